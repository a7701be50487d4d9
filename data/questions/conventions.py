"""The order of turning and driving, which a log may follow otherwise than stated.

Every order is a change of the inputs. It is judged by a likelihood: of the true increments, or of observations in
pairs of frames, between which the odometry carries what was observed. Landmarks need no names: each observation goes to
the nearest of the other frame, under each order anew. Likelihoods of two simple hypotheses need no fitted
threshold: a wrong one is e^T times as likely as the right one with probability below e^-T.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np

from data.inputs import Increments, Inputs
from data.log import INTEGRATION, ODOMETRY_KIND, ODOMETRY_PERIOD, Log
from data.motion.velocity import compose_in_place
from data.se2 import Array, between, dead_reckoned, rotation

ARC, TURN_FIRST, DRIVE_FIRST = "arc", "turn-first", "drive-first"
ORDERS = {ARC: 0.0, TURN_FIRST: 0.5, DRIVE_FIRST: -0.5}
"""By name: share of a step's turn by which its motion points further than along the arc. A chord in the middle heading,
the third order of the textbooks, differs from the arc by a 24th of the turn's square only."""
ARCS = "unicycle"  # the motion model of arcs
CLEAR = 20.0
"""Difference of log-likelihoods that raises a question; of worlds and recordings here the largest is 1."""
CLEAR_UNSEEN = 10.0
"""The same of the order without ground truth, where pairs of frames show little of it."""
PLAIN = 0.6
"""Largest mean squared error under another convention, over that as stated: it explains most of what does not fit."""
NEAR = 0.3
"""Largest difference of the best share of half a turn from 1: another cause has another size."""
ROBUST = 16.0  # squared distance beyond which an observation counts as one of something else
TURNED, LONGEST, PAIRS = 0.25, 60, 150  # rad and frames between the frames of a pair; most pairs
TINY = 1e-12  # sigmas; a shorter difference of two conventions is none
SPANS = (1, 4, 16)
"""Frames between compared true poses: over more of them the order shows through noisy or rarely known ones."""
REGULAR = 1e-9  # of the trace of a covariance, added to its variances before it is inverted
FEWEST = 30  # observations, or steps with a true one, for a question


class Verdict(NamedTuple):
    """The likeliest convention, and by how much its log-likelihood exceeds that of the stated one."""

    name: str
    gain: float


def reordered(increments: Increments, share: float, steps: Array | float = 1.0) -> Increments:
    """Increments (N,) of arcs, made of so many steps each, as of another order: turned by a share of a step's turn."""
    mean = increments.mean.copy()
    turn = share * mean[:, 2] / steps
    c, s = np.cos(turn), np.sin(turn)
    mean[:, 0], mean[:, 1] = c * mean[:, 0] - s * mean[:, 1], s * mean[:, 0] + c * mean[:, 1]
    return Increments(mean, increments.covariance)


def _steps(log: Log) -> Array:
    """Samples of odometry in each increment (N,); of unknown ones, as many as there are shortest frame intervals."""
    gap = np.diff(log.recorded.time, prepend=log.recorded.time[0])
    usual = float(np.quantile(gap[1:], 0.1)) if len(gap) > 1 else 1.0
    period = float(cast("float", log.source.get(ODOMETRY_PERIOD, usual)))
    return np.maximum(np.round(gap / period), 1.0) if period > 0.0 else np.ones(len(gap))


def _may_be_reordered(log: Log) -> bool:
    """Whether the odometry may be velocities that were taken for arcs."""
    source = log.source
    return source.get(ODOMETRY_KIND, "velocities") == "velocities" and source.get(INTEGRATION, ARCS) == ARCS


def order_by_truth(log: Log) -> Verdict | None:
    """The order of turning and driving under which odometry has the true increments; None: too few turns to tell.

    A misstated noise, or that of the truth, is estimated along: likelihoods are those of the noise that fits best.
    """
    pose, u = log.truth.pose, log.recorded.increments
    if pose is None or len(pose) < 2 or not _may_be_reordered(log):
        return None
    steps = _steps(log)
    orders = {name: reordered(u, share, steps) for name, share in ORDERS.items()}
    found = [_order_over(span, pose, orders) for span in SPANS]
    return max((v for v in found if v is not None), key=lambda v: v.gain, default=None)


def _order_over(span: int, pose: Array, orders: Mapping[str, Increments]) -> Verdict | None:
    """The order by true poses (N, 3) that are so many frames apart."""
    true = between(pose[:-span:span], pose[span::span])
    mean, covariance = _over(span, orders[ARC])
    rows = np.flatnonzero(np.isfinite(true).all(axis=1) & (np.abs(mean[:, 2]) > 0.0) & mean[:, :2].any(axis=1))
    if len(rows) < FEWEST:
        return None
    P = covariance[rows, :2, :2]  # singular where odometry is exact in one direction
    weight = np.linalg.inv(P + (REGULAR * np.trace(P, axis1=1, axis2=2)[:, None, None] + TINY) * np.eye(2))
    stated = mean[rows, :2]
    r = true[rows, :2] - stated
    cost, off = {}, {}
    for name, increments in orders.items():
        if name == ARC:
            continue
        d = _over(span, increments)[0][rows, :2] - stated
        length = np.sqrt(np.einsum("ni,nij,nj->n", d, weight, d))
        # the residual in the direction in which the two conventions differ, in sigmas
        along = np.einsum("ni,nij,nj->n", d, weight, r) / np.maximum(length, TINY)
        cost[name], off[name] = float(np.sum((along - length) ** 2)), (along, length)
    best = min(cost, key=lambda name: cost[name])
    along, length = off[best]
    as_stated = float(along @ along)
    if cost[best] > PLAIN * as_stated:
        return Verdict(ARC, 0.0)
    size = float(length @ along / (length @ length))
    gain = 0.5 * (as_stated - cost[best]) / max(cost[best] / len(rows), 1.0)
    return Verdict(best, gain) if gain > CLEAR and abs(size - 1.0) < NEAR else Verdict(ARC, 0.0)


