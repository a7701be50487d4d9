"""The instants at which poses are estimated (frames), and the true poses there."""

import numpy as np
from numpy.typing import NDArray

from data import se2
from data.se2 import Array

MAX_GAP = 1.0  # s, longest interval between frames, and, with `usual_gap`, across which truth is interpolated
SPREAD, SLOWEST = 1.5, 5.0
"""Longest interval of stamps in a row over their median: jitter stays below, one missing stamp is above. s, longest
interval that is interpolated whatever the rate."""


def usual_gap(time: Array, most: float = SLOWEST) -> float:
    """Longest interval [s] of stamps (K,) that is no gap: `MAX_GAP` or `SPREAD` times their median, up to `most`."""
    step = np.diff(time)
    return max(MAX_GAP, min(SPREAD * float(np.median(step)), most)) if len(step) else MAX_GAP


def frame_times(at: Array, first: float, last: float, max_gap: float = MAX_GAP) -> Array:
    """Frames of a log: the instants `at` [s] once each, `first`, `last`, and keyframes, ascending.

    A gap longer than `max_gap` is cut into the fewest equal parts. The given instants are kept bit for bit, so
    `np.searchsorted(frames, at)` finds the frame of each. Raises ValueError for an instant outside [first, last].
    """
    at = np.asarray(at, float).ravel()
    if not max_gap > 0.0:
        raise ValueError(f"max_gap {max_gap}: a positive number of seconds is needed")
    if not (first <= last and np.all((at >= first) & (at <= last))):
        raise ValueError(f"every instant must lie within [{first}, {last}]")
    given = np.unique(np.concatenate([[first, last], at]))
    gap = np.diff(given)
    rounding = 4.0 * np.spacing(max(abs(first), abs(last)))  # unix stamps are rounded, so a gap of 1 s may seem longer
    parts = np.maximum(np.ceil((gap - rounding) / max_gap), 1.0).astype(np.int64)
    owner = np.repeat(np.arange(len(gap)), parts - 1)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1
    return np.unique(np.concatenate([given, given[owner] + gap[owner] * (nth / parts[owner])]))


def truth_at(time: Array, pose: Array, at: Array) -> Array:
    """True poses (N, 3) at the instants `at` [s], from poses (K, 3) at ascending stamps `time` [s].

    Interpolated between neighbouring rows, headings along the shorter arc; a heading alone may be NaN. NaN outside the
    span of `time`, where these rows are further apart than `usual_gap`, or where one of them is NaN; at a stamp only
    its own row counts.
    """
    time, pose, at = np.asarray(time, float), np.asarray(pose, float).reshape(-1, 3), np.asarray(at, float)
    result = np.full((len(at), 3), np.nan)
    known: NDArray[np.bool_] = np.all(np.isfinite(pose[:, :2]), axis=1)
    if not known.any():
        return result
    after = np.clip(np.searchsorted(time, at, side="left"), 0, len(time) - 1)
    before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)
    inside = (at >= time[0]) & (at <= time[-1])
    # at a stamp `before` and `after` are that row
    usable = inside & known[before] & known[after] & (time[after] - time[before] <= usual_gap(time))
    result[usable] = se2.interpolate(time[known], np.nan_to_num(pose[known]), at[usable])
    turned = np.isfinite(pose[:, 2])
    result[usable & ~(turned[before] & turned[after]), 2] = np.nan
    if not turned.all():  # headings beside unknown ones
        both = turned & known
        rows = usable & turned[before] & turned[after]
        result[rows, 2] = se2.interpolate(time[both], pose[both], at[rows])[:, 2] if rows.any() else 0.0
    return result
