"""The player: watching changes nothing, and its page is one small file that asks for nothing."""

import html.parser
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from association.names import METHODS
from data.log import shortened
from data.logs import open_log
from data.sensors import RelativePoint
from eval import play
from eval.player.document import document, played, player_of
from eval.player.pack import Pack, ranges, text_of
from eval.player.scene import COARSE, own_steps, scene
from eval.player.watch import NOT_ASKED, Watch
from eval.referee.score import Trial, confusion_of
from eval.replay.recorder import Observer
from eval.replay.run import compare, step_by_step
from eval.replay.settings import Setup
from tests.builders.logs import inputs_of, map_of, observations_of, still
from tests.builders.unpacked import unpacked
from tests.eval.handmade import circle_log
from tests.quick import slow
from tests.wings.camera.report.handmade import GREY, evidence


@pytest.fixture(scope="module")
def trial():
    log = shortened(open_log("corridor:0:people"), 15)
    runs = compare(log.inputs(labels=True), "slam", ["dead-reckoning", "ekf", "batch"], "known", watch=Watch)
    runs += compare(log.inputs(), "slam", ["ekf"], "nn", watch=Watch)
    return Trial(log, "slam", tuple(runs))


@pytest.fixture(scope="module")
def page(trial):
    return document(trial.log.name, [scene([trial], Setup())])


class Parts(html.parser.HTMLParser):
    """All attributes that could make a browser ask for something, and ids."""

    def __init__(self, text):
        super().__init__()
        self.asked, self.ids, self.unnamed = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.asked += [(tag, k, v) for k, v in attrs if k in ("src", "href", "srcset", "data", "action", "poster")]
        self.ids += [given["id"]] if "id" in given else []
        if tag == "canvas" and not given.get("aria-label"):
            self.unnamed.append(given)


