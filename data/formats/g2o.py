"""g2o graphs in the plane: reading and writing, a graph as a log, and a log with decisions as a graph.

    VERTEX_SE2 id x y theta                        pose [m, m, rad]
    VERTEX_XY id x y                               landmark [m]
    FIX id [id ...]                                fixed vertices
    EDGE_PRIOR_SE2 i x y theta I11 I12 I13 I22 I23 I33       measured pose; that of the first pose is its prior
    EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33        pose j in the frame of pose i
    EDGE_SE2_XY i l x y I11 I12 I22                landmark l in the frame of pose i
    EDGE_BEARING_SE2_XY i l bearing I              direction of landmark l from pose i

Toro's VERTEX2 and EDGE2 are read, too; the latter's order is I11 I12 I22 I33 I13 I23.

I: information matrix, upper triangle row by row. Poses and landmarks share one set of ids. The error of an EDGE_SE2 is
that of the relative pose seen from its measured end, (R(dtheta)' (t - t_measured), theta - theta_measured); errors of
landmark edges are additive (g2o's types_slam2d).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from data import se2
from data.digest import source_file
from data.errors import LARGEST, DataError
from data.formats.bearings import PARALLAX, triangulate
from data.formats.csv_table import bytes_of, is_number, symmetric
from data.formats.graph_file import TORO
from data.formats.recordings.laser import FLOOR
from data.inputs import Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.pose_measurements import Closures
from data.se2 import Array, inverse, wrap_angle
from data.sensors import RangeBearing, RelativePoint, Sensor
from data.truth import Truth

POSE, POINT, FIX = "VERTEX_SE2", "VERTEX_XY", "FIX"
MOTION, OBSERVATION, BEARING = "EDGE_SE2", "EDGE_SE2_XY", "EDGE_BEARING_SE2_XY"
PRIOR = "EDGE_PRIOR_SE2"
TORO_VERTEX, TORO_EDGE = "VERTEX2", "EDGE2"
NUMBERS = {
    POSE: (1, 3, 0),
    POINT: (1, 2, 0),
    MOTION: (2, 3, 6),
    OBSERVATION: (2, 2, 3),
    BEARING: (2, 1, 1),
    PRIOR: (1, 3, 6),
}
"""Numbers of ids, measured values, and entries of the information matrix after each tag."""
SPATIAL = ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "VERTEX_SE3", "EDGE_SE3", "VERTEX_TRACKXYZ", "EDGE_SE3_TRACKXYZ")


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of one kind: ends (K, 2) ids, measured (K, d), covariance (K, d, d), line (K,) in the file."""

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
        path: of the file, for messages.
        pose, point: vertices in file order: id (K,), value (K, 3) or (K, 2).
        fixed: ids of fixed vertices.
        motion, observation, bearing: edges.
        prior: of poses, with both ends the same.
        other: numbers of lines with other tags.
    """

    path: Path
    pose: tuple[IntArray, Array]
    point: tuple[IntArray, Array]
    fixed: IntArray
    motion: Edges
    observation: Edges
    bearing: Edges
    prior: Edges
    other: dict[str, int]


def read_graph(path: Path) -> Graph:
    """Read a graph.

    Raises DataError for an unreadable file, wrong fields of a line, an information matrix that is not positive
    definite, a repeated id, or a graph in space.
    """
    text = bytes_of(path).decode("utf-8", "replace")
    rows: dict[str, list[tuple[int, list[float]]]] = {tag: [] for tag in NUMBERS}
    fixed: list[int] = []
    other: Counter[str] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        tag, *fields = line.split("#")[0].split() or [""]
        if tag in (TORO_VERTEX, TORO_EDGE):
            tag = POSE if tag == TORO_VERTEX else MOTION
            if tag == MOTION and len(fields) == sum(NUMBERS[MOTION]):
                fields = [*fields[:5], *(fields[5 + k] for k in TORO)]
        if tag in NUMBERS:
            rows[tag].append((number, _numbers(path, number, tag, fields, sum(NUMBERS[tag]), NUMBERS[tag][0])))
        elif tag == FIX:
            fixed += [int(v) for v in _numbers(path, number, tag, fields, len(fields))]
        elif tag in SPATIAL:
            raise DataError.at(path, f"{tag}: a graph in space; a graph in the plane ({POSE}) is needed", line=number)
        elif tag:
            other[tag] += 1
    pose, point = _vertices(rows[POSE]), _vertices(rows[POINT])
    ids = np.concatenate([pose[0], point[0]])
    found, times = np.unique(ids, return_counts=True)
    if (times > 1).any():
        raise DataError.at(path, f"vertex {found[np.argmax(times > 1)]} is repeated; ids must be unique")
    motion, observation, bearing = (_edges(path, rows[tag], tag) for tag in (MOTION, OBSERVATION, BEARING))
    prior = _edges(path, [(n, [v[0], *v]) for n, v in rows[PRIOR]], PRIOR)
    return Graph(path, pose, point, np.array(fixed, np.int64), motion, observation, bearing, prior, dict(other))


def _numbers(path: Path, line: int, tag: str, fields: Sequence[str], count: int, ids: int | None = None) -> list[float]:
    if len(fields) != count:
        raise DataError.at(path, f"{tag} with {len(fields)} numbers; {count} are needed", line=line)
    values = []
    for k, field in enumerate(fields):
        value = float(field) if is_number(field) else math.nan
        whole = ids is None or k < ids
        if not abs(value) <= LARGEST or (whole and (value < 0.0 or not value.is_integer())):
            wanted = "an id, a whole number from 0 up" if whole else "a number"
            raise DataError.at(path, f"{tag}: {field[:40]!r} is not {wanted}", line=line)
        values.append(value)
    return values


def _vertices(rows: Sequence[tuple[int, list[float]]]) -> tuple[IntArray, Array]:
    if not rows:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    values = np.array([v for _, v in rows])
    return values[:, 0].astype(np.int64), values[:, 1:]


def _edges(path: Path, rows: Sequence[tuple[int, list[float]]], tag: str) -> Edges:
    _, d, _ = NUMBERS[tag]
    values = np.array([v for _, v in rows]).reshape(-1, 2 + sum(NUMBERS[tag][1:]))
    line = np.array([n for n, _ in rows], np.int64)
    information = symmetric(values[:, 2 + d :])
    bad = np.linalg.eigvalsh(information)[:, 0] <= 0.0 if len(values) else np.zeros(0, bool)
    if bad.any():
        what = f"{tag}: its information matrix is not positive definite"
        raise DataError.at(path, what, line=int(line[np.argmax(bad)]))
    covariance = np.linalg.inv(information).astype(np.float64)
    return Edges(values[:, :2].astype(np.int64), values[:, 2 : 2 + d], covariance, line)


SHOWN = 5  # landmarks without a place that are named
CONTRADICTED = 0.3  # rad between a bearing and its vertices, beyond which these are no estimates
POSE_IDS = "pose_ids"
"""Key of a log's source: ids of the vertices of its frames, where these are not 0 to N - 1."""
UNSEEN = 100.0
"""Standard deviation of an unmeasured range over the range from the vertices."""


