"""Placement: the pose of a frame by geometry, where the motion is too uncertain for an expectation at its mean.

A linearized expectation says nothing about a robot that may have turned by a radian. Two observations and two
landmarks as far apart give a pose exactly (as in `association.geometry.relocalize`); those that the motion allows are
verified with the estimator's own joint covariance, linearized there, and the best of them is where the frame is decided
about.

Which is the best? A world may repeat itself. That what lies ahead looks like what is mapped behind is no evidence of
being there, so an observation beyond what was ever in view speaks neither for a pose nor against it; what should have
been seen and was not, then or now, speaks against it, and for the rest the motion decides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from association.evidence import constants
from association.evidence.landmarks import missing
from association.evidence.pairings import given, prune, settled
from association.expectation import Expectation, gate_threshold
from association.geometry.pair_poses import candidates
from association.jcbb import search
from data import se2
from data.inputs import Increment, IntArray
from data.result import NEW
from data.se2 import Array
from data.sensors import Sensor


class Memory(NamedTuple):
    """What the frames before tell.

    seen_from: poses (3,) from which the map was seen; rate: (n,) with which each candidate is seen where it is well in
    view; strays: share of what is seen, where the map was seen before, that is no landmark of it.
    """

    seen_from: Sequence[Array]
    rate: Array
    strays: float


class Placed(NamedTuple):
    """A frame with its pose found.

    pose: (3,) in the world; expectation: linearized there; believed: the same once the pairings are believed;
    decisions: (m,) as of `association.evidence.pairings`; sudden: how many of the unpaired should have been seen
    before;
    score: log-likelihood, see `place`.
    """

    pose: Array
    expectation: Expectation
    believed: Expectation
    decisions: IntArray
    sudden: int
    score: float


def drifted(covariance: Array, increment: Increment) -> Array:
    """Covariance (3, 3) of a motion, in the body frame that it is expected to end in, after one more increment."""
    (x, y, turn), M = increment
    B = se2.world_from_body(-float(turn))
    F = B @ np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    P: Array = F @ covariance @ F.T + B @ M @ B.T
    return 0.5 * (P + P.T)


def too_uncertain(e: Expectation, sensor: Sensor, motion: Array) -> bool:
    """Whether what one linearization leaves out exceeds the noise of most observations.

    A point p seen after an unexpected motion (d, a) stands at R(-a) (p - d); the second-order terms |p| a^2 / 2 and
    |d| |a| have root mean squares of sqrt(3) / 2 |p| sigma_a^2 and at most sigma_d sigma_a. `motion` (3, 3): see
    `drifted`.
    """
    if not len(e.z):
        return False
    xy, R = sensor.body_points(e.z, e.R)
    turn, shift = motion[2, 2], math.sqrt(motion[0, 0] + motion[1, 1])
    left_out = 0.5 * math.sqrt(3.0) * turn * np.hypot(*xy.T) + shift * math.sqrt(turn)
    return bool(np.median(left_out - np.maximum(np.linalg.det(R), 0.0) ** 0.25) > 0.0)


def place(
    e: Expectation,
    sensor: Sensor,
    predicted: Array,
    motion: Array,
    memory: Memory,
    gate: float | None,
    new_gate: float | None,
) -> Placed | None:
    """The pose at which a frame is to be decided about, with its decisions; None if the map does not give one.

    The score of a pose is -d^2 / 2 of the motion to it, and the logarithms of the probabilities that landmarks which
    should have been seen were missed, and that unpaired observations which should have been seen before are strays.
    Pairings must hold, jointly and each given the others; their number and how well they fit are worth nothing more:
    where a world repeats itself that is luck.

    Args:
        e: expectation at the predicted pose, with `elsewhere`.
        sensor: of the observations.
        predicted: (3,) pose in the world.
        motion: (3, 3) its covariance relative to what is mapped, in the predicted body frame.
        memory: of the frames before.
        gate: chi-square probability of a pairing given the others of its frame.
        new_gate: the one outside which an unpaired observation is a new landmark.
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
    decisions = settled(best.expectation, prune(best.expectation, best.decisions, gate), new_gate)
    return best._replace(decisions=decisions)


