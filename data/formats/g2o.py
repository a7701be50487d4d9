"""Text of a g2o graph in the plane, read and written.

    VERTEX_SE2 id x y theta                        pose [m, m, rad]
    VERTEX_XY id x y                               landmark [m]
    FIX id [id ...]                                held where they are
    EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33        pose j in the frame of pose i
    EDGE_SE2_XY i l x y I11 I12 I22                landmark l in the frame of pose i
    EDGE_BEARING_SE2_XY i l bearing I              direction of landmark l from pose i

I: information matrix, upper triangle row by row. An EDGE_SE2's error is that of the relative pose seen from its
measured end, (R(dtheta)' (t - t_measured), theta - theta_measured); the landmark edges' errors are additive (g2o's
types_slam2d).
Poses and landmarks share one set of ids.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.errors import LARGEST, DataError
from data.inputs import IntArray
from data.se2 import Array

POSE, POINT, FIX = "VERTEX_SE2", "VERTEX_XY", "FIX"
MOTION, SIGHTING, BEARING = "EDGE_SE2", "EDGE_SE2_XY", "EDGE_BEARING_SE2_XY"
NUMBERS = {POSE: (1, 3, 0), POINT: (1, 2, 0), MOTION: (2, 3, 6), SIGHTING: (2, 2, 3), BEARING: (2, 1, 1)}
"""Ids, measured numbers, and numbers of the information matrix after each tag."""
SPATIAL = ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "VERTEX_SE3", "EDGE_SE3", "VERTEX_TRACKXYZ", "EDGE_SE3_TRACKXYZ")


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of one kind: ends (K, 2) ids, measured (K, d), covariance (K, d, d), line (K,) of the file."""

    ends: IntArray
    measured: Array
    covariance: Array
    line: IntArray

    def __len__(self) -> int:
        return len(self.ends)


@dataclass(frozen=True, eq=False)
class Graph:
    """A graph in the plane.

    Attributes:
        path: where it was read, for messages.
        pose, point: estimates by id, in the order of the file: id (K,), value (K, 3) or (K, 2).
        fixed: ids held where they are.
        motion, sighting, bearing: edges.
        other: lines with any other tag, by tag.
    """

    path: Path
    pose: tuple[IntArray, Array]
    point: tuple[IntArray, Array]
    fixed: IntArray
    motion: Edges
    sighting: Edges
    bearing: Edges
    other: dict[str, int]


def read_graph(path: Path) -> Graph:
    """The graph of a file.

    Raises:
        DataError: not readable, a line with too few or other fields, an information matrix that is not positive
            definite, an id twice, or a graph in space.
    """
    try:
        text = path.read_text("utf-8", "replace")
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from None
    rows: dict[str, list[tuple[int, list[float]]]] = {tag: [] for tag in NUMBERS}
    fixed: list[int] = []
    other: Counter[str] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        tag, *fields = line.split("#")[0].split() or [""]
        if tag in NUMBERS:
            rows[tag].append((number, _values(path, number, tag, fields)))
        elif tag == FIX:
            fixed += [int(v) for v in _numbers(path, number, tag, fields, len(fields))]
        elif tag in SPATIAL:
            raise DataError.at(path, f"{tag}: a graph in space; graphs in the plane ({POSE}) are read", line=number)
        elif tag:
            other[tag] += 1
    vertices = {tag: _vertices(path, rows[tag]) for tag in (POSE, POINT)}
    ids = np.concatenate([vertices[POSE][0], vertices[POINT][0]])
    found, times = np.unique(ids, return_counts=True)
    if (times > 1).any():
        raise DataError.at(path, f"vertex {found[np.argmax(times > 1)]} stands there twice; ids are for one each")
    edges = {tag: _edges(path, rows[tag], tag) for tag in (MOTION, SIGHTING, BEARING)}
    return Graph(
        path, vertices[POSE], vertices[POINT], np.array(fixed, np.int64), edges[MOTION], edges[SIGHTING],
        edges[BEARING], dict(other),
    )  # fmt: skip


