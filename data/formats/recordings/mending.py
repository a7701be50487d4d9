"""What a laser recording does not state, or states wrongly, and how a person says it: units, mounting, reach, clock."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.inputs import Scanner
from data.notice import Code, Notice, notice
from data.se2 import Array

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
RADIANS = {"rad": 1.0, "deg": math.pi / 180.0}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True)
class Mending:
    """How the numbers of a laser recording are read."""

    range_unit: str = "m"  # range_unit, odometry_unit: of lengths in the file, a key of `METRES`
    odometry_unit: str = "m"
    angle: str = "rad"  # angle, time: units of the odometry's headings and of stamps, keys of `RADIANS` and `SECONDS`
    time: str = "s"
    # clockwise: beams run clockwise: the laser is upside down, or its beams are listed from left to right
    clockwise: bool = False
    laser_turned: float = 0.0  # deg, heading of the laser on the robot besides what the recording states
    beam_step: float | None = None  # deg between beams, where the recording's is wrong
    max_range: float | None = None  # m, from which on a reading is no return
    sort_stamps: bool = False  # lines are in the order of their stamps, not in that of the file
    odometry: bool = True  # false: it is unknown, and scans alone tell the motion

    def ranges(self, ranges: Array) -> Array:
        """In metres."""
        return ranges * METRES[self.range_unit]

    def poses(self, pose: Array) -> Array:
        """Poses (N, 3) in metres and radians."""
        unit = METRES[self.odometry_unit]
        return np.asarray(pose * np.array([unit, unit, RADIANS[self.angle]]))

    def stamps(self, stamp: Array) -> Array:
        """In seconds."""
        return stamp * SECONDS[self.time]

    def scanner(self, scanner: Scanner) -> Scanner:
        """The scanner as it is mounted."""
        if self.beam_step is not None:
            scanner = replace(scanner, angle_step=math.copysign(math.radians(self.beam_step), scanner.angle_step))
        if self.max_range is not None:
            scanner = replace(scanner, max_range=self.max_range)
        return scanner.mounted(clockwise=self.clockwise, turned=math.radians(self.laser_turned))


AS_STATED = Mending()


FARTHEST = 100.0  # m, beyond which no scanner of robots measures; codes for no return are smaller
TOO_FAR = 0.5  # Share of readings beyond it that raises an error


def require_metres(path: Path, ranges: Array) -> None:
    """Raise DataError where most finite ranges are farther than any scanner measures."""
    finite = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    if not len(finite) or (finite > FARTHEST).mean() <= TOO_FAR:
        return
    middle = float(np.median(finite))
    unit = "mm" if middle > 1000.0 else "cm"
    what = f"the middle range is {middle:g} m; metres are needed"
    right = f"add --range-unit {unit} to slamref convert carmen or rosbag (of a table --unit scans.range={unit})"
    raise DataError.at(path, f"{what}: are the ranges in {unit}? Then {right}")


LOOSE = 1.5  # Beams, by which the stated angles may disagree


def beam_angles(first: float, step: float, last: float, beams: int) -> list[Notice]:
    """A question where the angles [rad] of the first and of the last beam are not `beams` steps apart."""
    wanted = (last - first) / max(beams - 1, 1)
    if beams < 2 or abs(first + (beams - 1) * step - last) <= LOOSE * abs(step) or wanted == 0.0:
        return []
    return [
        notice(
            Code.BEAM_ANGLES, beams=beams, step=math.degrees(step), last=math.degrees(last),
            reached=math.degrees(first + (beams - 1) * step), mended=abs(math.degrees(wanted)),
            flags=(f"--beam-step {abs(math.degrees(wanted)):.6g}",),
        )
    ]  # fmt: skip


PILE, BESIDE, STANDS_OUT = 1e-3, 0.01, 10
"""The largest reading is a code for no return if it is the share PILE of all, and STANDS_OUT times as frequent as
readings less than the share BESIDE below it."""


def piled_up(ranges: Array, below: float) -> tuple[float, int] | None:
    """The largest reading below a limit [m] if readings pile up there, and their number."""
    fine = ranges[ranges < below]
    top = float(fine.max(initial=0.0))
    piled = int((fine == top).sum())
    beside = int(((fine < top) & (fine >= (1.0 - BESIDE) * top)).sum())
    if top > 0.0 and piled >= max(PILE * ranges.size, STANDS_OUT) and piled >= STANDS_OUT * beside:
        return top, piled
    return None


SPREAD = 1.4826  # Standard deviation of a normal variable per median of its size
SMOOTH = 0.1  # Largest relative difference of neighbouring ranges on one surface
PLENTY = 1000  # Least number of triples of beams


def range_noise(ranges: Array, step: float, max_range: float) -> float | None:
    """Standard deviation [m] of ranges (S, B), from neighbouring beams on straight walls; None with too few.

    Along a straight wall u = 1 / r obeys u(i-1) + u(i+1) = 2 cos(step) u(i). Corners spoil few triples, which the
    median ignores.
    """
    r = ranges[:: max(len(ranges) // 500, 1)]
    fine = (r > 0.0) & (r < max_range) & np.isfinite(r)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(fine, 1.0 / r, np.nan)
        near = (np.abs(r[:, 1:-1] / r[:, :-2] - 1.0) < SMOOTH) & (np.abs(r[:, 2:] / r[:, 1:-1] - 1.0) < SMOOTH)
    off = (u[:, :-2] + u[:, 2:] - 2.0 * math.cos(step) * u[:, 1:-1]) * r[:, 1:-1] ** 2
    off = off[near & np.isfinite(off)]
    if len(off) < PLENTY:
        return None
    return SPREAD * float(np.median(np.abs(off))) / math.sqrt(2.0 + 4.0 * math.cos(step) ** 2)


COARSE = 3.0  # Times the noise of the data from which on a stated accuracy is a resolution


def sigma_of(stated: float, ranges: Array, step: float, max_range: float, least: float) -> tuple[float, list[str]]:
    """The standard deviation of a range [m], and a note where the stated one is much larger than the data's."""
    found = range_noise(ranges, step, max_range)
    if found is None or stated <= COARSE * max(found, least):
        return stated, []
    used = max(found, least)
    measured = f"along walls the ranges vary by {found:.2g} m, and {used:.2g} m is used"
    return used, [f"The stated accuracy of {stated:g} m is taken as a resolution: {measured}."]


