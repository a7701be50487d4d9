"""A log with decisions as a g2o graph: its poses in a chain, its landmarks, an edge for every pairing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data import se2
from data.errors import DataError, UsageError
from data.graphs.g2o import BEARING, MOTION, SIGHTING, written
from data.inputs import Inputs, IntArray
from data.log import Log
from data.open_log.csv_table import read_table
from data.se2 import Array
from data.sensors import RANGE_BEARING

BLIND = 10.0
"""A range whose sigma is so many times the range itself is none: the edge is a bearing alone."""
Edge = tuple[str, int, int, Array, Array]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What becomes the vertices: pose (N, 3), of (M,) the landmark number of each reading or -1, landmark by number."""

    pose: Array
    of: IntArray
    landmark: dict[int, Array]
    known: bool = False


def labelled(log: Log) -> Estimate:
    """Dead reckoning, pairings by label, and each landmark where its first reading puts it.

    Raises:
        UsageError: the log has no labels.
    """
    label, inputs = log.granted, log.recorded
    if label is None and len(inputs.observations.frame):
        raise UsageError(f"log {log.name!r} has no labels, so nobody knows its landmarks; name a run with --run FOLDER")
    label = np.zeros(0, np.int64) if label is None else label
    pose = se2.dead_reckoned(inputs.prior.mean, inputs.increments.mean)
    of = np.where(label >= 0, label, -1)
    landmark: dict[int, Array] = {}
    for i in np.flatnonzero(of >= 0).tolist():
        if int(of[i]) not in landmark:
            xy, _, _ = inputs.sensor.inverse(pose[inputs.observations.frame[i]], inputs.observations.z[i][None])
            landmark[int(of[i])] = xy[0]
    return Estimate(pose, of, landmark)


def of_result(log: Log, folder: Path) -> Estimate:
    """The last path, the map and the final decisions of `runs/<log>/<task>-<estimator>-<association>/` of a report.

    Raises:
        DataError: a file is missing, or is of another log.
    """
    inputs = log.recorded
    path = next((p for p in (folder / "final.csv", folder / "online.csv") if p.exists()), None)
    if path is None:
        raise DataError.at(folder, "neither final.csv nor online.csv: the folder of one run in a report is needed")
    table = read_table(path, ("x", "y", "theta"), may_be_blank=("x", "y", "theta"))
    if len(table) != len(inputs):
        raise DataError.at(path, f"{len(table)} rows for the {len(inputs)} frames of log {log.name!r}; another log's?")
    pose = table.stack(("x", "y", "theta"))
    if not np.isfinite(pose).all():
        raise DataError.at(path, "poses are missing: the run did not get to its end")
    of = np.full(len(inputs.observations.frame), -1, np.int64)
    if len(of):
        decided = read_table(
            folder / "decisions.csv", ("frame", "decision", "final_decision"), may_be_blank=("final_decision",)
        )
        if not np.array_equal(decided.columns["frame"], inputs.observations.frame):
            raise DataError.at(
                folder / "decisions.csv", f"its frames are not those of log {log.name!r}; another log's?"
            )
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
        places = read_table(folder / "landmarks.csv", ("landmark", "x", "y"))
        xy = places.stack(("x", "y"))
        landmark = {int(i): p for i, p in zip(places.columns["landmark"], xy, strict=True)}
    of = np.where(np.isin(of, list(landmark)), of, -1)
    return Estimate(pose, of, landmark, known)


def graph_text(inputs: Inputs, estimate: Estimate) -> str:
    """The graph; poses have the ids 0 to N - 1, landmarks those after them in the order of their numbers.

    Readings become points in the body frame (to first order, where they are ranges and bearings), or bearings alone
    where the range is as good as unknown. The first pose is fixed, and of a known map its landmarks.
    Raises UsageError where landmarks are walls.
    """
    if not inputs.sensor.sees_points:
        raise UsageError("the log's landmarks are walls; g2o has no vertex for a wall")
    n, o = len(inputs), inputs.observations
    numbers = sorted(set(estimate.of[estimate.of >= 0].tolist()))
    vertex = {number: n + k for k, number in enumerate(numbers)}
    edges: list[Edge] = [
        (MOTION, k - 1, k, inputs.increments.mean[k], inputs.increments.covariance[k]) for k in range(1, n)
    ]
    points, spread = inputs.sensor.body_points(o.z, o.R) if len(o.frame) else (o.z, o.R)
    blind = np.zeros(len(o.frame), bool)
    if inputs.sensor.kind == RANGE_BEARING and not any(inputs.sensor.translation):
        blind = np.sqrt(o.R[:, 0, 0]) > BLIND * o.z[:, 0]
    for i in np.flatnonzero(estimate.of >= 0).tolist():
        ends = int(o.frame[i]), vertex[int(estimate.of[i])]
        if blind[i]:
            bearing = o.z[i, 1] - inputs.sensor.rotation
            edges.append((BEARING, *ends, np.array([bearing]), o.R[i, 1:, 1:]))
        else:
            edges.append((SIGHTING, *ends, points[i], spread[i]))
    places = np.array([estimate.landmark[number] for number in numbers]).reshape(-1, 2)
    held = [0, *(vertex.values() if estimate.known else ())]
    return written((range(n), estimate.pose), (list(vertex.values()), places), held, edges)
