"""Steps 3 and 4 of SLAM: pair a frame, and postpone what only the stated noise explains.

Stated noise is often several times too large, so that a new landmark lies inside the gate of its neighbour.
`LearnedGates` learns two variance scales, one for the sensor and one for map and motion: a landmark seen in every frame
informs about the sensor only.

An observation outside a landmark's usual spread but inside the stated gate is a new landmark next to it, or the
landmark itself after a slip (`Tentative`). Later observations decide: after a slip no landmark is where it is expected;
next to a new landmark the others are.

A frame is paired by joint compatibility (`pair`); a single observation never chooses among dense landmarks.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from association.conditional import ConditionalDecisions, jcbb_conditional, unless_close
from association.expectation import Expectation, gate_threshold
from data.compiled import njit
from data.inputs import IntArray
from data.result import DISCARD, NEW
from data.se2 import Array, BoolArray
from data.sensors import RANGE_BEARING
from ekf.slam import EkfSlam
from eval.replay.hindsight import constants
from eval.replay.hindsight.ledger import Epoch, Ledger
from eval.replay.hindsight.noise import NoiseScale
from eval.replay.settings import Setup


class Scales(NamedTuple):
    """Learned variance scales of the sensor, and of map and motion."""

    sensor: NoiseScale
    motion: NoiseScale
    log_tails: float = 0.0  # logarithm of a factor on variances for tails beyond Student's
    observations: float = 0.0  # number from which it was learned


def as_stated() -> Scales:
    """The scales before anything is learned."""
    stated = NoiseScale(1.0, constants.SCALES_PRIOR)
    return Scales(stated, stated)


def widest(scales: Scales) -> float:
    """Variance scale of all gates: the larger of both, at most 1."""
    return min(1.0, _core(scales) * math.exp(scales.log_tails))


def _core(scales: Scales) -> float:
    return min(1.0, constants.TAILS * max(scales.sensor.scale, scales.motion.scale))


def counted(scales: Scales, inside: int, outside: int) -> Scales:
    """After observations inside and outside the gate that are not new: move the gate to its target false-rejection
    rate (Robbins and Monro, Annals of Mathematical Statistics 22, 1951).
    """
    observations = max(scales.observations + inside + outside, 1.0)
    step = max(min(constants.TAILS_STEP, constants.TAILS_HORIZON / observations), constants.TAILS_SLOWEST)
    too_narrow = outside * (1.0 - constants.FALSE_REJECTION) - inside * constants.FALSE_REJECTION
    log = min(max(0.0, scales.log_tails + step * too_narrow), -math.log(_core(scales)))
    return scales._replace(log_tails=log, observations=observations)


def relearned(scales: Scales, e: Expectation, decisions: IntArray) -> Scales:
    """After the pairings of a frame, under the stated expectation.

    Variance components: each innovation informs about a scale by the square of its share in the covariance, as the
    Fisher information does; Student's weights as in `eval.replay.hindsight.noise`.
    """
    rows, chosen = e.paired(decisions)
    if not len(rows):
        return scales
    parts = scales.sensor.scale * e.R[rows], scales.motion.scale * e.HPHt[chosen]
    nu = e.residual(e.z[rows], e.z_hat[chosen])
    tails = constants.FREEDOM, constants.LEAST_SHARE
    sensor, motion = (_toward(s, *_excess(nu, part, *parts, *tails)) for s, part in zip(scales[:2], parts, strict=True))
    return scales._replace(sensor=sensor, motion=motion)


def _toward(before: NoiseScale, total: float, excess: float) -> NoiseScale:
    """Update one scale by the sums of `_excess`."""
    memory = min(before.weight + total, max(constants.NOISE_MEMORY, total))
    return NoiseScale(max(before.scale * (1.0 + excess / memory), constants.LEAST_SCALE), memory)


@njit
def _excess(nu: Array, part: Array, one: Array, other: Array, freedom: float, least: float) -> tuple[float, float]:
    """Sums of squared shares of a part (k, 2, 2) in the innovations' covariances, alone and times what each says."""
    total, excess = 0.0, 0.0
    for i in range(len(nu)):
        x, y, xx, xy, yy = nu[i, 0], nu[i, 1], part[i, 0, 0], part[i, 0, 1], part[i, 1, 1]
        a, b = one[i, 0, 0] + other[i, 0, 0], one[i, 0, 1] + other[i, 0, 1]
        c = one[i, 1, 1] + other[i, 1, 1]
        det = a * c - b * b
        u, v = (c * x - b * y) / det, (a * y - b * x) / det
        weight = (freedom + 2.0) / (freedom + x * u + y * v)
        share = 0.5 * (c * xx - 2.0 * b * xy + a * yy) / det
        ratio = 0.5 * weight * (u * u * xx + 2.0 * u * v * xy + v * v * yy) / max(share, least)
        total, excess = total + share * share, excess + share * share * (ratio - 1.0)
    return total, excess


