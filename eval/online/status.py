"""The line on the terminal, once a second: where each estimator takes the robot to be, walls, link, latency."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from data.se2 import Array, wrap_angle
from eval.online.session import Step

SIGMAS = 3.0
SHORTEST, PER_DECADE, DECADES = 1.0e-5, 50, 8
"""s, and the classes in which latencies are counted: 5 % wide, up to 1000 s."""


class Latencies:
    """How long estimates took, counted, so that no number of them takes memory.

    Attributes:
        longest: s, since `begin`.
    """

    def __init__(self) -> None:
        """None yet."""
        self.longest = 0.0
        self._counts = np.zeros(PER_DECADE * DECADES + 1, np.int64)

    def add(self, seconds: float) -> None:
        """One more."""
        self.longest = max(self.longest, seconds)
        place = PER_DECADE * math.log10(max(seconds, SHORTEST) / SHORTEST)
        self._counts[min(math.ceil(place), len(self._counts) - 1)] += 1

    def begin(self) -> None:
        """The longest is asked for anew."""
        self.longest = 0.0

    def within(self, share: float) -> float:
        """Time [s] within which such a share of all estimates came, 5 % at most too long; NaN where there are none."""
        total = int(self._counts.sum())
        if not total:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self._counts), share * total))
        return float(SHORTEST * 10.0 ** (place / PER_DECADE))


def pose_words(mean: Array, covariance: Array) -> str:
    """A pose with its 3 sigma: x, y [m], heading [degrees]."""
    x, y, heading = SIGMAS * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    degrees = math.degrees(float(wrap_angle(float(mean[2]))))
    return (
        f"x {mean[0]:.3f} ± {x:.3f}, y {mean[1]:.3f} ± {y:.3f} m, heading {degrees:.1f} ± {math.degrees(heading):.1f}°"
    )


def estimator_words(name: str, step: Step | None, walls: int | None, failure: str) -> str:
    """An estimator with its newest pose, how many walls it has, or that it has ended."""
    if failure:
        return f"{name} ended"
    if step is None:
        return f"{name} waits"
    return f"{name} {pose_words(step.mean, step.covariance)}" + ("" if walls is None else f", walls {walls}")


def status_line(
    t: float, estimators: Sequence[str], faults: Mapping[str, int], latencies: Latencies, period: float
) -> str:
    """All of it; `period` [s]: real time between frames, beyond which an estimate is late for the next one."""
    counted = ", ".join(f"{name} {count}" for name, count in faults.items() if count)
    parts = [f"{t:7.1f} s", *estimators, f"link: {counted or 'no faults'}"]
    soon = latencies.within(0.99)
    if math.isfinite(soon):
        parts.append(f"latency {1e3 * latencies.longest:.1f} ms, 99 % < {1e3 * soon:.1f} ms")
    if latencies.longest > period:
        parts.append(f"late: {latencies.longest:.2f} s, longer than a period of {period:g} s")
    return " | ".join(parts)
