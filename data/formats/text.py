"""The rows of a text file: encoding, comments, separator, quotes, decimal commas, a cut last row, and the header.

Comma, semicolon, tab, bar or spaces, with or without a header, which may have a title above it. Lines that start with
`#` or `%` are comments; the last one above the first row is the header if its number of fields fits. Fields may be
quoted. Paths (`Text`) keep rows of any length, logs (`TextTable`) have as many fields in each, below names.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Self

import numpy as np

from data.columns.named import is_stamp
from data.csv_table import cut_off, ends_early, is_number
from data.dates import DMY, EXAMPLE, MDY, is_date, seconds_of, whole_dates
from data.errors import DataError
from data.formats.arrays import ELEMENT, WIDE, columns_of, is_arrays
from data.formats.messages import LISTED, blocks_of, cut_end, kinds_of, parts_of, read_lines, whole_names
from data.formats.recordings.ros import file_and_topic, is_bag, table_of
from data.inputs import IntArray
from data.se2 import Array, BoolArray

SEPARATORS = (";", "\t", ",", "|", " ")  # In this order: a decimal comma is no separator beside a semicolon or a tab
COMMENT = ("#", "%")
CELLS = r"\"[^\"]*\"|[\[(][^\[\]()]*[\])]|(?<=\d) sec(?=[,;])"  # Quoted, or lists; unit of MATLAB's timetables
RTKLIB = r"%\s+(GPST|UTC|JST)\s+latitude\(deg\)"  # The comment that names the columns of its solutions
SLOTS = 3  # Least different numbers of filled columns, from the left always, which no landmarks in sight would make


@dataclass(frozen=True, eq=False)
class Text:
    """Rows of stripped fields without quotes, of any length; the first may be a header."""

    path: Path
    fields: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]  # of each row, from 1
    separator: str = ""  # a blank: spaces and tabs; none: of arrays and topics
    comments: tuple[tuple[int, str], ...] = ()  # with the numbers of their lines
    every: tuple[int, ...] = ()  # lines that are no comments, also blank ones
    cut: str = ""  # what is said of rows that are left out
    block: tuple[str, ...] = ()  # number of the block of each row

    @property
    def commas(self) -> bool:
        """Whether more than blanks separates the fields."""
        return self.separator not in (" ", "\t")

    @property
    def above(self) -> tuple[str, ...]:
        """The fields of the last comment above the rows; none without."""
        last = [comment.lstrip("#% ") for k, comment in self.comments if k < self.line[0]][-1:]
        return next(iter(split(last, self.separator)), ())

    def place(self, row: int) -> str:
        """Place of a row, for messages."""
        return f"{self.path}:{self.line[row]}"


@dataclass(frozen=True, eq=False)
class TextTable:
    """Rows of stripped fields without quotes, of equal length."""

    path: Path
    names: tuple[str, ...]  # of the columns, "1", "2", ... without a header
    rows: tuple[tuple[str, ...], ...]
    line: IntArray  # (K,) of each row
    named: bool  # with a header
    cut: str = ""  # what is said of rows that are left out, or end before the header
    steps: int = 0  # rows of which each has any number of observations, one for each row of the odometry

    def __len__(self) -> int:
        return len(self.rows)

    def series(self) -> dict[int, list[str]]:
        """Names by number of rows, of arrays that begin in the first row and end in different ones; else none."""
        columns = list(zip(*self.rows, strict=True)) if is_arrays(self.path) and all(self.rows[0]) else []
        found: dict[int, list[str]] = {}
        for name, column in zip(self.names, columns, strict=False):
            found.setdefault(column.index("") if "" in column else len(column), []).append(name)
        return found if len(found) > 1 else {}

    def beside(self, name: str, number: IntArray) -> Self:
        """With one more column, of a number (K,) for each row."""
        rows = tuple((*row, str(k)) for row, k in zip(self.rows, number.tolist(), strict=True))
        return replace(self, names=(*self.names, name), rows=rows)

    @cached_property
    def filled(self) -> tuple[int, ...]:
        """The columns with a field that is not blank."""
        return tuple(k for k in range(len(self.names)) if any(row[k] for row in self.rows))

    def text(self, column: int, keep: BoolArray) -> list[str]:
        """The fields of a column in the rows to keep (K,)."""
        return [row[column] for row, wanted in zip(self.rows, keep.tolist(), strict=True) if wanted]

    def numbers(self, column: int, keep: BoolArray, dates: str = "") -> Array:
        """A column as numbers, NaN where blank; `dates`: unit of dates, in s since 1970. DataError if invalid."""
        parse = partial(seconds_of, unit=dates) if dates else _number
        values = np.full(int(keep.sum()), np.nan)
        for k, text in enumerate(self.text(column, keep)):
            try:
                values[k] = parse(text) if text else np.nan
            except ValueError:
                what = f"a date as in {EXAMPLE} (or as --unit t={DMY}, {MDY} say)" if dates else "a number"
                line, name = int(self.line[keep][k]), self.names[column]
                raise DataError.at(self.path, f"{text!r} is not {what}", line=line, column=name) from None
        return values


def _number(field: str) -> float:
    value = float(field)
    if "_" in field or math.isinf(value):  # Python reads 1_0 as ten
        raise ValueError
    return value


def is_row(fields: Sequence[str]) -> bool:
    """Whether at least half of a line's non-blank fields are numbers or dates."""
    filled = [f for f in fields if f]
    return bool(filled) and 2 * sum(is_number(f.replace(",", ".")) or is_date(f) for f in filled) >= len(filled)


