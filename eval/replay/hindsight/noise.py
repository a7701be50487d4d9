"""Variance scales of the stated noise, learned from innovations and from consecutive frames.

*By innovations.* Stated noise is often several times too large, because lasting errors must count for less. This is
right for an estimate, but not for comparing explanations. So squared innovations are taken relative to their usual
size, with Student's tails because slips happen.

*By differences of consecutive frames.* Observations of one frame are expected in the next one, moved by odometry.
Mutual nearest neighbours differ by the noise of both observations and by that of the motion, which all pairs of a step
share. These variance components are fitted by expectation maximization (Dempster, Laird and Rubin, Journal of the Royal
Statistical Society B 39, 1977). A pair may also be of a moving object, or of two landmarks at the density of the view.
Lasting errors, of a calibration for example, cancel.

Where the log shows more noise or a wider view than stated, `Restated` corrects the statement. It never reduces noise,
because differences hide lasting errors; innovations narrow the gates (`gates`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from association.candidates import holding
from association.expectation import gate_threshold
from data.blocks import squared_norms
from data.compiled import njit
from data.inputs import Frame, FrameObservations, Increment, IntArray
from data.notice import Code, Notice, notice
from data.se2 import Array
from data.sensors import MIN_RANGE, RANGE_BEARING, Sensor
from eval.replay.hindsight import constants


class NoiseScale(NamedTuple):
    """Variance of the innovations over the stated one, and the weight of what was learned, in innovations."""

    scale: float
    weight: float


def stated() -> NoiseScale:
    """The scale before anything is learned, with a known map."""
    return NoiseScale(1.0, constants.NOISE_PRIOR)


def log_density(noise: NoiseScale, d2: float, log_det: float) -> float:
    """Log density of an innovation (2,): Student's t with `noise.scale` times the stated covariance as scale matrix.
    d2, log_det: squared distance and log determinant under the stated covariance.
    """
    tails = 0.5 * (constants.FREEDOM + 2.0) * math.log1p(d2 / (constants.FREEDOM * noise.scale))
    return -math.log(2.0 * math.pi * noise.scale) - 0.5 * log_det - tails


def learned(before: NoiseScale, d2: Array, share: Array) -> NoiseScale:
    """The scale after squared innovations d2 (k,), each with weight share (k,). One step of expectation maximization
    for Student's t (Liu and Rubin, Statistica Sinica 5, 1995), with fading memory.
    """
    total = float(share.sum())
    if total <= 0.0:
        return before
    counts = (constants.FREEDOM + 2.0) / (constants.FREEDOM + d2 / before.scale)
    weight = min(before.weight + total, max(constants.NOISE_MEMORY, total))
    scale = before.scale + (0.5 * float(share @ (counts * d2)) - total * before.scale) / weight
    return NoiseScale(max(scale, constants.LEAST_SCALE), weight)


SOME = 0.1  # share of the pairs of moving objects before the first round


class Shares(NamedTuple):
    """Variances of ranges, of bearings and of the motion, over the stated ones."""

    range: float = 1.0
    bearing: float = 1.0
    motion: float = 1.0


AS_STATED = Shares()


class Step(NamedTuple):
    """The K pairs of two consecutive frames.

    covariance: (3, 3) stated, of the motion between them. nu: (K, 2) differences; H: (K, 2, 3) their Jacobians to the
    motion; by_range, by_bearing: (K, 2, 2) covariances from the stated noise of both observations. chance: (K,) density
    at nu of the difference to another landmark.
    """

    covariance: Array
    nu: Array
    H: Array
    by_range: Array
    by_bearing: Array
    chance: Array


def axes(sensor: Sensor, z: Array) -> Array:
    """Directions of range and bearing (m, 2, 2), as columns, in the space of measurements (m, 2)."""
    if sensor.kind == RANGE_BEARING:
        return np.broadcast_to(np.eye(2), (len(z), 2, 2))
    r = np.hypot(z[:, 0], z[:, 1])[:, None]
    along = np.where(r < MIN_RANGE, [1.0, 0.0], z / np.maximum(r, MIN_RANGE))  # nothing has a direction at zero range
    return np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=-1)


def with_shares(sensor: Sensor, observations: FrameObservations, shares: Shares) -> FrameObservations:
    """The same observations with variances scaled by shares."""
    z, R = observations
    T = axes(sensor, z)
    D = T @ np.diag(np.sqrt([shares.range, shares.bearing])) @ T.transpose(0, 2, 1)
    return FrameObservations(z, D @ R @ D)


class Consecutive(NamedTuple):
    """Observations of two consecutive frames, the motion between them, and the reach [m] of the view by then."""

    before: FrameObservations
    motion: Increment
    now: FrameObservations
    reach: float


def paired(sensor: Sensor, every: Sequence[Consecutive]) -> list[Step]:
    """Mutual nearest neighbours of two frames under the stated noise. What has no noise has no share of any."""
    parts = zip(*((*c.before, *c.now, *c.motion) for c in every), strict=True)
    old_z, old_R, new_z, new_R = (np.concatenate(next(parts)) for _ in range(4))
    motion, M = (np.stack(each) for each in parts)
    olds, news = np.cumsum([(0, 0), *((len(c.before.z), len(c.now.z)) for c in every)], axis=0).T
    of = np.repeat(np.arange(len(every)), np.diff(olds))
    xy, _, Gz = sensor.inverse(np.zeros(3), old_z)
    z_hat, H, Hl = sensor.linearize(motion[of], xy)
    J = Hl @ Gz
    S = J @ old_R @ J.transpose(0, 2, 1) + H @ M[of] @ H.transpose(0, 2, 1)
    pairs = list[tuple[IntArray, IntArray]]()
    for (i, j), (m, n) in zip(pairwise(olds.tolist()), pairwise(news.tolist()), strict=True):
        d2 = squared_norms(sensor.residual(new_z[m:n, None], z_hat[None, i:j]), S[i:j] + new_R[m:n, None])
        nearest = d2.argmin(axis=1)
        rows = np.flatnonzero(d2.argmin(axis=0)[nearest] == np.arange(n - m))
        pairs.append((m + rows, i + nearest[rows]))
    rows, at = (np.concatenate(part) for part in zip(*pairs, strict=True))
    here, there = _by_direction(sensor, new_z[rows], new_R[rows]), _by_direction(sensor, old_z[at], old_R[at])
    by_range, by_bearing = (a + J[at] @ b @ J[at].transpose(0, 2, 1) for a, b in zip(here, there, strict=True))
    reach = np.array([c.reach for c in every])
    density = np.diff(olds) / (0.5 * (sensor.max_angle - sensor.min_angle) * reach**2)
    per_unit = np.maximum(new_z[rows, 0], MIN_RANGE) if sensor.kind == RANGE_BEARING else np.ones(len(rows))
    columns = sensor.residual(new_z[rows], z_hat[at]), H[at], by_range, by_bearing, density[of[at]] * per_unit
    ends = np.cumsum([len(rows) for rows, _ in pairs])[:-1]
    steps = [Step(*parts) for parts in zip(M, *(np.split(each, ends) for each in columns), strict=True)]
    some = np.minimum.reduceat(np.linalg.det(by_range + by_bearing), [0, *ends])
    return [step for step, least in zip(steps, np.minimum(np.linalg.det(M), some), strict=True) if least > 0.0]


def _by_direction(sensor: Sensor, z: Array, R: Array) -> tuple[Array, Array]:
    """The parts (m, 2, 2) of R (m, 2, 2) from range and bearing noise, without their correlation."""
    T = axes(sensor, z)
    variance = (T * (R @ T)).sum(axis=1)
    along, across = (variance[:, i, None, None] * T[:, :, None, i] * T[:, None, :, i] for i in range(2))
    return along, across


def fitted(steps: list[Step]) -> Shares:
    """The most likely shares; as stated if a nearest neighbour may be any landmark."""
    of = np.repeat(np.arange(len(steps)), [len(s.nu) for s in steps])
    s = Step(np.stack([s.covariance for s in steps]), *map(np.concatenate, list(zip(*steps, strict=True))[1:]))
    prior, rounds, wide = constants.DIFFERENCES_PRIOR, constants.DIFFERENCES_ROUNDS, constants.DIFFERENCES_WIDE
    found = Shares(*_fit(of, s, prior, rounds, wide, SOME))
    moved = s.H @ s.covariance[of] @ s.H.transpose(0, 2, 1)
    S = found.range * s.by_range + found.bearing * s.by_bearing + found.motion * moved
    others = s.chance * math.pi * gate_threshold(constants.DENSE_GATE) * np.sqrt(np.linalg.det(S))
    return found if others.mean() < constants.DENSE else AS_STATED


@njit
def _inverse(A: Array, out: Array) -> None:
    """Inverse `out` of a symmetric A (3, 3)."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for q in range(3):
            r, t = (q + 1) % 3, (q + 2) % 3
            out[i, q] = A[j, r] * A[k, t] - A[j, t] * A[k, r]
    det = A[0, 0] * out[0, 0] + A[0, 1] * out[0, 1] + A[0, 2] * out[0, 2]
    for i in range(3):
        for q in range(3):
            out[i, q] /= det


