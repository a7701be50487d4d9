"""A CARMEN log (`.log` or `.clf`, also as `.gz` or `.bz2`) as a laser log: odometry and range scans, no landmarks; or
lines O and L of a course (`data.formats.recordings.tagged`).

Every ODOM line is a frame; without any, every scan is. A scan belongs to the last ODOM line in line order, since stamps
of such logs come in bursts and go back. The frame's pose is then the robot's pose that the scan's line states. Where
most scans follow another without an ODOM line between, every scan is a frame.

Raw odometry can be recovered from a log corrected by a particle filter. Each scan line that the filter used states its
corrected pose, at the instant of the ODOM line before it; the following ODOM lines are that pose with raw increments.
Some programs repeat the corrected pose as an ODOM line without a stamp, before the NEFF line.
"""

import bz2
import gzip
import hashlib
import io
import math
import re
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import IO

import numpy as np

from data.columns.scans import DENSEST, LARGE, with_returns
from data.csv_table import Table, number_rows, shown
from data.digest import file_sha256
from data.errors import LARGEST, DataError, UsageError
from data.formats.open_log import read_relations
from data.formats.recordings import mending as as_meant
from data.formats.recordings.beams import on_one_set
from data.formats.recordings.laser import laser_inputs, without_odometry
from data.formats.recordings.tagged import tables_of
from data.inputs import IntArray, Scanner, Scans
from data.log import Log
from data.logs import Reading
from data.notice import Code, Notice, notice
from data.origin import Origin, Origins
from data.questions.examination import heading_unit
from data.se2 import Array, BoolArray, between, dead_reckoned, inverse, wrap_angle
from data.terminal import counted
from data.truth import Truth

# CARMEN log text, plain, gzip or bzip2: lines of odometry and of a front laser as arrays.
#
# Fields are separated by blanks; the first word is the kind of line:
#
#     PARAM name value ...                    a parameter of the robot
#     ODOM x y theta tv rv accel              and the tail; pose of the robot [m, m, rad]
#     FLASER n r1 .. rn  x y theta  odom_x odom_y odom_theta          and the tail; ranges [m], poses of laser and robot
#     ROBOTLASER1 type start_angle fov resolution max_range accuracy remission_mode  n r1 .. rn  m i1 .. im
#                 x y theta  odom_x odom_y odom_theta  tv rv front side turn_axis      and the tail; angles [rad]
#     the tail: ipc_timestamp host logger_timestamp [s]
#
# Other lines are counted and ignored; comments (#) and blank lines are not counted.
# Source: the CARMEN toolkit's log format (M. Montemerlo, N. Roy, S. Thrun), as stated at the head of its logs.

ODOM, FLASER, ROBOTLASER, PARAM, NEFF = "ODOM", "FLASER", "ROBOTLASER1", "PARAM", "NEFF"
SCANS = (FLASER, ROBOTLASER)
POSES = ("x", "y", "theta", "odom_x", "odom_y", "odom_theta")
HEAD = ("type", "start_angle", "fov", "resolution", "max_range", "accuracy", "remission_mode")
TAIL = 3  # Fields at the end of a line: stamp, host, stamp of the logger
ODOM_FIELDS = 1 + 6 + TAIL


@dataclass(frozen=True)
class OdometryLines:
    """pose (O, 3) of the robot, stamp (O,) s, line (O,) in the file."""

    pose: Array
    stamp: Array
    line: IntArray


@dataclass(frozen=True)
class ScanLines:
    """Scans of one kind, in line order."""

    kind: str  # first word of their lines
    ranges: Array  # (S, B) m, as in the file
    laser: Array  # (S, 3) poses of the laser in the odometry frame
    robot: Array  # (S, 3) of the robot
    stamp: Array  # (S,) s
    line: IntArray  # (S,) in the file
    beams: tuple[float, float]  # angle of the first beam and step [rad]
    head: Array | None = None  # (S, 7) the numbers `HEAD` of each line (ROBOTLASER1), else None
    resampled: int = 0  # number of scans that had other beams


