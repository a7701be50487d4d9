"""The request of `python -m data.convert table`: flags or a mapping file, as values in SI units.

Without `--sensor` there is one sensor, whose observations are in the file of `--observations` or of the odometry. With
`--sensor NAME=FILE` each has a file; flags of `OF_SENSORS` then are of one sensor (`--view camera=-30deg,30deg`) or of
all (`--view -30deg,30deg`).
"""

import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from data import se2
from data.columns.appearance import Noise
from data.csv_table import is_name
from data.errors import DataError, UsageError, did_you_mean, unknown
from data.formats.arrays import is_arrays
from data.formats.recordings.laser import SPEED, TravelNoise
from data.formats.results.reading import RATES, words_of
from data.formats.tables import files as table_files, motion
from data.formats.tables.files import POSE, ROLES, SCANS, SECOND, STAMPED, STARRED, Columns, Given, Units, described
from data.formats.tables.layout import by_layout, landmarks_in_rows, named_alike, ranges_in_columns, seen_by_layout
from data.formats.tables.motion import KINDS, Noises, Second, StepNoise, Wheels, kind_of, path_of
from data.formats.tables.scans import BEAMS, alone_in, folded_up, wide_in
from data.formats.text import TextTable, read_table
from data.formats.wrapped import file_and_word
from data.motion.velocity import WITH_ALPHAS, VelocityNoise
from data.origin import Origin, Origins
from data.se2 import Array
from data.sensors import Bearing, Range, RangeBearing, RelativePoint, Sensor
from data.toml_table import load_toml

SENSOR, OBSERVATIONS, XY = "sensor", "observations", ("x", "y")
LOOKS = {"descriptor": "descriptor-sigma", "class": "class-error"}
"""Columns of appearance, and the flag that states the noise of each; without it the column is not read."""
MEASURES = {"fixes", "closures", SCANS, SECOND}  # Parts beside which a log needs no observations
OF_SENSORS = ("observation-sigma", "sensor-pose", "max-range", "view", "sees", *LOOKS.values())  # Of each sensor
NUMBERS = {
    flag: (of["dimensions"].split(","), of["needed"], of.get("zero")) for flag, of in motion.SAID["numbers"].items()
}
"""Flags of numbers: dimensions, what is needed in words, and which numbers may be: any, 0, or only more."""
LENGTH = "length"  # Key of the unit that `--unit length` states, in the request as settled
FILE = "file"  # Key of a table [sensor.NAME] of a mapping file, beside those flags
ASSUMED = {"density": "5cm,2deg", "travel": ",".join(map("{:g}".format, TravelNoise()))}
"""Noise of an odometry that nobody states, by model: measured on a robot with wheels in an office."""


SEEN: dict[tuple[str, ...], type[Sensor]] = {
    ("range",): Range, ("bearing",): Bearing, ("range", "bearing"): RangeBearing, ("x", "y"): RelativePoint,
}  # fmt: skip
"""Sensors by the columns that they measure."""


@dataclass(frozen=True, eq=False)
class TableSensor:
    """A sensor of tables, in SI units."""

    role: str  # of its file, among the files and in keys of columns: its name, or "observations" of the only one
    measured: tuple[str, ...]  # measured: its columns, a key of `SEEN`; sensor: its label, blank if it is the only one
    sensor: Sensor
    origins: Origins  # of its noise, place, and reach, which is as observed where it is inferred
    sigma: Array  # sigma: (2,) of an observation; looks: noise of descriptors and classes; what is None is not read
    looks: Noise

    @property
    def looked(self) -> tuple[str, ...]:
        """Columns of appearance to read."""
        return tuple(q for q, noise in zip(LOOKS, self.looks, strict=True) if noise is not None)


def numbers_of(given: Mapping[str, object], flag: str) -> Array | None:
    """The numbers that a flag of `NUMBERS` states; None where it is not given."""
    dimensions, what, zero = NUMBERS[flag]
    return None if given.get(flag) is None else _numbers(given, flag, dimensions, what, zero)


def _numbers(given: Mapping[str, object], flag: str, dims: Sequence[str], what: str, zero: bool | None = None) -> Array:
    """The numbers of a flag, lengths without a unit in that of `--unit length`."""
    return table_files.numbers(given[flag], dims, flag, what, zero=zero, length=str(given.get(LENGTH, "")))


def by_sensor(value: object, flag: str) -> dict[str, str]:
    """Text by sensor, "" of all, of a flag that is a text, or several, or a table by sensor."""
    if isinstance(value, Mapping):
        return {str(k): str(v) for k, v in value.items()}
    found: dict[str, str] = {}
    for text in map(str, value if isinstance(value, list) else [value]):
        name, equals, rest = text.partition("=")
        name, rest = (name.strip(), rest.strip()) if equals else ("", text)
        if name and name in found:
            raise UsageError(f"--{flag}: {name} is named twice")
        found[name] = rest
    return found


def files_of(given: Given) -> dict[str, Path]:
    """The file of each sensor by name; none without `--sensor`. UsageError for a name that cannot be one."""
    found: dict[str, Path] = {}
    for name, text in by_sensor(given.get(SENSOR, {}), SENSOR).items():
        if not name or not text:
            raise UsageError(f"--{SENSOR} {text or name}: NAME=FILE is needed, as in lidar=cones.csv")
        if not is_name(name) or "." in name or name in ROLES:
            what = f"other than {', '.join(ROLES)}" if name in ROLES else "without dots, commas and quotes"
            raise UsageError(f"--{SENSOR} {name}={text}: a name {what} is needed")
        found[name] = Path(text)
    if found and OBSERVATIONS in given:
        raise UsageError(f"--{OBSERVATIONS} beside --{SENSOR}: name this one, too, as in --{SENSOR} lidar=FILE")
    return found