def log_of(name: str, graph: Graph, *, true: bool = False) -> Log:
    """The log of a graph; `true`: its vertices are the true values.

    Frames are the poses in the order of their vertices (by id without any). The first EDGE_SE2 between neighbours, in
    either direction, is the motion; every other one becomes a closure. Labels are landmark ids.
    A bearing becomes an observation with nearly unknown range. The first pose is fixed at its vertex.

    Raises DataError for neighbours without an edge, an edge without its vertex or of a vertex with itself, or no pose.
    """
    ids = _frames(graph)
    notes: list[str] = []
    mean, covariance, used = _chain(graph, ids)
    covariance, floored = floor_covariances(covariance, FLOOR)
    vertex = _estimates(graph.pose, ids)
    start = vertex[0] if np.isfinite(vertex[0]).all() else np.zeros(3)
    frame, label, z, R, sensor = _observations(graph, ids, notes, se2.dead_reckoned(start, mean))
    notes += _changes(graph, ids, used)
    landmarks = None
    if true and len(graph.point[0]):
        order = np.argsort(graph.point[0])
        landmarks = LandmarkMap(graph.point[0][order], graph.point[1][order])
    inputs = Inputs(
        prior=_prior(graph, ids, start, notes),
        time=np.arange(len(ids), dtype=float),
        increments=Increments(mean, covariance),
        observations=Observations(frame, z, R),
        sensor=sensor,
        map=landmarks,
        time_is_index=True,
        covariance_floor=FLOOR,
        floored=floored,
        closures=_closures(graph.motion, ids, used),
    )
    truth = Truth(pose=vertex if true else None, landmarks=landmarks, landmark_of=label if true else None)
    source: dict[str, object] = {"kind": "g2o", **source_file(graph.path)}
    if ids.tolist() != list(range(len(ids))):
        source[POSE_IDS] = ids.tolist()
    return Log(name, inputs, truth, label=label if len(label) and not true else None, source=source, notes=tuple(notes))


