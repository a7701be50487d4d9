"""iSAM2 and fixed lag estimate systematic errors of odometry and sensor, also where pairings or landmarks change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data import se2
from data.inputs import FrameObservations, Increment, LandmarkMap
from data.result import DISCARD
from ekf.slam import EkfSlam
from graph.batch import smooth
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from tests.graph.calibrating import as_sensed, erring
from tests.graph.calibration.worlds import ALL, CARTESIAN, CARTESIAN_OFF, ODOMETRY, POLAR, POLAR_OFF, to_estimate
from tests.graph.driving import TIGHT, drive


def calibrated(inputs, **options):
    return Isam2Smoother(inputs.prior, inputs.sensor, inputs.map, systematic=inputs.systematic, **options)


@pytest.mark.parametrize("task", ["slam", pytest.param("localization", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "sensor", [CARTESIAN, *(pytest.param(s, marks=pytest.mark.slow) for s in (POLAR, CARTESIAN_OFF))]
)
def test_finish_is_the_batch_solution_and_the_newest_frame_is_near_it_before(sensor, task):
    inputs, *plan, _ = erring(sensor, task, to_estimate(*ALL), frames=40, noise=0.1, size=0.1)
    decisions, batch = plan[0], smooth(inputs, *plan)
    s, *_ = drive(inputs, decisions, smoother=calibrated(inputs, threshold=1e-6, skip=1))
    for _ in range(3):
        s.refine()
    (pose, covariance), (errors, of_errors) = s.estimate(), s.errors
    sigma, of = np.sqrt(np.diag(batch.trajectory.covariance[-1])), batch.systematic.sigma[-1]
    assert (np.abs(se2.pose_error(pose, batch.trajectory.pose[-1])) < 0.01 * sigma).all()
    assert (np.abs(errors - batch.systematic.mean[-1]) < 0.01 * of).all()
    np.testing.assert_allclose((covariance - batch.trajectory.covariance[-1]) / np.outer(sigma, sigma), 0.0, atol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(of_errors)), of, rtol=0.01)
    finished = s.finish()
    np.testing.assert_allclose(finished.final.pose, batch.trajectory.pose, atol=1e-5)
    np.testing.assert_allclose(finished.final.covariance, batch.trajectory.covariance, atol=1e-6)
    np.testing.assert_allclose(finished.systematic.mean, batch.systematic.mean, atol=1e-5)
    np.testing.assert_allclose(finished.systematic.sigma, batch.systematic.sigma, atol=1e-6)
    assert finished.total_nis == pytest.approx(batch.total_nis, rel=1e-6)


@pytest.mark.parametrize(
    ("names", "task"), [pytest.param(ALL, "slam", marks=pytest.mark.slow), (("scale", "drift"), "localization")]
)
def test_with_an_infinite_lag_the_fixed_lag_smoother_is_isam2_and_with_a_short_one_near_it(names, task):
    inputs, decisions, *_ = erring(POLAR, task, to_estimate(*names), frames=40)
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
    np.testing.assert_allclose(finished.systematic.mean[-1], short.errors[0], atol=1e-12)
    np.testing.assert_allclose(finished.systematic.sigma[-1], np.sqrt(np.diag(short.errors[1])), rtol=1e-6)
    np.testing.assert_allclose(finished.final.pose[-1], short.estimate().mean)
    np.testing.assert_allclose(finished.final.covariance[-1], short.estimate().covariance, atol=1e-9)


@pytest.mark.parametrize("sensor", [POLAR, POLAR_OFF], ids=["polar", "polar, off"])
def test_in_a_known_map_that_is_expected_which_is_in_view_whatever_the_range_error_scales(sensor):
    """There all is scaled by the range error: the robot is looked for in the world, and so far around it."""
    what = to_estimate("curvature", "range", "bearing")
    inputs, decisions, *_ = erring(sensor, "localization", what, frames=24, noise=0.0, size=-1.0)
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
    read = as_sensed(sensor, sensor.predict(s.estimate().mean, everywhere[e.number]), *s.errors[0][1:])
    np.testing.assert_allclose(sensor.residual(e.z_hat, read), 0.0, atol=1e-9)


def test_landmarks_go_and_are_joined_and_a_motion_is_doubted_with_errors_as_without():
    inputs, decisions, *_ = erring(POLAR, "slam", to_estimate(*ALL), frames=40)
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


def test_predictions_are_those_of_a_filter():
    """Not with errors of turns: a filter has them act on the turn of late."""
    systematic = to_estimate("scale", "curvature", "drift", "range", "bearing")
    inputs, *_ = erring(POLAR_OFF, "localization", systematic, frames=30)
    s = drive(inputs, np.full(len(inputs.observations.frame), DISCARD), smoother=calibrated(inputs))[0]
    theirs = EkfSlam(inputs.prior, inputs.sensor, systematic=systematic)
    for k in range(1, len(inputs)):
        theirs.predict(inputs.increment(k))
    for mine, other in zip((*s.estimate(), *s.errors), (*theirs.estimate(), *theirs.errors), strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-9)


@pytest.mark.parametrize("names", [ODOMETRY, pytest.param(ALL, marks=pytest.mark.slow)], ids=["odometry", "all"])
def test_pairings_amended_leave_what_they_would_have_been_from_the_start(names):
    inputs, decisions, *_ = erring(POLAR, "localization", to_estimate(*names), frames=24)
    right = drive(inputs, decisions, smoother=calibrated(inputs, **TIGHT))[0]
    right.refine()
    wrong, frame = decisions.copy(), inputs.observations.frame
    swapped = np.isin(frame, (20, 21))
    wrong[swapped] = (wrong[swapped] + 1) % 8
    s = drive(inputs, wrong, smoother=calibrated(inputs, **TIGHT))[0]
    sigma = np.sqrt(np.diag(right.errors[1]))
    assert (np.abs(s.errors[0] - right.errors[0]) > 0.5 * sigma).any()
    rows = np.flatnonzero(swapped)
    s.amend(frame[rows], FrameObservations(inputs.observations.z[rows], inputs.observations.R[rows]), decisions[rows])
    s.refine()
    assert (np.abs(s.errors[0] - right.errors[0]) < 0.01 * sigma).all()
    np.testing.assert_allclose(s.estimate().mean, right.estimate().mean, atol=1e-4)
    np.testing.assert_allclose(s.errors[1], right.errors[1], atol=0.01 * sigma.min() ** 2)


def test_an_update_may_start_at_any_pose_of_the_robot():
    """In the world, not in that of the graph: at its own pose nothing changes, and from elsewhere it comes back."""
    inputs, decisions, *_ = erring(POLAR_OFF, "localization", to_estimate(*ALL), frames=20)
    last = inputs.observations.frame == 19
    nis, found = [], []
    for off in (None, np.zeros(3), np.array([0.4, -0.3, 0.2])):
        s = drive(inputs, np.where(last, DISCARD, decisions), smoother=calibrated(inputs, **TIGHT))[0]
        at = None if off is None else s.estimate().mean + off
        nis.append(s.update(inputs.frame_observations(19), decisions[last], at=at, innovations=True).nis)
        s.refine()
        s.refine()
        found.append(np.concatenate([s.estimate().mean, s.errors[0]]))
    assert nis[1] == pytest.approx(nis[0], rel=1e-9)
    np.testing.assert_allclose(found[1:], [found[0]] * 2, atol=1e-6)