def sensors_of(given: Given, files: Mapping[str, TextTable], columns: Columns, kind: str) -> tuple[TableSensor, ...]:
    """The sensors with a file among `files`, in order, beside a `kind` of odometry; UsageError for a wrong value."""
    names = list(files_of(given))
    texts = {flag: by_sensor(given[flag], flag) for flag in OF_SENSORS if flag in given}
    for flag, found in texts.items():
        for name in found:
            if name and name not in (*names, *[SCANS] * (flag == "sensor-pose" and SCANS in files)):
                known = unknown(name, names) if names else f"no sensor; --{SENSOR} {name}=FILE names one"
                raise UsageError(f"--{flag} {name}={found[name]}: {name!r} is {known}")
    texts[LENGTH] = {"": str(given[LENGTH])}
    roles = names or [role for role in (OBSERVATIONS,) if role in files]
    for flag, found in texts.items():
        if not roles and flag not in (LENGTH, *["sensor-pose"] * (SCANS in files)):
            raise UsageError(f"--{flag} {found.popitem()[1]}: no observations; --{OBSERVATIONS} FILE names them")
    pose = motion.pose_columns(files["odometry"], columns.quiet, "odometry")
    taken = {
        role
        for role in roles
        if (files[role] is files["odometry"] and columns.quiet.has(files[role], "odometry", pose))
        or any(columns.taken(files[role], role, ("x", "y"), files.get(of), of) for of in ("truth", "fixes"))
    }
    own = {columns.quiet.find(files["odometry"], "odometry", q) for q in ("t", *KINDS[kind])}
    free = "truth" in files or given.get("frames") == "odometry" or own >= {*files["odometry"].filled}
    free &= not names and len(texts) == 1 and files.get(OBSERVATIONS) is files["odometry"]
    each = (_sensor(r, r if names else "", texts, files[r], columns, r in taken, free=free) for r in roles)
    return tuple(of for of in each if of is not None)


def _sensor(
    role: str, name: str, texts: Mapping[str, Mapping[str, str]], file: TextTable, columns: Columns, taken: bool,
    *, free: bool = False,
) -> TableSensor | None:  # fmt: skip
    """A sensor by what is stated of it or of all; `taken`: x, y are another part's; `free`: it may have no columns."""
    of = {flag: found.get(name, found.get("")) for flag, found in texts.items()}
    found = [q for q in ("range", "bearing") if (columns.quiet if free else columns).find(file, role, q) is not None]
    guessed = free and found == ["range"] and not {"range", "label", "true_id"} & {*file.names, *columns.given}
    found = [] if guessed and not columns.stated(role, ("range", "label")) else found  # a range by another name alone
    stated = of.get("observation-sigma")
    alone = found[0] if len(found) == 1 and (stated is None or len(table_files.words(stated)) == 1) else None
    measured = (alone,) if alone is not None else ("range", "bearing") if found else ("x", "y")
    points = columns.has(file, role, measured) and (not taken or columns.stated(role, measured))
    if measured == ("x", "y") and not points:
        own, where = f"{name}." if name else "", "or their file with --observations (none: --frames odometry)"
        what = f"no observations: {described(file)}; range and bearing, or x and y in the sensor's frame, are needed"
        numbered = Counter(re.sub(r"\d+$", "*", name) for name in file.names if file.named)
        star = next((name for name, n in numbered.most_common(1) if n > 1 and name != "*"), "")
        where += f"; of scans --scans {file.path}" * any(n >= BEAMS for n in numbered.values())
        a, b = ("DIST", "ANGLE", *(name for name in file.names if file.named and name.isdecimal()))[-2:]
        where += f"; of a column for each landmark as in --columns {own}range={star}" * bool(star)
        what += f"; name them as in --columns {own}range={a},{own}bearing={b}, {where}"
        if free:
            told = f"if it has some, name them as in --columns {own}range={a},{own}bearing={b}"
            columns.notes.append(f"{file.path.name}: without observations; {told}: {described(file)}")
            return None
        raise DataError.at(file.path, what)
    sees = of.get("sees") or ""
    if "sees" in of and not is_name(sees):
        raise UsageError(f"--sees {sees}: a kind of landmark is needed, as in tree")
    reach, view, pose = (numbers_of(of, flag) for flag in ("max-range", "view", "sensor-pose"))
    if view is not None and not view[0] < view[1]:
        raise UsageError(f"--view {of['view']}: the smaller bearing first")
    low, high = (-np.pi, np.pi) if view is None else view.tolist()
    x, y, turned = se2.inverse(np.zeros(3) if pose is None else pose).tolist()
    sensor = SEEN[measured](np.inf if reach is None else float(reach[0]), low, high, turned, (x, y), name, sees)
    if stated is None:
        usual = {"range": "10cm", "bearing": "2deg"}
        of["observation-sigma"] = ",".join(usual[q] for q in (found if alone else usual)) if found else "10cm,10cm"
        columns.notes.append(f"assumed: --observation-sigma {f'{name}=' * bool(name)}{of['observation-sigma']}")
    sigma = _observation_sigma(of, alone, polar=bool(found))
    given_of = {"observation_noise": stated, "sensor_pose": pose}
    origins = {of: Origin.ASSUMED if value is None else Origin.GIVEN for of, value in given_of.items()}
    if measured != ("bearing",):
        origins["max_range"] = Origin.INFERRED if reach is None else Origin.GIVEN
    return TableSensor(role, measured, sensor, origins, sigma, _looks(of, role, file, columns))


def _looks(of: Mapping[str, str | None], role: str, file: TextTable, columns: Columns) -> Noise:
    """The noise of descriptors and classes."""
    found: list[float | None] = []
    for quantity, flag in LOOKS.items():
        value = numbers_of(of, flag)
        if value is not None and flag == "class-error" and not 0.0 < value[0] < 0.5:
            raise UsageError(f"--{flag} {of[flag]}: a probability above 0 and below 0.5 is needed")
        if value is not None and columns.find(file, role, quantity) is None:
            what = f"the {OBSERVATIONS} have no column {quantity}"
            raise UsageError(f"--{flag} {of[flag]}: {what}; --columns {role}.{quantity}=NAME names it")
        found.append(None if value is None else float(value[0]))
    return Noise(*found)


def _observation_sigma(given: Mapping[str, str | None], alone: str | None, *, polar: bool) -> Array:
    """Standard deviations (2,), 1 in the place of what is not measured."""
    flag = "observation-sigma"
    if alone is not None:
        dimension, what = ("length", "of a range alone [m]") if alone == "range" else ("angle", "of a bearing [rad]")
        one = _numbers(given, flag, (dimension,), what, zero=False)
        return np.concatenate([one, [1.0]] if alone == "range" else [[1.0], one])
    what = "of a range [m] and a bearing [rad], as in 0.1,2deg" if polar else "of x and y [m], as in 0.1,0.1"
    return _numbers(given, flag, ("length", "angle" if polar else "length"), what, zero=False)


FROM_TRUTH = "truth"  # The prior's mean is the first true pose


