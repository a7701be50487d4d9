"""Columns of tables of other programs: their names (`--columns t=stamp,truth.x=px`), what these tell, and their units.

Fields stay text until a column is read in SI units (`--unit angle=deg,time=ns,v=km/h`).
"""

import itertools
import math
import re
import tomllib
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Self

import numpy as np

from data.columns.named import LENGTH, is_stamp, unused
from data.csv_table import Table, is_number
from data.dates import DATES, DMY, MDY, is_date, unit_of
from data.earth import on_plane, placed
from data.errors import DataError, UsageError, did_you_mean, unknown
from data.formats.arrays import ELEMENT, WIDE, is_arrays, solids
from data.formats.messages import kinds_of, read_lines
from data.formats.results.reading import RATES, role_of, topics_in, words_of
from data.formats.text import COMMENT, SLOTS, TextTable
from data.notice import Notice
from data.origin import Origin
from data.questions.examination import heading_unit, in_degrees
from data.se2 import Array, BoolArray
from data.terminal import counted

NAMED = 12  # Most columns of a matrix of which each has a meaning
NAMES_SHOWN = 200  # Most characters of a header in a message


def stem_of(name: str) -> str:
    """The name of a column without its number."""
    return name.rstrip("0123456789")


def column_of(file: TextTable, name: str) -> int | None:
    """Index of the column of that name, or number counted from 1; None without one, DataError for several."""
    name = name if name in file.names else name.lstrip("".join(COMMENT))  # of a header that is a comment
    if name in file.names:
        several = [str(k + 1) for k, other in enumerate(file.names) if other == name]
        if len(several) > 1 and any(len({row[int(k) - 1] for k in several}) > 1 for row in file.rows):
            what = f"columns {' and '.join(several)} are named {name!r}; name one by its number, as in"
            raise DataError.at(file.path, f"{what} --columns KEY={several[0]}")
        return file.names.index(name)
    if len(listed := [k for k, own in enumerate(file.names) if own.startswith(f"{name}_")]) > NAMED:
        return listed[0]  # the first of a matrix, or of lists
    if name.isdecimal() and 1 <= int(name) <= len(file.names):
        return int(name) - 1
    alike = [k for k, own in enumerate(file.names) if file.named and words_of(own)[0] == words_of(name)[0] != []]
    return alike[0] if len(alike) == 1 else None  # but for its unit, and capitals


def described(file: TextTable) -> str:
    """The columns in a message."""
    if not file.named:
        return f"columns 1 to {len(file.names)}, without names{kinds_of(file.path, file.rows)}"
    if len(topics := [topic for topic in topics_in(file.names) if topic.startswith("/")]) > 1:
        return f"topics {', '.join(topics)}, as in {file.path}:{topics[0]}"
    parts = []
    for rows, names in (file.series() or {0: [name for name in file.names if name]}).items():
        runs = [list(run) for _, run in groupby(names, key=stem_of)]
        listed = ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 3 else ", ".join(run) for run in runs)
        parts.append(listed + f" ({rows} rows)" * bool(rows))
    text = "; ".join(parts)
    text = text if len(text) <= NAMES_SHOWN else text[:NAMES_SHOWN] + " ..."
    return "; ".join(["columns " + text, *(solids(file.path) if is_arrays(file.path) else [])])


def unpivoted(file: TextTable, patterns: Mapping[str, str]) -> TextTable:
    """A row for each landmark of a table with a column for each, of names with a star by quantity; what the star stands
    for is the label, but of columns filled from the left. Blank, infinite, zero and negative ranges are no observation.
    """
    found: dict[str, dict[str, int]] = {}
    own = not {"label", "true_id"} & set(patterns)
    for quantity, pattern in patterns.items():
        for star, j in starred(file.names, pattern).items():
            found.setdefault(star, {})[quantity] = j
    labels = {star: of for star, of in found.items() if len(of) == len(patterns)}
    if not labels:
        raise DataError.at(file.path, f"no column {', '.join(patterns.values())}; it has {described(file)}")
    rest = sorted({*range(len(file.names))} - {j for of in found.values() for j in of.values()})
    far = [[_distance(row, of) for of in labels.values()] for row in file.rows]
    seen = [[k for k, distance in enumerate(each) if distance > 0.0] for each in far]
    own &= len(set(map(len, seen))) < SLOTS or any(some != list(range(len(some))) for some in seen)
    named = [*labels] if all(map(str.isdecimal, labels)) else [str(k) for k in range(len(labels))]
    columns = [of.values() for of in labels.values()]
    rows = [
        (*(row[j] for j in rest), *(row[j] for j in columns[k]), *[named[k]] * own)
        for row, some in zip(file.rows, seen, strict=True) for k in some
    ]  # fmt: skip
    line = np.repeat(file.line, list(map(len, seen)))
    names = (*(file.names[j] for j in rest), *patterns, *["label"] * own)
    lost = sum(distance <= 0.0 for each in far for distance in each)
    return replace(
        file, names=names, rows=tuple(rows), line=line, named=True, cut=nothing_there(lost, len(rows)) * bool(lost)
    )


def starred(names: Sequence[str], pattern: str) -> dict[str, int]:
    """Columns by what a star stands for: numbers, where several are (not a word beside them, as in r_1, r_2, r_var)."""
    match = re.compile(re.escape(pattern).replace(r"\*", "(.*)")).fullmatch
    found = {(*matched.groups(), name)[0]: j for j, name in enumerate(names) if (matched := match(name)) is not None}
    numbered = {star: j for star, j in found.items() if star.isdecimal()}
    return numbered if len(numbered) > 1 else found


def nothing_there(lost: int, kept: int) -> str:
    """What is said of observations at no distance, or less, beside those that are kept."""
    return f"{lost} of {lost + kept} observations are at 0 m or less, where nothing was seen: left out"


