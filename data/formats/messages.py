"""Rows of tables: messages that ROS printed as YAML (`rostopic echo`), and rows of one kind of several."""

import csv
import re
import struct
from collections import Counter
from collections.abc import Sequence
from itertools import islice, pairwise, zip_longest
from pathlib import Path

import numpy as np

from data.columns.named import LENGTH, STAMP
from data.csv_table import bytes_of, is_number
from data.errors import DataError
from data.formats.arrays import is_arrays, records
from data.formats.recordings.ros import file_and_topic
from data.formats.wrapped import echoed_names, file_and_word, unwrapped


def read_lines(path: Path) -> tuple[list[tuple[int, str]], str, str]:
    """Rows of a file with the numbers of their lines; the word of FILE:WORD, which these rows hold; and a note on
    titles that are left out. DataError for a file that cannot be read, or is no text.
    """
    content, word = records(path)
    if not content:
        content, word = unwrapped(path, bytes_of(file_and_word(path)[0], missing="no such file"), word)
    try:
        text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    kind, _, width = word.partition("=")
    if kind in BINARY and width.isdecimal() and len(content) % (int(width) * BINARY[kind]) == 0:
        table = np.frombuffer(content, f"<f{BINARY[kind]}").reshape(-1, int(width))
        return [(k, " ".join(map(repr, row))) for k, row in enumerate(table.tolist(), 1)], word, ""
    if "\0" in text:
        file = file_and_word(path)[0]
        what = f"of rows of K doubles type {file}:doubles=K, of floats {file}:floats=K"
        raise DataError.at(path, f"not a text file of {len(content)} bytes; a CSV file is needed, or arrays; {what}")
    if TELEGRAM in text and (telegrams := _of_sick(text)):
        return telegrams, word, SICK
    rows = numbered_rows(text)
    lines, said = _of_motive(rows) if text.startswith("Format Version") else _tidied(rows)
    return with_word(lines, word), word, said


def runs_of(path: Path) -> str:
    """What to type where the rows of a text are of several runs, one after the other; else nothing."""
    lines = read_lines(path)[0] if file_and_word(path)[0].is_file() and not is_arrays(path) else []
    begun = [str(lines[k][0]) for k in begins(lines)]
    said = f"; {len(begun)} runs begin, in lines {', '.join(begun)[:60]}: name one, as in {path}:run=1"
    return said if len(begun) > 1 else ""


BINARY = {"doubles": 8, "floats": 4}  # Bytes of numbers of binary rows


