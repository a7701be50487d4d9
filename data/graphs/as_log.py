"""A g2o graph as a log: its chain of poses is the odometry, its landmark edges are labelled readings."""

from __future__ import annotations

import numpy as np

from data.errors import DataError
from data.graphs.g2o import BEARING, MOTION, SIGHTING, Edges, Graph, turned
from data.inputs import Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.floor import floor_covariances
from data.recordings.wheel_odometry import FLOOR
from data.se2 import Array, inverse, wrap_angle
from data.sensors import RangeBearing, RelativePoint, Sensor
from data.truth import Relations, Truth

UNSEEN = 100.0
"""Standard deviations of a range that was not measured, in units of the range that the vertices give: it has 1e-4 of
the information of a range known to its own length."""


def log_of(name: str, graph: Graph, *, true: bool = False) -> Log:
    """The log; `true`: the vertices are the true values, not estimates.

    Frames are the poses in the order of their vertices (by id where the file has none). The first EDGE_SE2 between
    neighbours, in either direction, is the motion; every other EDGE_SE2 becomes a reference relation, by which the
    result is scored and which no estimator sees. Landmarks keep their ids as labels. A bearing without a range becomes
    a reading whose range is as good as unknown. The first pose is fixed, where its vertex says.

    Raises:
        DataError: neighbours without an edge, an edge of a vertex that is not there, no pose.
    """
    ids = _frames(graph)
    notes: list[str] = []
    mean, covariance, used = _chain(graph, ids)
    covariance, floored = floor_covariances(covariance, FLOOR)
    vertex = _estimates(graph.pose, ids)
    frame, label, z, R, sensor = _readings(graph, ids, notes)
    start = vertex[0] if np.isfinite(vertex[0]).all() else np.zeros(3)
    notes += _said(graph, ids, used)
    relations = _relations(graph.motion, ids, used)
    landmarks = None
    if true and len(graph.point[0]):
        order = np.argsort(graph.point[0])
        landmarks = LandmarkMap(graph.point[0][order], graph.point[1][order])
    inputs = Inputs(
        prior=Prior(start, np.zeros((3, 3))),
        time=np.arange(len(ids), dtype=float),
        increments=Increments(mean, covariance),
        observations=Observations(frame, z, R),
        sensor=sensor,
        map=landmarks,
        time_is_index=True,
        covariance_floor=FLOOR,
        floored=floored,
    )
    truth = Truth(
        pose=vertex if true else None, landmarks=landmarks, landmark_of=label if true else None, relations=relations
    )
    source = {"kind": "g2o", "path": str(graph.path.absolute())}
    return Log(name, inputs, truth, label=label if len(label) and not true else None, source=source, notes=tuple(notes))


def _frames(graph: Graph) -> IntArray:
    """Pose ids (N,) in the order of frames."""
    ends = [graph.motion.ends.ravel(), graph.sighting.ends[:, 0], graph.bearing.ends[:, 0]]
    ids = graph.pose[0] if len(graph.pose[0]) else np.unique(np.concatenate(ends))
    if len(ids) == 0:
        raise DataError.at(graph.path, "no pose: neither VERTEX_SE2 nor EDGE_SE2")
    strange = [(int(e), edges) for edges in (graph.motion,) for e in np.setdiff1d(edges.ends, ids)]
    strange += [
        (int(e), edges) for edges in (graph.sighting, graph.bearing) for e in np.setdiff1d(edges.ends[:, 0], ids)
    ]
    for i, edges in strange:
        line = int(edges.line[(edges.ends == i).any(axis=1)][0])
        raise DataError.at(graph.path, f"no VERTEX_SE2 {i}, at which this edge ends", line=line)
    return ids


def _estimates(vertices: tuple[IntArray, Array], ids: IntArray) -> Array:
    """Values of vertices by id, NaN where there is none."""
    rows = {int(i): value for i, value in zip(*vertices, strict=True)}
    width = vertices[1].shape[1]
    found = np.full((len(ids), width), np.nan)
    for k, i in enumerate(ids.tolist()):
        found[k] = rows.get(i, np.nan)
    return found


def _chain(graph: Graph, ids: IntArray) -> tuple[Array, Array, IntArray]:
    """Increments (N, 3), their covariances (N, 3, 3), and the numbers (N - 1,) of the edges they are."""
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
    motion, P = edges.measured[used].copy(), turned(edges.measured[used], edges.covariance[used])
    back = edges.ends[used, 0] != ids[:-1]
    if back.any():
        # the inverse motion's additive error, to first order: J of (x, y, theta) -> inverse
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


