"""Chordal start of a pose graph: rotations as matrices by linear least squares, then positions.

Relations state R_j = R_i M and t_j = t_i + R_i m. Without the constraint that R is a rotation the first is linear, each
row of R on its own; the solution is projected onto rotations (Martinec and Pajdla, "Robust rotation and translation
estimation in multiview reconstruction", CVPR 2007; Carlone et al., "Initialization techniques for 3D SLAM", ICRA 2015).
"""

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from data.inputs import Inputs, IntArray
from data.se2 import Array, compose


def chordal(ends: IntArray, M: Array, m: Array, turn: Array, shift: Array) -> tuple[Array, Array]:
    """Rotations (V, d, d) and translations (V, d) of poses 0 ... V - 1; the first of each connected part is the origin.

    Args:
        ends: (n, 2) poses that each relation ties.
        M: (n, d, d) measured rotations.
        m: (n, d) measured translations.
        turn: (n,) information about the rotations, a number each.
        shift: (n,) information about the translations.
    """
    d = m.shape[1]
    free = _free(ends, int(ends.max()) + 1)
    eye = np.tile(np.eye(d), (len(ends), 1, 1))
    # The nearest rotations to R' (V, d, d), transposed; a matrix without rank keeps to the identity.
    X = _solved(ends, free, M.transpose(0, 2, 1), eye, np.zeros((len(ends), d, d)), turn, np.eye(d))
    U, s, Vt = np.linalg.svd(X.transpose(0, 2, 1))
    U[:, :, -1] *= np.sign(np.linalg.det(U @ Vt))[:, None]
    R: Array = U @ Vt
    lost = ~(s[:, -1] > 1e-9 * np.maximum(s[:, 0], 1.0)) if X.shape[1] == 2 else ~(s[:, 1] > 1e-9)
    R[lost] = np.eye(X.shape[1])
    ahead = np.einsum("nij,nj->ni", R[ends[:, 0]], m)[:, :, None]
    return R, _solved(ends, free, eye, eye, ahead, shift, np.zeros((d, 1)))[:, :, 0]


def chordal_path(inputs: Inputs) -> Array:
    """Poses (N, 3) of a log from its increments and closures, from the mean of its prior on."""
    n, steps, closures = len(inputs), inputs.increments, inputs.closures
    ends = np.stack([np.arange(n - 1), np.arange(1, n)], 1)
    relative, C = steps.mean[1:], steps.covariance[1:]
    if closures is not None:
        ends = np.concatenate([ends, np.stack([closures.frame1, closures.frame2], 1)])
        relative, C = np.concatenate([relative, closures.relative]), np.concatenate([C, closures.covariance])
    if not len(ends):
        return inputs.prior.mean[None].copy()
    c, s = np.cos(relative[:, 2]), np.sin(relative[:, 2])
    M = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)
    R, t = chordal(ends, M, relative[:, :2], 1.0 / C[:, 2, 2], 2.0 / (C[:, 0, 0] + C[:, 1, 1]))
    return compose(inputs.prior.mean, np.column_stack([t, np.arctan2(R[:, 1, 0], R[:, 0, 0])]))


def _free(ends: IntArray, count: int) -> IntArray:
    """Number (count,) of each pose among those that are solved for; -1: the first of its part."""
    pairs = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), (count, count))
    label = connected_components(pairs, directed=False)[1]
    free = np.ones(count, bool)
    free[np.unique(label, return_index=True)[1]] = False
    return np.where(free, np.cumsum(free) - 1, -1)


def _solved(ends: IntArray, free: IntArray, B: Array, C: Array, e: Array, weight: Array, first: Array) -> Array:
    """Unknowns (V, d, c) of  C x_j = B x_i + e  (n, d, c) in least squares; those that are not free are `first`."""
    n, d, c = e.shape
    root = np.sqrt(weight / max(float(weight.mean()), np.finfo(float).tiny))
    rows, columns, values = [], [], []
    b = root[:, None, None] * e
    at = d * np.arange(n)[:, None, None] + np.arange(d)[:, None]
    for side, block in ((0, -B), (1, C)):
        place, block = free[ends[:, side]], root[:, None, None] * block
        held = place < 0
        b[held] -= block[held] @ first
        rows.append(np.broadcast_to(at, block.shape)[~held].ravel())
        columns.append(np.broadcast_to(d * place[:, None, None] + np.arange(d), block.shape)[~held].ravel())
        values.append(block[~held].ravel())
    size = d * (int(free.max(initial=-1)) + 1)
    out = np.tile(first, (len(free), 1, 1)).astype(float)
    if size:
        A = csc_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (n * d, size))
        out[free >= 0] = np.asarray(spsolve((A.T @ A).tocsc(), A.T @ b.reshape(n * d, c))).reshape(-1, d, c)
    return out