def _tidied(lines: list[tuple[int, str]]) -> tuple[list[tuple[int, str]], str]:
    """Rows without `sep=;`, titles, repeated names and comments, and what titles say; words for nothing are NaN."""
    lines = [(i, re.sub(r"^\s*//", "#", re.sub(NOTHING, "nan", re.sub(ALONE, r"\1", line)))) for i, line in lines[:-1]
             if not re.fullmatch(r"sep=.\s*", line)] + lines[-1:]  # fmt: skip
    top = [pair for pair in lines[:LEADING] if pair[1].strip() and pair[1].lstrip()[0] not in "#%"]
    mark = next((m for m in ";\t|," if top and m in top[-1][1]), None)
    rows = [line.split() if all(map(is_number, line.split())) else
            [f.strip(' "') for f in line.strip().rstrip(mark).split(mark)] for _, line in top]  # fmt: skip
    ahead = [len(row) > 2 or len(row) == len(after) for row, after in zip(rows, [*rows[1:], *rows[-1:]], strict=True)]
    first = next((k for k, row in enumerate(rows) if ahead[k] and 2 * sum(map(is_number, row)) >= len(row)), 0)
    units = rows[first - 1] if first > 1 and len(rows[first - 2]) == len(rows[first]) == len(rows[first - 1]) else []
    if any(units) and all(re.fullmatch(UNIT, u, re.IGNORECASE) for u in units):  # such as (sec) and [m], some blank
        named = [f"{name} [{u.strip('[]()')}]" if u else name for name, u in zip(rows[first - 2], units, strict=True)]
        whole = [(top[first - 2][0], (mark or " ").join(named)) if pair == top[first - 2] else pair for pair in lines]
        return _tidied([pair for pair in whole if pair != top[first - 1]])
    wide = [len(row) == len(rows[first]) for row in rows]
    heads = [k for k in range(first) if wide[k] and top[k][1] not in {line for _, line in top[:k]}]
    alone = bool(first and re.search(PROSE[mark is None], top[first - 1][1]) and not {*LISTED} & {*rows[first - 1]})
    alone = alone and not heads and len(wide) > first + 2
    alone = alone and (mark is None or len(rows[first - 1]) < len(rows[first]))
    if first < 1 or len(heads) != (not alone) or not all(wide[first : first + 2 + alone]):
        return lines, ""
    head, titles = [top[k] for k in heads], [top[k] for k in range(first) if not wide[k]]
    again, above = {line for _, line in top[:first]}, f"above {'rows without' if alone else 'the'} names"
    said = "; ".join(f"line {i} is a title {above}: {line.strip()[:60]}" for i, line in titles)
    between = [re.match(r"\D*[A-Za-z]\D*(?=\d)", line) for i, line in titles if not head or i > head[0][0]]
    starts = tuple(found[0] for found in between if found)  # as of Run:,1
    return [pair for pair in lines if pair in head or not (pair[1] in again or pair[1].startswith(starts))], said


LISTED = ("ranges", "range", "scan", "distances")  # Names that may stand for all beams of a scan
PROSE = r"\w \w", r"[,:;.!?](\s|$)|\s\d"  # In a line above rows that are separated by a mark, or by spaces alone


def _of_motive(lines: list[tuple[int, str]]) -> tuple[list[tuple[int, str]], str]:
    """Rows of the first rigid body of an export of Motive (OptiTrack), its y, which is up, as z; and what is said."""
    (_, title), *rows = [(i, [f.strip('" ') for f in line.split(",")]) for i, line in lines if line.strip()]
    top = next((k for k, (_, row) in enumerate(rows) if row[0].startswith("Frame")), 0)
    kinds, bodies, parts, axes = (rows[k][1] for k in (0, 1, top - 1, top))
    unit = next((unit for word, unit in (("Millimeters", "mm"), ("Centimeters", "cm")) if word in title), "m")
    of, made = dict(zip("XYZW", "yzxw", strict=True)), {1: "t [s]"}
    for j, (kind, body, part, axis) in enumerate(zip(kinds, bodies, parts, map(str.upper, axes), strict=False)):
        if kind == "Rigid Body" and body == bodies[kinds.index(kind)] and axis in of:
            made[j] = f"q{of[axis]}" if part == "Rotation" else f"{of[axis]} [{unit}]"
    said = f"inferred: rigid body {bodies[min(made.keys() - {1}, default=1)]} of Motive, whose y is up and becomes z"
    return [(0, ",".join(made.values())), *((i, ",".join(r[j] for j in made)) for i, r in rows[top + 1 :])], said


def _of_sick(text: str) -> list[tuple[int, str]]:
    """A row for each telegram of a scan of SICK, whose numbers are hexadecimal: time, first angle, step and ranges."""
    rows, line = list[tuple[int, list[float]]](), 1
    for before, telegram in pairwise(text.split(TELEGRAM)):
        line += before.count("\n")
        fields = re.findall(r"\w+", telegram)
        if SCAN not in fields[:-5]:
            continue
        scale, begin, low, step, count, *far = fields[fields.index(SCAN) + 1 :]
        metres, zero = struct.unpack(">2f", bytes.fromhex(f"{scale:0>8}{begin:0>8}")) * np.array(LENGTH["mm"])
        first = (int(low, 16) + 2**31) % 2**32 - 2**31
        ranges = [zero + metres * r * (r >= ERRORS) for r in (int(f, 16) for f in far[: int(count, 16)])]
        rows.append((line, [1e-6 * int(fields[7], 16), 1e-4 * first - 90.0, 1e-4 * int(step, 16), *ranges]))
    names = ("t", "angle_min_deg", "angle_increment_deg", *map("range{}".format, range(len(rows[0][1]) - 3)))
    return [(0, ",".join(names)), *((i, ",".join(f"{v:.9g}" for v in row)) for i, row in rows)] if rows else []


