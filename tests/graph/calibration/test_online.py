"""iSAM2 and the fixed-lag smoother estimate systematic errors of odometry and sensor along with path and map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.inputs import Increment, LandmarkMap
from data.motion.systematic import corrected_all, places
from data.result import DISCARD
from graph.batch import smooth
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from graph.problem import Start
from tests.graph.calibration.least_squares import solve
from tests.graph.calibration.running import calibrated, in_sigmas, true_map
from tests.graph.calibration.worlds import (
    ALL,
    CARTESIAN,
    CARTESIAN_OFF,
    ODOMETRY,
    POLAR,
    POLAR_OFF,
    erring,
    read_wrongly,
    to_estimate,
)
from tests.graph.driving import drive, for_task

WHAT = {"odometry": ODOMETRY, "drift": ("scale", "curvature", "drift"), "bearing": ("bearing",), "all": ALL}
SENSORS = {"polar": POLAR, "points": CARTESIAN, "polar, off": POLAR_OFF, "points, off": CARTESIAN_OFF}
CLOSE = 0.005
"""Sigmas of the mean, and share of a covariance; largest seen: 0.0036, of a landmark, with all errors."""
CASES = [
    pytest.param(names, sensor, task, id=f"{what}, {kind}, {task}", marks=() if fast else pytest.mark.slow)
    for what, names in WHAT.items()
    for kind, sensor in SENSORS.items()
    for task in ("slam", "localization")
    for fast in [(what, kind, task) == ("drift", "points, off", "localization")]
]


@pytest.mark.parametrize(("names", "sensor", "task"), CASES)
def test_newest_pose_errors_and_map_are_those_of_dense_least_squares(names, sensor, task):
    """With small noise where bearings are carried from the sensor to the robot, to first order in it."""
    inputs, path, xy = erring(to_estimate(*names), sensor, frames=24, noise=0.05 if sensor is POLAR_OFF else 0.3)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    start = true_map(inputs, created, xy) if task == "slam" else inputs.map.xy
    number = np.where(created >= 0, created, decisions)
    oracle = solve(inputs, number, path, start)
    s, *_ = drive(inputs, decisions, smoother=calibrated(inputs, threshold=1e-6, skip=1))
    s.refine()
    s.refine()
    pose, covariance = s.estimate()
    b, B = s.errors
    assert in_sigmas(se2.pose_error(pose, oracle.pose), oracle.pose_covariance).max() < CLOSE
    assert in_sigmas(b - oracle.errors, oracle.errors_covariance).max() < CLOSE
    for mine, theirs in ((covariance, oracle.pose_covariance), (B, oracle.errors_covariance)):
        scale = np.sqrt(np.diag(theirs))
        np.testing.assert_allclose(mine / np.outer(scale, scale), theirs / np.outer(scale, scale), atol=CLOSE)
    if task == "slam":
        state = s.landmarks()
        for xy, C, theirs, D in zip(state.xy, state.covariance, oracle.xy, oracle.xy_covariance, strict=True):
            assert in_sigmas(xy - theirs, D).max() < CLOSE
            np.testing.assert_allclose(C / np.trace(D), D / np.trace(D), atol=CLOSE)


@pytest.mark.parametrize("task", ["slam", pytest.param("localization", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "sensor", [POLAR, pytest.param(CARTESIAN_OFF, marks=pytest.mark.slow)], ids=["polar", "points"]
)
def test_finish_is_the_batch_solution_and_the_newest_frame_is_near_it_before(sensor, task):
    inputs, path, xy = erring(to_estimate(*ALL), sensor, noise=1.0)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    batch = smooth(inputs, decisions, created, Start(path, true_map(inputs, created, xy)))
    s, *_ = drive(inputs, decisions, smoother=calibrated(inputs, threshold=1e-6, skip=1))
    for _ in range(3):
        s.refine()
    sigma = np.sqrt(np.diag(batch.trajectory.covariance[-1]))
    assert (np.abs(se2.pose_error(s.estimate().mean, batch.trajectory.pose[-1])) < 0.05 * sigma).all()
    assert (np.abs(s.errors[0] - batch.systematic.mean[-1]) < 0.1 * batch.systematic.sigma[-1]).all()
    finished = s.finish()
    np.testing.assert_allclose(finished.final.pose, batch.trajectory.pose, atol=1e-5)
    np.testing.assert_allclose(finished.final.covariance, batch.trajectory.covariance, atol=1e-6)
    np.testing.assert_allclose(finished.systematic.mean, batch.systematic.mean, atol=1e-5)
    np.testing.assert_allclose(finished.systematic.sigma, batch.systematic.sigma, atol=1e-6)
    assert finished.total_nis == pytest.approx(batch.total_nis, rel=1e-6)


def test_prediction_carries_pose_and_errors_together():
    """Without any observation: what the errors add is their Jacobian, by central differences of the whole way."""
    inputs, *_ = erring(to_estimate(*ODOMETRY, "bearing"), POLAR_OFF, frames=30)
    nothing = np.full(len(inputs.observations.frame), DISCARD)
    s, poses, covariances, _ = drive(inputs, nothing, smoother=calibrated(inputs))
    sigma = inputs.systematic.sigma

    def end(b):
        odometry = np.tile(b * (np.arange(5) < 4), (30, 1))
        i, pose = inputs.increments, inputs.prior.mean
        for moved in corrected_all(i.mean, i.covariance, odometry, places(inputs.systematic), np.zeros(3)).mean[1:]:
            pose = se2.compose(pose, moved)
        return pose

    J = np.array([(end(d) - end(-d)) / 2e-5 for d in 1e-5 * np.eye(5)]).T
    _, plain, without, _ = drive(replace(inputs, systematic=None), nothing)
    np.testing.assert_allclose(poses, plain, atol=1e-9)
    np.testing.assert_allclose(covariances[-1], without[-1] + J @ np.diag(sigma**2) @ J.T, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(s.errors[1], np.diag(sigma**2), atol=1e-12)
    assert Isam2Smoother(inputs.prior, inputs.sensor).errors is None


@pytest.mark.parametrize(
    ("names", "task"), [pytest.param(ALL, "slam", marks=pytest.mark.slow), (("scale", "drift"), "localization")]
)
def test_with_an_infinite_lag_the_fixed_lag_smoother_is_isam2_and_with_a_short_one_near_it(names, task):
    inputs, *_ = erring(to_estimate(*names), POLAR)
    inputs = for_task(inputs, task)
    decisions, _ = known_decisions(inputs)
    _, poses, covariances, _ = drive(inputs, decisions, smoother=calibrated(inputs))
    given = (inputs.prior, inputs.sensor, inputs.map)
    endless = FixedLagSmoother(*given, lag=np.inf, systematic=inputs.systematic)
    np.testing.assert_array_equal(drive(inputs, decisions, smoother=endless)[1], poses)
    short = FixedLagSmoother(*given, lag=8.0, systematic=inputs.systematic)
    _, near, *_ = drive(inputs, decisions, smoother=short)
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    assert (np.abs(se2.pose_error(near, poses)) < 1.0 * sigma).all()
    finished = short.finish()
    assert len(finished.final.pose) == len(finished.systematic.mean) == len(inputs)
    np.testing.assert_allclose(finished.systematic.mean[-1], short.errors[0])
    np.testing.assert_allclose(finished.systematic.sigma[-1], np.sqrt(np.diag(short.errors[1])), rtol=1e-6)
    np.testing.assert_allclose(finished.final.pose[-1], short.estimate().mean)
    np.testing.assert_allclose(finished.final.covariance[-1], short.estimate().covariance, atol=1e-9)


@pytest.mark.parametrize("sensor", [POLAR, POLAR_OFF], ids=["polar", "polar, off"])
def test_in_a_known_map_that_is_expected_which_is_in_view_whatever_the_range_error_scales(sensor):
    """There all is scaled by the range error: the robot is looked for in the world, and so far around it."""
    inputs, *_ = erring(to_estimate("curvature", "range", "bearing"), sensor, frames=24, noise=0.0)
    decisions, _ = known_decisions(inputs)
    rng = np.random.default_rng(3)
    everywhere = np.vstack([inputs.map.xy, rng.uniform(-40.0, 40.0, (400, 2))])
    inputs = replace(inputs, map=LandmarkMap(np.arange(len(everywhere)), everywhere))
    s, *_ = drive(inputs, decisions, smoother=calibrated(inputs))
    share = 1.0 + s.errors[0][1]
    assert share > 1.03
    at = sensor.inverse(s.estimate().mean, np.zeros((1, 2)))[0][0]  # what is at range zero: the sensor's own place
    place, radius = s._end.reach(8.0)
    np.testing.assert_allclose(place, at, atol=1e-9)
    assert radius == pytest.approx(8.0 / share)
    e = s.expect(inputs.frame_observations(len(inputs) - 1))
    expected = set(e.number.tolist())
    # the sensor reads up to 8 m, which is less in the world; its uncertainty lets it expect a little more
    away = np.hypot(*(everywhere - at).T)
    assert set(np.flatnonzero(away < 8.0 / share).tolist()) <= expected
    assert away[sorted(expected)].max() < 8.0 / share + 1.0
    assert 5 < len(expected) < 60
    # and each is expected as the sensor, with its errors, would read it
    told = dict(zip(inputs.systematic.names, s.errors[0], strict=True))
    read = read_wrongly(sensor, sensor.predict(s.estimate().mean, everywhere[e.number]), told, told)
    np.testing.assert_allclose(sensor.residual(e.z_hat, read), 0.0, atol=1e-9)


def test_landmarks_go_and_are_joined_and_a_motion_is_doubted_with_errors_as_without():
    inputs, *_ = erring(to_estimate(*ALL), POLAR)
    inputs = inputs.without_map()
    decisions, _ = known_decisions(inputs)
    s, *_ = drive(inputs, decisions, smoother=calibrated(inputs))
    s.remove(np.array([2]))
    s.merge(np.array([4]), np.array([0]))
    assert s.numbers.tolist() == s.landmarks().number.tolist() == [0, 1, 3, 5, 6, 7]
    np.testing.assert_allclose(s.positions(s.numbers), s.landmarks().xy)
    before = s.estimate().covariance
    s.predict(Increment(np.zeros(3), 1e-6 * np.eye(3)))
    s.inflate(np.eye(3))
    added = s.estimate().covariance - before
    np.testing.assert_allclose(np.diag(added)[2], 1.0, rtol=1e-4)
    assert added[0, 0] > 0.9
    elsewhere = s.estimate().mean + [0.3, -0.2, 0.1]
    e = s.expect(inputs.frame_observations(len(inputs) - 1))
    there = e.elsewhere(s.estimate().mean)
    np.testing.assert_allclose(there.z_hat, e.z_hat, atol=1e-9)
    done = s.update(inputs.frame_observations(len(inputs) - 1), np.full(len(e.z), DISCARD), at=elsewhere)
    assert not done.used.any()