def _over(span: int, increments: Increments) -> tuple[Array, Array]:
    """Increments (K, 3) over so many frames, and their covariances (K, 3, 3)."""
    if span == 1:
        return increments.mean[1:], increments.covariance[1:]
    path = dead_reckoned(np.zeros(3), increments.mean)
    mean = between(path[:-span:span], path[span::span])
    covariance = np.zeros((len(mean), 3, 3))
    for k, P in enumerate(covariance):
        motion = np.zeros(3)
        for i in range(k * span + 1, (k + 1) * span + 1):
            compose_in_place(motion, P, increments.mean[i], increments.covariance[i], motion, P)
    return mean, covariance


class _Pair(NamedTuple):
    """What is needed of two frames: odometry between them with its covariance, and what was observed, in the body."""

    motion: Array  # (3,)
    covariance: Array  # (3, 3)
    before: Array  # (m, 2), and its covariances
    spread_before: Array
    after: Array  # (k, 2)
    spread_after: Array


def _ends(inputs: Inputs) -> list[tuple[int, int]]:
    """First and last frame of pairs with observations between which the robot turned."""
    seen = np.flatnonzero(np.diff(inputs.start) > 0)
    turned = np.concatenate([[0.0], np.cumsum(np.abs(inputs.increments.mean[1:, 2]))])[seen]
    found, i = list[tuple[int, int]](), 0
    while i < len(seen):
        j = max(int(np.searchsorted(turned, turned[i] + TURNED)), i + 1)
        if j < len(seen) and seen[j] <= seen[i] + LONGEST:
            found.append((int(seen[i]), int(seen[j])))
            i = j
        else:
            i += 1
    chosen = np.unique(np.linspace(0, len(found) - 1, PAIRS).astype(int)) if len(found) > PAIRS else range(len(found))
    return [found[k] for k in chosen]


def _pairs(inputs: Inputs, increments: Increments, ends: Sequence[tuple[int, int]]) -> list[_Pair]:
    """What is needed of pairs of frames."""
    start = inputs.start
    xy, spread = inputs.sensor.body_points(inputs.observations.z, inputs.observations.R)
    found = []
    for first, last in ends:
        motion, P = np.zeros(3), np.zeros((3, 3))
        for i in range(first + 1, last + 1):
            compose_in_place(motion, P, increments.mean[i], increments.covariance[i], motion, P)
        a, b = slice(start[first], start[first + 1]), slice(start[last], start[last + 1])
        found.append(_Pair(motion, P, xy[a], spread[a], xy[b], spread[b]))
    return found


def _fit(pairs: list[_Pair]) -> tuple[float, int]:
    """Sum over observations of their squared distance to the nearest one of the other frame, and their number."""
    total, count = 0.0, 0
    for p in pairs:
        back = rotation(-float(p.motion[2]))
        here = (p.before - p.motion[:2]) @ back.T
        # to the motion: (x, y) by -R', the heading by the turned point
        J = np.zeros((len(here), 2, 3))
        J[:, :, :2] = -back
        J[:, 0, 2], J[:, 1, 2] = here[:, 1], -here[:, 0]
        S = (back @ p.spread_before @ back.T + J @ p.covariance @ J.transpose(0, 2, 1))[:, None] + p.spread_after[None]
        nu = here[:, None] - p.after[None]
        d2 = np.einsum("mki,mki->mk", nu, np.linalg.solve(S, nu[..., None])[..., 0])
        total += float(np.minimum(d2.min(axis=1), ROBUST).sum())
        count += len(here)
    return total, count


def order_by_observations(log: Log) -> Verdict | None:
    """The order of turning and driving by what is observed before and after; None: too little to tell."""
    inputs, u = log.recorded, log.recorded.increments
    if not inputs.sensor.sees_points or not _may_be_reordered(log):
        return None
    ends, steps = _ends(inputs), _steps(log)

    def fit(share: float) -> tuple[float, int]:
        return _fit(_pairs(inputs, reordered(u, share, steps), ends))

    fits = {name: fit(share) for name, share in ORDERS.items()}
    count = fits[ARC][1]
    if count < FEWEST:
        return None
    best = min(fits, key=lambda name: fits[name][0])
    gain = 0.5 * (fits[ARC][0] - fits[best][0]) / max(0.5 * fits[best][0] / count, 1.0)
    if gain <= CLEAR_UNSEEN or fit(2.0 * ORDERS[best])[0] < fits[best][0]:  # else another cause, as a wrong mounting
        return Verdict(ARC, 0.0)
    return Verdict(best, gain)
