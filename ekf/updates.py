"""Compiled updates of the filter: plain, iterated, invariant; same buffers as `ekf.kernels`."""

import math
from typing import NamedTuple

import numpy as np

from data.blocks import cholesky
from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from data.sensors import wrap_angle_jit
from ekf.kernels import NOT_PSD, OK, Innovation, Pairings, healthy, innovate

ADDITIVE = 0  # retraction mean += K nu
INVARIANT = 3
"""Retraction by exp(xi), the right-invariant error of SE_(1+n)(2), of pose and landmarks. This or more is the offset of
the landmarks; states between them and the pose are corrected additively."""

TILE = 16  # states; rows and columns of a tile stay in the nearest cache while it is mirrored


class UpdateRule(NamedTuple):
    """Rule of an update."""

    threshold: float  # squared distance of the gate, inf for none
    retraction: int  # `ADDITIVE`, `INVARIANT` or more
    iterations: int  # largest number of linearizations
    first: Array  # see `ekf.kernels`; not together with iterations
    clones: int = 0  # offsets where poses of earlier frames begin and end in the state (`ekf.pose_updates`)
    clones_end: int = 0


class Outcome(NamedTuple):
    """Outputs of an update with k pairings, by pairing."""

    keep: BoolArray  # (k,) passed the gate
    stats: Array  # (3,) sums of NIS, log-likelihood and degrees of freedom
    white: Array  # (k, 2) innovations divided by their standard deviations, NaN where not used


@njit
def forward(L: Array, rows: Array) -> None:
    """Each row of `rows` (m, n) <- L^-1 of it, for a lower triangle L (n, n)."""
    for r in range(len(rows)):
        for i in range(len(L)):
            total = rows[r, i]
            for q in range(i):
                total -= L[i, q] * rows[r, q]
            rows[r, i] = total / L[i, i]


@njit
def correct(mean: Array, P: Array, d: int, found: Innovation, stats: Array, how: UpdateRule) -> int:
    """The Kalman update: mean += K nu (or see `move`), P -= W W' with W = PHt L^-T, S = L L'. Adds NIS and
    log-likelihood to `stats` (2,). P stays symmetric to the bit. Returns a status.
    """
    nu, PHt, S = found
    retraction = how.retraction
    n = len(nu)
    L, white = np.empty((n, n)), np.empty((1, n))
    if not cholesky(S, L, n):
        return NOT_PSD
    white[0] = nu
    forward(L, white)
    forward(L, PHt)
    log_det, nis = 0.0, 0.0
    for i in range(n):
        nis += white[0, i] * white[0, i]
        log_det += 2.0 * math.log(L[i, i])
    shift = np.zeros(d)
    for r in range(d):
        for i in range(n):
            shift[r] += PHt[r, i] * white[0, i]
        if retraction == ADDITIVE:
            mean[r] += shift[r]
    subtract(P, d, PHt)
    if retraction != ADDITIVE:
        move(mean, P, d, shift, retraction, how.clones, how.clones_end)
    mean[2] = wrap_angle_jit(mean[2])
    stats[0] += nis
    stats[1] -= 0.5 * (nis + log_det + n * math.log(2.0 * math.pi))
    return healthy(mean, P)


@njit
def subtract(P: Array, d: int, W: Array) -> None:
    """P -= W W' on the leading d entries, W (d, n): the lower triangle, then mirrored. By whole rows, which takes half
    the time of entry by entry from 40 to 800 states, and 1.5 times with 1500.
    """
    n = W.shape[1]
    Wt, total = np.ascontiguousarray(W.T), np.empty(d)
    for r in range(d):
        total[: r + 1] = 0.0
        for i in range(n):
            weight = W[r, i]
            for c in range(r + 1):
                total[c] += weight * Wt[i, c]
        for c in range(r + 1):
            P[r, c] -= total[c]
    for top in range(0, d, TILE):
        for left in range(0, top + 1, TILE):
            for r in range(top, min(top + TILE, d)):
                for c in range(left, min(left + TILE, r)):
                    P[c, r] = P[r, c]


