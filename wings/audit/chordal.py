"""Chordal start of a graph file, in the plane or in space (`graph.chordal`)."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from data.formats.graph_file import POSE2, POSE3, GraphFile
from data.se2 import Array
from graph.chordal import chordal


def chordal_start(file: GraphFile) -> dict[int, tuple[str, Array]]:
    """Poses by id, as of a graph file, of all that relations tie; the first of each connected part is the origin."""
    out: dict[int, tuple[str, Array]] = {}
    for kind, d in ((POSE2, 2), (POSE3, 3)):
        edges = [edge for edge in file.edges if file.kind(edge) == (kind, kind)]
        if not edges:
            continue
        ids, ends = np.unique(np.array([edge.ends for edge in edges]), return_inverse=True)
        M, m = (np.array(each) for each in zip(*(_parts(edge.measured) for edge in edges), strict=True))
        known = [np.diagonal(edge.information) for edge in edges]
        shift, turn = np.array([each[:d].mean() for each in known]), np.array([each[d:].mean() for each in known])
        R, t = chordal(ends.reshape(-1, 2), M, m, turn, shift)
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