@dataclass(frozen=True, eq=False)
class Wanted:
    """The request, in SI units."""

    # files, texts: by role (odometry, observations or the name of a sensor, map, truth, fixes, closures)
    files: Mapping[str, Path]
    texts: Mapping[str, TextTable]
    columns: Columns
    kind: str  # kind, noise: of the odometry; model: how velocities become increments
    wheels: Wheels | None
    noise: Noises
    model: str
    sensors: tuple[TableSensor, ...]
    prior: Array | str | None  # mean (3,), "truth", or None: the log's frame starts at the robot; with prior_sigma (3,)
    prior_sigma: Array | None
    map_pose: Array  # map_pose: (3,) pose of the map's frame in the world; truth_pose: of the truth's
    truth_pose: Array
    every_row: bool  # every odometry row is a frame, not only those with observations
    sensed: bool
    backward: bool = False  # a row's velocities held since the row before; else until the next one
    # fix_sigma, closure_sigma: (3,) of x, y, theta where a row states none, NaN unknown; None: not stated
    fix_sigma: Array | None = None
    closure_sigma: Array | None = None
    # fix_lever, fix_rotation: place [m] and direction [rad] in the body frame of what measures the fixes
    fix_lever: tuple[float, float] = (0.0, 0.0)
    fix_rotation: float = 0.0
    second: Second | None = None
    scanner: Array | None = None  # (3,) first angle, step [rad] and reach [m] of scans; None: columns state them
    mount: Array | None = None  # (3,) pose of the scanner on the robot
    blind: float = 0.0  # m/s, without odometry: within which the motion is unknown
    assumed: tuple[str, ...] = ()  # quantities of `Origins` that nobody stated


TABLES = ("columns", "unit", "time-offset")  # Flags of pairs KEY=VALUE, tables of a mapping file


def with_mapping(path: Path, given: Given, keys: Sequence[str]) -> dict[str, object]:
    """The flags and the keys of a mapping file (paths relative to it); flags win. DataError for an invalid file."""
    merged: dict[str, Any] = {}
    stated: dict[str, Any] = load_toml(path, lambda what: DataError.at(path, what))
    for key, value in stated.items():
        flag = key.replace("_", "-")
        if flag not in keys:
            raise DataError.at(path, f"key {key!r}: {unknown(flag, keys)}")
        if flag in (*TABLES, SENSOR) and not isinstance(value, Mapping):
            line = {SENSOR: 'file = "cones.csv"', "time-offset": "truth = 0.5"}.get(flag, 't = "stamp"')
            table = f"{SENSOR}.lidar" if flag == SENSOR else key
            raise DataError.at(path, f"{key}: a table is needed, as [{table}] with lines such as {line}")
        if flag == SENSOR:
            for name, table in value.items():
                for other, text in _of_sensor(path, f"[{key}.{name}]", table).items():
                    merged[other] = {**by_sensor(merged.get(other, {}), other), name: text}
        elif flag in TABLES:
            merged[flag] = dict(_flat(value))
        elif flag in OF_SENSORS:
            merged[flag] = {"": _text(path, key, value), **by_sensor(merged.get(flag, {}), flag)}
        elif isinstance(value, bool) and flag == "labels-sensed":
            merged[flag] = value
        else:
            text = _text(path, key, value)
            merged[flag] = str(path.parent / text) if flag in ROLES else text
    for key, value in given.items():
        read = table_files.pairs if key in TABLES else by_sensor if key in (SENSOR, *OF_SENSORS) else None
        merged[key] = value if read is None or key not in merged else {**read(merged[key], key), **read(value, key)}
    return merged


def _of_sensor(path: Path, where: str, table: object) -> dict[str, str]:
    """A table [sensor.NAME] of a mapping file as texts by flag."""
    if not isinstance(table, Mapping) or FILE not in table:
        raise DataError.at(path, f'{where}: no {FILE}; as in {FILE} = "cones.csv"')
    found = {}
    for key, value in table.items():
        flag = key.replace("_", "-")
        if flag not in (FILE, *OF_SENSORS):
            raise DataError.at(path, f"{where}: key {key!r}: {unknown(flag, (FILE, *OF_SENSORS))}")
        text = _text(path, f"{where} {key}", value)
        found[SENSOR if flag == FILE else flag] = str(path.parent / text) if flag == FILE else text
    return found


def _text(path: Path, where: str, value: object) -> str:
    """A text, a number or a list as of a flag."""
    if isinstance(value, bool) or not isinstance(value, str | int | float | list):
        raise DataError.at(path, f"{where} = {value}: a text, a number or a list is needed")
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def _flat(table: Mapping[str, object], above: str = "") -> list[tuple[str, str]]:
    """Dotted keys of nested tables."""
    flat: list[tuple[str, str]] = []
    for key, value in table.items():
        flat += _flat(value, f"{above}{key}.") if isinstance(value, dict) else [(f"{above}{key}", str(value))]
    return flat


