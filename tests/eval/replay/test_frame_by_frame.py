"""A run frame by frame: what a front end gets, what is written down, and one list of names."""

from collections import Counter
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import get_type_hints

import numpy as np
import pytest

from association.decide import PLAIN, SEARCHES
from association.names import SCAN
from data.errors import UsageError
from data.inputs import Frame, FrameObservations, Observations
from data.result import DISCARD, NEW, Event, Finished, MapState, Updated
from data.worlds.arena import Arena, simulate
from ekf import kernels, localizer, updates
from eval.replay import settings
from eval.replay.estimators import OPTIONAL, Estimator, capabilities, make_estimator
from eval.replay.frontend import FrontEnd
from eval.replay.hindsight.localizing_frontend import Stretches
from eval.replay.recorder import Recorder
from eval.replay.run import compare, front_end, step_by_step
from eval.replay.settings import HINDSIGHT, MHT, Beginning, Setup
from graph import factors
from tests.quick import slow

MANAGED = Setup(maintain=True, forget_after=3.0, lag=2.0)


@pytest.fixture(scope="module")
def inputs():
    return simulate(Arena(frames=60, landmarks=20), 3).inputs(labels=True)


def alone(name, association, inputs, setup):
    """Decisions (M,) and poses (N, 3) by a front end that never sees more than a frame at a time."""
    frames = [inputs.frame(k) for k in range(len(inputs))]
    front = front_end(name, association, Beginning(inputs.prior, inputs.sensor, inputs.map), setup)
    decisions, poses = [], []
    while frames:
        frame = frames.pop(0)
        front.move(frame)
        if len(frame.observations.z):
            pairing = front.associate(frame)
            done = front.update(frame, pairing)
            decisions += np.where((pairing.decisions >= 0) & ~done.used, -2, pairing.decisions).tolist()
        front.tidy()
        poses.append(front.estimator.estimate().mean)
    front.close()
    return decisions, poses


@pytest.mark.parametrize("association", ["known", pytest.param("jcbb", marks=pytest.mark.slow), "jcbb-hindsight"])
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("name", ["ekf", slow("isam2"), slow("fixed-lag")])
def test_a_run_needs_no_more_than_a_frame_at_a_time(inputs, name, task, association):
    given = inputs if task == "localization" else inputs.without_map()
    given = given if association == "known" else given.without_labels()
    run = step_by_step(name, given, task, association, MANAGED)
    decisions, poses = alone(name, association, given, MANAGED)
    assert run.decisions.tolist() == decisions
    assert np.array_equal(run.online.pose, poses)


def test_labels_that_were_not_granted_are_missed_at_the_first_sighting(inputs):
    o = inputs.observations
    front = front_end("ekf", "known", replace(inputs, observations=Observations(o.frame, o.z, o.R)), Setup())
    front.move(inputs.frame(0))
    with pytest.raises(ValueError, match="not granted"):
        front.associate(inputs.frame(0)._replace(label=None))


def test_a_frame_of_the_localizer_takes_a_call_to_predict_one_to_look_up_and_one_to_update(inputs, monkeypatch):
    calls = Counter()

    def counted(name, real):
        return lambda *given: calls.update([name]) or real(*given)

    kinds = kernels, localizer, updates
    functions = {(m, n): f for m in kinds for n, f in vars(m).items() if hasattr(f, "py_func") and f.py_func is not f}
    for (module, name), real in functions.items():
        monkeypatch.setattr(module, name, counted(name, real))
    step_by_step("ekf", inputs, "localization")
    seen = int((np.diff(inputs.start) > 0).sum())
    assert calls == {"predict": len(inputs) - 1, "look_up": seen, "of_frame": seen}


NOTHING = Finished(None, None)


def part(number, first, count):
    seen = FrameObservations(np.zeros((count, 2)), np.tile(np.eye(2), (count, 1, 1)))
    return Frame(number, float(number), None, seen, None, first)


def front(**changed):
    """Of a filter without systematic errors that nothing was revised in."""
    estimator = SimpleNamespace(smooths=False, estimate=lambda: (np.arange(3.0), 2.0 * np.eye(3)))
    given = {"k": 1, "estimator": estimator, "state_size": 7, "map_management": None, "association": "jcbb"}
    given |= {"can": SimpleNamespace(calibrating=None), "poses": SimpleNamespace(gate=None)}
    found = SimpleNamespace(
        **{**given, "events": lambda: (), "notes": list, "gated_final": None, "left": None, **changed}
    )
    found.initialized = partial(FrontEnd.initialized, found)
    return found


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
    run = ran(recorder, front(estimator=SimpleNamespace(smooths=True)), Finished(None, None, (9.0, 8)))
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


def test_every_batch_smoother_is_a_loss_that_the_graph_knows_or_gnc():
    assert [settings.ESTIMATOR_TABLE[name].options["loss"] for name in settings.BATCH] == [*factors.LOSSES, "truncated"]


def test_every_way_of_association_is_known_a_method_hindsight_or_of_scans():
    assert {*settings.ASSOCIATIONS} - {*PLAIN, *SEARCHES} == {"known", HINDSIGHT, MHT, SCAN}


@pytest.mark.parametrize("task", settings.TASKS)
def test_every_estimator_runs_by_its_name(task):
    runs = compare(simulate(Arena(frames=4), 0).inputs(labels=True), task, settings.ESTIMATORS)
    assert [run.estimator for run in runs] == list(settings.ESTIMATORS)


@pytest.mark.parametrize("task", settings.TASKS)
@pytest.mark.parametrize("name", settings.STEPPING)
def test_every_stepping_estimator_has_the_core_and_capabilities_that_are_its_own(name, task):
    inputs = simulate(Arena(frames=2), 0).inputs()
    estimator = make_estimator(name, inputs if task == "localization" else inputs.without_map())
    verbs = [verb for verb in vars(Estimator) if not verb.startswith("_")]
    assert [verb for verb in verbs if not hasattr(estimator, verb)] == []
    assert [verb for verb in verbs if not hasattr(Stretches, verb)] == []
    smooths = name in settings.INCREMENTAL
    assert estimator.smooths == smooths
    assert get_type_hints(type(estimator).update)["innovations"] is bool
    can = capabilities(estimator)
    expected = {
        "stamp": name == "fixed-lag", "size": not smooths, "errors": True, "park": not smooths and task == "slam",
        "remove": smooths or task == "slam", "merge": smooths or task == "slam", "amend": smooths, "inflate": True,
        "reset": not smooths and task == "localization", "look": True, "initialize": smooths or task == "slam",
        "fix": True, "close_loops": True,
    }  # fmt: skip
    assert {verb: can.get(verb) is estimator for verb in OPTIONAL} == expected


def test_an_unknown_name_is_told_those_that_work_step_by_step():
    with pytest.raises(UsageError, match=", ".join(settings.STEPPING[:-1])):
        make_estimator("batch", simulate(Arena(frames=2), 0).inputs())