def _distance(row: Sequence[str], of: Mapping[str, int]) -> float:
    """From the sensor [the file's unit], NaN where a number is not there; 1 of a bearing alone."""
    values = {q: float(row[j]) if is_number(row[j]) else math.nan for q, j in of.items() if q in STARRED}
    far = values.get("range", math.hypot(values.get("x", 1.0), values.get("y", 0.0)))
    return far + 0.0 * sum(values.values())


STARRED, IDS = ("range", "bearing", "x", "y"), ("label", "true_id")
"""Quantities of observations that may have a column for each landmark, or for each of several in a row, with ids."""


def stars(file: TextTable) -> dict[str, str]:
    """Names with a star by quantity, of ranges and bearings of several landmarks, as range_1, lm1_range, z_range_1."""
    usual = {q: (q.replace("_", ""), *ALSO.get(q, ()), *["id"] * (q == "label")) for q in ("range", "bearing", *IDS)}
    found: dict[str, set[str]] = {}
    for name in file.names if file.named else ():
        if (matched := re.fullmatch(r"(.*?)(\d+)(\D*)", name)) is not None:
            near = [words for part in (matched[3], matched[1]) if (words := words_of(part)[0])]
            told = [q for words in near for q, named in usual.items() if {"".join(words), words[-1]} & {*named}]
            for quantity in told[:1]:
                found.setdefault(quantity, set()).add(f"{matched[1]}*{matched[3]}")
    whole = {"range", "bearing"} <= {*found} and not {"range", "bearing"} & {*file.names}
    return {q: min(names) for q, names in found.items()} if whole and max(map(len, found.values())) == 1 else {}


def solid_stars(file: TextTable, stated: Mapping[str, str]) -> dict[str, str]:
    """Names with a star for what counts landmarks, of quantities stated as NAME_K of an array of three dimensions."""
    found = {}
    for quantity, (stem, _, k) in ((q, n.rpartition("_")) for q, n in stated.items() if n not in file.names):
        places = [m.groups() for n in file.names if (m := re.fullmatch(re.escape(stem) + r"_(\d+)_(\d+)", n))]
        counts = [len(set(each)) for each in zip(*places, strict=True)]
        alike = sum(n.rpartition("_")[0] == stem for n in stated.values())
        if places and k.isdecimal() and counts.count(alike) != 1:
            which = f"{quantity}={stem}_*_{k} or {quantity}={stem}_{k}_*: * counts what is seen at once"
            raise DataError.at(file.path, f"{stem} has {counts[0]} x {counts[1]} numbers at each instant; name {which}")
        if places and k.isdecimal():
            found[quantity] = f"{stem}_*_{k}" if counts[1] == alike else f"{stem}_{k}_*"
    return found


ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi, "compass": -math.pi / 180.0}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
DIMENSIONS = {"length": LENGTH | {"mi": 1609.344, "nmi": 1852.0}, "angle": ANGLE, "time": TIME}

STAMPS = ("t", "t1", "t2")
INSTANTS = {*STAMPS, "frame", "frame1"}
NAMES = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))
QUANTITIES: dict[str, str] = {q: dimension for dimension, of in NAMES["dimensions"].items() for q in of.split()}


@dataclass(frozen=True)
class Units:
    """Stated units by key: a dimension, a quantity, or `role.quantity`; the narrower key wins."""

    given: dict[str, str]
    typed: frozenset[str] = field(init=False)  # keys that a person stated; names of columns add others

    def __post_init__(self) -> None:
        object.__setattr__(self, "typed", frozenset(self.given))
        for key, unit in self.given.items():
            quantity = key.rpartition(".")[2]
            dimension = key if key in DIMENSIONS else QUANTITIES.get(quantity)
            if not dimension:
                known = [*DIMENSIONS, *(q for q, d in QUANTITIES.items() if d)]
                raise UsageError(f"--unit {key}={unit}: quantity {key!r}: {unknown(quantity, known)}")
            factor(dimension, unit, f"--unit {key}={unit}")

    def unit(self, role: str, quantity: str) -> str | None:
        """The unit stated for a quantity, `role.quantity` before `quantity`."""
        return self.given.get(f"{role}.{quantity}", self.given.get(quantity))

    def dates(self, role: str) -> str:
        """The unit of a file's stamps, if they are dates."""
        unit = self.unit(role, "t") or self.given.get("time", "")
        return unit if unit in DATES else ""

    def factor(self, role: str, quantity: str) -> float:
        """SI units per unit of a quantity in a file."""
        dimension, unit = QUANTITIES[quantity], self.unit(role, quantity)
        usual = ANGLE["deg"] if quantity in EARTH.values() else 1.0
        if not dimension or (dimension == "time" and self.dates(role)):
            return 1.0
        if unit is None:  # rates are per second then
            dimension = quantity = dimension.partition("/")[0]
            unit = self.given.get(dimension)
        return 1.0 if unit is None else factor(dimension, unit, f"--unit {quantity}={unit}") / usual


def factor(dimension: str, text: str, where: str) -> float:
    """SI units per unit `text`, with a minus sign for clockwise angles; UsageError for an unknown one."""
    sign, unit = (-1.0, text[1:]) if text.startswith("-") else (1.0, text)
    unit = RATES.get(unit, unit)
    over, slash, under = unit.partition("/")
    kind, per, _ = (*dimension.split("/"), "", "")[:3]
    units = DIMENSIONS[kind]
    if kind == "time" and text in DATES:
        return 1.0
    (over, often), (under, times) = (
        (text[many.end() :], float(many[0])) if (many := re.match(r"\d*\.?\d+([eE][-+]?\d+)?", text)) else (text, 1.0)
        for text in (over, under)  # counts of 0.1ms or 1e-7deg, per 0.1s
    )
    if over not in units or bool(slash) != bool(per) or (per and under not in TIME) or not times * often > 0.0:
        example = f"{next(iter(units))}/s" if per else ", ".join([*units, *DATES] if kind == "time" else units)
        what = f"of {', '.join(units)} per {', '.join(TIME)}, as in {example}," if per else f"one of {example}"
        known = [f"{unit}/{time}" for time in TIME for unit in units] if per else units
        hint = f" (did you mean {over}/s?)" if per and unit in units else did_you_mean(unit, known)
        raise UsageError(f"{where}: unknown unit {text!r}{hint}; {what} is needed")
    return sign * often * units[over] / (times * TIME[under] if per else 1.0)


