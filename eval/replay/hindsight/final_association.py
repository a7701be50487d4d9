"""Final re-association: all observations of a log with known landmarks, from known poses.

Online decisions use the map and pose of their moment. After smoothing, the errors of path and map are small against the
noise of an observation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.appearance import Looks
from association.expectation import Expectation, gate_threshold
from association.methods import gnn
from data.inputs import IntArray, LandmarkMap, Observations
from data.se2 import Array, BoolArray
from data.sensors import Sensor
from eval.replay.hindsight import constants


class Reassociation(NamedTuple):
    """Landmark (m,) of every observation, -1 for none; alone (m,): inside no other landmark's gate."""

    number: IntArray
    alone: BoolArray


def noise_share(sensor: Sensor, pose: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> float:
    """Variance of observations (m) of the landmarks (m,), -1 for none, over the stated one; poses (N, 3).

    From a quantile of squared distances to often observed landmarks; the position of a landmark observed once follows
    from that observation. 1 without such landmarks, at least `LEAST_SCALE`.
    """
    times = np.bincount(number[number >= 0], minlength=1)
    rows = np.flatnonzero((number >= 0) & (times[np.maximum(number, 0)] >= constants.REASSOCIATION_OBSERVATIONS))
    if not len(rows):
        return 1.0
    d2 = _distances(sensor, pose, known, seen, number, rows)
    share = float(np.quantile(d2, constants.REASSOCIATION_QUANTILE)) / gate_threshold(constants.REASSOCIATION_QUANTILE)
    return max(share, constants.LEAST_SCALE)


def squares(sensor: Sensor, pose: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> float:
    """Sum of the squared distances of observations (m) to their landmarks (m,), -1 for none; poses (N, 3)."""
    return float(_distances(sensor, pose, known, seen, number, np.flatnonzero(number >= 0)).sum())


def _distances(
    sensor: Sensor, pose: Array, known: LandmarkMap, seen: Observations, number: IntArray, rows: IntArray
) -> Array:
    nu = sensor.residual(seen.z[rows], sensor.predict(pose[seen.frame[rows]], known.positions(number[rows])))
    d2: Array = (nu * np.linalg.solve(seen.R[rows], nu[..., None])[..., 0]).sum(axis=1)
    return d2


def reassociate(
    sensor: Sensor, pose: Array, known: LandmarkMap, seen: Observations, looks: Looks | None = None
) -> Reassociation:
    """Global nearest neighbour in every frame, from exact poses (N, 3), for observations (m) ascending by frame.

    `looks`: what the landmarks look like, if the observations have an appearance.
    """
    number, alone = np.full(len(seen.frame), -1, np.int64), np.zeros(len(seen.frame), np.bool_)
    begin = np.searchsorted(seen.frame, np.arange(len(pose) + 1))
    for k in np.unique(seen.frame).tolist():
        rows = slice(begin[k], begin[k + 1])
        e = _expected(sensor, pose[k], known, seen.z[rows], seen.R[rows])
        if looks is not None and seen.appearance is not None:
            e = e.with_appearance(looks.unlike(e.number, seen.appearance.only(rows)))
        threshold = e.threshold(constants.REASSOCIATION_GATE)
        number[rows] = gnn(e, constants.REASSOCIATION_GATE)
        alone[rows] = (e.individual_distances() < threshold).sum(axis=1) == 1
    return Reassociation(number, alone & (number >= 0))


def beginnings(found: Reassociation) -> dict[int, int]:
    """The observation that each landmark begins with: the first unambiguous one, or else the first.

    It names the landmark, so an error there would make all right decisions after it wrong.
    """
    rows = np.lexsort((~found.alone, found.number))
    numbers, first = np.unique(found.number[rows], return_index=True)
    return {n: row for n, row in zip(numbers.tolist(), rows[first].tolist(), strict=True) if n >= 0}


def _expected(sensor: Sensor, pose: Array, known: LandmarkMap, z: Array, R: Array) -> Expectation:
    """Landmarks within twice the sensor's range, known exactly, and observations (m, 2) of a frame."""
    reach = math.hypot(*sensor.translation) + 2.0 * sensor.max_range
    near = np.flatnonzero(np.hypot(*(known.xy - pose[:2]).T) <= reach)
    n, m = len(near), len(z)
    return Expectation(
        known.id[near], sensor.predict(pose, known.xy[near]), np.zeros((n, 2, 2)), np.zeros(n, np.int64),
        z, R, np.zeros(m, np.int64), sensor.residual, lambda which: np.zeros((2 * len(which), 2 * len(which))),
    )  # fmt: skip