def _frames(graph: Graph) -> IntArray:
    """Pose ids (N,) in the order of frames."""
    ends = [graph.motion.ends.ravel(), graph.observation.ends[:, 0], graph.bearing.ends[:, 0]]
    ids = graph.pose[0] if len(graph.pose[0]) else np.unique(np.concatenate(ends))
    if len(ids) == 0:
        raise DataError.at(graph.path, "no pose: neither VERTEX_SE2 nor EDGE_SE2")
    for edges, columns in ((graph.motion, 2), (graph.observation, 1), (graph.bearing, 1)):
        for i in np.setdiff1d(edges.ends[:, :columns], ids):
            line = int(edges.line[(edges.ends == i).any(axis=1)][0])
            raise DataError.at(graph.path, f"no VERTEX_SE2 {i}; this edge ends there", line=line)
    itself = graph.motion.ends[:, 0] == graph.motion.ends[:, 1]
    if itself.any():
        k = int(np.argmax(itself))
        what = f"{MOTION}: both ends are {graph.motion.ends[k, 0]}; two poses are needed"
        raise DataError.at(graph.path, what, line=int(graph.motion.line[k]))
    joined = {(a, b) for pair in graph.motion.ends.tolist() for a, b in (pair, pair[::-1])}
    ordered = np.sort(ids)
    if not _in_a_row(ids, joined) and _in_a_row(ordered, joined):  # vertices out of order
        return ordered
    return ids


def _in_a_row(ids: IntArray, joined: set[tuple[int, int]]) -> bool:
    """Whether each two successive poses have an edge."""
    return all(pair in joined for pair in pairwise(ids.tolist()))


def _prior(graph: Graph, ids: IntArray, start: Array, notes: list[str]) -> Prior:
    """Of the first pose: its EDGE_PRIOR_SE2 unless it is fixed, else exact."""
    own = np.flatnonzero(graph.prior.ends[:, 0] == ids[0])
    used = bool(len(own)) and int(ids[0]) not in graph.fixed.tolist()
    if len(graph.prior) > used:
        notes.append(f"{len(graph.prior) - used} {PRIOR} left out")
    if not used:
        return Prior(start, np.zeros((3, 3)))
    mean, P = graph.prior.measured[own[0]], graph.prior.covariance[own[:1]]
    return Prior(mean, se2.covariances_in_world(mean[None, 2], P)[0])


def _estimates(vertices: tuple[IntArray, Array], ids: IntArray) -> Array:
    """Values of vertices by id, NaN where there is none."""
    rows = {int(i): value for i, value in zip(*vertices, strict=True)}
    unknown = np.full(vertices[1].shape[1], np.nan)
    return np.array([rows.get(i, unknown) for i in ids.tolist()]).reshape(-1, len(unknown))