def quantity_with_unit(text: str, dimension: str, where: str) -> float:
    """A number with an optional unit, as 2deg or 5mm; SI by default. UsageError for anything else."""
    number, unit = re.fullmatch(r"(.*[\d.])?(.*)", text.strip(), re.DOTALL).groups("")  # type: ignore[union-attr]
    value = float(number) if is_number(number) else math.nan
    if not math.isfinite(value):
        raise UsageError(f"{where}: {text!r} is not a number, as in 0.1, 5cm or 2deg")
    return value * (factor(dimension, unit.strip(), where) if unit.strip() else 1.0)


EARTH, ON_EARTH = {"x": "lon", "y": "lat"}, ("map", "truth", "fixes")
"""Quantities in degrees instead of metres east and north, and roles of files that may have them."""
SECOND, SCANS = "second-odometry", "scans"
ROLES = ("odometry", "observations", "map", "truth", "fixes", "closures", SECOND, SCANS)
QUATERNION = ("qx", "qy", "qz", "qw")
MORE: dict[str, tuple[str, ...]] = {
    "odometry": (), SECOND: (), SCANS: (), "observations": ("true_id", "label"), "map": ("id", "sx"), "truth": (),
    "fixes": ("theta", "sx", "source"), "closures": ("sx", "source"),
}  # fmt: skip
"""Quantities that a file may lack, by role; of sensors as of observations."""
SPEED = ("velocity", "vel", "v", "speed", "omega", "w")  # Words of the speed of a wheel, the last two of its turning
HOLDING = ("data", "message", "msg", "payload", "steps", "records", "samples", "entries")  # Of objects within an object
WHEEL = "|".join((*HOLDING, "wheels?", *SPEED, "ticks?|counts?|position|pos|angle|joint|encoders?|enc|phi"))
WHEELS = {side: re.compile(f"(?!{side[0]}$)(?:{WHEEL})*(?:{side}|{side[0]})(?:{WHEEL})*") for side in ("left", "right")}
ALSO, TWIST = ({q: (*words.split(),) for q, words in NAMES[kind].items()} for kind in ("also", "twist"))
PARTS, ALSO_OF = ({of: frozenset(words.split()) for of, words in NAMES[kind].items()} for kind in ("parts", "kinds"))
WITHIN = ("frame", "frame1", "frame2")
AGAIN = 3  # Least usual number of observations of a landmark


def _sideways(file: TextTable, column: int) -> bool:
    """Whether the velocity beside one along x, along y, is not zero."""
    stem, x, end = file.names[column].rpartition("x")
    beside = [c for c, name in enumerate(file.names) if x and name == f"{stem}y{end}"][:1]
    return any(is_number(row[c]) and abs(float(row[c])) > 0.0 for c in beside for row in file.rows)


def _comes_again(file: TextTable, column: int) -> bool:
    """Whether numbers of a column name things that are observed again and again, not their places in a frame."""
    ids = [row[column] for row in file.rows if row[column]]
    if not all(map(is_number, ids)) or AGAIN * len({*ids}) > len(ids):
        return False
    number = np.array(ids, float)
    each = np.split(number, np.flatnonzero(np.diff(number, prepend=np.inf) <= 0.0)[1:])
    counted_up = all((np.diff(some) == 1.0).all() and some[0] == number.min() for some in each)
    return not (counted_up and len(set(map(len, each))) > 1)


def kinds_by_part(path: Path) -> dict[str, Path]:
    """FILE:WORD by part, of a file whose lines begin with few words, of which each tells another part; else none."""
    if not path.is_file() or is_arrays(path):
        return {}
    begin = [re.split(r"[\s,;:]+", line.strip())[0] for _, line in read_lines(path)[0] if line.strip()]
    words = [word for word, n in Counter(begin).items() if n > 1 and not is_number(word)]
    if not 1 < len(words) <= NAMED or sum(word in words for word in begin) < len(begin) - 1:
        return {}
    each = {word: word.lower().rstrip("0123456789") for word in words}
    of = [(part, w) for part in PARTS for w, low in each.items() if low in PARTS[part] | ALSO_OF.get(part, set())]
    found = {part: Path(f"{path}:{word}") for part, word in of}
    return found if "odometry" in found and len(found) == len(of) else {}


COMMANDED = frozenset(("cmd", "command", "commanded", "control", "input"))  # Beside measured speeds not taken
BESIDE = COMMANDED | {"gyro", "gyroz", "imu"}  # Not taken beside others


THRUN = [re.compile(rf"(d|delta)?{end}") for end in ("rot(ation)?1", "trans(lation)?", "rot(ation)?2")]


def stepped(file: TextTable) -> TextTable:
    """Turns, ways and turns (Thrun et al., Probabilistic Robotics, table 5.5) as steps, too; other tables as is."""
    names = ["".join(words_of(name)[0]) for name in file.names] if file.named else []
    found = [[k for k, name in enumerate(names) if word.fullmatch(name)] for word in THRUN]
    if not all(len(of) == 1 for of in found):
        return file
    first, way, second = (file.numbers(k, np.ones(len(file), bool)) for (k,) in found)
    unit = ANGLE.get(words_of(file.names[found[0][0]])[1], 1.0)
    steps = np.stack([way * np.cos(unit * first), way * np.sin(unit * first), unit * (first + second)], axis=-1)
    rows = tuple((*row, *map(repr, step)) for row, step in zip(file.rows, steps.tolist(), strict=True))
    told = f"inferred: {', '.join(file.names[k] for (k,) in found)} are a turn, a way and a turn"
    own = ("" if [k] in found else name for k, name in enumerate(file.names))
    return replace(file, names=(*own, "dx", "dy", "dtheta"), rows=rows, cut="; ".join(filter(None, (file.cut, told))))


