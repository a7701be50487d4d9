"""Relocalization: where in a map a scan was taken, without a prior.

Geometric constraints, branch and bound (Neira, Tardos and Castellanos, ICRA 2003): points of the scan are paired with
landmarks such that all their distances agree. Hypotheses with most pairings are verified by a rigid fit and its joint
distance. The best counts only if no other place explains the scan nearly as well.

The scan is accumulated over a few frames as a robot-centred map (Castellanos, Martinez-Cantin, Tardos and Neira,
Robotics and Autonomous Systems 55, 2007). The robot is at the origin without error; its motion moves the points and
adds an uncertainty common to all of them.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from association.expectation import gate_threshold
from data import se2
from data.blocks import add_to_diagonal, blocks_of, coordinates, diagonal_blocks, of_points, squared_norms
from data.compiled import njit
from data.inputs import FrameObservations, Increment, IntArray, LandmarkMap
from data.se2 import Array
from data.sensors import Sensor
from eval.replay.hindsight import constants


@dataclass(frozen=True)
class Scan:
    """Points (n, 2) m in the body frame, their joint covariance (2n, 2n), and each one's rows of the log."""

    xy: Array
    covariance: Array
    rows: tuple[tuple[int, ...], ...]

    def __len__(self) -> int:
        return len(self.xy)


EMPTY = Scan(np.empty((0, 2)), np.empty((0, 0)), ())  # nothing seen


def moved(scan: Scan, increment: Increment) -> Scan:
    """The scan in the body frame after an increment, without points that have become too uncertain (`FADED`)."""
    if not len(scan):
        return scan
    n, (mean, M) = len(scan), increment
    turn = se2.rotation(-float(mean[2]))
    xy = (scan.xy - mean[:2]) @ turn.T
    A, B = np.kron(np.eye(n), turn), np.zeros((2 * n, 3))
    B[:, :2] = np.tile(-turn, (n, 1))
    B[0::2, 2], B[1::2, 2] = xy[:, 1], -xy[:, 0]
    whole = Scan(xy, A @ scan.covariance @ A.T + B @ M @ B.T, scan.rows)
    clear = np.flatnonzero(_variance(whole) < constants.FADED**2)
    if len(clear) == n:
        return whole
    return Scan(xy[clear], of_points(whole.covariance, clear), tuple(whole.rows[i] for i in clear))


def extended(scan: Scan, sensor: Sensor, observations: FrameObservations, rows: IntArray) -> Scan:
    """The scan with a frame's observations (m), whose rows of the log are `rows` (m,). An observation of a known point
    (nearest first, one to one, inside `SAME_GATE`) corrects the scan; any other is a new point.
    """
    xy, R = sensor.body_points(*observations)
    n, old = len(scan), _pairs(scan, xy, R)
    mean, P, seen = scan.xy.ravel().copy(), scan.covariance, [list(r) for r in scan.rows]
    if old:
        at = coordinates(np.array([j for _, j in old]))
        S = P[np.ix_(at, at)].copy()
        add_to_diagonal(S, R[[i for i, _ in old]])
        nu = np.concatenate([xy[i] - scan.xy[j] for i, j in old])
        K = np.linalg.solve(S, P[at]).T
        mean = mean + K @ nu
        P = P - K @ P[at]
        P = 0.5 * (P + P.T)
        for i, j in old:
            seen[j].append(int(rows[i]))
    new = np.setdiff1d(np.arange(len(xy)), [i for i, _ in old])
    joint = np.zeros((2 * (n + len(new)),) * 2)
    joint[: 2 * n, : 2 * n] = P
    for q, i in enumerate(new.tolist(), n):
        joint[2 * q : 2 * q + 2, 2 * q : 2 * q + 2] = R[i]
        seen.append([int(rows[i])])
    return Scan(np.concatenate([mean.reshape(-1, 2), xy[new]]), joint, tuple(tuple(s) for s in seen))


def _pairs(scan: Scan, xy: Array, R: Array) -> list[tuple[int, int]]:
    """Observations and the known points they show: nearest pair first, one to one."""
    n = len(scan)
    d2 = squared_norms(xy[:, None] - scan.xy, diagonal_blocks(scan.covariance) + R[:, None])
    pairs, threshold = [], gate_threshold(constants.SAME_GATE)
    while d2.size and d2.min() < threshold:
        i, j = divmod(int(np.argmin(d2)), n)
        pairs.append((i, j))
        d2[i], d2[:, j] = np.inf, np.inf
    return pairs


def _variance(scan: Scan) -> Array:
    return np.asarray(np.diag(scan.covariance).reshape(-1, 2).sum(axis=1))


