"""Two landmarks that are one: the filter's estimates of both become one estimate."""

import numpy as np

from data.inputs import FrameObservations, Increment, Prior
from data.result import NEW
from data.sensors import RangeBearing
from ekf.slam import JOINED, EkfSlam

SENSOR = RangeBearing(max_range=20.0)
R = np.diag([0.05, 0.01]) ** 2


def mapped():
    """A filter that initialized the first two of four landmarks again after a way with drift."""
    rng = np.random.default_rng(1)
    f = EkfSlam(Prior(np.zeros(3), np.diag([0.01, 0.01, 0.001]) ** 2), SENSOR)
    z = np.array([[5.0, 0.2], [6.0, -0.5], [7.0, 0.8], [4.0, 1.2]])
    f.update(FrameObservations(z, np.tile(R, (4, 1, 1))), np.full(4, NEW))
    for _ in range(10):
        f.predict(Increment(np.array([0.01, 0.0, 0.0]), np.diag([0.05, 0.05, 0.01]) ** 2))
    z = z[:2] + rng.normal(0.0, [0.05, 0.01], (2, 2))
    f.update(FrameObservations(z, np.tile(R, (2, 1, 1))), np.full(2, NEW))
    return f


def test_joining_is_conditioning_on_their_difference_being_zero():
    f = mapped()
    mean, P = f.mean, f.covariance
    H = np.zeros((4, len(mean)))
    H[:, 11:15], H[:, 3:7] = np.eye(4), -np.eye(4)
    information = np.linalg.inv(P) + H.T @ H / JOINED**2
    posterior = np.linalg.inv(information)
    expected = posterior @ np.linalg.solve(P, mean)
    f.merge(np.array([4, 5]), np.array([0, 1]))
    np.testing.assert_allclose(f.mean, expected[:11], atol=1e-6)
    np.testing.assert_allclose(f.covariance, posterior[:11, :11], atol=1e-8)
    assert np.linalg.eigvalsh(f.covariance)[0] > 0.0
    assert np.linalg.eigvalsh(P[:3, :3] - f.covariance[:3, :3])[0] > 0.0


def test_joined_landmarks_are_gone_and_numbers_are_not_used_again():
    f = mapped()
    f.merge(np.array([5]), np.array([1]))
    assert f.finish().map.number.tolist() == [0, 1, 2, 3, 4]
    again = f.update(FrameObservations(np.array([[9.0, 0.0]]), R[None]), np.array([NEW]))
    assert again.created.tolist() == [6]


def test_positions_are_those_of_the_landmarks_asked_for():
    f = mapped()
    mean, P = f.position(np.array([3, 1]))
    assert mean.tolist() == f.mean[[9, 10, 5, 6]].tolist()
    assert np.array_equal(P, f.covariance[np.ix_([9, 10, 5, 6], [9, 10, 5, 6])])
