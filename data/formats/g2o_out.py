"""A log as a g2o graph (`data.formats.g2o` has the format): by its labels, or by the poses and pairings of a run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from data import se2
from data.csv_table import read_table
from data.errors import DataError, UsageError
from data.formats.g2o import BEARING, FIX, MOTION, OBSERVATION, POINT, POSE, POSITION, PRIOR
from data.inputs import Inputs, IntArray
from data.log import Log
from data.pose_measurements import FixKind
from data.se2 import Array


def written(
    poses: tuple[Sequence[int], Array],
    points: tuple[Sequence[int], Array],
    fixed: Iterable[int],
    edges: Iterable[tuple[str, int, int, Array, Array]],
) -> str:
    """Text of a graph from poses and points by id, fixed ids, and edges (tag, id, id, measured (d,), covariance (d,
    d)).

    The covariance of an EDGE_SE2 is that of the additive error in the frame of its start.
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
    # last, because gtsam's reader stops there
    lines += [f"{FIX} {i}" for i in fixed]
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
        if not sensor.locates:
            what = f"the log has observations of {sensor.name} alone"
            raise UsageError(f"{what}; sensors that measure two numbers are needed")


def of_result(log: Log, folder: Path) -> Estimate:
    """The last path, map and final decisions of a run's folder in a report; DataError if a file is missing or of
    another log.
    """
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
    of = np.full(len(inputs.observations.frame), -1, np.int64)
    if len(of):
        file = folder / "decisions.csv"
        decided = read_table(file, ("frame", "decision", "final_decision"), may_be_blank=("final_decision",))
        if not np.array_equal(decided.columns["frame"], inputs.observations.frame):
            raise DataError.at(file, f"its frames are not those of log {log.name!r}; another log's?")
        online, final = (decided.columns[c].astype(np.int64) for c in ("decision", "final_decision"))
        founded = np.where(online == -1, np.cumsum(online == -1) - 1, -1)
        of = np.where(final >= 0, final, np.where(final == -1, founded, -1))
    known = not (folder / "landmarks.csv").exists()
    if known:
        if inputs.map is None:
            return Estimate(pose, np.full(len(of), -1), {})
        landmark = {int(i): xy for i, xy in zip(inputs.map.id, inputs.map.xy, strict=True)}
        of = decided.columns["final_decision"].astype(np.int64) if len(of) else of
    else:
        if inputs.map is not None and inputs.map.sigma is not None and len(of) and not (online == -1).any():
            what = "the run localized in an uncertain map, and no edge of g2o holds a landmark's place in it"
            raise UsageError(f"{what}; name a run of SLAM, or remove sx and sy from landmarks.csv")
        places = read_table(folder / "landmarks.csv", ("landmark", "x", "y"))
        xy = places.stack(("x", "y"))
        landmark = {int(i): p for i, p in zip(places.columns["landmark"], xy, strict=True)}
    of = np.where(np.isin(of, list(landmark)), of, -1)
    if known or log.granted is None or not (log.granted >= 0).any():
        return Estimate(pose, of, landmark, known)
    ids = _ids(of, landmark, log.granted)
    named = np.array([ids.get(number, -1) for number in of.tolist()], np.int64)
    return Estimate(pose, named, {ids[number]: xy for number, xy in landmark.items()})


def _ids(of: IntArray, landmark: Iterable[int], label: IntArray) -> dict[int, int]:
    """Ids of landmarks by number: the label (M,) of most of their observations; of several with one label, the most
    observed landmark has it, and the others are numbered above all labels.
    """
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
    to first order, or bearings where the range is nearly unknown. Fixes of positions and poses of the body become
    priors. Without them the first pose is fixed, and so are landmarks of a known map. UsageError where landmarks are
    walls.
    """
    _require_points(inputs)
    n, o = len(inputs), inputs.observations
    numbers = sorted(set(estimate.of[estimate.of >= 0].tolist()))
    own = pose_ids(n, estimate) if ids is None else ids
    after = max(own, default=0) + 1
    free = not set(numbers) & set(own)
    vertex = {number: number if free else after + k for k, number in enumerate(numbers)}
    edges = [
        (MOTION, own[k - 1], own[k], inputs.increments.mean[k], inputs.increments.covariance[k]) for k in range(1, n)
    ]
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
    sensor = inputs.sensor_of()
    points, spread = sensor.body_points(o.z, o.R) if len(o.frame) else (o.z, o.R)
    blind = sensor.bearings_alone(o.z, o.R) if len(o.frame) else np.zeros(0, bool)
    for i in np.flatnonzero(estimate.of >= 0).tolist():
        ends = own[int(o.frame[i])], vertex[int(estimate.of[i])]
        if blind[i] and not any(inputs.sensor_at(i).translation):
            bearing = o.z[i, 1] - inputs.sensor_at(i).rotation
            edges.append((BEARING, *ends, np.array([bearing]), o.R[i, 1:, 1:]))
        else:
            edges.append((OBSERVATION, *ends, points[i], spread[i]))
    places = np.array([estimate.landmark[number] for number in numbers]).reshape(-1, 2)
    held = [*(() if tied else own[:1]), *(vertex.values() if estimate.known else ())]
    return written((own, estimate.pose), (list(vertex.values()), places), held, edges)
