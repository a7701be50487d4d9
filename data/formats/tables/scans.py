"""Laser scans of a table, a row each: ranges in columns that are numbered, angles in others or as stated."""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from types import SimpleNamespace

import numpy as np

from data.columns.named import LENGTH, STAMP
from data.csv_table import Table, is_number
from data.errors import DataError, UsageError
from data.formats.arrays import ELEMENT, is_arrays
from data.formats.bags import GEOMETRY, Collected, LaserScans, scans_of
from data.formats.recordings.beams import resampled
from data.formats.results.reading import words_of
from data.formats.tables.files import ANGLE, DIMENSIONS, Columns, described, stem_of
from data.formats.tables.motion import Odometry
from data.formats.text import TextTable
from data.inputs import IntArray
from data.se2 import Array

RANGE = re.compile(r"(?:.*[._])?ranges?[._\[]?\d+\]?")
FAR, MOST = frozenset(("range", "ranges", "distance", "distances", "dist")), 4000  # Words of ranges; beams of a scan
BEAMS = 30  # Least numbers of a row that are taken for a scan
STATED = ("angle_min", "angle_increment", "range_max")
ALIKE = {"start": "min", "first": "min", "end": "max", "last": "max", "angular": "angle"}
ALIKE |= dict.fromkeys(("inc", "step", "resolution"), "increment")
"""Words for those of `GEOMETRY`."""
NOTHING, SHARE = 0.05, 0.01  # A range that no scanner measures, and the share of all from which it stands for none
UNLIKELY = 1000.0  # m, a middle range that no scanner measures
TURNS = 4.0 * math.pi, 721.0  # Angle between the outer beams, above as many rad and below as many degrees in degrees


