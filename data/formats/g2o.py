"""Graphs in the plane as logs. `data.formats.graph_file` reads g2o, Toro and text of gtsam and iSAM, and lists their
tags; logs are written as g2o, by their labels or by the poses and pairings of a run. EDGE_PRIOR_SE2 of the first pose
is the prior.

The error of an EDGE_SE2 is that of the relative pose seen from its measured end, (R(dtheta)' (t - t_measured),
theta - theta_measured); errors of landmark edges are additive (g2o's types_slam2d).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise
from pathlib import Path

import numpy as np

from data import se2
from data.columns.named import definite
from data.csv_table import read_table
from data.digest import source_file
from data.errors import LARGEST, DataError, UsageError
from data.formats import graph_file
from data.formats.recordings.laser import FLOOR
from data.formats.results.tables import companions
from data.inputs import Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.origin import Origin
from data.pose_measurements import Closures, Fixes, FixKind, FixSource
from data.se2 import Array, BoolArray, compose, inverse, wrap_angle
from data.sensors import Bearing, Range, RangeBearing, RelativePoint, Sensor
from data.truth import Truth

POSE, POINT, FIX = "VERTEX_SE2", "VERTEX_XY", "FIX"
MOTION, OBSERVATION, BEARING, RANGE = "EDGE_SE2", "EDGE_SE2_XY", graph_file.BEARING, graph_file.RANGE
PRIOR, POSITION, RANGED = "EDGE_PRIOR_SE2", "EDGE_PRIOR_SE2_XY", "BR"
KINDS = {"motion": 3, "observation": 2, "bearing": 1, "range": 1, "polar": 2, "prior": 3, "position": 2}
"""Edges of a graph, and what they measure."""


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges of a kind: ends (K, 2) ids, measured (K, d), covariance (K, d, d), line (K,), bare (K,): none is stated."""

    ends: IntArray
    measured: Array
    covariance: Array
    line: IntArray
    bare: BoolArray

    def __len__(self) -> int:
        return len(self.ends)

    def only(self, rows: IntArray | BoolArray) -> Edges:
        """The edges in some rows."""
        return Edges(self.ends[rows], self.measured[rows], self.covariance[rows], self.line[rows], self.bare[rows])

    def in_world(self) -> Array:
        """Covariances (K, 3, 3) in the frame of the start; errors of edges are seen from the measured end."""
        P = se2.covariances_in_world(self.measured[:, 2], self.covariance)
        return np.asarray(0.5 * (P + P.transpose(0, 2, 1)))


@dataclass(frozen=True, eq=False)
class Graph:
    """A graph in the plane: its file, and edges by what they measure."""

    file: graph_file.GraphFile
    motion: Edges
    observation: Edges
    bearing: Edges
    range: Edges
    polar: Edges  # range and bearing
    prior: Edges  # poses, with both ends the same
    position: Edges  # positions of poses, the same

    @property
    def seen(self) -> tuple[tuple[type[Sensor], Edges], ...]:
        """Edges to landmarks, and the sensors that measure so."""
        kinds = (RelativePoint, RangeBearing, Bearing, Range)
        return tuple(zip(kinds, (self.observation, self.polar, self.bearing, self.range), strict=True))


def read_graph(path: Path, noise: str | None = None) -> Graph:
    """Read a graph; `noise` as of `read_graph_file`. Raises DataError for what `read_graph_file` refuses, a vertex that
    is a pose and a landmark, or a graph in space.
    """
    file = graph_file.read_graph_file(path, noise, bare=True)
    kinds = {kind for kind, _ in (*file.poses.values(), *file.points.values())}
    if any({graph_file.POSE3, graph_file.POINT3} & some for some in (kinds, *(set(file.kind(e)) for e in file.edges))):
        raise DataError.at(path, f"a graph in space; a graph in the plane ({POSE}) is needed")
    if both := sorted(file.poses.keys() & file.points.keys()):
        raise DataError.at(path, f"vertex {both[0]} is repeated; ids must be unique")
    found: dict[str, list[graph_file.Edge]] = {name: [] for name in KINDS}
    for e in file.edges:
        point = "observation" if file.kind(e)[1] == graph_file.POINT2 else "motion"
        found[{BEARING: "bearing", RANGE: "range", RANGED: "polar"}.get(e.tag, point)].append(e)
    for e in file.priors:
        found["prior" if e.tag == PRIOR else "position"].append(e)
    edges = {name: _edges(path, found[name], d) for name, d in KINDS.items()}
    polar = edges["polar"]
    edges["polar"] = replace(polar, measured=polar.measured[:, ::-1], covariance=polar.covariance[:, ::-1, ::-1])
    return Graph(file, **edges)


