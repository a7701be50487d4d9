"""The request of `python -m data.convert table`: flags or a mapping file, as values in SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data.errors import DataError, UsageError, did_you_mean, unknown
from data.formats.open_log.appearance import Noise
from data.formats.recordings.laser import TravelNoise
from data.formats.tables.files import ROLES, Columns, TextTable, Units, quantity_with_unit, read_text
from data.formats.tables.motion import KINDS, Wheels, kind_of
from data.motion.velocity import WITH_ALPHAS, VelocityNoise
from data.se2 import Array
from data.toml_table import load_toml

UNSTATED = Noise()
FROM_TRUTH = "truth"
"""The prior's mean is the first true pose."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """The request, in SI units.

    Attributes:
        files: path by role (odometry, observations, map, truth).
        columns: columns and units.
        kind: of odometry; None: by its columns.
        wheels: of wheel ticks.
        noise: of the odometry; model: how velocities become increments.
        sigma: (2,) of an observation; alone: "range" or "bearing", where nothing else is measured.
        prior: mean (3,), "truth", or None: the frame of the log starts at the robot; prior_sigma (3,) or None.
        map_pose: (3,) pose of the map's frame in the world; truth_pose: of the truth's.
        every_row: every odometry row is a frame, not only those with observations.
        max_range: m, view: rad, least and largest bearing; None: as observed.
        sensor_pose: (3,) of the sensor in the body frame.
        sensed: a sensor read the labels.
        backward: a row's velocities held since the row before; else until the next one.
        fix_sigma, closure_sigma: (3,) of x, y, theta where a row states none, NaN unknown; None: not stated.
        looks: noise of descriptors and classes; what is None is not read.
        fix_lever, fix_rotation: place [m] and direction [rad] in the body frame of what measures the fixes.
    """

    files: Mapping[str, Path]
    columns: Columns
    kind: str | None
    wheels: Wheels | None
    noise: VelocityNoise | TravelNoise
    model: str
    sigma: Array
    prior: Array | str | None
    prior_sigma: Array | None
    map_pose: Array
    truth_pose: Array
    every_row: bool
    max_range: float | None
    view: tuple[float, float] | None
    sensor_pose: Array
    sensed: bool
    backward: bool = False
    alone: str | None = None
    fix_sigma: Array | None = None
    closure_sigma: Array | None = None
    fix_lever: tuple[float, float] = (0.0, 0.0)
    fix_rotation: float = 0.0
    looks: Noise = UNSTATED


TABLES = ("columns", "unit", "time-offset")
"""Flags of pairs KEY=VALUE, tables of a mapping file."""
STAMPED = ("odometry", "observations", "truth", "fixes", "closures")
"""Roles of files with stamps."""
POSE = ("length", "length", "angle")
TRAVEL = ("length", "length", "angle", "angle")
TUNED = "`slamref tune LOG OUT` fits it afterwards where the log has labels"

Given = Mapping[str, object]
"""Texts by flag (without leading dashes), `columns` and `unit` as text or as a table of texts."""


def with_mapping(path: Path, given: Given, keys: Sequence[str]) -> dict[str, object]:
    """The flags and the keys of a mapping file, whose paths are relative to it; flags win. DataError for an invalid
    file.
    """
    merged: dict[str, object] = {}
    for key, value in load_toml(path, lambda what: DataError.at(path, what)).items():
        flag = key.replace("_", "-")
        if flag not in keys:
            raise DataError.at(path, f"key {key!r}: {unknown(flag, keys)}")
        if flag in TABLES:
            if not isinstance(value, dict):
                line = "truth = 0.5" if flag == "time-offset" else 't = "stamp"'
                raise DataError.at(path, f"{key}: a table is needed, as [{key}] with lines such as {line}")
            merged[flag] = dict(_flat(value))
        elif isinstance(value, list):
            merged[flag] = ",".join(str(v) for v in value)
        elif isinstance(value, str | int | float) and not isinstance(value, bool):
            merged[flag] = str(path.parent / str(value)) if flag in ROLES else str(value)
        elif isinstance(value, bool) and flag == "labels-sensed":
            merged[flag] = value
        else:
            raise DataError.at(path, f"{key} = {value}: a text, a number or a list is needed")
    for key, value in given.items():
        both = key in TABLES and key in merged
        merged[key] = {**pairs(merged[key], key), **pairs(value, key)} if both else value
    return merged


def _flat(table: Mapping[str, object], above: str = "") -> list[tuple[str, str]]:
    """Dotted keys of nested tables."""
    flat: list[tuple[str, str]] = []
    for key, value in table.items():
        flat += _flat(value, f"{above}{key}.") if isinstance(value, dict) else [(f"{above}{key}", str(value))]
    return flat


def pairs(value: object, flag: str) -> dict[str, str]:
    """`a=b,c=d` (or several such texts, or a table) as a dict."""
    if isinstance(value, Mapping):
        return {str(k): str(v) for k, v in value.items()}
    texts = value if isinstance(value, list) else [str(value)]
    found: dict[str, str] = {}
    for part in [p.strip() for text in texts for p in str(text).split(",") if p.strip()]:
        key, equals, name = part.partition("=")
        if not (key.strip() and equals and name.strip()):
            right = "KEY=NAME is needed, as in t=stamp (names with commas: in a mapping file)"
            if flag == "time-offset":
                right = f"PART=SECONDS is needed, as in truth=-0.5, of {', '.join(STAMPED)}"
            raise UsageError(f"--{flag} {part}: {right}")
        if key.strip() in found:
            raise UsageError(f"--{flag}: {key.strip()} is named twice")
        found[key.strip()] = name.strip()
    return found


def numbers(text: object, dimensions: Sequence[str], flag: str, what: str) -> Array:
    """Numbers with or without units, one for each dimension; `what` describes them in a message."""
    parts = [p for p in str(text).replace(",", " ").split() if p]
    if len(parts) != len(dimensions):
        raise UsageError(f"--{flag} {text}: {len(dimensions)} numbers are needed: {what}")
    return np.array([quantity_with_unit(p, d, f"--{flag}") for p, d in zip(parts, dimensions, strict=True)])


def _sigmas(text: object, dimensions: Sequence[str], flag: str, what: str, *, zero: bool = True) -> Array:
    found = numbers(text, dimensions, flag, what)
    if (found < 0.0).any() or (not zero and (found == 0.0).any()):
        raise UsageError(f"--{flag} {text}: must be {'0 or more' if zero else 'more than 0'}")
    return found


def settle(given: Given) -> Wanted:
    """The request in SI units; UsageError for missing, unknown or invalid values."""
    files = {role: Path(str(given[role])) for role in ROLES if given.get(role) is not None}
    if "odometry" not in files:
        raise UsageError('a mapping file names the file with the odometry: odometry = "FILE"')
    units = Units(pairs(given.get("unit", {}), "unit"))
    columns = Columns(pairs(given.get("columns", {}), "columns"), units, _offsets(given, files))
    kind = given.get("odometry-kind")
    if kind is not None and kind not in KINDS:
        raise UsageError(f"--odometry-kind {kind}: {unknown(str(kind), KINDS)}")
    kind = kind_of(read_text(files["odometry"]), columns, None if kind is None else str(kind))
    seen = read_text(files["observations"]) if "observations" in files else None
    found = [q for q in ("range", "bearing") if seen is not None and columns.find(seen, "observations", q) is not None]
    alone = found[0] if len(found) == 1 and len(_words(given.get("observation-sigma", ""))) == 1 else None
    spread = given.get("prior-sigma")
    return Wanted(
        files=files,
        columns=columns,
        kind=kind,
        wheels=_wheels(given, kind),
        noise=_noise(given, kind),
        model=_model(given, kind),
        alone=alone,
        sigma=np.ones(2) if seen is None else _observation_sigma(given, alone, polar=bool(found)),
        prior=_prior(given),
        prior_sigma=None if spread is None else _sigmas(spread, POSE, "prior-sigma", "x and y [m], heading [rad]"),
        map_pose=_pose(given, "map-transform"),
        truth_pose=_pose(given, "truth-transform"),
        every_row=_one_of(given, "frames", ("observations", "odometry")) == "odometry",
        max_range=_reach(given),
        view=_view(given),
        sensor_pose=_pose(given, "sensor-pose"),
        sensed=bool(given.get("labels-sensed", False)),
        backward=_backward(given, kind),
        **_of_fixes(given, files),
        looks=_of_looks(given, seen, columns),
    )


def _of_looks(given: Given, seen: TextTable | None, columns: Columns) -> Noise:
    """The noise of descriptors and classes of observations."""
    found: dict[str, float] = {}
    for quantity, flag, high in (("descriptor", "descriptor-sigma", math.inf), ("class", "class-error", 0.5)):
        if flag not in given:
            continue
        value = float(numbers(given[flag], ("",), flag, "one number")[0])
        if not 0.0 < value < high:
            right = "must be more than 0" if high == math.inf else "a probability above 0 and below 0.5 is needed"
            raise UsageError(f"--{flag} {given[flag]}: {right}")
        if seen is None or columns.find(seen, "observations", quantity) is None:
            what = f"the observations have no column {quantity}"
            raise UsageError(f"--{flag} {given[flag]}: {what}; --columns observations.{quantity}=NAME names it")
        found["sigma" if quantity == "descriptor" else "error"] = value
    return Noise(**found)


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
        sigma[entries] = _sigmas(text, [POSE[k] for k in entries], "fix-sigma", what, zero=False)
        found["fix_sigma"] = sigma
    if "closure-sigma" in given:
        what = "of dx and dy [m] and of the turn [rad], as in 0.1,0.1,1deg"
        found["closure_sigma"] = _sigmas(given["closure-sigma"], POSE, "closure-sigma", what, zero=False)
    if "fix-lever" in given:
        x, y = numbers(given["fix-lever"], ("length",) * 2, "fix-lever", "x and y [m] in the body frame").tolist()
        found["fix_lever"] = (x, y)
    if "fix-rotation" in given:
        what = "an angle [rad, or as in 90deg]"
        found["fix_rotation"] = float(numbers(given["fix-rotation"], ("angle",), "fix-rotation", what)[0])
    return found


def _offsets(given: Given, files: Mapping[str, Path]) -> dict[str, float]:
    """Seconds to add to the stamps, by role."""
    found = {}
    for role, text in pairs(given.get("time-offset", {}), "time-offset").items():
        if role not in STAMPED:
            raise UsageError(f"--time-offset {role}={text}: {unknown(role, STAMPED)}")
        if role not in files:
            raise UsageError(f"--time-offset {role}={text}: there is no file of it; --{role} FILE names one")
        found[role] = quantity_with_unit(text, "time", f"--time-offset {role}")
    return found


def _backward(given: Given, kind: str) -> bool:
    if "hold" in given and kind != "velocities":
        raise UsageError(f"--hold {given['hold']}: the odometry has {kind}; velocities hold, between rows")
    return _one_of(given, "hold", ("forward", "backward")) == "backward"


def _one_of(given: Given, flag: str, known: Sequence[str]) -> str:
    value = str(given.get(flag, known[0]))
    if value not in known:
        raise UsageError(f"--{flag} {value}: {unknown(value, known)}")
    return value


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
    each = _one_of(given, "ticks", ("total", "each")) == "each"
    return Wheels(width, (float(metres[0]), float(metres[-1])), each, int(wrap))


def _noise(given: Given, kind: str) -> VelocityNoise | TravelNoise:
    """Odometry noise, by the kind of odometry."""
    velocities = kind == "velocities"
    default = "density" if velocities else "travel"
    known = ("density", "velocity", "displacement", "textbook") if velocities else ("travel",)
    model = str(given.get("odometry-noise", default))
    if model not in known:
        raise UsageError(f"--odometry-noise {model}: for {kind}{did_you_mean(model, known)}: {', '.join(known)}")
    what = {
        "density": "of v [m] and omega [rad], per square root of a second, as in 0.05,2deg",
        "velocity": "of v [m/s] and omega [rad/s], of each sample, as in 0.1,5deg",
        "displacement": "A1,A2,A3,A4: sigma_v = A1 |v| + A2 |omega|, sigma_omega = A3 |v| + A4 |omega|",
        "textbook": "A1,A2,A3,A4[,A5,A6]: sigma_v^2 = A1 v^2 + A2 omega^2, sigma_omega^2 = A3 v^2 + A4 omega^2, "
        "A5 v^2 + A6 omega^2 of a final rotation",
        "travel": "of travel [m] per sqrt(m) and per sqrt(rad), of the heading [rad] per sqrt(m) and per sqrt(rad); "
        f"{','.join(f'{n:g}' for n in TravelNoise())} was measured on a robot with wheels in an office",
    }[model]
    if "odometry-sigma" not in given:
        raise UsageError(f"unknown odometry noise; --odometry-sigma is needed: {what}; {TUNED}")
    text = given["odometry-sigma"]
    if model == "travel":
        return TravelNoise(*_sigmas(text, TRAVEL, "odometry-sigma", what).tolist())
    if model in WITH_ALPHAS:
        count = 6 if model == "textbook" and len(str(text).replace(",", " ").split()) == 6 else 4
        return VelocityNoise(model, alphas=tuple(_sigmas(text, ("",) * count, "odometry-sigma", what).tolist()))
    sigma_v, sigma_omega = _sigmas(text, ("length", "angle"), "odometry-sigma", what).tolist()
    return VelocityNoise(model, sigma=(sigma_v, sigma_omega))


INTEGRATED = {"arc": "unicycle", "midpoint": "half_angle", "turn-first": "turn_first", "drive-first": "drive_first"}
"""Motion model by the order of turning and driving within a step."""


def _model(given: Given, kind: str) -> str:
    """The motion model of velocities."""
    if "integrate" in given and kind != "velocities":
        raise UsageError(f"--integrate {given['integrate']}: for velocities; {kind} are integrated already")
    return INTEGRATED[_one_of(given, "integrate", tuple(INTEGRATED))]


def _words(text: object) -> list[str]:
    return str(text).replace(",", " ").split()


def _observation_sigma(given: Given, alone: str | None, *, polar: bool) -> Array:
    """Standard deviations (2,), 1 in the place of what is not measured."""
    if alone is not None:
        dimension, what = ("length", "of a range alone [m]") if alone == "range" else ("angle", "of a bearing [rad]")
        one = _sigmas(given["observation-sigma"], (dimension,), "observation-sigma", what, zero=False)
        return np.concatenate([one, [1.0]] if alone == "range" else [[1.0], one])
    what = "of a range [m] and a bearing [rad], as in 0.1,2deg" if polar else "of x and y [m], as in 0.1,0.1"
    if "observation-sigma" not in given:
        raise UsageError(f"unknown observation noise; --observation-sigma is needed: {what}; {TUNED}")
    dimensions = ("length", "angle" if polar else "length")
    return _sigmas(given["observation-sigma"], dimensions, "observation-sigma", what, zero=False)


def _prior(given: Given) -> Array | str | None:
    if "prior" not in given or given["prior"] == FROM_TRUTH:
        return FROM_TRUTH if "prior" in given else None
    return numbers(given["prior"], POSE, "prior", "x, y [m], heading [rad], or the word truth")


def _pose(given: Given, flag: str) -> Array:
    return numbers(given.get(flag, "0,0,0"), POSE, flag, "x, y [m], angle [rad or as in 90deg]")


def _reach(given: Given) -> float | None:
    if "max-range" not in given:
        return None
    reach = float(numbers(given["max-range"], ("length",), "max-range", "metres")[0])
    if reach <= 0.0:
        raise UsageError(f"--max-range {given['max-range']}: must be more than 0")
    return reach


def _view(given: Given) -> tuple[float, float] | None:
    if "view" not in given:
        return None
    low, high = numbers(given["view"], ("angle",) * 2, "view", "least and largest bearing, as in -60deg,60deg").tolist()
    if not low < high:
        raise UsageError(f"--view {given['view']}: the smaller bearing first")
    return low, high
