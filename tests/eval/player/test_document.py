"""The player's page: one file that asks for nothing, packed in few bytes, the camera's images in it."""

from __future__ import annotations

import html.parser
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from data.log import shortened
from data.logs import open_log
from eval import play
from eval.player.document import document, played, player_of
from eval.player.pack import Pack, ranges, text_of, unpacked
from eval.player.scene import scene
from eval.player.watch import Watch
from eval.referee.score import Trial, confusion_of
from eval.replay.run import compare
from eval.replay.settings import Setup
from tests.eval.handmade import circle_log
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


def test_the_command_names_what_it_cannot_do(tmp_path, capsys):
    assert play.main(["arena:0", "--out", str(tmp_path / "a.png")]) == 2
    assert "ends in .html" in capsys.readouterr().err
    assert play.main(["arena:0", "--frames", "none"]) == 2
    assert "--frames none: a whole number" in capsys.readouterr().err


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
        "width": GREY.shape[1],
        "frames": [0, 2, 4],
        "images": ["Zmlyc3Q=", "c2Vjb25k", "dGhpcmQ="],
    }
    arrays, found = unpacked(chunk), log.evidence.found
    assert arrays["camera_frame"][:, 0].tolist() == found.frame.tolist()
    assert arrays["camera_picture"][:, 0].tolist() == found.picture.tolist()
    np.testing.assert_allclose(arrays["camera_corners"], found.pixels.reshape(-1, 8), atol=0.13)
    log = shortened(camera_log(), 3)
    chunk = scene([Trial(log, "localization", ())], Setup())
    assert chunk["camera"]["frames"] == [0, 2]
    assert unpacked(chunk)["camera_frame"].max() == 2
