"""EKF over key poses: augmentation by every key pose, and loop closures as updates of all of them.

Durrant-Whyte, Majumder, Thrun, de Battista and Scheding, "A Bayesian algorithm for simultaneous localisation and map
building", 2001, kept poses without landmarks; Eustice, Singh and Leonard, "Exactly sparse delayed-state filters", IEEE
TRO 22(6), 2006, in information form. Here in covariance form, dense: P grows to 3K x 3K.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from data.inputs import IntArray, Prior
from data.motion.velocity import compose_in_place
from data.notice import stopped
from data.result import Failure
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import wrap_angle_jit as wrapped

GROWTH = 1.5  # factor by which a full covariance buffer grows


class LoopUpdate(NamedTuple):
    """Result of an update: used (m,), d2 (m,) squared innovation of each by itself, nis of those used together."""

    used: BoolArray
    d2: Array
    nis: float


class PoseChainFilter:
    """A filter whose state is every key pose so far, world frame, additive errors."""

    def __init__(self, prior: Prior, room: int = 64) -> None:
        """Start at the prior with key pose 0; `room`: key poses to allocate."""
        self.keys = 1
        self._pose = np.zeros((max(room, 1), 3))
        self._P = np.empty((3 * max(room, 1), 3 * max(room, 1)))  # lower triangle, diagonal blocks in full
        self._pose[0], self._P[:3, :3] = prior.mean, prior.covariance

    def augment(self, motion: Array, covariance: Array) -> None:
        """The next key pose: `motion` (3,) from the newest, covariance (3, 3) in its body frame; prediction."""
        n = 3 * self.keys
        if self.keys == len(self._pose):
            room = int(GROWTH * self.keys) + 1
            pose, P = np.zeros((room, 3)), np.empty((3 * room, 3 * room))
            pose[: self.keys], P[:n, :n] = self._pose, self._P
            self._pose, self._P = pose, P
        _augment(self._pose, self._P, self.keys, np.array(motion, float), np.array(covariance, float))
        self.keys += 1

    def close(
        self, key1: IntArray, key2: IntArray, relative: Array, covariance: Array, *, threshold: float = math.inf
    ) -> LoopUpdate:
        """One update with loop closures (m,): poses (m, 3) of key2 in the frames of key1, with (m, 3, 3).

        Each is rejected by itself if its squared innovation (3 dof) is not below the threshold. Raises LinAlgError if
        the innovation covariance is not positive definite.
        """
        m, n = len(key1), 3 * self.keys
        nu, H = _innovations(self._pose, key1, key2, np.array(relative, float))
        W = _columns(self._P, n, key1, key2, H)  # H P
        S = np.empty((3 * m, 3 * m))
        for j in range(m):
            a, b = slice(3 * key1[j], 3 * key1[j] + 3), slice(3 * key2[j], 3 * key2[j] + 3)
            S[:, 3 * j : 3 * j + 3] = W[:, a] @ H[j, :, :3].T + W[:, b] @ H[j, :, 3:].T
            S[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] += covariance[j]
        own = np.array([S[i : i + 3, i : i + 3] for i in range(0, 3 * m, 3)]).reshape(-1, 3, 3)
        d2 = np.einsum("mi,mi->m", nu, np.linalg.solve(own, nu[..., None])[..., 0])
        used = d2 < threshold
        if not used.any():
            return LoopUpdate(used, d2, 0.0)
        rows = np.flatnonzero(np.repeat(used, 3))
        L = np.linalg.cholesky(0.5 * (S + S.T)[np.ix_(rows, rows)])
        both = np.linalg.solve(L, np.concatenate([W[rows], nu.reshape(-1, 1)[rows]], axis=1))
        V, white = np.ascontiguousarray(both[:, :n]), both[:, n]
        pose = self._pose[: self.keys]
        pose += (white @ V).reshape(-1, 3)
        pose[:, 2] = wrap_angle(pose[:, 2])
        _downdate(self._P, V)
        return LoopUpdate(used, d2, float(white @ white))

    def poses(self) -> Array:
        """The present key poses (K, 3)."""
        return self._pose[: self.keys].copy()

    def newest(self) -> tuple[Array, Array]:
        """The newest key pose (3,) and its covariance (3, 3)."""
        n = 3 * self.keys
        return self._pose[self.keys - 1].copy(), self._P[n - 3 : n, n - 3 : n].copy()

    def covariances(self) -> Array:
        """Covariances (K, 3, 3) of all key poses."""
        return np.array([self._P[i : i + 3, i : i + 3] for i in range(0, 3 * self.keys, 3)])


@numba.njit(cache=True)
def _augment(pose: Array, P: Array, keys: int, motion: Array, M: Array) -> None:
    n = 3 * keys
    last = pose[keys - 1]
    before, corner = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            before[i, j] = P[n - 3 + i, n - 3 + j]
    compose_in_place(last, before, motion, M, pose[keys], corner)
    wx, wy = pose[keys, 0] - last[0], pose[keys, 1] - last[1]
    pose[keys, 2] = wrapped(pose[keys, 2])
    for j in range(n):
        P[n, j] = P[n - 3, j] - wy * P[n - 1, j]
        P[n + 1, j] = P[n - 2, j] + wx * P[n - 1, j]
        P[n + 2, j] = P[n - 1, j]
    for i in range(3):
        for j in range(3):
            P[n + i, n + j] = corner[i, j]


@numba.njit(cache=True)
def _innovations(pose: Array, key1: IntArray, key2: IntArray, relative: Array) -> tuple[Array, Array]:
    """Innovations (m, 3) and Jacobians (m, 3, 6) of the relative poses to key1 and key2."""
    nu, H = np.empty((len(key1), 3)), np.zeros((len(key1), 3, 6))
    for i in range(len(key1)):
        a, b = pose[key1[i]], pose[key2[i]]
        c, s = math.cos(a[2]), math.sin(a[2])
        x, y = c * (b[0] - a[0]) + s * (b[1] - a[1]), -s * (b[0] - a[0]) + c * (b[1] - a[1])
        nu[i, 0], nu[i, 1] = relative[i, 0] - x, relative[i, 1] - y
        nu[i, 2] = wrapped(relative[i, 2] - wrapped(b[2] - a[2]))
        H[i, 0, 3], H[i, 0, 4], H[i, 1, 3], H[i, 1, 4], H[i, 2, 5] = c, s, -s, c, 1.0
        for r in range(3):
            for j in range(3):
                H[i, r, j] = -H[i, r, 3 + j]
        H[i, 0, 2], H[i, 1, 2] = y, -x
    return nu, H


@numba.njit(cache=True)
def _columns(P: Array, n: int, key1: IntArray, key2: IntArray, H: Array) -> Array:
    """H P (3m, n) from the lower triangle."""
    W = np.zeros((3 * len(key1), n))
    for i in range(len(key1)):
        for half in range(2):
            first = 3 * (key1[i] if half == 0 else key2[i])
            for r in range(3):
                for q in range(3):
                    h = H[i, r, 3 * half + q]
                    if h != 0.0:
                        for j in range(first + 3):
                            W[3 * i + r, j] += h * P[first + q, j]
                        for j in range(first + 3, n):
                            W[3 * i + r, j] += h * P[j, first + q]
    return W


@numba.njit(cache=True)
def _downdate(P: Array, V: Array) -> None:
    """P -= V' V for V (r, n): one pass over the lower triangle, diagonal blocks in full."""
    r, n = V.shape
    for i in range(n):
        end = 3 * (i // 3) + 3
        for q in range(r):
            v = V[q, i]
            for j in range(end):
                P[i, j] -= v * V[q, j]


class PoseChainRun(NamedTuple):
    """The filter over a whole chain."""

    online: Array  # (K, 3) each key pose when it was the newest, its loop closures included
    online_covariance: Array  # (K, 3, 3)
    pose: Array  # (K, 3) in the last state
    covariance: Array  # (K, 3, 3)
    used: BoolArray  # (L,) loop closures that passed the gate
    d2: Array  # (L,) squared innovations, NaN: not tested
    nis: Array  # (K,) of the update at each key pose
    dof: IntArray  # (K,)
    failure: Failure | None


def run_pose_chain(
    prior: Prior,
    motion: Array,
    motion_covariance: Array,
    key1: IntArray,
    key2: IntArray,
    relative: Array,
    covariance: Array,
    joined: IntArray,
    *,
    threshold: float = math.inf,
) -> PoseChainRun:
    """The filter over motion (K, 3), (K, 3, 3), row 0 unused, and loop closures (L,), each at key pose `joined` (L,).
    All loop closures of one key pose are one update. `joined` < 0: never; `threshold` as of `close`.
    """
    K = len(motion)
    filter_ = PoseChainFilter(prior, K)
    online, online_P = np.full((K, 3), np.nan), np.full((K, 3, 3), np.nan)
    used, d2 = np.zeros(len(key1), np.bool_), np.full(len(key1), np.nan)
    order = np.argsort(joined, kind="stable")
    first = np.searchsorted(joined[order], np.arange(K + 1))
    nis, dof, failure = np.zeros(K), np.zeros(K, np.int64), None
    for k in range(K):
        if k:
            filter_.augment(motion[k], motion_covariance[k])
        rows = order[first[k] : first[k + 1]]
        if len(rows):
            try:
                done = filter_.close(key1[rows], key2[rows], relative[rows], covariance[rows], threshold=threshold)
            except np.linalg.LinAlgError as fault:
                failure = Failure("diverged", k, stopped(f"loop closures of key pose {k}: {fault}"))
                break
            used[rows], d2[rows] = done.used, done.d2
            nis[k], dof[k] = done.nis, 3 * int(done.used.sum())
        online[k], online_P[k] = filter_.newest()
    pose, final_P = np.full((K, 3), np.nan), np.full((K, 3, 3), np.nan)
    pose[: filter_.keys], final_P[: filter_.keys] = filter_.poses(), filter_.covariances()
    return PoseChainRun(online, online_P, pose, final_P, used, d2, nis, dof, failure)
