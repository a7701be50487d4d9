"""Noise told by the differences of consecutive frames, before any map: variances of range, bearing and motion.

What one frame saw is expected in the next one, moved by odometry. Nearest neighbours of both frames differ by the
noise of both readings, each by its own, and by that of the motion, which is common to all pairs of a frame: variance
components, fitted by expectation maximization (Dempster, Laird and Rubin, Journal of the Royal Statistical Society B
39, 1977). A pair may be of two different landmarks; then it differs as neighbours do by chance, at the density of the
readings in the view.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from association.evidence import constants
from data import se2
from data.inputs import Increment, Sightings
from data.se2 import Array
from data.sensors import RANGE_BEARING, Sensor


class Shares(NamedTuple):
    """Variances of ranges, of bearings and of the motion, in those that were stated."""

    range: float = 1.0
    bearing: float = 1.0
    motion: float = 1.0


AS_STATED = Shares()


class Steps(NamedTuple):
    """Pairs of consecutive frames.

    first: (F + 1,) where the pairs of each step begin; covariance: (F, 3, 3) of its motion.
    nu: (K, 2) difference, H: (K, 2, 3) its Jacobian to the motion; by_range, by_bearing: (K, 2, 2) stated covariance of
    it; chance: (K,) density of a neighbour that is another landmark.
    """

    first: Array
    covariance: Array
    nu: Array
    H: Array
    by_range: Array
    by_bearing: Array
    chance: Array


def by_direction(sensor: Sensor, sightings: Sightings) -> tuple[Array, Array]:
    """The parts (m, 2, 2) of R that are noise of the range and of the bearing; what they have in common is in neither."""
    z, R = sightings
    if sensor.kind == RANGE_BEARING:
        T = np.broadcast_to(np.eye(2), R.shape)
    else:
        u = z / np.maximum(np.hypot(z[:, 0], z[:, 1]), np.finfo(float).tiny)[:, None]
        T = np.stack([u, np.stack([-u[:, 1], u[:, 0]], axis=1)], axis=-1)
    variance = np.einsum("mij,mik,mkj->mj", T, R, T)
    along, across = (v[:, None, None] * T[:, :, None, i] * T[:, None, :, i] for i, v in enumerate(variance.T))
    return along, across


def with_shares(sensor: Sensor, sightings: Sightings, shares: Shares) -> Sightings:
    """The readings with the noise that there is."""
    if shares.range == 1.0 and shares.bearing == 1.0 or not len(sightings.z):
        return sightings
    z, R = sightings
    D = np.diag(np.sqrt([shares.range, shares.bearing]))
    if sensor.kind != RANGE_BEARING:
        u = z / np.maximum(np.hypot(z[:, 0], z[:, 1]), np.finfo(float).tiny)[:, None]
        T = np.stack([u, np.stack([-u[:, 1], u[:, 0]], axis=1)], axis=-1)
        D = T @ D @ T.transpose(0, 2, 1)
        return Sightings(z, D @ R @ D.transpose(0, 2, 1))
    return Sightings(z, D @ R @ D)


class Differences:
    """Collects pairs of consecutive frames, and says what they tell of the noise.

    Attributes:
        shares: what is known by now.
    """

    def __init__(self, sensor: Sensor) -> None:
        """Before the first frame."""
        self.sensor, self.shares = sensor, AS_STATED
        self._before: Sightings | None = None
        self._steps: list[Steps] = []
        self._next = 1
        self._farthest = 0.0

    def see(self, increment: Increment | None, sightings: Sightings) -> None:
        """The next frame."""
        if len(self._steps) >= constants.DIFFERENCES_MOST:
            return
        before, self._before = self._before, sightings if len(sightings.z) else None
        self._farthest = max(self._farthest, float(self.sensor.polar(sightings.z)[:, 0].max(initial=0.0)))
        if before is None or increment is None or not len(sightings.z):
            return
        step = pairs(self.sensor, before, increment, sightings, self._farthest)
        if not len(step.nu):
            return
        self._steps.append(step)
        if len(self._steps) == self._next:
            self._next *= 2
            self.shares = fitted(self._steps)


def pairs(sensor: Sensor, before: Sightings, increment: Increment, now: Sightings, reach: float) -> Steps:
    """Readings of two frames that are each other's nearest neighbours, by the stated noise; reach [m] of the sensor."""
    xy, _, Gz = sensor.inverse(np.zeros(3), before.z)
    z_hat, H, Hl = sensor.linearize(increment.mean, xy)
    J = Hl @ Gz
    S = np.einsum("nij,njk,nlk->nil", J, before.R, J) + H @ increment.covariance @ H.transpose(0, 2, 1)
    nu = sensor.residual(now.z[:, None], z_hat[None])
    S = S[None] + now.R[:, None]
    d2 = np.einsum("mni,mni->mn", nu, np.linalg.solve(S, nu[..., None])[..., 0])
    nearest = d2.argmin(axis=1)
    rows = np.flatnonzero(d2.argmin(axis=0)[nearest] == np.arange(len(nu)))
    at = nearest[rows]
    r, b = by_direction(sensor, now)
    r0, b0 = by_direction(sensor, before)
    turned = J[at].transpose(0, 2, 1)
    area = 0.5 * (sensor.max_angle - sensor.min_angle) * max(reach, 1e-9) ** 2
    chance = np.full(len(rows), len(before.z) / area)
    if sensor.kind == RANGE_BEARING:
        chance *= now.z[rows, 0]
    return Steps(
        np.array([0, len(rows)]), increment.covariance[None], nu[rows, at], H[at],
        r[rows] + J[at] @ r0[at] @ turned, b[rows] + J[at] @ b0[at] @ turned, chance,
    )  # fmt: skip