@dataclass(frozen=True)
class CarmenLines:
    """The contents of a file."""

    odometry: OdometryLines
    scans: ScanLines
    parameters: Mapping[str, float]  # numeric values of PARAM lines
    left_out: Mapping[str, int]  # counts of other lines by kind
    neff: IntArray  # (K,) lines with a particle filter's effective number of particles: the poses are the filter's


COURSE = re.compile(rb"(?ms)(L|O(?=.*?^L ))( +[-+.\de]+){4}")  # How its log begins, with a scan in it
LASER, CM = "L", np.array([0.01, 0.01, 1.0])  # Kind of its scans, and the units of its poses


def _course(path: Path, content: bytes) -> CarmenLines:
    """Scans of lines L, each at its own odometry, which is older than that of the line O above."""
    scan = next(f for line in content.split(b"\n") if (f := line.split())[:1] == [LASER.encode()])
    ranges = tuple(f"range {i}" for i in range(1, len(scan) - 7))
    kinds = {LASER: (0, (*POSES[3:], *POSES[:3], *ranges, "stamp")), "O": (0, (*POSES[3:], "stamp"))}
    (seen, own), _ = tables_of(path, kinds, content)
    for name in ranges:
        seen.require(seen.get(name) >= 0.0, name, "{} is not a range; a number from 0 up is needed")
    r, (laser, robot) = 0.01 * seen.stack(ranges), (seen.stack(names) * CM for names in (POSES[:3], POSES[3:]))
    scans = ScanLines(LASER, r, laser, robot, seen.get("stamp"), seen.line, beams_of(len(ranges)))
    none = np.zeros(0, np.int64)
    return CarmenLines(OdometryLines(np.zeros((0, 3)), np.zeros(0), none), scans, {}, {"O": len(own)}, none)


def parse_carmen(path: Path, content: bytes) -> CarmenLines:
    """Lines of a log, with the scans of the more frequent kind (ROBOTLASER1 if equal); a logger may write both. Raises
    DataError for a log without scans, a line with wrong fields, or beams that change.
    """
    if COURSE.match(content):
        return _course(path, content)
    found: dict[str, tuple[list[int], list[list[bytes]]]] = {kind: ([], []) for kind in (ODOM, *SCANS)}
    words = {kind.encode(): found[kind] for kind in found}
    parameters: dict[str, float] = {}
    neff: list[int] = []
    others: Counter[str] = Counter()
    for number, text in enumerate(content.split(b"\n"), start=1):
        fields = text.split()
        if not fields:
            continue
        into = words.get(fields[0])
        if into is not None:
            into[0].append(number)
            into[1].append(fields)
        elif fields[0] == b"PARAM":
            _parameter(path, number, fields, parameters)
        elif not fields[0].startswith(b"#"):
            kind = fields[0].decode("ascii", "replace")
            others[kind if len(kind) <= 30 and kind.isprintable() else "(not text)"] += 1
            if kind == NEFF:
                neff.append(number)
    kind = max(reversed(SCANS), key=lambda k: len(found[k][0]))
    lines, rows = found[kind]
    if not lines:
        more = f"; a table is for slamref convert table {path} LOG"
        raise DataError.at(path, f"no line of a laser scan; {FLASER} or {ROBOTLASER} lines (or L) are needed{more}")
    others.update({k: len(found[k][0]) for k in SCANS if k != kind and found[k][0]})
    scans = _scans(path, kind, lines, rows)
    return CarmenLines(_odometry(path, *found[ODOM]), scans, parameters, dict(others), np.array(neff, np.int64))


def _parameter(path: Path, line: int, fields: Sequence[bytes], into: dict[str, float]) -> None:
    """Keep `PARAM name value ...` if the value is a number."""
    try:
        name, value = fields[1].decode("ascii", "replace"), float(fields[2])
    except (IndexError, ValueError):
        return
    if not abs(value) <= LARGEST:
        what = f"PARAM {name} is {fields[2][:40].decode('ascii', 'replace')}; a finite number in SI units is needed"
        raise DataError.at(path, what, line=line)
    into[name] = value