TELEGRAM, SCAN, ERRORS = "LMDscandata", "DIST1", 16  # Names of a telegram, of its ranges; least number that is a range
SICK = "inferred: telegrams of SICK, whose 90 deg are ahead; seconds since the scanner's start"


UNIT = (
    r"[\[(]?\s*(|-|%|[mun]?s|[mun]?sec|seconds?|[cmk]?m|met(er|re)s?|(deg|degrees?|°|rad|radians?|[cmk]?m|g)"
    r"(/s(\^?2|²|/s)?)?|km/h|hz|ticks?|counts?|n/?a)\s*[\])]?"
)
ALONE, NOTHING = r"(?<![\w\]])\[([-+.\deE]+)\]", r"(?<![^\s,;])(?:N/A|n/a|None|null|NULL|-)(?=$|[\s,;])"
LEADING = 30  # First lines among which the first row of numbers is looked for


def numbered_rows(text: str) -> list[tuple[int, str]]:
    """Lines of a text with numbers from 1; of messages a header and a row each, at its first line.

    A field is named by its path, as `pose.pose.position.x`; elements of lists have numbers from 0 behind it. Seconds
    and nanoseconds of a stamp are one field. Messages whose fields are not those of the first are left out.
    """
    lines = _whole(list(enumerate(text.splitlines(), 1)))
    first = next((line for _, line in lines if line.strip() not in ("", "---")), "")
    if header := echoed_names(first):
        return [(0, header), *lines]
    if re.fullmatch(r"\s*[A-Za-z_]\w*:\s*\S+\s*", first) and (blocks := _blocks(lines)):
        return blocks
    if re.match(r"\s*[\[(][^\])]*[\])],?\s*$", first):  # rows in brackets
        return [(i, line.strip(" \t,[]()")) for i, line in lines]
    if pairs := _pairs(lines):
        return pairs
    if not re.fullmatch(r"[A-Za-z_]\w*:(\s+\S+)?\s*", first) or not any(line.rstrip() == "---" for _, line in lines):
        return lines
    messages: list[tuple[int, dict[str, str]]] = [(0, {})]
    path: list[tuple[int, str]] = []
    for number, line in lines:
        body, indent = line.strip(), len(line) - len(line.lstrip())
        if body == "---":
            messages.append((number + 1, {}))
            continue
        item, key = body.startswith("- "), re.match(r"(\w+):\s*(.*)", body)
        while path and (path[-1][0] > indent or (path[-1][0] == indent and not item)):
            path.pop()
        name, found = ".".join(part for _, part in path), messages[-1][1]
        if item:
            found[f"{name}{sum(k.startswith(name) for k in found)}"] = body[2:].strip()
        elif key is not None and key[2].startswith("["):
            listed = key[2].strip("[]").split(",")
            found |= {f"{name}.{key[1]}{k}".lstrip("."): value.strip() for k, value in enumerate(listed)}
        elif key is not None and key[2]:
            found[f"{name}.{key[1]}".lstrip(".")] = key[2].strip("'\"").replace(",", " ")
        elif key is not None:
            path.append((indent, key[1]))
    rows = [(number or 1, _stamped(fields)) for number, fields in messages if fields]
    names = tuple(rows[0][1])
    whole = [(number, ",".join(fields.values())) for number, fields in rows if tuple(fields) == names]
    return [(1, ",".join(names)), *whole]


