"""CARMEN log text, plain or gzip: lines of odometry and of a front laser as arrays.

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

import gzip
import hashlib
import io
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data.errors import LARGEST, DataError
from data.formats.csv_table import Table, number_rows, shown
from data.formats.open_log.scans import DENSEST, LARGE
from data.inputs import IntArray
from data.se2 import Array

ODOM, FLASER, ROBOTLASER, PARAM, NEFF = "ODOM", "FLASER", "ROBOTLASER1", "PARAM", "NEFF"
SCANS = (FLASER, ROBOTLASER)
POSES = ("x", "y", "theta", "odom_x", "odom_y", "odom_theta")
HEAD = ("type", "start_angle", "fov", "resolution", "max_range", "accuracy", "remission_mode")
GEOMETRY = slice(1, 4)
"""Entries of `HEAD` that may not change within a log."""
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
        head: (S, 7) the numbers `HEAD` of each line (ROBOTLASER1), else None.
    """

    kind: str
    ranges: Array
    laser: Array
    robot: Array
    stamp: Array
    line: IntArray
    head: Array | None = None


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


def _same_beams(path: Path, kind: str, lines: list[int], counts: list[int]) -> None:
    for line, n in zip(lines, counts, strict=True):
        if n == 0:
            raise DataError.at(path, f"{kind} without beams; at least one is needed", line=line)
        if n != counts[0]:
            what = f"{kind} with {n} beams; {counts[0]} are needed, as in line {lines[0]}"
            raise DataError.at(path, what, line=line)


def _flaser(path: Path, lines: list[int], rows: list[list[bytes]]) -> ScanLines:
    counts = [_count(path, i, FLASER, f, 1, "beams") for i, f in zip(lines, rows, strict=True)]
    for line, fields, n in zip(lines, rows, counts, strict=True):
        _complete(path, line, FLASER, fields, 2 + n + len(POSES) + TAIL, f"{n} beams, two poses and stamps")
    _same_beams(path, FLASER, lines, counts)
    return _scans(path, FLASER, lines, [f[2:-2] for f in rows], counts[0])


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
    _same_beams(path, ROBOTLASER, lines, counts)
    table = _table(path, lines, heads, HEAD)
    table.require_finite(HEAD)
    table.require(table.columns["resolution"] != 0.0, "resolution", "{} rad between beams; a number above 0 is needed")
    table.require(table.columns["max_range"] > 0.0, "max_range", "{} m; a number above 0 is needed")
    head = table.stack(HEAD)
    for i in range(GEOMETRY.start, GEOMETRY.stop):
        what = f"{{}} differs from {float(head[0, i])!r} in line {lines[0]}; one geometry is needed"
        table.require(np.abs(head[:, i] - head[0, i]) <= 1e-6, HEAD[i], what)
    return replace(_scans(path, ROBOTLASER, lines, chosen, counts[0]), head=head)


def _scans(path: Path, kind: str, lines: list[int], rows: list[list[bytes]], n: int) -> ScanLines:
    """Scans from the fields of each line: n ranges (may be infinite), six numbers of poses, the stamp."""
    names = (*(f"range {i}" for i in range(1, n + 1)), *POSES, "stamp")
    values = number_rows(path, lines, rows, names)
    numbers = np.array(lines, np.int64)
    ranges = values[:, :n]
    fine = ranges >= 0.0  # false for NaN
    if not fine.all():
        row, beam = np.argwhere(~fine)[0].tolist()
        what = f"{float(ranges[row, beam])!r} is not a range; a number from 0 up is needed"
        raise DataError.at(path, what, line=lines[row], column=names[beam])
    rest = dict(zip((*POSES, "stamp"), values[:, n:].T, strict=True))
    table = Table(path, rest, line=numbers)
    table.require_finite((*POSES, "stamp"))
    return ScanLines(kind, ranges, table.stack(POSES[:3]), table.stack(POSES[3:]), rest["stamp"], numbers)


def _table(path: Path, lines: list[int], rows: list[list[bytes]], names: Sequence[str]) -> Table:
    values = number_rows(path, lines, rows, names)
    return Table(path, dict(zip(names, values.T, strict=True)), line=np.array(lines, np.int64))


PART = 1 << 16
"""Bytes unpacked at a time."""


def content_of(path: Path) -> tuple[bytes, str]:
    """Contents of a file, unpacked if its name ends in .gz, and its SHA-256 as it is; DataError if unreadable."""
    try:
        packed = path.read_bytes()
        content = _unpacked(path, packed) if path.suffix.lower() == ".gz" else packed
        return content, hashlib.sha256(packed).hexdigest()
    except gzip.BadGzipFile:
        raise DataError.at(path, "not a gzip file; compress it, or rename it without .gz") from None
    except (EOFError, zlib.error) as error:
        raise DataError.at(path, f"the gzip file is broken or cut off ({error}); a whole one is needed") from None
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from None


def _unpacked(path: Path, packed: bytes) -> bytes:
    """The content of a gzip file; logs pack to about a fifth, so much larger contents are refused."""
    most = max(LARGE, DENSEST * len(packed))
    parts, length = [], 0
    with gzip.open(io.BytesIO(packed)) as file:
        while part := file.read(PART):
            parts.append(part)
            length += len(part)
            if length > most:
                what = f"{len(packed)} bytes that unpack to more than {most}"
                raise DataError.at(path, f"{what}; logs pack to about a fifth")
    return b"".join(parts)
