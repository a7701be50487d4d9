"""What flags say of each sensor: its file, noise, place, view, and the kind of landmark that it sees.

Without `--sensor` there is one, whose observations are in the file of `--observations` (or of the odometry). With
`--sensor NAME=FILE` each has a file; flags of `OF_SENSORS` then are of one sensor (`--view camera=-30deg,30deg`) or of
all (`--view -30deg,30deg`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.columns.appearance import Noise
from data.csv_table import is_name
from data.errors import DataError, UsageError, unknown
from data.formats.tables.files import ROLES, Columns, TextTable, read_text
from data.formats.tables.values import POSE, Given, numbers, sigmas, words
from data.se2 import Array

SENSOR, OBSERVATIONS = "sensor", "observations"
LOOKS = {"descriptor": "descriptor-sigma", "class": "class-error"}
"""Columns of appearance, and the flag that states the noise of each; without it the column is not read."""
OF_SENSORS = ("observation-sigma", "sensor-pose", "max-range", "view", "sees", *LOOKS.values())
"""Flags with a value for each sensor."""
FILE = "file"
"""Key of a table [sensor.NAME] of a mapping file, beside those flags."""
TUNED = "`slamref tune LOG OUT` fits it afterwards where the log has labels"


@dataclass(frozen=True, eq=False)
class TableSensor:
    """A sensor of tables, in SI units.

    Attributes:
        role: of its file, among the files and in keys of columns: the name, or "observations" of the only one.
        name: blank: the only one.
        sigma: (2,) of an observation; alone: "range" or "bearing", where nothing else is measured.
        pose: (3,) in the body frame.
        max_range: m, view: rad, least and largest bearing; None: as observed.
        sees: kind of landmark; blank: all.
        looks: noise of descriptors and classes; what is None is not read.
    """

    role: str
    name: str
    sigma: Array
    alone: str | None
    pose: Array
    max_range: float | None
    view: tuple[float, float] | None
    sees: str
    looks: Noise

    @property
    def looked(self) -> tuple[str, ...]:
        """Columns of appearance to read."""
        return tuple(q for q, noise in zip(LOOKS, self.looks, strict=True) if noise is not None)

    @property
    def what(self) -> str:
        """Its observations, in a message."""
        return f"observations of {self.name}" if self.name else OBSERVATIONS


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


def from_tables(path: Path, tables: object) -> dict[str, dict[str, str]]:
    """The tables [sensor.NAME] of a mapping file as flags, by sensor; DataError for an unknown key."""
    found: dict[str, dict[str, str]] = {SENSOR: {}}
    if not isinstance(tables, Mapping):
        raise DataError.at(path, f'{SENSOR}: tables are needed, as [{SENSOR}.lidar] with file = "cones.csv"')
    for name, table in tables.items():
        where = f"[{SENSOR}.{name}]"
        if not isinstance(table, Mapping):
            raise DataError.at(path, f'{SENSOR}.{name}: a table is needed, as {where} with file = "cones.csv"')
        if FILE not in table:
            raise DataError.at(path, f'{where}: no {FILE}; as in {FILE} = "cones.csv"')
        for key, value in table.items():
            flag = key.replace("_", "-")
            if flag != FILE and flag not in OF_SENSORS:
                raise DataError.at(path, f"{where}: key {key!r}: {unknown(flag, (FILE, *OF_SENSORS))}")
            if isinstance(value, bool) or not isinstance(value, str | int | float | list):
                raise DataError.at(path, f"{where} {key} = {value}: a text, a number or a list is needed")
            text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            if flag == FILE:
                found[SENSOR][name] = str(path.parent / text)
            else:
                found.setdefault(flag, {})[name] = text
    return found


def sensors_of(given: Given, files: Mapping[str, Path], columns: Columns) -> tuple[TableSensor, ...]:
    """The sensors with a file among `files`, in their order. UsageError for missing or invalid values."""
    names = list(files_of(given))
    texts = {flag: by_sensor(given[flag], flag) for flag in OF_SENSORS if flag in given}
    for flag, found in texts.items():
        for name in found:
            if name and name not in names:
                known = unknown(name, names) if names else f"no sensor; --{SENSOR} {name}=FILE names one"
                raise UsageError(f"--{flag} {name}={found[name]}: {name!r} is {known}")
    roles = names or [role for role in (OBSERVATIONS,) if role in files]
    return tuple(_sensor(role, role if names else "", texts, files[role], columns) for role in roles)


def _sensor(role: str, name: str, texts: Mapping[str, Mapping[str, str]], path: Path, columns: Columns) -> TableSensor:
    """One of them, by what is stated of it, or else of all."""
    of = {flag: found.get(name, found.get("")) for flag, found in texts.items()}
    file = read_text(path)
    found = [q for q in ("range", "bearing") if columns.find(file, role, q) is not None]
    sigma = of.get("observation-sigma")
    alone = found[0] if len(found) == 1 and len(words(sigma or "")) == 1 else None
    sees = of.get("sees") or ""
    if "sees" in of and not is_name(sees):
        raise UsageError(f"--sees {sees}: a kind of landmark is needed, as in tree")
    return TableSensor(
        role, name, _observation_sigma(sigma, alone, name, polar=bool(found)), alone, _pose(of.get("sensor-pose")),
        _reach(of.get("max-range")), _view(of.get("view")), sees, _looks(of, role, file, columns),
    )  # fmt: skip


def _looks(of: Mapping[str, str | None], role: str, file: TextTable, columns: Columns) -> Noise:
    """The noise of descriptors and classes."""
    found: list[float | None] = []
    for (quantity, flag), high in zip(LOOKS.items(), (math.inf, 0.5), strict=True):
        given = of.get(flag)
        value = None if given is None else float(numbers(given, ("",), flag, "one number")[0])
        if value is not None and not 0.0 < value < high:
            right = "must be more than 0" if high == math.inf else "a probability above 0 and below 0.5 is needed"
            raise UsageError(f"--{flag} {given}: {right}")
        if value is not None and columns.find(file, role, quantity) is None:
            what = f"the {OBSERVATIONS} have no column {quantity}"
            raise UsageError(f"--{flag} {given}: {what}; --columns {role}.{quantity}=NAME names it")
        found.append(value)
    return Noise(*found)


def _observation_sigma(given: str | None, alone: str | None, name: str, *, polar: bool) -> Array:
    """Standard deviations (2,), 1 in the place of what is not measured."""
    flag, of = "observation-sigma", f" of {name}" if name else ""
    if alone is not None:
        dimension, what = ("length", "of a range alone [m]") if alone == "range" else ("angle", "of a bearing [rad]")
        one = sigmas(given, (dimension,), flag, what, zero=False)
        return np.concatenate([one, [1.0]] if alone == "range" else [[1.0], one])
    what = "of a range [m] and a bearing [rad], as in 0.1,2deg" if polar else "of x and y [m], as in 0.1,0.1"
    if given is None:
        form = f" {name}=S1,S2" if name else ""
        raise UsageError(f"unknown observation noise{of}; --{flag}{form} is needed: {what}; {TUNED}")
    return sigmas(given, ("length", "angle" if polar else "length"), flag, what, zero=False)


def _pose(given: str | None) -> Array:
    return numbers(given or "0,0,0", POSE, "sensor-pose", "x, y [m], angle [rad or as in 90deg]")


def _reach(given: str | None) -> float | None:
    if given is None:
        return None
    reach = float(numbers(given, ("length",), "max-range", "metres")[0])
    if reach <= 0.0:
        raise UsageError(f"--max-range {given}: must be more than 0")
    return reach


def _view(given: str | None) -> tuple[float, float] | None:
    if given is None:
        return None
    low, high = numbers(given, ("angle",) * 2, "view", "least and largest bearing, as in -60deg,60deg").tolist()
    if not low < high:
        raise UsageError(f"--view {given}: the smaller bearing first")
    return low, high
