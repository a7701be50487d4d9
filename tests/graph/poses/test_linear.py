"""A pose graph linearized: the errors are gtsam's, the rows their derivatives."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from data.errors import DataError
from data.inputs import Prior
from graph.poses.batch import _linearize, pose_problem
from tests.graph.poses.worlds import corridors


def scattered(seed=0, keys=40):
    """A problem with full covariances, and poses that are far from fitting it, headings all around."""
    rng = np.random.default_rng(seed)
    world = corridors(seed, keys, loops=20, blocks=1)
    root = rng.normal(0, 0.1, (keys + len(world.key1), 3, 3))
    C = root @ root.transpose(0, 2, 1) + 1e-4 * np.eye(3)
    problem = pose_problem(world.prior(), world.motion, C[:keys], *world[3:6], C[keys:])
    pose = world.truth + rng.normal(0, 0.7, world.truth.shape)
    pose[:, 2] = rng.uniform(-np.pi, np.pi, keys)
    return problem, pose, np.concatenate([C[1:keys], C[keys:]])


def test_the_error_of_a_relative_pose_is_that_of_gtsams_factor_for_a_covariance_turned_to_the_end():
    problem, pose, covariance = scattered()
    residual = problem.residuals(pose)
    for e in range(len(residual)):
        a, b, m = pose[problem.key1[e]], pose[problem.key2[e]], problem.relative[e]
        turn = np.eye(3)
        turn[:2, :2] = gtsam.Rot2(m[2]).matrix()
        model = gtsam.noiseModel.Gaussian.Covariance(turn.T @ covariance[e] @ turn)
        factor = gtsam.BetweenFactorPose2(0, 1, gtsam.Pose2(*m), model)
        values = gtsam.Values()
        values.insert(0, gtsam.Pose2(*a))
        values.insert(1, gtsam.Pose2(*b))
        assert 0.5 * residual[e] @ residual[e] == pytest.approx(factor.error(values), rel=1e-9)


def test_rows_are_the_derivatives_of_the_residuals():
    problem, pose, _ = scattered(1)
    A, rhs = _linearize(pose, problem.key1, problem.key2, problem.relative, problem.root)
    np.testing.assert_allclose(rhs[:, :, 0], -problem.residuals(pose), atol=1e-12)
    for first, keys in ((0, problem.key2), (3, problem.key1)):
        for e in range(len(keys)):
            for i in range(3):
                step = np.zeros_like(pose)
                step[keys[e], i] = 1e-6
                change = (problem.residuals(pose + step)[e] - problem.residuals(pose - step)[e]) / 2e-6
                np.testing.assert_allclose(A[e, :, first + i], change, rtol=1e-4, atol=1e-4)


def test_a_singular_covariance_and_a_loop_to_nowhere_are_refused():
    world = corridors(0, 60, loops=5, blocks=1)
    with pytest.raises(ValueError, match=r"between key poses 0 ... 59"):
        world._replace(key2=world.key2 + 60).problem()
    singular = world.loop_covariance.copy()
    singular[2, 2, 2] = 0.0
    with pytest.raises(DataError, match=r"loop closure, number 2: its covariance is singular"):
        world._replace(loop_covariance=singular).problem()
    flat = world.covariance.copy()
    flat[4] = 0.0
    with pytest.raises(DataError, match="motion between key poses, number 3"):
        pose_problem(Prior(world.truth[0], np.zeros((3, 3))), world.motion, flat, *world[3:])
