"""The instants at which a pose is estimated (frames), and the true poses at those instants.

Shared by everything that turns asynchronous stamps (odometry, observations, motion capture) into a log.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from data import se2
from data.se2 import Array

MAX_GAP = 1.0
"""s. Frames are never further apart; truth is not interpolated across more."""


def frame_times(at: Array, first: float, last: float, max_gap: float = MAX_GAP) -> Array:
    """Frames of a log: the instants `at` [s] once each, `first`, `last`, and keyframes in between, ascending.

    A gap longer than `max_gap` is cut into the fewest equal parts that are not longer. The given instants come back
    bit for bit, so `np.searchsorted(frames, at)` finds the frame of each.

    Raises:
        ValueError: an instant outside [first, last], or not a number; max_gap not positive.
    """
    at = np.asarray(at, float).ravel()
    if not max_gap > 0.0:
        raise ValueError(f"max_gap {max_gap}: a positive number of seconds")
    if not (first <= last and np.all((at >= first) & (at <= last))):
        raise ValueError(f"every instant must lie within [{first}, {last}]")
    given = np.unique(np.concatenate([[first, last], at]))
    gap = np.diff(given)
    # a gap of 1 s between unix stamps is 1 s give or take the rounding of the stamps
    rounding = 4.0 * np.spacing(max(abs(first), abs(last)))
    parts = np.maximum(np.ceil((gap - rounding) / max_gap), 1.0).astype(np.int64)
    owner = np.repeat(np.arange(len(gap)), parts - 1)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1
    keyframes = given[owner] + gap[owner] * (nth / parts[owner])
    return np.unique(np.concatenate([given, keyframes]))


def truth_at(time: Array, pose: Array, at: Array, max_gap: float = MAX_GAP) -> Array:
    """True poses (N, 3) at the instants `at` [s], from poses (K, 3) at the ascending stamps `time` [s].

    Interpolated between the two rows around an instant (headings along the shorter way). NaN outside the span of
    `time`, where those rows are further apart than `max_gap`, or where one of them is NaN (a row is known whole or not
    at all); at a stamp only that stamp's row counts.
    """
    time, pose, at = np.asarray(time, float), np.asarray(pose, float).reshape(-1, 3), np.asarray(at, float)
    result = np.full((len(at), 3), np.nan)
    known: NDArray[np.bool_] = np.all(np.isfinite(pose), axis=1)
    if not known.any():
        return result
    after = np.clip(np.searchsorted(time, at, side="left"), 0, len(time) - 1)
    before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)
    inside = (at >= time[0]) & (at <= time[-1])
    # at a stamp `before` and `after` are that stamp, so the distance is 0
    usable = inside & known[before] & known[after] & (time[after] - time[before] <= max_gap)
    result[usable] = se2.interpolate(time[known], pose[known], at[usable])
    return result