@njit
def _through(H: Array, P: Array) -> tuple[float, float, float]:
    """Entries xx, xy and yy of H P H' with H (2, 3)."""
    xx, xy, yy = 0.0, 0.0, 0.0
    for r in range(3):
        a = P[r, 0] * H[0, 0] + P[r, 1] * H[0, 1] + P[r, 2] * H[0, 2]
        b = P[r, 0] * H[1, 0] + P[r, 1] * H[1, 1] + P[r, 2] * H[1, 2]
        xx, xy, yy = xx + H[0, r] * a, xy + H[0, r] * b, yy + H[1, r] * b
    return xx, xy, yy


@njit
def _normal(x: float, y: float, xx: float, xy: float, yy: float) -> float:
    """Density at (x, y) of a normal variable of covariance [[xx, xy], [xy, yy]]."""
    det = xx * yy - xy * xy
    d2 = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / det
    return math.exp(-0.5 * d2) / (2.0 * math.pi * math.sqrt(det))


@njit
def _trace(S: Array, A: Array) -> float:
    """Trace of S A, for a symmetric S with the entries xx, xy, yy (3,) and A (2, 2)."""
    return float(S[0] * A[0, 0] + S[1] * A[0, 1] + S[1] * A[1, 0] + S[2] * A[1, 1])