@njit
def move(mean: Array, P: Array, d: int, shift: Array, base: int, clones: int, clones_end: int) -> None:
    """Move pose and landmarks by exp(xi) for the additive correction `shift` (d,), and transform P.

    Landmarks begin at `base`; states between them and the pose are corrected additively. xi_theta = shift_theta; for
    every point x, rho = shift_x - J x xi_theta and x <- R(xi_theta) x + V(xi_theta) rho (Brossard, Barrau and Bonnabel,
    IEEE Sensors Journal 19(4), 2019). P is the additive covariance in the world frame before and after: P <- N P N'
    with N = I + J (x+ - x-) e_theta' on the rows of each point. The states from `clones` before `clones_end` are poses
    of other frames, each moved by an exponential of its own, with its own heading instead of theta.
    """
    angle = shift[2]
    step, column, heading = np.zeros(d), np.zeros(d), np.full(d, 2)
    a, b = _exponential(angle)
    r = 0
    while r < d:
        if clones <= r < clones_end:
            own = shift[r + 2]
            _step(mean, shift, r, own, *_exponential(own), step, column)
            step[r + 2] = own
            heading[r], heading[r + 1], heading[r + 2] = r + 2, r + 2, r + 2
            r += 3
        else:
            _step(mean, shift, r, angle, a, b, step, column)
            r = base if r == 0 else r + 2
    step[3:base] = shift[3:base]
    # rows, then columns, of each row of a point, then of the headings, which the others need as they were
    for headings in (False, True):
        for i in range(d):
            if (heading[i] == i) == headings:
                for j in range(d):
                    P[i, j] += column[i] * P[heading[i], j]
                for j in range(d):
                    P[i, j] += P[i, heading[j]] * column[j]
    for top in range(0, d, TILE):
        for left in range(0, top + 1, TILE):
            for i in range(top, min(top + TILE, d)):
                for j in range(left, min(left + TILE, i)):
                    mid = 0.5 * (P[i, j] + P[j, i])
                    P[i, j], P[j, i] = mid, mid
    mean[:d] += step
    mean[2] += angle


@njit
def _exponential(angle: float) -> tuple[float, float]:
    """a, b of V = [[a, -b], [b, a]], the integral of the rotations up to an angle."""
    if abs(angle) < 1e-4:  # series; (1 - c) / angle would lose digits
        return 1.0 - angle * angle / 6.0, 0.5 * angle
    return math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle


@njit
def _step(mean: Array, shift: Array, r: int, angle: float, a: float, b: float, step: Array, column: Array) -> None:
    """The step of the point at offset r, and its column of N; see `move`."""
    c, s = math.cos(angle), math.sin(angle)
    x, y = mean[r], mean[r + 1]
    u, v = shift[r] + y * angle, shift[r + 1] - x * angle
    step[r] = c * x - s * y + a * u - b * v - x
    step[r + 1] = s * x + c * y + b * u + a * v - y
    column[r], column[r + 1] = -step[r + 1], step[r]


@njit
def iterate(
    kind: int, extrinsic: Array, point: Array, mean: Array, P: Array, d: int, seen: Pairings, found: Innovation,
    how: UpdateRule, stats: Array,
) -> None:  # fmt: skip
    """Move the point of linearization (d,): Gauss-Newton, at most `how.iterations` - 1 steps (Bell and Cathey 1993).

    `found` is at `point`, before and after; its first NIS and log-likelihood are added to `stats`. Ends early where no
    state moves by 1e-6 sigma, or where S is singular: the correction then returns the status.
    """
    nu, PHt, S = found
    n = len(nu)
    begin = len(seen.at) - n // 2  # 0, which as a literal would compile `innovate` once more
    L, white, row = np.empty((n, n)), np.empty((1, n)), np.empty((1, n))
    for turn in range(how.iterations - 1):
        if not cholesky(S, L, n):
            return
        white[0] = nu
        forward(L, white)
        if turn == 0:
            nis, log_det = 0.0, 0.0
            for i in range(n):
                nis += white[0, i] * white[0, i]
                log_det += math.log(L[i, i])
            stats[0] += nis
            stats[1] -= 0.5 * (nis + n * math.log(2.0 * math.pi)) + log_det
        moved = 0.0
        for r in range(d):
            row[0] = PHt[r]
            forward(L, row)
            place = mean[r]
            for i in range(n):
                place += row[0, i] * white[0, i]
            if P[r, r] > 0.0:
                moved = max(moved, abs(place - point[r]) / math.sqrt(P[r, r]))
            point[r] = place
        innovate(kind, extrinsic, point, mean, P, d, seen, begin, found, how.first)
        if moved < 1e-6:
            return