def _whole(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """The lines, with those within the quotes of a field as one; as they are where a quote is not closed."""
    found, held = list[tuple[int, str]](), list[tuple[int, str]]()
    for line in lines if any(line.count('"') % 2 for _, line in lines) else ():
        held.append(line)
        if sum(part.count('"') for _, part in held) % 2 == 0:
            found.append((held[0][0], " ".join(part.strip() for _, part in held)))
            held = []
        elif len(held) > LONGEST:
            break
    return found if found and not held else lines


LONGEST = 1000  # Lines of a field within quotes


def _pairs(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """A header and rows of lines `key: number, key: [number, number]` that have the same keys; else none."""
    rows, names = list[tuple[int, str]](), ""
    for number, line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        found = [(key, (one or several).replace(",", " ").split()) for key, one, several in re.findall(PAIR, line)]
        rest = re.sub(PAIR, "", line)
        if stamp := re.match(rf"\s*(?:\[({NUMBER})\]|({NUMBER}):)", rest):
            found, rest = [("t", [stamp[1] or stamp[2]]), *found], rest[stamp.end() :]
        each = [f"{k}_{j}" if len(v) > 1 else k for k, v in found for j in range(1, len(v) + 1)]
        told = "" if len(each) < 2 or re.search(r"[\d=]", rest) else ",".join(each)
        if told != names or not told:
            if len(rows) > 1 or number > LEADING:
                return []
            rows, names = [], told  # a title above it
        rows += [(number, ",".join(v for _, values in found for v in values))] * bool(told)
    return [(1, names), *rows] if rows else []


NUMBER = r"[-+]?(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?"  # possessive: a field of many digits takes no longer
SEVERAL = rf"{NUMBER}(?: +{NUMBER})*", rf"[\[(]\s*({NUMBER}(?:[\s,]+{NUMBER})*)\s*[\])]"
PAIR = rf"(?<!\w)([A-Za-z_]\w*)\s*[:=]\s*(?:({SEVERAL[0]})(?![\w.])|{SEVERAL[1]})"


def _blocks(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """A header and rows of lines `key: number`, in blocks that begin with the first key; else none."""
    pairs = [(i, *line.replace(" ", "").partition(":")[::2]) for i, line in lines if line.strip()]
    names = list(dict.fromkeys(key for _, key, _ in pairs))
    if len(pairs) < 2 * len(names) or not all(key.isidentifier() and is_number(value) for _, key, value in pairs):
        return []
    rows: list[tuple[int, dict[str, str]]] = []
    for number, key, value in pairs:
        same = dict(rows[-1][1]) if rows else {}
        if not rows or key in same:
            rows.append((number, {} if key == names[0] else dict(list(same.items())[: list(same).index(key)])))
        rows[-1][1][key] = value
    return [(1, ",".join(names)), *((number, ",".join(row.get(n, "") for n in names)) for number, row in rows)]


def _stamped(fields: dict[str, str]) -> dict[str, str]:
    out: dict[str, str] = {}
    for name, value in fields.items():
        stamp, _, part = name.rpartition(".")
        if part in ("nsecs", "nanosec") and stamp in out:
            out[stamp] += f".{int(value):09d}"
        else:
            out[stamp if part in ("secs", "sec") else name] = value
    return out


def parts_of(path: Path) -> list[Path]:
    """The files of a folder by name, or of FIRST+SECOND+..., the others in the folder, or bag, of the first; or one."""
    if path.is_dir():  # 9 before 10
        files = (p for p in path.iterdir() if p.is_file() and not p.name.startswith("."))
        return sorted(files, key=lambda p: [part.zfill(20) for part in re.split(r"(\d+)", p.name)]) or [path]
    first, *others = str(path).split("+")
    bag, topic = file_and_topic(first)
    if topic is not None:
        return [Path(first), *(Path(o if Path(o).exists() or ":" in o else f"{bag}:{o}") for o in others)]
    each = [Path(first), *(Path(name) if Path(name).exists() else Path(first).parent / name for name in others)]
    if path.exists() or not each[0].is_file():
        return [path]
    if missing := next((p for p in each if not p.exists()), None):
        raise DataError.at(missing, f"no such file, of {path}")
    return each


def with_word(lines: list[tuple[int, str]], word: str) -> list[tuple[int, str]]:
    """The numbered lines with a field `word`, or by COLUMN=WORD with that word in that column; of a table with topics
    as columns those of a topic; of lines that begin with `word:` what is behind it; "": all.
    """
    if not word:
        return lines
    keyed = [(i, line.strip()) for i, line in lines if line.strip().startswith(f"{word}:")]
    if keyed:
        return [(i, line[len(word) + 1 :]) for i, line in keyed]
    if not is_number(word) and (below := _of_topic(lines, word.strip("/"))):
        return below
    fields = [re.split(r"\s*[,;\t]\s*|\s+", line.strip()) for _, line in lines] if "=" in word else []
    name, _, value = word.partition("=")
    if name.isdecimal() and fields and name not in fields[0]:  # of columns without names, by its number
        return [pair for pair, row in zip(lines, fields, strict=True) if row[int(name) - 1 : int(name)] == [value]]
    if (top := next((k for k, row in enumerate(fields) if name in row), None)) is not None:
        j = fields[top].index(name)
        if some := [pair for pair, row in zip(lines, fields, strict=True) if row[j : j + 1] == [value]]:
            return [lines[top], *some]
    if name == "run" and value.isdecimal() and 0 < (k := int(value)) <= len(begun := [*begins(lines), len(lines)]) - 1:
        return [*lines[: begun[0]], *lines[begun[k - 1] : begun[k]]]
    rows = [re.split(r"[\s,;]+", line.strip()) for _, line in lines]
    number = is_number(word) and any(row[0] == word for row in rows)  # of the kind of a row, which stands first
    kept = [pair for pair, row in zip(lines, rows, strict=True) if word in (row[:1] if number else row)]
    head = [pair for pair in lines if pair[1].strip()][:1] if kept else []
    return [*(pair for pair in head if pair[0] < kept[0][0] and not re.search(r"\d", pair[1])), *kept]


def _of_topic(lines: list[tuple[int, str]], topic: str) -> list[tuple[int, str]]:
    """The columns of a topic, without its name, and stamps, of rows that have some; none without such columns."""
    filled = [(i, line) for i, line in lines if line.strip()]
    separator = next((s for s in ",;\t" if filled and s in filled[0][1]), ",")
    rows = [[f.strip() for f in row] for row in csv.reader((line for _, line in filled), delimiter=separator)]
    names = [name.strip("/") for name in rows[0]] if 0 < len(rows) == len(filled) else []
    stamps = [j for j, name in enumerate(names) if name.strip("_%# ").lower() in STAMP]
    below = [j for j, name in enumerate(names) if name.startswith((f"{topic}/", f"{topic}."))]
    if not below:
        return []
    below = [j for j in below if not (stamps and "stamp" in names[j])]
    rows[0] = [names[j][len(topic) + 1 :] if j in below else name for j, name in enumerate(rows[0])]
    return [
        (i, separator.join(row[j].replace(separator, " ") for j in (*stamps, *below) if j < len(row)))
        for (i, _), row in zip(filled, rows, strict=True) if any(j < len(row) and row[j] for j in below)
    ]  # fmt: skip


def kinds_of(path: Path, rows: Sequence[Sequence[str]]) -> str:
    """What to type where rows hold one of few words each, as the names of sources: of one kind; else nothing."""
    for column in islice(zip_longest(*rows, fillvalue=""), LEADING):
        kinds = Counter(column)
        some = [kind for kind in kinds if kind and kinds[kind] > 1]
        whole = sum(kinds[kind] for kind in some) >= len(rows) - 1  # but for a header
        if whole and not any(map(is_number, some)) and 1 < len(some) < len(rows) / 2:
            listed = ", ".join(f"{kind} ({kinds[kind]})" for kind in some)
            return f"; rows hold {listed[:200]}: name those of one kind, as in {path}:{some[0].rstrip(':')}"
    return ""


def cut_end(rows: Sequence[Sequence[str]], line: int) -> str:
    """What is said of the last of rows, on a line, that is left out: it has too few fields, or ends within a number.
    Empty where it is whole, or where others differ in length, too.
    """
    *others, last = rows
    if len(others) < LEAST or len({len(row) for row in others[1:]}) > 1 or len(last) > len(others[-1]) or not last:
        return ""
    broken = any(f and not is_number(f) and all(is_number(row[j]) for row in others[1:]) for j, f in enumerate(last))
    said = f"line {line}, the last one, is cut off and left out: {','.join(last)[:60]!r}"
    return said if broken or len(last) != len(others[-1]) else ""


LEAST = 3  # rows before the last one


def blocks_of(rows: Sequence[Sequence[str]]) -> list[str]:
    """Number of each row's block, "" of heads: this number, one more than before, and how many rows follow; or none."""
    block = list[str]()
    while (k := len(block)) < len(rows) and len(rows[k]) == 2 and all(map(str.isdecimal, rows[k])):
        block += ["", *[rows[k][0]] * min(int(rows[k][1]), len(rows))]
    heads = [int(row[0]) for row, of in zip(rows, block, strict=False) if not of]
    below = [(row, of) for row, of in zip(rows, block, strict=False) if of]
    own = any(row[0] != of for row, of in below)  # else a row for each observation, behind its frame
    whole = len(block) == len(rows) and heads == list(range(heads[0], heads[0] + max(2, len(heads))))
    return block if whole and own and len({len(row) for row, _ in below}) == 1 else []


def begins(lines: Sequence[tuple[int, str]]) -> list[int]:
    """Where runs begin: at the first row of numbers, and where the first column that else ascends goes back by half of
    its way; without one where the first row comes again, else below blank lines and comments.
    """
    split = [re.split(r"[\s,;]+", line.strip(" \t,;")) for _, line in lines]
    at = [k for k, row in enumerate(split) if 2 * sum(map(is_number, row)) > len(row)]
    rows = [split[k] for k in at]
    again = [k for k in range(1, len(rows)) if rows[k] == rows[0] != rows[k - 1]]
    starts = [0, *(again or [k for k in range(1, len(at)) if lines[at[k]][0] > lines[at[k - 1]][0] + 1])]
    for column in reversed([*zip(*rows, strict=False)]):
        v = np.array([float(f) if is_number(f) else np.nan for f in column])
        back = [0, *(np.flatnonzero(np.diff(v) < 0.0) + 1)]
        if len(back) > 1 and 2 * np.sum(np.diff(v) > 0.0) > len(v):
            starts = back if all(v[k] < 0.5 * (v[first] + v[k - 1]) for first, k in pairwise(back)) else starts
    return [at[k] for k in starts] if np.diff([*starts, len(rows)]).min() >= SHORTEST else at[:1]


SHORTEST = 5  # Rows of a run, more than of a matrix


def whole_names(names: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Names of a header; where some are repeated, each with that of the last blank column before it, which stands for
    the message that it is of: `position,x,y,orientation,x`.
    """
    if len(set(names)) == len(names):
        return tuple(names)
    of, out = "", []
    for j, name in enumerate(names):
        blank = all(j < len(row) and not row[j] for row in rows)
        of = name if blank else of
        out.append(name if blank or not of else f"{of}.{name}")
    return tuple(out)