class TentativeObservation(NamedTuple):
    """Place (2,) [m] in the world, its covariance (2, 2) from the sensor alone, distance travelled [m] until then."""

    xy: Array
    covariance: Array
    travelled: float

    def distance(self, other: "TentativeObservation") -> float:
        """Squared Mahalanobis distance to another one."""
        (x, y), ((a, b), (_, c)) = (self.xy - other.xy).tolist(), (self.covariance + other.covariance).tolist()
        return float((c * x * x - 2.0 * b * x * y + a * y * y) / (a * c - b * b))


@dataclass(eq=False)
class _Place:
    """The latest observation, their number, and the pairings of the run before the first."""

    last: TentativeObservation
    times: int
    pairings: int


class Tentative:
    """Places of possible new landmarks."""

    def __init__(self) -> None:
        self._places: list[_Place] = []
        self._suspects: list[TentativeObservation] = []

    def see(self, observation: TentativeObservation, pairings: int, reach: float) -> bool:
        """Add a postponed observation; returns whether it is a new landmark by now.

        `pairings` of the run so far: a pairing between the first observation and this one confirms the pose. A place is
        forgotten `reach` [m] after its last observation.
        """
        self._places = [p for p in self._places if observation.travelled - p.last.travelled <= reach]
        self._suspects = [d for d in self._suspects if observation.travelled - d.travelled <= reach]
        near = min(self._places, key=lambda p: p.last.distance(observation), default=None)
        if near is None or near.last.distance(observation) >= gate_threshold(constants.SAME_GATE):
            self._places.append(_Place(observation, 1, pairings))
            return False
        near.last, near.times = observation, near.times + 1
        if near.times < constants.AGREE or pairings <= near.pairings:
            return False
        self._places.remove(near)
        return True

    def suspect(self, observation: TentativeObservation) -> None:
        """Note an observation that was counted as rejected by a landmark's gate."""
        self._suspects.append(observation)

    def settle(self, observation: TentativeObservation) -> int:
        """A landmark was initialized there: forget its suspects and return their number."""
        own = [d for d in self._suspects if d.distance(observation) < gate_threshold(constants.SAME_GATE)]
        self._suspects = [d for d in self._suspects if not any(d is o for o in own)]
        return len(own)


