"""Factors of the systematic errors: with increments, priors, between knots, and with known landmarks.

The factor of an increment is exact in both poses, and linear in the errors. A factor linear in the poses as well is
exact only to first order: poses move by metres while increments are known to millimetres. So the residual is evaluated
at each linearization at the present errors, and extrapolated by its tangent to the errors of gtsam's linearization
point. These may be far apart, without another elimination of the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.compiled import njit
from data.inputs import FrameObservations, Increment, IntArray, Prior
from data.motion.systematic import forgotten
from data.se2 import Array, world_from_body
from data.sensors import Sensor
from graph.factors import (
    Factor,
    ObservationFactors,
    increment_roots,
    landmark_factors,
    noise,
    pose2,
    prior_factor,
    root_information,
)
from graph.qr.calibrated import linearize_increments
from graph.systematic import Errors, drift_key

PINNED = 1e-4
"""m. Sigma of a known landmark in the sensor's frame, where no prior can hold it exactly. It adds 1e-4 to the variance
of observations of 0.01 m; Cholesky fails at a weight of 1e10."""
UNIT = {n: noise.Unit.Create(n) for n in (1, 2, 3)}


def linear_factor(terms: list[tuple[int, Array]], b: Array, point: gtsam.Values) -> Factor:
    """The residual sum of A x - b in units of its sigma, x relative to `point`. A `JacobianFactor` of more than three
    variables has no constructor in Python; its subclass `GaussianConditional` has.
    """
    whole = gtsam.GaussianConditional(terms, 1, b, UNIT[len(b)])
    return gtsam.LinearContainerFactor(gtsam.JacobianFactor(whole), point)


def knot_factor(errors: Errors, knot: int, ended: float) -> Factor:
    """The factor between a knot's drift and that of the next one, after `ended` metres."""
    decay, fresh = forgotten(ended, errors.systematic.length)
    sigma = np.sqrt(fresh)
    terms = [(drift_key(knot), np.array([[-decay / sigma]])), (drift_key(knot + 1), np.array([[1.0 / sigma]]))]
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
    # the pose given the errors, in gtsam's body frame
    B = world_from_body(mean[2])
    K = P[:3, 3:] / sigma**2
    variance, axes = np.linalg.eigh(B.T @ (P[:3, :3] - K @ P[3:, :3]) @ B)
    given = axes @ np.diag(np.maximum(variance, PINNED**2)) @ axes.T
    root = root_information(given[None])[0][0]
    pose = linear_factor([(X(0), root), *errors.terms(-root @ B.T @ K * sigma, 0)], np.zeros(3), values)
    return [pose, *alone], values


def pinned_landmark_factors(
    errors: Errors,
    sensor: Sensor,
    seen: FrameObservations,
    frames: IntArray,
    number: IntArray,
    xy: Array,
    row: int,
    loss: str,
    now: Array,
) -> list[ObservationFactors]:
    """Known landmarks at xy (m, 2) of the world, which depend on the errors in the sensor's frame. Copies L(row), ...
    for each observation, of relative points as well; they start according to the errors `now` (p,).
    """
    copies = np.arange(row, row + len(number))
    there, _ = errors.frame.points_in(xy, now)
    zero, J = errors.frame.points_in(xy, np.zeros_like(now))
    found = landmark_factors(sensor, *seen, frames, copies, loss)
    result = []
    for i, s in enumerate(found):
        assert s.key is not None
        point = errors.zero(errors.keys(0)[:1])
        point.insert(s.key, zero[i])
        terms = [(s.key, np.eye(2) / PINNED), *errors.terms(-J[i] / PINNED * errors.systematic.sigma, 0)[:1]]
        pin = linear_factor(terms, np.zeros(2), point)
        result.append(replace(s, number=int(number[i]), pin=pin, xy=there[i]))
    return result


Residual = Callable[[gtsam.CustomFactor, gtsam.Values, list[Array] | None], Array]


@njit
def tangent(
    pose: Array,
    at: Array,
    errors: Array,
    order: IntArray,
    sigma: Array,
    motion: Array,
    root: Array,
    place: IntArray,
    mount: Array,
) -> Array:
    """Columns (3, 1 + 6 + p): the whitened residual of one increment and its Jacobians to both poses and the variables.

    `pose` (2, 3): before and after the increment; the residual is linearized at `errors` (p,) and extrapolated to
    variables `at` (p,). Each of these is error `order` (p,), all in units of `sigma` (p,); others as of
    `linearize_increments`.
    """
    p = len(at)
    b = np.empty((1, p))
    for j in range(p):
        b[0, order[j]] = errors[j] * sigma[order[j]]
    residual, before, after, by = linearize_increments(pose, motion, root, b, place, mount)
    found = np.empty((3, 7 + p))
    for i in range(3):
        found[i, 0] = residual[0, i]
        for j in range(3):
            found[i, 1 + j], found[i, 4 + j] = before[0, i, j], after[0, i, j]
        for j in range(p):
            slope = by[0, i, order[j]] * sigma[order[j]]
            found[i, 7 + j] = slope
            found[i, 0] += slope * (at[j] - errors[j])
    return found