def _chain(graph: Graph, ids: IntArray) -> tuple[Array, Array, IntArray]:
    """Increments (N, 3), covariances (N, 3, 3), and numbers (N - 1,) of their edges."""
    at = {int(i): k for k, i in enumerate(ids)}
    edges, n = graph.motion, len(ids)
    first: dict[int, int] = {}
    for e, (a, b) in enumerate(edges.ends.tolist()):
        i, j = at[a], at[b]
        if abs(i - j) == 1:
            first.setdefault(max(i, j), e)
    for k in range(1, n):
        if k not in first:
            what = f"no {MOTION} between the successive poses {ids[k - 1]} and {ids[k]}; a log needs that motion"
            raise DataError.at(graph.path, what)
    mean, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
    if n == 1:
        return mean, covariance, np.zeros(0, np.int64)
    used = np.array([first[k] for k in range(1, n)], np.int64)
    motion = edges.measured[used].copy()
    P = se2.covariances_in_world(motion[:, 2], edges.covariance[used])
    back = edges.ends[used, 0] != ids[:-1]
    if back.any():
        # error of the inverse motion to first order: J of (x, y, theta) -> inverse
        x, y, a = motion[back].T
        c, s = np.cos(a), np.sin(a)
        J = np.zeros((len(a), 3, 3))
        J[:, 0, 0], J[:, 0, 1], J[:, 0, 2] = -c, -s, s * x - c * y
        J[:, 1, 0], J[:, 1, 1], J[:, 1, 2] = s, -c, c * x + s * y
        J[:, 2, 2] = -1.0
        motion[back] = inverse(motion[back])
        P[back] = J @ P[back] @ J.transpose(0, 2, 1)
    mean[1:], covariance[1:] = motion, P
    mean[:, 2] = wrap_angle(mean[:, 2])
    return mean, 0.5 * (covariance + covariance.transpose(0, 2, 1)), used


def _observations(
    graph: Graph, ids: IntArray, notes: list[str], path: Array
) -> tuple[IntArray, IntArray, Array, Array, Sensor]:
    """Frame (M,), label (M,), z (M, 2), R (M, 2, 2) by frame, and the sensor: points, or ranges with bearings.

    Distances of bearings are triangulated along the odometry's path (N, 3).
    """
    at = {int(i): k for k, i in enumerate(ids)}
    points, rays = graph.observation, graph.bearing
    guess = np.zeros(0)
    if len(rays):
        rays, guess = _placed(graph, at, path, notes)
    frame = np.array([at[int(i)] for i in [*points.ends[:, 0], *rays.ends[:, 0]]], np.int64)
    label = np.concatenate([points.ends[:, 1], rays.ends[:, 1]])
    z, R = points.measured, points.covariance
    kind: type[Sensor] = RelativePoint
    if len(rays):
        kind = RangeBearing
        z, R = _polar(z, R)
        far = np.zeros((len(rays), 2, 2))
        far[:, 0, 0], far[:, 1, 1] = (UNSEEN * guess) ** 2, rays.covariance[:, 0, 0]
        z = np.concatenate([z, np.stack([guess, rays.measured[:, 0]], axis=1)])
        R = np.concatenate([R, far])
        notes.append(
            f"{len(graph.bearing)} bearings without a range ({BEARING}): triangulated from {np.degrees(PARALLAX):.0f} "
            f"deg of parallax on, else of the file's vertices, with a standard deviation {UNSEEN:g} times as large"
        )
        if len(points):
            notes.append(f"{len(points)} points ({OBSERVATION}) became ranges and bearings, to first order")
    order = np.argsort(frame, kind="stable")
    reach = float(kind().polar(z)[:, 0].max(initial=0.0))
    if len(rays) or len(points):
        notes.append(f"max_range is {1.001 * reach:.4g} m, the farthest observation: a graph states no field of view")
    sensor = kind(max_range=1.001 * reach if reach > 0.0 else np.inf)
    return frame[order], label[order], z[order], R[order], sensor