def read_scans(
    file: TextTable, columns: Columns, scanner: Array | None, odometry: Odometry, mount: Array | None = None
) -> tuple[LaserScans, Table]:
    """All scans, and their stamps as a table; without stamps one for each row of the odometry. `scanner`: (3,) first
    angle, step [rad] and reach [m]; `mount`: (3,) its pose on the robot. DataError: bad fields; UsageError: no angles.
    """
    at = {name.rpartition(".")[2]: k for k, name in enumerate(file.names)}
    numbers = _geometry(file.names)
    first = columns.find(file, "scans", "range")
    beams = [k for k, name in enumerate(file.names) if RANGE.fullmatch(name)]
    t = columns.find(file, "scans", "t")
    if first is not None:  # of an array named Z those named Z_1, Z_2, ...
        stem = file.names[first].rstrip("0123456789")
        end = len(file.names) - (file.names[-1] == "frame")
        beams = [k for k in range(first, end) if k != t and (not stem or file.names[k].startswith(stem))]
        ends = {k: name.removeprefix(stem) for k, name in enumerate(file.names) if stem and name.startswith(stem)}
        number = {k: int(end) for k, end in ends.items() if end.isdecimal()}
        if {*beams} <= {*number}:  # arrays may be stored in another order
            beams = sorted((k for k in number if number[k] >= number[first]), key=number.__getitem__)
    listed = at.get("ranges") if not beams else None  # in one field
    if not beams and listed is None and (wide := wide_in(file, stated=True)):  # the only array of many numbers
        beams = list(range(file.names.index(wide[0]), file.names.index(wide[1]) + 1))
        columns.notes.append(f"{file.path.name}: inferred: --columns scans.range={wide[0]}")
    if not beams and listed is None:
        what = f"no scans: {described(file)}; columns such as range0, range1 are needed"
        raise DataError.at(file.path, f"{what}, or --columns scans.range=N: all from the N-th on")
    metre = columns.units.factor("scans", "range")

    def fields_of(row: Sequence[str]) -> list[str]:
        return [row[j] for j in beams] if listed is None else row[listed].strip("()[] ").split(",")

    read = [metre * float(f) for row in file.rows for f in fields_of(row) if is_number(f)]
    middle = float(np.median([r for r in read if 0.0 < r < math.inf] or [0.0]))
    if middle > UNLIKELY and not {"scans.range", "range", "length"} & {*columns.units.given}:
        metre, read = LENGTH["mm"], [LENGTH["mm"] * r for r in read]
        told = f"--unit scans.range=mm, as the middle range is {middle:.6g}"
        columns.notes.append(f"{file.path.name}: inferred: {told} (--unit scans.range=m reads it as written)")
    far = max(filter(math.isfinite, read), default=0.0)
    reach = far * (1.0 if read.count(far) > 2 else 1.001)  # where several have it, what stands for no return
    if scanner is None and not {"angle_min", "angle_max"} <= {*numbers} and not {*STATED} <= {*numbers}:
        scanner = _listed_angles(file, beams, columns, reach)
    there = [k for k, row in enumerate(file.rows) if listed is not None or any(row[j] for j in beams)]
    if len(beams) > 1 and len(there) < len(file):  # a shorter array than others
        file = replace(file, rows=tuple(file.rows[k] for k in there), line=file.line[there])
    file, beams, stamp = _folded(file, beams[0], columns, odometry) if len(beams) == 1 else (file, beams, None)
    slots: IntArray = np.arange(len(beams))
    if scanner is not None and len(scanner) > 3:
        slots, scanner = _uneven(scanner, len(beams))
    if scanner is not None and (int(slots.max()) - 0.5) * abs(scanner[1]) > 2.0 * np.pi:
        what = f"{len(beams)} beams, {math.degrees(scanner[1]):.4g} deg apart, pass a full turn"
        raise UsageError(f"--scanner: {what}; are there intensities between the ranges? Leave their columns out")
    if stamp is None:
        rows = odometry.rows if len(file) == len(odometry.rows) else odometry.rows[~np.isnan(odometry.rows)]
        stamped = t is not None or len(file) != len(rows)
        stamp = columns.stamps(file, "scans", np.ones(len(file), bool)) if stamped else rows
    found, header = Collected(), SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="laser")
    given = {} if scanner is None else dict(zip(STATED, scanner.tolist(), strict=True))
    least, often = np.unique([r for r in read if 0.0 < r < NOTHING], return_counts=True)
    same = float(least[often.argmax()]) if len(often) and often.max() > SHARE * len(read) else 0.0
    if same:  # more often than any robot is so close to a wall
        columns.notes.append(f"{file.path.name}: inferred: {same:g} m, {often.max()} times, stands for no return")
    inferred = scanner is None and "range_max" not in numbers
    known, unit = {"range_max": reach} if inferred else {}, 1.0
    for k, (row, line) in enumerate(zip(file.rows, file.line.tolist(), strict=True)):
        fields = [f or "nan" * (listed is None) for f in fields_of(row)]
        if (slots != range(len(slots))).any():
            each = dict(zip(slots.tolist()[::-1], fields[::-1], strict=True))  # of beams at one angle the first
            fields = [each.get(slot, "nan") for slot in range(max(each) + 1)]
        if (wrong := next((f for f in fields if not is_number(f)), None)) is not None:
            raise DataError.at(file.path, f"{wrong!r} is not a number", line=line)
        last = max(len(fields) - 1, 1)
        known |= {name: si * float(row[j]) for name, (j, si) in numbers.items() if is_number(row[j])} | given
        own = dict(known)  # of a key alone that of the first row
        own["range_min"] = max(own.get("range_min", 0.0), 1.001 * same)
        if {"angle_min", "angle_max"} <= {*own}:
            own.setdefault("angle_increment", (own["angle_max"] - own["angle_min"]) / last)
        if missing := [name for name in STATED if name not in own]:
            what = f"{file.path.name} names no {', '.join(missing)}"
            raise UsageError(f"--scanner LOW,STEP,MAX, as in -90deg,0.5deg,8m, is needed: {what}")
        if k == 0 and inferred:
            columns.notes.append(f"{file.path.name}: inferred: reach {reach:g} m, the farthest reading")
        own.setdefault("angle_max", own["angle_min"] + last * own["angle_increment"])
        if k == 0 and not given and TURNS[0] < last * abs(own["angle_increment"]) < TURNS[1]:
            unit = ANGLE["deg"]
            columns.notes.append(f"{file.path.name}: inferred: angles of beams in deg, as in rad they pass two turns")
        ranges = [metre * float(f) for f in fields]
        angles = {name: unit * own[name] for name in GEOMETRY[:3]}
        message = SimpleNamespace(header=header, ranges=ranges, **own | angles)
        found.scans.add(message, float(stamp[k]), f"{file.path}:{line}")
    used = (*beams, *(j for j, _ in numbers.values()), t)
    columns.read |= {(file.path, file.names[k]) for k in used if k is not None}
    if mount is not None:
        turned = (0.0, 0.0, math.sin(0.5 * mount[2]), math.cos(0.5 * mount[2]))
        found.tree.add("", header.frame_id, 0.0, (*mount[:2].tolist(), 0.0, *turned), static=True)
    seen = scans_of(file.path, (), found, "", (-math.inf, math.inf))  # the caller drops some
    return seen, Table(file.path, {"t": seen.stamp}, line=np.arange(1, len(seen.stamp) + 1))


