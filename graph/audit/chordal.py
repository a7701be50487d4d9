"""Chordal start of a pose graph: rotations as matrices by linear least squares, then positions.

Relations state R_j = R_i M and t_j = t_i + R_i m. Without the constraint that R is a rotation the first is linear, each
row of R on its own; the solution is projected onto rotations (Martinec and Pajdla, "Robust rotation and translation
estimation in multiview reconstruction", CVPR 2007; Carlone et al., "Initialization techniques for 3D SLAM", ICRA 2015).
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from data.formats.graph_file import POSE2, POSE3, GraphFile
from data.inputs import IntArray
from data.se2 import Array


def chordal(file: GraphFile) -> dict[int, tuple[str, Array]]:
    """Poses by id, as of a graph file, of all that relations tie; the first of each connected part is the origin."""
    out: dict[int, tuple[str, Array]] = {}
    for kind, d in ((POSE2, 2), (POSE3, 3)):
        edges = [edge for edge in file.edges if file.kind(edge) == (kind, kind)]
        if not edges:
            continue
        ids, ends = np.unique(np.array([edge.ends for edge in edges]), return_inverse=True)
        ends = ends.reshape(-1, 2)
        M, m = (np.array(each) for each in zip(*(_parts(edge.measured) for edge in edges), strict=True))
        known = [np.diagonal(edge.information) for edge in edges]
        shift, turn = np.array([each[:d].mean() for each in known]), np.array([each[d:].mean() for each in known])
        free = _free(ends, len(ids))
        eye = np.tile(np.eye(d), (len(edges), 1, 1))
        R = _projected(_solved(ends, free, M.transpose(0, 2, 1), eye, np.zeros((len(edges), d, d)), turn, np.eye(d)))
        ahead = np.einsum("nij,nj->ni", R[ends[:, 0]], m)[:, :, None]
        t = _solved(ends, free, eye, eye, ahead, shift, np.zeros((d, 1)))[:, :, 0]
        for key, rotation, xyz in zip(ids.tolist(), R, t, strict=True):
            out[key] = kind, _written(rotation, xyz)
    return out


def _parts(z: Array) -> tuple[Array, Array]:
    """Rotation (d, d) and translation (d,) of a measured relation."""
    if len(z) == 3:
        c, s = np.cos(z[2]), np.sin(z[2])
        return np.array([[c, -s], [s, c]]), z[:2]
    return gtsam.Rot3.Quaternion(z[6], z[3], z[4], z[5]).matrix(), z[:3]


def _written(R: Array, t: Array) -> Array:
    if len(t) == 2:
        return np.array([*t, np.arctan2(R[1, 0], R[0, 0])])
    q: Any = gtsam.Rot3(R).toQuaternion()  # the stubs do not know it
    return np.array([*t, q.x(), q.y(), q.z(), q.w()])


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
        x = spsolve((A.T @ A).tocsc(), A.T @ b.reshape(n * d, c))
        out[free >= 0] = np.asarray(x).reshape(-1, d, c)
    return out


def _projected(X: Array) -> Array:
    """The nearest rotations to R' (V, d, d), transposed; a matrix without rank keeps to the identity."""
    U, s, Vt = np.linalg.svd(X.transpose(0, 2, 1))
    sign = np.sign(np.linalg.det(U @ Vt))
    U[:, :, -1] *= sign[:, None]
    out: Array = U @ Vt
    lost = ~(s[:, -1] > 1e-9 * np.maximum(s[:, 0], 1.0)) if X.shape[1] == 2 else ~(s[:, 1] > 1e-9)
    out[lost] = np.eye(X.shape[1])
    return out