class LearnedGates:
    """The widths of the gates in this log."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger = ledger
        self.scales = as_stated()
        self._tentative = Tentative()
        self._pairings = 0

    def learn(self, e: Expectation, decisions: IntArray) -> None:
        """Learn from the innovations of a frame's pairings."""
        self.scales = relearned(self.scales, e, decisions)

    def put_off(self, e: Expectation, found: ConditionalDecisions, pose: Array, new_gate: float | None) -> IntArray:
        """Decisions (m,) with `DISCARD` for what may be a landmark under the stated noise, until several agree.

        e is under the stated noise, decisions are under the learned noise; pose (3,) of the robot. An observation
        outside `new_gate` under the stated noise is new at once.
        """
        ledger, sensor, reach = self.ledger, self.ledger.sensor, self.ledger.range
        close, nearest = found.given < e.threshold(new_gate), e.individual_distances()
        stated = unless_close(found.decisions, close)
        waiting = (found.decisions == NEW) & (stated != NEW)
        if widest(self.scales) == 1.0:  # under smaller noise three observations agree too easily
            # discarded for landmarks alone that the frame observed elsewhere: there are two, or it is clutter
            free = (e.number[:, None] != stated).all(axis=1)
            waiting |= (stated == DISCARD) & close.any(axis=1) & ~close[:, free].any(axis=1)
        paired = stated[stated >= 0].tolist()
        self._pairings += len(paired)
        inside, outside = sum(ledger.gated_elsewhere(n, True) for n in paired), 0
        left = np.flatnonzero(stated < 0)
        xy, _, G = sensor.inverse(pose, e.z[left])
        covariances = G @ e.R[left] @ G.transpose(0, 2, 1)
        for q, i in enumerate(left.tolist()):
            observation = TentativeObservation(xy[q], covariances[q], ledger.travelled)
            if waiting[i] and self._tentative.see(observation, self._pairings, reach):
                stated[i] = NEW
            if stated[i] == NEW:
                outside -= self._tentative.settle(observation)  # suspects there are not of the landmark next to it
            elif ledger.gated_elsewhere(int(e.number[np.argmin(nearest[i])]), False):
                self._tentative.suspect(observation)
                outside += 1
        self.scales = counted(self.scales, inside, outside)
        return stated


class Paired(NamedTuple):
    """Decisions among candidates, and the epoch after them."""

    among: Expectation
    found: ConditionalDecisions
    epoch: Epoch


def pair(e: Expectation, slam: EkfSlam, ledger: Ledger, scales: Scales, setup: Setup) -> Paired:
    """Joint compatibility; an ambiguous pairing counts only if its frame as a whole supports it. e: landmarks in view
    under the stated noise. After an ambiguous frame the epoch may not be the ledger's.
    """
    share, epoch = widest(scales), ledger.epoch
    found = jcbb_conditional(e, setup.gate, setup.new_gate, share=share)
    if not len(e.number) or not len(e.z) or not (unclear := dense(e, slam, ledger, setup)).any():
        return Paired(e, found, epoch)
    # unambiguous landmarks were seen on the way here, so they do not tell where in the old map the robot is
    if np.isin(found.decisions, e.number[unclear]).sum() >= constants.TOGETHER:
        return Paired(e, found, epoch)
    if ledger.travelled - epoch.begun > constants.WINDOW_SPAN * ledger.range:
        epoch = Epoch(ledger.travelled, ledger.created)
    few = e.only(clear(e, unclear, epoch))
    return Paired(few, jcbb_conditional(few, setup.gate, setup.new_gate, share=share), epoch)


def clear(e: Expectation, dense: BoolArray, epoch: Epoch) -> IntArray:
    """Candidates (k,) that a single observation may choose: unambiguous ones, and those initialized in this epoch."""
    return np.flatnonzero(~dense | (e.number >= epoch.first)).astype(np.int64)


def dense(e: Expectation, slam: EkfSlam, ledger: Ledger, setup: Setup) -> BoolArray:
    """Candidates (n,) with so many landmarks in their gate by chance that a single observation is ambiguous."""
    sensor, threshold = slam.sensor, gate_threshold(setup.gate or constants.DENSE_GATE)
    area = np.sqrt(np.linalg.det(e.HPHt)) * (sensor.polar(e.z_hat)[:, 0] if sensor.kind == RANGE_BEARING else 1.0)
    return np.asarray(density(slam, ledger.range) * math.pi * threshold * area > constants.DENSE)


def density(slam: EkfSlam, reach: float) -> float:
    """Landmarks per square metre around the robot, within the sensor's reach [m]."""
    near = np.hypot(*(slam.xy - slam.mean[:2]).T) < reach
    return max(1, int(near.sum())) / (math.pi * reach**2) if reach > 0.0 else 0.0
