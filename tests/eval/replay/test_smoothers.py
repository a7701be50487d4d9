"""The smoothers of the replay beside the filters: fixed-lag in both phases, GNC's revisions, and who is gated."""

from __future__ import annotations

import numpy as np
import pytest

from association.decide import known_decisions
from data.logs import open_log
from data.notice import Code
from data.result import DISCARD, NEW
from data.worlds.arena import Arena, simulate
from eval.referee import errors
from eval.referee.score import Trial, confusion_of, score
from eval.replay.run import compare
from eval.replay.settings import Setup
from eval.studies.scenario import with_wrong_labels

GATED = Setup(gate_known=0.99, gate_smoothers=False)


@pytest.fixture(scope="module")
def clean():
    return simulate(Arena(frames=60), 3)


@pytest.fixture(scope="module")
def wrong(clean):
    return with_wrong_labels(clean, 0.15, 3)


def off(run, log):
    t = run.trajectory(run.phases[-1])
    return errors.rms(errors.position_distance(t.pose, log.truth.pose))


@pytest.mark.parametrize("task", ["localization", "slam"])
def test_a_fixed_lag_longer_than_the_log_is_isam2_and_a_short_one_is_near(clean, task):
    inputs = clean.inputs(labels=True)
    isam2, whole = (compare(inputs, task, [n], setup=Setup(lag=1e3))[0] for n in ("isam2", "fixed-lag"))
    (short,) = compare(inputs, task, ["fixed-lag"], setup=Setup(lag=3.0))
    assert whole.phases == short.phases == ("online", "final")
    np.testing.assert_allclose(whole.online.pose, isam2.online.pose, atol=1e-6)
    distance = errors.position_distance(short.online.pose, isam2.online.pose)
    assert 1e-7 < errors.rms(distance) < 0.01
    assert short.map is None or len(short.map) == len(isam2.map)


@pytest.mark.parametrize("name", [
    "arena:1", *(pytest.param(name, marks=pytest.mark.slow) for name in (
        "corridor:1", "corridor:0:no-odometry+forward", "park:0:frames=500"
    ))
])  # fmt: skip
def test_batch_and_isam2_end_in_the_same_optimum(name):
    inputs = open_log(name).inputs(labels=True)
    isam2, batch = compare(inputs, "slam", ["isam2", "batch"])
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
    scores = score([Trial(wrong, "slam", (gnc,))])
    assert scores.metrics.loc[0, "landmarks"] == len(gnc.map)


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