def _odometry(path: Path, lines: list[int], rows: list[list[bytes]]) -> OdometryLines:
    names = ("x", "y", "theta", "stamp")
    chosen = []
    for line, fields in zip(lines, rows, strict=True):
        if len(fields) != ODOM_FIELDS:
            right = f"{ODOM_FIELDS} are needed (x y theta tv rv accel stamp host stamp)"
            raise DataError.at(path, f"{ODOM} with {len(fields)} fields; {right}", line=line)
        chosen.append([*fields[1:4], fields[7]])
    numbers = np.array(lines, np.int64)
    values = number_rows(path, lines, chosen, names)
    Table(path, dict(zip(names, values.T, strict=True)), line=numbers).require_finite(names)
    return OdometryLines(values[:, :3], values[:, 3], numbers)


def _count(path: Path, line: int, kind: str, fields: list[bytes], at: int, what: str) -> int:
    """The whole number at a place of a line."""
    if at >= len(fields):
        raise DataError.at(path, f"{kind} line ends before its number of {what} (was it cut off?)", line=line)
    if not fields[at].isdigit():
        raise DataError.at(path, f"{kind} with {shown(fields[at])} {what}; a whole number is needed", line=line)
    return int(fields[at])


def _scans(path: Path, kind: str, lines: list[int], rows: list[list[bytes]]) -> ScanLines:
    """Scans from the lines of one kind; ranges may be infinite."""
    head = HEAD if kind == ROBOTLASER else ()
    at = 1 + len(head)
    counts, chosen = [], []
    for line, fields in zip(lines, rows, strict=True):
        n = _count(path, line, kind, fields, at, "beams")
        if not n:
            raise DataError.at(path, f"{kind} without beams; at least one is needed", line=line)
        ranges = at + 1
        poses, because = ranges + n, f"{n} beams, two poses and stamps"
        needed = poses + len(POSES) + TAIL
        if head:
            m = _count(path, line, kind, fields, poses, "remissions")
            because = f"{n} beams, {m} remissions, two poses, five of the robot and stamps"
            poses, needed = poses + 1 + m, needed + 1 + m + 5
        if len(fields) != needed:
            hint = " (was the line cut off?)" if len(fields) < needed else ""
            raise DataError.at(path, f"{kind} with {len(fields)} fields; {because} take {needed}{hint}", line=line)
        counts.append(n)
        chosen.append([*fields[1:at], *fields[poses : poses + len(POSES)], fields[-TAIL], *fields[ranges : ranges + n]])
    most, rest = max(counts), (*head, *POSES, "stamp")
    names = (*rest, *(f"range {i}" for i in range(1, most + 1)))
    values = number_rows(path, lines, [[*f, *[b"0"] * (most - n)] for f, n in zip(chosen, counts, strict=True)], names)
    ranges_of = values[:, len(rest) :]
    if len(wrong := np.argwhere(~(ranges_of >= 0.0))):  # NaN, too
        row, beam = wrong[0].tolist()
        what = f"{float(ranges_of[row, beam])!r} is not a range; a number from 0 up is needed"
        raise DataError.at(path, what, line=lines[row], column=names[len(rest) + beam])
    numbers = np.array(lines, np.int64)
    table = Table(path, dict(zip(rest, values.T, strict=False)), line=numbers)
    table.require_finite(rest)
    angles = np.array([beams_of(n) for n in counts])
    if head:
        table.require(
            table.columns["resolution"] != 0.0, "resolution", "{} rad between beams; a number above 0 is needed"
        )
        table.require(table.columns["max_range"] > 0.0, "max_range", "{} m; a number above 0 is needed")
        angles = table.stack(("start_angle", "resolution"))
    seen = [r[:n] for r, n in zip(ranges_of, counts, strict=True)]
    common, low, step, resampled = on_one_set(seen, angles[:, 0], angles[:, 1])
    return ScanLines(
        kind, common, table.stack(POSES[:3]), table.stack(POSES[3:]), table.columns["stamp"], numbers, (low, step),
        table.stack(head) if head else None, resampled,
    )  # fmt: skip


NARROW = {101: 100.0, 201: 100.0, 401: 100.0}  # Opening angle [deg] by number of beams, where it is not 180


