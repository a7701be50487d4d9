"""Systematic errors and noises as a person says them: which way, how much, in which unit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from data.inputs import Inputs
from data.sensors import RangeBearing
from eval.page.numbers import number

DEGREES = 180.0 / math.pi
SHARE, ANGLE = ("%", 100.0), ("°", DEGREES)
METRES, SECONDS = ("m", 1.0), ("s", 1.0)
CURVATURE, DRIFT = ("rad/m", 1.0), ("rad/s", 1.0)
PER_FRAME = {SECONDS: ("frames", 1.0), DRIFT: ("rad/frame", 1.0)}
"""Units of a log without stamps, whose time is the number of the frame."""


@dataclass(frozen=True)
class Phrase:
    """A systematic error, said of a log that states more than is true, and of one that states less.

    Attributes:
        noun: the error without a size.
        more, less: sentences with `{}` for the size.
        unit: and its factor from SI.
    """

    noun: str
    more: str
    less: str
    unit: tuple[str, float]

    def sentence(self, size: float, error: float) -> str:
        """Which way the log errs, and how much."""
        return (self.more if size > 0.0 else self.less).format(with_error(abs(size), error, self.unit))


def _sides(noun: str, text: str, unit: tuple[str, float], more: str, less: str) -> Phrase:
    return Phrase(noun, f"{text} {more}", f"{text} {less}", unit)


ODOMETRY = {
    "odometry_x_distance": _sides(
        "a wrong scale of the odometry's distances", "odometry states distances {} too", SHARE, "long", "short"
    ),
    "odometry_x_turn": _sides(
        "odometry of a point beside the robot's own", "odometry is that of a point {} to the", METRES,
        "right of the robot's own", "left of the robot's own",
    ),
    "odometry_y_distance": _sides(
        "odometry askew to the way driven", "odometry points {} to the", ANGLE,
        "left of the way driven", "right of the way driven",
    ),
    "odometry_y_turn": _sides(
        "odometry of a point ahead of or behind the robot's own", "odometry is that of a point {}", METRES,
        "ahead of the robot's own", "behind the robot's own",
    ),
    "odometry_theta_distance": _sides(
        "a curvature of the odometry", "odometry curves {} more to the", CURVATURE,
        "left than the way driven", "right than the way driven",
    ),
    "odometry_theta_turn": _sides(
        "a wrong scale of the odometry's turns", "odometry turns {}", SHARE,
        "more than the robot did", "less than the robot did",
    ),
    "odometry_theta_time": _sides(
        "a drift of the odometry's heading", "the odometry's heading drifts {} to the", DRIFT, "left", "right"
    ),
}  # fmt: skip
POLAR = {
    "z1_constant": _sides("a bias of the ranges", "ranges are {} too", METRES, "long", "short"),
    "z1_range": _sides("a wrong scale of the ranges", "ranges grow {} too", SHARE, "fast", "slowly"),
    "z2_constant": _sides("a bias of the bearings", "bearings are {} too far to the", ANGLE, "left", "right"),
    "z2_range": _sides(
        "bearings that turn with the range", "bearings turn {} to the", CURVATURE,
        "left as the range grows", "right as the range grows",
    ),
}  # fmt: skip
POINTS = {
    "z1_constant": _sides("a bias of the readings' x", "the readings' x is {} too", METRES, "large", "small"),
    "z1_range": _sides("a wrong scale of the readings", "readings grow {} too", SHARE, "fast", "slowly"),
    "z2_constant": _sides("a bias of the readings' y", "the readings' y is {} too", METRES, "large", "small"),
    "z2_range": _sides(
        "a sensor turned on its mount", "readings are turned {}", ANGLE, "counter-clockwise", "clockwise"
    ),
}  # fmt: skip
SHOWN_BY = {"speed": "the robot's motion", "turn_rate": "its turning"}
"""What of the motion shows that readings are late."""


@dataclass(frozen=True)
class Terms:
    """What a log's numbers are called: readings ranges and bearings (else points), time in seconds (else frames)."""

    polar: bool = True
    stamped: bool = True


def terms_of(inputs: Inputs) -> Terms:
    """The terms of a log."""
    return Terms(isinstance(inputs.sensor, RangeBearing), not inputs.time_is_index)


def component(name: str, terms: Terms) -> str:
    """A component of increments or readings, as the noun whose noise is spoken of."""
    readings = ("ranges", "bearings") if terms.polar else ("readings' x", "readings' y")
    return {
        "odometry_x": "odometry's forward motion", "odometry_y": "odometry's sideways motion",
        "odometry_theta": "odometry's heading", "z1": readings[0], "z2": readings[1],
    }[name]  # fmt: skip


def phrase(name: str, terms: Terms) -> Phrase:
    """How a systematic error `<component>_<regressor>` of `eval.referee.effects` is said."""
    said = _phrase(name, terms)
    if not terms.stamped and said.unit in PER_FRAME:
        return replace(said, unit=PER_FRAME[said.unit])
    return said


def _phrase(name: str, terms: Terms) -> Phrase:
    known = {**ODOMETRY, **(POLAR if terms.polar else POINTS)}
    if name in known:
        return known[name]
    which, regressor = name.split("_", 1)
    what = component(which, terms)
    late = what if terms.polar else f"the {what}"
    verb = "are" if terms.polar else "is"
    text, shown = f"{late} {verb} {{}}", f"than stamped, as {SHOWN_BY[regressor]} shows"
    return _sides(f"{late} stamped at the wrong instant", text, SECONDS, f"older {shown}", f"newer {shown}")


def with_unit(value: float, unit: tuple[str, float], digits: int = 2) -> str:
    """A size in a unit, (its name, its factor from SI)."""
    name, factor = unit
    return f"{number(factor * value, digits)}{'' if name == '°' else ' '}{name}"


def with_error(value: float, error: float, unit: tuple[str, float]) -> str:
    """A size with its standard error to the same decimals, in its unit; without an error to three digits."""
    name, factor = unit
    if not (math.isfinite(error) and error > 0.0):
        return with_unit(value, unit, 3)
    # two digits of an error that begins with 1: half of it would be lost in rounding
    exponent = math.floor(math.log10(factor * error))
    places = max(-exponent + (factor * error < 1.95 * 10.0**exponent), 0)
    space = "" if name == "°" else " "
    return f"{factor * value:.{places}f}{space}{name} ± {factor * error:.{places}f}{space}{name}"


def factor_words(factor: float) -> str:
    """What the noise is, of what is stated: too large or too small by how much."""
    by, word = (1.0 / factor, "large") if factor < 1.0 else (factor, "small")
    return f"{by:.2f} times too {word}" if by < 1.995 else f"{number(by, 2)} times too {word}"


def noise_words(name: str, factor: float, terms: Terms) -> str:
    """A wrong noise: of which component, and how it is stated."""
    return f"the noise (σ) of the {component(name, terms)} is stated {factor_words(factor)}"
