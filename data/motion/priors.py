"""Priors of systematic errors: standard deviations, wide and tight, and their names.

Wide ones are for suspected errors, as large as robots have. Tight ones are for all errors at once without suspicion:
the remaining errors after calibration with a tape measure and a turn in place. Imports nothing heavy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from data.errors import UsageError, unknown

if TYPE_CHECKING:
    from data.inputs import Systematic


class Prior(NamedTuple):
    """Wide and tight standard deviation of an error, in its unit, and their reasons."""

    wide: float
    tight: float
    why: str


PRIORS = {
    "scale": Prior(0.1, 0.02, "a wheel radius out of a data sheet; measured over 10 m to 0.2 m"),
    "curvature": Prior(0.05, 0.002, "a steering 2 to 3° off centre at a 1 m wheelbase; 0.1° of it"),
    "left": Prior(0.1, 0.05, "a wheelbase to 10 %; to 5 %, as tyres carry on their whole width"),
    "right": Prior(0.1, 0.05, "as of turns to the left"),
    "drift": Prior(0.005, 0.001, "a road's camber or a play of 0.3° in the steering; 0.06° of it"),
    "range": Prior(0.1, 0.02, "a sensor whose unit or temperature is wrong; a data sheet's 2 %"),
    "bearing": Prior(0.1, 0.02, "mounted by eye, to 6°; mounted on an edge, to 1°"),
}  # By name, in the order of `data.inputs.ERRORS`. The drift has this size at any time, and a length of 50 m.
AUTO = "auto"  # Instead of names: those that the log suggests, else all


def read_errors(label: str, value: object) -> tuple[str, ...]:
    """`NAME[=SIGMA]`, separated by commas or as a list, in the order of the errors; `auto` alone. `true` is `auto`,
    `false` is none. UsageError for an unknown or repeated name, or an invalid sigma.
    """
    if isinstance(value, bool):
        return (AUTO,) if value else ()
    texts = [value] if isinstance(value, str) else value
    if not isinstance(texts, (list, tuple)) or not all(isinstance(t, str) for t in texts):
        raise UsageError(f"{label} {value!r}: names are needed, of {', '.join(PRIORS)}, or auto")
    given = [part.strip() for t in texts for part in t.split(",") if part.strip()]
    if given == [AUTO]:
        return (AUTO,)
    found: dict[str, str] = {}
    for part in given:
        name, equals, sigma = (each.strip() for each in part.partition("="))
        if name not in PRIORS:
            raise UsageError(f"{label} {part}: {unknown(name, PRIORS)}, each NAME or NAME=SIGMA; or auto")
        if name in found:
            raise UsageError(f"{label} {','.join(given)}: {name} is named twice")
        if equals and not 0.0 < _number(sigma) < math.inf:
            raise UsageError(f"{label} {part}: a positive prior sigma is needed")
        found[name] = f"{name}={sigma}" if equals else name
    if not found:
        raise UsageError(f"{label}: a name is needed, of {', '.join(PRIORS)}, or auto")
    return tuple(found[name] for name in PRIORS if name in found)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def written(names: Sequence[str], *, tight: bool = False) -> tuple[str, ...]:
    """Errors (in their order) with their priors, as `read_errors` reads them."""
    return tuple(f"{name}={p.tight if tight else p.wide:g}" for name, p in PRIORS.items() if name in names)


def systematic(stated: Sequence[str]) -> Systematic:
    """The errors from `read_errors`, with wide priors where no sigma is stated."""
    import numpy as np

    from data.inputs import Systematic

    halves = [text.partition("=") for text in stated]
    sigma = [float(s) if equals else PRIORS[name].wide for name, equals, s in halves]
    return Systematic(tuple(name for name, _, _ in halves), np.array(sigma))