def _readings(graph: Graph, ids: IntArray, notes: list[str]) -> tuple[IntArray, IntArray, Array, Array, Sensor]:
    """Frame (M,), label (M,), z (M, 2), R (M, 2, 2) by frame, and the sensor: points, or ranges with bearings."""
    at = {int(i): k for k, i in enumerate(ids)}
    points, rays = graph.sighting, graph.bearing
    frame = np.array([at[int(i)] for i in [*points.ends[:, 0], *rays.ends[:, 0]]], np.int64)
    label = np.concatenate([points.ends[:, 1], rays.ends[:, 1]])
    z, R = points.measured, points.covariance
    kind: type[Sensor] = RelativePoint
    if len(rays):
        kind = RangeBearing
        z, R = _polar(z, R)
        guess = _ranges(graph, rays)
        far = np.zeros((len(rays), 2, 2))
        far[:, 0, 0], far[:, 1, 1] = (UNSEEN * guess) ** 2, rays.covariance[:, 0, 0]
        z = np.concatenate([z, np.stack([guess, rays.measured[:, 0]], axis=1)])
        R = np.concatenate([R, far])
        notes.append(
            f"{len(rays)} bearings without a range ({BEARING}): the range is that of the file's vertices, with a "
            f"standard deviation {UNSEEN:g} times as large"
        )
        if len(points):
            notes.append(f"{len(points)} points ({SIGHTING}) became ranges and bearings, to first order")
    order = np.argsort(frame, kind="stable")
    reach = float(kind().polar(z)[:, 0].max(initial=0.0))
    if len(rays) or len(points):
        notes.append(f"max_range is {1.001 * reach:.4g} m, the farthest reading: a graph states no field of view")
    sensor = kind(max_range=1.001 * reach if reach > 0.0 else np.inf)
    return frame[order], label[order], z[order], R[order], sensor


def _polar(z: Array, R: Array) -> tuple[Array, Array]:
    """Points (K, 2) with covariances as range and bearing, to first order."""
    r = np.maximum(np.hypot(z[:, 0], z[:, 1]), 1e-9)
    J = np.empty((len(z), 2, 2))
    J[:, 0], J[:, 1] = z / r[:, None], np.stack([-z[:, 1], z[:, 0]], axis=1) / (r**2)[:, None]
    return np.stack([r, np.arctan2(z[:, 1], z[:, 0])], axis=1), J @ R @ J.transpose(0, 2, 1)


def _ranges(graph: Graph, rays: Edges) -> Array:
    """Distances (K,) of bearings' ends by the file's vertices."""
    pose, point = _estimates(graph.pose, rays.ends[:, 0]), _estimates(graph.point, rays.ends[:, 1])
    missing = ~(np.isfinite(pose).all(axis=1) & np.isfinite(point).all(axis=1))
    if missing.any():
        k = int(np.argmax(missing))
        what = f"{BEARING} of landmark {rays.ends[k, 1]}, which has no VERTEX_XY: without it nothing says how far it is"
        raise DataError.at(graph.path, what, line=int(rays.line[k]))
    ranges: Array = np.maximum(np.hypot(*(point - pose[:, :2]).T), 1e-3)
    return ranges


def _relations(edges: Edges, ids: IntArray, used: IntArray) -> Relations | None:
    """EDGE_SE2 that are no part of the chain."""
    rest = np.setdiff1d(np.arange(len(edges)), used)
    if not len(rest):
        return None
    at = {int(i): k for k, i in enumerate(ids)}
    rows = np.array([[at[int(a)], at[int(b)]] for a, b in edges.ends[rest]], np.int64)
    return Relations(rows[:, 0], rows[:, 1], edges.measured[rest])


def _said(graph: Graph, ids: IntArray, used: IntArray) -> list[str]:
    """What is not as it stands in the file."""
    notes = []
    loops = len(graph.motion) - len(used)
    if loops:
        notes.append(
            f"{loops} {MOTION} besides the chain of successive poses (loop closures) became reference relations: "
            "results are scored by them, and no estimator sees them"
        )
    if len(graph.fixed) and graph.fixed.tolist() != [int(ids[0])]:
        notes.append(
            f"FIX {' '.join(map(str, graph.fixed.tolist()[:5]))}: the first pose is fixed instead, which is another "
            "frame of the same shape"
        )
    notes += [f"{count} {tag} left out" for tag, count in graph.other.items()]
    return notes
