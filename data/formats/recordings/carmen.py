"""A CARMEN log (`.log` or `.clf`, also as `.gz` or `.bz2`) as a laser log: odometry and range scans, no landmarks.

Every ODOM line is a frame; without any, every scan is. A scan belongs to the last ODOM line in line order, since stamps
of such logs come in bursts and go back. The frame's pose is then the robot's pose that the scan's line states. Where
most scans follow another without an ODOM line between, every scan is a frame.

Raw odometry can be recovered from a log corrected by a particle filter. Each scan line that the filter used states its
corrected pose, at the instant of the ODOM line before it; the following ODOM lines are that pose with raw increments.
Some programs repeat the corrected pose as an ODOM line without a stamp, before the NEFF line.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from data.columns.scans import with_returns
from data.digest import file_sha256
from data.errors import DataError
from data.formats.open_log.reader import read_relations
from data.formats.recordings.carmen_lines import (
    HEAD,
    SCANS,
    CarmenLines,
    OdometryLines,
    ScanLines,
    content_of,
    parse_carmen,
)
from data.formats.recordings.laser import laser_inputs, without_odometry
from data.formats.recordings.mending import (
    AS_STATED,
    NEXT,
    Mending,
    beam_angles,
    heading_unit,
    piled_up,
    require_metres,
    sigma_of,
    stamps_back,
    without_jumps,
    without_resets,
)
from data.inputs import IntArray, Scanner, Scans
from data.log import Log
from data.notice import Code, Notice, notice
from data.se2 import Array, BoolArray, between, dead_reckoned, inverse, wrap_angle
from data.terminal import counted
from data.truth import Truth


def without_corrections(lines: CarmenLines) -> tuple[CarmenLines, str]:
    """The same lines with raw odometry from the first ODOM pose on, and a note.

    The raw increment into an ODOM line starts at the last pose stated before it, corrected or not. Repeated corrected
    poses are dropped; a scan has the raw pose of the ODOM line before it.
    """
    odometry, scans = lines.odometry, lines.scans
    again = _stated_again(lines)
    line = np.concatenate([odometry.line, scans.line])
    order = np.argsort(line, kind="stable")
    pose = np.concatenate([odometry.pose, scans.robot])[order]
    counts = np.concatenate([~again, np.zeros(len(scans.line), bool)])[order]
    counted = np.flatnonzero(counts)
    increments = between(pose[np.maximum(counted - 1, 0)], pose[counted])
    increments[0] = 0.0
    raw = dead_reckoned(pose[counted[0]], increments)
    raw[:, 2] = wrap_angle(raw[:, 2])
    kept = OdometryLines(raw, odometry.stamp[~again], odometry.line[~again])
    last = np.maximum(np.searchsorted(kept.line, scans.line) - 1, 0)
    before = np.searchsorted(odometry.line, scans.line) - 1
    corrections = between(odometry.pose[before[before >= 0]], scans.robot[before >= 0])
    distance = np.hypot(corrections[:, 0], corrections[:, 1])
    moved = int(((distance > 0.0) | (corrections[:, 2] != 0.0)).sum())
    note = (
        f"Raw odometry recovered: {moved} corrections undone, the largest {distance.max(initial=0.0):.3g} m; "
        f"{int(again.sum())} ODOM lines that repeat a corrected pose dropped."
    )
    return replace(lines, odometry=kept, scans=replace(scans, robot=raw[last]), neff=lines.neff[:0]), note


def _stated_again(lines: CarmenLines) -> BoolArray:
    """Which ODOM lines (O,) repeat the pose of the last scan line: no other pose is between, the pose is equal, and a
    NEFF line follows or the stamp is 0.
    """
    odometry, scans = lines.odometry, lines.scans
    scan = np.searchsorted(scans.line, odometry.line) - 1
    first = np.append(True, scan[1:] != scan[:-1]) & (scan >= 0)
    same = (odometry.pose == scans.robot[np.maximum(scan, 0)]).all(axis=1)
    marked = np.isin(odometry.line + 1, lines.neff) | (odometry.stamp == 0.0)
    return np.asarray(first & same & marked)


ENDINGS = (".log", ".clf")
RELATIONS = ".relations.csv"
REACH = 80.0
"""m, reach of the SICK LMS 2xx; its codes for no return begin at 81.83 m."""
SIGMA = 0.01
"""m, of a range: the resolution, above the noise of 5 mm (data sheet of the LMS 200)."""
OFFSET = "robot_frontlaser_offset"
LARGEST_RANGE = ("laser_max_range", "robot_front_laser_max")
"""Parameters that state the reach."""
FEWEST_KEPT = 0.5
"""Least share of the scans that frames of ODOM lines keep."""
STILL = 0.9
"""Share of stamps that do not increase, from which on a clock does not run."""
MOUNTED = 0.01
"""m, rad, largest variation of a laser's pose on the robot, as given by the line's two poses."""


def log_name(path: Path) -> str:
    """The file's name without `.gz`, `.bz2`, `.log`, `.clf`."""
    return re.sub(r"(?i)(?<=.)\.(log|clf)$", "", re.sub(r"(?i)(?<=.)\.(gz|bz2)$", "", path.name))