def split(lines: Sequence[str], separator: str) -> list[tuple[str, ...]]:
    """Fields of each line."""
    lines = [" ".join(line.split()) for line in lines] if separator == " " else lines
    if not any('"' in line for line in lines):
        return [tuple(map(str.strip, line.split(separator))) for line in lines]
    return [tuple(map(str.strip, row)) for row in csv.reader(lines, delimiter=separator, skipinitialspace=True)]


def _separator(lines: Sequence[str]) -> str:
    """The first that cuts the first lines into equal numbers of fields, more than one; else a comma."""
    for separator in SEPARATORS:
        # a header may hold any character, so the rows below it decide
        counts = {len(row) for row in split(lines[1:] or lines, separator)}
        if len(counts) == 1 and counts.pop() > 1:
            # tabs beside spaces: both separate, if that leaves numbers
            apart = split(lines[1:] or lines, " ") if separator == "\t" else []
            mixed = len({len(row) for row in apart}) == 1 and all(map(is_row, apart))
            mixed &= any(" " in line for line in lines[1:] or lines) or all("\t\t" in line for line in lines)
            return " " if mixed else separator
    held = [s for s in SEPARATORS if 2 * sum(s in line for line in lines) > len(lines)]
    numbers = held[:1] == ["\t"] and all(is_number(f) for line in lines for f in line.split())  # tabs in some alone
    return " " if numbers else held[0] if held else ","


def read_text(path: Path) -> Text:
    """A file's rows, below a header those of its table, or of FIRST+SECOND+..., but not what is within an object."""
    several = not path.is_dir() and len(parts_of(path)) > 1
    text = Text(path, (), ()) if several else _rows(path)
    if several or not is_row(text.fields[0]):
        table = _table(text) if text.fields else read_table(path)
        line = (0 if several else text.line[0], *table.line.tolist())
        text = replace(text, fields=(table.names, *table.rows), line=line, cut=table.cut)
    inside = [k for k, name in enumerate(text.fields[0]) if name.rpartition(".")[2] == ELEMENT]
    fields = tuple(row for k, row in enumerate(text.fields) if k == 0 or not any(row[j] for j in inside))
    return replace(text, fields=fields, line=text.line[: len(fields)]) if inside else text


