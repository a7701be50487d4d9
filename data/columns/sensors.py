"""Sensors of landmarks in `log.toml`, and what the rows of observations.csv measure with them (docs/log-folder.md)."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from data.columns import appearance as looks
from data.columns.appearance import Noise
from data.columns.named import covariances, names_of, or_blank, require_given, source_rows
from data.columns.scans import mounting
from data.csv_table import Table, is_name
from data.inputs import IntArray
from data.se2 import Array
from data.sensors import Bearing, Line, Range, RangeBearing, RelativePoint, Sensor
from data.toml_table import TomlTable, finite, positive

SENSOR = "sensor"
KEYS = (
    *("kind", "sigma", "max_range", "min_angle", "max_angle", "field_of_view"),
    *("rotation", "translation", "extrinsic", "name", "sees", *looks.KEYS),
)
KINDS: dict[str, Callable[..., Sensor]] = {s.name: s for s in (RangeBearing, RelativePoint, Line, Bearing, Range)}
FIRST = tuple(s.name for s in (RangeBearing, RelativePoint, Line))  # Kinds of format 1
NOISE = ("r11", "r12", "r22")


class Stated(NamedTuple):
    """A sensor, sigma (d,) of what it measures, None: not stated, and the noise of what landmarks look like."""

    sensor: Sensor
    sigma: Array | None
    looks: Noise = Noise()


def stated(top: TomlTable, *, first_format: bool) -> tuple[Stated, ...]:
    """The sensors that `log.toml` states, none where there is no such table; `first_format`: as format 1 has them."""
    several, one = isinstance(top.table.get(SENSOR), list), SENSOR in top
    tables = top.tables_of(SENSOR) if several else [top.table_of(SENSOR)] if one else []
    if first_format:
        for table in tables:
            for key in ("name", "sees", *looks.KEYS):
                if key in table:
                    raise table.error(key, "format = 2 is needed")
        if several:
            raise top.fault("[[sensor]] in format 1; format = 2, or one [sensor], is needed")
    names = names_of(tables) if len(tables) > 1 else [""] * len(tables)
    found = tuple(_sensor(table, name, first_format=first_format) for table, name in zip(tables, names, strict=True))
    if len({s.sensor.sees_points for s in found}) > 1:
        raise top.fault("[[sensor]]: lines beside points; landmarks are either walls or points")
    return found


def _sensor(table: TomlTable, name: str, *, first_format: bool) -> Stated:
    kind = KINDS[table.one_of("kind", FIRST if first_format else KINDS)]
    measured = len(kind().measures)
    sigma = None
    if "sigma" in table:
        what = "two numbers > 0 are" if measured == 2 else "one number > 0 is"
        sigma = table.numbers("sigma", measured, what, positive)
    max_range = table.number("max_range", math.inf, "a range > 0 [m]", lambda v: v > 0.0)
    low, high = _view(table)
    extrinsic = table.optional_table("extrinsic")
    if extrinsic is not None and ("rotation" in table or "translation" in table):
        raise table.error("extrinsic", "give rotation and translation here or in [sensor], not both")
    mounted = mounting(table if extrinsic is None else extrinsic)
    words = {key: table.text(key) for key in ("name", "sees") if key in table}
    for key, word in words.items():
        if not is_name(word):
            raise table.error(key, "a name without commas, quotes and outer spaces is needed")
    named = words.get("name", name), words.get("sees", "")
    return Stated(kind(max_range, low, high, *mounted, *named), sigma, looks.noise_of(table))


def _view(table: TomlTable) -> tuple[float, float]:
    """Smallest and largest angle [rad] of the field of view."""
    if "field_of_view" in table:
        if "min_angle" in table or "max_angle" in table:
            raise table.error("field_of_view", "give it or min_angle and max_angle, not both")
        what = "an opening angle above 0 and up to 2 pi (radians)"
        opening = table.number("field_of_view", math.inf, what, lambda v: 0.0 < v <= 2.0 * math.pi + 1e-9)
        return -0.5 * opening, 0.5 * opening
    low = table.number("min_angle", -math.pi, "a finite angle (radians)", finite)
    high = table.number("max_angle", math.pi, "a finite angle (radians)", finite)
    key = "min_angle" if "min_angle" in table else "max_angle"
    if low >= high:
        raise table.error(key, f"min_angle ({low!r}) must be smaller than max_angle ({high!r})")
    if high - low > 2.0 * math.pi + 1e-9:
        raise table.error(key, f"the field of view opens {high - low:.6g}, more than 2 pi; angles are in radians")
    return low, high


def may_be_blank(sensors: Sequence[Stated]) -> tuple[str, ...]:
    """Columns with fields that may be blank."""
    return () if len(sensors) == 1 and sensors[0].sensor.locates else ("z2", *NOISE, SENSOR)


def observed(table: Table, sensors: Sequence[Stated]) -> tuple[Array, Array, IntArray | None]:
    """Z (M, 2), R (M, 2, 2) with the row's or the sensor's noise, and the row (M,) of the sensor, None for one."""
    number = source_rows(table, [s.sensor.label for s in sensors], SENSOR, SENSOR)
    table.require_finite(("z1",))
    table.require_finite([n for n in ("z2", *NOISE) if n in table], blank=bool(may_be_blank(sensors)))
    table.together(NOISE)
    z = np.stack([table.get("z1"), table.get("z2")], axis=-1)
    ranged = np.array([not isinstance(s.sensor, RelativePoint | Bearing) for s in sensors])[number]
    table.require(~ranged | (z[:, 0] >= 0.0), "z1", "{} is a negative range")
    measured = np.array([[True, s.sensor.locates] for s in sensors])[number]
    sigma = np.full((len(sensors), 2), np.nan)
    for k, s in enumerate(sensors):
        if s.sigma is not None:
            sigma[k, : len(s.sigma)] = s.sigma
    place = [f"[[sensor]] {s.sensor.label!r}" if s.sensor.label else "[sensor]" for s in sensors]

    def kind(row: int) -> str:
        return str(sensors[number[row]].sensor.name)

    require_given(table, ("z1", "z2"), z, measured, kind)
    R = covariances(table, NOISE, measured, sigma[number], kind, lambda row: place[number[row]])
    z, alone = np.nan_to_num(z), ~measured[:, 1]
    R[alone, 1, 1] = 1.0
    second = np.array([s.sensor.measures == (1,) for s in sensors])[number]
    z[second], R[second] = z[second, ::-1], R[second, ::-1, ::-1]
    return z, R, number if len(sensors) > 1 else None


def columns_of(sensors: Sequence[Sensor], z: Array, R: Array, number: IntArray | None) -> dict[str, list[Any]]:
    """Columns by name, as `observed` reads them."""
    which = np.zeros(len(z), np.int64) if number is None else number
    place = np.array([s.measures[0] for s in sensors])[which]
    both = np.array([s.locates for s in sensors])[which]
    rows = np.arange(len(z))
    columns: dict[str, list[Any]] = {} if number is None else {SENSOR: [sensors[i].label for i in which.tolist()]}
    blank = (z[rows, place], z[:, 1], R[rows, place, place], R[:, 0, 1], R[:, 1, 1])
    for name, values in zip(("z1", "z2", *NOISE), blank, strict=True):
        columns[name] = or_blank(values, both | (name in ("z1", "r11")))
    return columns


def table_of(sensor: Sensor) -> dict[str, Any]:
    """The table [sensor], without noise."""
    keys = ("max_range", "min_angle", "max_angle", "rotation", "translation")
    named = {key: word for key, word in {"name": sensor.label, "sees": sensor.sees}.items() if word}
    return {"kind": sensor.name, **{key: getattr(sensor, key) for key in keys}, **named}