def is_named_carmen(path: Path) -> bool:
    """Whether a file is named as a CARMEN log."""
    return path.name.lower().removesuffix(".gz").removesuffix(".bz2").endswith(ENDINGS)


def is_carmen(path: Path) -> bool:
    """Whether a file is named as a CARMEN log, and holds a scan."""
    if not is_named_carmen(path) or not path.is_file():
        return False
    try:
        content, _ = content_of(path)
    except DataError:
        return False
    return any(content.startswith(f"{kind} ".encode()) or f"\n{kind} ".encode() in content for kind in SCANS)


def relations_beside(path: Path) -> Path | None:
    """`<name>.relations.csv` beside a log, or None."""
    beside = path.with_name(log_name(path) + RELATIONS)
    return beside if beside.is_file() else None


def load_carmen(
    path: str | PathLike[str],
    relations: Path | None = None,
    *,
    undo_correction: bool = False,
    mending: Mending = AS_STATED,
) -> Log:
    """A CARMEN log with the relations in a file, or in the file beside it; `undo_correction` recovers raw odometry.

    The prior is the first odometry pose, exactly; increments have the noise of `data.formats.recordings.laser`. The
    first scan of a frame, nearest to its odometry, is kept. Times are the stamps made strictly increasing in line
    order; `Relations.frame_stamp` are the recorded ones, a scan's before its frame's, since references relate scans.

    Raises DataError for an unreadable file, one without a scan, or an invalid line or relation.
    """
    file = Path(path)
    content, sha256 = content_of(file)
    lines = parse_carmen(file, content)
    notes: list[str] = []
    if undo_correction:
        if not len(lines.odometry.line):
            raise DataError.at(file, "no ODOM line; recovering raw odometry needs them")
        lines, *notes = without_corrections(lines)
        used, scans = len(np.unique(np.searchsorted(lines.odometry.line, lines.scans.line))), len(lines.scans.line)
        if used < FEWEST_KEPT * scans:
            what = f"--undo-correction keeps {used} of {scans} scans, because the others have no ODOM line of their own"
            raise DataError.at(file, f"{what}; raw odometry is needed between scans: read the log without the flag")
    log = log_of(file, sha256, lines, relations or relations_beside(file), mending)
    return replace(log, notes=(*notes, *log.notes))