class Motions(NamedTuple):
    """Of each step's motion: information L (F, 3, 3), b (F, 3) = L x, covariance P and mean x."""

    L: Array
    b: Array
    P: Array
    x: Array


@njit
def _motions(
    of: IntArray, weight: Array, information: Array, pull: Array, stated: Array, share: float, motions: Motions
) -> None:
    """The motion of each step by its pairs, and by its `stated` information (F, 3, 3) where that counts a `share`."""
    L, b, P, x = motions
    b[:] = 0.0
    L[:] = stated / share
    for j in range(len(of)):
        for r in range(3):
            b[of[j], r] += weight[j] * pull[j, r]
            for c in range(3):
                L[of[j], r, c] += weight[j] * information[j, r, c]
    for k in range(len(L)):
        _inverse(L[k], P[k])
        for r in range(3):
            x[k, r] = P[k, r, 0] * b[k, 0] + P[k, r, 1] * b[k, 1] + P[k, r, 2] * b[k, 2]


@njit
def _fit(of: IntArray, s: Step, prior: float, rounds: int, wide: float, some: float) -> tuple[float, float, float]:
    """Shares after `rounds` rounds, with a prior of `prior` pairs for the stated noise; pair j is of step of[j]."""
    _, nu, H, one, two, chance = s
    n, steps = len(of), len(s.covariance)
    # from above: noise that is as large as that of what moves would else be taken for it
    by_range, by_bearing, by_motion = wide, wide, 1.0
    static, mobile, mixed = 0.5 - 0.5 * some, some, 0.5 - 0.5 * some
    stated, L, P = np.empty((steps, 3, 3)), np.empty((steps, 3, 3)), np.empty((steps, 3, 3))
    for k in range(steps):
        _inverse(s.covariance[k], stated[k])
    b, moved, weight = np.empty((steps, 3)), np.empty((steps, 3)), np.ones(n)
    motions = Motions(L, b, P, moved)
    R, W, WH = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 2, 3))
    information, pull = np.empty((n, 3, 3)), np.empty((n, 3))
    left, rest = np.empty((3, 3)), np.empty((3, 3))
    for _ in range(rounds):
        for j in range(n):
            xx = by_range * one[j, 0, 0] + by_bearing * two[j, 0, 0]
            xy = by_range * one[j, 0, 1] + by_bearing * two[j, 0, 1]
            yy = by_range * one[j, 1, 1] + by_bearing * two[j, 1, 1]
            det = xx * yy - xy * xy
            R[j, 0], R[j, 1], R[j, 2] = xx, xy, yy
            W[j, 0], W[j, 1], W[j, 2] = yy / det, -xy / det, xx / det
            for c in range(3):
                WH[j, 0, c] = W[j, 0] * H[j, 0, c] + W[j, 1] * H[j, 1, c]
                WH[j, 1, c] = W[j, 1] * H[j, 0, c] + W[j, 2] * H[j, 1, c]
                pull[j, c] = WH[j, 0, c] * nu[j, 0] + WH[j, 1, c] * nu[j, 1]
                for r in range(3):
                    information[j, r, c] = H[j, 0, r] * WH[j, 0, c] + H[j, 1, r] * WH[j, 1, c]
        _motions(of, weight, information, pull, stated, by_motion, motions)
        above_r = below_r = prior * (0.5 / by_range)
        above_b = below_b = prior * (0.5 / by_bearing)
        above_m = below_m = prior
        statics, mobiles, mixeds = static, mobile, mixed
        for j in range(n):  # by what the other pairs of the step say of the motion
            k, x, y = of[j], nu[j, 0], nu[j, 1]
            for r in range(3):
                for c in range(3):
                    left[r, c] = L[k, r, c] - weight[j] * information[j, r, c]
            _inverse(left, rest)
            for r in range(3):
                at = 0.0
                for c in range(3):
                    at += rest[r, c] * (b[k, c] - weight[j] * pull[j, c])
                x, y = x - H[j, 0, r] * at, y - H[j, 1, r] * at
            xx, xy, yy = _through(H[j], rest)
            good = static * _normal(x, y, R[j, 0] + xx, R[j, 1] + xy, R[j, 2] + yy)
            moving = mobile * _normal(x, y, wide * R[j, 0] + xx, wide * R[j, 1] + xy, wide * R[j, 2] + yy)
            every = good + moving + mixed * chance[j]
            good, moving, other = good / every, moving / every, mixed * chance[j] / every
            weight[j] = good + moving / wide
            statics, mobiles, mixeds = statics + good, mobiles + moving, mixeds + other
            # sums of those of ranges and bearings are in units of the present shares
            below_r += 0.5 * (good + moving) * _trace(W[j], one[j])
            below_b += 0.5 * (good + moving) * _trace(W[j], two[j])
        static, mobile, mixed = statics / (1.0 + n), mobiles / (1.0 + n), mixeds / (1.0 + n)
        _motions(of, weight, information, pull, stated, by_motion, motions)
        for j in range(n):
            x, y = nu[j, 0], nu[j, 1]
            for r in range(3):
                x, y = x - H[j, 0, r] * moved[of[j], r], y - H[j, 1, r] * moved[of[j], r]
            x, y = W[j, 0] * x + W[j, 1] * y, W[j, 1] * x + W[j, 2] * y
            xx, xy, yy = _through(WH[j], P[of[j]])
            pull[j, 0], pull[j, 1], pull[j, 2] = xx + x * x, xy + x * y, yy + y * y
            above_r += 0.5 * by_range * weight[j] * _trace(pull[j], one[j])
            above_b += 0.5 * by_bearing * weight[j] * _trace(pull[j], two[j])
        for k in range(steps):
            for r in range(3):
                for c in range(3):
                    above_m += stated[k, r, c] * (P[k, r, c] + moved[k, r] * moved[k, c]) / 3.0
        by_range, by_bearing, by_motion = above_r / below_r, above_b / below_b, above_m / (below_m + steps)
    return by_range, by_bearing, by_motion