def beams_of(n: int) -> tuple[float, float]:
    """Angle of the first beam and step [rad] of a FLASER line with n beams, which states neither.

    From -90 degrees; an odd number reaches +90 (181: every degree, 361: every half), an even one stops a step before
    (180, 360). 101, 201 and 401 beams open 100 degrees.
    """
    opening = math.radians(NARROW.get(n, 180.0))
    return -0.5 * opening, opening / max(n - n % 2, 1)


PACKED: dict[str, tuple[str, Callable[[io.BytesIO], IO[bytes]]]] = {
    ".gz": ("gzip", gzip.open), ".bz2": ("bzip2", bz2.open),  # type: ignore[dict-item]
}  # fmt: skip


def content_of(path: Path) -> tuple[bytes, str]:
    """Contents of a file, unpacked if named .gz or .bz2, and its SHA-256 as it is. DataError if it cannot be read, or
    unpacks to far more than the fifth that logs pack to.
    """
    kind = path.suffix.lower()
    what, opened = PACKED.get(kind, ("", None))
    try:
        content = packed = path.read_bytes()
        if opened is not None:
            most = max(LARGE, DENSEST * len(packed))
            with opened(io.BytesIO(packed)) as file:
                content = file.read(most + 1)
            if len(content) > most:
                size = f"{len(packed)} bytes that unpack to more than {most}"
                raise DataError.at(path, f"{size}; logs pack to about a fifth")
        return content, hashlib.sha256(packed).hexdigest()
    except (EOFError, zlib.error) as error:
        raise DataError.at(path, f"the {what} file is broken or cut off ({error}); a whole one is needed") from None
    except OSError as error:
        if what and error.errno is None:
            raise DataError.at(path, f"not a {what} file; compress it, or rename it without {kind}") from None
        raise DataError.at(path, f"cannot be read: {error.strerror}") from None


def without_corrections(lines: CarmenLines) -> tuple[CarmenLines, str]:
    """The same lines with raw odometry from the first ODOM pose on, and a note: an increment starts at the last pose
    before it, repeated ones are dropped, a scan has the raw pose of the ODOM line before it.
    """
    odometry, scans = lines.odometry, lines.scans
    again = _stated_again(lines)
    order = np.argsort(np.concatenate([odometry.line, scans.line]), kind="stable")
    pose = np.concatenate([odometry.pose, scans.robot])[order]
    counted = np.flatnonzero(np.concatenate([~again, np.zeros(len(scans.line), bool)])[order])
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
    undone = f"{moved} corrections undone, the largest {distance.max(initial=0.0):.3g} m"
    note = f"Raw odometry recovered: {undone}; {int(again.sum())} ODOM lines that repeat a corrected pose dropped."
    return replace(lines, odometry=kept, scans=replace(scans, robot=raw[last]), neff=lines.neff[:0]), note


def _stated_again(lines: CarmenLines) -> BoolArray:
    """Which ODOM lines (O,) repeat the last scan line's pose: equal, none between, a NEFF line follows or stamp 0."""
    odometry, scans = lines.odometry, lines.scans
    scan = np.searchsorted(scans.line, odometry.line) - 1
    first = np.append(True, scan[1:] != scan[:-1]) & (scan >= 0)
    same = (odometry.pose == scans.robot[np.maximum(scan, 0)]).all(axis=1)
    return np.asarray(first & same & (np.isin(odometry.line + 1, lines.neff) | (odometry.stamp == 0.0)))


ENDINGS = (".log", ".clf")
RELATIONS = (".relations.csv", ".relations")
REACH = 80.0  # m, reach of the SICK LMS 2xx; its codes for no return begin at 81.83 m
SIGMA = 0.01  # m, of a range: the resolution, above the noise of 5 mm (data sheet of the LMS 200)
OFFSET = "robot_frontlaser_offset"
LARGEST_RANGE = ("laser_max_range", "robot_front_laser_max")  # Parameters that state the reach
FEWEST_KEPT = 0.5  # Least share of the scans that frames of ODOM lines keep
STILL = 0.9  # Share of stamps that do not increase, from which on a clock does not run
MOUNTED = 0.01  # m, rad, largest variation of a laser's pose on the robot, as given by the line's two poses


