"""Compiled updates of the filter: plain, iterated, invariant; same buffers as `ekf.kernels`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from data.se2 import Array, BoolArray
from data.sensors import wrap_angle_jit
from ekf.kernels import NEWEST, NOT_PSD, OK, Innovation, Pairings, gate, healthy, innovate

ADDITIVE = 0  # retraction mean += K nu
INVARIANT = 3
"""Retraction by exp(xi), the right-invariant error of SE_(1+n)(2), of pose and landmarks. This or more is the offset of
the landmarks; states between them and the pose are corrected additively."""

BY_ROWS = (64, 800)
"""States; within these limits the update of P goes by whole rows. Fewer do not fill them, more exceed the cache."""
TILE = 16  # states; rows and columns of a tile stay in the nearest cache while it is mirrored


class UpdateRule(NamedTuple):
    """Rule of an update."""

    threshold: float  # squared distance of the gate, inf for none
    retraction: int  # `ADDITIVE`, `INVARIANT` or more
    iterations: int  # largest number of linearizations
    first: Array  # see `ekf.kernels`; not together with iterations


class Outcome(NamedTuple):
    """Outputs of an update with k observations."""

    keep: BoolArray  # (k,) passed the gate
    stats: Array  # (3,) sums of NIS, log-likelihood and degrees of freedom
    white: Array  # (k, 2) innovations divided by their standard deviations, NaN where not used


@numba.njit(cache=True)
def cholesky(S: Array, L: Array, n: int) -> bool:
    """Lower Cholesky factor of the leading n x n block of S; False where S is not positive definite."""
    for i in range(n):
        for j in range(i + 1):
            total = S[i, j]
            for q in range(j):
                total -= L[i, q] * L[j, q]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@numba.njit(cache=True)
def forward(L: Array, b: Array, x: Array) -> None:
    """X = L^-1 b for a lower triangle L (n, n); x may be b."""
    for i in range(len(b)):
        total = b[i]
        for q in range(i):
            total -= L[i, q] * x[q]
        x[i] = total / L[i, i]


@numba.njit(cache=True)
def correct(mean: Array, P: Array, d: int, found: Innovation, stats: Array, retraction: int) -> int:
    """The Kalman update: mean += K nu (or see `move`), P -= W W' with W = PHt L^-T, S = L L'. Adds NIS and
    log-likelihood to `stats` (2,). P stays symmetric to the bit. Returns a status.
    """
    nu, PHt, S = found
    n = len(nu)
    L = np.empty((n, n))
    if not cholesky(S, L, n):
        return NOT_PSD
    white = np.empty(n)
    forward(L, nu, white)
    log_det, nis = 0.0, 0.0
    for i in range(n):
        nis += white[i] * white[i]
        log_det += 2.0 * math.log(L[i, i])
    shift = np.zeros(d)
    for r in range(d):
        forward(L, PHt[r], PHt[r])
        for i in range(n):
            shift[r] += PHt[r, i] * white[i]
        if retraction == ADDITIVE:
            mean[r] += shift[r]
    subtract(P, d, PHt)
    if retraction != ADDITIVE:
        move(mean, P, d, shift, retraction)
    mean[2] = wrap_angle_jit(mean[2])
    stats[0] += nis
    stats[1] -= 0.5 * (nis + log_det + n * math.log(2.0 * math.pi))
    return healthy(mean, P)


@numba.njit(cache=True)
def subtract(P: Array, d: int, W: Array) -> None:
    """P -= W W' on the leading d entries, W (d, n): the lower triangle, then mirrored.

    Every entry is summed over n in the same order, so both ways give the same bytes. By rows it takes 0.7 of the time
    entry by entry with n = 4, 0.6 with 10, 0.45 with 20 (100 to 400 states).
    """
    n = W.shape[1]
    if not BY_ROWS[0] <= d <= BY_ROWS[1]:
        for r in range(d):
            for c in range(r + 1):
                entry = 0.0
                for i in range(n):
                    entry += W[r, i] * W[c, i]
                P[r, c] -= entry
                P[c, r] = P[r, c]
        return
    Wt = np.ascontiguousarray(W.T)
    total = np.empty(d)
    for r in range(d):
        total[: r + 1] = 0.0
        for i in range(n):
            weight, row = W[r, i], Wt[i]
            for c in range(r + 1):
                total[c] += weight * row[c]
        line = P[r]
        for c in range(r + 1):
            line[c] -= total[c]
    for top in range(0, d, TILE):
        for left in range(0, top + 1, TILE):
            for r in range(top, min(top + TILE, d)):
                for c in range(left, min(left + TILE, r)):
                    P[c, r] = P[r, c]


@numba.njit(cache=True)
def move(mean: Array, P: Array, d: int, shift: Array, base: int) -> None:
    """Move pose and landmarks by exp(xi) for the additive correction `shift` (d,), and transform P.

    Landmarks begin at `base`; states between them and the pose are corrected additively. xi_theta = shift_theta; for
    every point x, rho = shift_x - J x xi_theta and x <- R(xi_theta) x + V(xi_theta) rho (Brossard, Barrau and Bonnabel,
    IEEE Sensors Journal 19(4), 2019). P is the additive covariance in the world frame before and after: P <- N P N'
    with N = I + J (x+ - x-) e_theta' on the rows of each point.
    """
    angle = shift[2]
    c, s = math.cos(angle), math.sin(angle)
    if abs(angle) < 1e-4:  # series; (1 - c) / angle would lose digits
        a, b = 1.0 - angle * angle / 6.0, 0.5 * angle
    else:
        a, b = s / angle, (1.0 - c) / angle
    step, column = np.zeros(d), np.zeros(d)
    r = 0
    while r < d:
        x, y = mean[r], mean[r + 1]
        u, v = shift[r] + y * angle, shift[r + 1] - x * angle
        step[r] = c * x - s * y + a * u - b * v - x
        step[r + 1] = s * x + c * y + b * u + a * v - y
        column[r], column[r + 1] = -step[r + 1], step[r]
        r = base if r == 0 else r + 2
    for r in range(3, base):
        step[r] = shift[r]
    for i in range(d):
        for j in range(d):
            P[i, j] += column[i] * P[2, j]
    for i in range(d):
        for j in range(d):
            P[i, j] += P[i, 2] * column[j]
    for i in range(d):
        for j in range(i):
            mid = 0.5 * (P[i, j] + P[j, i])
            P[i, j], P[j, i] = mid, mid
    for i in range(d):
        mean[i] += step[i]
    mean[2] += angle


@numba.njit(cache=True)
def iterate(
    kind: int,
    extrinsic: Array,
    start: Array,
    mean: Array,
    P: Array,
    d: int,
    seen: Pairings,
    found: Innovation,
    iterations: int,
    stats: Array,
) -> Array:
    """Point of linearization (d,): Gauss-Newton from `start`, at most `iterations` - 1 steps (Bell and Cathey 1993).

    `found` is at `start`, and is overwritten; its NIS and log-likelihood are added to `stats`. Ends early where no
    state moves by 1e-6 sigma.
    """
    nu, PHt, S = found
    point = start[:d].copy()
    n = len(nu)
    L, white = np.empty((n, n)), np.empty(n)
    for turn in range(iterations - 1):
        if not cholesky(S, L, n):
            return point  # the correction returns the status
        forward(L, nu, white)
        if turn == 0:
            stats[0] += (white * white).sum()
            stats[1] -= 0.5 * ((white * white).sum() + n * math.log(2.0 * math.pi)) + np.log(np.diag(L)).sum()
        moved = 0.0
        for r in range(d):
            row = np.empty(n)
            forward(L, PHt[r], row)
            place = mean[r]
            for i in range(n):
                place += row[i] * white[i]
            if P[r, r] > 0.0:
                moved = max(moved, abs(place - point[r]) / math.sqrt(P[r, r]))
            point[r] = place
        if moved < 1e-6:
            break
        innovate(kind, extrinsic, point, mean, P, d, seen, found, NEWEST)
    return point


@numba.njit(cache=True)
def update(
    kind: int, extrinsic: Array, mean: Array, P: Array, d: int, seen: Pairings, how: UpdateRule, done: Outcome
) -> int:
    """One stacked update with k pairings from the prediction; see `update_from`."""
    status: int = update_from(kind, extrinsic, mean, mean, P, d, seen, how, done)
    return status


@numba.njit(cache=True)
def update_from(
    kind: int,
    extrinsic: Array,
    start: Array,
    mean: Array,
    P: Array,
    d: int,
    seen: Pairings,
    how: UpdateRule,
    done: Outcome,
) -> int:
    """An update first linearized at the state `start` (d,), without pairings outside the gate. Returns a status."""
    keep, stats = done.keep, done.stats
    k = len(seen.at)
    nu, PHt, S = np.empty(2 * k), np.empty((d, 2 * k)), np.empty((2 * k, 2 * k))
    innovate(kind, extrinsic, start, mean, P, d, seen, Innovation(nu, PHt, S), how.first)
    keep[:] = True
    if how.threshold < np.inf:
        count = gate(nu, S, how.threshold, keep)
        if count == 0:
            done.white[:] = np.nan
            return OK
        if count < k:
            rows = np.empty(2 * count, np.int64)
            n = 0
            for i in range(k):
                if keep[i]:
                    rows[n], rows[n + 1] = 2 * i, 2 * i + 1
                    n += 2
            nu, PHt, S = nu[rows], PHt[:, rows], S[rows][:, rows]
    whiten(nu, S, keep, done.white)
    stats[2] += len(nu)
    found = Innovation(nu, PHt, S)
    if how.iterations > 1:
        used = Pairings(seen.at[keep], seen.known[keep], seen.z[keep], seen.R[keep])
        point = iterate(kind, extrinsic, start, mean, P, d, used, found, how.iterations, stats)
        innovate(kind, extrinsic, point, mean, P, d, used, found, NEWEST)
        stats = np.zeros(3)  # the innovation is the one at `start`
    return correct(mean, P, d, found, stats, how.retraction)


@numba.njit(cache=True)
def whiten(nu: Array, S: Array, keep: BoolArray, white: Array) -> None:
    """Innovations nu (2n,) of the n observations kept, each by its own block of S: rows of `white` (k, 2)."""
    white[:] = np.nan
    n = 0
    for i in range(len(keep)):
        if keep[i]:
            if S[n, n] > 0.0:
                b = S[n + 1, n] / S[n, n]
                rest = S[n + 1, n + 1] - b * S[n, n + 1]
                if rest > 0.0:
                    white[i, 0] = nu[n] / math.sqrt(S[n, n])
                    white[i, 1] = (nu[n + 1] - b * nu[n]) / math.sqrt(rest)
            n += 2


@numba.njit(cache=True)
def update_each(
    kind: int, extrinsic: Array, mean: Array, P: Array, d: int, seen: Pairings, how: UpdateRule, done: Outcome
) -> int:
    """One update per observation, each linearized after the previous one (as in the classic tutorials)."""
    for i in range(len(seen.at)):
        one = slice(i, i + 1)
        single = Pairings(seen.at[one], seen.known[one], seen.z[one], seen.R[one])
        status = update(kind, extrinsic, mean, P, d, single, how, Outcome(done.keep[one], done.stats, done.white[one]))
        if status != OK:
            return status
    return OK