def upright(file: TextTable) -> TextTable:
    """A file of few long rows of numbers without names as a table of these columns, unless they may be scans."""
    wide = not file.named and 1 < len(file) <= WIDE[0] and len(file.names) >= WIDE[1]
    if not wide or not all(is_number(f or "nan") for row in file.rows for f in row):
        return file
    values = np.array([[f or "nan" for f in row] for row in file.rows], float)
    if not (values < 0.0).any() and not (np.diff(values) > 0.0).all(axis=1).any():
        return file
    cut = "; ".join(filter(None, (file.cut, f"inferred: its {len(file)} rows are columns of {len(file.names)} rows")))
    names, rows = tuple(str(k + 1) for k in range(len(file))), tuple(zip(*file.rows, strict=True))
    return replace(file, names=names, rows=rows, line=np.repeat(file.line[:1], len(rows)), cut=cut)


def quantity_of(key: str) -> str:
    """A key of `--columns` or `--unit`, where its quantity has another usual name with this quantity's own."""
    role, dot, name = key.rpartition(".")
    word = "".join(words_of(name)[0])
    known = {role_of(name)[0].replace("yaw", "theta")} | {q for q, also in ALSO.items() if word in also}
    found = [*(known & {*QUANTITIES})] if name not in QUANTITIES and key not in DIMENSIONS else []
    return f"{role}{dot}{found[0]}" if len(found) == 1 else key


@cache
def meaning(name: str) -> tuple[frozenset[str], tuple[str, str], tuple[str, str]]:
    """The parts that a column's name tells; role and words of the name, and those without the words that tell parts."""
    words, _ = words_of(name)
    parts = frozenset(part for part, of in PARTS.items() if any(w in of or w.rstrip("s") in of for w in words))
    own = COMMANDED.union(HOLDING, *(PARTS[part] for part in parts))
    rest = [w for w in words if w not in own and w.rstrip("s") not in own]
    return parts, (role_of(name)[0], "".join(words)), (role_of("_".join(rest))[0], "".join(rest))


EPOCH, CLOCKS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}, (1.0e9, 2.2e9)
"""Units of stamps since 1970 that their size tells; s, from 2001 to 2039."""


