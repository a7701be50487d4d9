"""Files of factor graphs, in the plane and in space: g2o, Toro, iSAM. Lines are kept for writing.

    VERTEX_SE2 | VERTEX2 id x y theta                              VERTEX_XY id x y
    VERTEX_SE3:QUAT id x y z qx qy qz qw                           VERTEX_TRACKXYZ id x y z
    VERTEX3 id x y z roll pitch yaw                                FIX id [id ...]
    EDGE_SE2 i j x y theta I11 I12 I13 I22 I23 I33                 EDGE_SE2_XY | LANDMARK2 i l x y I11 I12 I22
    EDGE2 i j x y theta I11 I12 I22 I33 I13 I23                    EDGE_BEARING_SE2_XY i l bearing I
    BR i l bearing range sigma sigma                               PARAMS_SE3OFFSET id x y z qx qy qz qw
    EDGE_SE3:QUAT i j x y z qx qy qz qw I (21)                     EDGE3 i j x y z roll pitch yaw I (21)
    EDGE_SE3_TRACKXYZ i l parameter x y z I (6)
    ODOMETRY i j x y theta P11 P12 P13 P22 P23 P33                 LANDMARK i l x y P11 P12 P22

I: information, P: covariance, upper triangle row by row; in space translation first. As gtsam's reader, and unlike g2o,
the rotation's information is of the angle, not of the quaternion's half angle. Poses and points have ids of their own.
An edge without information has the identity. An EDGE2 that is not definite in Toro's order is read as an EDGE_SE2.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.errors import LARGEST, DataError
from data.formats.csv_table import bytes_of, is_number
from data.se2 import Array

POSE2, POSE3, POINT2, POINT3 = "pose2", "pose3", "point2", "point3"
VERTICES = {
    "VERTEX_SE2": (POSE2, 3), "VERTEX2": (POSE2, 3), "VERTEX_XY": (POINT2, 2), "VERTEX_SE3:QUAT": (POSE3, 7),
    "VERTEX_TRACKXYZ": (POINT3, 3), "VERTEX3": (POSE3, 6),
}  # fmt: skip
"""Kind and number of values."""
EDGES = {
    "EDGE_SE2": (3, 3, POSE2, POSE2), "EDGE2": (3, 3, POSE2, POSE2), "EDGE_SE2_XY": (2, 2, POSE2, POINT2),
    "LANDMARK2": (2, 2, POSE2, POINT2), "EDGE_BEARING_SE2_XY": (1, 1, POSE2, POINT2), "BR": (2, 2, POSE2, POINT2),
    "ODOMETRY": (3, 3, POSE2, POSE2), "LANDMARK": (2, 2, POSE2, POINT2),
    "EDGE_SE3:QUAT": (7, 6, POSE3, POSE3), "EDGE3": (6, 6, POSE3, POSE3), "EDGE_SE3_TRACKXYZ": (3, 3, POSE3, POINT3),
}  # fmt: skip
"""Measured values, residuals, and the kinds of both ends."""
COVARIANCES = ("ODOMETRY", "LANDMARK")  # tags of text of iSAM that state covariances, as gtsam reads them
TORO = [0, 1, 4, 2, 5, 3]  # places of I11 I12 I13 I22 I23 I33 among the six of an EDGE2
UNIT = 1e-3  # largest difference of a quaternion's norm from 1


@dataclass(frozen=True, eq=False)
class Edge:
    """One factor: its tag, ends, measured values, information (d, d), line in the file, and parameter (-1: none)."""

    tag: str
    ends: tuple[int, int]
    measured: Array
    information: Array
    line: int
    parameter: int = -1


@dataclass(frozen=True, eq=False)
class GraphFile:
    """A graph as written: lines, poses and points by id (kind, values), edges in order, fixed ids, offsets, tags."""

    path: Path
    lines: list[str]
    poses: dict[int, tuple[str, Array]]
    points: dict[int, tuple[str, Array]]
    edges: list[Edge]
    fixed: list[int]
    offsets: dict[int, Array]
    other: dict[str, int]

    def kind(self, edge: Edge) -> tuple[str, str]:
        """Kinds of the variables at both ends."""
        return EDGES[edge.tag][2:]


def read_graph_file(path: Path) -> GraphFile:
    """Read a graph.

    Raises DataError with line and value: wrong fields, a number that is none, an information matrix that is not
    positive definite, a quaternion that is no rotation, an id that is repeated, or of two kinds, a pose without its
    vertex where the file has some; and for a file without an edge.
    """
    return graph_file_of(path, bytes_of(path).decode("utf-8", "replace"))


def graph_file_of(path: Path, text: str) -> GraphFile:
    """The graph of a text; errors, as of `read_graph_file`, name the path."""
    lines = text.splitlines()
    graph = GraphFile(path, lines, {}, {}, [], [], {}, {})
    other: Counter[str] = Counter()
    for number, line in enumerate(lines, start=1):
        tag, *fields = line.split("#")[0].split() or [""]
        if tag in VERTICES:
            kind, count = VERTICES[tag]
            (key,), values = _fields(path, number, tag, fields, 1, count)
            known = graph.poses if kind in (POSE2, POSE3) else graph.points
            if key in known:
                raise DataError.at(path, f"{tag}: vertex {key} is repeated; ids must be unique", line=number)
            known[key] = kind, _pose(path, number, tag, values)
        elif tag in EDGES:
            graph.edges.append(_edge(path, number, tag, fields))
        elif tag == "FIX":
            graph.fixed.extend(_fields(path, number, tag, fields, len(fields), 0)[0])
        elif tag == "PARAMS_SE3OFFSET":
            (key,), values = _fields(path, number, tag, fields, 1, 7)
            graph.offsets[key] = _pose(path, number, tag, values)
        elif tag:
            other[tag] += 1
    graph.other.update(other)
    if not graph.edges:
        tags = ", ".join(EDGES)
        raise DataError.at(path, f"no edge of a graph; lines of g2o or Toro are needed, with a tag of {tags}")
    kinds: dict[tuple[bool, int], str] = {(False, k): kind for k, (kind, _) in graph.poses.items()}
    kinds |= {(True, k): kind for k, (kind, _) in graph.points.items()}
    for edge in graph.edges:
        for key, kind in zip(edge.ends, graph.kind(edge), strict=True):
            point = kind in (POINT2, POINT3)
            if graph.poses and not point and key not in graph.poses:
                what = f"{edge.tag}: vertex {key} is missing; each pose needs its line, or none has one"
                raise DataError.at(path, what, line=edge.line)
            if kinds.setdefault((point, key), kind) != kind:
                what = f"{edge.tag}: {key} is a {kinds[point, key]}, where a {kind} is needed"
                raise DataError.at(path, what, line=edge.line)
    missing = next((key for key in graph.fixed if key not in graph.poses and key not in graph.points), None)
    if missing is not None:
        raise DataError.at(path, f"FIX {missing}: vertex {missing} is missing")
    return graph


def _fields(path: Path, line: int, tag: str, fields: list[str], ids: int, count: int) -> tuple[tuple[int, ...], Array]:
    if len(fields) != ids + count:
        raise DataError.at(path, f"{tag} with {len(fields)} numbers; {ids + count} are needed", line=line)
    for k, field in enumerate(fields):
        value = float(field) if is_number(field) else math.nan
        if not abs(value) <= LARGEST or (k < ids and (value < 0.0 or not value.is_integer())):
            wanted = "an id, a whole number from 0 up" if k < ids else "a number"
            raise DataError.at(path, f"{tag}: {field[:40]!r} is not {wanted}", line=line)
    return tuple(int(float(f)) for f in fields[:ids]), np.array([float(f) for f in fields[ids:]])


def _edge(path: Path, line: int, tag: str, fields: list[str]) -> Edge:
    measured, d, first, second = EDGES[tag]
    ids = 3 if tag == "EDGE_SE3_TRACKXYZ" else 2
    entries = 2 if tag == "BR" else d * (d + 1) // 2
    bare = tag != "BR" and len(fields) == ids + measured
    keys, values = _fields(path, line, tag, fields, ids, measured + entries * (not bare))
    if keys[0] == keys[1] and first == second:
        raise DataError.at(path, f"{tag}: both ends are {keys[0]}; two variables are needed", line=line)
    stated = values[measured:]
    if tag == "BR":
        if not (stated > 0.0).all():
            raise DataError.at(path, f"{tag}: sigma {stated.min():g} is not positive", line=line)
        information = np.diag(1.0 / stated**2)
    elif bare:
        information = np.eye(d)
    else:
        toro = d == 3 and first == POSE2 and bool(_definite(_symmetric(stated[TORO], d)))
        information = _symmetric(stated[TORO] if tag == "EDGE2" and toro else stated, d)
        if not _definite(information):
            value = float(np.linalg.eigvalsh(information)[0])
            matrix = "covariance" if tag in COVARIANCES else "information matrix"
            what = f"{tag}: its {matrix} is not positive definite (least eigenvalue {value:.3g})"
            hint = "; it would be in Toro's order I11 I12 I22 I33 I13 I23, as of an EDGE2" if toro else ""
            raise DataError.at(path, what + hint, line=line)
        if tag in COVARIANCES:
            information = np.asarray(np.linalg.inv(information), float)
    return Edge(tag, (keys[0], keys[1]), _pose(path, line, tag, values[:measured]), information, line, *keys[2:])


def _symmetric(entries: Array, d: int) -> Array:
    out = np.zeros((d, d))
    out[np.triu_indices(d)] = entries
    out += np.triu(out, 1).T
    return out


def _definite(information: Array) -> bool:
    """Whether it is positive definite, whatever its units."""
    scale = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    return bool(scale.all()) and float(np.linalg.eigvalsh(information / scale[:, None] / scale)[0]) > 1e-12


def _pose(path: Path, line: int, tag: str, values: Array) -> Array:
    """The values; a quaternion normalized, roll, pitch and yaw as a quaternion."""
    if len(values) == 7:
        norm = float(np.linalg.norm(values[3:]))
        if abs(norm - 1.0) > UNIT:
            raise DataError.at(path, f"{tag}: quaternion of norm {norm:.6g}; 1 is needed (qx qy qz qw)", line=line)
        return np.concatenate([values[:3], values[3:] / norm])
    if len(values) == 6:
        (cr, cp, cy), (sr, sp, sy) = np.cos(values[3:] / 2), np.sin(values[3:] / 2)
        x, y, z = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
        q = [x, y, z, cr * cp * cy + sr * sp * sy]
        return np.concatenate([values[:3], q])
    return values


def with_information(graph: GraphFile, information: dict[int, Array], left_out: set[int]) -> str:
    """The text of the graph with other information matrices of some edges, and without others, by number."""
    lines = list(graph.lines)
    for k, edge in enumerate(graph.edges):
        if k in left_out:
            lines[edge.line - 1] = f"# left out: {lines[edge.line - 1]}"
        elif k in information:
            measured, d, *_ = EDGES[edge.tag]
            words = lines[edge.line - 1].split("#")[0].split()
            keep = words[: 1 + (3 if edge.tag == "EDGE_SE3_TRACKXYZ" else 2) + measured]
            stated = np.linalg.inv(information[k]) if edge.tag in COVARIANCES else information[k]
            entries = stated[np.triu_indices(d)]
            if edge.tag == "BR":
                entries = 1.0 / np.sqrt(np.diagonal(information[k]))
            elif edge.tag == "EDGE2":
                entries = entries[np.argsort(TORO)]
            lines[edge.line - 1] = " ".join([*keep, *(repr(float(v)) for v in entries)])
    return "\n".join(lines) + "\n"
