"""Compiled steps of the filter: predict, expect, innovate, augment, on growing buffers (see `ekf.updates`).

State vector [x, y, theta, l1x, l1y, ...]; the leading `d` entries of `mean` (C,) and `P` (C, C) are in use. P is the
covariance of the additive world-frame error. Step-by-step filters and the whole-run loop (`run`) use the same
functions, with the same bytes.

`first` (C,) holds the first estimates (last predicted pose, landmarks as initialized) at which an FEJ filter takes its
Jacobians (Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010, section 5.2); empty: at the newest estimates.
"""

import math
from typing import NamedTuple

import numpy as np

from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array
from data.sensors import LINE, invert, measure, name_as_read, residual, wrap_angle_jit

NEWEST = np.empty(0)  # first estimates of a filter without any: Jacobians at the newest estimates
OK = 0
NOT_FINITE = 1
NOT_PSD = 2
FAILURES = {NOT_FINITE: "the state is no longer finite", NOT_PSD: "a covariance lost positive definiteness"}


class Pairings(NamedTuple):
    """Observations and the landmarks that they are paired with."""

    at: IntArray  # (k,) offset of each landmark in the state; negative: known
    known: Array  # (k, 2) known landmarks
    z: Array  # (k, 2)
    R: Array  # (k, 2, 2)


class Innovation(NamedTuple):
    """nu (2k,), its covariance S (2k, 2k), and its cross-covariance PHt (d, 2k) with the state."""

    nu: Array
    PHt: Array
    S: Array


@njit
def predict(mean: Array, P: Array, d: int, motion: Array, M: Array, first: Array) -> None:
    """Move by a body-frame increment `motion` (3,) with covariance M (3, 3): P <- F P F' + G M G', map unchanged. F
    differs from I only in its third column: with first estimates, the displacement between predicted positions.
    """
    c, s = math.cos(mean[2]), math.sin(mean[2])
    wx, wy = c * motion[0] - s * motion[1], s * motion[0] + c * motion[1]
    fx, fy = -wy, wx
    if len(first):
        fx, fy = first[1] - (mean[1] + wy), mean[0] + wx - first[0]
    for j in range(d):  # rows, then columns: F (P F')
        P[0, j] += fx * P[2, j]
        P[1, j] += fy * P[2, j]
    for i in range(d):
        P[i, 0] += fx * P[i, 2]
        P[i, 1] += fy * P[i, 2]
    mxx = c * c * M[0, 0] - 2.0 * c * s * M[0, 1] + s * s * M[1, 1]
    myy = s * s * M[0, 0] + 2.0 * c * s * M[0, 1] + c * c * M[1, 1]
    mxy = c * s * (M[0, 0] - M[1, 1]) + (c * c - s * s) * M[0, 1]
    mxt, myt = c * M[0, 2] - s * M[1, 2], s * M[0, 2] + c * M[1, 2]
    P[0, 0] += mxx
    P[1, 1] += myy
    P[2, 2] += M[2, 2]
    P[0, 1] += mxy
    P[0, 2] += mxt
    P[1, 2] += myt
    P[1, 0], P[2, 0], P[2, 1] = P[0, 1], P[0, 2], P[1, 2]
    for j in range(3, d):
        P[j, 0], P[j, 1], P[j, 2] = P[0, j], P[1, j], P[2, j]
    mean[0] += wx
    mean[1] += wy
    mean[2] = wrap_angle_jit(mean[2] + motion[2])
    if len(first):
        first[0], first[1], first[2] = mean[0], mean[1], mean[2]