def _polar(z: Array, R: Array) -> tuple[Array, Array]:
    """Points (K, 2) with covariances as range and bearing, to first order."""
    r = np.maximum(np.hypot(z[:, 0], z[:, 1]), 1e-9)
    J = np.empty((len(z), 2, 2))
    J[:, 0], J[:, 1] = z / r[:, None], np.stack([-z[:, 1], z[:, 0]], axis=1) / (r**2)[:, None]
    return np.stack([r, np.arctan2(z[:, 1], z[:, 0])], axis=1), J @ R @ J.transpose(0, 2, 1)


def _placed(graph: Graph, at: dict[int, int], path: Array, notes: list[str]) -> tuple[Edges, Array]:
    """The bearings of landmarks that have a place, and their distances (K,); DataError where none has one."""
    rays = graph.bearing
    frame = np.array([at[int(i)] for i in rays.ends[:, 0]], np.int64)
    found = triangulate(path, frame, rays.ends[:, 1], rays.measured[:, 0])
    distance = np.where(np.isfinite(found.distance), found.distance, _of_vertices(graph, rays))
    known = np.isfinite(distance)
    if not known.all():
        lost = np.unique(rays.ends[~known, 1])
        shown = ", ".join(f"{i} ({np.degrees(found.parallax[i]):.2g} deg)" for i in lost[:SHOWN].tolist())
        missing = f"{len(lost)} landmarks have no place (no VERTEX_XY): {shown}{', ...' if len(lost) > SHOWN else ''}"
        needed = (
            f"rays that cross ahead of the robot at {np.degrees(PARALLAX):.0f} deg, or a VERTEX_XY near the truth, are "
            "needed"
        )
        if not known.any() and not len(graph.observation):
            raise DataError.at(graph.path, f"{BEARING}: {missing}; {needed}", line=int(rays.line[0]))
        notes.append(f"{missing}; {needed}; {int((~known).sum())} bearings are left out")
    kept = Edges(rays.ends[known], rays.measured[known], rays.covariance[known], rays.line[known])
    return kept, np.maximum(distance[known], 1e-3)


def _of_vertices(graph: Graph, rays: Edges) -> Array:
    """Distances (K,) between a bearing's vertices, NaN where these contradict it or one is missing."""
    pose, point = _estimates(graph.pose, rays.ends[:, 0]), _estimates(graph.point, rays.ends[:, 1])
    off = point[:, :2] - pose[:, :2]
    aside = np.abs(wrap_angle(np.arctan2(off[:, 1], off[:, 0]) - pose[:, 2] - rays.measured[:, 0]))
    return np.asarray(np.where(aside < CONTRADICTED, np.hypot(*off.T), np.nan))


def _closures(edges: Edges, ids: IntArray, used: IntArray) -> Closures | None:
    """EDGE_SE2 outside the chain, by their later frame."""
    rest = np.setdiff1d(np.arange(len(edges)), used)
    if not len(rest):
        return None
    at = {int(i): k for k, i in enumerate(ids)}
    frame = np.array([[at[int(a)], at[int(b)]] for a, b in edges.ends[rest]], np.int64)
    order = np.argsort(frame.max(axis=1), kind="stable")
    rest, frame = rest[order], frame[order]
    # the edge's error is seen from its measured end
    covariance = se2.covariances_in_world(edges.measured[rest, 2], edges.covariance[rest])
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    return Closures(
        frame[:, 0], frame[:, 1], edges.measured[rest], covariance, np.zeros(len(rest), np.int64), (MOTION,)
    )


def _changes(graph: Graph, ids: IntArray, used: IntArray) -> list[str]:
    """Notes about differences from the file."""
    notes = []
    loops = len(graph.motion) - len(used)
    if loops:
        notes.append(f"{loops} {MOTION} outside the chain of poses are its closures")
    if len(graph.fixed) and graph.fixed.tolist() != [int(ids[0])]:
        notes.append(f"FIX {' '.join(map(str, graph.fixed.tolist()[:5]))}: the first pose is fixed instead")
    notes += [f"{count} {tag} left out" for tag, count in graph.other.items()]
    return notes
