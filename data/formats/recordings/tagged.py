"""Logs in one file whose lines begin with a word for what they hold: the circle log of DLR, and that of SLAM courses.

DLR (Kurlbaum and Frese, A Benchmark Data Set for Data Association, SFB/TR 8 report 017-02/2009):

    STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi      pose after the step in that before; covariance, yy third
    LANDMARK_C pX pY quality cXX cXY cYY ID                    a circle seen after the latest step; ID -1: none

The robot mapping courses of Freiburg and Bonn (`sensor_data.dat`, and `world.dat` with a landmark `id x y` a line):

    ODOMETRY r1 t r2            a turn, a drive and a turn since the pose before
    SENSOR id range bearing     a landmark seen after the latest step

The course 16-833 of CMU, lengths in cm, poses in the odometry's frame (read with CARMEN's logs, `wings.laser.carmen`):

    O x y theta t                                   pose of the robot
    L x y theta xl yl thetal r1 .. rn t             the same, pose of the laser, ranges

Other lengths: metres, radians, blanks between fields; text after # is a comment. DLR's axes (-y ahead) are kept.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from data.csv_table import Table, bytes_of, lines_of, number_rows, shown
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

Kinds = Mapping[str, tuple[int, tuple[str, ...]]]
"""By the first word of a line: the number of words after it that are not read, and the names of the numbers."""
DLR: Kinds = {
    "STEP": (1, ("dX", "dY", "dPhi", "cXX", "cXY", "cYY", "cXPhi", "cYPhi", "cPhiPhi")),
    "LANDMARK_C": (0, ("pX", "pY", "quality", "cXX", "cXY", "cYY", "ID")),
}
COURSE: Kinds = {"ODOMETRY": (0, ("r1", "t", "r2")), "SENSOR": (0, ("id", "range", "bearing"))}
WORLD: Kinds = {"": (0, ("id", "x", "y"))}


def is_course(path: Path) -> bool:
    """Whether a file begins with a step of a course's log."""
    with path.open("rb") as lines:
        first = lines.readline(200).split()
    return len(first) == 4 and first[0] == b"ODOMETRY"


def load_dlr(path: Path, name: str) -> Log:
    """The circle log, its identities as true ids; frames have no stamps. DataError with line and value."""
    (step, seen), frame = tables_of(path, DLR)
    P = step.stack(("cXX", "cXY", "cXPhi", "cXY", "cYY", "cYPhi", "cXPhi", "cYPhi", "cPhiPhi")).reshape(-1, 3, 3)
    R = seen.stack(("cXX", "cXY", "cXY", "cYY")).reshape(-1, 2, 2)
    z = seen.stack(("pX", "pY"))
    log = _log(name, step.stack(("dX", "dY", "dPhi")), P, Observations(frame, z, R), RelativePoint)
    truth, source = Truth(landmark_of=_known(seen.integers("ID", -1))), {"kind": "dlr", **source_file(path)}
    return replace(log, truth=truth, source=source, notes=("The file's axes are kept: -y is ahead.",))


def load_course(path: Path, name: str, world: Path | None, turns: ArrayLike, seen_sigma: ArrayLike) -> Log:
    """The log of a course, ids as labels and true ids, with its known map, if `world` is its file. DataError with line
    and value.

    turns (3,): standard deviations of r1 [rad], t [m], r2 [rad] of a step; seen_sigma (2,): of range [m] and bearing.
    """
    (step, seen), frame = tables_of(path, COURSE)
    ahead = seen.get("range") >= 0.0  # a noisy range of a landmark beside the robot may be negative
    left_out = int((~ahead).sum())
    seen, frame = seen.part(ahead), frame[ahead]
    z = np.stack([seen.get("range"), wrap_angle(seen.get("bearing"))], axis=1)
    r1, t, r2 = step.stack(("r1", "t", "r2")).T
    mean = np.stack([t * np.cos(r1), t * np.sin(r1), r1 + r2], axis=1)
    J = np.zeros((len(step), 3, 3))  # of the increment by r1, t, r2
    J[:, 0, 0], J[:, 1, 0], J[:, 2, 0] = -mean[:, 1], mean[:, 0], 1.0
    J[:, 0, 1], J[:, 1, 1], J[:, 2, 2] = np.cos(r1), np.sin(r1), 1.0
    P = J @ np.diag(np.square(turns)) @ J.transpose(0, 2, 1)
    R = np.broadcast_to(np.diag(np.square(seen_sigma)), (len(seen), 2, 2)).copy()
    log, ids = _log(name, mean, P, Observations(frame, z, R), RangeBearing), seen.integers("id", -1)
    notes = (f"Left out: {counted(left_out, 'observation')} with a negative range.",) * (left_out > 0)
    again = len(ids) - len(np.unique(np.column_stack([frame, ids]), axis=0))
    if unnamed := again > REPEATED * len(ids):
        notes += (f"Ids name no landmarks: {again} of {len(ids)} repeat one of their frame.",)
    return replace(
        log, recorded=replace(log.recorded, map=None if world is None else _map(world)),
        truth=Truth(landmark_of=None if unnamed else _known(ids)), source={"kind": "course", **source_file(path)},
        notes=notes,
    )  # fmt: skip


