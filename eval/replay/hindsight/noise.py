"""How much noise there is, whatever is stated: learned from what is believed, and told before any map.

*By innovations.* Stated noise is often several times too wide, because errors that last are to count for less than
their spread says. It is right for the estimate then, but not for comparing explanations: one that fits ten times as
well as the other, in terms of the noise that there really is, would count as equally good. So squared innovations are
taken relative to their usual size, and as slips happen, their distribution has Student's tails.

*By differences of consecutive frames.* What one frame read is expected in the next one, moved by odometry. Readings
that are each other's nearest neighbours differ by the noise of both, each of its own, and by that of the motion, which
all pairs of a step have in common: variance components, fitted by expectation maximization (Dempster, Laird and Rubin,
Journal of the Royal Statistical Society B 39, 1977). A pair may be of something that moved, whose differences are
wider, or of two landmarks: these differ as neighbours do by chance, at the density of the readings in the view. Errors
that last, of a calibration say, cancel.

Where the log shows more noise or a wider view than is stated, the statement is put right (`Restated`). Noise is only
ever taken for more: differences hide errors that last, so that less of them is no reason to believe in less noise;
gates are narrowed by innovations (`gates`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np

from association.candidates import holding
from association.expectation import gate_threshold
from data.inputs import Frame, FrameObservations, Increment, IntArray
from data.notice import Code, Notice, notice
from data.se2 import Array
from data.sensors import MIN_RANGE, RANGE_BEARING, Sensor
from eval.replay.hindsight import constants


class NoiseScale(NamedTuple):
    """Variance of the innovations as a share of what was stated, and the weight of what was learned, in innovations."""

    scale: float
    weight: float


def stated() -> NoiseScale:
    """In a known map before anything is learned: what was stated, worth as much as a few innovations."""
    return NoiseScale(1.0, constants.NOISE_PRIOR)


def log_density(noise: NoiseScale, d2: float, log_det: float) -> float:
    """Logarithm of the density of an innovation (2,): d^2 and log determinant by its stated covariance.

    Student's t in two dimensions with the scale matrix `noise.scale` times the stated covariance.
    """
    tails = 0.5 * (constants.FREEDOM + 2.0) * math.log1p(d2 / (constants.FREEDOM * noise.scale))
    return -math.log(2.0 * math.pi * noise.scale) - 0.5 * log_det - tails


def learned(before: NoiseScale, d2: Array, share: Array) -> NoiseScale:
    """The scale after innovations of squares d2 (k,), each believed to a share (k,).

    One step of expectation maximization for Student's t (Liu and Rubin, Statistica Sinica 5, 1995), with fading memory.
    """
    total = float(share.sum())
    if total <= 0.0:
        return before
    counts = (constants.FREEDOM + 2.0) / (constants.FREEDOM + d2 / before.scale)
    weight = min(before.weight + total, max(constants.NOISE_MEMORY, total))
    scale = before.scale + (0.5 * float(share @ (counts * d2)) - total * before.scale) / weight
    return NoiseScale(max(scale, constants.LEAST_SCALE), weight)


SOME = 0.1
"""Share of the pairs that are of something that moves, before the first round; the others are shared out evenly."""


class Shares(NamedTuple):
    """Variances of ranges, of bearings and of the motion, in those that were stated."""

    range: float = 1.0
    bearing: float = 1.0
    motion: float = 1.0


AS_STATED = Shares()


class Step(NamedTuple):
    """The K pairs of two consecutive frames.

    covariance: (3, 3) of the motion between them, as stated.
    nu: (K, 2) differences; H: (K, 2, 3) their Jacobians to the motion; by_range, by_bearing: (K, 2, 2) covariances that
    the stated noise of both readings gives them.
    chance: (K,) density at nu of the difference to a neighbour that is another landmark.
    """

    covariance: Array
    nu: Array
    H: Array
    by_range: Array
    by_bearing: Array
    chance: Array


class Differences:
    """Collects the steps from one frame to the next; what they tell is worked out at the 1st, 2nd, 4th, 8th one."""

    def __init__(self, sensor: Sensor) -> None:
        """Before the first frame."""
        self._sensor, self._shares = sensor, AS_STATED
        self._before: FrameObservations | None = None
        self._steps: list[Step] = []
        self._farthest = MIN_RANGE

    def see(self, increment: Increment | None, observations: FrameObservations) -> Shares:
        """The next frame, its motion and what was read; what is known of the noise by now."""
        if len(self._steps) >= constants.DIFFERENCES_MOST:
            return self._shares
        before, self._before = self._before, observations if len(observations.z) else None
        if not len(observations.z):
            return self._shares
        self._farthest = max(self._farthest, float(self._sensor.polar(observations.z)[:, 0].max()))
        if before is not None and increment is not None:
            step = paired(self._sensor, before, increment, observations, self._farthest)
            exact = min(np.linalg.det(step.covariance), *np.linalg.det(step.by_range + step.by_bearing)) <= 0.0
            if not exact:  # what is stated to be without noise has no share of it
                self._steps.append(step)
                if len(self._steps).bit_count() == 1:
                    self._shares = fitted(self._steps)
        return self._shares


def axes(sensor: Sensor, z: Array) -> Array:
    """Directions of the range and of the bearing (m, 2, 2), as columns, in the space of measurements (m, 2)."""
    if sensor.kind == RANGE_BEARING:
        return np.tile(np.eye(2), (len(z), 1, 1))
    r = np.hypot(z[:, 0], z[:, 1])[:, None]
    along = np.where(r < MIN_RANGE, [1.0, 0.0], z / np.maximum(r, MIN_RANGE))  # nothing has a direction at zero range
    return np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=-1)


def with_shares(sensor: Sensor, observations: FrameObservations, shares: Shares) -> FrameObservations:
    """The same readings with such shares of the stated variances."""
    z, R = observations
    T = axes(sensor, z)
    D = T @ np.diag(np.sqrt([shares.range, shares.bearing])) @ T.transpose(0, 2, 1)
    return FrameObservations(z, D @ R @ D)


def paired(
    sensor: Sensor, before: FrameObservations, increment: Increment, now: FrameObservations, reach: float
) -> Step:
    """Readings of two frames that are each other's nearest neighbours, by the stated noise; `reach` [m] of the view."""
    xy, _, Gz = sensor.inverse(np.zeros(3), before.z)
    z_hat, H, Hl = sensor.linearize(increment.mean, xy)
    J = Hl @ Gz
    S = J @ before.R @ J.transpose(0, 2, 1) + H @ increment.covariance @ H.transpose(0, 2, 1)
    nu = sensor.residual(now.z[:, None], z_hat[None])
    d2 = (nu * np.linalg.solve(S[None] + now.R[:, None], nu[..., None])[..., 0]).sum(axis=2)
    density = len(before.z) / (0.5 * (sensor.max_angle - sensor.min_angle) * reach**2)
    per_unit = np.maximum(now.z[:, 0], MIN_RANGE) if sensor.kind == RANGE_BEARING else np.ones(len(now.z))
    nearest = d2.argmin(axis=1)
    rows = np.flatnonzero(d2.argmin(axis=0)[nearest] == np.arange(len(nu)))
    at = nearest[rows]
    here = _by_direction(sensor, FrameObservations(now.z[rows], now.R[rows]))
    there = _by_direction(sensor, FrameObservations(before.z[at], before.R[at]))
    by_range, by_bearing = (a + J[at] @ b @ J[at].transpose(0, 2, 1) for a, b in zip(here, there, strict=True))
    return Step(increment.covariance, nu[rows, at], H[at], by_range, by_bearing, density * per_unit[rows])