def log_name(path: Path) -> str:
    """The file's name without `.gz`, `.bz2`, `.log`, `.clf`."""
    return re.sub(r"(?i)(?<=.)\.(log|clf)$", "", re.sub(r"(?i)(?<=.)\.(gz|bz2)$", "", path.name))


def is_carmen_file(path: Path) -> bool:
    """Whether it is a file, named as a CARMEN log."""
    return path.is_file() and path.name.lower().removesuffix(".gz").removesuffix(".bz2").endswith(ENDINGS)


def is_carmen(path: Path) -> bool:
    """Whether a file is named as a CARMEN log, and holds a scan."""
    if not is_carmen_file(path):
        return False
    try:
        content, _ = content_of(path)
    except DataError:
        return False
    return (COURSE.match(content) or re.search(rb"(?m)^(FLASER|ROBOTLASER1) ", content)) is not None


def relations_beside(path: Path) -> Path | None:
    """`<name>.relations.csv`, or `<name>.relations` as published, beside a log, or None."""
    beside = (path.with_name(log_name(path) + ending) for ending in RELATIONS)
    return next((file for file in beside if file.is_file()), None)


def carmen_logs(paths: Sequence[Path], say: Callable[[str], None]) -> dict[Path, Callable[[], Log] | None]:
    """The CARMEN logs with scans of a folder's paths, with loaders; only those with relations where some have them."""
    logs = [path for path in paths if is_carmen(path)]
    related = [path for path in logs if relations_beside(path) is not None]
    found: dict[Path, Callable[[], Log] | None] = {p: None for p in paths if p.name.endswith(RELATIONS)}
    for path in logs:
        if related and path not in related:
            say(f"skipped {path}: no relations beside it, unlike other logs there")
        found[path] = partial(load_carmen, path) if path in related or not related else None
    return found


def open_carmen(path: Path, reading: Reading, _: Callable[[str], None]) -> Log:
    """The log of a file, with the relations that are asked for, or those beside it."""
    return load_carmen(path, reading.relations)


def load_carmen(
    path: str | PathLike[str], relations: Path | None = None, *, undo_correction: bool = False,
    mending: as_meant.Mending = as_meant.AS_STATED,
) -> Log:  # fmt: skip
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


def log_of(
    file: Path, sha256: str, lines: CarmenLines, relations: Path | None, mending: as_meant.Mending = as_meant.AS_STATED
) -> Log:
    """The log of a file's lines."""
    if lines.scans.kind == LASER and (mending.range_unit, mending.odometry_unit) != ("m", "m"):
        raise UsageError("--range-unit, --odometry-unit: lines O and L are read in cm as they are; leave the flags out")
    lines = _mended(lines, mending)
    as_meant.require_metres(file, lines.scans.ranges)
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
    scanner, of_scanner, asked, origins = _scanner(lines)
    scanner = mending.scanner(scanner)
    if own:
        pose = pose.copy()
        pose[frame[kept]] = scans.robot[kept]
    raw = stamp.copy()
    raw[frame[kept]] = scans.stamp[kept]
    taken = Scans(scanner, frame[kept], with_returns(scans.ranges[kept], scanner.max_range))
    mixed = [] if mending.sort_stamps else as_meant.stamps_back(pose, stamp)
    clock, resets = (stamp, list[int]()) if mixed else as_meant.without_resets(stamp)
    clock, broken, low = (clock, 0, 0) if mixed else as_meant.without_jumps(clock)
    asked += [*heading_unit("the odometry", np.arange(len(pose), dtype=float), pose, "--unit angle=deg"), *mixed]
    asked += [notice(Code.STAMPS_BROKEN, broken=broken, stamps=len(stamp))] if broken else []
    recorded = laser_inputs(pose, clock, taken)
    still = len(clock) > as_meant.NEXT and not mixed and float((np.diff(clock) <= 0.0).mean()) > STILL
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
    return Log(log_name(file), recorded, truth, source=source, notes=tuple(notes), asked=tuple(asked), origins=origins)