@njit
def update(
    kind: int, extrinsic: Array, start: Array, mean: Array, P: Array, d: int, seen: Pairings, begin: int, end: int,
    how: UpdateRule, done: Outcome,
) -> int:  # fmt: skip
    """Update with the pairings from `begin` before `end` inside the gate, stacked. The first linearization is at
    `start` (d,): `mean` itself for the prediction. Returns a status.
    """
    size = end - begin
    found = Innovation(np.empty(2 * size), np.empty((d, 2 * size)), np.empty((2 * size, 2 * size)))
    innovate(kind, extrinsic, start, mean, P, d, seen, begin, found, how.first)
    count = gate(found, how.threshold, begin, done)
    if count == 0:
        return OK
    kept = done.keep[begin:end]
    if count < size:
        found = passed(found, kept)
    stats = done.stats
    stats[2] += 2 * count
    if how.iterations > 1:
        used, point = chosen(seen, begin + np.flatnonzero(kept)), start[:d].copy()
        iterate(kind, extrinsic, point, mean, P, d, used, found, how, stats)
        stats = np.zeros(3)  # the innovation is the one at `start`
    return correct(mean, P, d, found, stats, how)


@njit
def of_frame(
    kind: int, extrinsic: Array, start: Array, mean: Array, P: Array, d: int, at: IntArray, known: Array, z: Array,
    R: Array, decisions: IntArray, threshold: float, retraction: int, iterations: int, first: Array, clones: int,
    clones_end: int, used: BoolArray, white: Array, created: IntArray, stats: Array,
) -> int:  # fmt: skip
    """`update` with those of the observations (m) whose decision is not negative, and the outcome of all of them. Plain
    arrays and numbers, since a tuple of them costs a call from Python a microsecond. Returns a status.
    """
    rows = np.flatnonzero(decisions >= 0)
    k = len(rows)
    done = Outcome(np.ones(k, np.bool_), stats, np.full((k, 2), np.nan))
    used[:], white[:], created[:], stats[:] = False, np.nan, -1, 0.0
    status = OK
    if k > 0:
        seen = chosen(Pairings(at, known, z, R), rows)
        how = UpdateRule(threshold, retraction, iterations, first, clones, clones_end)
        begin = len(seen.at) - k  # as in `iterate`
        status = update(kind, extrinsic, start, mean, P, d, seen, begin, k, how, done)
        used[rows], white[rows] = done.keep, done.white
    return status


@njit
def gate(found: Innovation, threshold: float, begin: int, done: Outcome) -> int:
    """Pairings from `begin` on with squared distance below `threshold`, and white innovations; returns the number."""
    nu, _, S = found
    count = 0
    for i in range(len(nu) // 2):
        row = begin + i
        done.white[row, 0], done.white[row, 1] = np.nan, np.nan
        a, b, c = S[2 * i, 2 * i], S[2 * i, 2 * i + 1], S[2 * i + 1, 2 * i + 1]
        x, y = nu[2 * i], nu[2 * i + 1]
        done.keep[row] = True
        if threshold < np.inf:
            done.keep[row] = (c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b) < threshold
        if done.keep[row]:
            count += 1
            if a > 0.0 and c - b / a * b > 0.0:
                done.white[row, 0] = x / math.sqrt(a)
                done.white[row, 1] = (y - b / a * x) / math.sqrt(c - b / a * b)
    return count


@njit
def passed(found: Innovation, kept: BoolArray) -> Innovation:
    """The part of an innovation whose pairings (k,) passed the gate."""
    rows = np.flatnonzero(np.repeat(kept, 2))
    return Innovation(found.nu[rows], found.PHt[:, rows], found.S[rows][:, rows])


@njit
def chosen(seen: Pairings, rows: IntArray) -> Pairings:
    """The pairings in some rows."""
    return Pairings(seen.at[rows], seen.known[rows], seen.z[rows], seen.R[rows])