def _near(e: Expectation, sensor: Sensor, motion: Array) -> IntArray:
    """Candidates (k,) no farther away than what is seen farthest, however the robot moved."""
    seen, there = sensor.polar(e.z)[:, 0], sensor.inverse(np.zeros(3), e.z_hat)[0]
    lever = math.hypot(*sensor.translation)
    reach = float(seen.max(initial=0.0)) + lever + constants.REACH_SIGMAS * math.sqrt(motion[0, 0] + motion[1, 1])
    near: IntArray = np.flatnonzero(np.hypot(*there.T) < reach)
    return near


def _verified(
    e: Expectation,
    sensor: Sensor,
    predicted: Array,
    motion: Array,
    choice: IntArray,
    memory: Memory,
    gate: float | None,
) -> Placed | None:
    """The place that a pairing (m,) leads to, its decisions those of all pairings; None if they do not hold."""
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
        decisions = _clear(given(here, prune(here, decisions, gate), every), decisions, gate)
        decisions = prune(here, _more(given(here, decisions, every), decisions, gate), gate)
    rows, chosen = e.paired(decisions)
    if len(rows) < constants.PLACE_PAIRINGS:
        return None
    nis, dof, _ = here.innovation_statistics(rows, chosen)
    if nis >= gate_threshold(gate, dof):
        return None
    believed = given(here, decisions, every)
    absent = missing(believed, decisions, sensor)
    stray = decisions == NEW
    sudden = _in_view_before(sensor, pose, xy[stray], R[stray], memory.seen_from)
    off = se2.between(predicted, pose)
    score = -0.5 * float(off @ np.linalg.solve(motion, off))
    score += float(np.log1p(-memory.rate[absent]).sum()) + sudden * math.log(memory.strays)
    return Placed(pose, here, believed, decisions, sudden, score)


def _clear(believed: Expectation, decisions: IntArray, gate: float | None) -> IntArray:
    """Those pairings of which neither side has another one in the gate, given all; all of them if these are few."""
    near = believed.individual_distances() < gate_threshold(gate)
    rows, chosen = believed.paired(decisions)
    clear = (near[rows].sum(axis=1) == 1) & (near[:, chosen].sum(axis=0) == 1) & near[rows, chosen]
    if clear.sum() < constants.PLACE_PAIRINGS:
        return decisions
    left = np.full(len(decisions), NEW, np.int64)
    left[rows[clear]] = decisions[rows[clear]]
    return left


def _more(believed: Expectation, decisions: IntArray, gate: float | None) -> IntArray:
    """Pairings of what is left, by joint compatibility given those made."""
    left = np.flatnonzero(decisions == NEW)
    free = np.flatnonzero(~np.isin(believed.number, decisions))
    if not len(left) or not len(free):
        return decisions
    rest = replace(
        believed.only(free), z=believed.z[left], R=believed.R[left], observed_frame=believed.observed_frame[left]
    )
    more = decisions.copy()
    more[left] = search(rest, gate).decisions
    return more


def _in_view_before(sensor: Sensor, pose: Array, xy: Array, R: Array, seen_from: Sequence[Array]) -> int:
    """How many points (k, 2) seen from a pose (3,) had been well in view before, by 3 sigma."""
    world = se2.transform_points(pose, xy)
    sigma = constants.REACH_SIGMAS * np.sqrt(np.trace(R, axis1=1, axis2=2))
    before = np.zeros(len(xy), np.bool_)
    for past in seen_from:
        z = sensor.predict(past, world)
        angle = sigma / np.maximum(sensor.polar(z)[:, 0], sigma)
        before |= sensor.in_view(z, margin_range=-sigma, margin_angle=-angle)
    return int(before.sum())
