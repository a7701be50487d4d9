"""The filter's compiled steps: predict, innovate, update, augment, on buffers that grow in place.

State vector [x, y, theta, l1x, l1y, ...]; `mean` (C,) and `P` (C, C) are buffers of which the leading `d` entries are
in use. P is the covariance of the additive world-frame error. One set of these functions serves the step-by-step
filters and the whole-run loop (`run`): same arithmetic, same bytes.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from data.sensors import invert, measure, residual, wrap_angle

NEW = -1
DISCARD = -2
OK = 0
NOT_FINITE = 1
NOT_PSD = 2
ADDITIVE = 0
"""Correction: mean += K nu."""
INVARIANT = 1
"""Correction: pose and landmarks are moved together by exp(xi), the right-invariant error of SE_(1+n)(2)."""
FAILURES = {NOT_FINITE: "the state is no longer finite", NOT_PSD: "a covariance lost positive definiteness"}


@numba.njit(cache=True)
def predict(mean, P, d, motion, M):  # type: ignore[no-untyped-def]
    """Move by a body-frame increment `motion` (3,) with covariance M (3, 3): P <- F P F' + G M G', map untouched.

    F differs from I in its third column only, so the cross-covariances with the map change by multiples of row 2.
    """
    c, s = math.cos(mean[2]), math.sin(mean[2])
    wx, wy = c * motion[0] - s * motion[1], s * motion[0] + c * motion[1]
    fx, fy = -wy, wx
    # rows, then columns: F (P F')
    for j in range(d):
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
    mean[2] = wrap_angle(mean[2] + motion[2])


@numba.njit(cache=True)
def innovate(kind, extrinsic, mean, base, P, d, at, known, z, R, nu, PHt, S):  # type: ignore[no-untyped-def]
    """Innovation nu (2k,), PHt (d, 2k) and S (2k, 2k) of k paired observations, all Jacobians at `mean`.

    `base` is the prediction: nu = z - h(mean) - H (base - mean), so the two differ only where an update is iterated.

    `at` (k,) is the offset of each landmark in the state; where it is negative the landmark is known and stands in
    `known` (k, 2).
    """
    k = len(at)
    H = np.empty((k, 2, 5))
    z_hat, Hx, Hl, landmark = np.empty(2), np.empty((2, 3)), np.empty((2, 2)), np.empty(2)
    for i in range(k):
        a = at[i]
        if a < 0:
            landmark[0], landmark[1] = known[i, 0], known[i, 1]
        else:
            landmark[0], landmark[1] = mean[a], mean[a + 1]
        measure(kind, extrinsic, mean, landmark, z_hat, Hx, Hl)
        residual(kind, z[i], z_hat, nu[2 * i : 2 * i + 2])
        H[i, :, :3] = Hx
        H[i, :, 3:] = Hl
        for q in range(2):
            for j in range(3):
                nu[2 * i + q] -= Hx[q, j] * (base[j] - mean[j])
            if a >= 0:
                nu[2 * i + q] -= Hl[q, 0] * (base[a] - mean[a]) + Hl[q, 1] * (base[a + 1] - mean[a + 1])
        for r in range(d):
            for q in range(2):
                value = P[r, 0] * Hx[q, 0] + P[r, 1] * Hx[q, 1] + P[r, 2] * Hx[q, 2]
                if a >= 0:
                    value += P[r, a] * Hl[q, 0] + P[r, a + 1] * Hl[q, 1]
                PHt[r, 2 * i + q] = value
    for i in range(k):
        a = at[i]
        for q in range(2):
            for j in range(2 * k):
                value = H[i, q, 0] * PHt[0, j] + H[i, q, 1] * PHt[1, j] + H[i, q, 2] * PHt[2, j]
                if a >= 0:
                    value += H[i, q, 3] * PHt[a, j] + H[i, q, 4] * PHt[a + 1, j]
                S[2 * i + q, j] = value
    for i in range(2 * k):
        for j in range(i):
            mid = 0.5 * (S[i, j] + S[j, i])
            S[i, j], S[j, i] = mid, mid
    for i in range(k):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += R[i]


@numba.njit(cache=True)
def cholesky(S, L, n):  # type: ignore[no-untyped-def]
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
def correct(mean, P, d, nu, PHt, S, stats, retraction):  # type: ignore[no-untyped-def]
    """The Kalman update: mean += K nu (or see `move`), P -= W W' with W = PHt L^-T, S = L L'.

    Adds NIS and log-likelihood to `stats` (2,). The subtraction is computed once per pair and mirrored, so P stays
    symmetric to the bit. Returns a status.
    """
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
    for r in range(d):
        for c in range(r + 1):
            total = 0.0
            for i in range(n):
                total += PHt[r, i] * PHt[c, i]
            P[r, c] -= total
            P[c, r] = P[r, c]
    if retraction == INVARIANT:
        move(mean, P, d, shift)
    mean[2] = wrap_angle(mean[2])
    stats[0] += nis
    stats[1] -= 0.5 * (nis + log_det + n * math.log(2.0 * math.pi))
    return healthy(mean, P)


@numba.njit(cache=True)
def move(mean, P, d, shift):  # type: ignore[no-untyped-def]
    """Move pose and landmarks by exp(xi) for the additive correction `shift` (d,), and take P along.

    xi_theta = shift_theta; for every point x, rho = shift_x - J x xi_theta and x <- R(xi_theta) x + V(xi_theta) rho
    (Brossard, Barrau and Bonnabel, IEEE Sensors Journal 19(4), 2019). P is the additive covariance in the world frame
    before and after: P <- N P N' with N = I + J (x+ - x-) e_theta' on the rows of each point.
    """
    angle = shift[2]
    c, s = math.cos(angle), math.sin(angle)
    if abs(angle) < 1e-4:  # the series to a rounding; (1 - c) / angle would lose digits
        a, b = 1.0 - angle * angle / 6.0, 0.5 * angle
    else:
        a, b = s / angle, (1.0 - c) / angle
    step = np.zeros(d)
    r = 0
    while r < d:
        x, y = mean[r], mean[r + 1]
        u, v = shift[r] + y * angle, shift[r + 1] - x * angle
        step[r] = c * x - s * y + a * u - b * v - x
        step[r + 1] = s * x + c * y + b * u + a * v - y
        r = 3 if r == 0 else r + 2
    column = np.zeros(d)
    r = 0
    while r < d:
        column[r], column[r + 1] = -step[r + 1], step[r]
        r = 3 if r == 0 else r + 2
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
def healthy(mean, P):  # type: ignore[no-untyped-def]
    """Status of the pose: finite, and no variance negative beyond rounding (1e-12 of the trace)."""
    trace = P[0, 0] + P[1, 1] + P[2, 2]
    for r in range(3):
        if not (math.isfinite(mean[r]) and math.isfinite(P[r, r])):
            return NOT_FINITE
        if P[r, r] < -1e-12 * trace:
            return NOT_PSD
    return OK


@numba.njit(cache=True)
def augment(kind, extrinsic, mean, P, d, z, R, variance):  # type: ignore[no-untyped-def]
    """Append the landmark that z (2,) shows from the present pose; the caller has room for d + 2 states.

    P_new = [[P, P Gx'], [Gx P, Gx P Gx' + Gz R Gz']]. With `variance` >= 0 the landmark instead gets variance * I and
    no correlation (the classic tutorials' way, overconfident by construction).
    """
    landmark, Gx, Gz = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    invert(kind, extrinsic, mean, z, landmark, Gx, Gz)
    mean[d], mean[d + 1] = landmark[0], landmark[1]
    if variance >= 0.0:
        for q in range(2):
            for j in range(d + 2):
                P[d + q, j] = 0.0
                P[j, d + q] = 0.0
            P[d + q, d + q] = variance
        return
    for j in range(d):
        for q in range(2):
            value = Gx[q, 0] * P[0, j] + Gx[q, 1] * P[1, j] + Gx[q, 2] * P[2, j]
            P[d + q, j] = value
            P[j, d + q] = value
    own = Gz @ R @ Gz.T
    for q in range(2):
        for j in range(2):
            own[q, j] += P[d + q, 0] * Gx[j, 0] + P[d + q, 1] * Gx[j, 1] + P[d + q, 2] * Gx[j, 2]
    mid = 0.5 * (own[0, 1] + own[1, 0])
    P[d, d], P[d + 1, d + 1] = own[0, 0], own[1, 1]
    P[d, d + 1], P[d + 1, d] = mid, mid


@numba.njit(cache=True)
def gate(nu, S, threshold, keep):  # type: ignore[no-untyped-def]
    """Set keep (k,): is each observation's own squared Mahalanobis distance below `threshold`? Returns the count."""
    count = 0
    for i in range(len(keep)):
        a, b, c = S[2 * i, 2 * i], S[2 * i, 2 * i + 1], S[2 * i + 1, 2 * i + 1]
        x, y = nu[2 * i], nu[2 * i + 1]
        distance = (c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b)
        keep[i] = distance < threshold
        count += keep[i]
    return count


@numba.njit(cache=True)
def update(kind, extrinsic, mean, P, d, at, known, z, R, threshold, keep, stats, rule):  # type: ignore[no-untyped-def]
    """One stacked update with k pairings; those outside the gate are left out (`keep` says which). Returns a status.

    `rule` = retraction of the correction, and how often to linearize at most (1: at the prediction only).

    `stats` (3,) collects NIS, log-likelihood and degrees of freedom.
    """
    k = len(at)
    nu, PHt, S = np.empty(2 * k), np.empty((d, 2 * k)), np.empty((2 * k, 2 * k))
    innovate(kind, extrinsic, mean, mean, P, d, at, known, z, R, nu, PHt, S)
    keep[:] = True
    if threshold < np.inf:
        count = gate(nu, S, threshold, keep)
        if count == 0:
            return OK
        if count < k:
            rows = np.empty(2 * count, np.int64)
            n = 0
            for i in range(k):
                if keep[i]:
                    rows[n], rows[n + 1] = 2 * i, 2 * i + 1
                    n += 2
            nu, PHt, S = nu[rows], PHt[:, rows], S[rows][:, rows]
    stats[2] += len(nu)
    retraction, iterations = rule
    if iterations > 1:
        at, known, z, R = at[keep], known[keep], z[keep], R[keep]
        point = iterate(kind, extrinsic, mean, P, d, at, known, z, R, nu, PHt, S, iterations, stats)
        innovate(kind, extrinsic, point, mean, P, d, at, known, z, R, nu, PHt, S)
        stats = np.zeros(3)  # the innovation is the one at the prediction
    return correct(mean, P, d, nu, PHt, S, stats, retraction)


@numba.njit(cache=True)
def iterate(kind, extrinsic, mean, P, d, at, known, z, R, nu, PHt, S, iterations, stats):  # type: ignore[no-untyped-def]
    """Where to linearize (d,): Gauss-Newton from the prediction, at most `iterations` - 1 steps (Bell and Cathey 1993).

    nu, PHt and S are those at the prediction, whose NIS and log-likelihood are added to `stats`; they are overwritten.
    Ends early where no state moves by 1e-6 sigma.
    """
    point = mean[:d].copy()
    n = len(nu)
    L, white = np.empty((n, n)), np.empty(n)
    for turn in range(iterations - 1):
        if not cholesky(S, L, n):
            return point  # the correction itself will say so
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
        innovate(kind, extrinsic, point, mean, P, d, at, known, z, R, nu, PHt, S)
    return point


@numba.njit(cache=True)
def forward(L, b, x):  # type: ignore[no-untyped-def]
    """X = L^-1 b for a lower triangle L (n, n); x may be b."""
    for i in range(len(b)):
        total = b[i]
        for q in range(i):
            total -= L[i, q] * x[q]
        x[i] = total / L[i, i]


@numba.njit(cache=True)
def update_each(kind, extrinsic, mean, P, d, at, known, z, R, threshold, keep, stats, rule):  # type: ignore[no-untyped-def]
    """One update per observation, each linearized after the one before it (the classic tutorials' way)."""
    for i in range(len(at)):
        one = slice(i, i + 1)
        status = update(
            kind, extrinsic, mean, P, d, at[one], known[one], z[one], R[one], threshold, keep[one], stats, rule
        )
        if status != OK:
            return status
    return OK


@numba.njit(cache=True)
def expect(kind, extrinsic, mean, P, at, known, z_hat, blocks):  # type: ignore[no-untyped-def]
    """Expected measurement z_hat (n, 2) of n candidates and the blocks H P H' (n, 2, 2)."""
    Hx, Hl, landmark = np.empty((2, 3)), np.empty((2, 2)), np.empty(2)
    H, columns = np.empty((2, 5)), np.empty(5, np.int64)
    for i in range(len(at)):
        a = at[i]
        n = 3 if a < 0 else 5
        if a < 0:
            landmark[0], landmark[1] = known[i, 0], known[i, 1]
        else:
            landmark[0], landmark[1] = mean[a], mean[a + 1]
        measure(kind, extrinsic, mean, landmark, z_hat[i], Hx, Hl)
        H[:, :3], H[:, 3:] = Hx, Hl
        columns[0], columns[1], columns[2], columns[3], columns[4] = 0, 1, 2, a, a + 1
        for q in range(2):
            for p in range(q + 1):
                total = 0.0
                for r in range(n):
                    for c in range(n):
                        total += H[q, r] * P[columns[r], columns[c]] * H[p, c]
                blocks[i, q, p] = total
                blocks[i, p, q] = total


@numba.njit(cache=True)
def run(kind, extrinsic, mean, P, d, motion, M, start, z, R, decision, known, how, threshold, out):  # type: ignore[no-untyped-def]
    """A whole log with decisions made beforehand: what the step-by-step filter does, without leaving compiled code.

    `decision` (M,): SLAM (known empty): landmark number, `NEW` or `DISCARD`; localization: row of `known` (L, 2) or
    `DISCARD`. Rejected pairings become `DISCARD` in place. `out` = pose (N, 3), covariance (N, 3, 3), stats (N, 3),
    state_size (N,); `how` = each, variance of a new landmark, rule. Returns (d, status, frame of the failure).
    """
    each, variance, rule = how
    pose, covariance, stats, size = out
    slam = len(known) == 0
    n = len(motion)
    for f in range(n):
        if f > 0:
            predict(mean, P, d, motion[f], M[f])
        first, last = start[f], start[f + 1]
        paired = 0
        for i in range(first, last):
            paired += decision[i] >= 0
        status = OK
        if paired > 0:
            at, xy = np.empty(paired, np.int64), np.empty((paired, 2))
            zs, Rs, rows = np.empty((paired, 2)), np.empty((paired, 2, 2)), np.empty(paired, np.int64)
            keep = np.empty(paired, np.bool_)
            k = 0
            for i in range(first, last):
                if decision[i] >= 0:
                    rows[k], zs[k], Rs[k] = i, z[i], R[i]
                    at[k] = -1
                    if slam:
                        at[k] = 3 + 2 * decision[i]
                    else:
                        xy[k] = known[decision[i]]
                    k += 1
            if each:
                status = update_each(kind, extrinsic, mean, P, d, at, xy, zs, Rs, threshold, keep, stats[f], rule)
            else:
                status = update(kind, extrinsic, mean, P, d, at, xy, zs, Rs, threshold, keep, stats[f], rule)
            for k in range(paired):
                if not keep[k]:
                    decision[rows[k]] = DISCARD
        if slam and status == OK:
            for i in range(first, last):
                if decision[i] == NEW:
                    augment(kind, extrinsic, mean, P, d, z[i], R[i], variance)
                    d += 2
        if status == OK:
            status = healthy(mean, P)
        pose[f] = mean[:3]
        covariance[f] = P[:3, :3]
        size[f] = d
        if status != OK:
            return d, status, f
    return d, OK, n
