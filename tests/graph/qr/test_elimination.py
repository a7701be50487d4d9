"""Sparse QR against dense linear algebra: solution, covariances, what is left over, and what is free."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from graph.qr.elimination import SLACK, Rows, eliminate, marginals, means, ordering, structure
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
    dim = np.repeat([3, 2], [poses, landmarks])
    return Rows(np.array(variable), A, b, np.array(count), dim)


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
