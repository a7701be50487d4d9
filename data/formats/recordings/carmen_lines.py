"""CARMEN log text, plain, gzip or bzip2: lines of odometry and of a front laser as arrays.

Fields are separated by blanks; the first word is the kind of line:

    PARAM name value ...                    a parameter of the robot
    ODOM x y theta tv rv accel              and the tail; pose of the robot [m, m, rad]
    FLASER n r1 .. rn  x y theta  odom_x odom_y odom_theta          and the tail; ranges [m], poses of laser and robot
    ROBOTLASER1 type start_angle fov resolution max_range accuracy remission_mode  n r1 .. rn  m i1 .. im
                x y theta  odom_x odom_y odom_theta  tv rv front side turn_axis      and the tail; angles [rad]
    the tail: ipc_timestamp host logger_timestamp [s]

Other lines are counted and ignored; comments (#) and blank lines are not counted.
Source: the CARMEN toolkit's log format (M. Montemerlo, N. Roy, S. Thrun), as stated at the head of its logs.
"""

from __future__ import annotations

import bz2
import gzip
import hashlib
import io
import math
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np

from data.columns.scans import DENSEST, LARGE
from data.csv_table import Table, number_rows, shown
from data.errors import LARGEST, DataError
from data.formats.recordings.beams import on_one_set
from data.inputs import IntArray
from data.se2 import Array

ODOM, FLASER, ROBOTLASER, PARAM, NEFF = "ODOM", "FLASER", "ROBOTLASER1", "PARAM", "NEFF"
SCANS = (FLASER, ROBOTLASER)
POSES = ("x", "y", "theta", "odom_x", "odom_y", "odom_theta")
HEAD = ("type", "start_angle", "fov", "resolution", "max_range", "accuracy", "remission_mode")
TAIL = 3
"""Fields at the end of a line: stamp, host, stamp of the logger."""
ODOM_FIELDS = 1 + 6 + TAIL


@dataclass(frozen=True)
class OdometryLines:
    """pose (O, 3) of the robot, stamp (O,) s, line (O,) in the file."""

    pose: Array
    stamp: Array
    line: IntArray


@dataclass(frozen=True)
class ScanLines:
    """Scans of one kind, in line order.

    Attributes:
        kind: first word of their lines.
        ranges: (S, B) m, as in the file.
        laser, robot: (S, 3) poses of laser and robot in the odometry frame.
        stamp: (S,) s.
        line: (S,) in the file.
        beams: angle of the first beam and step [rad].
        head: (S, 7) the numbers `HEAD` of each line (ROBOTLASER1), else None.
        resampled: number of scans that had other beams.
    """

    kind: str
    ranges: Array
    laser: Array
    robot: Array
    stamp: Array
    line: IntArray
    beams: tuple[float, float]
    head: Array | None = None
    resampled: int = 0


@dataclass(frozen=True)
class CarmenLines:
    """The contents of a file.

    Attributes:
        odometry, scans: its lines.
        parameters: numeric values of PARAM lines.
        left_out: counts of other lines by kind.
        neff: (K,) lines with a particle filter's effective number of particles: the poses are the filter's.
    """

    odometry: OdometryLines
    scans: ScanLines
    parameters: Mapping[str, float]
    left_out: Mapping[str, int]
    neff: IntArray


def parse_carmen(path: Path, content: bytes) -> CarmenLines:
    """Lines of a log, with the scans of the more frequent kind (ROBOTLASER1 if equal); a logger may write both.

    Raises DataError for a log without scans, a line with wrong fields, or beams that change.
    """
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
        raise DataError.at(path, f"no line of a laser scan; {FLASER} or {ROBOTLASER} lines are needed")
    others.update({k: len(found[k][0]) for k in SCANS if k != kind and found[k][0]})
    scans = (_flaser if kind == FLASER else _robotlaser)(path, lines, rows)
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
    table = _table(path, lines, chosen, names)
    table.require_finite(names)
    return OdometryLines(table.stack(names[:3]), table.columns["stamp"], np.array(lines, np.int64))


def _count(path: Path, line: int, kind: str, fields: list[bytes], at: int, what: str) -> int:
    """The whole number at a place of a line."""
    try:
        text = fields[at]
    except IndexError:
        raise DataError.at(path, f"{kind} line ends before its number of {what} (was it cut off?)", line=line) from None
    if not text.isdigit():
        raise DataError.at(path, f"{kind} with {shown(text)} {what}; a whole number is needed", line=line)
    return int(text)


def _complete(path: Path, line: int, kind: str, fields: list[bytes], needed: int, because: str) -> None:
    """Raise unless a line has the number of fields that its counts imply."""
    if len(fields) != needed:
        hint = " (was the line cut off?)" if len(fields) < needed else ""
        raise DataError.at(path, f"{kind} with {len(fields)} fields; {because} take {needed}{hint}", line=line)


def _with_beams(path: Path, kind: str, lines: list[int], counts: list[int]) -> None:
    for line, n in zip(lines, counts, strict=True):
        if n == 0:
            raise DataError.at(path, f"{kind} without beams; at least one is needed", line=line)


def _flaser(path: Path, lines: list[int], rows: list[list[bytes]]) -> ScanLines:
    counts = [_count(path, i, FLASER, f, 1, "beams") for i, f in zip(lines, rows, strict=True)]
    for line, fields, n in zip(lines, rows, counts, strict=True):
        _complete(path, line, FLASER, fields, 2 + n + len(POSES) + TAIL, f"{n} beams, two poses and stamps")
    _with_beams(path, FLASER, lines, counts)
    angles = np.array([beams_of(n) for n in counts])
    return _scans(path, FLASER, lines, [f[2:-2] for f in rows], counts, angles)


