"""What columns of a file or matrix without names are: stamps ascend, headings follow the motion, landmarks stand."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from data import se2
from data.csv_table import is_number
from data.formats.arrays import ELEMENT
from data.formats.results.reading import only_reading, words_of
from data.formats.text import TextTable
from data.se2 import Array

WORDS = {
    "odometry": "odo|control|input|cmd|command|^u_", "truth": "tru|real|gt|^ref",
    "map": "map|land|lm|beacon|balis|anchor|^m_",
}  # fmt: skip
"""Parts of names of matrices that tell a role, where a file has several."""
SEEN = "obs|meas|detect|range|bear|dist|noise|sigma|std|cov"  # of no role's
LARGEST = 3.0 * np.pi  # rad, a direction of half a turn less a heading of one: bearings that were not wrapped
SPANS = (1, 4, 16)  # Observations of a landmark between two that are compared
CLEAR = 0.7  # Largest share of the next reading's spread: of 360 simulated tables 260 were read so, none wrong


def by_layout(file: TextTable, role: str, *, alone: bool = True) -> tuple[TextTable, str, tuple[str, ...]] | None:
    """The only table of a role, and of its name if not `alone`, with names, the flag that says so, and names before."""
    if role == "map" and file.names[:3] == ("key", "value_1", "value_2"):  # of objects by number
        told = "--columns map.id=key,map.x=value_1,map.y=value_2"
        return replace(file, names=("id", "x", "y", *file.names[3:])), told, file.names[:3]
    parts = [p for p in _parts(file) if alone or p.line[0] == file.line[0]]
    if role == "map":  # a row for x, one for y
        turned = (tuple(zip(*p.rows, strict=True)) if 1 < len(p.rows) < min(4, len(p.names)) else p.rows for p in parts)
        parts = [replace(p, rows=rows) for p, rows in zip(parts, turned, strict=True)]
    titles = [p.names[0].lower() for p in parts]
    tells = [{of for of, words in WORDS.items() if re.search(words, n) and not re.search(SEEN, n)} for n in titles]
    free = [{role} if alone and len(parts) == 1 else of or {*[role] * alone} for of in tells]
    each = zip(parts, free, strict=True)
    found = [(p, names) for p, of in each if role in of and (names := _names(p.rows, role, p.names[0] * file.named))]
    if file.named and role == "odometry" and not found:  # commands, beside stamps or none
        each = zip(parts, tells, strict=True)
        found = [(p, ("v", "omega")) for p, of in each if role in of and len(p.names) == 2]
    if len(found) > 1:
        found = [f for f in found if re.search(WORDS.get(role, "$^"), f[0].names[0].lower())]
    if len(found) != 1:
        return None
    part, names = found[0]
    told = ",".join(f"{role}.{q}={name}" for q, name in zip(names, part.names, strict=False))
    told = f"--columns {told}" if len(names) == len(part.names) else f"{part.names[0]} ...: rows of {', '.join(names)}"
    line = part.line if len(part.line) == len(part.rows) else part.line[:1].repeat(len(part.rows))
    return replace(part, names=names, line=line, named=True), told, part.names


def _parts(file: TextTable) -> list[TextTable]:
    """The matrices of a file, or a whole file without names; of numbers alone."""
    matrices: dict[str, list[int]] = {}
    words = {c for c, field in enumerate(file.rows[0]) if not (file.named or is_number(field))}  # of a kind of rows
    for column, name in enumerate(file.names):
        if (column in words and all(row[column] == file.rows[0][column] for row in file.rows)) or name == "frame":
            continue
        if not file.named or (matched := re.fullmatch(r"(.+)_\d+", name)):
            matrices.setdefault(matched[1] if file.named and matched else "", []).append(column)
    parts = []
    for stem, columns in matrices.items():
        there = [k for k, row in enumerate(file.rows) if any(row[c] for c in columns)]  # a longer matrix goes on
        beside = (f"{stem}.{ELEMENT}", ELEMENT, f"{stem.rpartition('.')[0]}.key") if file.named else ()
        columns[:0] = [
            file.names.index(n) for n in beside if n in file.names and file.rows[there[0]][file.names.index(n)]
        ]
        rows = [tuple(row[c] for c in columns) for row in file.rows]
        if all(is_number(field) for k in there for field in rows[k]):
            names = tuple(file.names[c] for c in columns)
            parts.append(replace(file, names=names, rows=tuple(rows[k] for k in there), line=file.line[there]))
    return parts


def _names(rows: Sequence[tuple[str, ...]], role: str, title: str) -> tuple[str, ...]:
    """Quantities of the columns of a path, of velocities or a map, also as a title tells; none if unclear."""
    values = np.array(rows, float)
    if not np.isfinite(values).all():
        return ()
    if role == "map":
        ids = [len(np.unique(v)) == len(v) and bool((v == np.abs(np.round(v))).all()) for v in values.T]
        close = np.ptp(values, axis=0) < 2 * len(values)  # others in whole numbers are places in mm
        if values.shape[1] == 3 and ids[0] and (close[0] or (values % 1.0).any()):
            return "id", "x", "y"
        return {2: ("x", "y"), 3: ("x", "y", "id" if ids[-1] and close[-1] else "z")}.get(values.shape[1], ())
    if role == "fixes":
        return ("t", "x", "y") if values.shape[1] == 3 and (np.diff(values[:, 0]) > 0.0).all() else ()
    last = np.append(np.diff(values[:, 0]) != 0.0, True)  # of equal stamps
    path = only_reading([row for row, taken in zip(rows, last.tolist(), strict=True) if taken])
    if "yaw" in path:
        return tuple(q.replace("yaw", "theta") for q, _ in sorted(path.items(), key=lambda item: int(item[1])))
    if values.shape[1] == 3 and re.search("pose|traj", title.lower()):
        return "x", "y", "theta"
    velocities = role == "odometry" and values.shape[1] == 3 and (np.diff(values[:, 0]) > 0.0).all()
    return ("t", "v", "omega") if velocities else ()


def seen_by_layout(
    file: TextTable, path_of: Callable[[], tuple[Array, Array] | None]
) -> tuple[TextTable, str, dict[str, str], tuple[str, ...]] | None:
    """Observations with names, what says so, units, and the names before: an instant, then id and two numbers, several
    times, which keep landmarks along a path, stamps (K,) [s] and poses (K, 3), in one reading alone; or None.
    """
    for part in _parts(file):
        values = np.array(part.rows, float)
        if values.shape[1] < 4 or values.shape[1] % 3 != 1 or (np.diff(values[:, 0]) < 0.0).any():
            continue
        each = values[:, 1:].reshape(-1, 3)
        ids = [j for j in range(3) if (each[:, j] == np.abs(np.round(each[:, j]))).all()]
        if len(ids) != 1:
            continue
        if (path := path_of()) is None:
            return None
        count, unstamped = len(values[0]) // 3, np.array_equal(path[0], np.arange(len(path[0])))
        first = "frame" if unstamped or part.names[0].endswith(ELEMENT) else "t"
        at = values[:, 0] if first == "t" else path[0][np.minimum(values[:, 0].astype(int), len(path[0]) - 1)]
        pose = se2.interpolate(*path, np.repeat(at, count))
        found = []
        for kind, order, sign in product((("range", "bearing"), ("x", "y")), (1, -1), ("", "-")):
            pair = [j for j in range(3) if j not in ids][::order]
            deg = "deg" * bool(kind[1] == "bearing" and np.abs(each[:, pair[1]]).max() > LARGEST)
            unit = sign + (deg or ("rad" if kind[1] == "bearing" else "m")) if sign or deg else ""
            a, b = each[:, pair].T * np.array([[1.0], [(-1.0 if sign else 1.0) * (np.pi / 180.0 if deg else 1.0)]])
            if kind[0] == "x" or (a >= 0.0).all():
                local = np.stack([a, b] if kind[0] == "x" else [a * np.cos(b), a * np.sin(b)], axis=-1)
                found.append((_spread(se2.transform_points(pose, local), local, each[:, ids[0]]), kind, pair, unit))
        found.sort(key=lambda f: f[0])
        if len(found) > 1 and found[0][0] < CLEAR * found[1][0]:
            _, kind, pair, unit = found[0]
            named = {ids[0]: "label", pair[0]: kind[0], pair[1]: kind[1]}
            names = [f"{named[j]}{k}" if count > 1 else named[j] for k in range(1, count + 1) for j in range(3)]
            told = f"its columns are {', '.join([first, *names])}{f' ({kind[1]} in {unit})' * bool(unit)}"
            return replace(part, names=(first, *names), named=True), told, {kind[1]: unit} if unit else {}, part.names
    return None


def ranges_in_columns(file: TextTable, places: Array, first: str) -> tuple[TextTable, str, str] | None:
    """The table with names, a name with a star, and what tells it, of the only columns that hold ranges to places
    (n, 2): of numbered names, or at equal distances without names; then the `first` may be stated.
    """
    i, j = np.triu_indices(n := len(places), 1)
    numbered, width = dict[str, list[int]](), len(file.names)
    for column, name in enumerate(file.names if file.named else ()):
        if (matched := re.fullmatch(r"(.*?\D)\d+(\D*)", name)) is not None:
            numbered.setdefault(f"{matched[1]}*{matched[2]}", []).append(column)
    for k, step in product(range(0 if file.named or n < 3 or width > MOST else width), range(1, width)):
        if k + step * (n - 1) < width and first in ("", file.names[k]):
            numbered[f"{k}:{step}"] = list(range(k, k + step * n, step))
    rows = file.rows[:: 1 + len(file) // ENOUGH]
    values = np.array([[float(f) if is_number(f) else 0.0 for f in row] for row in rows])
    apart, found = np.hypot(*(places[i] - places[j]).T), []
    for star, columns in numbered.items():
        far = np.where(values[:, columns] > 0.0, values[:, columns], np.nan)
        if len(columns) == n > 1 and np.isfinite(far).any(axis=0).all():
            a, b = far[:, i], far[:, j]
            fits = ((a + b > NEARLY * apart) & (np.abs(a - b) < apart / NEARLY))[np.isfinite(a + b)]
            found += [star] * bool(2 * len(fits) > len(far) and fits.mean() > MOSTLY)
    if len(found) != 1:
        return None
    which = ", ".join(file.names[c] for c in numbered[found[0]])
    told = f", of columns {which}: triangles with landmarks of the map"
    if file.named:
        return file, found[0], told
    label = {column: f"range_{k}" for k, column in enumerate(numbered[found[0]], start=1)}
    names = (label.get(k, name if k else "t") for k, name in enumerate(file.names))
    return replace(file, names=tuple(names), named=True), "range_*", told


MOST, ENOUGH = 100, 1000  # Most columns without names, and about as many rows, that are looked at
NEARLY, MOSTLY = 0.9, 0.97  # Share of a side that noise leaves; of pairs of ranges that make triangles with landmarks


def named_alike(seen: TextTable, known: TextTable) -> tuple[str, str] | None:
    """The only columns of observations and of a map that hold the same names, or whole numbers, of landmarks."""
    pairs = []
    for name, ids in zip(known.names, zip(*known.rows, strict=True), strict=True):
        distinct = len({*ids}) == len(ids) and not any("." in field and is_number(field) for field in ids)
        for own, fields in zip(seen.names, zip(*seen.rows, strict=True), strict=True) if distinct else ():
            again = 1 < len(used := {*fields} - {""}) <= len(fields) / AGAIN and used <= {*ids}
            if again and (own == name or not all(map(is_number, ids)) or CALLED & {*words_of(own)[0]}):
                pairs.append((own, name))
    return pairs[0] if len(pairs) == 1 and seen.named and known.named else None


CALLED = frozenset(("id", "landmark", "lm", "tag", "marker", "beacon", "anchor", "node", "cone", "subject", "barcode"))
"""Words of columns whose numbers may name landmarks."""


def landmarks_in_rows(file: TextTable) -> tuple[TextTable, TextTable, str] | None:
    """Observations with labels, a map, and what says so, of rows with one of few places (anchor_x, anchor_y)."""
    pairs = [(j, f"{name[:-1]}y") for j, name in enumerate(file.names) if re.fullmatch(PLACED, name, re.IGNORECASE)]
    found = [(j, file.names.index(y)) for j, y in pairs if y in file.names]
    if not file.named or len(found) != 1:
        return None
    (j, k), label = found[0], dict[tuple[str, str], int]()
    each = [label.setdefault((row[j], row[k]), len(label)) for row in file.rows]
    if not 1 < len(label) <= len(each) / AGAIN or not all(is_number(f) for place in label for f in place):
        return None
    seen = tuple((*row, str(n)) for row, n in zip(file.rows, each, strict=True))
    told = f"{file.names[j]}, {file.names[k]} are places of {len(label)} landmarks: the map, and the label of each row"
    known = tuple((str(n), *place) for place, n in label.items())
    of_map = replace(file, names=("id", "x", "y"), rows=known, line=file.line[: len(known)])
    return replace(file, names=(*file.names, "label"), rows=seen), of_map, told


PLACED, AGAIN = r"((anchor|beacon|landmark|lm|node)_?(pos(ition)?_?)?|a|b|l)x", 3  # Names; least rows of each landmark


def _spread(place: Array, local: Array, label: Array) -> float:
    """Mean distance between places (N, 2) of a landmark, relative to how far it is from the sensor."""
    off = []
    for name in np.unique(label):
        own = place[label == name]
        off += [np.hypot(*(own[span:] - own[:-span]).T) for span in SPANS if span < len(own)]
    return float(np.mean(np.concatenate(off)) / np.mean(np.hypot(*local.T))) if off else np.inf
