"""Units of stamps: stated, or inferred from their size and rate.

Stamps since 1970 tell their unit by their size. Others tell it by their rate: trajectories have poses between 10 kHz
and one in 5 s. A stated unit that neither allows is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data.errors import DataError
from data.se2 import Array

DIGITS = {"s": 0, "ms": 3, "us": 6, "ns": 9}
STATED, SIZE, RATE, ASSUMED, ROWS = "stated", "size", "rate", "assumed", "rows"
EPOCH = (1e8, 4.2e9)
"""s since 1970 of years 1973 to 2103."""
STEPS = (1e-4, 5.0)
"""s, intervals between successive poses of a trajectory."""
SLOWEST, ABSURD = 600.0, 1e-5
"""s, largest interval beside a stamp since 1970, and smallest interval that a stated unit may give."""


@dataclass(frozen=True)
class Clock:
    """Unit of stamps, and how it is known: `STATED`, by `SIZE`, by `RATE`, or `ASSUMED`; `ROWS`: none, a row's
    number is its stamp.
    """

    unit: str = "s"
    by: str = ASSUMED

    @property
    def words(self) -> str:
        """For the kind of a file."""
        if self.by == ROWS:
            return "without stamps"
        how = {SIZE: " by their size", RATE: " by their rate"}.get(self.by, "")
        return f"stamps in {self.unit}{how}"


def clock_of(file: str, stamps: Array, stated: str | None, usual: str = "s") -> Clock:
    """The unit of ascending stamps (n,); `usual` where they do not tell.

    DataError for a stated unit that stamps contradict.
    """
    finite = stamps[np.isfinite(stamps)]
    steps = np.diff(finite)
    steps = steps[steps > 0.0]
    step = float(np.median(steps)) if len(steps) else None
    since = float(np.min(np.abs(finite))) if len(finite) else 0.0

    def epoch(unit: str) -> bool:
        scale = 10.0 ** -DIGITS[unit]
        return EPOCH[0] <= since * scale <= EPOCH[1] and (step is None or ABSURD <= step * scale <= SLOWEST)

    def rate(unit: str) -> bool:
        return step is None or STEPS[0] <= step * 10.0 ** -DIGITS[unit] < STEPS[1]

    by_size = [u for u in DIGITS if epoch(u)]
    if stated is not None:
        absurd = step is not None and step * 10.0 ** -DIGITS[stated] < ABSURD
        if absurd or (by_size and stated not in by_size and not rate(stated)):
            looks = by_size[0] if by_size else next((u for u in DIGITS if rate(u)), "s")
            what = (
                f"its header states stamps in {stated}, but {finite[0]:.10g} and steps of {step or 0.0:.3g} are {looks}"
            )
            raise DataError.at(file, f"{what}; correct the header, or type --unit {looks}")
        return Clock(stated, STATED)
    if by_size:
        return Clock(usual if usual in by_size else by_size[0], SIZE)
    if step is None or rate(usual):
        return Clock(usual, ASSUMED)
    return next((Clock(u, RATE) for u in DIGITS if rate(u)), Clock(usual, ASSUMED))


def seconds(stamps: Array, texts: Sequence[str], unit: str) -> Array:
    """Stamps (n,) in s; whole numbers are divided as written, as they may have more digits than a float."""
    if unit == "s":
        return stamps
    whole = 10 ** DIGITS[unit]
    values = [int(t) / whole if t.lstrip("-").isdecimal() else float(t) / whole for t in texts]
    return np.array(values, float)