def _edges(path: Path, found: Sequence[graph_file.Edge], d: int) -> Edges:
    ends, measured = np.array([e.ends for e in found], np.int64), np.array([e.measured for e in found])
    with np.errstate(over="ignore"):
        covariance = np.linalg.inv(np.array([e.information for e in found]).reshape(-1, d, d)).astype(np.float64)
    for edge, P in zip(found, covariance, strict=True):
        if not (np.abs(P) <= LARGEST).all():
            what = f"{edge.tag}: its information is nearly none; variances up to {LARGEST:g} are needed"
            raise DataError.at(path, what, line=edge.line)
    line = np.array([e.line for e in found], np.int64)
    bare = np.array([e.origin is Origin.ASSUMED for e in found], bool)
    return Edges(ends.reshape(-1, 2), measured.reshape(-1, d), covariance, line, bare)


POSE_IDS = "pose_ids"  # Key of a log's source: ids of the vertices of its frames, where these are not 0 to N - 1


def log_of(name: str, graph: Graph, *, true: bool = False) -> Log:
    """The log of a graph; `true`: its vertices are the true values.

    Frames are the poses by id, or in the order of vertices if only these have edges from each to the next. The first
    EDGE_SE2 between neighbours, in either direction, is the motion; every other one becomes a closure. Labels are
    landmark ids. The first pose is fixed at its vertex.

    Raises DataError for neighbours without an edge, an edge without its vertex, or no pose.
    """
    ids = _frames(graph)
    mean, covariance, used = _chain(graph, ids)
    covariance, floored = floor_covariances(covariance, FLOOR)
    unknown = ("", np.full(3, np.nan))
    vertex = np.array([graph.file.poses.get(i, unknown)[1] for i in ids.tolist()])
    start = vertex[0] if np.isfinite(vertex[0]).all() else np.zeros(3)
    if not graph.file.listed and len(row := np.flatnonzero(np.isfinite(vertex[:, 0]))):
        start = compose(vertex[row[0]], inverse(se2.dead_reckoned(np.zeros(3), mean)[row[0]]))
    observations, label, sensors = _observations(graph, ids)
    origins: dict[str, Origin] = {"max_range": Origin.INFERRED} if len(label) else {}
    landmarks = None
    if true and graph.file.points:
        points = sorted(graph.file.points.items())
        landmarks = LandmarkMap(np.array([i for i, _ in points], np.int64), np.array([xy for _, (_, xy) in points]))
    inputs = Inputs(
        prior=_prior(graph, ids, start, origins), time=np.arange(len(ids), dtype=float),
        increments=Increments(mean, covariance), observations=observations,
        sensor=sensors[0] if sensors else RelativePoint(), sensors=sensors if len(sensors) > 1 else (), map=landmarks,
        time_is_index=True, covariance_floor=FLOOR, floored=floored, closures=_closures(graph, ids, used),
        fixes=_fixes(graph, ids),
    )  # fmt: skip
    truth = Truth(pose=vertex if true else None, landmarks=landmarks, landmark_of=label if true else None)
    source: dict[str, object] = {"kind": "g2o", **source_file(graph.file.path)}
    if ids.tolist() != list(range(len(ids))):
        source[POSE_IDS] = ids.tolist()
    chain = np.isin(np.arange(len(graph.motion)), used)
    bare = {
        "odometry_noise": graph.motion.bare[chain], "closure_noise": graph.motion.bare[~chain],
        "observation_noise": np.concatenate([e.bare for _, e in graph.seen]),
        "fix_noise": np.append(graph.prior.bare, graph.position.bare),
    }  # fmt: skip
    origins |= {quantity: Origin.ASSUMED for quantity, which in bare.items() if which.any()}
    return Log(
        name, inputs, truth, label=label if len(label) and not true else None, source=source,
        notes=tuple(_changes(graph, ids, used)), origins=origins,
    )  # fmt: skip