def _rows(path: Path, stated: Collection[str] = (), odometry: int = 0) -> Text:
    bag, topic = file_and_topic(str(path))
    if topic is not None or is_arrays(path):
        names, found = columns_of(path, stated, odometry) if topic is None else table_of(bag, topic)
        return Text(path, (names, *found), tuple(range(len(found) + 1)))
    lines, word, title = read_lines(path)
    most = csv.field_size_limit()
    for i, line in lines:
        if len(line) > most and ('"' in line or max(map(len, re.split(r"[\s,;|]", line))) > most):
            raise DataError.at(path, f"more than {most} characters", line=i)
    every = [(i, line) for i, line in lines if not line.lstrip().startswith(COMMENT)]
    plain = [(i, line.replace(",\t", ",")) for i, line in every if line.strip()]
    if not any(line.strip(" ;,|\t") for _, line in plain):
        raise DataError.at(path, f"no rows{f' of {word}' * bool(word)}; at least one is needed")
    number, separator = [i for i, _ in plain], _separator([line for _, line in (*plain[:50], *plain[50:-1][-1:])])
    if separator == "," and any(re.search(r"[\[(]| sec", line) for _, line in plain):
        joined = partial(re.sub, CELLS, lambda c: c[0] if c[0][0] == '"' else re.sub(",| sec", " ", c[0]))
        plain = [(i, joined(line)) for i, line in plain]  # commas within lists separate nothing
    rows = split([line for _, line in plain], separator)
    if len(rows) != len(plain):
        open_at = next((i for i, line in plain if line.count('"') % 2), number[0])
        raise DataError.at(path, "a quote that is not closed within its line", line=open_at)
    if separator != "," and any("," in line for _, line in plain):
        points = any("." in f and is_number(f) for row in rows for f in row)
        with_point = (tuple(f.replace(",", ".") for f in row) for row in rows)
        each = (zip(row, others, strict=True) for row, others in zip(rows, with_point, strict=True))
        rows = rows if points else [tuple(p if is_number(p) or is_date(p) else f for f, p in pairs) for pairs in each]
    stripped = ((i, line.strip().removesuffix(separator)) for i, line in lines)
    comments = tuple((i, line) for i, line in stripped if line.startswith(COMMENT))
    text = Text(path, tuple(rows), tuple(number), separator, comments, tuple(i for i, _ in every))
    names, below = (rows[0], rows[1:]) if not is_row(rows[0]) else (text.above, rows)
    if below and all(len(row) > 1 and not row[-1] for row in below):
        named = len(names) == len(below[0]) or (below is not rows and len(names) > len(below[0]))
        if not (named and names[-1]):  # else a last column that is blank
            rows = [row[: -1 if not row[-1] else None] for row in rows]  # a separator ends every line
    if cut := cut_end(rows, number[-1]):
        rows, number = rows[:-1], number[:-1]
    if block := blocks_of(rows):
        cut = f"inferred: {block.count('')} rows as {','.join(rows[0])} are heads: a number, and how many rows follow"
        within = [k for k, of in enumerate(block) if of]
        rows, number, block = [rows[k] for k in within], [number[k] for k in within], [block[k] for k in within]
        text = replace(text, every=tuple(number), block=tuple(block))
    if titles := next((c.lstrip("% ").split() for _, c in comments if re.match(RTKLIB, c)), None):
        dated = "/" in rows[0][0]  # else the week, and its seconds
        rows = [("time", *titles[1:]), *((" ".join(row[:2]) if dated else row[1], *row[2:]) for row in rows)]
        number = [0, *number]
    return replace(text, fields=tuple(rows), line=tuple(number), cut="; ".join(filter(None, (title, cut))))


def read_table(path: Path, stated: Collection[str] = (), odometry: int = 0, *, seen: bool = False) -> TextTable:
    """A file's rows, or DataError. `stated`: names of columns; `odometry`: its rows; `seen`: each may have several."""
    bag, topic = file_and_topic(str(path))
    if topic is None and is_bag(bag):
        what = f"type slamref convert bag {bag} --list; a topic is a table: slamref convert table {bag}:/TOPIC LOG"
        raise DataError.at(path, f"a ROS bag; {what}")
    if len(parts := parts_of(path)) > 1:
        return _joined(path, parts)
    text = _rows(path, stated, odometry)
    line = tuple(i for i, row in zip(text.line, text.fields, strict=True) if any(row))
    text = replace(text, fields=tuple(row for row in text.fields if any(row)), line=line)
    return _table(text, stated, odometry, seen=seen)