def settle(given: Given) -> Wanted:
    """The request in SI units; UsageError for missing, unknown or invalid values."""
    files = {role: Path(str(given[role])) for role in ROLES if given.get(role) is not None}
    if "odometry" not in files:
        raise UsageError('a mapping file names the file with the odometry: odometry = "FILE"')
    files |= (several := files_of(given))
    keyed = (table_files.pairs(given.get(flag, {}), flag) for flag in ("unit", "columns"))
    stated, named = ({table_files.quantity_of(key): value for key, value in each.items()} for each in keyed)
    units = Units(stated)
    given = {**given, LENGTH: units.given.get(LENGTH, "")}
    columns = Columns(named, units, _offsets(given, files, several), roles=(*ROLES, *several))
    if "period" in given:
        columns.period = table_files.quantity_with_unit(str(given["period"]), "time", "--period")
    if given[LENGTH]:
        columns.notes.append(f"lengths of flags without a unit are in {given[LENGTH]}, as --unit states")
    parts = _Parts(files, {}, columns, named, (OBSERVATIONS, *several))
    _read(parts)
    _beside_odometry(parts, given)
    for role, table in parts.texts.items():
        columns.take_series(table, role)
    _below_odometry(parts)
    unnamed = _by_layout(parts)
    for role in (r for r in parts.observing if r in parts.texts):
        _take_stars(parts, role)
    _hold_heading(parts)
    blind, given = _blind(parts, given)
    kind = _kind(given, parts.texts, columns, "odometry", tuple(KINDS))
    _name_observations(parts, given, kind, unnamed)
    given, texts = _rates(parts, given) if kind == "ticks" else given, parts.texts
    for flag in ("hold", "integrate"):
        if flag in given and kind not in motion.STAMPED and (flag, given.get("ticks")) != ("hold", "rate"):
            raise UsageError(f"--{flag} {given[flag]}: for velocities; the odometry has {kind}")
    second, starts = _second(given, texts, columns), "truth" in files and "prior" not in given
    if starts or ("prior" in given and "prior-sigma" not in given):
        told = "" if "prior" in given else f" --prior {FROM_TRUTH}"
        given = {"prior": FROM_TRUTH, "prior-sigma": "10cm,10cm,3deg", **given}
        columns.notes.append(f"assumed:{told} --prior-sigma {given['prior-sigma']}")
    prior, poses = given.get("prior"), by_sensor(given.get("sensor-pose", []), "sensor-pose")
    map_pose, truth_pose = (numbers_of(given, f"{of}-transform") for of in ("map", "truth"))
    return Wanted(
        files=files, texts=texts, columns=columns, kind=kind, wheels=_wheels(given, kind, columns),
        noise=_noise(given, kind, [] if blind else columns.notes),  # not that of an unknown motion
        model=INTEGRATED[table_files.one_of(given, "integrate", tuple(INTEGRATED))],
        sensors=sensors_of(given, texts, columns, kind),
        prior=FROM_TRUTH if prior == FROM_TRUTH else numbers_of(given, "prior"),
        prior_sigma=numbers_of(given, "prior-sigma"), map_pose=np.zeros(3) if map_pose is None else map_pose,
        truth_pose=np.zeros(3) if truth_pose is None else truth_pose,
        every_row=table_files.one_of(given, "frames", ("observations", "odometry")) == "odometry",
        sensed=bool(given.get("labels-sensed", False)),
        backward=table_files.one_of(given, "hold", ("forward", "backward")) == "backward", second=second,
        scanner=_scanner(given),
        mount=numbers_of({**given, "sensor-pose": poses.get(SCANS, poses.get(""))}, "sensor-pose"),
        blind=blind, assumed=("odometry_noise",) * ("odometry-sigma" not in given) + ("prior",) * starts,
        **_of_fixes(given, files, texts, columns.quiet),
    )  # fmt: skip


@dataclass
class _Parts:
    """Files and tables by role, while those that nobody named are found."""

    files: dict[str, Path]
    texts: dict[str, TextTable]
    columns: Columns
    named: Mapping[str, str]  # stated columns
    observing: tuple[str, ...]  # roles of observations, the only one or the names of sensors

    def find(self, role: str, quantities: Sequence[str]) -> bool:
        """Whether a role's table has a column for any of these quantities."""
        return any(self.columns.quiet.find(self.texts[role], role, q) is not None for q in quantities)

    def hold(self, quantities: Sequence[str]) -> None:
        """Give the odometry a column of zeros for each of these quantities."""
        for q in quantities:
            table = self.texts["odometry"]
            self.texts["odometry"] = table.beside(f"no {q}", np.zeros(len(table), int))
            self.columns.given = {**self.columns.given, f"odometry.{q}": f"no {q}"}

    def infer(self, told: str, role: str = "") -> None:
        """Note what is inferred, of a role's file."""
        self.columns.notes.append(f"{self.files[role].name}: inferred: {told}" if role else f"inferred: {told}")


def _read(p: _Parts) -> None:
    """Read each file once, also of several roles, and of kinds of rows that tell their parts."""
    if len(kinds := table_files.kinds_by_part(p.files["odometry"])) > 1:
        p.files |= {role: path for role, path in kinds.items() if role == "odometry" or role not in p.files}
        p.infer(", ".join(f"--{role} {path}" for role, path in kinds.items()))
    read: dict[Path, TextTable] = {}
    for role, path in p.files.items():
        count, seen = len(next(iter(read.values()), ())), role in p.observing
        if path not in read:
            read[path] = table_files.upright(read_table(path, p.named.values(), count, seen=seen))
        if role == "odometry" and "0" in {p.named.get(k) for k in ("theta", "odometry.theta")} - {*read[path].names}:
            read[path] = read[path].beside("0", np.zeros(len(read[path]), int))  # no column, which count from 1
    for path in {p.files.get(SCANS, p.files["odometry"])} - {p.files.get(OBSERVATIONS)}:
        moves = SCANS not in p.files and _moves(p, read[path])
        read[path] = folded_up(read[path], p.columns, moves) or read[path]
    read[p.files["odometry"]] = table_files.stepped(read[p.files["odometry"]])
    p.texts |= {role: read[path] for role, path in p.files.items()}
    p.columns.notes += [f"{path.name}: {table.cut}" for path, table in read.items() if table.cut]


def _beside_odometry(p: _Parts, given: Given) -> None:
    """Take the parts that are in the file of the odometry: stated, or told by names or by their form."""
    path, table = p.files["odometry"], p.texts["odometry"]
    for role in (r for r in ROLES[1:] if r not in p.texts):
        stated = [n for key, n in p.named.items() if key.startswith(f"{role}.")]
        own = [n for n in stated if table_files.column_of(table, n) is not None]
        if not own and role in ("truth", "fixes") and table.named:
            own = p.columns.quiet.tells(table, role)
        if not own and role == SCANS and not {*p.observing} & {*p.files}:
            own = wide_in(table, stated="scanner" in given) or [*alone_in(table, len(table)).values()]
        if own:
            p.files[role], p.texts[role] = path, table
            p.infer(f"--{role} {path}, of its columns {', '.join(own)}")
        arrays = not own and ((role == "truth" and table.named) or (role == "map" and is_arrays(path)))
        if arrays and (layout := by_layout(table, role, alone=False)) is not None:
            p.files[role], p.texts[role], told = path, *_laid_out(table, role, p.columns, layout)
            p.infer(f"--{role} {path}, {told}")
    alone = alone_in(p.texts[SCANS], len(table)) if SCANS in p.texts and not p.find(SCANS, ("t", "range")) else {}
    if alone:
        p.columns.given = {**p.columns.given, **alone}
        p.infer(f"--columns {','.join(f'{k}={v}' for k, v in alone.items())}", SCANS)
    if p.observing == (OBSERVATIONS,) and OBSERVATIONS not in p.texts:
        there = any(key in STARRED[:2] or key.startswith(f"{OBSERVATIONS}.") for key in p.named)
        there |= bool(table_files.stars(table)) or not MEASURES & {*p.files}
        if there or p.columns.quiet.has(table, OBSERVATIONS, STARRED[:2]):
            p.files[OBSERVATIONS], p.texts[OBSERVATIONS] = path, table