def increment_factor(
    errors: Errors, frame: int, increment: Increment, root: Array, knot: int, now: Array
) -> gtsam.CustomFactor:
    """The increment into a frame; root (3, 3): R with R'R the information of odometry's noise; `knot`: of its drift.
    `now` (q,): the present constants, in prior sigmas, read at each linearization.
    """
    keys = [X(frame - 1), X(frame), *errors.keys(knot)]
    return gtsam.CustomFactor(UNIT[3], keys, _residual(errors, keys, increment.mean, root, now))


def _residual(errors: Errors, keys: Sequence[int], mean: Array, root: Array, now: Array) -> Residual:
    """The callback of gtsam at each linearization of the factor."""
    before, after, q = keys[0], keys[1], len(errors.constant)
    constants, drift = keys[2], keys[-1] if errors.drift >= 0 else -1
    # copies: read-only arrays would compile the kernel once more
    given = [np.array(a, float, order="C") for a in (errors.systematic.sigma, mean[None], root[None])]
    sigma, motion, roots = given
    order, place, mount = np.array(errors.order), np.array(errors.place), np.array(errors.frame.mount, float)

    def residual(_: gtsam.CustomFactor, values: gtsam.Values, H: list[Array] | None) -> Array:
        p, r = values.atPose2(before), values.atPose2(after)
        if drift < 0:
            at, about = values.atVector(constants), now
        else:
            d = values.atVector(drift)
            at = np.concatenate([values.atVector(constants), d]) if q else d
            about = np.concatenate([now, d]) if q else d
        poses = np.array([[p.x(), p.y(), p.theta()], [r.x(), r.y(), r.theta()]])
        found = tangent(poses, at, about, order, sigma, motion, roots, place, mount)
        if H is not None:
            H[0], H[1] = found[:, 1:4], found[:, 4:7]
            if q:
                H[2] = found[:, 7 : 7 + q]
            if drift >= 0:
                H[-1] = found[:, -1:]
        column: Array = found[:, 0]
        return column

    return residual


class Motion:
    """All increments so far, in the order of frames from 1 on."""

    def __init__(self, errors: Errors) -> None:
        self._errors = errors
        self.knot = 0  # the newest one of the drift
        self.now = np.zeros(len(errors.constant))  # in prior sigmas: all factors are linearized there
        self._mean, self._covariance = [np.zeros(3)], [np.zeros((3, 3))]
        self._knots = list[int]()
        self.oldest = 0  # first frame in the graph; increments up to it are no factors any more
        self._first_knot = 0

    @property
    def raw(self) -> tuple[Array, Array]:
        """Increments (N, 3) and covariances (N, 3, 3) as stated by odometry."""
        return np.array(self._mean), np.array(self._covariance)

    def extend(self, first: int, increments: Sequence[Increment], knots: Sequence[int]) -> tuple[list[Factor], float]:
        """Factors of increments (n) into frames `first`, ..., with the knots (n,) of their drift. Also returns the
        smallest pivot of the covariances. Raises DataError for a singular one.
        """
        mean, covariance = (np.array(rows) for rows in zip(*increments, strict=True))
        roots, pivot = increment_roots(first, covariance)
        self._mean += list(mean)
        self._covariance += list(covariance)
        self._knots += knots
        found: list[Factor] = [
            increment_factor(self._errors, first + i, increments[i], roots[i], knots[i], self.now)
            for i in range(len(mean))
        ]
        return found, pivot

    def again(self, frame: int, increment: Increment) -> Factor:
        """The factor of the newest increment, into this frame, anew with another covariance."""
        (root,), _ = increment_roots(frame, increment.covariance[None])
        self._covariance[-1] = increment.covariance
        return increment_factor(self._errors, frame, increment, root, self._knots[-1], self.now)

    def knot_of(self, frame: int) -> int:
        """Knot of the increment into a frame of the graph (0 of frame 0)."""
        return self._knots[max(frame - 1 - self.oldest, 0)] if self._knots else self.knot

    def forget(self, oldest: int) -> range:
        """Make frame `oldest` the first one in the graph; returns the knots that left it."""
        removed, first = oldest - self.oldest, self._first_knot
        del self._knots[:removed]
        self.oldest = oldest
        self._first_knot = self._knots[0] if self._knots else self.knot
        return range(first, self._first_knot)