def wide_in(file: TextTable, *, stated: bool) -> list[str]:
    """First and last name of the only columns of a scan; without a `stated` scanner their names tell that they are."""
    runs = [names for _, run in groupby(file.names, key=stem_of) if len(names := list(run)) >= BEAMS and file.named]
    words = [{*words_of(stem_of(names[0]))[0]} for names in runs]
    fits = [bool(of & SCANNED) or (stated and not of & {"cov", "covariance"}) for of in words]
    told = [names for names, fit in zip(runs, fits, strict=True) if fit]
    told = [names for names in told if {*words_of(stem_of(names[0]))[0]} & SCANNED] or told
    return [told[0][0], told[0][-1]] if len(told) == 1 else []


SCANNED = FAR | frozenset(("scan", "scans", "laser", "lidar", "beam", "beams", "ray", "rays", "d"))


def folded_up(file: TextTable, columns: Columns, moves: bool) -> TextTable | None:
    """A table with a row for each beam as one with a row for each scan, of equal angles, the middle step apart; scans
    change with a stamp or number, or where angles begin anew, or turn back. None of a table without angles and ranges,
    or points; beside poses, if it `moves`, angles must be those of beams.
    """
    theta = columns.quiet.find(file, "odometry", "theta") if moves else None
    words = [{*words_of(name)[0]} if k != theta else set() for k, name in enumerate(file.names)]
    at, far = ([k for k, of in enumerate(words) if of & some and file.named] for some in (ANGLES, FAR))
    if columns.stated("scans", ("bearing",)) and columns.stated("scans", ("range",)):
        at, far = ([columns.find(file, "scans", q) or 0] for q in ("bearing", "range"))
    elif not at and not far:
        at, far = _turning(file)
    if not at and not far and not moves:
        file, at, far = _polar(file)
    if len(at) != 1 or len(far) != 1:
        return None
    filled = [row[at[0]] != "" != row[far[0]] for row in file.rows]  # of arrays of several lengths
    there = [k for k, row in enumerate(file.rows) if filled[k] and is_number(row[at[0]]) and is_number(row[far[0]])]
    if len(there) < max(2.0, STEADY * sum(filled)):  # the others are words, such as names that come again
        return None
    file = replace(file, rows=tuple(file.rows[k] for k in there), line=file.line[there])
    angle, distance = (np.array([row[k] for row in file.rows], float) for (k,) in (at, far))
    if (length := words_of(file.names[far[0]])[1]) in LENGTH and columns.units.unit("scans", "range") is None:
        distance = LENGTH[length] * distance
    keys = ({ELEMENT, "frame"}, {*STAMP, "scan", "revolution"})
    key = next((k for some in keys for k, of in enumerate(words) if of & some and k not in (*at, *far)), at[0])
    turn = np.cumsum([a[key] != b[key] for a, b in pairwise([file.rows[0], *file.rows])])
    leap = np.diff(angle, prepend=angle[0])
    if key == at[0] or len(file) < BEAMS * turn[-1]:
        if file.names[at[0]] == POINTS:  # of no scan: places
            return None
        turn = np.cumsum(-np.sign(leap) * (np.abs(leap) > 0.5 * np.ptp(angle)))  # back where rows are out of order
        turn = turn * np.sign(turn[-1])
        if not turn.any() and len(moved := np.flatnonzero(leap)):  # a servo, which turns back
            way = np.sign(leap)[moved[np.minimum(np.searchsorted(moved, np.arange(len(leap))), len(moved) - 1)]]
            turn = np.cumsum(np.diff(way, prepend=way[0]) != 0.0)
    if moves and np.mean(np.abs(leap - np.median(leap)) < 0.5 * np.abs(np.median(leap))) < 1.0 - 1.0 / BEAMS:
        return None
    _, first, of, count = np.unique(turn, return_index=True, return_inverse=True, return_counts=True)
    step = float(np.median(np.abs(np.diff(angle))))
    if len(first) < 2 or np.median(count) < BEAMS or not 0.0 < np.ptp(angle) <= MOST * step:  # or blank
        return None
    unit = words_of(file.names[at[0]])[1] or ("deg" if float(np.ptp(angle)) > TURNS[0] else "rad")
    stated = columns.units.unit("scans", "bearing") or columns.units.given.get("angle")
    printed = {"theta", "Dist", "Q"} <= {*file.names}
    si = columns.units.factor("scans", "bearing") if stated else ANGLE[unit] * (-1.0 if printed else 1.0)
    step, angle = step * abs(si), angle * si
    grid = np.arange(angle.min(), angle.max() + 0.5 * step, step)
    ranges = np.zeros((len(first), len(grid)))
    for k, own in enumerate(np.split(np.lexsort((angle, of)), np.cumsum(count)[:-1])):
        place = np.interp(grid, angle[own], np.arange(len(own)))
        near = np.abs(angle[own][np.rint(place).astype(int)] - grid) < NEAR * step
        ranges[k] = np.where(near, resampled(distance[own], place), np.nan)
    rest = [k for k in range(len(file.names)) if k not in (*at, *far)]
    known = {"angle_min": angle.min(), "angle_increment": step}
    names = (*(file.names[k] for k in rest), *known, *map("range_{}".format, range(len(ranges.T))))
    before = ((*(file.rows[k][j] for j in rest), *(repr(float(v)) for v in known.values())) for k in first.tolist())
    rows = tuple((*own, *map(repr, row)) for own, row in zip(before, ranges.tolist(), strict=True))
    columns.given = {key: name for key, name in columns.given.items() if key not in ("scans.bearing", "scans.range")}
    echoes = int(np.sum(np.isfinite(distance) & (distance > 0.0)))
    cut = f"inferred: {len(rows)} scans, a row for each beam, in steps of {math.degrees(step):.4g} deg; {echoes} echoes"
    cut += f", {len(file) - echoes} rows without one; columns {file.names[at[0]]} and {file.names[far[0]]}"
    ways = ("anticlockwise", f"-{unit}: clockwise"), ("clockwise, as RPLIDAR prints them", "deg: anticlockwise")
    cut += "; angles count {} (--unit scans.bearing={})".format(*ways[printed]) * (not stated)
    return replace(file, names=names, rows=rows, line=file.line[first], named=True, cut=cut)


