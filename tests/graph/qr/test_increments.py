"""Increments under systematic errors: the inverse of the correction, gtsam's cost, Jacobians by differences."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X

from data.motion.systematic import BEARING, corrected_all, stated
from data.se2 import between, pose_error
from graph.factors import between_factors, pose2, root_information
from graph.systematic import linearize_increments

N = 12
NONE = np.zeros(3)
MOUNT = np.array([0.5, 0.3, 0.7])
H = 1e-6


def world(mount):
    """(poses, motion, its covariances, errors, their places): residuals of a tenth of a metre and a radian."""
    rng = np.random.default_rng(0)
    place = np.arange(7) if mount.any() else np.arange(5)
    pose = np.cumsum(rng.normal(size=(N + 1, 3)), axis=0)
    motion = between(pose[:-1], pose[1:]) + rng.normal(0.0, 0.1, (N, 3))
    L = rng.normal(0.0, 0.1, (N, 3, 3))
    return pose, motion, L @ L.transpose(0, 2, 1) + 1e-3 * np.eye(3), rng.normal(0.0, 0.1, (N, len(place))), place


def linearized(pose, motion, covariance, errors, place, mount):
    return linearize_increments(pose, motion, root_information(covariance)[0], errors, place, mount)


def test_without_errors_the_cost_is_that_of_gtsams_factors():
    pose, motion, covariance, errors, place = world(NONE)
    values = gtsam.Values()
    for k, row in enumerate(pose):
        values.insert(X(k), pose2(row))
    cost = [2.0 * f.error(values) for f in between_factors(1, motion, covariance)[0]]
    r, *_ = linearized(pose, motion, covariance, 0.0 * errors, place, NONE)
    np.testing.assert_allclose(np.sum(r**2, axis=1), cost, rtol=1e-10)


@pytest.mark.parametrize("mount", [NONE, MOUNT], ids=["robot", "sensor"])
def test_what_would_be_stated_of_a_corrected_increment_is_the_increment(mount):
    _, motion, covariance, errors, place = world(mount)
    there = corrected_all(motion, covariance, errors, place, mount)
    m = np.empty(3)
    for k in range(N):
        every = np.zeros(7)
        every[place] = errors[k]
        stated(there.mean[k], every, mount, motion[k, 2] > 0.0, m, np.empty((3, 3)), np.empty((3, 7)))
        assert np.abs(pose_error(m, motion[k])).max() < 1e-12


@pytest.mark.parametrize("mount", [NONE, MOUNT], ids=["robot", "sensor"])
def test_jacobians_are_those_of_central_differences(mount):
    pose, motion, covariance, errors, place = world(mount)
    _, before, after, by_errors = linearized(pose, motion, covariance, errors, place, mount)

    def residual(pose, errors):
        return linearized(pose, motion, covariance, errors, place, mount)[0]

    for j in range(len(place)):
        e = H * (np.arange(len(place)) == j)
        found = (residual(pose, errors + e) - residual(pose, errors - e)) / (2 * H)
        np.testing.assert_allclose(by_errors[:, :, j], found, atol=1e-7 * np.abs(found).max())
    for j in range(3):

        def moved(k, d, j=j):
            there = pose.copy()
            p = pose2(pose[k]).retract(d * np.eye(3)[j])
            there[k] = p.x(), p.y(), p.theta()
            return residual(there, errors)

        for k in range(N):
            for jacobian, which in ((before, k), (after, k + 1)):
                found = ((moved(which, H) - moved(which, -H)) / (2 * H))[k]
                np.testing.assert_allclose(jacobian[k, :, j], found, atol=1e-7 * np.abs(jacobian[k]).max())


def test_an_increment_that_fits_exactly_has_finite_jacobians():
    pose, motion, covariance, errors, place = world(MOUNT)
    errors[:] = 0.0
    motion = between(pose[:-1], pose[1:])
    r, *jacobians = linearized(pose, motion, covariance, errors[:, :BEARING], place[:BEARING], NONE)
    assert np.abs(r).max() < 1e-11
    assert all(np.isfinite(J).all() for J in jacobians)
