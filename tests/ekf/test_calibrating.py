"""A filter that estimates what odometry does wrong in system, along with the map."""

import numpy as np
import pytest

from data import se2
from data.inputs import Increment, Prior, Sightings
from data.result import NEW
from data.sensors import RangeBearing
from ekf.calibrating import LENGTH, SIGMA, WALK, CalibratingSlam, systematic
from ekf.slam import EkfSlam

SENSOR = RangeBearing(max_range=15.0)
R = np.diag([0.1**2, 0.02**2])
M = np.diag([0.02, 0.01, 0.004]) ** 2
ERRORS = np.array([0.0, 0.003, 0.06, -0.02, 0.03])


def world(seed, frames=500):
    """True poses of a robot that drives figures of eight with wrong odometry, its increments, and landmarks."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-30.0, 30.0, (60, 2))
    measured, pose = [], [np.zeros(3)]
    for k in range(frames):
        step = np.array([0.5, 0.0, 0.05 if (k // 130) % 2 else -0.06])
        pose.append(se2.compose(pose[-1], step))
        wrong = step - systematic(step) @ ERRORS
        measured.append(wrong + rng.multivariate_normal(np.zeros(3), M))
    return np.array(pose), measured, xy, rng


def drive(f, seed):
    """Drive a filter through the world with labels; returns NEES of the pose per frame, and true poses."""
    pose, measured, xy, rng = world(seed)
    number, nees = {}, []
    for k, step in enumerate(measured, 1):
        f.predict(Increment(step, M))
        z = SENSOR.predict(np.tile(pose[k], (len(xy), 1)), xy)
        seen = np.flatnonzero((z[:, 0] < 15.0) & (rng.random(len(xy)) < 0.3))
        z = z[seen] + rng.multivariate_normal(np.zeros(2), R, len(seen))
        z[:, 1] = se2.wrap_angle(z[:, 1])
        done = f.update(Sightings(z, np.tile(R, (len(seen), 1, 1))), np.array([number.get(i, NEW) for i in seen]))
        number.update({i: n for i, n in zip(seen.tolist(), done.created.tolist()) if n >= 0})
        mean, P = f.estimate()
        e = se2.pose_error(mean, pose[k])
        nees.append(e @ np.linalg.solve(P, e))
    return np.array(nees), pose


def test_systematic_errors_are_found_and_the_pose_is_as_good_as_it_says():
    start = Prior(np.zeros(3), np.zeros((3, 3)))
    ours, plain = [], []
    for seed in range(4):
        f = CalibratingSlam(start, SENSOR)
        ours.append(drive(f, seed)[0])
        plain.append(drive(EkfSlam(start, SENSOR), seed)[0])
        mean, P = f.errors
        # the curvature that comes and goes cannot be told from the steady one on so short a way
        found = np.array([mean[0] + mean[1], *mean[2:]])
        T = np.zeros((4, 5))
        T[0, :2], T[1:, 2:] = 1.0, np.eye(3)
        off = found - [ERRORS[0] + ERRORS[1], *ERRORS[2:]]
        assert off @ np.linalg.solve(T @ P @ T.T, off) < 18.5  # chi-square, 4 dof, 99.9 %
        assert np.all(np.sqrt(np.diag(P))[2:] < 0.7 * SIGMA[2:])
    assert np.mean(ours) < 4.5
    assert np.mean(plain) > 3.0 * np.mean(ours)


def test_the_motion_with_errors_is_linearized_where_it_stands():
    f = CalibratingSlam(Prior(np.array([1.0, 2.0, 0.7]), np.diag([0.1, 0.2, 0.05]) ** 2), SENSOR)
    f.update(Sightings(np.array([[4.0, 0.3]]), R[None]), np.array([NEW]))
    f._mean[5:10] = 0.001, 0.002, 0.03, -0.02, 0.01
    before, P = f._mean[:10].copy(), f._P[:10, :10].copy()
    step = np.array([0.8, -0.1, 0.2])

    def moved(x):
        """The whole state one step later: pose, landmark, errors."""
        wrong = step + systematic(step) @ x[5:]
        y = x.copy()
        y[:3] = se2.compose(x[:3], wrong)
        y[5] *= np.exp(-np.hypot(*step[:2]) / LENGTH)
        return y

    J = np.stack([(moved(before + d) - moved(before - d)) / 2e-6 for d in 1e-6 * np.eye(10)], 1)
    B = np.zeros((10, 3))
    B[:3] = se2.world_from_body(before[2])
    way = np.hypot(*step[:2])
    fresh = way * WALK**2
    fresh[0] = SIGMA[0] ** 2 * (1.0 - np.exp(-2.0 * way / LENGTH))
    expected = J @ P @ J.T + B @ M @ B.T
    expected[range(5, 10), range(5, 10)] += fresh
    f.predict(Increment(step, M))
    np.testing.assert_allclose(f._mean[:10], moved(before), atol=1e-12)
    np.testing.assert_allclose(f._P[:10, :10], expected, atol=1e-8)


@pytest.mark.parametrize("step", [(0.8, 0.0, 0.0), (0.8, 0.05, 0.3), (0.8, -0.1, -0.4)])
def test_an_increments_errors_are_those_of_driving_it_in_small_pieces(step):
    """Uneven wheels turn a little with every metre of the way, a scale falsifies every piece alike."""
    step, n = np.array(step), 200
    piece = se2.compose(np.zeros(3), step)
    turn, way = piece[2] / n, np.hypot(*piece[:2])

    def driven(curvature, scale, length):
        pose, each = np.zeros(3), way / n
        for _ in range(n):
            pose = se2.compose(pose, np.array([each * length, 0.0, turn * scale + each * curvature]))
        return pose

    small = 1e-5
    exact = driven(0.0, 1.0, 1.0)
    A = systematic(exact)
    for column, error in (
        (1, (small, 1.0, 1.0)),
        (2 if turn > 0.0 else 3, (0.0, 1.0 + small, 1.0)),
        (4, (0.0, 1.0, 1.0 + small)),
    ):
        if column in (1, 4) or turn != 0.0:
            np.testing.assert_allclose(A[:, column], (driven(*error) - exact) / small, atol=0.03)


def test_backward_motion_turns_the_other_way():
    forth, back = systematic(np.array([1.0, 0.0, 0.0])), systematic(np.array([-1.0, 0.0, 0.0]))
    assert forth[2, 1] == 1.0
    assert back[2, 1] == -1.0


def test_landmarks_come_and_go_in_front_of_the_errors():
    f = CalibratingSlam(Prior(np.zeros(3), np.eye(3) * 0.01), SENSOR)
    f._mean[3:8] = 1.0, 2.0, 3.0, 4.0, 5.0
    z = np.array([[3.0, 0.1], [4.0, -0.4], [5.0, 0.9]])
    f.update(Sightings(z, np.tile(R, (3, 1, 1))), np.full(3, NEW))
    assert f.errors[0] == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0], abs=1e-9)
    f.remove(np.array([1]))
    assert f.errors[0] == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0], abs=1e-9)
    assert len(f.mean) == 7
    assert f.finish().map.number.tolist() == [0, 2]