def _by_direction(sensor: Sensor, observations: FrameObservations) -> tuple[Array, Array]:
    """The parts (m, 2, 2) of R that are noise of the range and of the bearing, without what these have in common."""
    T = axes(sensor, observations.z)
    variance = np.einsum("mij,mik,mkj->mj", T, observations.R, T)
    along, across = (variance[:, i, None, None] * T[:, :, None, i] * T[:, None, :, i] for i in range(2))
    return along, across


def fitted(steps: list[Step]) -> Shares:
    """The variances that explain the differences best; as stated, if with these a nearest neighbour may be any."""
    first = np.concatenate([[0], np.cumsum([len(s.nu) for s in steps])])
    covariance = np.stack([s.covariance for s in steps])
    nu, H, by_range, by_bearing, chance = (np.concatenate(c) for c in list(zip(*steps, strict=True))[1:])
    prior, rounds, wide = constants.DIFFERENCES_PRIOR, constants.DIFFERENCES_ROUNDS, constants.DIFFERENCES_WIDE
    share = _fit(first, covariance, nu, H, by_range, by_bearing, chance, prior, rounds, wide, SOME)
    found = Shares(*share.tolist())
    moved = H @ covariance[np.repeat(np.arange(len(steps)), np.diff(first))] @ H.transpose(0, 2, 1)
    S = found.range * by_range + found.bearing * by_bearing + found.motion * moved
    others = chance * math.pi * gate_threshold(constants.DENSE_GATE) * np.sqrt(np.linalg.det(S))
    return found if others.mean() < constants.DENSE else AS_STATED