def _unnamed(file: TextTable) -> list[int]:
    """Columns of a table without names, or numbered ones of arrays and of a folder, where they are few."""
    arrays = is_arrays(file.path) or file.path.is_dir()
    told = (".key", ".value", *"0123456789")
    free = [k for k, name in enumerate(file.names) if not file.named or (arrays and name.endswith(told))]
    return free if len(free) <= FEWEST else []


def _polar(file: TextTable) -> tuple[TextTable, list[int], list[int]]:
    """A table of points x, y, or of two unnamed numbers of any sign, with their angles and ranges in the same columns,
    and these; none without points.
    """
    named = [k for name in "xy" for k, other in enumerate(file.names) if words_of(other)[0] == [name]]
    a, b = (named if len(named) == 2 else [*_unnamed(file), 0, 0])[:2]
    rows = [row for row in file.rows if is_number(row[a]) and is_number(row[b])]
    x, y = (np.array([row[k] for row in rows], float) for k in (a, b))
    if a == b or len(rows) < 2 or (x.min() >= 0.0 and y.min() >= 0.0) or (len(_unnamed(file)) != 2 and not named):
        return file, [], []
    polar = zip(np.arctan2(y, x).tolist(), np.hypot(x, y).tolist(), rows, strict=True)
    rows = [
        tuple({a: repr(at), b: repr(far)}.get(k, field) for k, field in enumerate(row)) for at, far, row in polar if far
    ]
    names = tuple({a: POINTS, b: "range"}.get(k, name) for k, name in enumerate(file.names))
    return replace(file, names=names, rows=tuple(rows), line=np.arange(1, len(rows) + 1), named=True), [a], [b]