def _frames(graph: Graph) -> IntArray:
    """Pose ids (N,) in the order of frames."""
    ends = [graph.motion.ends.ravel(), *(e.ends[:, 0] for _, e in graph.seen)]
    ids = np.array(list(graph.file.poses), np.int64) if graph.file.listed else np.unique(np.concatenate(ends))
    if len(ids) == 0:
        raise DataError.at(graph.file.path, "no pose: neither VERTEX_SE2 nor EDGE_SE2")
    for edges, columns in ((graph.motion, 2), *((e, 1) for _, e in graph.seen)):
        for i in np.setdiff1d(edges.ends[:, :columns], ids):
            line = int(edges.line[(edges.ends == i).any(axis=1)][0])
            raise DataError.at(graph.file.path, f"no VERTEX_SE2 {i}; this edge ends there", line=line)
    joined = {(a, b) for pair in graph.motion.ends.tolist() for a, b in (pair, pair[::-1])}
    ordered = np.sort(ids)
    return ordered if _in_a_row(ordered, joined) or not _in_a_row(ids, joined) else ids


def _in_a_row(ids: IntArray, joined: set[tuple[int, int]]) -> bool:
    """Whether each two successive poses have an edge."""
    return all(pair in joined for pair in pairwise(ids.tolist()))


VAGUE = (10.0, 10.0, 0.5)  # m, m, rad: standard deviations of the first pose where measured poses tell the place


def _prior(graph: Graph, ids: IntArray, start: Array, origins: dict[str, Origin]) -> Prior:
    """Of the first pose: its EDGE_PRIOR_SE2 unless it is fixed; vague where others are measured; else exact."""
    own = graph.prior.only(_own_prior(graph, ids))
    if len(own):
        return Prior(own.measured[0], own.in_world()[0])
    if int(ids[0]) in graph.file.fixed or not len(graph.prior) + len(graph.position):
        return Prior(start, np.zeros((3, 3)))
    origins["prior"] = Origin.ASSUMED
    return Prior(start, np.diag(np.square(VAGUE)))


def _own_prior(graph: Graph, ids: IntArray) -> IntArray:
    """Row of the measured pose that is the prior of the first one, if there is one."""
    return np.flatnonzero(graph.prior.ends[:, 0] == ids[0])[:1][: int(ids[0]) not in graph.file.fixed]


def _frame_of(ids: IntArray, vertex: IntArray) -> IntArray:
    """The frames of vertices, by the ids (N,) of all frames."""
    order = np.argsort(ids)
    return order[np.searchsorted(ids, vertex, sorter=order)].astype(np.int64)


def _require_definite(graph: Graph, tag: str, edges: Edges, P: Array) -> None:
    fine = definite(P)
    if not fine.all():
        what = f"{tag}: its covariance is singular to rounding; directions of similar information are needed"
        raise DataError.at(graph.file.path, what, line=int(edges.line[np.argmin(fine)]))


def _fixes(graph: Graph, ids: IntArray) -> Fixes | None:
    """Measured poses and positions besides the prior."""
    pose, position = graph.prior.only(np.delete(np.arange(len(graph.prior)), _own_prior(graph, ids))), graph.position
    n, count = len(pose), len(pose) + len(position)
    if not count:
        return None
    z, P = np.zeros((count, 3)), np.zeros((count, 3, 3))
    z[:n], z[n:, :2] = pose.measured, position.measured
    P[:n], P[n:, :2, :2] = pose.in_world(), position.covariance
    P = 0.5 * (P + P.transpose(0, 2, 1))
    _require_definite(graph, PRIOR, pose, P[:n])
    frame = _frame_of(ids, np.concatenate([pose.ends[:, 0], position.ends[:, 0]]))
    source = np.repeat([0, 1], [n, len(position)])
    kind = np.array([FixKind.POSE, FixKind.POSITION], np.int64)[source]
    order = np.argsort(frame, kind="stable")
    return Fixes(frame[order], kind[order], source[order], z[order], P[order], (FixSource(PRIOR), FixSource(POSITION)))


def _chain(graph: Graph, ids: IntArray) -> tuple[Array, Array, IntArray]:
    """Increments (N, 3), covariances (N, 3, 3), and numbers (N - 1,) of their edges."""
    edges, n = graph.motion, len(ids)
    ends = _frame_of(ids, edges.ends)
    near = np.flatnonzero(np.abs(ends[:, 0] - ends[:, 1]) == 1)
    into, first = np.unique(ends[near].max(axis=1), return_index=True)
    for k in np.setdiff1d(np.arange(1, n), into)[:1].tolist():
        what = f"no {MOTION} between the successive poses {ids[k - 1]} and {ids[k]}; a log needs that motion, "
        raise DataError.at(graph.file.path, f"{what}slamref audit {graph.file.path.name} does not")
    mean, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
    used = near[first]
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