def fitted(steps: list[Steps]) -> Shares:
    """The variances that explain the differences best."""
    first = np.concatenate([[0], np.cumsum([len(s.nu) for s in steps])]).astype(np.int64)
    rest = (np.ascontiguousarray(np.concatenate(c)) for c in list(zip(*steps, strict=True))[1:])
    return Shares(*_fit(first, *rest, constants.DIFFERENCES_PRIOR, constants.DIFFERENCES_ROUNDS).tolist())


@numba.njit(cache=True)
def _fit(first, covariance, nu, H, by_range, by_bearing, chance, prior, rounds):  # type: ignore[no-untyped-def]
    """Shares (3,) after so many rounds; `prior` pairs say that all is as stated."""
    F, K = len(covariance), len(nu)
    share = np.ones(3)
    weight = np.ones(K)
    right = 0.5
    inverse = np.empty((F, 3, 3))
    for f in range(F):
        inverse[f] = np.linalg.inv(covariance[f])
    information, pull = np.empty((K, 3, 3)), np.empty((K, 3))
    for _ in range(rounds):
        above, below = np.full(3, prior), np.full(3, prior)
        total = 0.0
        for f in range(F):
            L, b = inverse[f] / share[2], np.zeros(3)
            for j in range(first[f], first[f + 1]):
                W = np.linalg.inv(share[0] * by_range[j] + share[1] * by_bearing[j])
                information[j] = H[j].T @ W @ H[j]
                pull[j] = H[j].T @ (W @ nu[j])
                L = L + weight[j] * information[j]
                b = b + weight[j] * pull[j]
            for j in range(first[f], first[f + 1]):
                # what the others of the frame say about this pair
                rest = np.linalg.inv(L - weight[j] * information[j])
                moved = rest @ (b - weight[j] * pull[j])
                N = share[0] * by_range[j] + share[1] * by_bearing[j]
                S = N + H[j] @ rest @ H[j].T
                off = nu[j] - H[j] @ moved
                det = S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]
                d2 = off @ np.linalg.inv(S) @ off
                good = right * math.exp(-0.5 * d2) / (2.0 * math.pi * math.sqrt(det))
                weight[j] = good / (good + (1.0 - right) * chance[j] + 1e-300)
                total += weight[j]
            L, b = inverse[f] / share[2], np.zeros(3)
            for j in range(first[f], first[f + 1]):
                L = L + weight[j] * information[j]
                b = b + weight[j] * pull[j]
            P = np.linalg.inv(L)
            moved = P @ b
            for j in range(first[f], first[f + 1]):
                W = np.linalg.inv(share[0] * by_range[j] + share[1] * by_bearing[j])
                v = W @ (nu[j] - H[j] @ moved)
                HP = W @ H[j] @ P @ H[j].T @ W
                for c in range(2):
                    part = by_range[j] if c == 0 else by_bearing[j]
                    above[c] += 0.5 * weight[j] * (v @ part @ v + np.sum(HP * part))
                    below[c] += 0.5 * weight[j] * np.sum(W * part) 
            M = inverse[f] @ P + np.outer(inverse[f] @ moved, moved)
            above[2] += (M[0, 0] + M[1, 1] + M[2, 2]) / 3.0
            below[2] += share[2]
        for c in range(2):
            # the sums are in units of the present share
            share[c] *= (above[c] - prior + prior / share[c]) / below[c]
        share[2] *= (above[2] - prior + prior) / (below[2] - prior + prior * share[2])
        right = (total + 1.0) / (K + 2.0)
    return share
