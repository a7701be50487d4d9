"""Relocalization: where in a map a scan was taken, without any prior of the pose.

Geometric constraints, branch and bound (Neira, Tardos and Castellanos, ICRA 2003): points of the scan are paired with
landmarks such that all distances between them agree; the hypotheses with most pairings are verified by a rigid fit and
its joint distance, and the best of them counts only if no other place explains the scan nearly as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from association.evidence import constants
from association.expectation import gate_threshold
from association.geometry.local_map import Scan, surest
from data import se2
from data.blocks import blocks_of, of_points
from data.inputs import IntArray, LandmarkMap
from data.se2 import Array


class Place(NamedTuple):
    """Pose (3,) in the world, its covariance (3, 3) additive in the world frame, and the landmark of each point (n,).

    `pairings` names landmark ids, -1 for none; `log_odds`: logarithm of its odds against the next best place.
    """

    pose: Array
    covariance: Array
    pairings: IntArray
    log_odds: float


class _Fit(NamedTuple):
    pose: Array
    covariance: Array
    score: float


def relocalize(scan: Scan, known: LandmarkMap, gate: float | None = None) -> Place | None:
    """The place in a known map at which the scan was taken, or None if there is none, or more than one.

    It presumes that the map holds what is seen there: in a place that is not mapped, few points may fit elsewhere.

    Args:
        scan: points with their joint covariance.
        known: landmarks, taken as exact.
        gate: chi-square probability of the joint distance of the fit (2 q - 3 dof for q pairings), by default
            `RELOCALIZE_GATE`.

    Returns:
        The place, all pairings inside the gate jointly; None also where the search could not be completed.
    """
    gate = constants.RELOCALIZE_GATE if gate is None else gate
    used = surest(scan, constants.SCAN_POINTS)
    m, fewest = len(used), max(constants.PLACE_PAIRINGS, math.ceil(constants.SCAN_SHARE * len(used)))
    if m < constants.PLACE_PAIRINGS or len(known.id) < constants.PLACE_PAIRINGS:
        return None
    xy = np.ascontiguousarray(scan.xy[used])
    P = of_points(scan.covariance, used)
    choices, complete = _search(
        xy, constants.DISTANCE_SIGMAS * distance_sigmas(xy, P), np.array(known.xy), fewest,
        constants.SEARCH_SLACK, constants.SEARCH_KEPT, constants.SEARCH_BUDGET,
    )  # fmt: skip
    if not complete or not len(choices):
        return None
    area = math.pi * float(np.hypot(*xy.T).max()) ** 2
    fits = []
    for choice in choices:
        fit = _verify(xy, P, known.xy, choice, gate, area)
        if fit is not None:
            fits.append((fit, choice))
    if not fits:
        return None
    best, choice = max(fits, key=lambda f: f[0].score)
    others = [f.score for f, _ in fits if not _same(best, f)]
    log_odds = best.score - max(others, default=-math.inf)
    if log_odds < math.log(constants.SCAN_ODDS):
        return None
    pairings = np.full(len(scan), -1, np.int64)
    pairings[used[choice >= 0]] = known.id[choice[choice >= 0]]
    return Place(best.pose, best.covariance, pairings, log_odds)


def _same(best: _Fit, other: _Fit) -> bool:
    """Whether two fits are one place: closer than 5 sigma."""
    error = se2.pose_error(best.pose, other.pose)
    return float(error @ np.linalg.solve(best.covariance + other.covariance, error)) < constants.ONE_PLACE_SIGMAS**2


def distance_sigmas(xy: Array, P: Array) -> Array:
    """Standard deviations (m, m) of the distances between points (m, 2) of joint covariance P (2m, 2m)."""
    m = len(xy)
    d = xy[:, None] - xy[None]
    r = np.hypot(d[..., 0], d[..., 1])
    u = d / np.where(r > 0.0, r, 1.0)[..., None]
    blocks = blocks_of(P)
    own = blocks[np.arange(m), np.arange(m)]
    difference = own[:, None] + own[None] - blocks - blocks.transpose(1, 0, 2, 3)
    sigma: Array = np.sqrt(np.maximum(np.einsum("mna,mnab,mnb->mn", u, difference, u), constants.EXACT_VARIANCE))
    return sigma


def _verify(xy: Array, P: Array, landmarks: Array, choice: IntArray, gate: float, area: float) -> _Fit | None:
    """Gauss-Newton fit of the pose to the pairings with their joint covariance; None if outside the joint gate.

    The score is the logarithm of the likelihood of all points, the pose marginalized over a flat prior; points without
    a pairing are strays, anywhere in `area` [m^2].
    """
    paired = np.flatnonzero(choice >= 0)
    points, places = xy[paired], landmarks[choice[paired]]
    pose = se2.rigid_fit(points, places)
    L = np.linalg.cholesky(of_points(P, paired))
    for _ in range(constants.FIT_STEPS):
        there = (places - pose[:2]) @ se2.rotation(pose[2])
        J = np.zeros((2 * len(paired), 3))
        J[0::2, :2], J[1::2, :2] = -se2.rotation(pose[2])[:, 0], -se2.rotation(pose[2])[:, 1]
        J[0::2, 2], J[1::2, 2] = there[:, 1], -there[:, 0]
        white, r = np.linalg.solve(L, J), np.linalg.solve(L, (points - there).ravel())
        information = white.T @ white
        if np.linalg.eigvalsh(information)[0] < constants.FIT_SINGULAR:
            return None
        step = np.linalg.solve(information, white.T @ r)
        pose = pose + step
        pose[2] = se2.wrap_angle(float(pose[2]))
        if float(step @ information @ step) < constants.FIT_CONVERGED:
            break
    d2 = float(r @ r - r @ white @ np.linalg.solve(information, white.T @ r))
    if d2 >= gate_threshold(gate, 2 * len(paired) - 3):
        return None
    covariance = np.linalg.inv(information)
    score = -0.5 * d2 - float(np.log(np.diag(L)).sum()) - len(paired) * math.log(2.0 * math.pi)
    score += 0.5 * float(np.linalg.slogdet(2.0 * math.pi * covariance)[1])
    return _Fit(pose, covariance, score + (len(xy) - len(paired)) * math.log(constants.SCAN_STRAY / area))


@numba.njit(cache=True)
def _search(xy, tolerance, landmarks, fewest, slack, kept, budget):  # type: ignore[no-untyped-def]
    """Interpretation tree over points (m, 2) in order, every landmark or none for each; depth first.

    A pairing is added if its distances to all points paired before agree within `tolerance` (m, m), and if it lies on
    the right side of the line through the first two: distances alone do not tell a scan from its mirror image. A branch
    is cut if it cannot reach `fewest` pairings, nor the most found so far less `slack`.

    Returns the hypotheses (h, m), landmark index or -1, and whether the search is complete.
    """
    m, n = len(xy), len(landmarks)
    found, counts, h = np.empty((kept, m), np.int64), np.empty(kept, np.int64), 0
    choice, branch, made = np.full(m, -1), np.zeros(m + 1, np.int64), np.zeros(m + 1, np.int64)
    used = np.zeros(n, np.bool_)
    least, t, nodes = fewest, 0, 0
    while t >= 0:
        if t == m:
            if made[t] >= least:
                if made[t] - slack > least:
                    least = made[t] - slack
                    rest = 0
                    for i in range(h):
                        if counts[i] >= least:
                            found[rest], counts[rest] = found[i], counts[i]
                            rest += 1
                    h = rest
                if h == kept:
                    return found[:h], False
                found[h], counts[h] = choice, made[t]
                h += 1
            t -= 1
            continue
        if choice[t] >= 0:
            used[choice[t]] = False
            choice[t] = -1
        if branch[t] > n or made[t] + m - t < least or (branch[t] == n and made[t] + m - t - 1 < least):
            t -= 1
            continue
        nodes += 1
        if nodes > budget:
            return found[:h], False
        c = branch[t]
        branch[t] += 1
        made[t + 1] = made[t]
        if c < n:
            if used[c]:
                continue
            agree, a, b = True, -1, -1
            for s in range(t):
                if choice[s] < 0:
                    continue
                if a < 0:
                    a = s
                elif b < 0:
                    b = s
                seen = math.hypot(xy[t, 0] - xy[s, 0], xy[t, 1] - xy[s, 1])
                o = choice[s]
                there = math.hypot(landmarks[c, 0] - landmarks[o, 0], landmarks[c, 1] - landmarks[o, 1])
                if abs(seen - there) > tolerance[s, t]:
                    agree = False
                    break
            if agree and b >= 0:
                offset = _side(xy[a], xy[b], xy[t])
                other = _side(landmarks[choice[a]], landmarks[choice[b]], landmarks[c])
                agree = (
                    abs(offset - other) <= tolerance[a, b] + tolerance[a, t] + tolerance[b, t] or offset * other > 0.0
                )
            if not agree:
                continue
            choice[t] = c
            used[c] = True
            made[t + 1] += 1
        t += 1
        if t < m:
            branch[t] = 0
    return found[:h], True


@numba.njit(cache=True)
def _side(a, b, p):  # type: ignore[no-untyped-def]
    """Signed distance of p from the line through a and b; 0 where these are one point."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    if length == 0.0:
        return 0.0
    return (dx * (p[1] - a[1]) - dy * (p[0] - a[0])) / length