def _values(path: Path, line: int, tag: str, fields: Sequence[str]) -> list[float]:
    """Numbers of a line, the ids first."""
    ids, measured, information = NUMBERS[tag]
    return _numbers(path, line, tag, fields, ids + measured + information, ids)


def _numbers(path: Path, line: int, tag: str, fields: Sequence[str], count: int, ids: int | None = None) -> list[float]:
    if len(fields) != count:
        raise DataError.at(path, f"{tag} with {len(fields)} numbers; {count} are needed", line=line)
    values = []
    for k, field in enumerate(fields):
        try:
            value = float(field)
        except ValueError:
            value = math.nan
        whole = ids is None or k < ids
        if "_" in field or not abs(value) <= LARGEST or (whole and (value < 0.0 or not value.is_integer())):
            wanted = "an id, a whole number from 0 up" if whole else "a number"
            raise DataError.at(path, f"{tag}: {field[:40]!r} is not {wanted}", line=line)
        values.append(value)
    return values


def _vertices(path: Path, rows: Sequence[tuple[int, list[float]]]) -> tuple[IntArray, Array]:
    if not rows:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    values = np.array([v for _, v in rows])
    return values[:, 0].astype(np.int64), values[:, 1:]


def _edges(path: Path, rows: Sequence[tuple[int, list[float]]], tag: str) -> Edges:
    _, d, _ = NUMBERS[tag]
    values = np.array([v for _, v in rows]).reshape(len(rows), -1) if rows else np.zeros((0, sum(NUMBERS[tag])))
    line = np.array([n for n, _ in rows], np.int64)
    information = np.empty((len(values), d, d))
    i, j = np.triu_indices(d)
    information[:, i, j] = information[:, j, i] = values[:, 2 + d :]
    bad = np.linalg.eigvalsh(information)[:, 0] <= 0.0 if len(values) else np.zeros(0, bool)
    if bad.any():
        what = f"{tag}: its information matrix is not positive definite"
        raise DataError.at(path, what, line=int(line[np.argmax(bad)]))
    covariance = np.linalg.inv(information).astype(np.float64)
    return Edges(values[:, :2].astype(np.int64), values[:, 2 : 2 + d], covariance, line)


def turned(motion: Array, covariance: Array, *, back: bool = False) -> Array:
    """Covariances (K, 3, 3) of g2o's EDGE_SE2 error as ours, additive in the frame of the start; `back`: from ours."""
    A = np.zeros((len(motion), 3, 3))
    c, s = np.cos(motion[:, 2]), np.sin(motion[:, 2])
    A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], A[:, 1, 1], A[:, 2, 2] = c, -s, s, c, 1.0
    T = A.transpose(0, 2, 1)
    result: Array = T @ covariance @ A if back else A @ covariance @ T
    return result


def written(
    poses: tuple[Sequence[int], Array],
    points: tuple[Sequence[int], Array],
    fixed: Iterable[int],
    edges: Iterable[tuple[str, int, int, Array, Array]],
) -> str:
    """Text of a graph: poses and points by id, ids held, and edges (tag, id, id, measured (d,), covariance (d, d)).

    An EDGE_SE2's covariance is that of the additive error in the frame of its start.
    """  # fmt: skip
    lines = [_line(POSE, [i], p) for i, p in zip(*poses, strict=True)]
    lines += [_line(POINT, [i], p) for i, p in zip(*points, strict=True)]
    for tag, a, b, measured, covariance in edges:
        P = turned(measured[None], covariance[None], back=True)[0] if tag == MOTION else np.atleast_2d(covariance)
        information = np.linalg.inv(P)
        lines.append(_line(tag, [a, b], [*np.ravel(measured), *information[np.triu_indices(len(P))]]))
    # last: gtsam's reader stops there, g2o takes it anywhere
    lines += [f"{FIX} {i}" for i in fixed]
    return "\n".join(lines) + "\n"


def _line(tag: str, ids: Sequence[int], values: Iterable[float]) -> str:
    return " ".join([tag, *map(str, ids), *(repr(float(v)) for v in values)])
