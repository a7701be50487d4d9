"""Placement: the pose of a frame by geometry, where the motion is too uncertain to linearize at its mean.

Two observations laid onto two landmarks at the same distance give a pose exactly, as in `relocalize`. Poses that the
motion allows are verified with the estimator's own joint covariance, linearized there, and the best one is used. Poses
with similar pairings are one.

A world may repeat itself, so similarity to mapped places is no evidence. An observation beyond everything in view
before counts neither for a pose nor against it. Missed detections count against it, then and now; otherwise the motion
decides.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from association.conditional import conditional_distances, conditional_expectation, prune, unless_close
from association.expectation import Expectation, gate_threshold
from association.jcbb import search
from data import se2
from data.blocks import block_diagonal
from data.compiled import njit
from data.inputs import Increment, IntArray
from data.result import NEW
from data.se2 import Array
from data.sensors import Sensor
from eval.replay.hindsight import constants
from eval.replay.hindsight.opportunities import missing
from eval.replay.hindsight.relocalize import distance_sigmas


def candidates(e: Expectation, sensor: Sensor, motion: Array) -> list[tuple[float, IntArray]]:
    """Different pairings (m,), candidate of each observation or -1, from poses allowed by the motion. Each with its
    squared distance from the predicted motion; most pairs first, at most `FRAME_PAIRINGS`.
    """
    seen, R = sensor.body_points(e.z, e.R)
    there, _, G = sensor.inverse(np.zeros(3), e.z_hat)
    every = np.arange(len(there))
    variance = np.trace(R, axis1=1, axis2=2)
    surest = np.sort(np.argsort(variance, kind="stable")[: constants.FRAME_POINTS])
    pairings, d2, count = _poses(
        seen, np.sqrt(variance), distance_sigmas(seen, block_diagonal(R)), surest,
        there, distance_sigmas(there, block_diagonal(G) @ e.joint(every) @ block_diagonal(G).T),
        np.asarray(np.linalg.inv(motion), np.float64), gate_threshold(constants.MOTION_GATE, 3),
        constants.DISTANCE_SIGMAS, constants.LONG_PAIR, constants.PLACE_PAIRINGS, constants.FRAME_POSES,
    )  # fmt: skip
    kept: list[tuple[float, IntArray]] = []
    for c in np.lexsort((d2[:count], -(pairings[:count] >= 0).sum(axis=1))).tolist():
        choice = pairings[c]
        paired = choice >= 0
        if all((k[paired] == choice[paired]).sum() <= constants.FRAME_ALIKE * paired.sum() for _, k in kept):
            kept.append((float(d2[c]), choice))
        if len(kept) == constants.FRAME_PAIRINGS:
            break
    return kept


@njit
def _poses(
    seen: Array, sigma: Array, seen_sigma: Array, surest: IntArray, there: Array, there_sigma: Array,
    information: Array, threshold: float, sigmas: float, long: float, fewest: int, kept: int,
) -> tuple[IntArray, Array, int]:  # fmt: skip
    """Poses (x, y, a) with there = R(a) seen + (x, y) from two pairs of points, and their pairings. seen (m, 2) with
    standard deviations (m,), seen_sigma (m, m) those of their distances; there (n, 2), there_sigma (n, n). Pairs of the
    observations `surest` at least `long` times as far apart as the farthest are used. Returns the pairings (kept, m),
    nearest within `sigmas` or -1, the squared distance (kept,) of each pose by `information` (3, 3), below `threshold`,
    and the number of poses with at least `fewest` pairings.
    """
    m, n = len(seen), len(there)
    pairings, distance, count = np.full((kept, m), -1), np.empty(kept), 0
    longest, free = 0.0, np.empty(n, np.bool_)
    for i in surest:
        for j in surest:
            longest = max(longest, math.hypot(seen[i, 0] - seen[j, 0], seen[i, 1] - seen[j, 1]))
    for i in surest:
        for j in surest:
            dx, dy = seen[j, 0] - seen[i, 0], seen[j, 1] - seen[i, 1]
            d = math.hypot(dx, dy)
            if j <= i or d < long * longest or d == 0.0:
                continue
            for a in range(n):
                for b in range(n):
                    ex, ey = there[b, 0] - there[a, 0], there[b, 1] - there[a, 1]
                    tolerance = sigmas * math.sqrt(seen_sigma[i, j] ** 2 + there_sigma[a, b] ** 2)
                    if a == b or abs(math.hypot(ex, ey) - d) > tolerance:
                        continue
                    angle = math.atan2(dx * ey - dy * ex, dx * ex + dy * ey)
                    c, s = math.cos(angle), math.sin(angle)
                    mx, my = 0.5 * (seen[i, 0] + seen[j, 0]), 0.5 * (seen[i, 1] + seen[j, 1])
                    x = 0.5 * (there[a, 0] + there[b, 0]) - (c * mx - s * my)
                    y = 0.5 * (there[a, 1] + there[b, 1]) - (s * mx + c * my)
                    d2 = 2.0 * (information[0, 1] * x * y + (information[0, 2] * x + information[1, 2] * y) * angle)
                    d2 += information[0, 0] * x * x + information[1, 1] * y * y + information[2, 2] * angle * angle
                    if d2 > threshold:
                        continue
                    paired = 0
                    free[:] = True
                    for k in range(m):
                        px, py = c * seen[k, 0] - s * seen[k, 1] + x, s * seen[k, 0] + c * seen[k, 1] + y
                        # the heading is as uncertain as the two points are, across, at their distance
                        lever = math.hypot(seen[k, 0] - mx, seen[k, 1] - my) / d
                        own = there_sigma[a, b] ** 2 + sigma[i] ** 2 + sigma[j] ** 2
                        nearest = sigmas**2 * (sigma[k] ** 2 + own * (0.5 + lever * lever))
                        pairings[count, k] = -1
                        for o in range(n):
                            ox, oy = there[o, 0] - px, there[o, 1] - py
                            if free[o] and ox * ox + oy * oy < nearest:
                                nearest = ox * ox + oy * oy
                                pairings[count, k] = o
                        if pairings[count, k] >= 0:
                            free[pairings[count, k]] = False
                            paired += 1
                    if paired < fewest:
                        continue
                    distance[count] = d2
                    count += 1
                    if count == kept:
                        return pairings, distance, count
    return pairings, distance, count


class Memory(NamedTuple):
    """Knowledge from the frames before."""

    seen_from: Sequence[Array]  # poses (3,) from which the map was seen
    rate: Array  # (n,) detection probability of each candidate
    strays: float  # share of observations in mapped areas that are of no landmark


class Placed(NamedTuple):
    """A frame with its pose."""

    pose: Array  # (3,) in the world
    expectation: Expectation  # linearized there
    believed: Expectation  # the same given the pairings
    decisions: IntArray  # (m,) as of `association.conditional`
    sudden: int  # number of unpaired observations in mapped areas
    score: float  # log-likelihood, see `place`


def drifted(covariance: Array, increment: Increment) -> Array:
    """Covariance (3, 3) of a motion after one more increment, in the body frame of its expected end."""
    (x, y, turn), M = increment
    B = se2.world_from_body(-float(turn))
    F = B @ np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    P = F @ covariance @ F.T + B @ M @ B.T
    return np.asarray(0.5 * (P + P.T))


def too_uncertain(e: Expectation, sensor: Sensor, motion: Array) -> bool:
    """Whether the linearization error exceeds the noise of most observations.

    A point p seen after an unexpected motion (d, a) is at R(-a) (p - d); the second-order terms |p| a^2 / 2 and |d| |a|
    have root mean squares of sqrt(3) / 2 |p| sigma_a^2 and at most sigma_d sigma_a. `motion` (3, 3): see `drifted`.
    """
    if not len(e.z):
        return False
    turn, shift = motion[2, 2], math.sqrt(motion[0, 0] + motion[1, 1])
    xy, _, Gz = sensor.inverse(np.zeros(3), e.z)
    det = (Gz[:, 0, 0] * Gz[:, 1, 1] - Gz[:, 0, 1] * Gz[:, 1, 0]) ** 2
    det *= e.R[:, 0, 0] * e.R[:, 1, 1] - e.R[:, 0, 1] * e.R[:, 1, 0]
    error = 0.5 * math.sqrt(3.0) * turn * np.hypot(xy[:, 0], xy[:, 1]) + shift * math.sqrt(turn)
    off, middle = np.sort(error - np.maximum(det, 0.0) ** 0.25), len(error) // 2
    return bool(off[middle] + off[~middle] > 0.0)  # the median


def place(
    e: Expectation, sensor: Sensor, predicted: Array, motion: Array, memory: Memory, gate: float | None,
    new_gate: float | None,
) -> Placed | None:  # fmt: skip
    """The pose at which a frame is to be decided about, with its decisions; None if the map does not give one.

    The score of a pose is -d^2 / 2 of the motion to it, plus two log probabilities: of its missed detections, and of
    unpaired observations in mapped areas. Pairings must pass the gates jointly and each given the others. Their number
    and fit do not count, because a repetitive world provides them by chance.

    e is linearized at the pose predicted (3,) in the world, with `elsewhere`; motion (3, 3) is its covariance relative
    to the map, in the predicted body frame. Pairings pass `gate`; outside `new_gate` an observation is a new landmark.
    """
    near = _near(e, sensor, motion)
    if min(len(near), len(e.z)) < constants.PLACE_PAIRINGS:
        return None
    e, memory = e.only(near), memory._replace(rate=memory.rate[near])
    outer = gate if gate is None or new_gate is None else max(gate, new_gate)
    best: Placed | None = None
    for d2, choice in sorted(candidates(e, sensor, motion), key=lambda c: c[0]):
        if best is not None and best.score > constants.FIT_SLACK - 0.5 * d2:
            break
        found = _verified(e, sensor, predicted, motion, choice, memory, outer)
        if found is not None and (best is None or found.score > best.score):
            best = found
    if best is None:
        return None
    e = best.expectation
    kept = prune(e, best.decisions, gate)
    return best._replace(decisions=unless_close(kept, conditional_distances(e, kept, new_gate) < e.threshold(new_gate)))


def _near(e: Expectation, sensor: Sensor, motion: Array) -> IntArray:
    """Candidates (k,) within the farthest observed distance, for any motion."""
    seen, there = sensor.polar(e.z)[:, 0], sensor.inverse(np.zeros(3), e.z_hat)[0]
    lever = math.hypot(*sensor.translation)
    reach = float(seen.max(initial=0.0)) + lever + constants.DISTANCE_SIGMAS * math.sqrt(motion[0, 0] + motion[1, 1])
    return np.flatnonzero(np.hypot(*there.T) < reach)


def _verified(
    e: Expectation, sensor: Sensor, predicted: Array, motion: Array, choice: IntArray, memory: Memory,
    gate: float | None,
) -> Placed | None:  # fmt: skip
    """The place of a pairing (m,), with all pairings as its decisions; None if they do not pass the gates."""
    assert e.elsewhere is not None  # the caller's promise
    xy, R = sensor.body_points(e.z, e.R)
    landmarks, every = sensor.inverse(predicted, e.z_hat)[0], np.arange(len(e.number))
    decisions = np.where(choice >= 0, e.number[choice], NEW)
    for _ in range(constants.VERIFY_ROUNDS):
        rows, chosen = e.paired(decisions)
        if len(rows) < constants.PLACE_PAIRINGS:
            return None
        pose = se2.rigid_fit(xy[rows], landmarks[chosen])
        here = e.elsewhere(pose)
        decisions = _clear(conditional_expectation(here, prune(here, decisions, gate), every), decisions, gate)
        decisions = prune(here, _more(conditional_expectation(here, decisions, every), decisions, gate), gate)
    rows, chosen = e.paired(decisions)
    if len(rows) < constants.PLACE_PAIRINGS:
        return None
    nis, dof, _ = here.innovation_statistics(rows, chosen)
    if nis >= gate_threshold(gate, dof):
        return None
    believed = conditional_expectation(here, decisions, every)
    absent = missing(believed, decisions, sensor)[0]
    stray = decisions == NEW
    sudden = _in_view_before(sensor, pose, xy[stray], R[stray], memory.seen_from)
    off = se2.between(predicted, pose)
    score = -0.5 * float(off @ np.linalg.solve(motion, off))
    score += float(np.log1p(-memory.rate[absent]).sum()) + sudden * math.log(memory.strays)
    return Placed(pose, here, believed, decisions, sudden, score)


def _clear(believed: Expectation, decisions: IntArray, gate: float | None) -> IntArray:
    """Unambiguous pairings of both sides, given all; all pairings if these are too few."""
    near = believed.individual_distances() < believed.threshold(gate)
    rows, chosen = believed.paired(decisions)
    clear = (near[rows].sum(axis=1) == 1) & (near[:, chosen].sum(axis=0) == 1) & near[rows, chosen]
    if clear.sum() < constants.PLACE_PAIRINGS:
        return decisions
    left = np.full(len(decisions), NEW, np.int64)
    left[rows[clear]] = decisions[rows[clear]]
    return left


def _more(believed: Expectation, decisions: IntArray, gate: float | None) -> IntArray:
    """Pair what is left, by joint compatibility given the pairings made."""
    left = np.flatnonzero(decisions == NEW)
    free = np.flatnonzero(~np.isin(believed.number, decisions))
    if not len(left) or not len(free):
        return decisions
    left_at = believed.observed_frame[left]
    rest = replace(believed.only(free), z=believed.z[left], R=believed.R[left], observed_frame=left_at)
    if rest.unlike is not None:
        rest = replace(rest, unlike=rest.unlike.of(left))
    more = decisions.copy()
    more[left] = search(rest, gate).decisions
    return more


def _in_view_before(sensor: Sensor, pose: Array, xy: Array, R: Array, seen_from: Sequence[Array]) -> int:
    """Number of points (k, 2) seen from a pose (3,) that were well in view before, by 3 sigma."""
    world = se2.transform_points(pose, xy)
    sigma = constants.DISTANCE_SIGMAS * np.sqrt(np.trace(R, axis1=1, axis2=2))
    before = np.zeros(len(xy), np.bool_)
    for past in seen_from:
        z = sensor.predict(past, world)
        angle = sigma / np.maximum(sensor.polar(z)[:, 0], sigma)
        before |= sensor.in_view(z, margin_range=-sigma, margin_angle=-angle)
    return int(before.sum())