def without_jumps(stamp: Array) -> tuple[Array, int, int]:
    """Stamps (N,) without single ones far above all later ones or below both neighbours; how many of each kind."""
    if len(stamp) < 2:
        return stamp, 0, 0
    padded = np.concatenate([np.full(NEXT, stamp[0]), stamp, np.full(NEXT, stamp[-1])])
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, NEXT), axis=1)
    before, following = middle[: len(stamp)], middle[NEXT + 1 :][: len(stamp)]
    high, low = stamp - following > JUMP, np.minimum(before, following) - stamp > JUMP
    broken, mended = high | low, stamp.copy()
    fine = np.flatnonzero(~broken)
    mended[broken] = np.interp(np.flatnonzero(broken), fine, stamp[fine]) if len(fine) else stamp[broken]
    return mended, int(high.sum()), int(low.sum())


def without_resets(stamp: Array) -> tuple[Array, list[int]]:
    """Stamps (N,) of a clock that was set back, continued as if it had not been, and the numbers where it was."""
    if len(stamp) < 2:
        return stamp, []
    before, after = np.full(len(stamp), -np.inf), np.full(len(stamp), np.inf)
    if len(stamp) >= NEXT:
        middle = np.median(np.lib.stride_tricks.sliding_window_view(stamp, NEXT), axis=1)
        before[NEXT - 1 :], after[: len(middle)] = middle, middle
    found = np.flatnonzero((stamp[:-1] - stamp[1:] > JUMP) & (before[:-1] - after[1:] > JUMP))
    mended, step = stamp.copy(), float(np.median(np.abs(np.diff(stamp))))
    for i in found.tolist():
        mended[i + 1 :] += mended[i] + step - mended[i + 1]
    return mended, (found + 1).tolist()


NEXT = 9  # Stamps after one, whose middle it is compared with
JUMP = 60.0  # s, by which a stamp exceeds the next ones if its clock is broken; buffers delay by seconds
BACK = 1.0  # s, from which on a step back is no burst
OFTEN = 5  # Steps back that say so where no path does
SHORTER = 0.9  # Length of the path by the stamps, as a share of that by the lines, below which lines are out of order


def stamps_back(pose: Array, stamp: Array) -> list[Notice]:
    """A question where the path (N, 3) is clearly shorter in the order of its stamps."""
    back = int((np.diff(stamp) < -BACK).sum())
    if not back:
        return []
    way = np.hypot(*np.diff(pose[:, :2], axis=0).T).sum()
    sorted_way = np.hypot(*np.diff(pose[np.argsort(stamp, kind="stable"), :2], axis=0).T).sum()
    mixed = way == 0.0 and int((np.diff(without_jumps(without_resets(stamp)[0])[0]) < -BACK).sum()) >= OFTEN
    if not (sorted_way < SHORTER * way or mixed):
        return []
    return [notice(Code.STAMPS_BACK, back=back, way=float(way), sorted=float(sorted_way), flags=("--sort-stamps",))]
