"""Filters that estimate what odometry and sensor do wrong in system, along with pose and map."""

import numpy as np
import pytest
from scipy.stats import chi2

from data import se2
from data.inputs import FrameObservations, Increment, LandmarkMap, Prior, Systematic
from data.motion.systematic import BETWEEN_KNOTS, corrected, places, sensor_frame
from data.result import NEW
from data.sensors import RangeBearing
from ekf.filter import DEFAULT
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from tests.quick import slow

MOUNTED = RangeBearing(max_range=15.0, rotation=0.3, translation=(0.2, -0.1))
PRIOR = Prior(np.array([1.0, 2.0, 0.7]), np.diag([0.1, 0.2, 0.005]) ** 2)
"""Of a heading known so well that EKF-SLAM is consistent: with 0.05 rad it is not, systematic errors or none."""
R = np.diag([0.1**2, 0.02**2])
M = np.diag([0.02, 0.01, 0.004]) ** 2
STEP = np.array([0.8, -0.1, 0.2])
ODOMETRY = Systematic(("scale", "curvature", "left", "right", "drift"), np.array([0.02, 2e-3, 0.05, 0.05, 1e-3]), 5.0)
ALL = Systematic((*ODOMETRY.names, "range", "bearing"), np.append(ODOMETRY.sigma, [0.03, 0.02]), 5.0)


def seen(*z):
    return FrameObservations(np.array(z, float), np.tile(R, (len(z), 1, 1)))


@pytest.mark.parametrize("of", [ODOMETRY, ALL], ids=["odometry", "all"])
def test_the_motion_is_linearized_where_pose_and_errors_stand(of):
    f, p = EkfSlam(PRIOR, MOUNTED, systematic=of), len(of.names)
    f.update(seen([4.0, 0.3]), np.array([NEW]))
    f._mean[3 : 3 + p] = np.linspace(-0.02, 0.03, p)
    d, frame = 5 + p, sensor_frame(of, MOUNTED, PRIOR)
    before, P = f.mean, f.covariance

    def moved(x):
        """The whole state one step later: pose, errors, landmark; no knot is reached."""
        y = x.copy()
        y[:3] = se2.compose(x[:3], corrected(Increment(STEP, M), x[3 : 3 + p], places(of), frame.mount).mean)
        return y

    J = np.stack([(moved(before + e) - moved(before - e)) / 2e-6 for e in 1e-6 * np.eye(d)], 1)
    B = np.zeros((d, 3))
    B[:3] = se2.world_from_body(before[2])
    noise = corrected(Increment(STEP, M), before[3 : 3 + p], places(of), frame.mount).covariance
    f.predict(Increment(STEP, M))
    np.testing.assert_allclose(f.mean, moved(before), atol=1e-12)
    np.testing.assert_allclose(f.covariance, J @ P @ J.T + B @ noise @ B.T, atol=1e-9)
    np.testing.assert_array_equal(f.covariance, f.covariance.T)


def test_the_drift_is_forgotten_from_knot_to_knot_and_nothing_else_is():
    f = EkfSlam(PRIOR, MOUNTED, systematic=ODOMETRY)
    f._mean[3:8] = 0.01, 0.001, 0.02, -0.02, 0.002
    mean, variance = [], []
    for _ in range(4):  # a knot is due every metre: before the third and no other
        f.predict(Increment(np.array([0.6, 0.0, 0.0]), M))
        mean.append(f.errors[0]), variance.append(np.diag(f.errors[1]))
    assert BETWEEN_KNOTS * ODOMETRY.length == 1.0
    stays = np.exp(-1.2 / ODOMETRY.length)
    assert np.array(mean)[:, 4] == pytest.approx(0.002 * np.array([1.0, 1.0, stays, stays]))
    assert np.array(mean)[:, :4] == pytest.approx(np.tile([0.01, 0.001, 0.02, -0.02], (4, 1)))
    assert np.array(variance) == pytest.approx(np.tile(ODOMETRY.sigma**2, (4, 1)))  # stationary


