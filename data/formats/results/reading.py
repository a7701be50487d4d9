"""Read a result in any format, recognized by content; a header that names columns decides first."""

import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain, pairwise, product
from pathlib import Path

import numpy as np
import scipy

from data.columns.named import COVARIANCE, LENGTH, STAMP, YAW
from data.csv_table import is_number, symmetric
from data.dates import EXAMPLE, IN_SECONDS, is_date, seconds_of, unit_of
from data.earth import on_plane, placed
from data.errors import DataError, UsageError, did_you_mean
from data.formats.messages import kinds_of, runs_of
from data.formats.recordings.ros import file_and_topic, is_bag
from data.formats.results import lines, path as paths
from data.formats.results.bags import is_table, read_bag
from data.formats.results.lines import BLOCKS, ENTRIES, ENTRIES_6, EUROC, POSE, TRIANGLE, UNSTAMPED
from data.formats.results.path import ABSENT, DATES, DIGITS, LOCAL, MIXED, ROWS, WORLD, GivenPath, Manner, Stated
from data.formats.results.space import NO_POSE, UNIT, full, known_only, require_covariances
from data.formats.text import Text, is_row, read_text, split
from data.formats.wrapped import file_and_word
from data.questions.examination import in_degrees
from data.se2 import Array, wrap_angle
from data.terminal import counted

# Headers of trajectories that name their columns: in the first line, or in a comment above the data.
# A header is obeyed: order of position and quaternion, units in brackets or at the end of a name, covariances. What it
# names and is not read is stated; a header without stamp, position or orientation is refused.

STAMPS = frozenset((*STAMP, "sec", "secs", "second", "seconds", "tow"))
WORDS = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))
PLACE, TURN, AROUND, SIDES, TRUE, REFERENCE, ESTIMATED, NANOSECONDS, GNSS = (
    frozenset[str](WORDS[kind].split())
    for kind in ("place", "turn", "around", "sides", "true", "reference", "estimated", "nanoseconds", "gnss")
)
EARTH: dict[str, str] = {word: role for role, words in WORDS["earth"].items() for word in words.split()}
ALIAS: dict[str, str] = {word: unit for unit, words in WORDS["units"].items() for word in words.split()}
TRUER: list[str] = WORDS["truer"]
OTHERS = [*WORDS["others"], *TRUER]
ANGLES = {"roll": "roll", "pitch": "pitch", **dict.fromkeys(YAW, "yaw")}
TURNS = {"rad": 1.0, "deg": np.pi / 180.0}
AXES = PLACE | TURN | {*"xyzw", *ANGLES}  # Words of the columns of one path, beside which its name stands
AXIS, PAIRED = "|".join(("x", "y", "z", *YAW)), "|".join(("x", "y", "t", *YAW))
SPREAD = "(cov|covariance|var|variance|std|stddev|stdev|sd|sigma)"
SPREADS = r"(?<![A-Za-z])(?i:cov|var(?!io)|sigma|std)|Cov|Var|Sigma|Std"  # begin a word that may name one
GLUED = r"(?<![a-z])([xyz]|th|theta|yaw)(odom?|gt|est|true|hat|ekf)(?![a-z])"  # xodo, thgt
KNOWN_UNITS = {*DIGITS, *LENGTH, *TURNS}
GROUPS = {"p": ("x", "y", "z"), "q": ("qx", "qy", "qz", "qw"), "v": ("vx", "vy", "vz")}
"""Names of several columns each, as in `# timestamp(s) q p v bg ba` of OpenVINS' states."""
SHOWN = 6  # Most names in a note
WELL_KNOWN: dict[tuple[str, ...], str] = {POSE: "TUM", EUROC: "EuRoC CSV", (*POSE, *BLOCKS): "OpenVINS"}
WELL_KNOWN |= {(*POSE, *entries): "TUM with covariance" for entries in (TRIANGLE, ENTRIES_6)}
MESSAGE, UPPER = tuple(f"f{k}" for k in range(36)), tuple(f"c{c[2]}{c[1]}" for c in TRIANGLE)
PLANE = ("t", "x", "y", "theta")  # Columns of our own files, with `COVARIANCE`
NANOSECONDS_FROM = 1e14  # Smallest stamp that is taken for ns: a day of them, or three million years of seconds


@dataclass(frozen=True)
class Columns:
    """Place and unit of each column by its role, names that are not read, and line of the header."""

    place: dict[str, int]
    unit: dict[str, str]
    unread: tuple[str, ...]
    named: int
    line: int
    in_data: bool
    told: str = ""  # what is inferred, as a flag
    spread: tuple[str, ...] = ()  # names of columns of planar covariances, variances and sigmas

    @property
    def order(self) -> tuple[str, ...]:
        """The roles from left to right."""
        return tuple(sorted(self.place, key=lambda role: self.place[role]))


def header_names(text: Text, manner: Manner) -> Columns | None:
    """The columns that a file or the user names; None without. A comment is a header if it names a column of each
    field, or mostly columns. DataError if it contradicts the data.
    """
    first = text.fields[0]
    if not is_row(first):
        return _columns(text, first, text.line[0], manner, in_data=True)
    width, separators = len(first), (text.separator or ",", *((",", ";") if text.commas else (" ", ",")))
    for line, comment in reversed([c for c in text.comments if c[0] < text.line[0] and not c[1].startswith("#%")]):
        for separator in separators:
            bare = comment.lstrip("#% ")  # `tx [m]` is one name
            (names,) = split([re.sub(r"\s+(?=[\[(])", "", bare) if separator == " " else bare], separator)
            names = names[names[0].endswith(":") :] if names else names  # "Format: timestamp tx"
            if len(names) < 3 or any(set(n) <= {"."} for n in names):
                continue
            if {"p", "q"} <= set(names):  # groups of both position and orientation
                cut = next((i for i, n in enumerate(names[1:], 1) if n not in GROUPS), len(names))
                names = tuple(part for n in names[:cut] for part in GROUPS.get(n, (n,)))
            found = _columns(text, names, line, manner, in_data=False)
            roles = len(found.place)
            if not {"x", "lat", "qx", "qw"} & set(found.place):
                continue
            if (found.named == width and roles >= 3) or (roles >= 4 and roles >= 0.6 * found.named):
                if found.named > width:
                    what = f"the header names {counted(found.named, 'column')}, the lines have {width}"
                    raise DataError.at(text.path, f"{what}; a name each is needed", line=line)
                return found
    numbered = tuple(str(k + 1) for k in range(width))
    return _columns(text, numbered, text.line[0], manner, in_data=False) if manner.columns else None