def _observations(graph: Graph, ids: IntArray) -> tuple[Observations, IntArray, tuple[Sensor, ...]]:
    """Observations by frame, their labels (M,), and a sensor of each kind that there is."""
    kinds: list[tuple[type[Sensor], Edges, Array, Array]] = []
    for kind, e in (k for k in graph.seen if len(k[1])):
        z, R, own = np.zeros((len(e), 2)), np.tile(np.eye(2), (len(e), 1, 1)), list(kind.measures)
        i, j = np.ix_(own, own)
        z[:, own], R[:, i, j] = e.measured, e.covariance
        kinds.append((kind, e, z, R))
    if not kinds:
        return Observations(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2))), np.zeros(0, np.int64), ()
    pose, label = np.concatenate([e.ends for _, e, _, _ in kinds]).T
    frame, which = _frame_of(ids, pose), np.repeat(np.arange(len(kinds)), [len(e) for _, e, _, _ in kinds])
    order = np.lexsort((which, frame))
    z, R = (np.concatenate([k[part] for k in kinds])[order] for part in (2, 3))
    sensors = []
    for kind, _, measured, _ in kinds:
        reach = float(kind().polar(measured)[:, 0].max(initial=0.0))
        sensors.append(kind(max_range=1.001 * reach if reach > 0.0 else np.inf))
    sensor = which[order].astype(np.int64) if len(kinds) > 1 else None
    return Observations(frame[order], z, R, sensor=sensor), label[order], tuple(sensors)


def _closures(graph: Graph, ids: IntArray, used: IntArray) -> Closures | None:
    """EDGE_SE2 outside the chain, by their later frame."""
    rest = graph.motion.only(np.setdiff1d(np.arange(len(graph.motion)), used))
    if not len(rest):
        return None
    rest = rest.only(np.argsort(_frame_of(ids, rest.ends).max(axis=1), kind="stable"))
    first, last = _frame_of(ids, rest.ends).T
    covariance = rest.in_world()
    _require_definite(graph, MOTION, rest, covariance)
    return Closures(first, last, rest.measured, covariance, np.zeros(len(rest), np.int64), (MOTION,))


def _changes(graph: Graph, ids: IntArray, used: IntArray) -> list[str]:
    one = len(graph.file.poses) * (not graph.file.listed)
    notes = ["One pose has a line; the others begin where the edges put them"] * one
    if loops := len(graph.motion) - len(used):
        notes.append(f"{loops} {MOTION} outside the chain of poses are its closures")
    if graph.file.fixed and graph.file.fixed != [int(ids[0])]:
        notes.append(f"FIX {' '.join(map(str, graph.file.fixed[:5]))}: the first pose is fixed instead")
    if graph.file.noise:
        others = " or ".join(n for n in graph_file.NOISES if n != graph.file.noise)
        notes.append(f"The noise of text is taken as {graph.file.noise}; --noise {others} reads another")
    notes += [f"{count} {tag} left out" for tag, count in graph.file.other.items()]
    return notes


def written(
    poses: tuple[Sequence[int], Array], points: tuple[Sequence[int], Array], fixed: Iterable[int],
    edges: Iterable[tuple[str, int, int, Array, Array]],
) -> str:  # fmt: skip
    """Text of a graph: poses and points by id, fixed ids, edges (tag, id, id, measured (d,), covariance (d, d)); that
    of an EDGE_SE2 is of the additive error in the frame of its start.
    """
    lines = [_line(POSE, [i], p) for i, p in zip(*poses, strict=True)]
    lines += [_line(POINT, [i], p) for i, p in zip(*points, strict=True)]
    for tag, a, b, measured, covariance in edges:
        P = np.atleast_2d(covariance)
        if tag in (MOTION, PRIOR):  # g2o's error is in the frame of the edge's end
            P = se2.covariances_in_body(measured[None, 2], P[None])[0]
        information = np.linalg.inv(P)
        ends = [a] if tag in (PRIOR, POSITION) else [a, b]
        lines.append(_line(tag, ends, [*np.ravel(measured), *information[np.triu_indices(len(P))]]))
    lines += [f"{FIX} {i}" for i in fixed]  # last, because gtsam's reader stops there
    return "\n".join(lines) + "\n"