def _below_odometry(p: _Parts) -> None:
    """Observations without an instant, in lines of the odometry's file, are of the line of odometry above them."""
    odometry, (file, word) = p.texts["odometry"], file_and_word(p.files["odometry"])
    for role in (r for r in p.observing if r in p.texts and word and p.texts[r] is not odometry):
        stated = any(p.columns.find(p.texts[role], role, q) is not None for q in ("t", "frame"))
        if file_and_word(p.files[role])[0] == file and not stated:
            above = np.searchsorted(odometry.line, p.texts[role].line) - 1
            p.texts[role] = p.texts[role].beside("frame", np.maximum(above, 0))
            p.columns.given = {**p.columns.given, f"{role}.frame": "frame"}
            p.infer("frame, of the row of odometry above each in the file", role)


def _by_layout(p: _Parts) -> list[str]:
    """Take what columns that nobody named tell: an odometry, truth, map; the roles without a stated column."""
    of = dict.fromkeys((*STARRED[:2], *table_files.IDS), OBSERVATIONS)  # not of an odometry, a truth or a map
    of |= {q: "odometry" for kind in KINDS.values() for q in kind if q not in KINDS["poses"]}
    roles = {k.rpartition(".")[0] or of.get(k, "") for k in p.named}
    unnamed = [r for r in p.texts if not roles & {"", r, *[OBSERVATIONS] * (r in p.observing)}]
    if "map" in p.texts and not any(k.startswith("map.") or n in p.texts["map"].names for k, n in p.named.items()):
        unnamed.append("map")
    odometry = any(p.columns.quiet.has(p.texts["odometry"], "odometry", KINDS[k]) for k in ("velocities", "poses"))
    for role in ("odometry",) * (not odometry) + ("truth", "map", "fixes"):
        known = any(key.startswith(f"{role}.") for key in p.columns.given)
        if role in unnamed and not known and (layout := by_layout(p.texts[role], role)) is not None:
            file, (p.texts[role], told) = p.texts[role], _laid_out(p.texts[role], role, p.columns, layout)
            p.texts.update({r: p.texts[role] for r in p.observing if p.texts.get(r) is file})
            p.infer(told, role)
    typed = {key.rpartition(".")[2] for key in p.named}
    if OBSERVATIONS in p.texts and "map" not in p.texts and not typed & {"id", *table_files.IDS}:
        alone = p.find(OBSERVATIONS, ("range",)) and not p.find(OBSERVATIONS, ("label",))
        if alone and (placed := landmarks_in_rows(p.texts[OBSERVATIONS])):
            p.texts[OBSERVATIONS], p.texts["map"], told = placed
            p.files["map"] = p.files[OBSERVATIONS]
            p.infer(told, "map")
    return unnamed


def _hold_heading(p: _Parts) -> None:
    """Hold the heading at 0 of an odometry of places without headings, beside fixes or a truth of places alone."""
    table, looked, aside = p.texts["odometry"], p.columns.quiet, {"vy", "odometry.vy"} & {*p.columns.given}
    own, what, turn = (("v", "vy"), "velocities are", ["theta"]) if aside else (XY, "places are steps", [])
    others = [role for role in ("fixes", "truth") if role in p.texts]  # of which headings would be the robot's
    known = any(looked.has(table, "odometry", q) for q in (*KINDS.values(), table_files.QUATERNION, ("v", *turn)))
    known |= any(p.texts[r] is not table or p.find(r, STARRED[:2]) for r in p.observing if r in p.texts)
    known |= any(p.find(r, ("theta", "qx")) for r in others)
    known |= not aside and any(looked.taken(table, "odometry", own, p.texts[r], r) for r in others)
    if others and looked.has(table, "odometry", own) and not known:
        p.hold(["omega" if aside else "theta"])
        p.texts.update({role: p.texts["odometry"] for role, of in p.texts.items() if of is table})
        if aside and (path := path_of(p.texts, p.columns, "sideways")) is not None:
            seen = looked.table(p.texts[others[0]], others[0], ("t", *XY), may_be_blank=XY)[0].stack(("t", *XY))
            seen = seen[np.isfinite(seen).all(axis=1)]
            off = se2.interpolate(*path, seen[:, 0])[:, :2] - seen[:, 1:]
            if FITS * np.var(off, axis=0).sum() > np.var(seen[:, 1:], axis=0).sum():
                raise DataError.at(table.path, motion.SAID["no-turn"])
        p.infer(f"no heading: {what} in axes of their own, whose heading is 0, not that of the robot", "odometry")


def _moves(p: _Parts, table: TextTable) -> bool:
    """Whether a table has the columns of an odometry."""
    return any(p.columns.quiet.has(table, "odometry", measured) for measured in KINDS.values())