def _columns(text: Text, names: tuple[str, ...], line: int, manner: Manner, *, in_data: bool) -> Columns:
    """The column of each role: the stated one, else by its name; of an estimate and a truth in one row those of one."""
    entry, sides = _by_number(names), _sided(names) if manner.rows else names
    each = (entry.get(name, side) for name, side in zip(names, sides, strict=True))
    read, place, earth = [*map(cache(role_of), each)], {}, {"lat", "lon"}  # most names of a wide row are blank
    if {*"wxyz"} <= {*names} and [role for role, _ in read].count("x") == 2:  # beside pos_x a quaternion
        read = [(f"q{name}", "") if name in tuple("wxyz") else its for name, its in zip(names, read, strict=True)]
    for role, name in manner.columns.items():
        number = int(name) - 1 if name.isdecimal() else -1
        if name not in names and not 0 <= number < len(names):
            what = f"no column {name!r}{did_you_mean(name, names)}; it has {', '.join(names)[:200]}"
            raise DataError.at(text.path, what, line=line or None)
        place[role] = names.index(name) if name in names else number
    several = topics_in(names)
    topic = topic_of(names[place["x"]]) if "x" in place else several[0] if len(several) == 1 else ""
    if topic and (len(several) > 1 or topic.startswith("/")):
        read = _roles(names, topic)
    found: dict[str, list[int]] = {}
    there = {role for role, _ in read} | {*place}
    earthly = earth <= there and (earth <= {*place} or not {"x", "y"} <= there)
    read = [("", "") if its[0] in (("x", "y", "z") if earthly else EARTH) else its for its in read]
    for j, (role, _) in enumerate(read):
        if role and role not in place and role not in manner.fixed and j not in place.values():
            found.setdefault(role, []).append(j)
    of_name = {name: set(words_of(name)[0]) for name in {*sides}}
    words = [of_name[name] for name in sides]
    truly = TRUE | REFERENCE if any(each & ESTIMATED for each in words) else TRUE
    true = [bool(truly & each) for each in words]
    both = any(len({true[j] for j in some}) > 1 for role, some in found.items() if role != "t")
    unlike = [topic for topic in several if topic.startswith("/") and "x" not in place]
    if len(unlike) > max(1, len(found.get("x", ()))):
        what = f"topics {', '.join(unlike)}: type which, of estimate and truth, as in {text.path}:{unlike[0]}"
        raise DataError.at(text.path, what, line=line or None)
    if moved := [name for name in names if name.endswith("_next") or name in ("from_index", "to_index")]:
        what = f"rows are motions from one instant to the next ({moved[0]}), no poses; compose them to poses"
        raise DataError.at(text.path, what, line=line or None)
    spread = {role: found.pop(role) for role in [*found] if role.startswith(("c_", "s_"))}
    unclear: dict[str, list[int]] = {}
    for role, some in found.items():
        if both and (role not in ("t", "nanoseconds") or len(some) > 1):
            some = [j for j in some if true[j] == manner.true]
        if role == "t":  # not the time of recording, nor one without the digits that tell rows apart
            some = [j for j in some if len({f[j] for f in text.fields[1:] if j < len(f)}) > 1] or some
            some = [j for j in some if "stamp" in names[j].lower()][-1:] or some[:1]
        if role != "t" and manner.rows and "x" in manner.columns:  # nor of another path of the table
            own = [{*words_of(name)[0]} - AXES for name in names]
            some = [j for j in some if not own[j] or own[j] == own[place["x"]]]
        if role == "z" and manner.true and manner.rows and "x" in manner.columns:  # not of the estimate beside it
            some = [j for j in some if names[j].lower() == "z".join(names[place["x"]].lower().rsplit("x", 1))]
        unclear |= {role: some} if len(some) > 1 else {}
        place |= dict.fromkeys([role] * (len(some) == 1), *some[:1])
    if unclear:
        role, some = next(iter(unclear.items()))
        what = f"{names[some[0]]!r} and {names[some[1]]!r} both name {role}; one of them is needed"
        of = (("truth.", 0), ("estimate.", -1)) if manner.rows and not both else (("truth." * manner.true, 0),)
        typed = ",".join(f"{who}{r}={s[k] + 1}" for who, k in of for r, s in unclear.items())
        raise DataError.at(text.path, f"{what}, as in --columns {typed.replace('yaw', 'theta')}", line=line or None)
    beside_of = {name: some & SIDES for name, some in of_name.items()}
    side, k = [beside_of[name] for name in sides], place.get("x", place.get("lat", -1))
    beside = [j for j, (role, _) in enumerate(read) if role == "x" and j != k]
    if not manner.true:  # odometry has none of its own
        beside = [j for j in beside if side[k] and not true[j] and side[j] != {"odom"}]
    for role, some in spread.items():  # a covariance has the words of its path, or none: of the only estimate
        some = [j for j in some if (side[j] == side[k] if side[j] else not beside)]
        place |= dict.fromkeys([role] * (len(some) == 1), *some[:1])
    stated = {role: words_of(names[j])[1] if role in manner.columns else read[j][1] for role, j in place.items()}
    flags = {*([] if manner.angles is None else TURNS), *([] if manner.stamps is None else (*DIGITS, "min", "h"))}
    unit = {role: its for role, its in stated.items() if its and role[-1] not in manner.lengths and its not in flags}
    unread = tuple(name for j, name in enumerate(names) if name and j not in place.values())
    if "nanoseconds" in place and "t" not in place:
        place["t"], unit["t"] = place.pop("nanoseconds"), "ns"
    covariances = (*(names[place[role]] for role in spread if role in place),)
    told = f"{'truth' if manner.true else 'estimate'}.{'x' if 'x' in place else 'lat'}={names[k]}"
    return Columns(place, unit, unread, len(names), line, in_data, told * (manner.rows and both), covariances)