class Place(NamedTuple):
    """Pose (3,), its covariance (3, 3) additive in the world frame, and the landmark of each point (n,)."""

    pose: Array
    covariance: Array
    pairings: IntArray  # -1 for none
    log_odds: float  # log odds against the next best place


def relocalize(scan: Scan, known: LandmarkMap) -> Place | None:
    """The place in a known map at which the scan was taken; None if there is none, or more than one. None also if the
    search was not completed. In an unmapped place, few points may fit elsewhere.
    """
    used = np.argsort(_variance(scan), kind="stable")[: constants.FRAME_POINTS]
    m, fewest = len(used), max(constants.PLACE_PAIRINGS, math.ceil(constants.SCAN_SHARE * len(used)))
    if m < constants.PLACE_PAIRINGS or len(known.id) < constants.PLACE_PAIRINGS:
        return None
    xy = np.ascontiguousarray(scan.xy[used])
    P = of_points(scan.covariance, used)
    if known.sigma is not None:  # each point is of one landmark, whose error is as large as usual in this map
        add_to_diagonal(P, np.tile(np.mean(known.sigma**2) * np.eye(2), (m, 1, 1)))
    choices, complete = _search(
        xy, constants.DISTANCE_SIGMAS * distance_sigmas(xy, P), np.array(known.xy), fewest,
        constants.SEARCH_SLACK, constants.SEARCH_KEPT, constants.SEARCH_BUDGET,
    )  # fmt: skip
    if not complete or not len(choices):
        return None
    area = math.pi * float(np.hypot(*xy.T).max()) ** 2
    verified = (_verify(xy, P, known.xy, choice, area) for choice in choices)
    fits = [fit for fit in verified if fit is not None]
    if not fits:
        return None
    best = max(fits, key=lambda fit: fit.log_odds)
    odds = best.log_odds - max((f.log_odds for f in fits if not _same(best, f)), default=-math.inf)
    if odds < math.log(constants.SCAN_ODDS):
        return None
    pairings, choice = np.full(len(scan), -1, np.int64), best.pairings
    pairings[used[choice >= 0]] = known.id[choice[choice >= 0]]
    return best._replace(pairings=pairings, log_odds=odds)


def _same(best: Place, other: Place) -> bool:
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
    return np.asarray(np.sqrt(np.maximum(np.einsum("mna,mnab,mnb->mn", u, difference, u), constants.EXACT_VARIANCE)))


def _verify(xy: Array, P: Array, landmarks: Array, choice: IntArray, area: float) -> Place | None:
    """Gauss-Newton fit of the pose to the pairings, with its log-likelihood; None outside their joint gate."""
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
    if d2 >= gate_threshold(constants.RELOCALIZE_GATE, 2 * len(paired) - 3):
        return None
    covariance = np.linalg.inv(information)
    score = -0.5 * d2 - float(np.log(np.diag(L)).sum()) - len(paired) * math.log(2.0 * math.pi)
    score += 0.5 * float(np.linalg.slogdet(2.0 * math.pi * covariance)[1])
    score += (len(xy) - len(paired)) * math.log(constants.SCAN_STRAY / area)
    return Place(pose, covariance, choice, score)


@njit
def _search(
    xy: Array, tolerance: Array, landmarks: Array, fewest: int, slack: int, kept: int, budget: int
) -> tuple[IntArray, bool]:
    """Interpretation tree over points (m, 2), depth first: hypotheses (h, m), landmark or -1, and whether complete.
    A pairing agrees in distances within `tolerance` (m, m) with all before, and in the side of the line through the
    first two; a branch that cannot reach `fewest` pairings, nor the most so far less `slack`, is cut.
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
                    every, h = h, 0
                    for i in range(every):
                        if counts[i] >= least:
                            counts[h] = counts[i]
                            found[h] = found[i]
                            h += 1
                if h == kept:
                    return found[:h], False
                counts[h] = made[t]
                found[h] = choice
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
                within = tolerance[a, b] + tolerance[a, t] + tolerance[b, t]
                agree = abs(offset - other) <= within or offset * other > 0.0
            if not agree:
                continue
            choice[t] = c
            used[c] = True
            made[t + 1] += 1
        t += 1
        if t < m:
            branch[t] = 0
    return found[:h], True


@njit
def _side(a: Array, b: Array, p: Array) -> float:
    """Signed distance of p from the line through a and b; 0 if these are one point."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    return 0.0 if length == 0.0 else float((dx * (p[1] - a[1]) - dy * (p[0] - a[0])) / length)