@numba.njit(cache=True)
def _fit(
    first: IntArray,
    covariance: Array,
    nu: Array,
    H: Array,
    by_range: Array,
    by_bearing: Array,
    chance: Array,
    prior: float,
    rounds: int,
    wide: float,
    some: float,
) -> Array:
    """Shares (3,) after so many rounds, where `prior` pairs and steps say that all is as stated.

    The pairs of step f are rows first[f] to first[f + 1] - 1. A pair is as it should be, of something that moves (its
    noise `wide` times as large), or of two landmarks.
    """
    # from above: noise that is as large as that of what moves would else be taken for it
    share, how = np.array([wide, wide, 1.0]), np.array([0.5 - 0.5 * some, some, 0.5 - 0.5 * some])
    n = len(nu)
    weight, held = np.ones(n), np.ones(n)
    W, information, pull = np.empty((n, 2, 2)), np.empty((n, 3, 3)), np.empty((n, 3))
    stated = np.empty_like(covariance)
    for f in range(len(covariance)):
        stated[f] = np.linalg.inv(covariance[f])
    for _ in range(rounds):
        # sums of those of ranges and bearings are in units of the present shares
        above = prior * np.array([0.5 / share[0], 0.5 / share[1], 1.0])
        below, total = above.copy(), how.copy()
        for f in range(len(covariance)):
            L, b = stated[f] / share[2], np.zeros(3)
            for j in range(first[f], first[f + 1]):
                W[j] = np.linalg.inv(share[0] * by_range[j] + share[1] * by_bearing[j])
                WH = W[j] @ H[j]
                information[j] = H[j].T @ WH
                pull[j] = WH.T @ nu[j]
                L += weight[j] * information[j]
                b += weight[j] * pull[j]
            for j in range(first[f], first[f + 1]):
                # by what the other pairs of the step say of the motion
                rest = np.linalg.inv(L - weight[j] * information[j])
                off = nu[j] - H[j] @ (rest @ (b - weight[j] * pull[j]))
                HPH = H[j] @ rest @ H[j].T
                R = share[0] * by_range[j] + share[1] * by_bearing[j]
                good, moving = how[0] * _normal(off, R + HPH), how[1] * _normal(off, wide * R + HPH)
                every = good + moving + how[2] * chance[j]
                good, moving = good / every, moving / every
                total += np.array([good, moving, 1.0 - good - moving])
                held[j], weight[j] = good + moving, good + moving / wide
            L, b = stated[f] / share[2], np.zeros(3)
            for j in range(first[f], first[f + 1]):
                L += weight[j] * information[j]
                b += weight[j] * pull[j]
            P = np.linalg.inv(L)
            moved = P @ b
            for j in range(first[f], first[f + 1]):
                WH = W[j] @ H[j]
                v = W[j] @ (nu[j] - H[j] @ moved)
                M = WH @ P @ WH.T + np.outer(v, v)
                above[0] += 0.5 * share[0] * weight[j] * np.sum(M * by_range[j])
                above[1] += 0.5 * share[1] * weight[j] * np.sum(M * by_bearing[j])
                below[0] += 0.5 * held[j] * np.sum(W[j] * by_range[j])
                below[1] += 0.5 * held[j] * np.sum(W[j] * by_bearing[j])
            above[2] += np.sum(stated[f] * (P + np.outer(moved, moved))) / 3.0
            below[2] += 1.0
        share, how = above / below, total / total.sum()
    return share


@numba.njit(cache=True)
def _normal(x: Array, S: Array) -> float:
    """Density at x (2,) of a normal variable of covariance S (2, 2)."""
    det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
    d2 = (S[1, 1] * x[0] * x[0] - (S[0, 1] + S[1, 0]) * x[0] * x[1] + S[0, 0] * x[1] * x[1]) / det
    return math.exp(-0.5 * d2) / (2.0 * math.pi * math.sqrt(det))


class Restated:
    """Reads a log's frames, and restates the covariances of those that come after.

    Attributes:
        shares: variances of range, bearing and motion as they are, in those stated; none is below 1.
    """

    def __init__(self, sensor: Sensor) -> None:
        """Before the first frame."""
        self.shares = AS_STATED
        self._sensor = self._view = sensor
        self._differences = Differences(sensor)

    def see(self, frame: Frame) -> Frame:
        """The next frame, with the noise that is known after it."""
        self._view = holding(self._view, self._sensor.polar(frame.observations.z))
        told = self._differences.see(frame.increment, frame.observations)
        self.shares = Shares(*(s if s > constants.UNDERSTATED**2 else 1.0 for s in told))
        return self.restated(frame)

    def restated(self, frame: Frame) -> Frame:
        """A frame with the noise that is known by now."""
        if self.shares == AS_STATED:
            return frame
        increment = frame.increment
        if increment is not None:
            increment = increment._replace(covariance=self.shares.motion * increment.covariance)
        return frame._replace(
            increment=increment, observations=with_shares(self._sensor, frame.observations, self.shares)
        )

    def widened(self, sensor: Sensor) -> Sensor:
        """A sensor with the view that holds all that was read so far."""
        view = self._view
        return replace(sensor, max_range=view.max_range, min_angle=view.min_angle, max_angle=view.max_angle)

    def notes(self) -> list[Notice]:
        """What a reader of the results should know."""
        more = {name: s**0.5 for name, s in self.shares._asdict().items() if s > 1.0}
        return [notice(Code.LARGER_SIGMAS, of=tuple(more), factors=tuple(more.values()))] if more else []