def _blind(p: _Parts, given: Given) -> tuple[float, Given]:
    """The speed [m/s] within which a robot without odometry moves, 0 with one, and the flags with what they assume."""
    table, looked = p.texts["odometry"], p.columns.quiet
    if none := given.get("odometry-kind") == "none":
        given = {flag: value for flag, value in given.items() if flag != "odometry-kind"}
    elif _moves(p, table) or "odometry-kind" in given or {"vy", "odometry.vy"} & {*p.columns.given}:
        return 0.0, given
    if p.texts.get(SCANS) is table:
        p.columns.notes.append(f"{p.files[SCANS].name}: no odometry in it: scan matching alone tells the motion")
        p.hold(KINDS["poses"])
        if (key := f"{SCANS}.t") in p.columns.given:
            p.columns.given = {**p.columns.given, "odometry.t": p.columns.given[key]}
        return SPEED, given
    wants, timed = ("t", *XY), looked.find(table, "odometry", "t") is not None
    if "fixes" not in p.texts and timed and (speed := _pace(p, none)):
        p.infer(f"no odometry: the motion is unknown, within {speed:.3g} m/s, as fast as nine tenths of ranges change")
        p.hold(KINDS["poses"])
        return speed, given
    if "fixes" not in p.texts or not timed or not looked.has(p.texts["fixes"], "fixes", wants):
        if none:
            raise UsageError(motion.SAID["none"])
        return 0.0, given
    at = looked.table(p.texts["fixes"], "fixes", wants, may_be_blank=wants[1:])[0].stack(wants)
    at = at[np.isfinite(at).all(axis=1)]
    moved = (np.diff(at[:, 0]) > 0.0) & np.diff(at[:, 1:], axis=0).any(axis=1)
    at = at[np.append(True, moved)]  # of held ones the first
    if len(at) < LEAST_FIXES:
        return 0.0, given
    far = at[np.hypot(*(at[:SOON, 1:] - at[0, 1:]).T).argmax(), 1:] - at[0, 1:]
    if "truth" not in p.texts and "prior" not in given:
        start = {"prior": f"{at[0, 1]},{at[0, 2]},{math.atan2(far[1], far[0])}", "prior-sigma": "1,1,45deg"}
        given, p.columns.origins["prior"] = {**start, **given}, Origin.INFERRED
        p.infer(f"--prior at the first fix, heading for the farthest of {SOON}; --prior-sigma {given['prior-sigma']}")
    speed = float(np.quantile(np.hypot(*np.diff(at[:, 1:], axis=0).T) / np.diff(at[:, 0]), FAST))
    q = "omega" if p.find("odometry", ("v",)) else "v" * bool({"omega", "odometry.omega"} & {*p.named})
    if q and not none:
        sigma = "5cm,45deg" if q == "omega" else f"{speed:.3g},2deg"
        p.hold([q])
        p.infer(f"no {'turn rate' if q == 'omega' else 'speed'}: unknown, within --odometry-sigma {sigma}")
        return 0.0, {"odometry-sigma": sigma, **given}
    p.infer(f"no odometry: the motion is unknown, within {speed:.3g} m/s, the speed of nine tenths of the fixes")
    p.hold(KINDS["poses"])  # it stands
    return speed, given


def _pace(p: _Parts, none: bool) -> float:
    """How fast nine tenths of ranges to landmarks of a map change [m/s]; 0 of none, or in a file with other columns."""
    looked, wants = p.columns.quiet, ("t", "label", "range")
    role = next((r for r in p.observing if r in p.texts and looked.has(p.texts[r], r, wants)), "")
    if not role or "map" not in p.texts or p.find(role, ("bearing",)):
        return 0.0
    file = p.texts[role]
    beside = [of for of in ("truth", "map") if p.files.get(of) == p.files[role]]
    others = [(of, q) for of in beside for q in KINDS["poses"]]
    read = {looked.find(file, *of) for of in [*((role, q) for q in wants), *others]}
    alone = all(k in read or len({row[k] for row in file.rows}) == 1 for k in file.filled)
    if not none and not (alone and p.texts["odometry"].path == file.path):
        return 0.0
    t, label, far = np.array(sorted(looked.table(file, role, wants)[0].stack(wants).tolist())).T
    speeds = []
    for of in np.unique(label):
        at, own = t[label == of], far[label == of]
        early = at <= at[-1] - LATER
        speeds.append(np.abs(np.interp(at[early] + LATER, at, own) - own[early]) / LATER)
    return float(np.quantile(np.concatenate(speeds), FAST)) if any(map(len, speeds)) else 0.0


LATER = 1.0  # s, between two ranges that tell how fast they change
LEAST_FIXES, FAST, SOON = 5, 0.9, 10  # Fixes that tell a speed, its quantile; first fixes that tell the heading


def _name_observations(p: _Parts, given: Given, kind: str, unnamed: Collection[str]) -> None:
    """Observations that are places of the robot, or whose columns, or labels, the path or the map tells."""
    beside = p.texts.get(OBSERVATIONS) is p.texts["odometry"] and not {"fixes", "observation-sigma"} & {*given}
    if beside and "fixes" not in p.texts and _are_places(p.texts, p.columns, kind):
        p.files["fixes"], p.texts["fixes"] = p.files.pop(OBSERVATIONS), p.texts.pop(OBSERVATIONS)
        told = "x and y are places along which the odometry leads (--columns observations.x=NAME reads observations)"
        p.infer(f"--fixes {p.files['fixes']}, as its {told}")
    for role in (r for r in p.observing if r in p.texts):
        looked = seen_by_layout(p.texts[role], lambda: path_of(p.texts, p.columns, kind)) if role in unnamed else None
        if looked is not None:
            p.texts[role], told, of, before = looked
            p.columns.read |= {(p.texts[role].path, name) for name in before}
            p.columns.given = {key: name for key, name in p.columns.given.items() if key != f"{role}.frame"}
            p.columns.units.given.update({f"{role}.{q}": unit for q, unit in of.items()})
            p.infer(f"{told}, as which alone landmarks stand still", role)
            _take_stars(p, role)
        free = "map" in p.texts and not p.find(role, table_files.IDS)
        if free and (same := named_alike(p.texts[role], p.texts["map"])) is not None:
            p.columns.given = {**p.columns.given, f"{role}.label": same[0], "map.id": same[1]}
            p.infer(f"--columns {role}.label={same[0]},map.id={same[1]}, which hold the same names", role)


