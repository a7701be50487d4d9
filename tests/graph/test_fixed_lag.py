"""Fixed-lag smoothing: the filter's answers where all is linear, batch with a long lag, gtsam's smoother as oracle."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L

from association.decide import known_decisions
from data import se2
from data.inputs import FrameObservations, Increments
from data.result import DISCARD
from ekf.slam import EkfSlam
from ekf.whole_run import run_filter
from graph.batch import smooth
from graph.incremental import Isam2Smoother
from graph.problem import Start
from tests.graph.worlds import (
    SENSORS,
    TIGHT,
    both_tasks,
    circle,
    drive,
    every_sensor,
    for_task,
    lagged,
    order_of_creation,
    resting,
    two_sensors,
)


def held(smoother):
    keys = smoother._engine.values().keys()
    return [gtsam.symbolIndex(k) for k in keys if gtsam.symbolChr(k) == ord("x")]


@pytest.mark.slow
@every_sensor
@both_tasks
@pytest.mark.parametrize("P0", [None, np.zeros((3, 3)), 0.01 * np.ones((3, 3))], ids=["P0", "zero", "rank one"])
@pytest.mark.parametrize("lag", [0.0, 7.0])
def test_noise_free_it_is_the_filter(sensor, task, P0, lag):
    """All is linearized at the truth, so that marginalization loses nothing: poses, covariances, map are the EKF's."""
    inputs, truth, xy = circle(sensor, noise=0.0, P0=P0, frames=30)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    s, poses, covariances, _ = drive(inputs, decisions, smoother=lagged(inputs, lag, **TIGHT))
    assert min(held(s)) >= len(inputs) - 2 - lag
    finished = s.finish()
    run = run_filter(inputs, decisions)
    assert np.abs(se2.pose_error(poses, truth)).max() < 1e-6
    assert np.abs(se2.pose_error(finished.final.pose, truth)).max() < 1e-6
    np.testing.assert_allclose(covariances, run.covariance, atol=2e-8)
    np.testing.assert_allclose(finished.final.covariance[-1], run.covariance[-1], atol=2e-8)
    assert finished.total_nis is None
    if task == "slam":
        ids = order_of_creation(inputs, decisions, created)
        np.testing.assert_array_equal(finished.map.number, np.arange(len(ids)))
        np.testing.assert_allclose(finished.map.xy, xy[ids], atol=1e-6)
        np.testing.assert_allclose(finished.map.covariance, run.map.covariance, atol=2e-8)
    else:
        assert finished.map is None


@two_sensors
@both_tasks
def test_a_pose_is_final_as_the_data_until_it_left_have_it(sensor, task):
    """Noise-free, so that the batch covariance over the first k frames is the oracle for pose k - lag."""
    inputs, _, _ = circle(sensor, noise=0.0, frames=24, see=1.0)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    final = drive(inputs, decisions, smoother=lagged(inputs, 5.0, slack=0.0, **TIGHT))[0].finish().final
    o, start = inputs.observations, run_filter(inputs, decisions)
    landmark = np.empty((0, 2)) if start.map is None else start.map.xy
    for k in (0, 3, 11, 17):
        until = np.where(o.frame <= k + 6, decisions, DISCARD), np.where(o.frame <= k + 6, created, -1)
        batch = smooth(inputs, *until, Start(start.pose, landmark))
        np.testing.assert_allclose(final.covariance[k], batch.trajectory.covariance[k], atol=2e-8)


def test_a_run_without_any_sighting_is_dead_reckoning():
    inputs, _, _ = circle(SENSORS["relative point"])
    nothing = np.full(len(inputs.observations.frame), DISCARD)
    run = run_filter(inputs, nothing)
    for task in ("localization", "slam"):
        given = for_task(inputs, task)
        s, poses, covariances, _ = drive(given, nothing, smoother=lagged(given, 5.0))
        np.testing.assert_allclose(poses, run.pose, atol=1e-12)
        np.testing.assert_allclose(covariances, run.covariance, atol=1e-12)
        final = s.finish().final
        np.testing.assert_allclose(final.pose, run.pose, atol=1e-9)
        np.testing.assert_allclose(final.covariance, run.covariance, atol=1e-9)


def test_senseless_requests_are_refused():
    inputs, _, _ = circle(SENSORS["range-bearing"])
    for lag in (-1.0, np.nan):
        with pytest.raises(ValueError, match="must not be negative"):
            lagged(inputs, lag)
    with pytest.raises(ValueError, match="must not be negative"):
        lagged(inputs, 3.0, slack=-0.5)
    with pytest.raises(ValueError, match="known map"):
        lagged(inputs, 3.0).remove(np.array([0]))
    assert isinstance(lagged(inputs, 3.0), Isam2Smoother)


