"""The filter's prediction against gtsam's invariant EKF, which lives in the tangent space of the pose."""

from __future__ import annotations

import gtsam
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf import kernels


def body_to_world(heading):
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), heading=st.floats(-np.pi, np.pi), turn=st.floats(-3.0, 3.0))
def test_predictions_equal_the_invariant_filters(seed, heading, turn):
    """World-frame and body-frame covariances are turned into each other; an increment's noise sits at its end there."""
    rng = np.random.default_rng(seed)
    A, C = rng.normal(size=(2, 3, 3))
    P, M = 0.01 * A @ A.T, 0.001 * C @ C.T
    mean = np.array([*rng.normal(0.0, 5.0, 2), heading])
    B = body_to_world(heading)
    other = gtsam.InvariantEKFPose2(gtsam.Pose2(*mean), B.T @ P @ B)
    for motion in (np.array([*rng.normal(size=2), turn]), np.array([*rng.normal(size=2), 0.1])):
        kernels.predict(mean, P, 3, motion, M, kernels.NEWEST)
        E = body_to_world(motion[2])
        other.predict(gtsam.Pose2(*motion), E.T @ M @ E)
    B = body_to_world(mean[2])
    np.testing.assert_allclose(P, B @ other.covariance() @ B.T, atol=1e-13 * max(1.0, np.abs(P).max()))
    pose = other.state()
    np.testing.assert_allclose(mean[:2], [pose.x(), pose.y()], atol=1e-12)
    assert np.cos(mean[2] - pose.theta()) > 1.0 - 1e-14