def log_of(file: Path, sha256: str, lines: CarmenLines, relations: Path | None, mending: Mending = AS_STATED) -> Log:
    """The log of a file's lines."""
    lines = _mended(lines, mending)
    require_metres(file, lines.scans.ranges)
    scans, odometry = lines.scans, lines.odometry
    frame = np.searchsorted(odometry.line, scans.line) - 1
    own = bool((scans.robot != scans.robot[0]).any())
    few = len(np.unique(frame[frame >= 0])) < FEWEST_KEPT * len(frame)
    if not len(odometry.line) or (own and few and relations is None):
        frame, pose, stamp = np.arange(len(scans.line)), scans.robot, scans.stamp
    else:
        pose, stamp = odometry.pose, odometry.stamp
    kept = np.flatnonzero((frame >= 0) & np.append(True, frame[1:] != frame[:-1]))
    if len(kept) == 0:
        raise DataError.at(file, "no scan after the first ODOM line; at least one is needed")
    scanner, of_scanner, asked = _scanner(lines)
    scanner = mending.scanner(scanner)
    if own:
        pose = pose.copy()
        pose[frame[kept]] = scans.robot[kept]
    raw = stamp.copy()
    raw[frame[kept]] = scans.stamp[kept]
    taken = Scans(scanner, frame[kept], with_returns(scans.ranges[kept], scanner.max_range))
    mixed = [] if mending.sort_stamps else stamps_back(pose, stamp)
    clock, resets = (stamp, list[int]()) if mixed else without_resets(stamp)
    clock, broken, low = (clock, 0, 0) if mixed else without_jumps(clock)
    asked += [*heading_unit(pose), *mixed]
    asked += [notice(Code.STAMPS_BROKEN, broken=broken, stamps=len(stamp))] if broken else []
    recorded = laser_inputs(pose, clock, taken)
    still = len(clock) > NEXT and not mixed and float((np.diff(clock) <= 0.0).mean()) > STILL
    if still:
        recorded = replace(recorded, time=np.arange(len(pose), dtype=float), time_is_index=True)
    if not mending.odometry:
        recorded = without_odometry(recorded)
    source = {"kind": "carmen", "file": file.name, "sha256": sha256}
    truth = Truth()
    if relations is not None:
        truth = Truth(relations=read_relations(relations, len(pose), raw))
        source["relations"], source["relations_sha256"] = relations.name, file_sha256(relations)
    notes = [*_notes(lines, frame.astype(np.int64), kept, stamp), *of_scanner]
    if still:
        notes.append("The clock does not run: times are numbers of frames.")
    if low:
        notes.append(f"{low} of {len(stamp)} stamps are far below those around them: interpolated.")
    if resets:
        at = ", ".join(map(str, resets[:5])) + (", ..." if len(resets) > 5 else "")
        notes.append(f"The clock was set back at frame {at}: later stamps continue those before.")
    return Log(log_name(file), recorded, truth, source=source, notes=tuple(notes), asked=tuple(asked))


def _mended(lines: CarmenLines, mending: Mending) -> CarmenLines:
    """Lines in metres, in the order of their stamps if asked for."""
    scans, odometry = lines.scans, lines.odometry
    scans = replace(
        scans, ranges=mending.ranges(scans.ranges), laser=mending.poses(scans.laser), robot=mending.poses(scans.robot),
        stamp=mending.stamps(scans.stamp),
    )  # fmt: skip
    odometry = replace(odometry, pose=mending.poses(odometry.pose), stamp=mending.stamps(odometry.stamp))
    if mending.sort_stamps:
        # an ODOM line goes before a scan of the same stamp
        first, then = np.argsort(odometry.stamp, kind="stable"), np.argsort(scans.stamp, kind="stable")
        place = np.argsort(np.argsort(np.concatenate([odometry.stamp, scans.stamp]), kind="stable"))
        odometry = OdometryLines(odometry.pose[first], odometry.stamp[first], np.sort(place[: len(first)]))
        head = None if scans.head is None else scans.head[then]
        scans = replace(
            scans, ranges=scans.ranges[then], laser=scans.laser[then], robot=scans.robot[then],
            stamp=scans.stamp[then], line=np.sort(place[len(first) :]), head=head,
        )  # fmt: skip
    return replace(lines, odometry=odometry, scans=scans)


