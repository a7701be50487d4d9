"""The replay: filters and smoothers on the same log, and failures that are told."""

import math
from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from association.names import METHODS
from data.inputs import Observations
from data.logs import open_log
from data.notice import Code, notice
from data.result import DISCARD, NEW
from data.sensors import RangeBearing
from data.worlds.arena import Arena, simulate
from eval.referee import errors
from eval.referee.score import Trial, association_row, confusion_of, score
from eval.replay import run as replay
from eval.replay.recorder import Observer
from eval.replay.run import compare, filter_known, step_by_step
from eval.replay.settings import Setup
from eval.studies.scenario import with_wrong_labels
from tests.builders.logs import inputs_of, map_of, observations_of, still
from tests.eval.replay.worlds import linear_world, slam


@pytest.mark.parametrize("method", METHODS)
def test_on_a_linear_world_filter_and_smoother_decide_alike_over_the_whole_run(method):
    ekf, isam2 = compare(linear_world(0), "slam", ["ekf", "isam2"], method)
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


GATED = Setup(gate_known=0.99, gate_smoothers=False)


@pytest.fixture(scope="module")
def clean():
    return simulate(Arena(frames=60), 3)


@pytest.fixture(scope="module")
def wrong(clean):
    return with_wrong_labels(clean, 0.15, 3)


def off(run, log):
    return errors.rms(errors.position_distance(run.trajectory(run.phases[-1]).pose, log.truth.pose))


@pytest.mark.parametrize("task", ["localization", "slam"])
def test_a_fixed_lag_longer_than_the_log_is_isam2_and_a_short_one_is_near(clean, task):
    inputs = clean.inputs(labels=True)
    isam2, whole = (compare(inputs, task, [n], setup=Setup(lag=1e3))[0] for n in ("isam2", "fixed-lag"))
    (short,) = compare(inputs, task, ["fixed-lag"], setup=Setup(lag=3.0))
    assert whole.phases == short.phases == ("online", "final")
    np.testing.assert_allclose(whole.online.pose, isam2.online.pose, atol=1e-6)
    assert 1e-7 < errors.rms(errors.position_distance(short.online.pose, isam2.online.pose)) < 0.01
    assert short.map is None or len(short.map) == len(isam2.map)


@pytest.mark.parametrize("name", [
    "arena:1", *(pytest.param(name, marks=pytest.mark.slow) for name in (
        "corridor:1", "corridor:0:no-odometry+forward", "park:0:frames=500"
    ))
])  # fmt: skip
def test_batch_and_isam2_end_in_the_same_optimum(name):
    isam2, batch = compare(open_log(name).inputs(labels=True), "slam", ["isam2", "batch"])
    sigma = np.sqrt(np.diagonal(batch.final.covariance, axis1=1, axis2=2)).clip(1e-6)
    assert np.abs((isam2.final.pose - batch.final.pose) / sigma).max() < 1e-3
    assert max(isam2.last_step_sigma, batch.last_step_sigma) < 1e-3
    assert min(isam2.iterations, batch.iterations) > 0


@pytest.mark.slow
@pytest.mark.parametrize("task", ["localization", "slam"])
def test_gnc_discards_what_is_wrong_and_its_path_is_as_good_as_without_it(clean, wrong, task):
    (reference,) = compare(clean.inputs(labels=True), task, ["batch"])
    batch, gnc = compare(wrong.inputs(labels=True), task, ["batch", "gnc"], setup=GATED)
    assert off(gnc, clean) < 1.5 * off(reference, clean)
    assert batch.status == "diverged" or off(batch, clean) > 3.0 * off(gnc, clean)
    paired = gnc.decisions >= 0
    lie = (wrong.label != wrong.truth.landmark_of)[paired]
    rejected = gnc.final_decisions[paired] == DISCARD
    assert rejected[lie].mean() > 0.9
    assert rejected[~lie].mean() < 0.1
    if task == "localization":  # in SLAM the referee takes a landmark for what its first observation was
        before, after = (confusion_of(gnc, wrong, phase) for phase in ("online", "final"))
        assert after.fp < 0.1 * before.fp
        assert after.tp > 0.9 * before.tp
    assert Code.OBSERVATIONS_REJECTED in [note.code for note in gnc.notes]
    assert (gnc.final_decisions[gnc.decisions == DISCARD] == DISCARD).all()


def test_a_landmark_of_which_nothing_is_left_is_discarded_with_its_founding(clean, wrong):
    (gnc,) = compare(wrong.inputs(labels=True), "slam", ["gnc"], setup=GATED)
    initialized = np.flatnonzero(gnc.created >= 0)
    gone = [i for i in initialized if gnc.created[i] not in gnc.map.number]
    assert all(gnc.final_decisions[i] == DISCARD for i in gone)
    kept = [i for i in initialized if gnc.created[i] in gnc.map.number]
    assert all(gnc.final_decisions[i] == NEW for i in kept)
    assert score([Trial(wrong, "slam", (gnc,))]).metrics.loc[0, "landmarks"] == len(gnc.map)


@pytest.mark.slow
def test_smoothers_get_the_gated_pairings_unless_the_gate_is_the_filters_alone(wrong):
    inputs = wrong.inputs(labels=True)
    every, _ = known_decisions(inputs)
    for setup, same_as_filter in ((Setup(gate_known=0.99), True), (GATED, False)):
        ekf, isam2, batch = compare(inputs, "localization", ["ekf", "isam2", "batch"], setup=setup)
        assert (ekf.decisions == DISCARD).sum() > 0.1 * len(every)
        assert np.array_equal(batch.decisions, ekf.decisions) == same_as_filter
        assert np.array_equal(batch.decisions, every) != same_as_filter
        assert np.array_equal(isam2.decisions, every) != same_as_filter
