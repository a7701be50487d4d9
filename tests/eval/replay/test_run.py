"""The replay with unknown labels: both estimators decide for themselves, failures are told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from association.names import METHODS
from data.inputs import Observations
from data.notice import Code, notice
from data.result import DISCARD
from data.sensors import RangeBearing
from eval.referee.score import association_row
from eval.replay import run as replay
from eval.replay.recorder import Observer
from eval.replay.run import compare, filter_known, step_by_step
from tests.builders.logs import inputs_of, map_of, observations_of, still
from tests.eval.replay.worlds import linear_world, slam


@pytest.mark.parametrize("method", METHODS)
def test_on_a_linear_world_filter_and_smoother_decide_alike_over_the_whole_run(method):
    inputs = linear_world(0)
    ekf, isam2 = compare(inputs, "slam", ["ekf", "isam2"], method)
    assert ekf.failure is None
    assert isam2.failure is None
    np.testing.assert_array_equal(ekf.decisions, isam2.decisions)
    np.testing.assert_array_equal(ekf.created, isam2.created)
    assert (ekf.decisions >= 0).sum() > 20
    np.testing.assert_allclose(ekf.online.pose, isam2.online.pose, atol=1e-6)
    # iSAM2 updates a landmark only when it moves by more than a part of the relinearization threshold
    np.testing.assert_allclose(ekf.innovations.nis, isam2.innovations.nis, rtol=5e-3, atol=0.05)


def test_known_without_labels_is_refused(lab):
    with pytest.raises(ValueError, match="not granted"):
        step_by_step("ekf", slam(lab), "slam")


@pytest.mark.slow
def test_a_batch_takes_the_decisions_of_isam2_or_of_the_filter_if_there_is_no_isam2(lab):
    inputs = slam(lab, labels=True)
    _, isam2, batch = compare(inputs, "slam", ["ekf", "isam2", "batch"], "nn")
    np.testing.assert_array_equal(batch.final_decisions, isam2.final_decisions)
    assert batch.notes[0] == notice(Code.DECIDED_BY, front="isam2")
    ekf, alone = compare(inputs, "slam", ["ekf", "batch"], "nn")
    np.testing.assert_array_equal(alone.decisions, ekf.decisions)
    assert alone.notes[0] == notice(Code.DECIDED_BY, front="ekf")
    assert not np.array_equal(ekf.decisions, isam2.decisions)


def test_a_filter_that_failed_has_what_was_begun_before_decides_nothing_after_and_is_counted_nowhere(lab):
    inputs = slam(lab, labels=True)
    o = inputs.observations
    z = np.where((o.frame == 9)[:, None], 1e200, o.z)
    run = filter_known(replace(inputs, observations=replace(o, z=z)), "slam")
    assert run.failure.status == "diverged"
    assert run.failure.frame in (9, 10)
    assert run.total_nis is None
    assert association_row(run, "final", lab) is None
    before = o.frame < run.failure.frame
    assert set(run.decisions[~before]) == {DISCARD}
    assert (run.created[~before] == -1).all()
    _, first = np.unique(o.label[before], return_index=True)
    begun = np.sort(o.frame[before][first])
    assert run.map.number.tolist() == list(range(len(begun)))
    assert run.map.first_frame.tolist() == begun.tolist()
    assert (run.created >= 0).sum() == len(begun)
    assert run.map.times_seen.sum() == ((run.decisions >= 0) | (run.created >= 0)).sum()
    assert np.isfinite(run.online.pose[:9]).all()
    assert np.isnan(run.online.pose[run.failure.frame :]).all()


def test_a_search_out_of_budget_is_told(lab, monkeypatch):
    real = replay.FrontEnd.decide
    monkeypatch.setattr(
        replay.FrontEnd, "decide", lambda self, e, method=None: real(self, e, method)._replace(complete=False)
    )
    run = step_by_step("ekf", slam(lab), "slam", "jcbb")
    assert run.notes[0] == notice(Code.OUT_OF_NODES, method="jcbb", nodes=50000, frames=44)


def test_a_singular_innovation_covariance_is_a_failure_with_frame_and_reason(lab):
    inputs = slam(lab)
    o = inputs.observations
    R = o.R.copy()
    R[o.frame == 7] = -np.eye(2)
    run = step_by_step("ekf", replace(inputs, observations=Observations(o.frame, o.z, R)), "slam", "nn")
    assert run.failure.status == "diverged"
    assert run.failure.frame == 7
    assert "positive definite" in run.failure.why
    assert np.isfinite(run.online.pose[:7]).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["ekf", "isam2"])
@pytest.mark.parametrize("task", ["localization", "slam"])
def test_odd_frames_are_no_reason_to_stop(name, method, task):
    """Nothing seen, one landmark seen 60 times, two landmarks at one place, one at the robot, one beyond range."""
    landmarks = map_of([[2.0, 0.0], [2.0, 0.0], [0.0, 0.0], [0.0, 40.0]])
    frame, z = [], []
    for k, ranges in enumerate(([2.0, 1e-3], [], [2.0] * 60, [2.0, 40.0], [1e-3], [2.0])):
        frame += [k] * len(ranges)
        z += [(r, 0.0 if r < 30 else math.pi / 2) for r in ranges]
    seen = observations_of(frame, z, np.diag([1e-2, 1e-3]))
    inputs = inputs_of(still(6, 1e-4), seen, RangeBearing(), landmarks, spread=1e-4)
    run = step_by_step(name, inputs if task == "localization" else inputs.without_map(), task, method)
    if run.failure is None:
        assert np.isfinite(run.online.pose).all()
        assert np.isfinite(run.online.covariance).all()
    else:
        assert run.failure.why
    assert len(run.decisions) == len(z)


def test_what_an_observer_raises_is_no_failure_of_the_estimator(lab):
    """Somebody who stops a replay, or an assertion in an observer, must not be taken for a run that diverged."""

    class Stopping(Observer):
        def moved(self, front):
            raise LookupError("stopped")

    with pytest.raises(LookupError, match="stopped"):
        step_by_step("ekf", slam(lab), "slam", "nn", observer=Stopping())