def _notes(lines: CarmenLines, frame: IntArray, kept: IntArray, stamp: Array) -> list[str]:
    notes = ["No ground truth: the prior is the first pose of the odometry."]
    if lines.left_out:
        notes.append("Lines left out: " + ", ".join(f"{n} {kind}" for kind, n in sorted(lines.left_out.items())) + ".")
    scans, early, dropped = counted(len(frame), "scan"), int((frame < 0).sum()), len(frame) - len(kept)
    if early:
        notes.append(f"{early} of {scans} before the first ODOM line: left out.")
    if dropped > early:
        notes.append(f"{dropped - early} of {scans} after another without an ODOM line between: left out.")
    if (back := int((np.diff(stamp) <= 0.0).sum())) > 0:
        notes.append(f"{back} of {len(stamp)} stamps do not increase; line order is used.")
    if len(lines.neff):
        recover = "data.convert carmen --undo-correction recovers the odometry"
        notes.append(f"Poses of a particle filter (NEFF lines): {recover}.")
    return notes


def _scanner(lines: CarmenLines) -> tuple[Scanner, list[str], list[Notice]]:
    """The scanner, notes about it, and questions."""
    scans = lines.scans
    low, step = scans.beams
    notes, asked = list[str](), list[Notice]()
    mounting: Array
    offset = lines.parameters.get(OFFSET)
    stated = next((lines.parameters[key] for key in LARGEST_RANGE if lines.parameters.get(key, 0.0) > 0.0), None)
    if scans.head is None:
        sigma, mounting = SIGMA, np.array([offset or 0.0, 0.0, 0.0])
    else:
        head = dict(zip(HEAD, scans.head[0].tolist(), strict=True))
        asked = beam_angles(low, step, low + head["fov"], scans.ranges.shape[1])
        sigma = head["accuracy"] if head["accuracy"] > 0.0 else SIGMA
        stated = float(scans.head[:, HEAD.index("max_range")].min())
        mounting, notes = _mounting(scans, offset)
    largest, note = largest_range(scans.ranges, stated)
    sigma, coarse = sigma_of(sigma, scans.ranges, step, largest, SIGMA)
    notes += coarse
    if scans.resampled:
        notes.append(f"{scans.resampled} of {counted(len(scans.line), 'scan')} with other beams: resampled.")
    if mounting.any():
        x, y, turned = mounting[0], mounting[1], math.degrees(mounting[2])
        notes.append(f"The laser is mounted at ({x:.6g}, {y:.6g}) m, turned by {turned:.4g} deg.")
    # p_scanner = R p_body + T: the body's pose in the laser's frame
    tx, ty, turn = (float(v) + 0.0 for v in inverse(mounting))
    scanner = Scanner(low, step, largest, sigma, turn, (tx, ty))
    return scanner, [*notes, note], asked


def largest_range(ranges: Array, stated: float | None) -> tuple[float, str]:
    """The range [m] from which on a reading is no return, and a note.

    It is the largest reading below the stated one, or below 80 m, if readings pile up there; else these.
    """
    limit = REACH if stated is None else stated
    found = piled_up(ranges, limit)
    if found is not None:
        top, piled = found
        text = f"No return: readings of {top:g} m and more, where {piled} of {ranges.size} pile up"
        return top, f"{text}." if stated is None else f"{text}; the log states {stated:g} m."
    return limit, f"No return: readings of {limit:g} m and more{', as the log states' * (stated is not None)}."


def _mounting(scans: ScanLines, offset: float | None) -> tuple[Array, list[str]]:
    """Pose (3,) of the laser on the robot: from the two poses of each line if they are consistent, else the
    parameter's.
    """
    on_robot = between(scans.robot, scans.laser)
    middle = np.median(on_robot, axis=0)
    if float(np.median(np.abs(on_robot - middle).max(axis=1))) <= MOUNTED:
        return np.where(np.abs(middle) < 1e-5, 0.0, middle), []
    note = "The distance of the two poses of ROBOTLASER1 lines varies; the laser's place is the parameter's."
    return np.array([offset or 0.0, 0.0, 0.0]), [note]
