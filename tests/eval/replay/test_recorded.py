"""What is written down of a run frame by frame, in parts where a frame comes in parts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from data.inputs import Frame, FrameObservations
from data.result import DISCARD, NEW, Event, Finished, MapState, Updated
from eval.replay.recorder import Recorder

NOTHING = Finished(None, None)


def part(number, first, count):
    seen = FrameObservations(np.zeros((count, 2)), np.tile(np.eye(2), (count, 1, 1)))
    return Frame(number, float(number), None, seen, None, first)


def front(**changed):
    """Of a filter without systematic errors that nothing was revised in."""
    estimator = SimpleNamespace(smooths=False, estimate=lambda: (np.arange(3.0), 2.0 * np.eye(3)))
    given = {"k": 1, "estimator": estimator, "state_size": 7, "map_management": None, "association": "jcbb"}
    given |= {"can": SimpleNamespace(calibrating=None), "poses": SimpleNamespace(gate=None)}
    return SimpleNamespace(
        **{**given, "events": lambda: (), "notes": list, "gated_final": None, "left": None, **changed}
    )


def ran(recorder, front, finished=NOTHING, failure=None):
    return recorder.run("ekf", "slam", front, finished, failure, 1.5)


def updated(used, created, nis, dof, likelihood, moments=None):
    n = len(used)
    white = np.arange(2.0 * n).reshape(n, 2)
    return Updated(np.array(used), np.array(created), nis, dof, likelihood, white)._replace(moments=moments)


@pytest.fixture
def recorder():
    found = Recorder(3, 6)
    found.update(part(0, 0, 2), np.array([NEW, NEW]), updated([False] * 2, [0, 1], np.nan, 0, np.nan))
    found.update(part(1, 2, 2), np.array([0, 1]), updated([True, False], [-1, -1], 3.0, 2, -1.0))
    found.update(part(1, 4, 1), np.array([NEW]), updated([False], [2], np.nan, 0, np.nan))
    found.update(part(1, 5, 1), np.array([1]), updated([True], [-1], 4.0, 2, -2.5, (1.5, 2.0)))
    return found


def test_parts_of_a_frame_add_up(recorder):
    run = ran(recorder, front())
    assert run.decisions.tolist() == [NEW, NEW, 0, DISCARD, NEW, 1], "a pairing that was not used is none"
    assert run.created.tolist() == [0, 1, -1, -1, 2, -1]
    i = run.innovations
    assert i.nis == pytest.approx([np.nan, 7.0, np.nan], nan_ok=True)
    assert i.dof.tolist() == [0, 4, 0]
    assert i.log_likelihood == pytest.approx([np.nan, -3.5, np.nan], nan_ok=True)
    assert i.white[2:4].tolist() == [[0.0, 1.0], [2.0, 3.0]]
    assert run.total_nis == (7.0, 4)
    assert run.gated == pytest.approx(((2 + 1.5) / 4, (4 + 2.0) / 4))
    assert run.seconds == 1.5


def test_a_smoothers_sum_is_its_own_and_a_filter_that_failed_has_none(recorder):
    smoother = front(estimator=SimpleNamespace(smooths=True))
    run = ran(recorder, smoother, Finished(None, None, (9.0, 8)))
    assert (run.total_nis, run.state_size) == ((9.0, 8), None)
    assert ran(recorder, front(), NOTHING, SimpleNamespace(status="diverged")).total_nis is None


def test_what_turns_from_a_pairing_into_new_is_what_its_landmark_begins_with():
    recorder = Recorder(2, 4)
    recorder.decisions[:], recorder.created[:] = [NEW, 0, 0, DISCARD], [0, -1, -1, -1]
    events = (Event(1, 0, NEW, DISCARD, "x"), Event(1, 2, 0, NEW, "x"), Event(1, 3, DISCARD, 0, "x"))
    run = ran(recorder, front(events=lambda: events, gated_final=(0.9, 1.5)))
    assert run.final_decisions.tolist() == [DISCARD, 0, NEW, 0]
    assert run.initialized.tolist() == [-1, -1, 0, -1]
    assert run.gated_final == (0.9, 1.5)
    # without such an event it is what is left of what was created
    plain = ran(recorder, front(events=lambda: events[2:]))
    assert plain.begun is None
    assert plain.initialized.tolist() == [0, -1, -1, -1]


def test_what_was_retracted_or_revised_counts_in_the_end_and_in_the_map(recorder):
    management = SimpleNamespace(retracted={0}, removal_frames=lambda count: np.full(count, 5))
    events = (Event(2, 5, 1, 2, "moved"),)
    state = MapState(np.array([1, 2]), np.zeros((2, 2)), np.zeros((2, 2, 2)))
    run = ran(recorder, front(map_management=management, events=lambda: events), Finished(None, state))
    assert run.decisions.tolist() == [NEW, NEW, 0, DISCARD, NEW, 1]
    assert run.final_decisions.tolist() == [DISCARD, NEW, DISCARD, DISCARD, NEW, 2]
    assert run.removed.tolist() == [5, 5, 5]
    assert run.events == events
    assert (run.map.first_frame.tolist(), run.map.times_seen.tolist()) == ([0, 1], [1, 2])