def _turning(file: TextTable) -> tuple[list[int], list[int]]:
    """Columns of a beam's angle and range among unnamed ones: angles ascend, or descend, and begin anew; ranges differ
    most. None where names tell others, or two columns may be the range.
    """
    some = [k for k in _unnamed(file) if is_number(file.rows[-1][k])]
    rows = [row for row in file.rows if all(is_number(row[k]) for k in some)]
    values = {k: np.array([row[k] for row in rows], float) for k in some} if len(rows) > 2 * BEAMS else {}
    at, size = list[int](), dict[int, int]()
    for k, v in values.items():
        step, whole = np.diff(v), float(np.ptp(v))
        new = np.abs(step) > 0.5 * whole
        on = step[~new] * -np.sign(step[new].sum())
        turns = 0 < BEAMS * new.sum() < len(v) and np.mean(on >= 0.0) > STEADY and np.any(on)
        at += [k] * bool(turns and QUARTER <= whole <= TURN)
        size[k] = 0 if (step >= 0.0).all() or (v < 0.0).any() else len(np.unique(v))
    far = sorted((k for k in size if k not in at), key=size.__getitem__)
    sure = len(at) == 1 and far and (len(far) == 1 or 2 * size[far[-2]] < size[far[-1]])
    return (at, far[-1:]) if sure else ([], [])


POINTS = "angle of points [rad]"  # Name of their column
QUARTER, TURN, STEADY = 0.5 * math.pi, 361.0, 0.95
"""Least and most of all angles, in rad or deg; share of steps between beams that have one sign."""
NEAR = 0.75  # Steps from a beam within which its range is measured


def _listed_angles(file: TextTable, beams: Sequence[int], columns: Columns, reach: float) -> Array | None:
    """Angles of all beams, of the only array of angles that has as many numbers, in each row the same if they stand
    there, and the reach; else None.
    """
    found = []
    for name, run in groupby((k for k in range(len(file.names)) if k not in beams), lambda k: stem_of(file.names[k])):
        fields = [row[k] for k in run for row in file.rows if row[k]]
        told = {*words_of(name)[0]} & ANGLES and all(map(is_number, fields))
        each = np.reshape(fields, (len(beams), -1)).astype(float) if told and not len(fields) % len(beams) else None
        if each is not None and np.ptp(each[:, :1], axis=None) > 0.0 and (each == each[:, :1]).all():
            found.append((name.strip("_"), each[:, 0]))
    if len(found) != 1:
        return None
    name, angles = found[0]
    deg = words_of(name)[1] == "deg" or float(np.ptp(angles)) > TURNS[0]
    columns.read |= {(file.path, own) for own in file.names if own.startswith(name)}
    what = f"{name} are the angles of beams{', in deg' * deg}; reach {reach:g} m"
    columns.notes.append(f"{file.path.name}: inferred: {what}")
    return np.append(angles * (ANGLE["deg"] if deg else 1.0), reach)


ANGLES = frozenset(("angle", "angles", "angule", "bearing", "bearings", "azimuth", "azimuths", "theta", "phi"))


def _geometry(names: Sequence[str]) -> dict[str, tuple[int, float]]:
    """Column and unit of each number of `GEOMETRY`, as min_angle, rangeMax [m] or angular_resolution name it."""
    found: dict[str, tuple[int, float]] = {}
    for k, name in enumerate(names):
        words, unit = words_of(name.rpartition(".")[2])
        two = {ALIKE.get(word, word) for word in words} - {"laser", "lidar", "scan", "scanner"}
        key = next((g for g in GEOMETRY if {*g.split("_")} == two), "")
        known = DIMENSIONS["length" if key.startswith("range") else "angle"]
        if key and unit in ("", *known):
            found.setdefault(key, (k, known.get(unit, 1.0)))
    return found


