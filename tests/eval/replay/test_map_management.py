"""The map is kept up by rules of frames and times; a large one is parked unasked, and no decision changes."""

import numpy as np
import pytest

from data.notice import Code
from data.result import DISCARD, NEW
from data.worlds.arena import Arena, simulate
from data.worlds.registry import named_log
from ekf import whole_run as epochs
from eval.referee.score import confusion_of
from eval.replay import map_management, run as replay
from eval.replay.frontend import FrontEnd
from eval.replay.map_management import MapManagement
from eval.replay.run import filter_known, step_by_step
from eval.replay.settings import Setup
from tests.builders.estimators import assert_close
from tests.builders.logs import inputs_of, observations_of, still
from tests.eval.replay.worlds import slam
from tests.quick import slow


def test_map_maintenance_removes_what_was_seen_once_from_filter_and_graph(crowded):
    setup = Setup(maintain=True)
    for name in ("ekf", "isam2"):
        run = step_by_step(name, slam(crowded), "slam", "jcbb", setup)
        initialized = np.flatnonzero(run.created >= 0)
        times = np.bincount(np.where(run.created >= 0, run.created, run.decisions)[run.decisions != DISCARD])
        frame = crowded.recorded.observations.frame
        last = len(crowded.recorded) - 1
        for i in initialized:
            n = run.created[i]
            gone = run.removed[n]
            assert (gone == frame[i] + 3) == (times[n] == 1 and frame[i] + 3 <= last)
            assert (run.final_decisions[i] == DISCARD) == (gone >= 0)
            assert (n in run.map.number) == (gone < 0)
        assert (run.removed >= 0).sum() > 5
        np.testing.assert_array_equal(run.decisions[initialized], NEW)


RULE = """
def rule(frame, landmarks):
    assert (landmarks.last <= frame).all()
    return landmarks.number[(landmarks.times == 1) & (frame - landmarks.first > 2)]
def strange(frame, landmarks):
    return [99]
"""


def test_a_function_of_the_users_says_which_landmarks_leave(crowded, tmp_path):
    (tmp_path / "mine.py").write_text(RULE)
    ours = step_by_step("ekf", slam(crowded), "slam", "jcbb", Setup(maintain=True))
    theirs = step_by_step("ekf", slam(crowded), "slam", "jcbb", Setup(maintain_by=f"{tmp_path}/mine.py:rule"))
    assert (theirs.removed >= 0).sum() > 5
    np.testing.assert_array_equal(theirs.removed, ours.removed)
    np.testing.assert_array_equal(theirs.online.pose, ours.online.pose)
    failed = step_by_step("ekf", slam(crowded), "slam", "jcbb", Setup(maintain_by=f"{tmp_path}/mine.py:strange"))
    assert "strange: landmark 99 is not in the map" in failed.failure.text


def test_a_removed_landmark_is_founded_again_under_a_new_number_with_labels_too():
    """One landmark seen in frames 0 and 9 only, another in all: the first is removed in between."""
    places = {4: [3.0, 1.0], 9: [2.0, -1.0]}
    frame, label = np.array([(k, i) for k in range(12) for i in ((9, 4) if k in (0, 9) else (9,))]).T
    seen = observations_of(frame, [places[i] for i in label], 1e-3, label)
    inputs = inputs_of(still(12, 1e-4), seen, spread=1e-4)
    for name in ("ekf", "isam2"):
        run = step_by_step(name, inputs, "slam", setup=Setup(maintain=True))
        assert run.created[run.created >= 0].tolist() == [0, 1, 2]
        assert run.removed.tolist() == [-1, 3, -1]
        assert run.map.number.tolist() == [0, 2]


def test_a_forgotten_landmark_is_gone_from_the_state_but_its_pairings_stay(lab):
    inputs = slam(lab, labels=True)
    run = step_by_step("ekf", inputs, "slam", setup=Setup(forget_after=5))
    whole = filter_known(inputs, "slam")
    assert run.state_size.max() < 3 + 2 * 60 < whole.state_size.max()
    assert (run.removed >= 0).sum() > 30
    np.testing.assert_array_equal(run.decisions, run.final_decisions)
    counts = confusion_of(run, lab, "final")
    assert counts.fp == counts.fn == 0
    batch = replay.batch("batch", inputs, run)
    assert batch.failure is None
    assert len(batch.map) == (run.created >= 0).sum()


def test_parked_landmarks_are_candidates_again_when_they_may_be_seen(lab):
    inputs = slam(lab)
    whole = step_by_step("ekf", inputs, "slam", "jcbb", Setup(in_view=True))
    run = step_by_step("ekf", inputs, "slam", "jcbb", Setup(in_view=True, deactivate_after=5))
    np.testing.assert_array_equal(run.decisions, whole.decisions)
    np.testing.assert_allclose(run.online.pose, whole.online.pose, atol=1e-9)