def _take_stars(p: _Parts, role: str) -> None:
    """A row for each observation of a table with columns for several, stated with stars or known by their names."""
    file, columns = p.texts[role], p.columns
    stated = {q: p.named.get(f"{role}.{q}", p.named.get(q, "")) for q in (*STARRED, *table_files.IDS)}
    deep = table_files.solid_stars(file, stated)
    stars = {q: n for q, n in {**stated, **deep}.items() if "*" in n}
    listed = {q: [table_files.column_of(file, k) for k in n.split(",")] for q, n in stated.items() if "," in n}
    if len({*map(len, listed.values())}) == 1 and not any(None in each for each in listed.values()):
        named = {j: f"{q}_{k}" for q, each in listed.items() for k, j in enumerate(each, start=1)}
        file = replace(file, names=tuple(named.get(j, name) for j, name in enumerate(file.names)), named=True)
        stars = {q: f"{q}_*" for q in listed}
    if deep:
        told = f"in {len(file)} rows; the odometry has {len(p.texts['odometry'])}"
        p.infer(f"--columns {','.join(f'{q}={n}' for q, n in deep.items())}, {told}")
    first = stated["range"] if stated["range"].isdecimal() and not file.named else ""
    if not stars and "".join(stated[q] for q in STARRED) == first:
        stars, why = table_files.stars(file), ""
        if not stars and "map" in p.texts and (first or not p.find(role, STARRED[:2])):
            places = columns.quiet.table(p.texts["map"], "map", XY)[0].stack(XY) / columns.units.factor(role, "range")
            if (found := ranges_in_columns(file, places, first)) is not None:
                p.texts.update({r: found[0] for r, table in p.texts.items() if table is file})
                file, stars, why = found[0], {"range": found[1]}, found[2]
        p.columns.notes += [f"inferred: --columns {','.join(f'{q}={n}' for q, n in stars.items())}{why}"] * bool(stars)
    if not stars:
        return
    seen = (j for star in stars.values() for j in table_files.starred(file.names, star).values())
    columns.read |= {(file.path, p.texts[role].names[j]) for j in seen}
    p.texts[role] = wide = table_files.unpivoted(file, stars)
    instant = any(columns.find(wide, role, q) is not None for q in ("t", "frame"))
    if not instant and len(file) == len(p.texts["odometry"]):
        p.texts[role] = wide.beside("frame", np.searchsorted(file.line, wide.line))
        p.infer(f"each of its {len(file)} rows is one of the odometry", role)
    columns.notes += [f"{file.path.name}: {wide.cut}"] * bool(wide.cut)
    if not {"label", "true_id"} & {*wide.names}:
        told = "filled from the left, so they are no labels (--columns label=NAME* names some)"
        p.infer(f"columns {', '.join(stars.values())} are {told}")
    taken = {*stars.values(), *(stated[q] for q in (*deep, *listed)), *[first] * bool(first)}
    columns.given = {k: n for k, n in columns.given.items() if n not in taken}


def _rates(p: _Parts, given: Given) -> Given:
    """The flags of speeds of wheels, where the name of their column is no count; of a stated heading."""
    others = [r for r in ("truth", "fixes") if r in p.texts and p.find(r, ("theta",))]
    if {"theta", "odometry.theta"} & {*p.columns.given} and not others:
        p.columns.given = {"odometry.theta" if q == "theta" else q: n for q, n in p.columns.given.items()}
        p.infer("the heading tells the turns, the wheels the way ahead alone", "odometry")
    if {"ticks", "odometry-kind"} & {*given}:
        return given
    name = p.texts["odometry"].names[p.columns.require(p.texts["odometry"], "odometry", ("left",))[0]]
    words, unit = words_of(name)
    told = {*table_files.SPEED} & {*re.findall(table_files.WHEEL, "".join(words))}
    if not told and "/" not in RATES.get(unit, unit):
        return given
    unit = unit or ("rad/s" if told & {*table_files.SPEED[-2:]} else "m/s")
    if "metres-per-tick" not in given and RATES.get(unit, unit).split("/")[0] in table_files.ANGLE:
        raise UsageError(f"{p.files['odometry']}: {name} is how fast a wheel turns; {motion.SAID['rates']}, and needed")
    metres = 1.0 if "metres-per-tick" in given else table_files.factor("length/time", unit, name)
    given = {"metres-per-tick": f"{metres:.9g}", **given, "ticks": "rate"}
    p.infer(f"--ticks rate --metres-per-tick {given['metres-per-tick']}, as {name} is a speed ({motion.SAID['rates']})")
    return given


def _laid_out(
    file: TextTable, role: str, columns: Columns, layout: tuple[TextTable, str, tuple[str, ...]]
) -> tuple[TextTable, str]:
    """The table of a role by its layout, and what is said: of a matrix beside others its columns are stated."""
    table, told, before = layout
    if not file.named or len(before) != len(table.names):
        columns.read |= {(file.path, name) for name in before}
        return table, told
    known = [(q, n) for q, n in zip(table.names, before, strict=True) if q in table_files.QUANTITIES]
    columns.given = {**columns.given, **{f"{role}.{q}": n for q, n in known}}
    return file, told


def _are_places(texts: Mapping[str, TextTable], columns: Columns, kind: str) -> bool:
    """Whether x, y beside an odometry are places in the world rather than observations of landmarks."""
    file, looked, wants = texts["odometry"], columns.quiet, ("t", "x", "y")
    others = ("range", "bearing", *table_files.IDS)
    alone = looked.has(file, OBSERVATIONS, wants) and not any(looked.has(file, OBSERVATIONS, (q,)) for q in others)
    alone &= not looked.has(file, "odometry", motion.pose_columns(file, looked, "odometry"))
    path = path_of(texts, columns, kind) if alone else None
    if path is None or columns.stated(OBSERVATIONS, wants):
        return False
    seen = looked.table(file, OBSERVATIONS, wants, may_be_blank=wants[1:])[0].stack(wants)
    seen = seen[np.isfinite(seen).all(axis=1)]
    pose, place = se2.interpolate(*path, seen[:, 0]), seen[:, 1:]
    off = se2.transform_points(np.tile(se2.rigid_fit(pose[:, :2], place), (len(place), 1)), pose[:, :2]) - place
    still = se2.transform_points(pose, place)
    step, own = (np.hypot(*np.diff(p, axis=0).T) for p in (place, pose[:, :2]))
    apart = np.median(np.abs(step - own)) > COPIED * np.median(own)
    return bool(apart and FITS * np.sum(off**2) < min(np.sum(np.var(p, axis=0)) * len(p) for p in (place, still)))


FITS, COPIED = 4.0, 1e-3  # How much less of the variance a fit leaves; share of steps by which a copy differs


def _kind(given: Given, texts: Mapping[str, TextTable], columns: Columns, role: str, known: Sequence[str]) -> str:
    """The kind of an odometry: the stated one, else by its columns."""
    if f"{role}-kind" in given:
        return table_files.one_of(given, f"{role}-kind", known)
    return kind_of(texts[role], columns, role, texts.get("truth"))