def _sided(names: Sequence[str]) -> list[str]:
    """Names of a table of two paths, with `gt` for words that tell the truer one, and `est` for other such words."""
    apart, found = [re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[a-z]) ", "_", name) for name in names], list[str]()
    for known, true in product((1, 2, len(OTHERS)), TRUER):  # words that nobody needs are not known
        rest = WORD.format("|".join({*" ".join(OTHERS[:known]).split()}.difference(true.split())))
        found = [re.sub(WORD.format(true.replace(" ", "|")), "gt", re.sub(rest, "est", name)) for name in apart]
        if len({"gt" in words_of(name)[0] for name in found if role_of(name)[0] in ("x", "lat")}) > 1:
            break
    return found


WORD = "(?i)(?<![a-z])({})(?![a-z])"


def _by_number(names: Sequence[str]) -> dict[str, str]:
    """Names c_xx to c_tt of entries P00, P_0_1 or P[1][1] of a covariance, or of variances P_0 to P_2."""
    digits = {n: re.findall(r"\d", n) for n in names if re.fullmatch(r"P_?\[?\d[\]\[_,]*\d\]?|P_\d", n)}
    pair = {n: (int(d[0]), int(d[-1])) for n, d in digits.items()}
    low, high = min(map(min, pair.values()), default=2), max(map(max, pair.values()), default=2)
    axes = "xyt" if high - low < 3 else "xy" * all(len(d) == 2 for d in digits.values())
    usable = low < 2 and {(low, low), (low + 1, low + 1)} <= {*pair.values()}
    return {n: f"c_{axes[i - low]}{axes[j - low]}" for n, (i, j) in pair.items() if usable and i <= j < low + len(axes)}


def topic_of(name: str) -> str:
    """The topic of the x of a position, as /odom of /odom/pose/pose/position/x; empty for any other name."""
    found = re.fullmatch(r"(.+?)(?:[/.](?:pose|transform|position|translation|point))*[/.]x", name)
    vector = r"(?i)linear|angular|(orientation|rotation|scale|acceleration|velocity|vel|field|magnetic)$"
    return found[1] if found is not None and not re.search(vector, found[1]) else ""


def topics_in(names: Sequence[str]) -> list[str]:
    """The topics with positions of a table with topics as columns."""
    return list(dict.fromkeys(topic for name in dict.fromkeys(names) if (topic := topic_of(name))))


def _roles(names: Sequence[str], topic: str) -> list[tuple[str, str]]:
    """Roles and units of the columns of a topic, and of the stamps of the table, else of the topic."""
    found = [role_of(n[len(topic) + 1 :]) if n.startswith((f"{topic}/", f"{topic}.")) else ("", "") for n in names]
    bare = {j: role_of(n) for j, n in enumerate(names) if n.startswith("header") or not re.search(r"[/.]", n)}
    table = {j: r for j, r in bare.items() if r[0] in ("t", "nanoseconds")}
    return [table.get(j, ("", "") if table and r[0] in ("t", "nanoseconds") else r) for j, r in enumerate(found)]


def role_of(name: str) -> tuple[str, str]:
    """Role of a column by its name, and its unit; empty where unknown."""
    bare = name.strip().strip("\"'").lstrip("#%").strip()
    if "twist" in bare.lower():  # a velocity, which has a covariance of its own
        return "", ""
    if found := re.fullmatch(r"([cC]ov(?:ariance)?|.*\.covariance|.*_covariance)[\[_.]?(\d+)\]?", bare):
        return f"f{int(found[2])}", ""
    if re.fullmatch(r"P[rt][1-3][1-3]", bare):
        return bare, ""
    words, unit = words_of(bare)
    if words and words[-1] in NANOSECONDS and set(words[:-1]) - AROUND <= STAMPS:
        return "nanoseconds", ""
    if len(words) > 1 and words[-1] in ("s", "ms", "us", "ns") and words[-2] in STAMPS:
        unit = unit or words.pop()
    if not words:
        return "", ""
    if len(words) == 1 and (own := ALIAS.get(words[0], words[0])) in ("ms", "us"):
        return "t", own
    if len(words) > 1 and words[-1] in SIDES:  # x_est
        words = [words[-1], *words[:-1]]
    last, rest = words[-1], words[:-1]
    around = set(rest) - AROUND
    if last in STAMPS and around <= STAMPS | {"gps"}:
        return "t", unit
    if last in ANGLES and around <= TURN | {"euler", "angle"}:
        return ANGLES[last], unit
    core = "".join(w for w in words if w not in AROUND)
    if found := re.fullmatch(rf"(?:c|p|cov)({PAIRED})({PAIRED})", core):
        pair = [c if c in "xy" else "t" for c in found.groups()]
        return f"c_{''.join(sorted(pair, key='xyt'.index))}", unit
    if found := re.fullmatch(rf"{SPREAD}(?:pos|position)?({AXIS})|({AXIS}){SPREAD}", core):
        axis = (found[2] or found[3]) if (found[2] or found[3]) in "xyz" else "t"
        return (f"s_{axis}" if (found[1] or found[4])[0] == "s" else f"c_{axis}{axis}"), unit
    if found := re.fullmatch(r"(?:c|p|cov)([1-6])([1-6])", "".join(words)):
        return f"c{found[1]}{found[2]}", ""
    if last in EARTH and around <= GNSS | PLACE:
        return EARTH[last], unit
    if last in tuple("wxyz") and around & TURN and around <= TURN | PLACE:
        return f"q{last}", ""
    if (found := re.fullmatch(r"(?:q|quat)([wxyz])", last)) and around <= TURN:
        return f"q{found[1]}", ""
    if last in tuple("xyz") and around <= PLACE:
        return last, unit
    if (found := re.fullmatch(r"(?:t|p|pos)([xyz])", last)) and not around:
        return found[1], unit
    return "", ""


RATES = {"kmh": "km/h", "kph": "km/h", "mph": "mi/h", "kn": "nmi/h", "mps": "m/s", "rpm": "rev/min", "dps": "deg/s"}


