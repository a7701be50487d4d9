"""Two landmarks of a smoothed map that are one: at one place, and hardly ever observed together.

A landmark that was initialized twice is observed as one of both or as the other. Two landmarks that are each detected
with probability r are observed together in a share r / (2 - r) of the frames in which one of them is. Online their
places are too uncertain for this test (`duplicates.py`); in the smoothed map they agree within the noise of a single
observation.
"""

from __future__ import annotations

import math

import numpy as np

from association.expectation import gate_threshold
from data.inputs import IntArray, LandmarkMap, Observations
from data.se2 import Array
from data.sensors import Sensor
from eval.replay.hindsight import constants

Pairs = list[tuple[int, int]]  # landmarks to remove, each with the one that it equals


def same_landmarks(sensor: Sensor, path: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> Pairs:
    """Landmarks of a map that equal one with a lower number; each is in one pair at most, the surest pairs come first.

    Args:
        sensor: its range is that in which observations were made.
        path: (N, 3) poses.
        known: the map.
        seen: observations (M), ascending by frame, with their noise as it is.
        number: (M,) landmark of each, -1 for none.
    """
    order = np.argsort(number, kind="stable")
    numbers, begin = np.unique(number[order], return_index=True)
    rows = dict(zip(numbers.tolist(), np.split(order, begin[1:]), strict=True))
    often = [n for n in rows if n >= 0 and len(rows[n]) >= constants.WINDOW_OBSERVATIONS]
    xy, apart = known.positions(np.array(often, np.int64)), constants.SAME_PLACE * sensor.max_range

    def agree(n: int, place: Array) -> bool:
        """Whether a landmark's observations, most of them, could be of something at this place."""
        k = rows[n]
        nu = sensor.residual(seen.z[k], sensor.predict(path[seen.frame[k]], np.broadcast_to(place, (len(k), 2))))
        d2 = (nu * np.linalg.solve(seen.R[k], nu[..., None])[..., 0]).sum(axis=1)
        return float(np.median(d2)) < gate_threshold(constants.SAME_GATE)

    found = []
    for i, j in sorted(_neighbours(xy)):
        a, b = often[i], often[j]
        if agree(a, xy[j]) and agree(b, xy[i]):
            odds = log_odds(seen.frame[rows[a]], seen.frame[rows[b]], path, apart)
            if odds > constants.SAME_ODDS:
                found.append((-odds, b, a))
    pairs: Pairs = []
    taken: set[int] = set()
    for _, away, kept in sorted(found):
        if not {away, kept} & taken:
            pairs.append((away, kept))
            taken |= {away, kept}
    return pairs


def _neighbours(xy: Array) -> set[tuple[int, int]]:
    """Each of the points (n, 2) with the nearest others, as pairs of rows in ascending order."""
    pairs = set()
    for i in range(len(xy)):
        distance = np.hypot(*(xy - xy[i]).T)
        for j in np.argsort(distance, kind="stable")[: 1 + constants.SAME_NEAREST].tolist():
            if i != j:
                pairs.add((min(i, j), max(i, j)))
    return pairs


def log_odds(one: IntArray, other: IntArray, path: Array, apart: float) -> float:
    """Log odds of one landmark against two, by the frames of their observations.

    Frames nearer than `apart` [m] to the one that counted before tell nothing new.
    """
    r = constants.SAME_DETECTED
    alone = -math.log(1.0 - r / (2.0 - r))
    together = math.log(constants.SAME_CHANCE * (2.0 - r) / r)
    odds, place = 0.0, np.full(2, np.inf)
    both = np.intersect1d(one, other)
    for k in np.setxor1d(one, other).tolist():
        if np.hypot(*(path[k, :2] - place)) >= apart:
            odds, place = odds + alone, path[k, :2]
    return odds + together * len(both)
