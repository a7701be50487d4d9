"""Does what the robot saw first fit the map? If not: would it with another reading of the camera's pose, or unit?"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from data.inputs import IntArray
from data.pictures import CORNERS, VisualSetup
from data.se2 import Array, inverse, rotation, transform_points
from data.visual.lab.configuration import READINGS, TRANSLATION_UNITS, camera_from_body

SIGMA = np.array([0.04, 0.10])
"""m, of a corner's x and z: twice the lab's constants, so that only gross faults are spoken of."""
CONFIDENCE = 1.0 - 1e-6
STEPS = 20
EXACT = 1e-6
"""m or rad: added to the prior's sigma, which may be 0."""


def unit_suspicion(
    setup: VisualSetup,
    first_points: Array,
    pictures: IntArray,
    *,
    translation_unit: str = "cm",
    reading: str = "to-camera",
) -> str | None:
    """A warning if the first observations do not fit the map, with the reading of camera_to_body with which they would.

    A picture fits if some first pose, weighed by the prior, explains its four corners: the least sum of squares is
    below the chi-square quantile. The observations fit if the median picture does, as one may be mistaken for another.

    Args:
        setup: as read.
        first_points: (m, 4, 3) m, corners in the camera's frame, all from the first frame with detections.
        pictures: (m,) rows of `setup.corners`.
        translation_unit: with which the setup was read.
        reading: likewise.
    """
    usable = np.isfinite(first_points).all(axis=(1, 2))
    seen, expected = first_points[usable][:, :, [0, 2]], setup.corners[pictures[usable]]
    if not len(seen) or _fits(setup, setup.rotation, setup.translation, seen, expected) is not None:
        return None
    found = []
    R, T = _as_in_file(setup, translation_unit, reading)
    for other in READINGS:
        for unit in TRANSLATION_UNITS:
            angle, translation = camera_from_body(R, T, translation_unit=unit, reading=other)
            cost = _fits(setup, angle, translation, seen, expected)
            if cost is not None:
                found.append((cost, f"{other!r} with T in {unit}"))
    start = (
        f"the first observations do not fit the map with camera_to_body read {reading!r} and T in {translation_unit}"
    )
    if found:
        return f"{start}, but they do with {min(found)[1]}; see the options for both"
    wide = np.median(_width(seen) / _width(expected))
    body = inverse(setup.prior.mean)
    camera = np.array([*setup.translation, setup.rotation])
    away = np.median(_range(seen) / _range(transform_points(camera, transform_points(body, expected))))
    return (
        f"{start}, nor with another reading: pictures are seen {wide:.3g} times as wide and {away:.3g} times as far "
        "away as map and first pose say; units are cm in map and first pose, degrees in theta0, mm in xyz"
    )


def _as_in_file(setup: VisualSetup, translation_unit: str, reading: str) -> tuple[Array, Array]:
    """R and T as the file has them."""
    R, T = rotation(setup.rotation), np.array(setup.translation)
    if reading == "to-body":
        R, T = R.T, -R.T @ T
    return R, T / TRANSLATION_UNITS[translation_unit]


def _fits(
    setup: VisualSetup, angle: float, translation: tuple[float, float], seen: Array, expected: Array
) -> float | None:
    """Median over pictures of the least sum of squares; None if that one does not fit."""
    camera = np.array([*translation, angle])
    mean = setup.prior.mean
    root = np.linalg.cholesky(setup.prior.covariance + EXACT**2 * np.eye(3))

    def residual(change: Array, z: Array, corners: Array) -> Array:
        pose = mean + root @ change
        here = transform_points(camera, transform_points(inverse(pose), corners))
        return np.concatenate([((z - here) / SIGMA).ravel(), change])

    # where pictures are far off, not having converged is as good an answer as any
    pairs = zip(seen, expected, strict=True)
    costs = [2.0 * least_squares(residual, np.zeros(3), args=pair, max_nfev=STEPS).cost for pair in pairs]
    cost = float(np.median(costs))
    return cost if cost < _gate() else None


@lru_cache
def _gate() -> float:
    return float(chi2.ppf(CONFIDENCE, 2 * CORNERS))


def _width(corners: Array) -> Array:
    width: Array = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=-1)
    return width


def _range(points: Array) -> Array:
    distance: Array = np.maximum(np.linalg.norm(points.mean(axis=1), axis=-1), math.ulp(1.0))
    return distance