@two_sensors
@pytest.mark.parametrize("P0", [None, np.zeros((3, 3))], ids=["P0", "zero"])
def test_removal_of_an_old_landmark_leaves_the_rest_as_a_filter_does(sensor, P0):
    """Its last observation left the window long ago: estimate and map of the others do not change, then or later."""
    inputs, truth, _ = circle(sensor, noise=0.0, frames=40, P0=P0)
    inputs = inputs.without_map()
    decisions, created = known_decisions(inputs)
    o = inputs.observations
    decisions[np.isin(o.label, (0, 5)) & (o.frame > 10)] = DISCARD
    gone = np.unique(created[(created >= 0) & np.isin(o.label, (0, 5))])
    assert len(gone) == 2
    s, twin = lagged(inputs, 6.0, **TIGHT), EkfSlam(inputs.prior, inputs.sensor)
    for k in range(len(inputs)):
        if k:
            s.predict(inputs.increment(k))
            twin.predict(inputs.increment(k))
        if k == 25:
            before = s.estimate()
            assert all(s._engine.holds(L(n)) for n in gone.tolist())
            twin.remove(gone)
            s.remove(gone)
            assert not any(s._engine.holds(L(n)) for n in gone.tolist())
            np.testing.assert_allclose(s.estimate().covariance, before.covariance, atol=1e-9)
        for e in (s, twin):
            e.update(inputs.frame_observations(k), decisions[inputs.start[k] : inputs.start[k + 1]])
    np.testing.assert_allclose(s.estimate().covariance, twin.estimate().covariance, atol=2e-8)
    np.testing.assert_allclose(se2.pose_error(s.estimate().mean, truth[-1]), 0.0, atol=1e-6)
    ours, theirs = s.finish().map, twin.finish().map
    np.testing.assert_array_equal(ours.number, np.sort(theirs.number))
    np.testing.assert_allclose(ours.covariance, theirs.covariance[np.argsort(theirs.number)], atol=2e-8)


@pytest.mark.parametrize("warned", [True, False], ids=["beforehand", "by the breakdown"])
def test_a_change_to_qr_in_the_middle_keeps_what_was_marginalized(warned, monkeypatch):
    """Off the truth, so that linear factors would be read at the wrong point if they lost theirs."""
    import graph.incremental as module

    if not warned:
        monkeypatch.setattr(module, "DELICATE", 0.0)
    inputs = resting(SENSORS["range-bearing"])
    noisy, _, _ = circle(SENSORS["range-bearing"])
    covariance = inputs.increments.covariance.copy()
    covariance[1:30] = noisy.increments.covariance[1:30]
    mean = inputs.increments.mean.copy()
    mean[1:30] = noisy.increments.mean[1:30]
    o = inputs.observations
    z = np.where((o.frame < 30)[:, None], noisy.observations.z, o.z)
    inputs = replace(inputs, increments=Increments(mean, covariance), observations=replace(o, z=z))
    decisions, _ = known_decisions(inputs)
    s, *_ = drive(inputs, decisions, until=30, smoother=lagged(inputs, 6.0, threshold=1e-6, skip=1))
    assert not s._engine.qr
    s.refine(3)
    before, map_before = s.estimate(), s.landmarks()
    s._engine.use_qr()
    s.refine(3)
    sigma = np.sqrt(np.diag(before.covariance))
    # all is linearized anew, so that there is a difference, far below a sigma
    assert (np.abs(se2.pose_error(s.estimate().mean, before.mean)) < 0.03 * sigma).all()
    np.testing.assert_allclose(s.estimate().covariance, before.covariance, atol=0.02 * sigma.max() ** 2)
    np.testing.assert_allclose(s.landmarks().xy, map_before.xy, atol=0.02)
    s, poses, _, _ = drive(inputs, decisions, smoother=lagged(inputs, 6.0))
    assert s._engine.qr
    assert np.abs(se2.pose_error(poses, drive(inputs, decisions)[1])).max() < 0.05
    s.remove(np.array([0, 2]))
    assert len(s.finish().map.number) == decisions.max() - 1


def test_pairings_are_amended_in_the_window_only():
    inputs, _, _ = circle(SENSORS["range-bearing"], frames=40, landmarks=6)
    right, _ = known_decisions(inputs)
    o = inputs.observations
    wrong = np.where(np.isin(o.frame, [5, 36]), (right + 1) % 6, right)
    rows = np.flatnonzero(np.isin(o.frame, [5, 36]))
    recent = np.where(o.frame == 36, right, wrong)
    s, *_ = drive(inputs, wrong, smoother=lagged(inputs, 10.0, **TIGHT))
    expected, *_ = drive(inputs, recent, smoother=lagged(inputs, 10.0, **TIGHT))
    s.amend(o.frame[rows], FrameObservations(o.z[rows], o.R[rows]), right[rows])
    expected.refine(10)
    s.refine(10)
    for a, b in zip(s.estimate(), expected.estimate(), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    assert len(s.finish().final.pose) == len(inputs)