def words_of(name: str) -> tuple[list[str], str]:
    """The words of a column's name in small letters, without its unit, in brackets or last, and that unit."""
    unit = ""
    if found := re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*)\s*[\])]\W*", name):
        name, unit = found[1], _unit(found[2]) or found[2].strip()
    parted = re.sub(GLUED, r"\1_\2", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
    words = [w for w in re.split(r"[^a-z0-9µ°]+", parted) if w]
    if len(words) > 1 and words[-1] not in STAMPS | set("xyzwt") and (_unit(words[-1]) or words[-1] in RATES):
        words, unit = words[:-1], unit or _unit(words[-1]) or words[-1]
    return words, unit


def _unit(word: str) -> str:
    low = word.strip().lower()
    low = ALIAS.get(low, low)
    return low if low in KNOWN_UNITS else ""


def read_named(text: Text, manner: Manner, columns: Columns) -> GivenPath:
    """The trajectory of named columns, in space if there is a z or more than a heading, else in the plane."""
    place, ours = columns.place, text.commas and set(PLANE[1:]) <= {f.strip('"') for f in text.fields[0]}
    body = replace(text, fields=text.fields[1:], line=text.line[1:]) if columns.in_data else text
    if not body.fields:
        raise DataError.at(text.path, "a header and no pose; at least one is needed")
    if ours:
        _require_ours(text, columns, manner)
    quaternion = [q for q in POSE[4:] if q in place]
    if flat := quaternion == ["qz", "qw"]:
        quaternion, columns = [], replace(columns, unit=columns.unit | {"yaw": "rad"})
    for role in (*(("lat", "lon") if "lat" in place else ("x", "y")), *(POSE[4:] if quaternion else ())):
        if role not in place and role not in manner.fixed:
            what = f"no column {role} is named: {', '.join(columns.order) or 'none'} are known"
            ends = [name for name in columns.unread if words_of(name)[0][-1:] == [role]][:SHOWN]
            what += f"; {', '.join(ends)} may be {role}" if ends else f"; it has {', '.join(columns.unread)[:120]}"
            what += f"; type --columns {'truth.' * manner.true}{role}={(ends or ['NAME'])[0]}"
            what += f", or {role}=0 of a straight way" * (role in ("x", "y") and not ends and len(place) > 1)
            raise DataError.at(text.path, what, line=columns.line or None)
    dated = _in_seconds(body, place["t"]) if "t" in place else body
    value = {"t": np.arange(len(body.fields), dtype=float)} | _values(dated, columns)
    value |= {role: np.full(len(body.fields), of) for role, of in manner.fixed.items()}
    behind = place.keys() & {"yaw", "qw"} == set() and place.get("t") == place.get("y", 0) + 1  # x, y, t
    if behind and (np.diff(value["t"]) < 0.0).any() and not manner.columns.keys() & {"t"}:
        told = f"{'truth.' * manner.true}theta={place['t'] + 1}"
        others = {role: j for role, j in place.items() if role != "t"} | {"yaw": place["t"]}
        return read_named(text, manner, replace(columns, place=others, told=told))
    if flat:
        value["yaw"] = 2.0 * np.arctan2(value.pop("qz"), value.pop("qw"))
    absent = not quaternion and "yaw" not in value
    asked = absent and not manner.columns.keys() & {"x", "lat"}
    if asked and (turned := [n for n in columns.unread if re.search(r"(?i)q\d|quat|rot|orient", n)]):
        what = f"no orientation is named ({', '.join(turned)} are unknown); qx, qy, qz, qw or yaw is needed"
        raise DataError.at(text.path, what, line=columns.line or None)
    if absent:
        value["yaw"] = np.zeros(len(body.fields))
    turn = 1.0 if manner.angles is None else manner.angles
    units = {"t": (dict.fromkeys(DIGITS, 1.0), 1.0), **dict.fromkeys(("x", "y", "z", "alt"), (LENGTH, 1.0))}
    units |= dict.fromkeys(("lat", "lon"), (TURNS, TURNS["deg"] if manner.angles is None else abs(turn)))
    units |= {"roll": (TURNS, abs(turn)), "pitch": (TURNS, abs(turn)), "yaw": (TURNS, turn)}
    for role, (known, usual) in units.items():
        if role in value:
            if (unit := columns.unit.get(role)) not in (None, *known):
                what = f"unit {unit!r} of {role}; one of {', '.join(known)} is needed"
                raise DataError.at(text.path, what, line=columns.line or None)
            value[role] = value[role] * (usual if unit is None else known[unit])
    if "yaw" in value:
        value["yaw"] = value["yaw"] * (np.sign(turn) if flat else 1.0) + 0.5 * np.pi * manner.compass
        manner = replace(manner, angles=TURNS[columns.unit["yaw"]]) if "yaw" in columns.unit else manner
    if "nanoseconds" in value:
        whole = bool((value["t"] % 1.0 == 0.0).all())  # else they are those of another clock
        value["t"] = value["t"] + 1e-9 * whole * value["nanoseconds"]
    unread = [*columns.unread[:SHOWN], *(["..."] if len(columns.unread) > SHOWN else [])]
    notes: tuple[str, ...] = (f"columns not read: {', '.join(unread)}",) if unread and not ours else ()
    value, said = _variances(value, columns)
    notes += (said,) * bool(said and not manner.true)
    if dated is not body:
        notes += (f"inferred: stamps are dates, {IN_SECONDS}; --columns t=NAME names others",)
    notes += (f"inferred: --columns {columns.told}",) * bool(columns.told)
    datum: tuple[float, ...] = ()
    axes = [q for q in (("lat", "lon") if "lat" in value else POSE[1:4]) if q in value]
    at, none = placed(np.column_stack([value[q] for q in axes]), "truth" * manner.true)
    value, notes = value | dict(zip(axes, at.T, strict=True)), notes + none
    if "lat" in value:  # in rad by now
        high = value.get("alt", np.full(len(body.fields), np.nan))
        each = np.column_stack([np.degrees(value["lat"]), np.degrees(value["lon"]), high])
        metres, datum, said = on_plane(text.path, each, manner.datum)
        value |= dict(zip("xyz" if "alt" in value else "xy", metres.T, strict=False))
        notes, manner = (*notes, *[said] * bool(said)), replace(manner, lengths={"z": manner.scale[2]})
    unit_of_time = DATES if dated is not body else "s" if "nanoseconds" in value else columns.unit.get("t")
    body = dated
    if manner.rows and not (np.diff(value["t"]) > 0.0).all() and np.isfinite([value["x"], value["y"]]).all():
        notes += ("stamps do not ascend, so its rows are compared one by one, without stamps",)
        value["t"], place = np.arange(len(body.fields), dtype=float), {r: j for r, j in place.items() if r != "t"}
        columns = replace(columns, place=place)
    _require_one(body, text.fields[0] if columns.in_data else (), value)
    flat = "lat" in value and "z" not in value  # angles in space beside latitudes without a height
    if quaternion or "z" in value or (not flat and ("roll" in place or "pitch" in place)):
        found = replace(_spatial(body, columns, value, manner, notes, unit_of_time), datum=datum)
        return paths.without_headings(found) if absent else found
    kind = f"columns {', '.join(columns.order)}"
    if ours:
        kind = "CSV of t, x, y, theta" + " and covariance" * (COVARIANCE[0] in place)
        bare = np.flatnonzero(~np.isfinite(value["t"]))
        if len(bare):
            raise DataError.at(text.path, "no stamp; a number is needed", line=body.line[bare[0]], column="t")
    found = _planar(body, kind, value, manner, notes, unit=unit_of_time, column=place.get("t", UNSTAMPED), ours=ours)
    found = replace(found, datum=datum)
    return paths.without_headings(found, flat="z" not in {*manner.columns, *manner.fixed}) if absent else found


def _require_one(body: Text, names: Sequence[str], value: dict[str, Array]) -> None:
    """Raise DataError where a column tells two paths apart whose rows alternate, as at equal stamps."""
    place = np.nan_to_num(value["x"] + 1j * value["y"])
    step = np.abs(np.diff(place))
    same = (np.diff(value["t"]) == 0.0) & (step > 0.0)
    for name, *column in zip(names, *(fields[: len(names)] for fields in body.fields), strict=False):
        kinds, of = Counter(column), np.array(column)
        if not 1 < len(kinds) <= min(PATHS, len(of) // PATHS):
            continue
        turns, own = of[1:] != of[:-1], np.concatenate([np.abs(np.diff(place[of == kind])) for kind in kinds])
        far = turns.mean() > OFTEN and np.median(step[turns]) > FAR * np.median(own)
        if far or (same.any() and turns[same].all()):
            listed = ", ".join(f"{kind} ({many})" for kind, many in kinds.items())
            what = f"rows are of {name} {listed}: name one, as in {body.path}:{name}={column[0]}"
            raise DataError.at(body.path, what)


PATHS, OFTEN, FAR = 10, 0.1, 5.0
"""Most paths in a file, and rows of each; least share of rows that change to another, and ratio of their steps."""


def _variances(value: dict[str, Array], columns: Columns) -> tuple[dict[str, Array], str]:
    """The values with covariances by columns of variances or sigmas, in m and the unit of headings; and a note."""
    whole, mixed = set(COVARIANCE) <= {*value}, {"c_xy", "c_xt", "c_yt"} & {*value}
    if whole:
        of = f"inferred: its covariance of x, y and heading is {', '.join(columns.spread)}"
        return value, of * bool(_by_number(columns.spread))
    if mixed or not {"c_xx", "s_x"} & {*value}:
        lost = [n for n in (*columns.spread, *columns.unread) if re.search(SPREADS, n)]
        said = f"no covariance is read of {', '.join(lost[:SHOWN])}: c_xx to c_tt, or sigma_x, sigma_y, are known"
        return value, said * bool(lost)
    made = dict.fromkeys(COVARIANCE, np.zeros(len(value["t"])))
    for axis, role in zip("xyzt", ("x", "y", "z", "yaw"), strict=True):
        given = c if (c := f"c_{axis}{axis}") in value else f"s_{axis}"
        known, usual = (TURNS, columns.unit.get(role, "rad")) if axis == "t" else (LENGTH, columns.unit.get(role, "m"))
        scale = known.get(columns.unit.get(given, usual).rstrip("^²2"), np.nan) / (known[usual] if axis == "t" else 1.0)
        made[c] = scale**2 * value.get(given, np.nan * value["t"]) ** (1 if given == c else 2)
    return value | made, f"inferred: its covariances are of {', '.join(columns.spread)}, without correlation"


def _in_seconds(body: Text, column: int) -> Text:
    """The text with seconds in a column of dates; the same without dates."""
    dates = [fields[column] for fields in body.fields if column < len(fields) and is_date(fields[column])]
    if not dates:
        return body
    made, unit = [], unit_of(body.path, dates, f"Dates as in {EXAMPLE} are")
    for line, f in zip(body.line, body.fields, strict=True):
        try:
            made.append((*f[:column], repr(seconds_of(f[column], unit)) if f[column] else "", *f[column + 1 :]))
        except ValueError:
            raise DataError.at(body.path, f"{f[column]!r} is no date as in {EXAMPLE}", line=line, column="t") from None
    return replace(body, fields=tuple(made))


def _require_ours(text: Text, columns: Columns, manner: Manner) -> None:
    """Raise DataError for what a file of ours cannot be: without stamps, or with a part of the covariance."""
    if manner.frame not in (None, WORLD):
        raise DataError.at(text.path, f"its covariances are {WORLD} ones; remove --cov-frame {manner.frame}")
    there = [c for c in COVARIANCE if c in columns.place]
    alone = {"c_xx", "c_yy"} <= {*there} <= {"c_xx", "c_yy", "c_tt"}
    if there and len(there) < len(COVARIANCE) and not alone:
        lacking = next(c for c in COVARIANCE if c not in there)
        what = f"no such column, but {there[0]}; all six or none are needed"
        raise DataError.at(text.path, what, line=1, column=lacking)


def _values(body: Text, columns: Columns) -> dict[str, Array]:
    """Numbers of the columns that are read, by role, and of a triangle behind all; other columns may hold anything."""
    wide = not columns.in_data and len(body.fields[0]) == columns.named + len(TRIANGLE)
    place = columns.place | {c: columns.named + k for k, c in enumerate(TRIANGLE) if wide}
    for line, fields in zip(body.line, body.fields, strict=True):
        if len(fields) < columns.named:
            raise DataError.at(body.path, f"{len(fields)} fields where the header names {columns.named}", line=line)
    chosen = [tuple(f[j] for j in place.values()) for f in body.fields]
    found = lines.numbers(replace(body, fields=tuple(chosen)), tuple(place), blank=True, huge=("t",))
    return dict(zip(place, found.T, strict=True))


def _spatial(
    body: Text, columns: Columns, value: dict[str, Array], manner: Manner, notes: tuple[str, ...], unit: str | None
) -> GivenPath:
    zero = np.zeros(len(body.fields))
    if "qw" in value:
        q = np.column_stack([value[name] for name in POSE[4:]])
        length = np.linalg.norm(q, axis=1)
        if columns.line and (odd := (np.abs(length - 1.0) > UNIT) & (length > 0.0)).any():
            q[odd] /= length[odd, None]
            notes += (f"inferred: {odd.sum()} of {len(q)} quaternions are not of length 1 and scaled",)
    else:
        angles = np.column_stack([value["yaw"], value.get("pitch", zero), value.get("roll", zero)])
        lost = ~np.isfinite(angles).all(axis=1, keepdims=True)
        turns = scipy.spatial.transform.Rotation.from_euler("ZYX", np.where(lost, 0.0, angles))
        q = np.where(lost, np.nan, turns.as_quat())
    pose = np.column_stack([value["t"], value["x"], value["y"], value.get("z", zero), q])
    C: Array | None = None
    frame, stated = LOCAL, Stated()
    known = next((names for names in (BLOCKS, MESSAGE, ENTRIES_6, TRIANGLE, UPPER) if {*names} <= {*value}), ())
    entries = np.column_stack([value[name] for name in known or POSE[1:3]])
    if known == BLOCKS:
        C, frame, stated = np.zeros((len(pose), 6, 6)), MIXED, Stated(convention=True, order=True)
        C[:, 3:, 3:], C[:, :3, :3] = symmetric(entries[:, :6]), symmetric(entries[:, 6:])
    elif known in (MESSAGE, ENTRIES_6):
        C, more = full(entries, body.place)
        frame, stated = (WORLD, Stated(order=True)) if known == MESSAGE else (frame, stated)
        notes += more
    elif known:
        C = symmetric(entries, lower=True)
    elif set(COVARIANCE) <= {*value}:
        C, frame, stated = np.full((len(pose), 6, 6), np.nan), WORLD, Stated(order=True)
        turn = (manner.angles or 1.0) if "qw" not in value else 1.0
        entries = np.column_stack([value[c] * turn ** c.count("t") for c in COVARIANCE])
        C[:, [[0], [1], [5]], [0, 1, 5]] = symmetric(entries)
        C[:, 2, 2] = value.get("c_zz", C[:, 2, 2])
    kind = WELL_KNOWN.get(columns.order, WELL_KNOWN.get(columns.order[:8], f"columns {', '.join(columns.order[:8])}"))
    time, clock = lines.times_of(body, value["t"], manner, unit=unit, column=columns.place.get("t", UNSTAMPED))
    path = lines.path_of(body, kind, (time, clock), pose, C, manner, frame=frame, stated=stated, notes=notes)
    if "qw" in value or manner.angles is not None:
        return path
    finite = np.flatnonzero(np.isfinite(pose).all(axis=1))
    return replace(path, headings=value["yaw"][finite[np.searchsorted(time[finite], path.time, side="right") - 1]])


def _planar(
    body: Text, kind: str, value: dict[str, Array], manner: Manner, notes: tuple[str, ...],
    *, unit: str | None = None, column: int, ours: bool = False,
) -> GivenPath:  # fmt: skip
    """The trajectory of t, x, y, yaw [rad] and maybe a covariance; `ours`: unknown poses are kept."""
    time, clock = lines.times_of(body, value["t"], manner, unit=unit, column=column)
    scale = np.array([*manner.scale[:2], manner.angles or 1.0])  # of covariances, also of the heading
    pose = np.column_stack([scale[0] * value["x"], scale[1] * value["y"], wrap_angle(value["yaw"])])
    known = np.isfinite(pose).all(axis=1) & np.isfinite(time)
    if ours:
        keep = paths.in_order(str(body.path), time, pose)
        if shared := len(pose) - len(keep):
            notes += (f"{shared} poses share their stamp with a later one, which is used",)
        if unknown := int((~known[keep]).sum()):
            notes += (f"{unknown} of {len(keep)} poses are blank or NaN, and scored as far as they are known",)
    else:
        if not known.any():
            raise DataError.at(body.path, NO_POSE.format(len(pose)))
        if not known.all():
            notes += (f"{int((~known).sum())} of {len(pose)} poses have a NaN and are left out",)
        keep = np.flatnonzero(known)[paths.in_order(str(body.path), time[known], pose[known])]
    P = None
    if all(c in value for c in COVARIANCE):
        entries = np.column_stack([value[c] for c in COVARIANCE])
        exact = ours & ~entries.any(axis=1)
        some, more = (None, ()) if exact.all() else known_only(symmetric(entries[~exact]))
        if some is not None or ours:
            P = np.zeros((len(pose), 3, 3))
            P[~exact] = np.nan if some is None else some
            P = P[keep] * np.outer(scale, scale)
            require_covariances(P, lambda k: body.place(int(keep[k])))
        notes += more
    if ours and np.isfinite(pose[:, :2]).any() and not np.isfinite(pose[:, 2]).any():
        notes = (ABSENT,)
    frame, raw = "" if P is None else WORLD, value["yaw"][keep] if manner.angles is None else None
    kind = f"{kind}, {clock.words}"
    path = GivenPath(str(body.path), kind, time[keep], pose[keep], P, frame, notes=notes, clock=clock, headings=raw)
    path = replace(path, every=time if (np.diff(time) > 0.0).all() else None)
    return paths.without_headings(path) if paths.unturned(path.pose[:, 2], path.pose[:, :2]) else path


def is_euroc(text: Text) -> bool:
    """Whether all lines are as many numbers, with commas: a stamp in ns, a position, and a quaternion of length 1."""
    each = [fields[: len(EUROC)] for fields in text.fields]
    if not text.commas or len({*map(len, text.fields)}) > 1 or not all(map(is_number, chain(*each))):
        return False
    rows = np.array(each, float)
    unit = rows.shape[1] == len(EUROC) and np.allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0, rtol=0.0, atol=UNIT)
    return bool(unit and (rows[:, 0] > NANOSECONDS_FROM).all())


PLAIN = Manner()
ACCEPTED = (
    "a CSV with the columns t,x,y,theta, TUM (8 columns), TUM with covariance (29 or 44), SQUARE, OpenVINS (20), EuRoC "
    "(commas, ns), KITTI poses (12, with stamps 13), columns named in a header, or a ROS bag"
)
WIDTHS = {len(roles): roles for roles in WELL_KNOWN if len(roles) > len(POSE)}  # Columns without names
WITHOUT_NAMES = {8: lines.read_tum, 12: lines.read_kitti}


def read_path(name: str, manner: Manner = PLAIN) -> GivenPath:
    """The trajectory in a file or bag (`FILE:/TOPIC`). DataError: wrong format or value; UsageError: wrong options."""
    path, topic = file_and_topic(name)
    table = topic is not None and is_table(path, topic)
    if is_bag(path) and not table:
        found, cov = read_bag(path, topic, manner), False
    elif path.is_dir() and not table:
        raise DataError.at(path, "a folder; a result is a file, or the folder of a run with online.csv or final.csv")
    else:
        text = lines.in_rows(read_text(Path(name)), named=bool(manner.columns))
        if text.cut.startswith(lines.COLMAP) and not (manner.axes or manner.inverse):
            manner = replace(manner, inverse=paths.INVERSE[0])
        text = _without_words(text if manner.columns.keys() - {"t"} else lines.in_names(text), manner)
        read = _reader(text, manner)
        found, cov = read(text, manner), read is lines.read_tum
        runs = runs_of(text.path) if found.clock.by == ROWS else ""
        found = replace(found, notes=(*found.notes, *filter(None, (text.cut, runs.lstrip("; ")))), runs=runs)
    raw = found.headings
    if raw is not None and in_degrees(np.column_stack([found.pose[:, :2], raw])):
        told = "inferred: headings are in degrees, as which alone they follow the motion (else --unit rad)"
        read_again = read_path(name, replace(manner, angles=TURNS["deg"]))
        return replace(read_again, notes=(*read_again.notes, told))
    if manner.cov is not None and not cov:
        raise UsageError(f"--cov {manner.cov}: {name} is {found.kind}; a TUM file of 8 columns is needed")
    if manner.inverse and found.space is None:
        raise UsageError(f"--axes {manner.inverse}: {name} has no poses in 3-D")
    for flag, value in (("--cov-frame", manner.frame), ("--cov-order", manner.order)):
        if value is not None and found.covariance is None:
            raise UsageError(f"{flag} {value}: {name} has no covariance")
    return found


def _without_words(text: Text, manner: Manner) -> Text:
    """The text without a word before each pose of KITTI or TUM, which is said; any other as it is."""
    body, words = replace(text, fields=tuple(row[1:] for row in text.fields)), {row[0] for row in text.fields}
    if manner.columns or len(body.fields[0]) not in WITHOUT_NAMES or any(map(is_number, words)):
        return text
    turned = lines.layout_of(body.fields) or tuple(only_reading(body.fields)) == POSE
    if not turned or header_names(text, manner) is not None:
        return text
    said = f"a word before each pose is left out ({', '.join(sorted(words))[:60]}); FILE:WORD reads those of one"
    return replace(body, cut="; ".join(filter(None, (text.cut, said))))


def _reader(text: Text, manner: Manner) -> Callable[[Text, Manner], GivenPath]:
    if "FORMAT" in lines.declared(text):
        return lines.read_square
    first = text.fields[0]
    columns = header_names(text, manner)
    if columns is not None:  # columns of TUM in their order are of the reader of that format
        plain = columns.order == POSE and columns.named == len(POSE) and not text.commas
        if not plain or len(first) not in (8, 29, 44):
            return partial(read_named, columns=columns)
    if len(first) == len(ENTRIES) + 1 and lines.layout_of([fields[1:] for fields in text.fields]):
        return lines.read_kitti
    bare = not text.commas and is_number(first[0])
    if roles := EUROC if is_euroc(text) else WIDTHS.get(len(first), ()) if bare else ():
        of = Columns({role: k for k, role in enumerate(roles)}, {}, (), len(roles), 0, in_data=False)
        return partial(read_named, columns=of)
    known = WITHOUT_NAMES.get(len(first)) if bare else None
    stated = {} if known not in (None, lines.read_kitti) or lines.layout_of(text.fields) else only_reading(text.fields)
    if stated and (columns := header_names(text, replace(manner, columns=stated))) is not None:
        return partial(read_named, columns=replace(columns, told=",".join(f"{q}={n}" for q, n in stated.items())))
    if known is not None:
        return known
    odd = next((k for k, row in enumerate(text.fields) if len(row) != len(first)), 0)
    shown = f"{len(text.fields[odd])} fields{f' where {len(first)} are above' * (odd > 0)}"
    shown += f", {','.join(text.fields[odd])[:40]!r}"
    example = ",".join(f"{'truth.' * manner.true}{q}={n}" for q, n in likely(text.fields).items())
    what = f"{shown}: no known trajectory format; {ACCEPTED} is needed, or columns by number: --columns {example}"
    numbers = not odd and all(map(is_number, chain(*text.fields)))
    if numbers and (k := lines.turns_in(np.array(text.fields, float))) >= 0:
        what = f"columns {k + 1} to {k + 9} are a rotation matrix, {len(first) - 9} others have no names: a header is "
        what += f"needed, as in x,y,z,r11,...,r33, or places in another file, as in POSITIONS+{text.path}"
    what += kinds_of(text.path, text.fields) or runs_of(text.path)
    raise DataError.at(text.path, what, line=text.line[odd])


PLANAR, SPACE = ("t", "x", "y", "yaw"), ("t", "x", "y", "z", "roll", "pitch", "yaw")
GUESSED: tuple[tuple[str, ...], ...] = (("x", "y"), ("x", "y", "yaw"), ("t", "x", "y"), PLANAR, SPACE[1:], SPACE)
"""What columns without names may be, by their number."""
ALONG = 0.7  # Least mean cosine between headings and the direction of motion
HALF, ROUNDED = 0.5, 1e-9  # Least share of a path's turns that headings follow; share of its length that is rounding
BURSTS, SPANS, CHORDS = 5.0, (1, 4, 16, 64), 20  # Longest usual step over the median; rows of a chord; least number
EVEN = 0.1  # Largest relative difference of the intervals of most stamps
FEW = 0.01  # Least extent of a path over its distance from the origin; others may be degrees of latitude and longitude


def only_reading(fields: Sequence[Sequence[str]]) -> dict[str, str]:
    """Number of each role of the only path that columns of numbers allow, or none: of two to four columns headings
    follow the motion, stamps ascend evenly, places are not all alike; of latitudes and longitudes digits and extent
    tell, of more columns four that are unit quaternions behind a place.
    """
    width = len(fields[0])
    if not all(len(f) == width and all(map(is_number, f)) for f in fields):
        return {}
    rows, fine = np.array(fields, float), []
    earth = _on_earth(fields, rows)
    for roles in () if earth else (roles for roles in GUESSED if len(roles) == width):
        column = dict(zip(roles, rows.T, strict=True))
        dt, place = np.diff(column.get("t", rows[:, 0])), np.array([column["x"], column["y"]])
        ascend = len(dt) > 0 and bool((dt > 0.0).all())
        most, usual = (BURSTS, 0.5) if len(roles) == 4 else (1.0 + EVEN, 0.1)
        steady = ascend and np.quantile(dt, 0.9) < most * np.quantile(dt, usual)
        chords = [span for span in SPANS if span == 1 or (len(roles) == 4 and CHORDS * span < len(rows))]
        follows = "yaw" not in roles or any(_follows(place, column["yaw"], span, ascend) for span in chords)
        if np.ptp(place, axis=1).max() > FEW * np.abs(place).max() and follows and ("t" not in roles or steady):
            fine.append(roles)
    fine = fine or [roles for roles in (earth, _turned(rows)) if roles]
    return {role: str(k + 1) for k, role in enumerate(fine[0])} if len(fine) == 1 else {}


def _follows(place: Array, heading: Array, span: int, turns: bool) -> bool:
    """Whether headings (n,) follow chords of a path (2, n); its `turns`, too, as a constant direction does not."""
    step, angle = place[:, span:] - place[:, :-span], heading[(span + 1) // 2 : len(heading) - span // 2]
    way, straight = np.hypot(*step), float(np.hypot(*np.sum(step, axis=1)))
    off = max(float(np.sum(way * np.cos(unit * angle - np.arctan2(step[1], step[0])))) for unit in TURNS.values())
    whole = float(way.sum())
    return off > ALONG * whole and (not turns or off - straight > HALF * (whole - straight) - ROUNDED * whole)


DIGITS_OF_DEGREES, EXTENT = 6, (20.0, 2e5)
"""Least usual decimals of latitudes and longitudes, 0.1 m, and their extent [m]: of less it may stand."""


def _on_earth(fields: Sequence[Sequence[str]], rows: Array) -> tuple[str, ...]:
    """Roles of columns t, latitude, longitude, height, with or without the first and last; none where they are not."""
    for k in (0, 1):
        if not 2 <= len(rows.T) - k <= 3 or (k and not (np.diff(rows[:, 0]) >= 0.0).all()):
            continue
        place = rows[:, k : k + 2]
        far = np.abs(place).max(axis=0)
        wide = math.radians(6371e3 * float(np.hypot(*np.ptp(place, axis=0))))
        fine = np.median([len(f.partition(".")[2]) for row in fields for f in row[k : k + 2]]) >= DIGITS_OF_DEGREES
        fine &= np.ptp(place, axis=0).max() < FEW * far.max()
        if fine and far.min() <= 90.0 and far.max() <= 180.0 and EXTENT[0] < wide < EXTENT[1]:
            return (*("t",) * k, *(("lat", "lon") if far[0] <= 90.0 else ("lon", "lat")), "alt")[: len(rows.T)]
    return ()


def _turned(rows: Array) -> tuple[str, ...]:
    """Roles of columns of a place and a unit quaternion, with or without a stamp, maybe with more behind; else none."""
    if lines.layout_of([[*map(str, row[:12])] for row in rows.tolist()]) or lines.turns_in(rows) >= 0:
        return ()
    stamps = len(rows) > 1 and bool((np.diff(rows[:, 0]) > 0.0).all())
    found = []
    for roles in (POSE, (*POSE[:3], *POSE[4:])) if stamps else (POSE[1:],):
        q = rows[:, roles.index("qx") : len(roles)]
        unit = len(rows.T) >= len(roles) and (np.abs(np.linalg.norm(q, axis=1) - 1.0) < UNIT).all()
        found += [roles] * bool(unit and np.ptp(q, axis=0).any())
    return found[0] if len(found) == 1 else ()


def likely(fields: Sequence[Sequence[str]]) -> dict[str, str]:
    """Number of each role that columns may have, as an example of a flag: a stamp where the first one ascends."""
    first = next((k for k, field in enumerate(fields[0]) if is_number(field)), 0)  # behind the name of a kind
    rows = [tuple(map(float, row)) for row in (f[first : first + 4] for f in fields) if all(map(is_number, row))]
    rows = [row for row in rows if len(row) == len(fields[0][first : first + 4]) > 1]
    roles = ("x", "y", "z")[: 3 if rows and len(rows[0]) == 3 and np.ptp(rows, axis=0)[2] > 2.0 * np.pi else 2]
    if len(rows) > 1 and all(a[0] < b[0] for a, b in pairwise(rows)) and len(rows[0]) > 2:
        degrees = all(abs(row[1]) <= 90.0 and abs(row[2]) <= 180.0 for row in rows)
        far = degrees and np.ptp([row[1:3] for row in rows], axis=0).max() < FEW * max(abs(row[2]) for row in rows)
        roles = ("t", "lat", "lon") if far else ("t", "x", "y")
    return {role: str(first + k) for k, role in enumerate(roles, 1)}


def holds_both(name: str) -> bool:
    """Whether the rows of a file name a true position, too."""
    if is_bag(file_and_topic(name)[0]) or not file_and_word(Path(name))[0].is_file():
        return False
    try:
        found = [
            header_names(lines.in_names(read_text(Path(name))), Manner(true=side, rows=True)) for side in (False, True)
        ]
    except DataError:  # of several that name a position, which reading it will say
        return True
    x, true = (None if columns is None else columns.place.get("lat", columns.place.get("x")) for columns in found)
    return None not in found and x != true