def drive(f, xy, seed, of=None, errors=None, frames=60, number=None):
    """Drive a filter through a world with labels, its odometry and sensor wrong by `errors`; NEES of the pose."""
    rng = np.random.default_rng(seed)
    pose, nees = rng.multivariate_normal(PRIOR.mean, PRIOR.covariance), []
    number = {} if number is None else dict(number)
    world = RangeBearing(max_range=15.0, rotation=0.3, translation=(0.2, -0.1))
    named = {} if of is None else dict(zip(of.names, errors, strict=True))
    for k in range(frames):
        step = np.array([0.5, 0.0, 0.05 if (k // 45) % 2 else -0.06])
        pose = se2.compose(pose, step)
        f.predict(Increment(measured(step, of, errors) + rng.multivariate_normal(np.zeros(3), M), M))
        z = world.predict(pose, xy)
        here = np.flatnonzero((z[:, 0] < 15.0) & (rng.random(len(xy)) < 0.3))
        z = z[here] * [1.0 + named.get("range", 0.0), 1.0] + [0.0, named.get("bearing", 0.0)]
        z += rng.multivariate_normal(np.zeros(2), R, len(here))
        z[:, 1] = se2.wrap_angle(z[:, 1])
        done = f.update(
            FrameObservations(z, np.tile(R, (len(here), 1, 1))), np.array([number.get(i, NEW) for i in here])
        )
        number.update({i: n for i, n in zip(here.tolist(), done.created.tolist()) if n >= 0})
        mean, P = f.estimate()
        e = se2.pose_error(mean, pose)
        nees.append(e @ np.linalg.solve(P, e))
    return np.array(nees), number


def measured(step, of, errors):
    """What odometry says where the robot moved by `step`: the increment that is corrected to it."""
    if of is None:
        return step
    odometry = [i for i, n in enumerate(of.names) if n not in ("range", "bearing")]
    u = step.copy()
    for _ in range(20):
        u = u + step - corrected(Increment(u, M), errors[odometry], places(of)[odometry], np.zeros(3)).mean
    return u


def drawn(of, seed):
    """Errors as the priors have them; the drift none (it is tested by itself)."""
    errors = np.random.default_rng([seed, 7]).normal(size=len(of.names)) * of.sigma
    return np.where(np.array(of.names) == "drift", 0.0, errors)


def known(xy):
    return LandmarkMap(np.arange(len(xy)), xy)


def filters(xy, of, options=DEFAULT):
    return {
        "slam": (EkfSlam(PRIOR, MOUNTED, options, systematic=of), None),
        "localization": (
            EkfLocalizer(PRIOR, MOUNTED, known(xy), options, systematic=of),
            {i: i for i in range(len(xy))},
        ),
    }


CONSTANT = Systematic(tuple(n for n in ALL.names if n != "drift"), ALL.sigma[[0, 1, 2, 3, 5, 6]])


def of_runs(task, seeds, frames, of=CONSTANT):
    """Mean NEES of the pose at the end, that of the errors, and the latter of a plain filter."""
    pose, errors, plain = [], [], []
    for seed in seeds:
        xy, b = np.random.default_rng(seed).uniform(-25.0, 25.0, (60, 2)), drawn(of, seed)
        f, number = filters(xy, of)[task]
        pose.append(drive(f, xy, seed, of, b, frames, number)[0][-1])
        mean, P = f.errors
        errors.append((mean - b) @ np.linalg.solve(P, mean - b))
        f, number = filters(xy, None)[task]
        plain.append(drive(f, xy, seed, of, b, frames, number)[0][-1])
    return np.array(pose), np.array(errors), np.array(plain)


@pytest.mark.parametrize(
    ("task", "runs"), [("slam", 4), slow("localization", 4), slow("slam", 50), slow("localization", 50)]
)
def test_errors_are_found_and_the_pose_is_as_good_as_it_says(task, runs):
    """Sums of chi-square with 3 and 6 degrees of freedom a run, within 99.9 %."""
    pose, errors, plain = of_runs(task, range(runs), 120)
    for found, dof in ((pose, 3), (errors, 6)):
        low, high = chi2.ppf([0.0005, 0.9995], dof * runs)
        assert low < found.sum() < high
    assert plain.sum() > 3.0 * pose.sum()
