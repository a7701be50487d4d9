"""Logs in one file whose lines begin with a word for what they hold: the circle log of DLR, and that of SLAM courses.

DLR (Kurlbaum and Frese, A Benchmark Data Set for Data Association, SFB/TR 8 report 017-02/2009):

    STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi      pose after the step in that before; covariance, yy third
    LANDMARK_C pX pY quality cXX cXY cYY ID                    a circle seen after the latest step; ID -1: none

The robot mapping courses of Freiburg and Bonn (`sensor_data.dat`, and `world.dat` with a landmark `id x y` a line):

    ODOMETRY r1 t r2            a turn, a drive and a turn since the pose before
    SENSOR id range bearing     a landmark seen after the latest step

Metres, radians, blanks between fields; text after # is a comment. DLR's axes (-y ahead) are kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from data.csv_table import bytes_of, lines_of, number_rows
from data.digest import source_file
from data.errors import DataError
from data.formats.recordings.laser import FLOOR
from data.inputs import Increments, Inputs, IntArray, LandmarkMap, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.origin import Origin
from data.se2 import Array, wrap_angle
from data.sensors import RangeBearing, RelativePoint, Sensor
from data.terminal import counted
from data.truth import UNKNOWN_ID, Truth

DLR = {
    "STEP": ("image", "dX", "dY", "dPhi", "cXX", "cXY", "cYY", "cXPhi", "cYPhi", "cPhiPhi"),
    "LANDMARK_C": ("pX", "pY", "quality", "cXX", "cXY", "cYY", "ID"),
}
COURSE = {"ODOMETRY": ("r1", "t", "r2"), "SENSOR": ("id", "range", "bearing")}


def is_course(path: Path) -> bool:
    """Whether a file begins with a step of a course's log."""
    with path.open("rb") as lines:
        first = lines.readline(200).split()
    return len(first) == 4 and first[0] == b"ODOMETRY"


def load_dlr(path: Path, name: str) -> Log:
    """The circle log, its identities as true ids; frames have no stamps. DataError with line and value."""
    step, seen, frame = _read(path, DLR)
    P = step[:, [3, 4, 6, 4, 5, 7, 6, 7, 8]].reshape(-1, 3, 3)
    notes = ("The file's axes are kept: -y is ahead.",)
    seen_at = Observations(frame, seen[:, :2], seen[:, [3, 4, 4, 5]].reshape(-1, 2, 2))
    return _log(path, name, "dlr", step[:, :3], P, seen_at, seen[:, 6], notes)


def load_course(path: Path, name: str, world: Path | None, turns: ArrayLike, seen_sigma: ArrayLike) -> Log:
    """The log of a course, ids as labels and true ids. DataError with line and value.

    Args:
        path: of the steps and landmarks.
        name: of the log.
        world: file of the known map, or None.
        turns: standard deviations (3,) of r1 [rad], t [m], r2 [rad] of each step.
        seen_sigma: of range [m] and bearing [rad] (2,).
    """
    step, seen, frame = _read(path, COURSE)
    behind = seen[:, 1] < 0.0  # a noisy range of a landmark beside the robot
    notes = (f"Left out: {counted(int(behind.sum()), 'observation')} with a negative range.",) * bool(behind.any())
    seen, frame = seen[~behind], frame[~behind]
    z = np.stack([seen[:, 1], wrap_angle(seen[:, 2])], axis=1)
    known = None
    if world is not None:
        lines = [(n, f) for n, line in enumerate(lines_of(bytes_of(world)), start=1) if (f := line.split())]
        rows = number_rows(world, [n for n, _ in lines], [f for _, f in lines], ("id", "x", "y"))
        order = np.argsort(rows[:, 0])
        known = LandmarkMap(rows[order, 0].astype(np.int64), rows[order, 1:])
    r1, t, r2 = step.T
    mean = np.stack([t * np.cos(r1), t * np.sin(r1), r1 + r2], axis=1)
    J = np.zeros((len(step), 3, 3))  # of the increment by r1, t, r2
    J[:, 0, 0], J[:, 1, 0], J[:, 2, 0] = -mean[:, 1], mean[:, 0], 1.0
    J[:, 0, 1], J[:, 1, 1], J[:, 2, 2] = np.cos(r1), np.sin(r1), 1.0
    P = J @ np.diag(np.square(turns)) @ J.transpose(0, 2, 1)
    R = np.broadcast_to(np.diag(np.square(seen_sigma)), (len(seen), 2, 2)).copy()
    return _log(path, name, "course", mean, P, Observations(frame, z, R), seen[:, 0], notes, known)


def _read(path: Path, kinds: Mapping[str, tuple[str, ...]]) -> tuple[Array, Array, IntArray]:
    """Numbers of steps and of landmarks, and the number (K,) of steps before each landmark."""
    (step, _), (landmark, _) = kinds.items()
    found: dict[str, list[tuple[int, list[bytes]]]] = {tag: [] for tag in kinds}
    frame = list[int]()
    for number, line in enumerate(lines_of(bytes_of(path)), start=1):
        if not (fields := line.split(b"#")[0].split()):
            continue
        tag = fields[0].decode("utf-8", "replace")
        if len(fields) != 1 + len(kinds.get(tag, fields)):
            needed = " or ".join(f"{t} with {len(names)} fields" for t, names in kinds.items())
            raise DataError.at(path, f"{line[:40].decode('utf-8', 'replace')!r}; {needed} is needed", line=number)
        frame += [len(found[step])] * (tag == landmark)
        found[tag].append((number, fields[1 + (kinds[tag][0] == "image") :]))
    steps, seen = (
        number_rows(path, [n for n, _ in rows], [f for _, f in rows], [n for n in names if n != "image"])
        for rows, names in zip(found.values(), kinds.values(), strict=True)
    )
    if not len(steps) or not np.isfinite(steps).all() or not np.isfinite(seen).all():
        raise DataError.at(path, "steps with finite numbers are needed")
    return steps, seen, np.array(frame, np.int64)


def _log(
    path: Path,
    name: str,
    kind: str,
    mean: Array,
    P: Array,
    observations: Observations,
    ids: Array,
    notes: tuple[str, ...],
    known: LandmarkMap | None = None,
) -> Log:
    """A log of steps and landmarks, which begins at the origin; `ids`: below 0 where unknown."""
    covariance, floored = floor_covariances(np.concatenate([np.zeros((1, 3, 3)), P]), FLOOR)
    reach = np.hypot(*observations.z.T) if kind == "dlr" else observations.z[:, 0]
    farthest = 1.001 * float(reach.max(initial=0.0)) or np.inf
    sensor: Sensor = RelativePoint(max_range=farthest) if kind == "dlr" else RangeBearing(max_range=farthest)
    recorded = Inputs(
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        time=np.arange(len(covariance), dtype=float),
        increments=Increments(np.concatenate([np.zeros((1, 3)), mean]), covariance),
        observations=observations,
        sensor=sensor,
        map=known,
        time_is_index=True,
        covariance_floor=FLOOR,
        floored=floored,
    )
    label = np.where(ids >= 0, ids, UNKNOWN_ID).astype(np.int64)
    source, origins = {"kind": kind, **source_file(path)}, {"max_range": Origin.INFERRED}
    return Log(name, recorded, Truth(landmark_of=label), source=source, notes=notes, origins=origins)
