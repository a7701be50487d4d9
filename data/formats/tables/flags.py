"""The request of `python -m data.convert table`: flags or a mapping file, as values in SI units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data.errors import DataError, UsageError, did_you_mean, unknown
from data.formats.recordings.laser import TravelNoise
from data.formats.tables.files import ROLES, SECOND, Columns, Units, quantity_with_unit, read_text
from data.formats.tables.motion import KINDS, Wheels, kind_of
from data.formats.tables.second import Second
from data.formats.tables.sensors import (
    OF_SENSORS,
    SENSOR,
    TUNED,
    TableSensor,
    by_sensor,
    files_of,
    from_tables,
    sensors_of,
)
from data.formats.tables.values import POSE, STAMPED, TRAVEL, Given, numbers, one_of, pairs, sigmas
from data.motion.velocity import WITH_ALPHAS, VelocityNoise
from data.se2 import Array
from data.toml_table import load_toml

FROM_TRUTH = "truth"
"""The prior's mean is the first true pose."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """The request, in SI units.

    Attributes:
        files: path by role (odometry, observations or the name of a sensor, map, truth, fixes, closures).
        columns: columns and units.
        kind: of odometry; None: by its columns.
        wheels: of wheel ticks.
        noise: of the odometry; model: how velocities become increments.
        sensors: of observations; none where there are none.
        prior: mean (3,), "truth", or None: the frame of the log starts at the robot; prior_sigma (3,) or None.
        map_pose: (3,) pose of the map's frame in the world; truth_pose: of the truth's.
        every_row: every odometry row is a frame, not only those with observations.
        sensed: a sensor read the labels.
        backward: a row's velocities held since the row before; else until the next one.
        fix_sigma, closure_sigma: (3,) of x, y, theta where a row states none, NaN unknown; None: not stated.
        fix_lever, fix_rotation: place [m] and direction [rad] in the body frame of what measures the fixes.
        second: a second odometry; None: there is none.
    """

    files: Mapping[str, Path]
    columns: Columns
    kind: str | None
    wheels: Wheels | None
    noise: VelocityNoise | TravelNoise
    model: str
    sensors: tuple[TableSensor, ...]
    prior: Array | str | None
    prior_sigma: Array | None
    map_pose: Array
    truth_pose: Array
    every_row: bool
    sensed: bool
    backward: bool = False
    fix_sigma: Array | None = None
    closure_sigma: Array | None = None
    fix_lever: tuple[float, float] = (0.0, 0.0)
    fix_rotation: float = 0.0
    second: Second | None = None


TABLES = ("columns", "unit", "time-offset")
"""Flags of pairs KEY=VALUE, tables of a mapping file."""


def with_mapping(path: Path, given: Given, keys: Sequence[str]) -> dict[str, object]:
    """The flags and the keys of a mapping file, whose paths are relative to it; flags win. DataError for an invalid
    file.
    """
    merged: dict[str, object] = {}
    for key, value in load_toml(path, lambda what: DataError.at(path, what)).items():
        flag = key.replace("_", "-")
        if flag not in keys:
            raise DataError.at(path, f"key {key!r}: {unknown(flag, keys)}")
        if flag == SENSOR:
            for name, texts in from_tables(path, value).items():
                merged[name] = {**by_sensor(merged.get(name, {}), name), **texts}
        elif flag in TABLES:
            if not isinstance(value, dict):
                line = "truth = 0.5" if flag == "time-offset" else 't = "stamp"'
                raise DataError.at(path, f"{key}: a table is needed, as [{key}] with lines such as {line}")
            merged[flag] = dict(_flat(value))
        elif flag in OF_SENSORS and isinstance(value, str | int | float | list) and not isinstance(value, bool):
            text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
            merged[flag] = {"": text, **by_sensor(merged.get(flag, {}), flag)}
        elif isinstance(value, list):
            merged[flag] = ",".join(str(v) for v in value)
        elif isinstance(value, str | int | float) and not isinstance(value, bool):
            merged[flag] = str(path.parent / str(value)) if flag in ROLES else str(value)
        elif isinstance(value, bool) and flag == "labels-sensed":
            merged[flag] = value
        else:
            raise DataError.at(path, f"{key} = {value}: a text, a number or a list is needed")
    for key, value in given.items():
        read = pairs if key in TABLES else by_sensor if key in (SENSOR, *OF_SENSORS) else None
        merged[key] = value if read is None or key not in merged else {**read(merged[key], key), **read(value, key)}
    return merged


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
    units = Units(pairs(given.get("unit", {}), "unit"))
    columns = Columns(
        pairs(given.get("columns", {}), "columns"), units, _offsets(given, files, several), roles=(*ROLES, *several)
    )
    kind = given.get("odometry-kind")
    if kind is not None and kind not in KINDS:
        raise UsageError(f"--odometry-kind {kind}: {unknown(str(kind), KINDS)}")
    kind = kind_of(read_text(files["odometry"]), columns, None if kind is None else str(kind))
    second, spread = _second(given, files, columns), given.get("prior-sigma")
    return Wanted(
        files=files,
        columns=columns,
        kind=kind,
        wheels=_wheels(given, kind),
        noise=_noise(given, kind),
        model=_model(given, kind),
        sensors=sensors_of(given, files, columns),
        prior=_prior(given),
        prior_sigma=None if spread is None else sigmas(spread, POSE, "prior-sigma", "x and y [m], heading [rad]"),
        map_pose=_pose(given, "map-transform"),
        truth_pose=_pose(given, "truth-transform"),
        every_row=one_of(given, "frames", ("observations", "odometry")) == "odometry",
        sensed=bool(given.get("labels-sensed", False)),
        backward=_backward(given, kind),
        second=second,
        **_of_fixes(given, files),
    )


def _of_fixes(given: Given, files: Mapping[str, Path]) -> dict[str, Any]:
    """What is stated of fixes and closures."""
    for role, flags in (("fixes", ("fix-sigma", "fix-lever", "fix-rotation")), ("closures", ("closure-sigma",))):
        for flag in flags:
            if flag in given and role not in files:
                raise UsageError(f"--{flag} {given[flag]}: there are none; --{role} FILE names them")
    found: dict[str, Any] = {}
    if "fix-sigma" in given:
        text = given["fix-sigma"]
        count = len(str(text).replace(",", " ").split())
        entries = {1: [2], 2: [0, 1]}.get(count, [0, 1, 2])
        sigma = np.full(3, np.nan)
        what = "of x and y [m], of the heading [rad], or of all three, as in 0.5,0.5,2deg"
        sigma[entries] = sigmas(text, [POSE[k] for k in entries], "fix-sigma", what, zero=False)
        found["fix_sigma"] = sigma
    if "closure-sigma" in given:
        what = "of dx and dy [m] and of the turn [rad], as in 0.1,0.1,1deg"
        found["closure_sigma"] = sigmas(given["closure-sigma"], POSE, "closure-sigma", what, zero=False)
    if "fix-lever" in given:
        x, y = numbers(given["fix-lever"], ("length",) * 2, "fix-lever", "x and y [m] in the body frame").tolist()
        found["fix_lever"] = (x, y)
    if "fix-rotation" in given:
        what = "an angle [rad, or as in 90deg]"
        found["fix_rotation"] = float(numbers(given["fix-rotation"], ("angle",), "fix-rotation", what)[0])
    return found


def _offsets(given: Given, files: Mapping[str, Path], sensors: Collection[str]) -> dict[str, float]:
    """Seconds to add to the stamps, by role; sensors have one each."""
    found, known = {}, (*STAMPED, *sensors)
    for role, text in pairs(given.get("time-offset", {}), "time-offset").items():
        if role not in known:
            raise UsageError(f"--time-offset {role}={text}: {unknown(role, known)}")
        if role not in files:
            raise UsageError(f"--time-offset {role}={text}: there is no file of it; --{role} FILE names one")
        found[role] = quantity_with_unit(text, "time", f"--time-offset {role}")
    return found


def _backward(given: Given, kind: str) -> bool:
    if "hold" in given and kind != "velocities":
        raise UsageError(f"--hold {given['hold']}: the odometry has {kind}; velocities hold, between rows")
    return one_of(given, "hold", ("forward", "backward")) == "backward"


def _wheels(given: Given, kind: str) -> Wheels | None:
    if kind != "ticks":
        for flag in ("track-width", "metres-per-tick", "tick-wrap", "ticks"):
            if flag in given:
                raise UsageError(f"--{flag} {given[flag]}: of wheel ticks; the odometry has {kind}")
        return None
    if "track-width" not in given or "metres-per-tick" not in given:
        raise UsageError("wheel ticks: --track-width M and --metres-per-tick M (or LEFT,RIGHT) are needed")
    width = float(numbers(given["track-width"], ("length",), "track-width", "the distance between the wheels")[0])
    text = str(given["metres-per-tick"])
    count = len(text.replace(",", " ").split())
    metres = numbers(text, ("length",) * (2 if count == 2 else 1), "metres-per-tick", "metres a tick")
    if width <= 0.0 or (metres == 0.0).any():
        raise UsageError(f"--track-width {width:g} --metres-per-tick {text}: wheels apart, that move, are needed")
    wrap = str(given.get("tick-wrap", "0"))
    if not wrap.isdecimal():
        raise UsageError(f"--tick-wrap {wrap}: a whole number of ticks is needed, as in 65536")
    each = one_of(given, "ticks", ("total", "each")) == "each"
    return Wheels(width, (float(metres[0]), float(metres[-1])), each, int(wrap))


def _second(given: Given, files: Mapping[str, Path], columns: Columns) -> Second | None:
    """What is stated of a second odometry; None: there is none."""
    if SECOND not in files:
        for flag in (f"{SECOND}-sigma", f"{SECOND}-kind", f"{SECOND}-noise"):
            if flag in given:
                raise UsageError(f"--{flag} {given[flag]}: there is none; --{SECOND} FILE names it")
        return None
    known = [kind for kind in KINDS if kind != "ticks"]
    asked = given.get(f"{SECOND}-kind")
    if asked is not None and asked not in known:
        raise UsageError(f"--{SECOND}-kind {asked}: {unknown(str(asked), known)}")
    kind = kind_of(read_text(files[SECOND]), columns, None if asked is None else str(asked), SECOND)
    if kind == "ticks":
        raise UsageError(
            f"--{SECOND} {files[SECOND]}: wheel ticks; {', '.join(known)} are needed, or make it the first"
        )
    return Second(kind, _noise(given, kind, SECOND))


def _noise(given: Given, kind: str, of: str = "odometry") -> VelocityNoise | TravelNoise:
    """Odometry noise, by the kind of odometry, in flags that begin with `of`."""
    stated = f"{of}-sigma"
    velocities = kind == "velocities"
    default = "density" if velocities else "travel"
    known = ("density", "velocity", "displacement", "textbook") if velocities else ("travel",)
    model = str(given.get(f"{of}-noise", default))
    if model not in known:
        raise UsageError(f"--{of}-noise {model}: for {kind}{did_you_mean(model, known)}: {', '.join(known)}")
    what = {
        "density": "of v [m] and omega [rad], per square root of a second, as in 0.05,2deg",
        "velocity": "of v [m/s] and omega [rad/s], of each sample, as in 0.1,5deg",
        "displacement": "A1,A2,A3,A4: sigma_v = A1 |v| + A2 |omega|, sigma_omega = A3 |v| + A4 |omega|",
        "textbook": "A1,A2,A3,A4[,A5,A6]: sigma_v^2 = A1 v^2 + A2 omega^2, sigma_omega^2 = A3 v^2 + A4 omega^2, "
        "A5 v^2 + A6 omega^2 of a final rotation",
        "travel": "of travel [m] per sqrt(m) and per sqrt(rad), of the heading [rad] per sqrt(m) and per sqrt(rad); "
        f"{','.join(f'{n:g}' for n in TravelNoise())} was measured on a robot with wheels in an office",
    }[model]
    if stated not in given:
        hint = f"; {TUNED}" if of == "odometry" else ""
        raise UsageError(f"unknown {of.replace('-', ' ')} noise; --{stated} is needed: {what}{hint}")
    text = given[stated]
    if model == "travel":
        return TravelNoise(*sigmas(text, TRAVEL, stated, what).tolist())
    if model in WITH_ALPHAS:
        count = 6 if model == "textbook" and len(str(text).replace(",", " ").split()) == 6 else 4
        return VelocityNoise(model, alphas=tuple(sigmas(text, ("",) * count, stated, what).tolist()))
    sigma_v, sigma_omega = sigmas(text, ("length", "angle"), stated, what).tolist()
    return VelocityNoise(model, sigma=(sigma_v, sigma_omega))


INTEGRATED = {"arc": "unicycle", "midpoint": "half_angle", "turn-first": "turn_first", "drive-first": "drive_first"}
"""Motion model by the order of turning and driving within a step."""


def _model(given: Given, kind: str) -> str:
    """The motion model of velocities."""
    if "integrate" in given and kind != "velocities":
        raise UsageError(f"--integrate {given['integrate']}: for velocities; {kind} are integrated already")
    return INTEGRATED[one_of(given, "integrate", tuple(INTEGRATED))]


def _prior(given: Given) -> Array | str | None:
    if "prior" not in given or given["prior"] == FROM_TRUTH:
        return FROM_TRUTH if "prior" in given else None
    return numbers(given["prior"], POSE, "prior", "x, y [m], heading [rad], or the word truth")


def _pose(given: Given, flag: str) -> Array:
    return numbers(given.get(flag, "0,0,0"), POSE, flag, "x, y [m], angle [rad or as in 90deg]")
