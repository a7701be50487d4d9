"""Elimination and increments with errors: triangular factors and Jacobians against dense ones."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from hypothesis import given, settings, strategies as st

from data.motion.systematic import BEARING
from data.se2 import between
from graph.factors import between_factors, pose2, root_information
from graph.qr.elimination import SLACK, Rows, eliminate, marginals, means, ordering, structure
from graph.systematic import linearize_increments
from tests.quick import examples


def drive(rng, poses, landmarks, observations, sides=1):
    """A chain of poses with random rows, each landmark seen at least once; whitened, of very different weight."""
    variable = [[0, -1], *([k, k - 1] for k in range(1, poses))]
    count = [3] * poses
    for i in range(max(observations, 2 * landmarks) if landmarks else observations):
        variable.append([int(rng.integers(poses)), poses + i % landmarks if landmarks else -1])
        count.append(2)
    B = len(variable)
    A, b = rng.standard_normal((B, 3, 6)), rng.standard_normal((B, 3, sides))
    # increments: known very differently along three axes, the pose before carried over nearly as it is
    W = np.linalg.qr(A[1:poses, :, :3])[0] * 10.0 ** rng.uniform(0.0, 4.0, (poses - 1, 3, 1))
    A[1:poses] = np.concatenate([W, -W @ (np.eye(3) + 0.1 * A[1:poses, :, 3:])], axis=2)
    A[poses:, 2], b[poses:, 2], A[poses:, :, 5] = 0.0, 0.0, 0.0
    A[np.array(variable)[:, 1] < 0, :, 3:] = 0.0
    return Rows(np.array(variable), A, b, np.array(count), np.repeat([3, 2], [poses, landmarks]))


def dense(rows):
    """The same rows as a matrix (3B, columns) and right-hand sides; columns by variable."""
    at = np.concatenate([[0], np.cumsum(rows.dim)])
    A = np.zeros((len(rows.A), 3, at[-1]))
    for k, (u, v) in enumerate(rows.variable):
        A[k, :, at[u] : at[u + 1]] += rows.A[k, :, : rows.dim[u]]
        if v >= 0:
            A[k, :, at[v] : at[v + 1]] += rows.A[k, :, 3 : 3 + rows.dim[v]]
    return A.reshape(-1, at[-1]), rows.b.reshape(-1, rows.b.shape[2]), at


def solved(rows, order):
    s = structure(rows.variable, rows.dim, order)
    t = eliminate(rows, s)
    assert t.free == -1
    return means(rows, s, t), marginals(rows, s, t, np.empty((0, 2), np.int64))[0], t


@settings(max_examples=examples(60), deadline=None)
@given(
    st.integers(0, 2**31), st.integers(1, 30), st.integers(0, 8), st.integers(0, 60), st.booleans(), st.integers(1, 3)
)
def test_any_order_gives_the_dense_solution_and_covariance(seed, poses, landmarks, observations, shuffled, sides):
    rng = np.random.default_rng(seed)
    rows = drive(rng, poses, landmarks, observations, sides)
    size = poses + landmarks
    order = rng.permutation(size) if shuffled else ordering(rows.variable, poses, size)
    x, covariance, t = solved(rows, order)
    A, b, at = dense(rows)
    Q, R = np.linalg.qr(A)
    inverse = np.linalg.inv(R)
    expected, P = inverse @ (Q.T @ b), inverse @ inverse.T
    rest = b - A @ expected
    np.testing.assert_allclose(t.left, rest.T @ rest, rtol=1e-6, atol=1e-8)
    for v, d in enumerate(rows.dim):
        own = slice(at[v], at[v + 1])
        sigma = np.sqrt(np.diag(P)[own])
        np.testing.assert_allclose(
            covariance[v, :d, :d] / np.outer(sigma, sigma), P[own, own] / np.outer(sigma, sigma), atol=1e-6
        )
        np.testing.assert_allclose(x[v, :d] / sigma[:, None], expected[own] / sigma[:, None], atol=1e-5)
        assert not covariance[v, d:].any()
        assert not x[v, d:].any()


def test_a_variable_without_information_is_named():
    rows = drive(np.random.default_rng(1), 20, 5, 40)
    rows.A[20:][rows.variable[20:, 1] == 22, :, 3:] = 0.0
    for order in (ordering(rows.variable, 20, 25), np.arange(25), np.arange(25)[::-1]):
        assert eliminate(rows, structure(rows.variable, rows.dim, order)).free == 22


def test_a_front_of_many_rows_is_made_triangular_on_the_way():
    """One landmark seen from everywhere, eliminated last: its rows pile up unless fronts are cut."""
    rows = drive(np.random.default_rng(3), 200, 1, 800)
    assert SLACK > 1.0
    _, covariance, t = solved(rows, np.arange(201))
    A, b, at = dense(rows)
    expected = np.linalg.inv(A.T @ A)[at[200] :, at[200] :]
    np.testing.assert_allclose(covariance[200, :2, :2], expected, rtol=1e-5)
    np.testing.assert_allclose(t.left, np.sum((b - A @ np.linalg.lstsq(A, b, rcond=None)[0]) ** 2), rtol=1e-6)


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
