"""What of a `Trust` stands in sentences: numbers of filter and smoother, of the twins, and of what stands out.

Systematic errors and noises as a person says them: which way, how much, in which unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data.inputs import Inputs
from data.sensors import RangeBearing
from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, NOISE, POWER
from eval.referee.trust import Measured
from eval.replay.settings import ESTIMATORS, FILTERS
from eval.report.page.tables import number
from eval.studies.trusted import Blame, Trust

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


STANDS_OUT = 3.0
"""Standard errors from which a slope is named where there are no twins to judge it by."""
SYSTEMATIC = ("odometry_theta_turn", "odometry_x_distance", "odometry_theta_distance")
"""Systematic errors of the odometry whose power is told."""
HINT = "`--twins 100` says which of this is more than chance, and whose fault it is."


def online(trust: Trust) -> list[str]:
    """Estimators that have a distance from the smoothed path, filters first."""
    names = (*ESTIMATORS, *(name for name in trust.real.apart if name not in ESTIMATORS))
    found = [name for name in names if math.isfinite(trust.real.apart.get(name, math.nan))]
    return sorted(found, key=lambda name: name not in FILTERS)


def who(name: str) -> str:
    """An estimator by its kind and name."""
    return f"the filter ({name})" if name in FILTERS else f"the online path of {name}"


def length(value: float) -> str:
    """A distance, below a centimetre in millimetres."""
    return f"{number(1000.0 * value, 2)} mm" if 0.0 < value < 0.01 else f"{number(value)} m"


def apart(trust: Trust, name: str) -> str:
    """How far an estimator is from the smoothed path, beside the same of the twins."""
    text = f"{who(name)} and the smoother are {length(trust.real.apart[name])} RMS apart"
    twins = [s.apart[name] for s in trust.twins if math.isfinite(s.apart.get(name, math.nan))]
    if twins:
        text += f", on the twins {length(min(twins))} to {length(max(twins))}"
    elif trust.twins:
        text += f"; {name} was not run on the twins"
    return text


def _median(trust: Trust, name: str) -> Measured | None:
    """Median of the quadratic form of the difference; None if unknown."""
    median = trust.real.measured.get((name, "filter_smoother_median"))
    known = median is not None and math.isfinite(median.value) and math.isfinite(median.expected)
    return median if known else None


def _with_expected(median: Measured) -> str:
    return f"median dᵀ(P_f − P_s)⁻¹d of {number(median.value)} where {number(median.expected)} is expected"


def median_before_and_after(before: Trust, after: Trust, name: str) -> tuple[str, str]:
    """The median of the quadratic form after a calibration, and before; empty if one is unknown."""
    was, now = _median(before, name), _median(after, name)
    if was is None or now is None:
        return "", ""
    return f"their difference d then has a {_with_expected(now)}", number(was.value)


def quadratic(trust: Trust, name: str) -> str:
    """Median of the quadratic form of the difference, and how often P_f - P_s is semidefinite; empty if unknown."""
    parts = []
    median = _median(trust, name)
    if median is not None:
        parts.append(f"their difference d has a {_with_expected(median)}")
    share = trust.real.measured.get((name, "filter_smoother_semidefinite"))
    if share is not None and math.isfinite(share.value):
        parts.append(f"P_f − P_s is positive semidefinite in {100.0 * share.value:.3g} % of the frames")
    return ", and ".join(parts)


def standing_out(trust: Trust, terms: Terms, most: int) -> list[str]:
    """Systematic errors that residuals ask for beyond `STANDS_OUT` standard errors, each alone, largest first."""
    found = []
    for (_, name), m in trust.real.measured.items():
        if name.startswith("slope_") and math.isfinite(m.value) and math.isfinite(m.se) and m.se > 0.0:
            found.append((abs(m.value) / m.se, name.removeprefix("slope_"), m))
    found = sorted((f for f in found if f[0] > STANDS_OUT), key=lambda f: -f[0])
    return [f"{phrase(name, terms).sentence(m.value, m.se)} ({z:.0f} standard errors)" for z, name, m in found[:most]]


def outside(blame: Blame, twins: int) -> str:
    """How many statistics are outside what the twins show, and the smallest family-wise p."""
    count = f"{len(blame.objected)} of {blame.tested}" if blame.objected else f"none of {blame.tested}"
    verb = "lies" if len(blame.objected) <= 1 else "lie"
    p = f" ({'smallest ' if not blame.objected else ''}family-wise p {number(blame.p, 2)})"
    return f"{count} statistics {verb} outside what {twins} twins show{p if math.isfinite(blame.p) else ''}"


def culprit(cause: str) -> str:
    """What a cause is called."""
    return {NOISE: "the noise model", ASSOCIATIONS: "the associations", ESTIMATOR: "the estimator"}.get(
        cause, "nothing to object to"
    )


def power(blame: Blame, terms: Terms, *, brief: bool = False) -> str:
    """Sizes of faults that the log would have shown, one at a time (`brief`: three of them); empty if none is known."""
    turned = "z2_constant" if terms.polar else "z2_range"
    names = ("odometry_theta_turn", turned, "z1_range") if brief else (*SYSTEMATIC, turned, "z1_range")
    parts = []
    for name in names:
        size = blame.detectable.get(name, math.nan)
        if math.isfinite(size):
            said = phrase(name, terms)
            parts.append(f"{said.noun} of {with_unit(size, said.unit)}")
    for name in () if brief else ("z1", "z2", "odometry_theta"):
        factor = blame.detectable.get(f"residual_{name}_spread", math.nan)
        if math.isfinite(factor):
            least = "at least " if name.startswith("odometry") else ""
            parts.append(f"a noise of the {component(name, terms)} {least}{factor:.2f} times as large as stated")
    if not parts:
        return ""
    listed = f"{', '.join(parts[:-1])} or {parts[-1]}" if len(parts) > 1 else parts[0]
    return f"With {100.0 * POWER:.0f} % probability it would have shown {listed}"


def nees_on_twins(trust: Trust) -> str:
    """Mean pose NEES of the estimators over the twins, which have a truth; empty where unknown."""
    parts = []
    for name, phase in dict.fromkeys(k for s in trust.twins for k in s.nees):
        values = [s.nees[name, phase] for s in trust.twins if (name, phase) in s.nees]
        known = np.array([v for v in values if math.isfinite(v)])
        if len(known):
            parts.append(f"{number(float(known.mean()))} for {name} ({phase})")
    if not parts:
        return ""
    return f"The twins have a truth: mean pose NEES over them is {_listed(parts)}, where 3 is expected"


def deciding_on_twins(trust: Trust) -> str:
    """Mean confusion counts over the twins of a way of deciding; empty with labels and where there are none."""
    if trust.association == "known":
        return ""
    said: dict[str, list[str]] = {}
    for name in dict.fromkeys(n for s in trust.twins for n in s.counts):
        counts = np.array([s.counts[name] for s in trust.twins if name in s.counts], float)
        if not counts.sum() > 0.0:
            continue
        tp, tn, fp, fn = counts.mean(axis=0).tolist()
        right = 100.0 * (tp + tn) / (tp + tn + fp + fn)
        text = (
            f"{number(fp, 2)} wrong pairings (FP) and {number(fn, 2)} missed (FN) in {tp + tn + fp + fn:.0f} decisions,"
            f" {right:.1f} % as batch paired them"
        )
        said.setdefault(text, []).append(name)
    parts = [f"{text} ({', '.join(names)})" for text, names in said.items()]
    if not parts:
        return ""
    return f"Expected of `{trust.association}` on this geometry (mean over the twins): {'; '.join(parts)}"


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
