"""The EKF over key poses: least squares where all is linear, and its gate."""

from __future__ import annotations

import numpy as np
import pytest

from data.inputs import Prior
from data.se2 import pose_error
from ekf.pose_chain import PoseChainFilter, run_pose_chain
from graph.poses.batch import smooth_poses
from tests.graph.poses.worlds import corridors


def without_turns(seed, keys=30, loops=12):
    """Headings are all zero and known: motion (K, 3), covariances, loops; and the dense least-squares answer.

    The answer: positions (K, 2), their covariances (K, 2, 2) and the least sum of squares.
    """
    rng = np.random.default_rng(seed)
    root = rng.normal(0, 0.1, (keys + loops, 2, 2))
    C = np.tile(np.diag([0.0, 0.0, 1e-12]), (keys + loops, 1, 1))
    C[:, :2, :2] = root @ root.transpose(0, 2, 1) + 1e-3 * np.eye(2)
    key1 = rng.integers(0, keys - 5, loops)
    key2 = np.array([rng.integers(a + 1, keys) for a in key1])
    truth = np.cumsum(rng.normal(0, 0.3, (keys, 2)), 0)
    a, b = np.concatenate([np.arange(keys - 1), key1]), np.concatenate([np.arange(1, keys), key2])
    z = truth[b] - truth[a] + np.einsum("nij,nj->ni", np.linalg.cholesky(C[1:, :2, :2]), rng.normal(0, 1, (len(a), 2)))
    prior = Prior(np.array([1.0, -2.0, 0.0]), np.diag([0.04, 0.09, 1e-12]))
    H, y = np.zeros((len(a) + 1, 2, keys, 2)), np.concatenate([prior.mean[None, :2], z])
    H[0, :, 0] = np.eye(2)
    for e in range(len(a)):
        H[e + 1, :, a[e]], H[e + 1, :, b[e]] = -np.eye(2), np.eye(2)
    white = np.linalg.inv(np.linalg.cholesky(np.concatenate([prior.covariance[None, :2, :2], C[1:, :2, :2]])))
    A = np.einsum("nij,njkl->nikl", white, H).reshape(-1, 2 * keys)
    rhs = np.einsum("nij,nj->ni", white, y).ravel()
    x = np.linalg.lstsq(A, rhs, rcond=None)[0]
    P = np.linalg.inv(A.T @ A)
    own = np.array([P[i : i + 2, i : i + 2] for i in range(0, 2 * keys, 2)])
    relative = np.concatenate([z, np.zeros((len(z), 1))], axis=1)
    motion = np.concatenate([np.zeros((1, 3)), relative[: keys - 1]])
    given = (prior, motion, C[:keys], key1, key2, relative[keys - 1 :], C[keys:])
    return given, (x.reshape(-1, 2), own, float(((A @ x - rhs) ** 2).sum()))


@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_turns_the_filter_is_least_squares_over_everything(seed):
    given, (xy, P, square) = without_turns(seed)
    run = run_pose_chain(*given, given[4])
    np.testing.assert_allclose(run.pose[:, :2], xy, atol=1e-9)
    np.testing.assert_allclose(run.covariance[:, :2, :2], P, atol=1e-9)
    np.testing.assert_allclose(run.online[-1], run.pose[-1], atol=1e-15)
    np.testing.assert_allclose(run.online_covariance[-1], run.covariance[-1], atol=1e-15)
    assert run.nis.sum() == pytest.approx(square, abs=1e-6)
    assert run.dof.sum() == 3 * 12
    assert run.used.all()


def test_room_that_grows_and_loops_one_after_the_other_change_nothing_where_all_is_linear():
    given, (xy, _, _) = without_turns(4)
    prior, motion, covariance, key1, key2, relative, C = given
    small = PoseChainFilter(prior, 1)
    for k in range(30):
        if k:
            small.augment(motion[k], covariance[k])
        for i in np.flatnonzero(key2 == k):
            small.close(key1[i : i + 1], key2[i : i + 1], relative[i : i + 1], C[i : i + 1])
    np.testing.assert_allclose(small.poses()[:, :2], xy, atol=1e-9)


def test_with_turns_it_ends_within_half_a_sigma_of_the_batch_optimum():
    world = corridors(1, 120, loops=50, blocks=2)
    run = run_pose_chain(world.prior(), *world[1:], world.key2)
    best = smooth_poses(world.problem(), run.pose)
    sigma = np.sqrt(np.diagonal(best.covariance[1:], axis1=1, axis2=2))
    assert np.abs(pose_error(run.pose[1:], best.pose[1:]) / sigma).max() < 0.5
    assert run.nis.sum() == pytest.approx(best.cost, rel=0.1)
    assert np.linalg.eigvalsh(run.covariance[1:]).min() > 0.0


def test_the_gate_rejects_a_false_loop_closure_and_one_that_never_joined_is_never_looked_at():
    world = corridors(1, 120, loops=50, blocks=2)
    wrong = world.with_loops(np.array([0, 5]), np.array([119, 100]), np.zeros((2, 3)))
    joined = np.append(world.key2, [119, -1])
    run = run_pose_chain(wrong.prior(), *wrong[1:], joined, threshold=16.27)
    assert run.used.tolist() == [*(run.d2[:50] < 16.27), False, False]
    assert run.used[:50].mean() > 0.9
    assert run.d2[50] > 1e3
    assert np.isnan(run.d2[51])
    open_gate = run_pose_chain(wrong.prior(), *wrong[1:], joined)
    assert world.rmse(open_gate.pose) > 5.0 * world.rmse(run.pose)


def test_a_loop_closure_waits_for_the_key_pose_at_which_it_joins():
    world = corridors(1, 120, loops=50, blocks=2)
    late = run_pose_chain(world.prior(), *world[1:], np.full(50, 119))
    never = run_pose_chain(world.prior(), *world[1:], np.full(50, -1))
    np.testing.assert_array_equal(late.online[:119], never.online[:119])
    assert world.rmse(late.pose) < world.rmse(never.pose)
    assert (late.dof[:119] == 0).all()
    assert late.dof[119] == 150


def test_innovations_without_a_positive_definite_covariance_stop_the_filter_where_they_come():
    world = corridors(1, 120, loops=50, blocks=2)
    C = world.loop_covariance.copy()
    C[20] = -np.eye(3)
    run = run_pose_chain(world.prior(), *world[1:6], C, world.key2)
    assert run.failure is not None
    assert run.failure.frame == world.key2[20]
    assert np.isnan(run.online[run.failure.frame :]).all()
    assert np.isfinite(run.online[: run.failure.frame]).all()