def _robotlaser(path: Path, lines: list[int], rows: list[list[bytes]]) -> ScanLines:
    at = 1 + len(HEAD)
    counts, chosen, heads = [], [], []
    for line, fields in zip(lines, rows, strict=True):
        n = _count(path, line, ROBOTLASER, fields, at, "beams")
        counts.append(n)
        m = _count(path, line, ROBOTLASER, fields, at + 1 + n, "remissions")
        needed = at + 2 + n + m + len(POSES) + 5 + TAIL
        because = f"{n} beams, {m} remissions, two poses, five of the robot and stamps"
        _complete(path, line, ROBOTLASER, fields, needed, because)
        poses = at + 2 + n + m
        heads.append(fields[1:at])
        chosen.append([*fields[at + 1 : at + 1 + n], *fields[poses : poses + len(POSES)], fields[-TAIL]])
    _with_beams(path, ROBOTLASER, lines, counts)
    table = _table(path, lines, heads, HEAD)
    table.require_finite(HEAD)
    table.require(table.columns["resolution"] != 0.0, "resolution", "{} rad between beams; a number above 0 is needed")
    table.require(table.columns["max_range"] > 0.0, "max_range", "{} m; a number above 0 is needed")
    head = table.stack(HEAD)
    angles = head[:, [HEAD.index("start_angle"), HEAD.index("resolution")]]
    return replace(_scans(path, ROBOTLASER, lines, chosen, counts, angles), head=head)


def _scans(
    path: Path, kind: str, lines: list[int], rows: list[list[bytes]], counts: list[int], angles: Array
) -> ScanLines:
    """Scans from the fields of each line: n ranges (may be infinite), six numbers of poses, the stamp; `angles` (S, 2)
    of the first beam and between two [rad].
    """
    most = max(counts)
    names = (*(f"range {i}" for i in range(1, most + 1)), *POSES, "stamp")
    padded = [[*f[:n], *[b"0"] * (most - n), *f[n:]] for f, n in zip(rows, counts, strict=True)]
    values = number_rows(path, lines, padded, names)
    numbers = np.array(lines, np.int64)
    ranges = values[:, :most]
    fine = ranges >= 0.0  # false for NaN
    if not fine.all():
        row, beam = np.argwhere(~fine)[0].tolist()
        what = f"{float(ranges[row, beam])!r} is not a range; a number from 0 up is needed"
        raise DataError.at(path, what, line=lines[row], column=names[beam])
    rest = dict(zip((*POSES, "stamp"), values[:, most:].T, strict=True))
    table = Table(path, rest, line=numbers)
    table.require_finite((*POSES, "stamp"))
    seen = [r[:n] for r, n in zip(ranges, counts, strict=True)]
    common, low, step, resampled = on_one_set(seen, angles[:, 0], angles[:, 1])
    return ScanLines(
        kind, common, table.stack(POSES[:3]), table.stack(POSES[3:]), rest["stamp"], numbers, (low, step),
        resampled=resampled,
    )  # fmt: skip


NARROW = {101: 100.0, 201: 100.0, 401: 100.0}
"""Opening angle [deg] by number of beams, where it is not 180."""


def beams_of(n: int) -> tuple[float, float]:
    """Angle of the first beam and step [rad] of a FLASER line with n beams, which states neither.

    From -90 degrees; an odd number reaches +90 (181: every degree, 361: every half), an even one stops a step before
    (180, 360). 101, 201 and 401 beams open 100 degrees.
    """
    opening = math.radians(NARROW.get(n, 180.0))
    return -0.5 * opening, opening / max(n - n % 2, 1)


def _table(path: Path, lines: list[int], rows: list[list[bytes]], names: Sequence[str]) -> Table:
    values = number_rows(path, lines, rows, names)
    return Table(path, dict(zip(names, values.T, strict=True)), line=np.array(lines, np.int64))


PART = 1 << 16
"""Bytes unpacked at a time."""


def content_of(path: Path) -> tuple[bytes, str]:
    """Contents of a file, unpacked if named .gz or .bz2, and its SHA-256 as it is; DataError if unreadable."""
    kind = path.suffix.lower()
    try:
        packed = path.read_bytes()
        content = _unpacked(path, packed, OPENERS[kind]) if kind in OPENERS else packed
        return content, hashlib.sha256(packed).hexdigest()
    except gzip.BadGzipFile:
        raise DataError.at(path, "not a gzip file; compress it, or rename it without .gz") from None
    except (EOFError, zlib.error) as error:
        what = "gzip" if kind == ".gz" else "bzip2"
        raise DataError.at(path, f"the {what} file is broken or cut off ({error}); a whole one is needed") from None
    except OSError as error:
        if kind == ".bz2" and error.errno is None:
            raise DataError.at(path, "not a bzip2 file; compress it, or rename it without .bz2") from None
        raise DataError.at(path, f"cannot be read: {error.strerror}") from None


OPENERS: dict[str, Callable[[io.BytesIO], IO[bytes]]] = {".gz": gzip.open, ".bz2": bz2.open}  # type: ignore[dict-item]


def _unpacked(path: Path, packed: bytes, opened: Callable[[io.BytesIO], IO[bytes]]) -> bytes:
    """The content of a packed file; logs pack to about a fifth, so much larger contents are refused."""
    most = max(LARGE, DENSEST * len(packed))
    parts, length = [], 0
    with opened(io.BytesIO(packed)) as file:
        while part := file.read(PART):
            parts.append(part)
            length += len(part)
            if length > most:
                what = f"{len(packed)} bytes that unpack to more than {most}"
                raise DataError.at(path, f"{what}; logs pack to about a fifth")
    return b"".join(parts)
