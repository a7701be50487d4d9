"""Innovations of fixes and closures after all data: each against what all others say together; what observations leave.

The innovation of a measurement against the estimate without it follows from its residual at the optimum. With whitened
Jacobian A, residual e and covariance P of the estimate, M = A P A' is the share of the measurement in its own fit; the
innovation is (I - M)^-1 e, its covariance (I - M)^-1 (Cook and Weisberg, "Residuals and influence in regression", 1982,
section 2.2). So each is chi-square by itself, as a filter's is, though not independent of the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data.inputs import IntArray
from data.pose_measurements import PoseInnovations
from data.se2 import Array
from graph.factors import CAUCHY, HUBER
from graph.pose_factors import PoseFactor
from graph.qr.elimination import Rows

UNCHECKED = 1e-9  # least share of a measurement that the others must say as well; less is rounding
LEAST_WEIGHT = 1e-12  # of a robust loss


def pairs_of(factors: Sequence[PoseFactor]) -> IntArray:
    """Frames (q, 2) of the closures among them."""
    return np.array([p.frames for p in factors if p.closure], np.int64).reshape(-1, 2)


def innovations(
    factors: Sequence[PoseFactor], rows: Rows, blocks: IntArray, covariance: Array, across: Array, loss: str
) -> tuple[PoseInnovations | None, PoseInnovations | None]:
    """Innovations of all fixes and closures; None: there are none.

    Args:
        factors: (k,) of the problem.
        rows: the problem at its optimum, weighted by the loss.
        blocks: (k,) of the factors in these rows.
        covariance: (V, 3, 3) of all variables; of the first as of `Linearizer`.
        across: (q, 3, 3) between those of `pairs_of`.
        loss: of the problem.
    """
    if not factors:
        return None, None
    used = np.array([p.used for p in factors])
    A, error = _unweighted(rows.A[blocks, :, :6], -rows.b[blocks, :, 0], loss)
    P = np.zeros((len(factors), 6, 6))
    first = np.array([p.frames[0] for p in factors])
    P[:, :3, :3] = covariance[first]
    two = [i for i, p in enumerate(factors) if p.closure]
    P[two, 3:, 3:] = covariance[[factors[i].frames[-1] for i in two]]
    P[two, :3, 3:], P[two, 3:, :3] = across, across.transpose(0, 2, 1)
    weight = np.where(used, _weight((rows.b[blocks, :, 0] ** 2).sum(1), loss), 0.0)
    M = A @ P @ A.transpose(0, 2, 1)
    G = np.eye(3) - weight[:, None, None] * M
    checked = np.linalg.eigvalsh(G)[:, 0] > UNCHECKED
    G[~checked] = np.eye(3)
    innovation = np.linalg.solve(G, error[:, :, None])
    S = np.eye(3) + np.linalg.solve(G, M)
    T = np.tile(np.eye(3), (len(factors), 1, 1))
    for i, p in enumerate(factors):
        T[i, : len(p.entries), : len(p.entries)] = p.unwhiten
    S = T @ S @ T.transpose(0, 2, 1)
    white = np.linalg.solve(np.linalg.cholesky(0.5 * (S + S.transpose(0, 2, 1))), T @ innovation)[:, :, 0]
    white[~checked] = np.nan
    fixes = [i for i, p in enumerate(factors) if not p.closure]
    return _of(factors, fixes, white), _of(factors, two, white)


def left_by(A: Array, covariance: Array, pairs: IntArray, across: Array) -> Array:
    """Eigenvalues (m, 2), ascending, of I - M for observations of both coordinates: variances of their residuals at the
    optimum, over those of their noise. Constant systematic errors count as known.

    Args:
        A: (m, 3, 6) of pose and landmark, whitened.
        covariance: (V, 3, 3) of all variables; of the first as of `Linearizer`.
        pairs: (m, 2) the variables; a known landmark is -1.
        across: (m, 3, 3) between them.
    """
    P = np.zeros((len(A), 6, 6))
    P[:, :3, :3], P[:, :3, 3:], P[:, 3:, :3] = covariance[pairs[:, 0]], across, across.transpose(0, 2, 1)
    P[:, 3:, 3:] = np.where((pairs[:, 1] >= 0)[:, None, None], covariance[pairs[:, 1]], 0.0)
    M = A[:, :2] @ P @ A[:, :2].transpose(0, 2, 1)
    return np.asarray(np.clip(np.linalg.eigvalsh(np.eye(2) - 0.5 * (M + M.transpose(0, 2, 1))), 0.0, 1.0))


def _of(factors: Sequence[PoseFactor], some: Sequence[int], white: Array) -> PoseInnovations | None:
    """The innovations of some of the factors, by their rows in the log."""
    if not some:
        return None
    row = np.array([factors[i].row for i in some])
    size = int(row.max()) + 1
    used, nis, dof = np.zeros(size, np.bool_), np.full(size, np.nan), np.zeros(size, np.int64)
    spread = np.full((size, 3), np.nan)
    for k, i in zip(row.tolist(), some, strict=True):
        p = factors[i]
        used[k], dof[k] = p.used, len(p.entries)
        spread[k, list(p.entries)] = white[i, : dof[k]]
        nis[k] = float(white[i, : dof[k]] @ white[i, : dof[k]])
    return PoseInnovations(used, nis, dof, spread)


def _weight(square: Array, loss: str) -> Array:
    """Weights (k,) under a loss, from squared weighted residuals (k,)."""
    if loss == "huber":
        return HUBER**2 / np.maximum(square, HUBER**2)
    if loss == "cauchy":
        return np.maximum(1.0 - square / CAUCHY**2, LEAST_WEIGHT)
    return np.ones(len(square))


def _unweighted(A: Array, error: Array, loss: str) -> tuple[Array, Array]:
    root = np.sqrt(_weight((error**2).sum(1), loss))
    return A / root[:, None, None], error / root[:, None]