def test_the_page_asks_for_nothing_names_its_licence_and_has_the_same_bytes_again(page, trial):
    parts = Parts(page)
    assert parts.asked == []
    assert "http://" not in page
    assert "https://" not in page
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|WebSocket\(|import\(", page)
    assert not parts.unnamed
    assert len(parts.ids) == len(set(parts.ids))
    assert "MIT licence" in page
    assert "Permission is hereby granted, free of charge" in page
    assert document(trial.log.name, [scene([trial], Setup())]) == page


def chunk_of(page):
    return json.loads(re.search(r'class="chunk">(.*?)</script>', page, re.S).group(1))


def test_paths_decisions_and_outcomes_are_those_of_the_runs(trial, page):
    chunk = chunk_of(page)
    arrays = unpacked(chunk)
    assert [r["estimator"] for r in chunk["runs"]] == ["dead-reckoning", "ekf", "batch", "ekf"]
    for run, entry in zip(trial.runs, chunk["runs"], strict=True):
        for phase in run.phases:
            xy = arrays[f"{entry['key']}{phase}_xy"]
            assert np.abs(xy - run.trajectory(phase).pose[:, :2]).max() < 0.1 * chunk["quantum"]
        if entry["decides"]:
            scored = confusion_of(run, trial.log, "online")
            assert arrays[f"{entry['key']}decision"][:, 0].tolist() == run.decisions.tolist()
            assert arrays[f"{entry['key']}outcome"][:, 0].tolist() == scored.outcome.tolist()
            assert arrays[f"{entry['key']}right"][:, 0].tolist() == scored.ground_truth.tolist()


def test_what_stands_beside_on_the_same_recording_is_in_the_same_player(trial):
    variant = Trial(trial.log, "slam", trial.runs[:1], variant_of=trial.log.name)
    other = Trial(open_log("corridor:1"), "slam", (), variant_of=trial.log.name)
    assert played([trial, variant, other]) == [(trial, variant)]
    assert player_of("corridor:0:people+no-odometry") == "players/corridor_0_people_no-odometry.html"


def test_the_command_writes_one_page(tmp_path, capsys):
    out = tmp_path / "short.html"
    arguments = ["corridor:0:people", "--association", "nn", "--estimator", "ekf", "--frames", "6", "--out", str(out)]
    assert play.main(arguments) == 0
    assert "short.html" in capsys.readouterr().out
    assert chunk_of(out.read_text(encoding="utf-8"))["frames"] == 6


def test_the_command_names_what_it_cannot_do(tmp_path, refused):
    assert "ends in .html" in refused(play.main, ["arena:0", "--out", str(tmp_path / "a.png")])
    assert "--frames none: a whole number" in refused(play.main, ["arena:0", "--frames", "none"])


def carried(add, values, *how):
    pack = Pack(0, len(values))
    getattr(pack, add)("a", values, *how)
    chunk = pack.done({})
    return unpacked(json.loads(text_of(chunk)))["a"], chunk["arrays"][0]


@pytest.mark.parametrize("step", [1e-4, 1e-3, 0.5])
def test_numbers_come_back_to_half_a_step(step):
    values = np.cumsum(np.random.default_rng(0).normal(size=(500, 3)), axis=0)
    back, _ = carried("add", values, step)
    assert np.abs(back - values).max() <= 0.5 * step * (1 + 1e-9)


def test_numbers_come_back_exactly_to_half_a_step_or_to_a_part_of_themselves():
    for most, size in ((100, 1), (30_000, 2), (1_000_000_000, 4)):
        values = np.array([0, most, most, most - 5])
        back, entry = carried("add", values)
        assert back[:, 0].tolist() == values.tolist()
        assert entry["size"] == size
    values = np.exp(np.random.default_rng(1).uniform(-20, 10, size=300))
    back, _ = carried("add_log", values)
    assert np.abs(back[:, 0] / values - 1).max() < 0.00051
    values = np.array([[np.nan, 1.0], [2.0, 3.0], [np.inf, 0.0], [4.0, 5.0]])
    back, entry = carried("add", values, 1.0)
    assert np.isnan(back).all(axis=1).tolist() == [True, False, True, False]
    assert back[[1, 3]].tolist() == [[2.0, 3.0], [4.0, 5.0]]
    assert entry["missing"] == [[0, 1], [2, 3]] == ranges(np.array([True, False, True, False]))
    values = np.array([0.0, 1.0, 1e12, -1e12])
    back, entry = carried("add", values, 1e-4)
    assert np.abs(back[:, 0] - values).max() <= 1e-9 * 1e12
    assert entry["scale"] < 1e-8 * 1e12
    with pytest.raises(OverflowError, match="a step of"):
        Pack(0, 1).add_steps("steps", np.array([2**31]))


def test_steps_and_names_are_packed_as_they_are():
    pack = Pack(3, 2)
    pack.add_steps("steps", np.array([[3, -1], [-300, 0]]))
    pack.add("nothing", np.empty((0, 2)))
    chunk = pack.done({"name": "x"})
    back = unpacked(chunk)
    assert back["steps"].tolist() == [[3, -1], [-300, 0]]
    assert back["nothing"].shape == (0, 2)
    assert (chunk["first"], chunk["frames"], chunk["name"]) == (3, 2, "x")
    assert "</script>" not in text_of(Pack(0, 0).done({"name": "</script>"}))


SMALL = ((0, b"first"), (2, b"second"), (4, b"third"))


def camera_log(small=SMALL):
    made = evidence()
    return replace(circle_log(), evidence=replace(made, found=replace(made.found, small=small)))


def test_small_images_and_corners_are_those_of_the_recording():
    log = camera_log()
    chunk = scene([Trial(log, "localization", ())], Setup())
    assert chunk["camera"] == {
        "width": GREY.shape[1], "frames": [0, 2, 4], "images": ["Zmlyc3Q=", "c2Vjb25k", "dGhpcmQ="],
    }  # fmt: skip
    arrays, found = unpacked(chunk), log.evidence.found
    assert arrays["camera_frame"][:, 0].tolist() == found.frame.tolist()
    assert arrays["camera_picture"][:, 0].tolist() == found.picture.tolist()
    np.testing.assert_allclose(arrays["camera_corners"], found.pixels.reshape(-1, 8), atol=0.13)
    log = shortened(camera_log(), 3)
    chunk = scene([Trial(log, "localization", ())], Setup())
    assert chunk["camera"]["frames"] == [0, 2]
    assert unpacked(chunk)["camera_frame"].max() == 2


class Memory(Observer):
    def __init__(self):
        self.maps, self.d2, self.said = {}, {}, {}

    def decided(self, front, frame, pairing):
        e = pairing.expectation
        for i in range(len(e.z)):
            for j, number in enumerate(e.number.tolist()):
                nu = e.z[i] - e.z_hat[j]
                nu = front.given.sensor.residual(e.z[i], e.z_hat[j]) if front.given.sensor.kind == 0 else nu
                self.d2[frame.first + i, number] = float(nu @ np.linalg.inv(e.HPHt[j] + e.R[i]) @ nu)
        for name in METHODS if len(e.number) else ():
            self.said[frame.number, name] = front.decide(e, name).decisions

    def updated(self, front, decisions, created):
        self.maps[front.k] = front.landmarks()


@pytest.fixture(scope="module")
def corridor():
    return shortened(open_log("corridor:0:people"), 12)


@pytest.fixture(scope="module")
def watched(corridor):
    memory = Memory()
    step_by_step("ekf", corridor.inputs().without_map(), "slam", "jcbb", observer=memory)
    return memory, compare(corridor.inputs(), "slam", ["ekf"], "jcbb", watch=Watch)[0]


def landmarks_at(w, frame):
    """By number, from the changes up to a frame: x, y, sigma_x, sigma_y, rho."""
    now = {}
    for i in np.flatnonzero(w.changes[:, 0] <= frame):
        number = int(w.changes[:, 1][i])
        now[number] = np.array([*w.changes[:, 3:5][i], *w.changes[:, 5:7][i], w.changes[:, 7][i]])
        if not w.changes[:, 2][i]:
            del now[number]
    return now


def test_landmarks_and_distances_are_those_of_each_instant_for_every_method(watched, corridor):
    memory, run = watched
    w = run.watched
    assert w.quantum == 1e-3
    assert w.every == 1
    for frame, state in memory.maps.items():
        now = landmarks_at(w, frame)
        assert sorted(now) == state.number.tolist()
        for number, xy, P in zip(state.number.tolist(), state.xy, state.covariance, strict=True):
            sigma = np.sqrt(np.diag(P))
            assert np.abs(now[number][:2] - xy).max() <= 0.5 * w.quantum
            assert 3 * np.abs(now[number][2:4] - sigma).max() <= 0.5 * w.quantum
    memory, run = watched
    w = run.watched
    for row, number, d2 in zip(w.pairs[:, 0].tolist(), w.pairs[:, 1].tolist(), w.pairs[:, 2], strict=True):
        assert d2 == pytest.approx(memory.d2[row, number], rel=1e-9)
    for row in {row for row, _ in memory.d2}:
        nearest = min((n for r, n in memory.d2 if r == row), key=lambda n: memory.d2[row, n])
        assert nearest in w.pairs[:, 1][w.pairs[:, 0] == row]
    paired = np.flatnonzero(run.decisions >= 0)
    assert set(zip(paired.tolist(), run.decisions[paired].tolist(), strict=True)) <= set(
        zip(w.pairs[:, 0].tolist(), w.pairs[:, 1].tolist(), strict=True)
    )
    memory, run = watched
    w, start = run.watched, corridor.recorded.start
    for (frame, name), said in memory.said.items():
        assert w.method_decisions[start[frame] : start[frame + 1], METHODS.index(name)].tolist() == said.tolist()
    assert (w.method_decisions[: start[1]] == NOT_ASKED).all()  # there was no map


@pytest.mark.parametrize("association", ["known", slow("jcbb"), "jcbb-hindsight"])
@pytest.mark.parametrize("estimator", ["ekf", "isam2"])
def test_watching_changes_no_number(corridor, estimator, association):
    inputs = corridor.inputs(labels=association == "known")
    plain, seen = (compare(inputs, "slam", [estimator], association, watch=w)[0] for w in (None, Watch))
    for phase in plain.phases:
        assert np.array_equal(plain.trajectory(phase).pose, seen.trajectory(phase).pose, equal_nan=True)
        assert np.array_equal(plain.trajectory(phase).covariance, seen.trajectory(phase).covariance, equal_nan=True)
    assert plain.decisions.tolist() == seen.decisions.tolist()
    assert np.array_equal(plain.map.covariance, seen.map.covariance)
    assert plain.watched is None
    assert len(seen.watched.changes[:, 0])
    assert seen.watched.covariances == (estimator == "ekf")


def test_a_landmark_that_leaves_the_map_leaves_the_picture(corridor):
    run = compare(corridor.inputs(), "slam", ["ekf"], "nn", Setup(maintain=True), Watch)[0]
    w = run.watched
    gone = np.flatnonzero(run.removed >= 0)
    assert len(gone)
    last = len(corridor.recorded) - 1
    assert sorted(landmarks_at(w, last)) == run.map.number.tolist()
    assert not set(gone.tolist()) & set(landmarks_at(w, last))
    assert sorted(w.changes[:, 1][w.changes[:, 2] == 0]) == gone.tolist()  # each once


def test_steps_of_each_landmark_add_up_to_its_values():
    number = np.array([4, 7, 4, 4, 7])
    values = np.array([[1.0], [10.0], [3.0], [2.0], [11.0]])
    assert own_steps(number, values)[:, 0].tolist() == [1.0, 10.0, 2.0, -1.0, 1.0]
    assert 0 < COARSE < 0.02


def test_kept_are_the_nearest_twelve_in_the_gate_and_who_was_paired_however_far():
    # the robot stands exactly at the origin, so a distance is that of the reading from the landmark, in sigmas
    x = 1.0 + 0.1 * np.arange(16)
    number, z = 2 * np.arange(16) + 1, np.array([[1.0, 0.05], [12.0, 0.0], [-9.0, 0.0]])
    known = map_of(np.column_stack([x, np.zeros(16)]), number)
    seen = observations_of([0, 0, 0], z, 1.0, [31, 7, 1])
    inputs = inputs_of(still(1), seen, RelativePoint(max_range=20.0), known)
    run = compare(inputs, "localization", ["ekf"], "known", watch=Watch)[0]
    w = run.watched
    assert run.decisions.tolist() == [31, 7, 1]
    kept = {0: [*range(12), 15], 1: [3, 15], 2: [0]}
    pairs = [(row, int(number[j])) for row, each in kept.items() for j in each]
    assert list(zip(w.pairs[:, 0].tolist(), w.pairs[:, 1].tolist(), strict=True)) == pairs
    d2 = [(x[j] - z[row, 0]) ** 2 + z[row, 1] ** 2 for row, each in kept.items() for j in each]
    assert w.pairs[:, 2] == pytest.approx(d2, abs=1e-9)
    seen = [*range(12), 15]
    assert w.seen[:, 0].tolist() == [0] * 13
    assert w.seen[:, 1].tolist() == number[seen].tolist()
    assert w.seen[:, 2:4] == pytest.approx(np.column_stack([x[seen], np.zeros(13)]), abs=1e-12)
    assert w.seen[:, 4:6] == pytest.approx(np.zeros((13, 2)), abs=1e-12)
    nearest = w.method_decisions[:, METHODS.index("nn")]
    assert nearest[0] == 1
    assert (nearest[1:] < 0).all()  # more than 9 sigma from all
