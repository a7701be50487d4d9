"""What is demanded of `jcbb-hindsight` on the judging half of the variety, and how much of it is reached."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data.se2 import Array
from eval.replay.settings import HINDSIGHT
from tests.research.variety.measure import JCBB, KNOWN, OK, Row

WORSE = 1.2  # RMSE, in those of `jcbb`: more is worse
ENOUGH = 0.95  # Share of the worlds where it must not be worse
WRONG = 0.2  # FP, in those of `jcbb`: at most, in the median
NEAR = 0.1  # Share of the visible landmarks by which a map may have too many or too few
OFTEN = 0.9  # Share of the worlds where it must not have
LOST, HEALTHY = 5.0, 1.5  # RMSE, in those with labels: beyond the first a run is lost, up to the second it is not


class World(NamedTuple):
    """The rows of one world: the two methods, and labels granted where that was measured."""

    jcbb: Row
    hindsight: Row
    known: Row | None

    @property
    def rmse_ratio(self) -> float:
        """RMSE of hindsight by that of `jcbb`: 0 where only hindsight came to an end, infinite where it did not."""
        if self.hindsight.status != OK and math.isnan(self.hindsight.rmse_m):
            return math.inf
        return 0.0 if math.isnan(self.jcbb.rmse_m) else self.hindsight.rmse_m / self.jcbb.rmse_m

    @property
    def landmark_ratio(self) -> float:
        """Landmarks mapped by visible ones; NaN where hindsight did not come to an end."""
        return math.nan if math.isnan(self.hindsight.rmse_m) else self.hindsight.landmarks / self.hindsight.visible

    @property
    def right_count(self) -> bool:
        """Whether hindsight's map has, within 10 %, between `often` and `visible` landmarks."""
        h, low, high = self.hindsight, 1.0 - NEAR, 1.0 + NEAR
        return math.isfinite(h.rmse_m) and low * h.often <= h.landmarks <= high * h.visible

    @property
    def right_ratio(self) -> float:
        """TP and TN of hindsight by those of `jcbb`, finally."""
        ours, theirs = (r.readings - r.fp - r.fn for r in (self.hindsight, self.jcbb))
        return ours / max(theirs, 1)

    @property
    def smoothed_ratio(self) -> float:
        """RMSE of the smoothed path by that of `jcbb`; 1 where neither could be smoothed."""
        ours, theirs = self.hindsight.smoothed_m, self.jcbb.smoothed_m
        return 1.0 if ours == theirs else ours / theirs


class Goal(NamedTuple):
    """One goal: what it says, the value reached, and whether that is enough."""

    says: str
    value: float
    met: bool


def worlds_of(rows: Sequence[Row]) -> list[World]:
    found = {(r.number, r.method): r for r in rows}
    both = sorted(i for i, method in found if method == HINDSIGHT and (i, JCBB) in found)
    return [World(found[i, JCBB], found[i, HINDSIGHT], found.get((i, KNOWN))) for i in both]


def fp_ratios(worlds: Sequence[World]) -> Array:
    """FP of hindsight by those of `jcbb`, where both came to an end and `jcbb` had some; one for each such world."""
    ended = [w for w in worlds if math.isfinite(w.jcbb.rmse_m) and math.isfinite(w.hindsight.rmse_m)]
    return np.array([w.hindsight.fp / w.jcbb.fp for w in ended if w.jcbb.fp > 0])


def goals(worlds: Sequence[World]) -> list[Goal]:
    if not worlds:
        return []
    good = float(np.mean([w.rmse_ratio <= WORSE for w in worlds]))
    wrong = fp_ratios(worlds)
    fp = float(np.median(wrong)) if len(wrong) else 0.0
    near = float(np.mean([abs(w.landmark_ratio - 1.0) <= NEAR for w in worlds]))
    return [
        Goal(f"RMSE at most {WORSE:g} times that of jcbb, share of worlds (goal: {ENOUGH:g})", good, good >= ENOUGH),
        Goal(f"FP by those of jcbb, median where it has some (goal: {WRONG:g}; {len(wrong)} worlds)", fp, fp <= WRONG),
        Goal(f"landmarks within {NEAR:.0%} of the visible, share of worlds (goal: {OFTEN:g})", near, near >= OFTEN),
    ]


