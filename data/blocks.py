"""Joint covariances of points with rows and columns x0, y0, x1, y1, ..., and their 2 x 2 blocks."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array


def coordinates(points: IntArray) -> IntArray:
    """Rows (2n,) of points (n,): 2 i and 2 i + 1 of each point i."""
    return coordinates_from(2 * np.asarray(points, np.int64))


def coordinates_from(first: IntArray) -> IntArray:
    """Rows (2n,) of points whose x is in the rows `first` (n,), and y in the next ones."""
    return np.asarray((first[:, None] + np.arange(2)).ravel())


def of_points(P: Array, points: IntArray) -> Array:
    """Joint covariance (2k, 2k) of points (k,), from that of all points (2n, 2n); a copy."""
    rows = coordinates(points)
    return np.asarray(P[np.ix_(rows, rows)])


def blocks_of(P: Array) -> Array:
    """Blocks (m, n, 2, 2) of a matrix (2m, 2n); a view where the matrix is contiguous."""
    m, n = len(P) // 2, P.shape[1] // 2
    return P.reshape(m, 2, n, 2).transpose(0, 2, 1, 3)


def diagonal_blocks(P: NDArray[np.floating[Any]]) -> Any:
    """Marginal covariance (n, 2, 2) of each point, from the joint one (2n, 2n); a copy."""
    n = len(P) // 2
    return P.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :]


def block_diagonal(blocks: Array) -> Array:
    """Matrix (na, nb) with blocks (n, a, b) on its diagonal, as the joint covariance of independent points."""
    n, a, b = blocks.shape
    whole = np.zeros((n, a, n, b))
    whole[np.arange(n), :, np.arange(n), :] = blocks
    return whole.reshape(n * a, n * b)


def add_to_diagonal(P: Array, blocks: Array) -> None:
    """Add blocks (k, 2, 2) to the first k <= n on the diagonal of contiguous P (2n, 2n), in place."""
    n, k = len(P) // 2, np.arange(len(blocks))
    P.reshape(n, 2, n, 2)[k, :, k, :] += blocks


def squared_norms(nu: Array, S: Array) -> Array:
    """Squared Mahalanobis distances (...) of differences nu (..., 2) with covariances S (..., 2, 2)."""
    x, y, a, b, c = nu[..., 0], nu[..., 1], S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    return np.asarray((c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b))


def whitened(nu: Array, S: Array) -> Array:
    """Innovations (k, 2) over their standard deviations, by the Cholesky factors of their covariances (k, 2, 2)."""
    return np.asarray(np.linalg.solve(np.linalg.cholesky(S), nu[:, :, None])[:, :, 0])


@njit
def cholesky(S: Array, L: Array, n: int) -> bool:
    """Lower Cholesky factor L of the leading n x n block of S, which may be L itself; False where S is not definite."""
    for i in range(n):
        for j in range(i + 1):
            total = S[i, j]
            for q in range(j):
                total -= L[i, q] * L[j, q]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True