def _line(tag: str, ids: Sequence[int], values: Iterable[float]) -> str:
    return " ".join([tag, *map(str, ids), *(repr(float(v)) for v in values)])


@dataclass(frozen=True, eq=False)
class Estimate:
    """The vertices to write: pose (N, 3), landmark number `of` (M,) of each observation or -1, landmark by number."""

    pose: Array
    of: IntArray
    landmark: dict[int, Array]
    known: bool = False


def labelled(log: Log) -> Estimate:
    """Dead reckoning, pairings by label, and each landmark from its first observation; UsageError without labels."""
    label, inputs = log.granted, log.recorded
    if label is None and len(inputs.observations.frame):
        raise UsageError(f"log {log.name!r} has no labels, so its landmarks are unknown; name a run with --run FOLDER")
    _require_points(inputs)
    if not all(s.locates for s in inputs.sensors or (inputs.sensor,)):
        what = "has bearings or ranges alone, which locate no landmarks; name a run with --run FOLDER"
        raise UsageError(f"log {log.name!r} {what}")
    pose = se2.dead_reckoned(inputs.prior.mean, inputs.increments.mean)
    of = np.zeros(0, np.int64) if label is None else np.maximum(label, -1)
    landmark: dict[int, Array] = {}
    for number, i in zip(*np.unique(of, return_index=True), strict=True):
        if number >= 0:
            xy, _, _ = inputs.sensor_at(i).inverse(pose[inputs.observations.frame[i]], inputs.observations.z[i][None])
            landmark[int(number)] = xy[0]
    return Estimate(pose, of, landmark)


def _require_points(inputs: Inputs) -> None:
    """UsageError for observations that no edge of ours holds."""
    if not inputs.sensor.sees_points:
        raise UsageError("the log's landmarks are walls, which g2o has no vertex for; a log of points is needed")
    for sensor in inputs.sensors or (inputs.sensor,):
        if not sensor.locates and any(sensor.translation):
            what = f"the log has observations of {sensor.name} alone"
            raise UsageError(f"{what}; sensors that measure two numbers are needed")


def of_result(log: Log, folder: Path) -> Estimate:
    """Last path, map and final decisions of a run's folder; DataError if a file is missing or of another log."""
    inputs = log.recorded
    path = next((p for p in (folder / "final.csv", folder / "online.csv") if p.exists()), None)
    if path is None:
        raise DataError.at(folder, "neither final.csv nor online.csv; the folder of one run in a report is needed")
    table = read_table(path, ("x", "y", "theta"), may_be_blank=("x", "y", "theta"))
    if len(table) != len(inputs):
        raise DataError.at(path, f"{len(table)} rows for the {len(inputs)} frames of log {log.name!r}; another log's?")
    pose = table.stack(("x", "y", "theta"))
    if not np.isfinite(pose).all():
        raise DataError.at(path, "poses are missing; a run that finished is needed")
    beside, file = companions(folder), folder / "decisions.csv"
    of = final = np.full(len(inputs.observations.frame), -1, np.int64)
    if len(of):
        if beside.decisions is None:
            raise DataError.at(file, "no such file; the decisions of the run are needed")
        frame, _, online, final = beside.decisions[:, :4].T
        if not np.array_equal(frame, inputs.observations.frame):
            raise DataError.at(file, f"its frames are not those of log {log.name!r}; another log's?")
        founded = np.where(online == -1, np.cumsum(online == -1) - 1, -1)
        of = np.where(final >= 0, final, np.where(final == -1, founded, -1))
    known = beside.landmarks is None
    if beside.landmarks is None:
        if inputs.map is None:
            return Estimate(pose, np.full(len(of), -1), {})
        landmark, of = dict(zip(inputs.map.id.tolist(), inputs.map.xy, strict=True)), final
    else:
        if inputs.map is not None and inputs.map.sigma is not None and len(of) and not (online == -1).any():
            what = "the run localized in an uncertain map, and no edge of g2o holds a landmark's place in it"
            raise UsageError(f"{what}; name a run of SLAM, or remove sx and sy from landmarks.csv")
        landmark = dict(zip(beside.landmarks.number.tolist(), beside.landmarks.xy, strict=True))
    of = np.where(np.isin(of, list(landmark)), of, -1)
    if known or log.granted is None or not (log.granted >= 0).any():
        return Estimate(pose, of, landmark, known)
    ids = _ids(of, landmark, log.granted)
    named = np.array([ids.get(number, -1) for number in of.tolist()], np.int64)
    return Estimate(pose, named, {ids[number]: xy for number, xy in landmark.items()})


