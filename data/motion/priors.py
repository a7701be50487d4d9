"""What is known of systematic errors before a log is read: standard deviations, wide and tight, and how they are named.

Wide ones are for errors that somebody suspects, a person or the log: as large as robots have been seen to
err. Tight ones are for all errors at once where nothing is suspected: what a robot keeps that was calibrated with a
tape measure and a turn on the spot, so that little is lost where there is no error. Imports nothing heavy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from data.errors import UsageError

if TYPE_CHECKING:
    from data.inputs import Systematic


class Prior(NamedTuple):
    """Standard deviations of an error, wide and tight, in its unit, and what they stand for."""

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
}
"""By name, in the order of `data.inputs.ERRORS`. The drift's is its size at any time; it is forgotten over 50 m."""
AUTO = "auto"
"""Instead of names: those that the log names, else all."""


def read_errors(label: str, value: object) -> tuple[str, ...]:
    """`NAME[=SIGMA]`, separated by commas or as a list, in the order of the errors; `auto` stands alone.

    `true` is `auto`, `false` is none.

    Raises:
        UsageError: an unknown name, one given twice, a sigma that is no positive number.
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
            raise UsageError(f"{label} {part}: unknown; known: {', '.join(PRIORS)}, each NAME or NAME=SIGMA; or auto")
        if name in found:
            raise UsageError(f"{label} {','.join(given)}: {name} is named twice")
        if equals and not 0.0 < _number(sigma) < math.inf:
            raise UsageError(f"{label} {part}: the sigma before the log is read is a positive number")
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
    """Errors (in their order) with the priors that they get, as `read_errors` reads them."""
    return tuple(f"{name}={p.tight if tight else p.wide:g}" for name, p in PRIORS.items() if name in names)


def systematic(stated: Sequence[str]) -> Systematic:
    """The errors that `read_errors` read, with wide priors where no sigma is stated."""
    import numpy as np

    from data.inputs import Systematic

    halves = [text.partition("=") for text in stated]
    sigma = [float(s) if equals else PRIORS[name].wide for name, equals, s in halves]
    return Systematic(tuple(name for name, _, _ in halves), np.array(sigma))