@pytest.mark.parametrize(("association", "maintain"), [
    ("jcbb", True), slow("jcbb", False), slow("jcbb-hindsight", False), slow("jcbb-hindsight", True)
])  # fmt: skip
def test_a_graph_forgets_and_parks_nothing(association, maintain):
    inputs = simulate(Arena(frames=60, landmarks=20), 3).inputs().without_map()
    setup = Setup(maintain=maintain, forget_after=3.0, deactivate_after=2.0)
    asked = step_by_step("isam2", inputs, "slam", association, setup)
    plain = step_by_step("isam2", inputs, "slam", association, Setup(maintain=maintain))
    forgetful = step_by_step("ekf", inputs, "slam", association, setup)
    assert np.array_equal(asked.final_decisions, plain.final_decisions)
    assert asked.map.number.tolist() == plain.map.number.tolist()
    assert len(forgetful.map.number) < len(asked.map.number)
    assert Code.FILTER_ONLY in [note.code for note in asked.notes]


def left(setup, seen, *, frames, seconds=0.5):
    """(frame, retracted, forgotten, parked) wherever something leaves; `seen`: numbers by frame."""
    management, found = MapManagement(setup), []
    for k in range(frames):
        management.begin(k, seconds * k)
        management.see(np.array(seen.get(k, []), np.int64))
        leaving = management.leaving()
        if any(map(len, leaving)):
            found.append((k, *(numbers.tolist() for numbers in leaving)))
    return found, management


def test_what_was_seen_once_goes_in_the_third_frame_after_and_only_once():
    found, management = left(Setup(maintain=True), {0: [0, 1], 1: [0, 2], 4: [3], 6: [3]}, frames=9)
    assert found == [(3, [1], [], []), (4, [2], [], [])]
    assert management.retracted == {1, 2}
    assert management.removal_frames(4).tolist() == [-1, 3, 4, -1]


PLAIN = Setup()


@pytest.fixture(scope="module")
def park():
    """250 frames through few crossings, so that many landmarks are seen again after a loop."""
    return named_log("park:5:frames=250+spacing=4+block=25+revisits=3")


@pytest.fixture
def eager(monkeypatch):
    def switch(on):
        monkeypatch.setattr(map_management, "LEAST", 10 if on else 10**9)
        monkeypatch.setattr(map_management, "KEPT", 3)
        monkeypatch.setattr(map_management, "PRODUCT", 1e-13)
        monkeypatch.setattr(map_management, "MOVED", 1e-12)
        monkeypatch.setattr(epochs, "LEAST", 10 if on else 10**9)
        monkeypatch.setattr(epochs, "WORTH", np.inf)

    return switch


def assert_same_run(run, plain):
    assert_close(run, plain)
    np.testing.assert_array_equal(run.created, plain.created)
    np.testing.assert_allclose(run.gated, plain.gated, rtol=1e-9)
    assert run.notes == plain.notes


def watched(monkeypatch):
    """Lengths of the state at every update, and how often landmarks came back."""
    sizes, back = [], []
    see, restore = map_management.AutomaticParking.see, map_management.AutomaticParking._restore

    def seen(self, observations, numbers):
        sizes.append(self.slam.size)
        see(self, observations, numbers)

    def restored(self, numbers):
        back.append(len(numbers))
        restore(self, numbers)

    monkeypatch.setattr(map_management.AutomaticParking, "see", seen)
    monkeypatch.setattr(map_management.AutomaticParking, "_restore", restored)
    return sizes, back


@pytest.mark.parametrize(("method", "setup"), [
    ("jcbb", PLAIN), ("jcbb", Setup(forget_after=120, maintain=True)),
    pytest.param("nn", Setup(gate=0.9, new_gate=0.99), marks=pytest.mark.slow),
    pytest.param("ml-ratio", Setup(new_gate=None), marks=pytest.mark.slow),
    pytest.param("gnn", PLAIN, marks=pytest.mark.slow), ("known", Setup(maintain=True, gate_known=0.99)),
])  # fmt: skip
def test_no_decision_and_no_estimate_changes(park, eager, monkeypatch, method, setup):
    inputs = slam(park, labels=method == "known")
    eager(False)
    plain = step_by_step("ekf", inputs, "slam", method, setup)
    eager(True)
    sizes, back = watched(monkeypatch)
    assert_same_run(step_by_step("ekf", inputs, "slam", method, setup), plain)
    assert np.mean(np.array(sizes) < 0.7 * plain.state_size.max()) > 0.3
    assert sum(back) > 10


def test_who_cannot_park_or_needs_every_landmark_is_left_alone(lab):
    def parks(name, method="jcbb", setup=PLAIN, given=None):
        return isinstance(FrontEnd(name, method, given or slam(lab), setup).parking, map_management.AutomaticParking)

    assert parks("ekf")
    assert parks("ekf", "ml-ratio", Setup(new_gate=None))
    assert not parks("ekf", setup=Setup(new_gate=None))
    assert not parks("ekf", setup=Setup(gate=None))
    assert not parks("ekf", setup=Setup(deactivate_after=5))
    assert not any(parks(name) for name in ("ekf-iterated", "ekf-fej", "ekf-invariant", "isam2"))
    assert not parks("ekf", given=lab.inputs())