@njit
def innovate(
    kind: int, extrinsic: Array, mean: Array, base: Array, P: Array, d: int, seen: Pairings, begin: int,
    out: Innovation, first: Array,
) -> None:  # fmt: skip
    """Fill `out` with the innovation of its k pairings from `begin` on, all Jacobians at `mean` or `first`. `base` is
    the prediction: nu = z - h(mean) - H (base - mean), so the two differ only in an iterated update.
    """
    at, known, z, R = seen
    nu, PHt, S = out
    n = len(nu)
    H = np.empty((n, 5))
    z_hat, Hx, Hl = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    for i in range(n // 2):
        row = begin + i
        a = at[row]
        measure_landmark(kind, extrinsic, mean, a, known[row, 0], known[row, 1], first, z_hat, Hx, Hl)
        name_as_read(kind, z[row, 1], z_hat, Hx, Hl)
        nu[2 * i], nu[2 * i + 1] = residual(kind, z[row, 0], z[row, 1], z_hat)
        for q in range(2):
            for j in range(3):
                H[2 * i + q, j] = Hx[q, j]
                nu[2 * i + q] -= Hx[q, j] * (base[j] - mean[j])
            H[2 * i + q, 3], H[2 * i + q, 4] = Hl[q, 0], Hl[q, 1]
            if a >= 0:
                nu[2 * i + q] -= Hl[q, 0] * (base[a] - mean[a]) + Hl[q, 1] * (base[a + 1] - mean[a + 1])
        for r in range(d):
            for q in range(2):
                value = P[r, 0] * Hx[q, 0] + P[r, 1] * Hx[q, 1] + P[r, 2] * Hx[q, 2]
                if a >= 0:
                    value += P[r, a] * Hl[q, 0] + P[r, a + 1] * Hl[q, 1]
                PHt[r, 2 * i + q] = value
    for i in range(n):
        a = at[begin + i // 2]
        for j in range(n):
            value = H[i, 0] * PHt[0, j] + H[i, 1] * PHt[1, j] + H[i, 2] * PHt[2, j]
            if a >= 0:
                value += H[i, 3] * PHt[a, j] + H[i, 4] * PHt[a + 1, j]
            S[i, j] = value
    for i in range(n):
        for j in range(i):
            mid = 0.5 * (S[i, j] + S[j, i])
            S[i, j], S[j, i] = mid, mid
    for i in range(n):
        for j in range(2):
            S[i, i - i % 2 + j] += R[begin + i // 2, i % 2, j]


@njit
def measure_landmark(
    kind: int, extrinsic: Array, mean: Array, a: int, x: float, y: float, first: Array, z_hat: Array, Hx: Array,
    Hl: Array,
) -> None:  # fmt: skip
    """`measure` a landmark at offset `a` of the state, or at (x, y) where a < 0; Jacobians at `first` if given."""
    if a >= 0:
        x, y = mean[a], mean[a + 1]
    measure(kind, extrinsic, mean, x, y, z_hat, Hx, Hl)
    if len(first):
        at_first = np.empty(2)
        if a >= 0:
            x, y = first[a], first[a + 1]
        measure(kind, extrinsic, first, x, y, at_first, Hx, Hl)
        name_as_read(kind, z_hat[1], at_first, Hx, Hl)


@njit
def healthy(mean: Array, P: Array) -> int:
    """Status of the pose: finite, and no variance negative beyond rounding (1e-12 of the trace)."""
    trace = P[0, 0] + P[1, 1] + P[2, 2]
    for r in range(3):
        if not (math.isfinite(mean[r]) and math.isfinite(P[r, r])):
            return NOT_FINITE
        if P[r, r] < -1e-12 * trace:
            return NOT_PSD
    return OK


@njit
def augment(
    kind: int, extrinsic: Array, mean: Array, P: Array, d: int, z: Array, R: Array, variance: float, first: Array
) -> None:
    """Append the landmark observed at z (2,) from the present pose; the buffers have room for d + 2 states.

    P_new = [[P, P Gx'], [Gx P, Gx P Gx' + Gz R Gz']]. With `variance` >= 0 the landmark instead gets variance * I and
    no correlation (as in the classic tutorials, overconfident by construction).
    """
    landmark, Gx, Gz = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    invert(kind, extrinsic, mean, z[0], z[1], landmark, Gx, Gz)
    mean[d], mean[d + 1] = landmark[0], landmark[1]
    if len(first):
        first[d], first[d + 1] = landmark[0], landmark[1]
        if kind == LINE:
            Gx[0, 2] = Gx[0, 0] * first[1] - Gx[0, 1] * first[0]
        else:
            Gx[0, 2], Gx[1, 2] = first[1] - landmark[1], landmark[0] - first[0]
    if variance >= 0.0:
        P[d : d + 2, : d + 2], P[: d + 2, d : d + 2] = 0.0, 0.0
        P[d, d] = P[d + 1, d + 1] = variance
        return
    for j in range(d):
        for q in range(2):
            value = Gx[q, 0] * P[0, j] + Gx[q, 1] * P[1, j] + Gx[q, 2] * P[2, j]
            P[d + q, j] = value
            P[j, d + q] = value
    for q in range(2):
        a, b = Gz[q, 0] * R[0, 0] + Gz[q, 1] * R[1, 0], Gz[q, 0] * R[0, 1] + Gz[q, 1] * R[1, 1]
        for j in range(2):
            own = a * Gz[j, 0] + b * Gz[j, 1]
            P[d + q, d + j] = own + (P[d + q, 0] * Gx[j, 0] + P[d + q, 1] * Gx[j, 1] + P[d + q, 2] * Gx[j, 2])
    mid = 0.5 * (P[d, d + 1] + P[d + 1, d])
    P[d, d + 1], P[d + 1, d] = mid, mid


@njit
def expect(
    kind: int, extrinsic: Array, mean: Array, P: Array, at: IntArray, known: Array, z_hat: Array, blocks: Array,
    first: Array,
) -> None:  # fmt: skip
    """Expected measurement z_hat (n, 2) of n candidates and the blocks H P H' (n, 2, 2)."""
    Hx, Hl = np.empty((2, 3)), np.empty((2, 2))
    H, columns = np.empty((2, 5)), np.empty(5, np.int64)
    columns[0], columns[1], columns[2] = 0, 1, 2
    for i in range(len(at)):
        a = at[i]
        measure_landmark(kind, extrinsic, mean, a, known[i, 0], known[i, 1], first, z_hat[i], Hx, Hl)
        for q in range(2):
            H[q, 0], H[q, 1], H[q, 2], H[q, 3], H[q, 4] = Hx[q, 0], Hx[q, 1], Hx[q, 2], Hl[q, 0], Hl[q, 1]
        columns[3], columns[4] = a, a + 1
        n = 3 if a < 0 else 5
        for q in range(2):
            for p in range(q + 1):
                total = 0.0
                for r in range(n):
                    for c in range(n):
                        total += H[q, r] * P[columns[r], columns[c]] * H[p, c]
                blocks[i, q, p], blocks[i, p, q] = total, total