@dataclass(eq=False)
class Columns:
    """Stated column names by key `quantity` or `role.quantity`; other quantities have their own names."""

    given: Mapping[str, str]
    units: Units
    offsets: Mapping[str, float] = field(default_factory=dict)  # s added to the stamps of a role's file
    roles: tuple[str, ...] = ROLES  # of files, with the names of sensors
    used: set[str] = field(default_factory=set)  # keys that named a column so far
    read: set[tuple[Path, str]] = field(default_factory=set)  # columns (file, name) that were read
    notes: list[str] = field(default_factory=list)  # about rows that were left out
    asked: list[Notice] = field(default_factory=list)  # questions that only the files raise
    datum: list[float] = field(default_factory=list)  # latitude and longitude [deg] of the first place in degrees
    origins: dict[str, Origin] = field(default_factory=dict)  # of what the data tell, or nobody
    period: float | None = None  # s between rows of an odometry without stamps
    # intervals: columns (file, role, number) that are named as stamps, and are the time between rows, or of other rows
    intervals: set[tuple[Path, str, int]] = field(default_factory=set)
    words: dict[str, int] = field(default_factory=dict)  # numbers of landmarks that are named by words

    def __post_init__(self) -> None:
        for key, name in self.given.items():
            role, dot, quantity = key.rpartition(".")
            unheard = quantity not in QUANTITIES
            if unheard or (dot and role not in self.roles):
                near = did_you_mean(quantity, QUANTITIES) if unheard else did_you_mean(role, self.roles)
                known = f"{', '.join(QUANTITIES)}, each also as in odometry.t (files: {', '.join(self.roles)})"
                raise UsageError(f"--columns {key}={name}: unknown quantity {key!r}{near}; known: {known}")

    @property
    def quiet(self) -> Self:
        """The same, for a look at the files that leaves nothing behind."""
        units = replace(self.units, given=dict(self.units.given))
        return replace(
            self, units=units, used=set(), read=set(), notes=[], asked=[], datum=[], origins={}, words={**self.words}
        )

    def stated(self, role: str, quantities: Collection[str]) -> bool:
        """Whether a column of this role is stated for one of the quantities."""
        return any(f"{role}.{q}" in self.given for q in quantities)

    def tells(self, file: TextTable, role: str) -> list[str]:
        """Names of the columns of a place in a file whose names tell that they are of this role; none without both."""
        for pair in (["x", "y"], [*EARTH.values()]) if not any("/" in name for name in topics_in(file.names)) else ():
            names = [file.names[c] for q in pair if (c := self.find(file, role, q)) is not None]
            parts = [meaning(name)[0] or ("fixes",) * (pair[0] == EARTH["x"]) for name in names]
            if len(names) == len(pair) and all(role in of for of in parts):
                return names
        return []

    def take_series(self, file: TextTable, role: str) -> None:
        """Of arrays of several lengths: the stamps of a role are those as long as what it measures, which is noted."""
        usual = ("v", "omega", "theta", "dtheta", "left") if role == "odometry" else ("range", "bearing")
        names = {name for key, name in self.given.items() if key.startswith(f"{role}.")}
        if not names and role not in ROLES[2:]:
            names = {self.given.get(q, q) for q in usual} | {*stars(file).values()}
        taken = {file.names[j] for name in names for j in starred(file.names, name).values()}
        own = [(k, of) for k, of in file.series().items() if taken & {*of}]
        stamps = [n for n in own[0][1] if is_stamp(n)] if len(own) == 1 else []
        if len(stamps) == 1 and f"{role}.t" not in self.given and stamps[0] != self.given.get("t", "t"):
            times = np.array([row[file.names.index(stamps[0])] for row in file.rows[: own[0][0]]], float)
            if (np.diff(times) >= 0.0).all():
                self.given = {**self.given, f"{role}.t": stamps[0]}
                told = f"--columns {role}.t={stamps[0]}, the stamps of its {own[0][0]} rows"
                self.notes.append(f"{file.path.name}: inferred: {told}")
        if len(own) == 1 and not stamps and role != "odometry":
            self.intervals |= {(file.path, role, c) for c, n in enumerate(file.names) if n not in own[0][1]}

    def find(self, file: TextTable, role: str, quantity: str) -> int | None:
        """Index of the column of a quantity in a file, or None; DataError if its stated column is missing."""
        for key in (f"{role}.{quantity}", quantity):
            if key in self.given and (column := column_of(file, self.given[key])) is not None:
                self.used.add(key)
                return self._in_unit(file, role, quantity, column, stated=True)
            if key in self.given and key != quantity:
                near = did_you_mean(self.given[key], file.names)
                raise DataError.at(file.path, f"no column {self.given[key]!r}{near} ({key}); it has {described(file)}")
        usual = (quantity.replace("theta", "yaw"), quantity)
        meant = {c: meaning(file.names[c]) for c in file.filled if file.named}
        more = (quantity, *ALSO.get(quantity, ()), *["id"] * (quantity == "label" and role not in ROLES[2:]))
        more += ("ids",) * ("id" in more) + (f"{quantity}s",) * (quantity in STARRED[:2])
        whole, apart = ([c for c, (_, *m) in meant.items() if m[k][0] in usual or m[k][1] in more] for k in (0, 1))
        also = [c for c in apart if role in meant[c][0]]
        exact = file.named and quantity in file.names and (not also or (role == "odometry" and quantity in TWIST))
        if exact and (file.path, role, file.names.index(quantity)) not in self.intervals:
            return column_of(file, "time" if quantity == "t" and self._headings(file) else quantity)
        read = [c for c in meant if role not in PARTS or not meant[c][0] or role in meant[c][0]]  # of no other part
        also = also or [c for c in whole if c in read] or [c for c in apart if c in read]
        also = [c for c in also if not BESIDE & {*words_of(file.names[c])[0]}] or also
        also = [c for c in also if quantity != "label" or meant[c][2][1] != "id" or _comes_again(file, c)]
        if not also and quantity in WITHIN:  # of a field within structs; not the number of a struct that has its own
            last = {c: "".join(words_of(name.rpartition(".")[2])[0]) for c, name in enumerate(file.names) if file.named}
            also = [c for c, word in last.items() if word in ALSO[quantity]]
            also = also or [c for c, word in last.items() if word == (ELEMENT if quantity == "frame" else quantity)]
        if quantity == "theta" and not also:  # phi_true beside x_true
            also = [c for c, (of, _, (_, word)) in meant.items() if word in ("phi", "psi") and role in of]
        if quantity in WHEELS and not also:
            also = [c for c in read if WHEELS[quantity].fullmatch(meant[c][1][1])]
            also = [c for c in also if not {*SPEED} & {*re.findall(WHEEL, meant[c][1][1])}] or also  # angles first
        if quantity == "t":  # not the time of recording
            also = [c for c in also if (file.path, role, c) not in self.intervals]
            also = [c for c in also if "header" in file.names[c]] or also
        if quantity == "t" and not also and self.period is None:  # dates by another name
            also = [c for c in read if is_date(file.rows[0][c]) and file.rows[0][c] != file.rows[-1][c]]
        if len({meant[c][1] for c in also}) == 1 and all(words_of(file.names[c])[1] for c in also):
            also = also[:1]  # in another unit
        if not also and quantity in TWIST and role in ("odometry", SECOND):
            also = [c for c in read if meant[c][1][1].endswith(TWIST[quantity]) and not _sideways(file, c)]
        if len(also) != 1:
            return self.find(file, role, EARTH[quantity]) if quantity in EARTH and role in ON_EARTH else None
        return self._in_unit(file, role, quantity, also[0])

    def _in_unit(self, file: TextTable, role: str, quantity: str, column: int, *, stated: bool = False) -> int:
        """The column, noted with the unit in its name if none is stated; of a `stated` one if that is no SI unit."""
        name, key = file.names[column], f"{role}.{quantity}"
        note = f"{file.path.name}: {quantity} of {role} is read from {name}"
        unit = (words_of(name)[1] or role_of(name)[1] * (quantity == "t")) * ("+" not in name)
        dimension, said = QUANTITIES[quantity], not stated
        unit = "ns" if quantity == "t" and name.startswith(("field.", "%time")) else unit  # of rostopic
        if unit and dimension and not {dimension, quantity, *[key] * stated} & set(self.units.given):
            try:
                if factor(dimension, unit, "") != 1.0 or said:
                    note, said = f"{note}, in {self.units.given.setdefault(key, unit)}", True
            except UsageError:
                note += f", whose unit {unit!r} is unknown (--unit {key}=UNIT; else SI)"
        self.notes += [note] * (said and note not in self.notes)
        return column

    def _headings(self, file: TextTable) -> bool:
        """Whether a column t beside an ascending column time descends, as headings do; which is noted."""
        if "time" not in file.names:
            return False
        pairs = np.array([[row[file.names.index(q)] or "nan" for q in ("t", "time")] for row in file.rows])
        if not all(map(is_number, pairs.ravel().tolist())):
            return False
        of_t, of_time = np.any(np.diff(pairs.astype(float), axis=0) < 0.0, axis=0).tolist()
        note = f"{file.path.name}: inferred: --columns t=time, as the column t descends"
        self.notes += [note] * (bool(of_t and not of_time) and note not in self.notes)
        return bool(of_t and not of_time)

    def taken(
        self, file: TextTable, role: str, quantities: Sequence[str], other: TextTable | None, of: str = "truth"
    ) -> bool:
        """Whether another part is the same table, and has the columns of these quantities of a role for its own."""
        return other is file and all(self.find(file, role, q) == self.find(file, of, q) for q in quantities)

    def require(self, file: TextTable, role: str, quantities: Sequence[str]) -> list[int]:
        """The columns of quantities that a file must have."""
        columns = []
        for q in quantities:
            column = self.find(file, role, q)
            if column is None:
                name = self.given.get(q, q)
                what = f"no column {name!r}{did_you_mean(name, file.names)} for {q}; it has {described(file)}"
                none = " (rows at equal times: --period S)" * ((role, q) == ("odometry", "t"))
                raise DataError.at(file.path, f"{what}; name it as in --columns {role}.{q}=NAME{none}")
            first = next((row[column] for row in file.rows if row[column]), "")
            if q in STAMPS and not {"t", "time", f"{role}.t"} & set(self.units.given):
                large = float(first) if is_number(first) else 0.0
                unit = next((u for u, size in EPOCH.items() if CLOCKS[0] < large * size < CLOCKS[1]), "")
                told = "by its size, since 1970"
                if is_date(first):
                    right = f"--unit {role}.t={DMY}, or {role}.t={MDY}, is"
                    unit, told = unit_of(file.path, (row[column] for row in file.rows), right), "is a date"
                if unit:
                    self.units.given[f"{role}.t"] = unit
                    self.notes.append(f"{file.path.name}: inferred: --unit {role}.t={unit}, as {first} {told}")
            columns.append(column)
        return columns

    def has(self, file: TextTable, role: str, quantities: Sequence[str]) -> bool:
        """Whether a file has a column for each of these quantities."""
        return all(self.find(file, role, q) is not None for q in quantities)

    def check_used(self, files: Sequence[TextTable]) -> None:
        """UsageError for a stated column that is in no file."""
        for key, name in self.given.items():
            if key not in self.used:
                role, _, quantity = key.rpartition(".")
                why = f"no file has a column {name!r}{did_you_mean(name, [n for f in files for n in f.names])}"
                if any(column_of(f, name) is not None for f in files):
                    why = f"{quantity} is not needed" + (f" in the {role}" if role else "")
                has = "; ".join(f"{f.path.name} has {described(f)}" for f in files)
                raise UsageError(f"--columns {key}={name}: not used: {why}; {has}")

    def stamps(self, file: TextTable, role: str, keep: BoolArray) -> Array:
        """Stamps t [s] of rows to keep (K,) of a file, NaN where blank."""
        values = file.numbers(self.require(file, role, ("t",))[0], keep, self.units.dates(role))
        return values * self.units.factor(role, "t") + self.offsets.get(role, 0.0)

    def _by_word(self, file: TextTable, column: int, keep: BoolArray) -> Array | None:
        """Numbers of landmarks (K,) that a column names by words; None where all are numbers."""
        texts = file.text(column, keep)
        if not self.words and all(is_number(text) for text in texts if text):
            return None
        words = [text for text in dict.fromkeys(texts) if text and text.lower() != "nan"]
        ends = [re.fullmatch(r"(.*?)(\d{1,6})", word) for word in words]
        if not self.words and all(ends) and len({end[1] for end in ends if end}) == 1:
            known = {end[0]: int(end[2]) for end in ends if end}
        else:
            known = self.words
            for word in words:
                known.setdefault(word, len(known))
        ids = ", ".join(f"{word} is {known[word]}" for word in words[:NAMED])
        self.notes.append(f"{file.path.name}: landmarks of {file.names[column]}: {ids}{', ...' * (len(words) > NAMED)}")
        return np.array([float(known.get(text, np.nan)) for text in texts])

    def turned(self, file: TextTable, role: str, time: Array, pose: Array) -> Array:
        """Poses (K, 3) in rad; headings that follow the course as degrees only are converted, others asked about."""
        key = f"{role}.theta"
        if self.units.factor(role, "theta") != 1.0:
            return pose
        if in_degrees(pose) and not {key, "theta", "angle"} & set(self.units.given):
            self.origins["units"] = Origin.INFERRED
            self.units.given[key] = "deg"
            told = f"headings reach {np.nanmax(np.abs(pose[:, 2])):.4g}, and follow the motion as degrees only"
            self.notes.append(
                f"{file.path.name}: inferred: --unit {key}=deg, as {told} (--unit {key}=rad reads them as written)"
            )
            return pose * [1.0, 1.0, ANGLE["deg"]]
        self.asked += heading_unit(file.path.name, time, pose, f"--unit {key}=deg")
        return pose

    def say_unused(self, files: Mapping[str, TextTable]) -> None:
        """Note the columns of files, by role, that nothing used, with what they likely are; no words without a name."""
        for path in dict.fromkeys(f.path for f in files.values()):
            of = {role: file for role, file in files.items() if file.path == path}
            free = [q for r, f in of.items() for q in MORE.get(r, MORE["observations"]) if self.find(f, r, q) is None]
            used = {part for where, name in self.read if where == path for part in (name, *name.split("+"))}
            there = [(f, c) for f in of.values() for c in range(len(f.names)) if f.named or is_number(f.rows[0][c])]
            names = dict.fromkeys(name for f, c in there if (name := f.names[c]) and name not in used)
            if names:
                self.notes.append(f"{path.name}: {unused([*names], free)}")

    def table(
        self, file: TextTable, role: str, quantities: Sequence[str], *, optional: Sequence[str] = (),
        texts: Sequence[str] = (), may_be_blank: Collection[str] = (),
    ) -> tuple[Table, int]:  # fmt: skip
        """Quantities of a file in SI units, some optional, and `texts` as words; and the number of skipped rows.

        Rows whose required quantities except instants are all blank are skipped, unless these may be blank. Rows that
        repeat an earlier one count once: of sensors in all fields, of others in those that are read.
        """
        columns = dict(zip(quantities, self.require(file, role, quantities), strict=True))
        columns |= {q: c for q in optional if (c := self.find(file, role, q)) is not None}
        named = {q: c for q in texts if (c := self.find(file, role, q)) is not None}
        for a, b in itertools.combinations([q for q in columns if q[0] != "s" and (QUANTITIES[q] or q in INSTANTS)], 2):
            if (c := columns[a]) == columns[b] and len({row[c] for row in file.rows}) > 1:
                raise DataError.at(file.path, f"column {file.names[c]} is named for {a} and {b} of {role}; name two")
        self.read |= {(file.path, file.names[c]) for c in (*columns.values(), *named.values())}
        measured = [columns[q] for q in quantities if q not in INSTANTS]
        empty = np.array([all(row[c].lower() in ("", "nan") for c in measured) for row in file.rows], bool)
        ended = empty & np.array(["t" in quantities and not row[columns["t"]] for row in file.rows], bool)
        empty &= ~ended  # below the end of an array that is shorter than others
        if role == "truth" and "t" in columns and 2 * empty.sum() > len(file):  # rows of several topics
            some = f"{int(empty.sum())} of {len(file)} rows have no true pose: it is interpolated between the others"
            self.notes.append(f"{file.path.name}: {some}")
        else:
            empty &= not set(quantities) & set(may_be_blank)
        keep = ~(empty | ended)
        must = [columns[q] for q in quantities if q not in may_be_blank]
        full = np.array([all(row[c].lower() not in ("", "nan") for c in must) for row in file.rows], bool)
        before = keep & (np.arange(len(file)) < np.argmax(keep & full) * ("t" in quantities))
        if before.any():
            some, has = counted(int(before.sum()), "row"), ", ".join(file.names[c] for c in must)
            self.notes.append(f"{file.path.name}: {some} before the first that has {has}: left out")
            keep &= ~before
        if role == "map" or INSTANTS & set(columns):
            whole = role not in ROLES or role == "observations"
            fields = range(len(file.names)) if whole else (*columns.values(), *named.values())
            first = {tuple(row[c] for c in fields): k for k, row in reversed([*enumerate(file.rows)])}
            once = np.zeros(len(file), bool)
            once[list(first.values())] = True
            if again := int((keep & ~once).sum()):
                self.notes.append(f"{file.path.name}: {counted(again, 'row')} of {role} repeated, counted once")
            keep &= once
        earth = {q for q in EARTH if role in ON_EARTH and columns.get(q, -1) == self.find(file, role, EARTH[q])}
        values: dict[str, Array] = {}
        for q, c in columns.items():
            dates = self.units.dates(role) if q in STAMPS else ""
            if q in ("id", *IDS) and (numbered := self._by_word(file, c, keep)) is not None:
                values[q] = numbered
                continue
            values[q] = file.numbers(c, keep, dates) * self.units.factor(role, EARTH[q] if q in earth else q)
            if q == "theta" and (self.units.unit(role, q) or self.units.given.get("angle")) == "compass":  # north is y
                values[q] += 0.5 * math.pi
            unstated = q == "t" and not {"t", "time", f"{role}.t"} & self.units.typed
            if unstated and (of_day := clock(values[q])) is not None:
                told = f"inferred: stamps are times of day hhmmss, as {file.text(c, keep)[0]}; now in s"
                self.notes.append(f"{file.path.name}: {told}")
                values[q] = of_day
        for q, c in columns.items():
            of = np.where(values[q] > 0.0, values[q], np.nan) if q == "range" else values[q]  # others are left out
            if QUANTITIES[q] not in ("", "time") and q[0] != "s" and (found := unmeasured(of)) is not None:
                row, count, far = found
                said = f"{file.text(c, keep)[row]} in {count} of {len(values[q])} rows"
                if far:
                    what = f"{said}, far beyond all others, is no measurement; leave the rows out, or the fields blank"
                    raise DataError.at(file.path, what, line=int(file.line[keep][row]), column=file.names[c])
                if q in ("range", "bearing"):
                    self.notes.append(f"{file.path.name}: {q} is {said}: was nothing measured there? Leave them out")
        if role in ("truth", "fixes") and {"x", "y"} <= {*values}:
            at, none = placed(np.column_stack([values["x"], values["y"]]), role, first=role == "fixes")
            self.notes += [f"{file.path.name}: {some}" for some in none]
            values |= {"x": at[:, 0], "y": at[:, 1]}
        if earth:
            place = np.stack([values["y"], values["x"], 0.0 * values["x"]], axis=-1)
            for k, (q, sides) in enumerate((("y", "NS"), ("x", "EW"))):  # the hemisphere, in the next column
                half = np.array(file.text(beside := (columns[q] + 1) % len(file.names), keep))
                if {*sides} >= set(half.tolist()):
                    place[half == sides[1], k] = -np.abs(place[half == sides[1], k])
                    self.read.add((file.path, file.names[beside]))
            if self.units.factor(role, "lat") != 1.0 and not np.nanmax(np.abs(place[:, 0]), initial=0.0) <= 90.0:
                raise DataError.at(file.path, "latitudes beyond 90 deg in the stated unit; is lat=deg,lon=deg right?")
            metres, datum, said = on_plane(file.path, place, self.datum)
            values |= {"x": metres[:, 0], "y": metres[:, 1]}
            self.datum[:] = datum[:2]
            self.notes += [said] * bool(said)
        if role in self.offsets:
            if not any(q in values for q in STAMPS):
                given = f"--time-offset {role}={self.offsets[role]:g}"
                raise UsageError(f"{given}: {file.path.name} is read without stamps")
            values |= {q: values[q] + self.offsets[role] for q in STAMPS if q in values}
        words = {q: file.text(c, keep) for q, c in named.items()}
        known = {q: f"{file.names[c]} ({role}.{q})" for q, c in columns.items() if file.names[c] != q}
        table = Table(file.path, values, line=file.line[keep], texts=words, named=known)
        for q, c in columns.items():
            fine = np.isfinite(values[q])
            if q not in may_be_blank and not fine.all():
                row = int(np.argmin(fine))
                field = file.text(c, keep)[row]
                raise table.error(row, file.names[c], f"{repr(field) if field else 'blank'}; a number is needed")
        if role in ("odometry", "truth") and "t" in values and not {"dx", "left"} & {*values}:  # which add up
            back = values["t"] < np.fmax.accumulate(values["t"])
            if 0.0 < back.sum() < FEW * len(back):
                said = f"{counted(int(back.sum()), f'{role} row')} with stamps before an earlier row's: left out"
                self.notes.append(f"{file.path.name}: {said}")
                table = table.part(np.flatnonzero(~back))
        return table, int(empty.sum())