def _uneven(scanner: Array, beams: int) -> tuple[IntArray, Array]:
    """Places (beams + 1,) of stated angles among equal steps, first angle, step and reach. UsageError: no step fits."""
    angles, reach = scanner[:-1], scanner[-1]
    off = angles - angles.min()
    gap = float(np.diff(np.unique(angles)).min(initial=2.0 * np.pi)) if len(angles) == beams else 0.0
    fine = [gap / k for k in range(1, 21) if gap and np.abs(off * k / gap - np.rint(off * k / gap)).max() < 0.02]
    if not fine:
        what = f"{len(angles)} angles for {beams} beams; LOW,STEP,MAX, or an angle for each and the reach, is needed"
        raise UsageError(f"--scanner: {what}")
    return np.rint(off / fine[0]).astype(np.int64), np.array([angles.min(), fine[0], reach])


def _folded(file: TextTable, beam: int, columns: Columns, odometry: Odometry) -> tuple[TextTable, list[int], Array]:
    """Scans whose ranges stand in one column, a row each, and their stamps; DataError where that is ambiguous."""
    count = 1 + max((k for k, row in enumerate(file.rows) if row[beam]), default=-1)
    stamp, what, uneven = odometry.rows[~np.isnan(odometry.rows)], "poses", False
    if columns.find(file, "scans", "t") is not None:
        stamp, what = columns.stamps(file, "scans", np.ones(len(file), bool)), "stamps"
        stamp = stamp[~np.isnan(stamp)]
    if len(stamp) == count:  # of each range
        first = np.flatnonzero(np.diff(stamp, prepend=-np.inf) != 0.0)
        stamp, uneven = stamp[first], len(np.unique(np.diff(first, append=count))) > 1
    each, rest = divmod(count, max(len(stamp), 1))
    if rest or uneven or each < 2:
        told = f"{count} ranges in one column and {len(stamp)} {what}: how many are a scan? As many for each are needed"
        raise DataError.at(file.path, f"{told}, {OTHERWISE}; ranges to landmarks are --observations")
    columns.notes.append(f"{file.path.name}: inferred: scans of {each} beams, {count} ranges for {len(stamp)} {what}")
    names = (*file.names, *(f"{file.names[beam]} {k}" for k in range(2, each + 1)))
    rows = tuple((*file.rows[k], *(r[beam] for r in file.rows[k + 1 : k + each])) for k in range(0, count, each))
    file, beams = replace(file, names=names, rows=rows, line=file.line[:count:each]), range(len(file.names), len(names))
    return file, [beam, *beams], stamp


def alone_in(file: TextTable, rows: int) -> dict[str, str]:
    """Columns of a file without names that holds ranges alone, or behind stamps; else none."""
    if file.named or len(file.names) < BEAMS or not all(is_number(f or "0") for row in file.rows for f in row):
        return {}
    values = np.nan_to_num(np.array([[f or "0" for f in row] for row in file.rows], float), posinf=0.0)
    step = np.diff(values[:, 0])
    before = len(step) >= FEWEST and bool((step > 0.0).all())
    stamped = before and not (len(values) == rows and values[0, 0] in (0.0, 1.0) and (step == 1.0).all())
    apart = np.median(np.abs(np.diff(values[:, before:])), axis=0)  # of neighbours, which are alike
    ends = max(apart[:FEWEST].max(), apart[-FEWEST:].max())
    fine = (values[:, before:] >= 0.0).all() and ends <= ALIKE_ENDS * apart[FEWEST:-FEWEST].max()
    told = {"scans.t": "1"} if stamped else {}
    return {**told, "scans.range": str(1 + before)} if fine and (stamped or len(values) == rows) else {}


OTHERWISE = "a column for each beam, or the angle of each range (--columns scans.bearing=NAME)"
ALIKE_ENDS = 2.0  # Times as far apart as other neighbours the first and the last may be: walls ahead, seen obliquely
FEWEST = 8  # Least steps forward that no ranges make; columns at both ends that are compared with the others