class Restated:
    """Estimates the noise from a log's frames, and restates the covariances of later ones. It collects steps between
    frames, and fits the shares at the 1st, 2nd, 4th, 8th, ... step.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.shares = AS_STATED  # variances of range, bearing and motion over the stated ones; none is below 1
        self._sensor = self._view = sensor
        self._fitted = AS_STATED
        self._before: FrameObservations | None = None
        self._steps: list[Step] = []
        self._waiting: list[Consecutive] = []  # of these, those without noise leave no step
        self._farthest = MIN_RANGE

    def fit(self, increment: Increment | None, observations: FrameObservations) -> Shares:
        """Add the next frame; returns the shares as they are fitted by now."""
        if len(self._steps) >= constants.DIFFERENCES_MOST:
            return self._fitted
        before, self._before = self._before, observations if len(observations.z) else None
        if not len(observations.z):
            return self._fitted
        self._farthest = max(self._farthest, float(self._sensor.polar(observations.z)[:, 0].max()))
        if before is not None and increment is not None:
            self._waiting.append(Consecutive(before, increment, observations, self._farthest))
            if (len(self._steps) + len(self._waiting)).bit_count() == 1:
                self._steps += paired(self._sensor, self._waiting)
                self._waiting.clear()
                if len(self._steps).bit_count() == 1:
                    self._fitted = fitted(self._steps)
        return self._fitted

    def see(self, frame: Frame) -> Frame:
        """Add the next frame; returns it with the noise known by now."""
        self._view = holding(self._view, self._sensor.polar(frame.observations.z))
        found = self.fit(frame.increment, frame.observations)
        self.shares = Shares(*(s if s > constants.UNDERSTATED**2 else 1.0 for s in found))
        return self.restated(frame)

    def restated(self, frame: Frame) -> Frame:
        """A frame with the noise that is known by now."""
        if self.shares == AS_STATED:
            return frame
        increment = frame.increment
        if increment is not None:
            increment = increment._replace(covariance=self.shares.motion * increment.covariance)
        seen = with_shares(self._sensor, frame.observations, self.shares)
        return frame._replace(increment=increment, observations=seen)

    def widened(self, sensor: Sensor) -> Sensor:
        """A sensor whose view holds all observations so far."""
        view = self._view
        if view is sensor:
            return sensor
        return replace(sensor, max_range=view.max_range, min_angle=view.min_angle, max_angle=view.max_angle)

    def notes(self) -> list[Notice]:
        """Messages about larger noise."""
        more = {name: s**0.5 for name, s in self.shares._asdict().items() if s > 1.0}
        return [notice(Code.LARGER_SIGMAS, of=tuple(more), factors=tuple(more.values()))] if more else []