def _mended(lines: CarmenLines, mending: as_meant.Mending) -> CarmenLines:
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
        recover = "slamref convert carmen --undo-correction recovers the odometry"
        notes.append(f"Poses of a particle filter (NEFF lines): {recover}.")
    return notes


def _scanner(lines: CarmenLines) -> tuple[Scanner, list[str], list[Notice], Origins]:
    """The scanner, notes about it, questions, and where the log's numbers come from."""
    scans = lines.scans
    low, step = scans.beams
    notes, asked, origins = list[str](), list[Notice](), {"odometry_noise": Origin.ASSUMED}
    mounting: Array
    offset = lines.parameters.get(OFFSET)
    stated = next((lines.parameters[key] for key in LARGEST_RANGE if lines.parameters.get(key, 0.0) > 0.0), None)
    if scans.kind == LASER:
        sigma, (mounting, notes) = SIGMA, _mounting(scans, offset)
        notes.append("Lines L of a course: lengths in cm, beams from -90 deg on, each scan at its own odometry.")
        origins |= {"range_noise": Origin.ASSUMED}
    elif scans.head is None:
        sigma, mounting = SIGMA, np.array([offset or 0.0, 0.0, 0.0])
        origins |= {"range_noise": Origin.ASSUMED} | ({"sensor_pose": Origin.ASSUMED} if offset is None else {})
    else:
        head = dict(zip(HEAD, scans.head[0].tolist(), strict=True))
        asked = as_meant.beam_angles(low, step, low + head["fov"], scans.ranges.shape[1])
        sigma = head["accuracy"] if head["accuracy"] > 0.0 else SIGMA
        stated = float(scans.head[:, HEAD.index("max_range")].min())
        mounting, notes = _mounting(scans, offset)
    largest, note = largest_range(scans.ranges, stated)
    sigma, coarse = as_meant.sigma_of(sigma, scans.ranges, step, largest, SIGMA)
    notes += coarse
    origins |= {"range_noise": Origin.INFERRED} if coarse else {}
    if largest != stated:
        origins["max_range"] = Origin.ASSUMED if largest == REACH else Origin.INFERRED
    if scans.resampled:
        notes.append(f"{scans.resampled} of {counted(len(scans.line), 'scan')} with other beams: resampled.")
    if mounting.any():
        x, y, turned = mounting[0], mounting[1], math.degrees(mounting[2])
        notes.append(f"The laser is mounted at ({x:.6g}, {y:.6g}) m, turned by {turned:.4g} deg.")
    tx, ty, turn = (float(v) + 0.0 for v in inverse(mounting))  # p_scanner = R p_body + T: the body in its frame
    return Scanner(low, step, largest, sigma, turn, (tx, ty)), [*notes, note], asked, origins


def largest_range(ranges: Array, stated: float | None) -> tuple[float, str]:
    """The range [m] from which on a reading is no return, and a note. It is the largest reading below the stated one,
    or below 80 m, if readings pile up there; else these.
    """
    limit = REACH if stated is None else stated
    found = as_meant.piled_up(ranges, limit)
    if found is not None:
        top, piled = found
        text = f"No return: readings of {top:g} m and more, where {piled} of {ranges.size} pile up"
        return top, f"{text}." if stated is None else f"{text}; the log states {stated:g} m."
    return limit, f"No return: readings of {limit:g} m and more{', as the log states' * (stated is not None)}."


def _mounting(scans: ScanLines, offset: float | None) -> tuple[Array, list[str]]:
    """Pose (3,) of the laser on the robot: from the poses of each line if consistent, else the parameter's."""
    on_robot = between(scans.robot, scans.laser)
    middle = np.median(on_robot, axis=0)
    if float(np.median(np.abs(on_robot - middle).max(axis=1))) <= MOUNTED:
        return np.where(np.abs(middle) < 1e-5, 0.0, middle), []
    note = f"The distance of the two poses of {scans.kind} lines varies; the laser's place is the parameter's."
    return np.array([offset or 0.0, 0.0, 0.0]), [note]