def table(rows: Sequence[Row]) -> list[str]:
    """The goals by kind of world as lines of a Markdown table, and a line for each: whether it is met."""
    worlds = worlds_of(rows)
    if not worlds:
        return ["No world was run with both methods."]
    lines = [
        f"| worlds | how many | RMSE ≤ {WORSE:g} × `jcbb` | median ratio | FP / FP of `jcbb`, median | FP, `jcbb` |"
        f" hindsight | landmarks ± {NEAR:.0%} | `jcbb` |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for kind in [*list(dict.fromkeys(w.jcbb.world for w in worlds)), "all"]:
        of = [w for w in worlds if kind in (w.jcbb.world, "all")]
        rmse, fp, near = goals(of)
        lines.append(
            f"| {kind} | {len(of)} | {rmse.value:.0%} | {np.median([w.rmse_ratio for w in of]):.2f} | {fp.value:.2f} |"
            f" {_fp([w.jcbb for w in of]):.1f} % | {_fp([w.hindsight for w in of]):.1f} % | {near.value:.0%} |"
            f" {np.mean([abs(w.jcbb.landmarks / w.jcbb.visible - 1.0) <= NEAR for w in of]):.0%} |"
        )
    lines += ["", *(f"{'met' if g.met else 'MISSED'}: {g.says}: {g.value:.2f}" for g in goals(worlds))]
    shown = [w for w in worlds if w.known is not None]
    if shown:
        ours, plain = (_as_with_labels(shown, method) for method in (HINDSIGHT, JCBB))
        lines.append(f"RMSE at most {WORSE:g} times that with labels: {ours:.0%} of the worlds, {JCBB} {plain:.0%}")
        lines.append(_said(shown))
    return lines


def _said(worlds: Sequence[World]) -> str:
    """On how many worlds hindsight said that it was lost: of those where it was, and of those where it was not."""
    parts = []
    beyond, between, near = f"beyond {LOST:g} times", "between", f"up to {HEALTHY:g} times"
    for least, most, what in ((LOST, math.inf, beyond), (HEALTHY, LOST, between), (0.0, HEALTHY, near)):
        of = [w.hindsight for w in worlds if w.known and least < w.hindsight.rmse_m / w.known.rmse_m <= most]
        parts.append(f"{sum(r.said_lost for r in of)} of {len(of)} {what}")
    return f"said to be lost, by the RMSE in those with labels: {', '.join(parts)}"


def _as_with_labels(worlds: Sequence[World], method: str) -> float:
    """Share of the worlds where a method's RMSE is at most `WORSE` times that with labels."""
    good = []
    for w in worlds:
        row = w.hindsight if method == HINDSIGHT else w.jcbb
        good.append(w.known is not None and row.rmse_m <= WORSE * w.known.rmse_m)
    return float(np.mean(good))


def _fp(rows: Sequence[Row]) -> float:
    """Median of FP, in % of the readings."""
    return float(np.median([100.0 * r.fp / max(r.readings, 1) for r in rows]))


def hiding_table(rows: Sequence[Row]) -> list[str]:
    """What is demanded where landmarks hide, by kind of world, as lines of a Markdown table."""
    lines = [
        "| worlds | how many | landmarks right, hindsight | `jcbb` | ± 10 % of visible | RMSE ≤ 1.2 × `jcbb` |"
        " TP + TN ≥ 0.98 × `jcbb` | smoothed RMSE ≤ 1.05 × `jcbb` | FP / FP of `jcbb`, median | seconds / `jcbb` |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    worlds = worlds_of(rows)
    for kind in [*dict.fromkeys(w.jcbb.world for w in worlds), "all"]:
        of = [w for w in worlds if kind in (w.jcbb.world, "all")]
        plain = [World(w.jcbb, w.jcbb, w.known) for w in of]
        reached = [w for w in of if w.known is None or w.known.rmse_m <= WORSE * w.jcbb.rmse_m]
        wrong = fp_ratios(of)
        shares = [
            [w.right_count for w in of], [w.right_count for w in plain],
            [abs(w.landmark_ratio - 1.0) <= NEAR for w in of], [w.rmse_ratio <= WORSE for w in reached],
            [w.right_ratio >= 0.98 for w in of], [w.smoothed_ratio <= 1.05 for w in of],
        ]  # fmt: skip
        seconds = sum(w.hindsight.seconds for w in of) / sum(w.jcbb.seconds for w in of)
        lines.append(
            f"| {kind} | {len(of)} | " + " | ".join(f"{np.mean(s):.0%}" if s else "" for s in shares)
            + f" | {np.median(wrong) if len(wrong) else math.nan:.2f} | {seconds:.1f} |"
        )  # fmt: skip
    return lines