def clock(values: Array) -> Array | None:
    """Seconds of the day of numbers hhmmss.s, whose last second of a minute is 40 to 41 before the next; else None."""
    step, second, minute = np.diff(values) % 4000.0, values % 100.0, values // 100.0 % 100.0  # 4041 after an hour
    new = (step > 40.0) & (step < 41.5) & (second[:-1] >= 58.5)
    whole = np.isfinite(values).all() and (values >= 0.0).all() and (values < 240000.0).all()
    fine = whole and (second < 60.0).all() and (minute < 60.0).all() and new.any()
    return np.asarray(3600.0 * (values // 10000.0) + 60.0 * minute + second) if fine else None


def unmeasured(values: Array) -> tuple[int, int, bool] | None:
    """First row and number of rows of a value that stands for none, and whether by size, as -999; else by frequency."""
    found, first, count = np.unique(values[np.isfinite(values)], return_index=True, return_counts=True)
    if len(found) < LEVELS:  # speeds that were commanded
        return None
    first, size = np.flatnonzero(np.isfinite(values))[first], np.abs(found)
    for by, far in ((size, True), (count, False)):
        k = int(np.argmax(by))
        if count[k] >= REPEATED and by[k] > BEYOND * np.delete(by, k).max():
            return int(first[k]), int(count[k]), far
    return None


FEW = 0.05  # Largest share of rows back in time that are left out
REPEATED, LEVELS = 3, 20  # Fewest fields with a value that stands for none, and fewest different values
BEYOND = 10.0  # Times as large, or as frequent, as any other


def headings(values: Mapping[str, Array], unit: float = 1.0) -> Array:
    """Headings (K,) [rad] from theta, or from a quaternion's rotation about z, clockwise if the unit is negative."""
    if "theta" in values:
        return values["theta"]
    x, y, z, w = (values[q] for q in QUATERNION)
    return np.asarray(np.arctan2(np.sign(unit) * 2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))


# Values of flags, as text.

Given = Mapping[str, object]  # Texts by flag (without leading dashes); flags of pairs as text or as a table of texts
POSE = ("length", "length", "angle")
TRAVEL = ("length", "length", "angle", "angle")
STAMPED = ("odometry", "observations", "truth", "fixes", "closures", SECOND, SCANS)  # With stamps, as sensors


def pairs(value: object, flag: str) -> dict[str, str]:
    """`a=b,c=d` (or several such texts, or a table) as a dict; of equal keys the last counts."""
    if isinstance(value, Mapping):
        return {str(k): str(v) for k, v in value.items()}
    texts = value if isinstance(value, list) else [str(value)]
    found: dict[str, str] = {}
    for part in [p.strip() for text in texts for p in str(text).split(",") if p.strip()]:
        key, equals, name = part.partition("=")
        if found and flag == "columns" and part.isdecimal():  # one more of several columns
            found[[*found][-1]] += f",{part}"
            continue
        if not (key.strip() and equals and name.strip()):
            right = "KEY=NAME is needed, as in t=stamp (names with commas: in a mapping file)"
            if flag == "time-offset":
                right = f"PART=SECONDS is needed, as in truth=-0.5, of {', '.join(STAMPED)}"
            raise UsageError(f"--{flag} {part}: {right}")
        found[key.strip()] = name.strip()
    return found


def numbers(
    text: object, dimensions: Sequence[str], flag: str, what: str, *, zero: bool | None = None, length: str = ""
) -> Array:
    """Numbers with or without units, by default of `length`; `zero`: standard deviations, which may be 0 or not."""
    parts = words(text)
    if len(parts) != len(dimensions):
        raise UsageError(f"--{flag} {text}: {len(dimensions)} numbers are needed: {what}")
    usual = [length if d == "length" and is_number(p) else "" for p, d in zip(parts, dimensions, strict=True)]
    each = zip(parts, usual, dimensions, strict=True)
    found = np.array([quantity_with_unit(f"{p}{unit}", d, f"--{flag}") for p, unit, d in each])
    if zero is not None and not (found >= 0.0 if zero else found > 0.0).all():
        raise UsageError(f"--{flag} {text}: must be {'0 or more' if zero else 'more than 0'}")
    return found


def one_of(given: Given, flag: str, known: Sequence[str]) -> str:
    """The word of a flag, by default the first that is known."""
    value = str(given.get(flag, known[0]))
    if value not in known:
        raise UsageError(f"--{flag} {value}: {unknown(value, known)}")
    return value


def words(text: object) -> list[str]:
    """The parts of a list with commas or spaces."""
    return str(text).replace(",", " ").split()
