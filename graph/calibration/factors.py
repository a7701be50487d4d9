"""Factors of the systematic errors: with increments, a priori, from knot to knot, and with known landmarks."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import IntArray, Prior, Sightings
from data.motion.systematic import forgotten
from data.se2 import Array, world_from_body
from data.sensors import Sensor
from graph.calibration.variables import Errors
from graph.factors import Factor, Sighted, noise, pose2, prior_factor, root_information, sight_landmarks
from graph.problem import drift_key

PINNED = 1e-4
"""m. Sigma of a known landmark in the sensor's frame, where it depends on the errors and no prior can hold it exactly.
Beside readings of 0.01 m it adds a ten-thousandth to their variance; and its weight is 1e4 times theirs at most, while
Cholesky breaks down at 1e10."""
UNIT = {n: noise.Unit.Create(n) for n in (1, 2, 3)}


def linear_factor(terms: list[tuple[int, Array]], b: Array, point: gtsam.Values) -> Factor:
    """The residual sum of A x - b in units of its sigma, x counted from `point`.

    A `JacobianFactor` of more than three variables has no constructor in Python; a `GaussianConditional`, which is one,
    has.
    """
    whole = gtsam.GaussianConditional(terms, 1, b, UNIT[len(b)])
    return gtsam.LinearContainerFactor(gtsam.JacobianFactor(whole), point)


def knot_factor(errors: Errors, knot: int, ended: float) -> Factor:
    """What a knot's drift says about that of the next one, after so many metres."""
    stays, anew = forgotten(ended, errors.systematic.length)
    sigma = np.sqrt(anew)
    terms = [(drift_key(knot), np.array([[-stays / sigma]])), (drift_key(knot + 1), np.array([[1.0 / sigma]]))]
    return linear_factor(terms, np.zeros(1), errors.zero(key for key, _ in terms))


def first_factors(errors: Errors, prior: Prior) -> tuple[list[Factor], gtsam.Values]:
    """The prior of the first pose and the errors, with start values; `prior` is the robot's, in its own frame."""
    values = errors.zero(errors.keys(0))
    size = errors.sizes
    alone = [
        gtsam.PriorFactorVector(key, np.zeros(n), noise.Unit.Create(n))
        for key, n in zip(errors.keys(0), size.values(), strict=True)
    ]
    sigma = errors.systematic.sigma
    mean, P = errors.frame.prior_in(prior, sigma)
    values.insert(X(0), pose2(mean[:3]))
    if errors.frame.same:
        return [prior_factor(prior), *alone], values
    # the pose given the errors; in the body frame, as gtsam has it
    B = world_from_body(mean[2])
    K = P[:3, 3:] / sigma**2
    variance, axes = np.linalg.eigh(B.T @ (P[:3, :3] - K @ P[3:, :3]) @ B)
    given = axes @ np.diag(np.maximum(variance, PINNED**2)) @ axes.T
    root = root_information(given[None])[0][0]
    pose = linear_factor([(X(0), root), *errors.terms(-root @ B.T @ K * sigma, 0)], np.zeros(3), values)
    return [pose, *alone], values


def sight_pinned(
    errors: Errors, sensor: Sensor, seen: Sightings, frames: IntArray, number: IntArray, xy: Array, row: int, loss: str,
    now: Array,
) -> list[Sighted]:  # fmt: skip
    """Known landmarks at xy (m, 2) of the world, which depend on the errors in the sensor's frame.

    Copies L(row), ... for each sighting, of relative points as well; they start where errors `now` (p,) put them.
    """
    copies = np.arange(row, row + len(number))
    there, _ = errors.frame.points_in(xy, now)
    zero, J = errors.frame.points_in(xy, np.zeros_like(now))
    found = sight_landmarks(sensor, *seen, frames, copies, loss)
    result = []
    for i, s in enumerate(found):
        assert s.key is not None
        point = errors.zero(errors.keys(0)[:1])
        point.insert(s.key, zero[i])
        terms = [(s.key, np.eye(2) / PINNED), *errors.terms(-J[i] / PINNED * errors.systematic.sigma, 0)[:1]]
        pin = linear_factor(terms, np.zeros(2), point)
        result.append(replace(s, number=int(number[i]), pin=pin, xy=there[i]))
    return result
