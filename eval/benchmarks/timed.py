"""Timed lines of a benchmark: medians after a warm-up, and their table."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

REPEATS = 5


@dataclass(frozen=True)
class Timed:
    """A line of the table: what, median seconds, what one unit is, units per second, and the peer's ratio if any."""

    what: str
    seconds: float
    units: int
    unit: str
    ratio: str = ""
    goal: str = ""


def median_seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median wall time of `work` after one warm-up."""
    work()
    taken = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begin)
    return statistics.median(taken)


def table(lines: list[Timed]) -> str:
    """The lines as text."""
    out = [f"{'':84s} {'median s':>9s} {'per second':>18s} {'ratio':>7s}  goal"]
    for t in lines:
        rate = f"{t.units / t.seconds:,.0f} {t.unit}" if t.seconds > 0 else ""
        seconds = f"{t.seconds:9.5f}" if math.isfinite(t.seconds) else " " * 9
        out.append(f"{t.what:84s} {seconds} {rate:>18s} {t.ratio:>7s}  {t.goal}")
    return "\n".join(out)
