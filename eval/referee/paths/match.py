"""The truth at a result's stamps: by interpolation where it is dense enough, unknown elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data.inputs import IntArray, read_only
from data.se2 import Array, wrap_angle

SAME = 1e-6
"""s: stamps that differ by no more are the same instant (microseconds were written; `smfeval` has the same)."""
GAP = 1.0
"""s: truths farther apart are not interpolated. Frames of a log are never farther apart (DESIGN), and beyond, a
sample of odometry does not hold either."""


@dataclass(frozen=True, eq=False)
class Match:
    """The truth at n stamps.

    Attributes:
        truth: (n, 3), NaN where unmatched.
        matched, unmatched: how many.
        interpolated: how many of the matched lie between two truths.
        error: m, what interpolation may be wrong by: RMS over the truths that can be left out, each interpolated from
            its neighbours, over 4 (half the step, a quarter of the sagitta); NaN where nothing was interpolated.
    """

    truth: Array
    matched: int
    unmatched: int
    interpolated: int
    error: float

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def text(self) -> str:
        """Counts, in a sentence."""
        said = f"{self.matched} of {self.matched + self.unmatched} poses matched with the truth"
        if self.interpolated:
            said += f", {self.interpolated} of them between two truths"
            if math.isfinite(self.error):
                said += f" (interpolation is off by about {self.error:.2g} m)"
        return said + (f"; {self.unmatched} unmatched, in no number" if self.unmatched else "")


def match(time: Array, truth_time: Array, truth: Array, gap: float = GAP) -> Match:
    """Truth (n, 3) at stamps `time` (n,) from truths (K, 3) at `truth_time` (K,), both strictly ascending.

    A stamp within `SAME` of a truth's takes that truth as it is. Between two known truths no more than `gap` seconds
    apart, positions are interpolated linearly and headings along the shorter way. Elsewhere, beside a truth that is
    NaN and outside the span of the truths, it is unknown.
    """
    n = len(time)
    found = np.full((n, 3), np.nan)
    if not len(truth_time):
        return Match(found, 0, n, 0, math.nan)
    after = np.clip(np.searchsorted(truth_time, time), 0, len(truth_time) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(truth_time[before] - time) < np.abs(truth_time[after] - time), before, after)
    same = np.abs(truth_time[nearest] - time) <= SAME
    found[same] = truth[nearest[same]]
    within = ~same & (truth_time[before] < time) & (time < truth_time[after])
    within &= truth_time[after] - truth_time[before] <= gap + SAME
    found[within] = _between(truth_time, truth, before[within], after[within], time[within])
    matched = np.asarray(np.isfinite(found).all(axis=1))
    between = int((within & matched).sum())
    error = _sagitta(truth_time, truth, gap) if between else math.nan
    return Match(found, int(matched.sum()), n - int(matched.sum()), between, error)


def _between(time: Array, pose: Array, a: IntArray, b: IntArray, at: Array) -> Array:
    """Poses (m, 3) at stamps (m,) between rows a and b (m,)."""
    share = ((at - time[a]) / (time[b] - time[a]))[:, None]
    step = pose[b] - pose[a]
    step[:, 2] = wrap_angle(step[:, 2])
    made = pose[a] + share * step
    made[:, 2] = wrap_angle(made[:, 2])
    return np.asarray(made)


def _sagitta(time: Array, pose: Array, gap: float) -> float:
    """See `Match.error`."""
    middle = np.arange(1, len(time) - 1)
    if not len(middle):
        return math.nan
    middle = middle[np.maximum(np.diff(time)[:-1], np.diff(time)[1:]) <= gap + SAME]
    made = _between(time, pose, middle - 1, middle + 1, time[middle])
    off = np.hypot(*(made - pose[middle])[:, :2].T)
    off = off[np.isfinite(off)]
    return float(0.25 * math.sqrt(np.mean(off**2))) if len(off) else math.nan