def _ids(of: IntArray, landmark: Iterable[int], label: IntArray) -> dict[int, int]:
    """Ids of landmarks: the label (M,) of most of their observations; of several the most observed one has it."""
    both = (of >= 0) & (label >= 0)
    pairs, times = np.unique(np.stack([of[both], label[both]]), axis=1, return_counts=True)
    ids: dict[int, int] = {}
    for number, name in pairs.T[np.argsort(-times, kind="stable")].tolist():
        if number not in ids and name not in ids.values():
            ids[number] = name
    free = count(int(label.max()) + 1)
    return {number: ids[number] if number in ids else next(free) for number in landmark}


def pose_ids(frames: int, estimate: Estimate) -> range:
    """Ids of the poses beside landmarks that keep their numbers: from 0, or above these where they would coincide."""
    numbers = estimate.of[estimate.of >= 0]
    first = int(numbers.max()) + 1 if len(numbers) and numbers.min() < frames else 0
    return range(first, first + frames)


def graph_text(inputs: Inputs, estimate: Estimate, ids: Sequence[int] | None = None) -> str:
    """The graph of poses `ids` (default: `pose_ids`), landmarks under their numbers, and closures.

    Landmarks whose numbers are among the given ids follow these instead. Observations become points in the body frame,
    to first order, or bearings. Fixes of positions and poses of the body become priors. Without them the first pose is
    fixed, and so are landmarks of a known map. UsageError where landmarks are walls.
    """
    _require_points(inputs)
    n, o = len(inputs), inputs.observations
    numbers = sorted(set(estimate.of[estimate.of >= 0].tolist()))
    own = pose_ids(n, estimate) if ids is None else ids
    after = max(own, default=0) + 1
    free = not set(numbers) & set(own)
    vertex = {number: number if free else after + k for k, number in enumerate(numbers)}
    steps = inputs.increments
    edges = [(MOTION, own[k - 1], own[k], steps.mean[k], steps.covariance[k]) for k in range(1, n)]
    if inputs.closures is not None:
        c = inputs.closures
        measured = zip(c.frame1.tolist(), c.frame2.tolist(), c.relative, c.covariance, strict=True)
        edges += [(MOTION, own[i], own[j], relative, P) for i, j, relative, P in measured]
    prior, f, rows = inputs.prior, inputs.fixes, list[int]()
    if f is not None:  # g2o has edges for poses and positions of the body itself
        body = np.array([not any(s.lever) and not s.rotation for s in f.sources])
        rows = np.flatnonzero((f.kind != FixKind.HEADING) & body[f.source]).tolist()
    tied = bool(rows) and bool(np.linalg.eigvalsh(prior.covariance)[0] > 0.0)
    if tied:
        edges.append((PRIOR, own[0], own[0], prior.mean, prior.covariance))
    for k in rows:
        assert f is not None  # it has rows
        tag, d = (PRIOR, 3) if f.kind[k] == FixKind.POSE else (POSITION, 2)
        edges.append((tag, own[f.frame[k]], own[f.frame[k]], f.z[k, :d], f.covariance[k, :d, :d]))
    points, spread = inputs.sensor_of().body_points(o.z, o.R) if len(o.frame) else (o.z, o.R)
    sure = definite(spread)  # to first order a landmark at no distance has no spread across
    for i in np.flatnonzero(estimate.of >= 0).tolist():
        ends = own[int(o.frame[i])], vertex[int(estimate.of[i])]
        if not (by := inputs.sensor_at(i)).locates:
            (k,) = by.measures  # 0 of ranges, 1 of bearings
            value = np.array([o.z[i, k] - k * by.rotation])
            edges.append((BEARING if k else RANGE, *ends, value, o.R[i, k : k + 1, k : k + 1]))
        elif sure[i]:
            edges.append((OBSERVATION, *ends, points[i], spread[i]))
    places = np.array([estimate.landmark[number] for number in numbers]).reshape(-1, 2)
    held = [*(() if tied else own[:1]), *(vertex.values() if estimate.known else ())]
    return written((own, estimate.pose), (list(vertex.values()), places), held, edges)