REPEATED = 0.2  # Share of observations with the id of another one of their frame, beyond which ids are no labels


def _map(path: Path) -> LandmarkMap:
    ((table,), _) = tables_of(path, WORLD)
    number = table.integers("id", 0)
    table.require_distinct("id", number, "{} is the id of two landmarks")
    order = np.argsort(number)
    return LandmarkMap(number[order], table.stack(("x", "y"))[order])


def _known(ids: IntArray) -> IntArray:
    return np.where(ids >= 0, ids, UNKNOWN_ID)


def tables_of(path: Path, kinds: Kinds, content: bytes | None = None) -> tuple[list[Table], IntArray]:
    """The rows of each kind, finite, and the number (K,) of rows of the first kind before each of the last. DataError
    for a line of no kind, one of another length, an invalid number, and where the first kind has no row.
    """
    rows: dict[str, list[list[bytes]]] = {word: [] for word in kinds}
    lines: dict[str, list[int]] = {word: [] for word in kinds}
    first, last = next(iter(kinds)), [*kinds][-1]
    before = list[int]()
    for number, line in enumerate(lines_of(bytes_of(path) if content is None else content), start=1):
        if not (fields := line.split(b"#")[0].split()):
            continue
        word = "" if "" in kinds else fields.pop(0).decode("utf-8", "replace")
        skipped, names = kinds.get(word, (0, ()))
        if word not in kinds or len(fields) != skipped + len(names):
            each = [(of, " ".join((*names[:8], "...", *names[-1:]) if len(names) > 12 else names))
                    for of, (_, names) in kinds.items()]  # fmt: skip
            needed = " or ".join(f"{of} {names}".strip() for of, names in each)
            raise DataError.at(path, f"{shown(line)}; {needed} is needed", line=number)
        before += [len(rows[first])] * (word == last)
        rows[word].append(fields[skipped:])
        lines[word].append(number)
    if not rows[first]:
        raise DataError.at(path, "no rows; at least one is needed")
    tables = []
    for word, (_, names) in kinds.items():
        values = number_rows(path, lines[word], rows[word], names)
        table = Table(path, dict(zip(names, values.T, strict=True)), line=np.array(lines[word], np.int64))
        table.require_finite(names)
        tables.append(table)
    return tables, np.array(before, np.int64)


def _log(name: str, mean: Array, P: Array, observations: Observations, sensor: type[Sensor]) -> Log:
    """A log of steps (N, 3) and their covariances, from the origin; its reach is the farthest landmark."""
    covariance, floored = floor_covariances(np.concatenate([np.zeros((1, 3, 3)), P]), FLOOR)
    farthest = 1.001 * float(sensor().polar(observations.z)[:, 0].max(initial=0.0)) or np.inf
    recorded = Inputs(
        prior=Prior(np.zeros(3), np.zeros((3, 3))), time=np.arange(len(covariance), dtype=float),
        increments=Increments(np.concatenate([np.zeros((1, 3)), mean]), covariance), observations=observations,
        sensor=sensor(max_range=farthest), time_is_index=True, covariance_floor=FLOOR, floored=floored,
    )  # fmt: skip
    return Log(name, recorded, Truth(), origins={"max_range": Origin.INFERRED})
