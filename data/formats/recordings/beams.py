"""Scans of varying numbers of beams (rotating scanners, 180 and 181 beams in one log) on one set of angles."""

from collections.abc import Sequence

import numpy as np

from data.se2 import Array

ONE_SURFACE = 0.1  # Largest relative difference of two neighbouring ranges between which a range is interpolated
ANGLE = 1e-5  # rad, by which angles of beams are the same


def on_one_set(ranges: Sequence[Array], first: Array, step: Array) -> tuple[Array, float, float, int]:
    """Ranges (S, B) of scans with B_i beams from angles first (S,) in steps (S,) [rad]; the first angle and the step
    that they have in common, and how many scans were resampled.

    The common angles are those of the most frequent kind of scan, and of the finest among equals. A range between two
    beams is interpolated where both are on one surface, else it is that of the nearer beam; outside there is none (0).
    """
    count = np.array([len(r) for r in ranges])
    kinds = np.stack([count, np.round(first / ANGLE), np.round(step / ANGLE)], axis=1).astype(np.int64)
    each, of, times = np.unique(kinds, axis=0, return_inverse=True, return_counts=True)
    of = of.ravel()
    best = int(np.lexsort((each[:, 0], times))[-1])
    like = int(np.flatnonzero(of == best)[0])
    beams, low, apart = int(count[like]), float(first[like]), float(step[like])
    result = np.zeros((len(ranges), beams))
    angle = low + apart * np.arange(beams)
    for i, r in enumerate(ranges):
        result[i] = r if of[i] == best else resampled(r, (angle - first[i]) / step[i])
    return result, low, apart, int((of != best).sum())


def resampled(ranges: Array, at: Array) -> Array:
    """Ranges at fractional numbers of beams (B,)."""
    n = len(ranges)
    inside = (at > -0.5) & (at < n - 0.5)
    at = np.clip(at, 0.0, n - 1.0)
    low = np.floor(at).astype(np.int64)
    a, b, share = ranges[low], ranges[np.minimum(low + 1, n - 1)], at - low
    fine = np.isfinite(a) & np.isfinite(b) & (a > 0.0) & (b > 0.0)
    with np.errstate(invalid="ignore"):
        one = fine & (np.abs(a - b) < ONE_SURFACE * np.minimum(a, b))
        between = np.where(one, (1.0 - share) * a + share * b, np.where(share < 0.5, a, b))
    return np.where(inside, between, 0.0)