def _table(text: Text, stated: Collection[str] = (), odometry: int = 0, *, seen: bool = False) -> TextTable:
    path = text.path
    if not text.separator:
        return TextTable(path, text.fields[0], text.fields[1:], np.array(text.line[1:], np.int64), named=True)
    said, rows, number = [text.cut], [*text.fields], np.array(text.line, np.int64)
    names: tuple[str, ...] | None = None
    if seen and (found := _by_rows(rows, np.searchsorted(text.every, number).tolist(), len(text.every), odometry)):
        names, rows, row_of = found
        cut = "inferred: a row for each of the odometry, of any number of observations of columns "
        cut += ",".join(names[:-1])
        return TextTable(path, names, tuple(rows), number[row_of], named=True, cut=cut, steps=len(text.every))
    if not is_row(rows[0]):
        names, rows, number = rows[0], rows[1:], number[1:]
    elif len(text.above) == len(rows[0]):
        names = text.above
    if not rows:
        raise DataError.at(path, "a header and no rows; at least one is needed")
    rows = _uncounted(rows) if names is None else rows
    if each := _each(rows) if names is None else 0:
        number = np.repeat(number, [len(row) // each for row in rows])
        rows = [(row[0], *row[k : k + each]) for row in rows for k in range(1, len(row), each)]
        said.append(f"inferred: a row is a stamp and any number of observations of {each} numbers each")
    if names and len(names) + SLOTS < len(rows[0]) <= LONG:
        names = names if names[-1] else names[:-1]
        alike = text.commas and len({*map(len, rows)}) == 1 and is_row(rows[0])
        if len(listed := [n for n in names if n in LISTED] or [*names[-1:]] * alike) == 1:  # one name for all of a list
            at, count = names.index(listed[0]), len(rows[0]) - len(names) + 1
            said.append(f"inferred: {listed[0]} stands for {count} columns, {listed[0]}_1 to {listed[0]}_{count}")
            names = (*names[:at], *(f"{listed[0]}_{k}" for k in range(1, count + 1)), *names[at + 1 :])
    longest = max(map(len, rows))
    names = names[:longest] if names and not any(names[longest:]) else names  # blank names behind all fields
    width = len(rows[0]) if names is None else len(names)
    early = ends_early(map(len, rows), width, 1) if names is not None and text.separator != " " else set()
    if early:
        many = f"{sum(len(row) in early for row in rows)} of {len(rows)}"
        said.append(f"{many} rows end before the header does: their last columns are blank")
    rows = [row + ("",) * (width - len(row)) if len(row) in early else row for row in rows]
    for row, line in zip(rows, number.tolist(), strict=True):
        if len(row) != width:
            last = cut_off(len(row), width, last=line == number[-1])
            ragged = "; is it one observation after the other? a row for each is needed, of points of a scan its ranges"
            if width > WIDE[1]:
                ragged = "; of scans as many ranges in each row are needed, blank or 0 where nothing returned"
            several = kinds_of(path, rows) or ragged * (len(set(map(len, rows))) > 2)
            raise DataError.at(path, f"{len(row)} fields where {width} are needed{last or several}", line=line)
    names, rows, number = _lists(names, whole_dates(rows), number)
    width = len(rows[0])
    shown = list(whole_names(names, rows)) if names is not None else [str(k + 1) for k in range(width)]
    seconds = ((k, m[1]) for k, name in enumerate(shown) if (m := re.fullmatch(r"(.*?[._]?)secs?", name)))
    for k, stem in [*seconds]:  # and nanoseconds of a stamp
        j = next((shown.index(n) for end in NANOSECONDS if (n := stem + end) in shown), None)
        if j is not None and all(r[j].isdecimal() and r[k].lstrip("-").isdecimal() for r in rows):
            rows = [(*r[:k], f"{r[k]}.{int(r[j]):09d}", *r[k + 1 :]) for r in rows]
            shown[k] = stem[:-1] if stem.endswith(".") else shown[k]
    for both in {name for name in stated if "+" in name and {*name.split("+")} <= {*shown}}:  # seconds and nanoseconds
        j, k = (shown.index(part) for part in both.split("+"))
        small = next((n for n, unit in FRACTIONS.items() if re.fullmatch(rf"(.*[^a-z])?({unit})", shown[k], re.I)), 9)
        rows, shown = [(*r, f"{r[j]}.{r[k]:0>{small}}" if r[j] and r[k] else "") for r in rows], [*shown, both]
    if text.block:
        rows, shown = [(*row, of) for row, of in zip(rows, text.block, strict=True)], [*shown, "frame"]
    cut = "; ".join(filter(None, said))
    return TextTable(path, tuple(shown), tuple(rows), number, names is not None, cut)


NANOSECONDS = ("nsecs", "nsec", "nanosec", "nanosecs")
FRACTIONS = {6: "us|usecs?|micro.*", 3: "ms|msecs?|milli.*"}
"""Digits of the second column of a stamp that is stated as SEC+REST, by its name; else nanoseconds."""


def _lists(
    names: tuple[str, ...] | None, rows: list[tuple[str, ...]], number: IntArray
) -> tuple[tuple[str, ...] | None, list[tuple[str, ...]], IntArray]:
    """Lists in fields as columns NAME_1, NAME_2, ...; lists of unequal lengths, or of groups, as rows below."""
    count, below = len(rows), dict[tuple[int, ...], list[int]]()  # rows below by how many each row has
    for j in reversed(range(len(rows[0]))):
        pattern = r"[\[({]|\d;|\d\s+[-+.\d]"
        if not any(re.search(pattern, row[j]) and not is_date(row[j]) for row in rows[: min(MANY, count)]):
            continue
        fields = [re.sub(r"np\.\w+\(([^()]*)\)|array", r"\1", row[j]) for row in rows[:count]]
        groups = [re.findall(r"[\[({]([^\[\](){}]+)[\])}]", f) or f.strip("[](){}").split(";") for f in fields]
        parts = [[re.split(r"[\s,:]+", g.strip(" ,")) for g in some if g.strip(" ,")] for some in groups]
        if max(map(len, parts)) == 1 and len({len(some[0]) for some in parts if some}) > 1:  # numbers of each in a row
            parts = [[[number] for number in some[0]] if some else [] for some in parts]
        counts, most = {len(part) for some in parts for part in some}, max(map(len, parts))
        if len(counts) != 1 or not all(is_number(v) for some in parts for part in some for v in part):
            continue
        if max(width := counts.pop(), most) > LONG or width == most == 1:
            continue
        shape, stem, blank = tuple(map(len, parts)), names[j] if names else str(j + 1), [("",) * width]
        if most > 1 and shape not in below:
            below[shape] = [len(rows) + k for k in range(sum(shape))]
            stamps = {c for c, name in enumerate(names or ()) if is_stamp(name)}
            rows = [(*row, "") for row in rows]
            each = ((k, rows[k]) for k, some in enumerate(parts) for _ in some)
            rows += [(*(f if c in stamps else "" for c, f in enumerate(row[:-1])), str(k)) for k, row in each]
            number = np.concatenate([number, np.repeat(number[:count], shape)])
            names = (*names, f"{stem}.{ELEMENT}") if names else None
        put = [*([tuple(some[0])] if some else blank for some in parts)] if most == 1 else [blank] * count
        own = [*(part[0] for part in put), *blank * (len(rows) - count)]
        for k, part in zip(below[shape], (p for some in parts for p in some), strict=True) if most > 1 else ():
            own[k] = tuple(part)
        rows = [(*row[:j], *part, *row[j + 1 :]) for row, part in zip(rows, own, strict=True)]
        named = [f"{stem}_{k}" for k in range(1, width + 1)] if width > 1 else [stem]
        names = (*names[:j], *named, *names[j + 1 :]) if names else None
    return names, rows, number


MANY, LONG = 50, 10_000  # First rows, of which one shows whether a column holds lists; most numbers of a list


def _uncounted(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Rows without their second number, where it says how many groups of two or three numbers follow in each."""
    several = len({*map(len, rows)}) > 1 and all(len(row) > 1 and is_number(row[1]) for row in rows)
    counted = (all(len(row) - 2 == each * float(row[1]) for row in rows) for each in (2, 3))
    return [(row[0], *row[2:]) for row in rows] if several and any(counted) else rows


def _each(rows: Sequence[Sequence[str]]) -> int:
    """How many numbers each observation has, in rows of three or more lengths behind stamps; 0: none, unknown."""
    count = math.gcd(*(len(row) - 1 for row in rows))
    fits = count in (2, 3) and len(set(map(len, rows))) >= SLOTS and all(map(is_number, chain(*rows)))
    return count if fits and all(float(a[0]) <= float(b[0]) for a, b in pairwise(rows)) else 0


def _by_rows(
    rows: Sequence[Sequence[str]], at: Sequence[int], count: int, steps: int
) -> tuple[tuple[str, ...], list[tuple[str, ...]], list[int]] | None:
    """Names, rows and the row before of observations, of which rows hold any number, two or three numbers each, behind
    the same words, at positions `at` among `count` lines, one for each of the odometry's `steps`; else None.
    """
    rows = [row[: max((j + 1 for j, f in enumerate(row) if f), default=0)] for row in rows]
    longest = max(rows, key=len)
    lead = next((j for j, f in enumerate(longest) if is_number(f)), len(longest))
    each = {2: 2, 3: 3, 4: 2}.get(math.gcd(*(len(row) - lead for row in rows)), 0)
    alike = all(row[:lead] == longest[:lead] and all(map(is_number, row[lead:])) for row in rows)
    unequal = len({*map(len, rows), *[lead] * (count > len(rows))}) > 1
    if not (each and alike and unequal and at[-1] <= steps <= count):
        return None
    found = [(k, row[j : j + each]) for k, row in enumerate(rows) for j in range(lead, len(row), each)]
    a, b = np.array([o[-2:] for _, o in found], float).T
    if (np.diff([float(row[lead]) for row in rows if len(row) > lead]) >= 0.0).all():
        return None
    points = each == 2 and bool((a < 0.0).any() or np.abs(b).max() > math.degrees(3.0 * math.pi))
    names = [str(k + 1) for k in range(lead + each)][: -2 if points else None] + ["x", "y"] * points
    return (*names, "frame"), [(*longest[:lead], *o, str(at[k])) for k, o in found], [k for k, _ in found]


def _joined(path: Path, parts: Sequence[Path]) -> TextTable:
    """One table of files: a folder's one below the other, numbered as `frame`, else side by side."""
    tables = [read_table(part) for part in parts]
    if not path.is_dir():
        often = Counter(name for t in tables if t.named for name in t.names if not is_stamp(name))
        tables = [
            replace(t, names=tuple(t.path.stem if often[n] > 1 else n for n in t.names)) if len(t.names) < 3 else t
            for t in tables
        ]  # a column alone beside stamps is that of its file, or topic
        names, rows, said = _side_by_side(path, tables)
        said = "; ".join(filter(None, (said, *(t.cut for t in tables))))
        return TextTable(path, names, rows, tables[0].line, named=True, cut=said)
    if len({len(t.names) for t in tables}) > 1:
        raise DataError.at(path, "files of unequal numbers of columns; as many in each are needed")
    names = ("frame", *tables[0].names)
    rows = tuple((str(k), *row) for k, t in enumerate(tables) for row in t.rows)
    return TextTable(path, names, rows, np.arange(1, len(rows) + 1), named=True)


def _side_by_side(path: Path, sides: Sequence[TextTable]) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...], str]:
    """Names and rows of files side by side, each row of the first with those nearest in time where all have stamps of
    their own, which is said; columns without names have those of their file. DataError for unequal numbers of rows.
    """
    stamps = [[k for k, name in enumerate(s.names) if s.named and is_stamp(name)] for s in sides]
    stamps = [[k for k in own if "header" in s.names[k]] or own for s, own in zip(sides, stamps, strict=True)]
    texts = [[row[k] for row in s.rows] for s, own in zip(sides, stamps, strict=True) for k in own[: len(own) < 2]]
    near = [np.arange(len(s.rows)) for s in sides]
    apart = len(texts) == len(sides) and any(own != texts[0] for own in texts) and all(map(is_number, chain(*texts)))
    times = [np.array(own, float) for own in texts] if apart else []
    if apart := apart and all((np.diff(time) >= 0.0).all() for time in times):
        near[1:] = [_nearest(time, times[0]) for time in times[1:]]
    elif len({*map(len, near)}) > 1:
        what = f"files of unequal numbers of rows ({', '.join(f'{s.path.name} {len(s.rows)}' for s in sides)})"
        raise DataError.at(path, f"{what}; as many in each are needed, or a column of stamps")
    held = dict[tuple[str, tuple[str, ...]], None]()  # the same stamps once
    for side, own, rows in zip(sides, stamps, near, strict=True):
        for j, name in enumerate(side.names):
            stem = side.path.stem + name * (len(side.names) > 1)
            column = tuple(side.rows[k][j] if k >= 0 else "" for k in rows.tolist())
            if side is sides[0] or not apart or j not in own:
                held[name if side.named and not name.isdecimal() else stem, column] = None
    others = ", ".join(s.path.name for s in sides[1:])
    said = f"beside each row of {sides[0].path.name} those of {others} nearest in time" * apart
    return tuple(name for name, _ in held), tuple(zip(*(column for _, column in held), strict=True)), said


def _nearest(time: Array, at: Array) -> IntArray:
    """The rows of ascending stamps (n,) nearest to others (m,); -1 for those more than a usual step outside."""
    near = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    near -= at - time[near - 1] < time[near] - at
    step = np.median(np.diff(time, prepend=time[0]))
    return np.where((time[0] - step <= at) & (at <= time[-1] + step), near, -1)
