"""Detection opportunities of landmarks: from where each was in view, and whether it was detected.

A landmark may be hidden from most places: by others, by its own far side, by distance. So a missed detection counts by
its viewpoint, the range and the side from which the landmark is looked at. A viewpoint is familiar if the landmark was
detected before in the same cell of viewpoints or in one beside it. Behind a mapped landmark it may be occluded. How
often persistent landmarks are detected from familiar viewpoints, from others and behind others is learned for the log
(`persistence.py`): where landmarks hide, misses from elsewhere tell nothing; where they do not, every miss counts.

Online, the ledger collects opportunities with the path and the pairings of the moment; `recounted` does so with the
smoothed path, the map and the pairings of the end, and counts misses before the first detection, too.
"""

from __future__ import annotations

import math

import numpy as np

from association.candidates import polar_sigma
from association.expectation import Expectation
from data.inputs import IntArray, LandmarkMap, Observations
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import Sensor
from eval.replay.hindsight import constants

MISSED, DETECTED = 0, 1  # of an opportunity: the result, ...
FAMILIAR, BEHIND = 2, 4  # ... plus one of these if the viewpoint is familiar, or behind another landmark
BEFORE = 6  # missed before the first detection


def cell(distance: float, direction: float) -> int:
    """Cell of viewpoints from which a landmark is at this distance [m], in this direction [rad] in the world."""
    ring = math.floor(math.log(max(distance, 1e-3)) / math.log(constants.VIEW_RING))
    side = math.floor(constants.VIEW_SIDES * direction / (2.0 * math.pi)) % constants.VIEW_SIDES
    return ring * constants.VIEW_SIDES + side


def beside(of: int) -> list[int]:
    """A cell and those beside it."""
    sides = constants.VIEW_SIDES
    ring, side = divmod(of, sides)
    return [r * sides + (side + s) % sides for r in (ring - 1, ring, ring + 1) for s in (-1, 0, 1)]


def in_sight(sensor: Sensor, z_hat: Array, covariance: Array, z: Array) -> BoolArray:
    """Which landmarks (n,) expected at z_hat (n, 2) are in view, and not occluded by something observed at z (m, 2).

    They are inside the field of view by `IN_VIEW_SIGMAS` of their covariance (n, 2, 2).
    """
    expected, seen = sensor.polar(z_hat), sensor.polar(z)
    sigma = constants.IN_VIEW_SIGMAS * polar_sigma(sensor, z_hat, covariance)
    inside = sensor.in_view(z_hat, margin_range=-sigma[:, 0], margin_angle=-sigma[:, 1])
    shadow = np.abs(wrap_angle(seen[None, :, 1] - expected[:, None, 1])) < constants.SHADOW
    return np.asarray(inside & ~(shadow & (seen[None, :, 0] < expected[:, None, 0])).any(axis=1))


def behind_others(sensor: Sensor, z_hat: Array) -> BoolArray:
    """Which landmarks (n,) expected at z_hat (n, 2) may be occluded by another one of them."""
    expected = sensor.polar(z_hat)
    width = constants.SHADOW_WIDTH / np.maximum(expected[:, 0], constants.SHADOW_WIDTH)
    shadow = np.abs(wrap_angle(expected[None, :, 1] - expected[:, None, 1])) < width[None, :]
    nearer = expected[None, :, 0] < expected[:, None, 0] - constants.SHADOW_WIDTH
    return np.asarray((shadow & nearer).any(axis=1))


def missing(e: Expectation, decisions: IntArray, sensor: Sensor) -> BoolArray:
    """Candidates (n,) with a missed detection: in sight and not paired."""
    return np.asarray(in_sight(sensor, e.z_hat, e.HPHt, e.z) & ~np.isin(e.number, decisions))


def recounted(
    sensor: Sensor, path: Array, known: LandmarkMap, seen: Observations, number: IntArray
) -> dict[int, bytes]:
    """The opportunities of each landmark of a map in a log, by number, without its first observation.

    Args:
        sensor: its view is that in which observations were made.
        path: (N, 3) poses.
        known: the map.
        seen: observations (M), ascending by frame. A frame without any may have been without the sensor.
        number: (M,) landmark of each, -1 for none.
    """
    noise, apart = np.median(seen.R, axis=0), constants.SAME_PLACE * sensor.max_range
    reach = math.hypot(*sensor.translation) + sensor.max_range
    familiar: list[set[int]] = [set() for _ in known.id]
    result, place = [bytearray() for _ in known.id], np.full((len(known.id), 2), np.inf)
    frames, begin = np.unique(seen.frame, return_index=True)
    for k, first, end in zip(frames.tolist(), begin, [*begin[1:], len(number)], strict=True):
        pose, z = path[k], seen.z[first:end]
        near = np.flatnonzero(np.hypot(*(known.xy - pose[:2]).T) <= reach)
        z_hat = sensor.predict(pose, known.xy[near])
        detected = np.isin(known.id[near], number[first:end])
        open_to = in_sight(sensor, z_hat, np.broadcast_to(noise, (len(near), 2, 2)), z)
        polar, behind = sensor.polar(z_hat), behind_others(sensor, z_hat)
        elsewhere = np.hypot(*(place[near] - pose[:2]).T) >= apart
        for q in np.flatnonzero(detected | (open_to & elsewhere)).tolist():
            i, found = int(near[q]), bool(detected[q])
            at, known_from = cell(polar[q, 0], pose[2] + polar[q, 1]), familiar[i]
            if known_from and (elsewhere[q] or not result[i].lstrip(bytes([BEFORE]))):
                viewpoint = BEHIND if behind[q] else FAMILIAR if at in known_from else 0
                result[i].append((DETECTED if found else MISSED) + viewpoint)
            elif not (known_from or found):
                result[i].append(BEFORE)
            if found:
                known_from.update(beside(at))
            if elsewhere[q]:
                place[i] = pose[:2]
    return {n: bytes(s) for n, s in zip(known.id.tolist(), result, strict=True)}
