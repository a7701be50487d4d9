"""A second odometry in a table of another program: closures between successive frames (`--second-odometry FILE`)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from data.csv_table import is_name
from data.errors import DataError
from data.formats.recordings.laser import TravelNoise
from data.formats.second_odometry import closures_between, covered, own_name
from data.formats.tables.files import SECOND, Columns, TextTable
from data.formats.tables.motion import Odometry, read_odometry
from data.motion.velocity import MAX_HOLD, VelocityNoise
from data.pose_measurements import Closures
from data.se2 import Array
from data.terminal import counted


@dataclass(frozen=True)
class Second:
    """What is stated of a second odometry: its kind, and noise as of the first."""

    kind: str
    noise: VelocityNoise | TravelNoise


def read_second(file: TextTable, second: Second, columns: Columns, first: Odometry) -> Odometry:
    """The second odometry of a file.

    Raises:
        DataError: no stamps where the first has some, another number of rows where it has none, or the same motion:
            one measurement would count twice.
    """
    found = read_odometry(file, columns, second.kind, None, SECOND)
    if found.stamped != first.stamped:
        columns.require(file, SECOND if first.stamped else "odometry", ("t",))
    if not found.stamped and len(found.time) != len(first.time):
        what = f"{counted(len(found.time), 'row')}, the odometry has {len(first.time)}"
        raise DataError.at(file.path, f"{what}; without stamps each row of one needs a row of the other")
    mine, other = (o.pose if o.velocity is None else o.velocity for o in (found, first))
    if (
        np.array_equal(found.time, first.time)
        and mine is not None
        and other is not None
        and np.array_equal(mine, other)
    ):
        raise DataError.at(file.path, "the motion of the odometry once more; another one is needed")
    return found


def _same(one: Array | None, other: Array | None) -> bool:
    return one is other if one is None or other is None else np.array_equal(one, other)


def second_closures(
    file: TextTable, odometry: Odometry, second: Second, time: Array, taken: Collection[str], notes: list[str]
) -> Closures:
    """Closures between successive frames at `time` (N,) that it covers; `taken`: names of other sources.

    Velocities with a gap of more than `MAX_HOLD` between two frames tell nothing of these; poses do.
    """
    stem = file.path.stem
    name = own_name(stem if is_name(stem) else SECOND, taken)
    frames = np.flatnonzero(covered(odometry.time, time))
    if len(frames) < 2:
        span = f"{odometry.time[0]:.15g} to {odometry.time[-1]:.15g}"
        what = f"{SECOND} from {span} s covers {counted(len(frames), 'frame')} of {time[0]:.15g} to {time[-1]:.15g} s"
        raise DataError.at(file.path, f"{what}; two are needed; state the unit as in --unit {SECOND}.t=ms")
    motion, _ = odometry.increments(time[frames], second.noise)
    gaps = None
    if odometry.velocity is not None:
        broken = np.cumsum(np.diff(odometry.time, prepend=odometry.time[0]) > MAX_HOLD + 1e-6)
        row = np.searchsorted(odometry.time, time[frames])
        gaps = broken[row[1:]] != broken[row[:-1]]
    found = closures_between(frames, motion, name, gaps)
    notes += odometry.notes
    pairs = f"{len(found)} of {len(time) - 1} pairs of successive frames"
    notes.append(f"{file.path.name}: a second odometry, as closures between {pairs}, source {name}")
    return found
