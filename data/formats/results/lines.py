"""Text files of trajectories, and those with one pose a line: TUM, SQUARE, OpenVINS, KITTI and EuRoC.

docs/results-files.md lists the columns. A triangle of a covariance is the lower one, row by row (c11 c21 c22 ... c66),
translation first; without a header T = T_mean Exp(xi), in the body's axes. `#%KEY value` lines declare the tangent.
"""

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import scipy

from data.columns.named import STAMP
from data.csv_table import cut_off, is_number, symmetric
from data.dates import EXAMPLE, ISO
from data.earth import placed
from data.errors import LARGEST, DataError, UsageError
from data.formats.arrays import is_arrays
from data.formats.messages import kinds_of, runs_of
from data.formats.results import path as paths
from data.formats.results.space import UNIT, known_only, on_plane, rotations, translation_first
from data.formats.text import Text, read_text
from data.se2 import Array

POSE = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
TRIANGLE = tuple(f"c{i}{j}" for i in range(1, 7) for j in range(1, i + 1))
ENTRIES_6 = tuple(f"c{i}{j}" for i in range(1, 7) for j in range(1, 7))
BLOCKS = tuple(f"P{block}{i}{j}" for block in "rt" for i in (1, 2, 3) for j in range(i, 4))
"""Upper triangles of OpenVINS: rotation, then position."""
SAME_STAMP = 1e-6  # s, largest difference of a covariance's stamp from its pose's
GAUSSIAN, DETERMINISTIC = "gaussian_se3", "deterministic"
UNITS = {"seconds": "s", "s": "s", "milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}
CONVENTIONS = {"right_perturbation": paths.LOCAL, "left_perturbation": paths.LEFT}
ORDERS = {"translation_rotation": paths.TRANSLATION, "rotation_translation": paths.ROTATION}
ENTRIES = tuple(f"r{i}{j}" if j < 4 else f"t{i}" for i in (1, 2, 3) for j in (1, 2, 3, 4))
LAYOUTS = {  # Places in a row of the upper three rows of a 4 x 4 pose
    "by rows": tuple(range(12)), "rotation, then position": (0, 1, 2, 9, 3, 4, 5, 10, 6, 7, 8, 11),
    "position, then rotation": (3, 4, 5, 0, 6, 7, 8, 1, 9, 10, 11, 2),
    "by columns": (0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14),
}  # fmt: skip
HEIGHTS = ((1, 0), (4, 0), (4, 1), (3, 0), (3, 1))  # Lines of a pose, and above it: of its stamp, or of other numbers
COLMAP = "images by name; their poses, of the world in the camera, are inverted (`--axes` with robot: as written)"
LISTS = (
    ("(p|t|pos|position|trans|translation|loc|location|xyz)s?", ("x", "y"), POSE[1:4]),
    ("(q|quat|quaternion|rot|rotation|orientation)s?", POSE[4:]), ("(pose|state)s?", ("x", "y", "theta"), POSE[1:]),
)  # fmt: skip
"""Last words of names NAME_1, NAME_2, ..., and what as many columns are."""
ABOUT_Z = 0.3  # Largest part about x and y of quaternions of what is nearly upright: tilted by 35 deg
EUROC = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")


def declared(text: Text) -> dict[str, tuple[int, str]]:
    """Values of the lines `#%KEY value` by key, with the numbers of these lines."""
    header: dict[str, tuple[int, str]] = {}
    for number, comment in text.comments:
        if comment.startswith("#%"):
            key, _, value = comment[2:].strip().partition(" ")
            if key.upper() in header:
                raise DataError.at(text.path, f"{key} is stated twice; once is needed", line=number)
            header[key.upper()] = number, value.strip()
    return header


def _one_of(text: Text, key: str, allowed: Collection[str]) -> str | None:
    """A value of the header that must be one of a few; None if absent."""
    line, value = declared(text).get(key, (0, None))
    if value is not None and value not in allowed:
        raise DataError.at(text.path, f"{key} {value!r}; one of {', '.join(allowed)} is needed", line=line)
    return value


def layout_of(rows: Sequence[Sequence[str]]) -> str:
    """Which of `LAYOUTS` rows of 12 or 16 numbers have, most of whose poses are rigid motions; empty for other rows."""
    wide = len(rows[0])
    if wide not in (12, 16) or not all(len(row) == wide and all(map(is_number, row)) for row in rows):
        return ""
    table = np.array(rows, float)
    fits = (how for how, order in LAYOUTS.items() if max(order) < wide
            and (np.delete(table, order, axis=1) == (0.0, 0.0, 0.0, 1.0)[: wide - 12]).all()
            and np.median(_off(table[:, order].reshape(-1, 3, 4))) < UNIT)  # fmt: skip
    return next(fits, "")


def _off(P: Array) -> Array:
    """How far the rotations of poses (n, 3, 3 or 4) are from any (n,)."""
    R = np.where(np.abs(P) < LARGEST, P, np.nan)[:, :, :3]
    return np.asarray(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max((1, 2)) + (np.linalg.det(np.nan_to_num(R)) < 0))


def turns_in(rows: Array) -> int:
    """The first of nine columns of rows (n, k) that are rotation matrices; -1 without such."""
    begins = range(min(rows.shape[1], 100) - 8)  # of a pose among few other numbers
    return next((k for k in begins if np.median(_off(rows[:, k : k + 9].reshape(-1, 3, 3))) < UNIT), -1)


def in_rows(text: Text, *, named: bool) -> Text:
    """The text with a pose's upper three rows in each, where it holds matrices, in one row or in several, behind a
    stamp or not; of arrays with one matrix, whose columns have no names of their own and nobody `named`, without names.
    """
    if any("IMAGE_ID" in comment for _, comment in text.comments):  # COLMAP: a line of points below each
        images = sorted((row[-1], k) for k, row in enumerate(text.fields) if not is_number(row[-1]))
        rows, line = zip(*((text.fields[k], text.line[k]) for _, k in images), strict=True)
        text = replace(text, fields=rows, line=line, cut=COLMAP)
    stems = [n.rpartition("_") for n in text.fields[0]] if is_arrays(text.path) else []
    if not named and len({stem for stem, _, number in stems if number.isdecimal()} - {""}) == 1:
        first = [re.sub("[^a-z]", "", name.lower()) not in STAMP for name in text.fields[0]]  # stamps before poses
        order = [j for j in np.argsort(first, kind="stable") if text.fields[-1][j]]  # no single numbers beside them
        below = tuple(tuple(row[j] for j in order) for row in text.fields[1:])
        text = replace(text, fields=below, line=text.line[1:], separator=" ")
    rows = text.fields
    for high, above in HEIGHTS if len(rows[-1]) in (4, 12, 13, 16, 17) else ():
        size = high + above
        if (high > 1 and any((k % size < above) == (len(row) == 4) for k, row in enumerate(rows))) or len(rows) % size:
            continue
        each = [rows[k : k + size] for k in range(0, len(rows), size)]
        joined = [(*(b[0] if above and len(b[0]) == 1 else ()), *chain(*b[above:])) for b in each]
        for before in (0, 1):
            if how := layout_of([row[before:] for row in joined]):
                fields = tuple((*row[:before], *(row[before + k] for k in LAYOUTS[how])) for row in joined)
                said = "; ".join(
                    filter(None, (text.cut, f"inferred: each pose is a matrix, {how}" * (how != "by rows")))
                )
                return replace(text, fields=fields, line=text.line[::size], separator=" ", cut=said)
    return text


def in_names(text: Text) -> Text:
    """The text with columns of a place and a quaternion for those named as entries of a matrix or a list, and for cells
    that hold a list. A matrix that is no rotation is not known; of nine entries none is that of a covariance.
    """
    head, *below = text.fields
    names, rows = [*head], [*map(list, below)]
    groups, said = dict[str, list[tuple[str, int]]](), [text.cut] * bool(text.cut)
    for j, name in enumerate(names):
        if (stem := re.sub(r"[\W_]*\d[\d\W_]*$", "", name)) != name:
            groups.setdefault(stem, []).append((re.sub(r"\D", "", name[len(stem) :]).zfill(2), j))
    if not groups or 2 * sum(map(is_number, head)) >= len(head) or {len(row) for row in rows} != {len(names)}:
        return text
    for stem, some in groups.items():
        at, word = [j for _, j in sorted(some)], re.split(r"[\W_]", stem)[-1]
        each = [[row[j] for j in at] + ["0"] * 3 * (len(at) == 9 and word[:1] not in "cCpPsS") for row in rows]
        roles = next(
            (r for w, *of in LISTS for r in of if len(r) == len(at) and re.fullmatch(w, word.lower()) and word != "P"),
            (),
        )
        if how := layout_of(each[:1000]) and layout_of(each):
            P, roles = np.array(each, float)[:, LAYOUTS[how]].reshape(-1, 3, 4), POSE[4 if len(at) == 9 else 1 :]
            P[bad := ~(_off(P) < UNIT), :, :3] = np.eye(3)
            q = scipy.spatial.transform.Rotation.from_matrix(P[:, :, :3]).as_quat()
            q[bad] = np.nan
            each = [[*map(repr, row)] for row in np.column_stack([P[:, :, 3], q])[:, -len(roles) :].tolist()]
        elif roles == POSE[4:] and all(map(is_number, chain(*each))):
            square = np.array(each, float) ** 2  # nearer upright through the path
            first, last = np.median(square[:, 1] + square[:, 2]), np.mean(square[:, 0] + square[:, 1])
            roles = ("qw", *POSE[4:7]) if first < ABOUT_Z**2 < last else roles
        if roles:
            said.append(f"inferred: {names[at[0]]} to {names[at[-1]]} are {', '.join(roles)}")
            own = [stem.removesuffix(word) + role for role in roles]
            for row, values in zip((names, *rows), (own, *each), strict=True):
                for k, j in enumerate(at):
                    row[j] = values[k] if k < len(roles) else ""
    return replace(text, fields=(tuple(names), *map(tuple, rows)), cut="; ".join(said)) if said else text


def numbers(text: Text, columns: Sequence[str], *, blank: bool = False, huge: Collection[str] = ()) -> Array:
    """The fields as numbers (n, columns), NaN where unknown, as an infinite covariance is, and where they may be blank;
    those of `huge` columns may exceed `LARGEST`.
    """
    for line, fields in zip(text.line, text.fields, strict=True):
        if len(fields) != len(columns):
            last = cut_off(len(fields), len(columns), last=line == text.line[-1])
            raise DataError.at(text.path, f"{len(fields)} fields; {len(columns)} are needed{last}", line=line)
    rows = [tuple(field or "nan" for field in fields) for fields in text.fields] if blank else text.fields
    if (k := next((k for k, field in enumerate(chain(*rows)) if not is_number(field)), None)) is not None:
        row, j = divmod(k, len(columns))
        raise DataError.at(text.path, f"{rows[row][j][:40]!r} is not a number", line=text.line[row], column=columns[j])
    found = np.array([*map(float, chain(*rows))]).reshape(-1, len(columns))
    of_covariance = [n.startswith(("c_", "s_")) or (n[:1] in "cPf" and n[-1:].isdigit()) for n in columns]
    beyond = (np.abs(found) > LARGEST) & (np.isinf(found) | [name not in huge for name in columns])
    for row, j in np.argwhere(beyond & ~np.array(of_covariance)).tolist():
        unknown = ", or nan where unknown" * math.isinf(found[row, j])
        what = f"{rows[row][j][:40]}; a finite number in SI units is needed{unknown}"
        raise DataError.at(text.path, what, line=text.line[row], column=columns[j])
    return np.where(beyond, np.nan, found)


def tangent(text: Text) -> tuple[str | None, str | None]:
    """Frame and order (`COV_ORDERS`) that a header declares."""
    convention, order = _one_of(text, "TANGENT_CONVENTION", CONVENTIONS), _one_of(text, "TANGENT_ORDER", ORDERS)
    return None if convention is None else CONVENTIONS[convention], None if order is None else ORDERS[order]


def read_tum(text: Text, manner: paths.Manner) -> paths.GivenPath:
    """A TUM file, with covariances from `manner.cov` if given."""
    rows = numbers(text, POSE, huge=POSE[:1])
    time, clock = times_of(text, rows[:, 0], manner)
    rows[:, 1:4], none = placed(rows[:, 1:4], "truth" * manner.true)
    if manner.cov is None:
        return path_of(text, "TUM", (time, clock), rows, None, manner, notes=none)
    side = read_text(manner.cov)
    kept = numbers(side, ("t", *TRIANGLE), huge=("t",))
    of_side, _ = times_of(side, kept[:, 0], manner, clock)
    if len(kept) != len(rows):
        what = f"{len(kept)} covariances for the {len(rows)} poses of {text.path}"
        raise DataError.at(manner.cov, f"{what}; one each is needed")
    off = np.flatnonzero(np.abs(of_side - time) > SAME_STAMP)
    if len(off):
        k = int(off[0])
        what = f"stamp {kept[k, 0]!r}; {rows[k, 0]!r} is needed, as of the pose at {text.place(k)}"
        raise DataError.at(manner.cov, what, line=side.line[k])
    kind = f"TUM with covariances of {manner.cov}"
    return path_of(text, kind, (time, clock), rows, symmetric(kept[:, 1:], lower=True), manner, declared=side)


def read_square(text: Text, manner: paths.Manner) -> paths.GivenPath:
    """A SQUARE file."""
    header = declared(text)
    line, version = header["FORMAT"]
    if not version.startswith("SQUARE/"):
        raise DataError.at(text.path, f"FORMAT {version!r}; SQUARE/0.3 is needed", line=line)
    what = _one_of(text, "REPRESENTATION", (GAUSSIAN, DETERMINISTIC))
    if what is None:
        raise DataError.at(text.path, f"the header lacks REPRESENTATION ({GAUSSIAN} or {DETERMINISTIC})", line=line)
    unit = UNITS[_one_of(text, "TIMESTAMP_UNIT", UNITS) or "seconds"]
    world, body = (header.get(key, (0, ""))[1] for key in ("POSE_FRAME", "BODY_FRAME"))
    stated = paths.Stated(world, body)
    bare = what == DETERMINISTIC
    for key, found in zip(("TANGENT_CONVENTION", "TANGENT_ORDER"), tangent(text), strict=True):
        if found is None and not bare:
            raise DataError.at(text.path, f"the header lacks {key}; {GAUSSIAN} needs it", line=line)
    if not bare:
        _one_of(text, "ROTATION_PARAM", ("axis_angle",))
    rows = numbers(text, POSE if bare else (*POSE, *TRIANGLE), huge=POSE[:1])
    C = None if bare else symmetric(rows[:, 8:], lower=True)
    at = times_of(text, rows[:, 0], manner, unit=unit)
    return path_of(text, f"{version}, {what}", at, rows[:, :8], C, manner, stated=stated)


UNSTAMPED = -1  # column of stamps of a file that has none: they are numbers of rows


def times_of(
    text: Text, stamps: Array, manner: paths.Manner, clock: paths.Clock | None = None,
    *, unit: str | None = None, usual: str = "s", column: int = 0,
) -> tuple[Array, paths.Clock]:  # fmt: skip
    """Times (n,) [s] of stamps (n,) in a column of a file, and their clock: given, of a flag, stated, or inferred. Of a
    file without stamps, or with numbers of rows, those of `manner.times`, one a line; UsageError where it has others.
    """
    if manner.times is not None and text.path != manner.times:
        if column != UNSTAMPED and not (np.diff(stamps) == 1.0).all():
            raise UsageError(f"--times {manner.times}: {text.path} has stamps of its own, not numbers of rows")
        side = read_text(manner.times)
        raw = numbers(side, ("t",), huge=("t",))[:, 0]
        if len(raw) != len(stamps):
            what = f"{len(raw)} stamps for the {len(stamps)} poses of {text.path}; one each is needed"
            raise DataError.at(manner.times, what)
        time, clock = times_of(side, raw, manner)
        return time, replace(clock, source=f" of {side.path}{' instead of numbers of rows' * (column != UNSTAMPED)}")
    unit_of_flag = manner.stamps
    if isinstance(unit_of_flag, float):
        stamps, unit_of_flag = unit_of_flag * stamps, "s"
    known = np.flatnonzero(np.isfinite(stamps))  # DataError where they decrease
    back = np.flatnonzero(np.diff(stamps[known]) < 0.0)
    if len(back):
        k, before = int(known[back[0] + 1]), int(known[back[0]])
        late, early = (repr(float(v)) if abs(v) <= LARGEST else f"{v:.0f}" for v in (stamps[before], stamps[k]))
        what = f"stamp {early} is before {late} of the line above; ascending stamps are needed"
        several = kinds_of(text.path, text.fields) or runs_of(text.path) or "; sort rows that are only out of order"
        raise DataError.at(text.path, what + several, line=text.line[k])
    clock = paths.Clock("s", paths.ROWS) if column == UNSTAMPED else clock
    clock = paths.Clock("s", paths.DATES) if unit == paths.DATES else clock
    if clock is None and unit_of_flag is not None:
        if unit_of_flag == ISO:
            raise UsageError(f"--unit {ISO}: {text.path} has no dates as in {EXAMPLE}")
        clock = paths.Clock(unit_of_flag, paths.STATED)
    clock = clock or paths.clock_of(str(text.path), stamps, unit, usual)
    written = [] if column == UNSTAMPED else [fields[column] for fields in text.fields]
    return paths.seconds(stamps, written, clock.unit), clock


def path_of(
    text: Text, kind: str, at: tuple[Array, paths.Clock], rows: Array, C: Array | None, manner: paths.Manner,
    *, frame: str = paths.LOCAL, stated: paths.Stated = paths.SILENT, notes: tuple[str, ...] = (),
    declared: Text | None = None,
) -> paths.GivenPath:  # fmt: skip
    """Rows t x y z qx qy qz qw (n, 8) at times of a clock, with covariances (n, 6, 6), in the plane. Frame and order of
    the tangent are those of the header of the file, or of the file `declared`, if it has one.
    """
    time, clock = at
    if C is not None:
        convention, order = tangent(text)
        if declared is not None:
            own = tangent(declared)
            convention, order = own[0] or convention, own[1] or order
        frame = convention or frame
        C = translation_first(C) if order == paths.ROTATION else C
        said = stated.convention or convention is not None
        stated = replace(stated, convention=said, order=stated.order or order is not None)
        C, more = known_only(C)
        notes += more
        if C is not None and not stated.convention and manner.frame is None:
            taken = f"covariances are read as {frame} ones with the translation first"
            notes += (f"{taken}, unless --cov-frame names another",)
    absent = C is None and paths.unturned(rows[:, 4:8], rows[:, 1:4])
    if absent:
        rows[:, 4:8] = [0.0, 0.0, 0.0, 1.0]
    length = np.linalg.norm(rows[:, 4:8], axis=1, keepdims=True)
    usual = float(np.median(length))
    if usual > 0.0 and abs(usual - 1.0) > UNIT and (np.abs(length / usual - 1.0) < UNIT).all():
        rows[:, 4:8] /= length
        notes += (f"inferred: quaternions are {usual:.4g} times as long as unit ones, and scaled",)
    file, R = str(text.path), rotations(rows[:, 4:8], text.place)
    kind = f"{kind}, {clock.words}"
    s = paths.Spatial(file, kind, time, rows[:, 1:4], R, C, frame, text.place, stated, notes, clock)
    path = on_plane(s, manner)
    return paths.without_headings(path, flat="z" not in {*manner.columns, *manner.fixed}) if absent else path


def read_kitti(text: Text, manner: paths.Manner) -> paths.GivenPath:
    """Poses in a camera's axes at the stamps of `manner.times`, one per line; without these at the numbers of rows.
    With a stamp before its twelve numbers in each line (MulRan, KITTI-360) poses are in a robot's axes.
    """
    stamped = len(text.fields[0]) > len(ENTRIES)
    table = numbers(text, (*POSE[:1] * stamped, *ENTRIES), huge=POSE[:1])
    rows = table[:, -len(ENTRIES) :].reshape(-1, 3, 4)
    if stamped:
        time, clock = times_of(text, table[:, 0], manner)
    elif manner.times is None and manner.stamps is not None:
        raise UsageError(f"--unit {manner.stamps}: {text.path} has no stamps (KITTI poses); --times FILE names them")
    else:
        time, clock = times_of(text, np.arange(len(rows), dtype=float), manner, column=UNSTAMPED)
    file, R = str(text.path), rows[:, :, :3]
    wide, notes = np.ptp(rows[:, :, 3], axis=0), tuple[str, ...]()
    if stamped and manner.axes is None and (time % 1.0 == 0.0).all() and FLAT * wide[1] < min(wide[0], wide[2]):
        notes = ("inferred: its axes are a camera's, as y is by far the flattest one, and its stamps are numbers",)
        manner, stamped = replace(manner, axes=paths.CAMERA), False
    bad = np.flatnonzero(_off(rows) > UNIT)
    if len(bad):
        raise DataError.at(file, "no KITTI pose (no rotation); name columns: --columns x=2,y=3", line=text.line[bad[0]])
    usual = manner.axes is None and not stamped
    axes = "a camera's axes" if usual else f"a {manner.axes or 'robot'}'s axes"
    kind, said = f"KITTI poses in {axes}, {clock.words}", paths.Stated(axes=usual)
    return on_plane(paths.Spatial(file, kind, time, rows[:, :, 3], R, None, "", text.place, said, notes, clock), manner)


FLAT = 4.0  # Times as long as the height of a path is its way in a camera's axes, at least