def _of_fixes(
    given: Given, files: Mapping[str, Path], texts: Mapping[str, TextTable], columns: Columns
) -> dict[str, Any]:
    """What is stated of fixes and closures; one sigma is that of x and y, unless it is an angle or there are none."""
    for role, flags in (("fixes", ("fix-sigma", "fix-lever", "fix-rotation")), ("closures", ("closure-sigma",))):
        for flag in flags:
            if flag in given and role not in files:
                raise UsageError(f"--{flag} {given[flag]}: there are none; --{role} FILE names them")
    found: dict[str, Any] = {}
    text = str(given.get("fix-sigma", ""))
    if len(table_files.words(text)) == 1 and not re.search("deg|rad|rev", text):
        place = columns.find(texts["fixes"], "fixes", "x")
        given = {**given, "fix-sigma": text if place is None else f"{text},{text}"}
    if "fix-sigma" in given:
        entries = {1: [2], 2: [0, 1]}.get(len(table_files.words(given["fix-sigma"])), [0, 1, 2])
        sigma = np.full(3, np.nan)
        what = "of x and y [m], of the heading [rad], or of all three, as in 0.5,0.5,2deg"
        sigma[entries] = _numbers(given, "fix-sigma", [POSE[k] for k in entries], what, zero=False)
        found["fix_sigma"] = sigma
    found["closure_sigma"] = numbers_of(given, "closure-sigma")
    if (lever := numbers_of(given, "fix-lever")) is not None:
        found["fix_lever"] = (float(lever[0]), float(lever[1]))
    if (rotation := numbers_of(given, "fix-rotation")) is not None:
        found["fix_rotation"] = float(rotation[0])
    return found


def _scanner(given: Given) -> Array | None:
    """First angle, step [rad] and reach [m] of a scanner, or the angles of all beams and the reach."""
    if "scanner" not in given or len(parts := table_files.words(given["scanner"])) < 4:
        return numbers_of(given, "scanner")
    return _numbers(given, "scanner", ("angle",) * (len(parts) - 1) + ("length",), "all angles and the reach")


def _offsets(given: Given, files: Mapping[str, Path], sensors: Collection[str]) -> dict[str, float]:
    """Seconds to add to the stamps, by role; sensors have one each."""
    found, known = {}, (*STAMPED, *sensors)
    for role, text in table_files.pairs(given.get("time-offset", {}), "time-offset").items():
        if role not in known:
            raise UsageError(f"--time-offset {role}={text}: {unknown(role, known)}")
        if role not in files:
            raise UsageError(f"--time-offset {role}={text}: there is no file of it; --{role} FILE names one")
        found[role] = table_files.quantity_with_unit(text, "time", f"--time-offset {role}")
    return found


def _wheels(given: Given, kind: str, columns: Columns) -> Wheels | None:
    ticks = dict.fromkeys(("track-width", "metres-per-tick", "tick-wrap", "ticks"), ("ticks", "wheel ticks"))
    for flag, (of, what) in {"wheel-base": ("car", "speed and steering"), **ticks}.items():
        if flag in given and kind != of:
            raise UsageError(f"--{flag} {given[flag]}: of {what}; the odometry has {kind}")
    if "wheel-base" in given:
        base = _numbers(given, "wheel-base", ("length",), "the distance between the axles", zero=False)
        return Wheels(float(base[0]), (1.0, 1.0))
    if kind != "ticks":
        return None
    turned = columns.stated("odometry", ("theta",))
    if "metres-per-tick" not in given or not (turned or "track-width" in given):
        raise UsageError(motion.SAID["ticks"])
    width = 0.0 if turned else float(_numbers(given, "track-width", ("length",), "the distance between the wheels")[0])
    text = given["metres-per-tick"]
    metres = table_files.numbers(
        text, ("length",) * (2 if len(table_files.words(text)) == 2 else 1), "metres-per-tick", "metres a tick"
    )
    if (width <= 0.0 and not turned) or (metres == 0.0).any():
        raise UsageError(f"--track-width {width:g} --metres-per-tick {text}: wheels apart, that move, are needed")
    wrap = str(given.get("tick-wrap", "0"))
    if not wrap.isdecimal():
        raise UsageError(f"--tick-wrap {wrap}: a whole number of ticks is needed, as in 65536")
    count = table_files.one_of(given, "ticks", ("total", "each", "rate"))
    each, rate, backward = count == "each", count == "rate", given.get("hold") == "backward"
    return Wheels(width, (float(metres[0]), float(metres[-1])), each, int(wrap), rate, backward)


def _second(given: Given, texts: Mapping[str, TextTable], columns: Columns) -> Second | None:
    """What is stated of a second odometry; None: there is none."""
    if SECOND not in texts:
        for flag in (f"{SECOND}-sigma", f"{SECOND}-kind", f"{SECOND}-noise"):
            if flag in given:
                raise UsageError(f"--{flag} {given[flag]}: there is none; --{SECOND} FILE names it")
        return None
    known = [kind for kind in KINDS if kind not in ("ticks", "car")]
    kind = _kind(given, texts, columns, SECOND, known)
    if kind not in known:
        what = f"{'wheel ' * (kind == 'ticks')}{kind}; {', '.join(known)} are needed, or make it the first"
        raise UsageError(f"--{SECOND} {given[SECOND]}: {what}")
    return Second(kind, _noise(given, kind, columns.notes, SECOND))


def _noise(given: Given, kind: str, notes: list[str], of: str = "odometry") -> Noises:
    """Odometry noise, by the kind of odometry, in flags that begin with `of`; a note where it is assumed."""
    stated = f"{of}-sigma"
    velocities = kind in motion.STAMPED
    default = "density" if velocities else "travel"
    known = ("density", "velocity", "displacement", "textbook") if velocities else ("travel", "step")
    model = str(given.get(f"{of}-noise", default))
    if model not in known:
        raise UsageError(f"--{of}-noise {model}: for {kind}{did_you_mean(model, known)}: {', '.join(known)}")
    what = motion.SAID[model]
    if stated not in given:
        if model not in ASSUMED:
            raise UsageError(f"unknown {of.replace('-', ' ')} noise; --{stated} is needed: {what}")
        given = {stated: ASSUMED[model]}
        notes.append(f"assumed: --{stated} {ASSUMED[model]}")
    text = given[stated]
    if model == "travel":
        return TravelNoise(*_numbers(given, stated, table_files.TRAVEL, what, zero=True).tolist())
    if model == "step":
        return StepNoise(*_numbers(given, stated, POSE, what, zero=True).tolist())
    if model in WITH_ALPHAS:
        count = 6 if model == "textbook" and len(table_files.words(text)) == 6 else 4
        return VelocityNoise(model, alphas=tuple(_numbers(given, stated, ("",) * count, what, zero=True).tolist()))
    sigma_v, sigma_omega = _numbers(given, stated, ("length", "angle"), what, zero=True).tolist()
    return VelocityNoise(model, sigma=(sigma_v, sigma_omega))


INTEGRATED = {"arc": "unicycle", "midpoint": "half_angle", "turn-first": "turn_first", "drive-first": "drive_first"}
"""Motion model by the order of turning and driving within a step."""
