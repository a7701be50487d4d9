"""Evidence for a landmark: detections, missed detections, and whether it stood still.

An observation gives the landmark's innovation given its frame's other pairings (`association.conditional.alone`). For a
static landmark these are independent, with chi-square squares and weighted mean zero in the world. A moving landmark
drags its estimate along, so its innovations point in the direction of motion.

Persistent or transient? Each landmark has a sequence of detection opportunities, detected or missed. Detections of a
persistent landmark form a Markov chain, with rates of its own around common ones (beta distributions). A transient
landmark vanishes right after its first observation (clutter) or before each later opportunity (people); afterwards it
is detected by chance only. Shares and rates are fitted to all landmarks of the log by expectation maximization. Misses
at the end of a sequence do not count for the rates: the landmark may have vanished.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import exp, lgamma, log
from typing import NamedTuple

import numpy as np
from numba import njit

from association.candidates import polar_sigma
from association.conditional import ConditionalInnovations
from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import Sensor
from eval.replay.hindsight import constants


class Evidence(NamedTuple):
    """Evidence for and against one landmark."""

    seen: int  # observations, `opportunities` of them from different places
    opportunities: int
    missed: int  # missed detections from different places, `row` of them since the last observation
    row: int
    judged: int  # observations judged by others of their frame
    squares: float  # sum of their squared innovations
    pull: Array  # (2,) weighted sum of their innovations in the world
    information: Array  # (2, 2) sum of their information


INITIALIZED = Evidence(1, 1, 0, 0, 0, 0.0, np.zeros(2), np.zeros((2, 2)))  # of a landmark that was initialized just now


class Judgement(NamedTuple):
    """Innovation (2,) of an observation given others of its frame, its information (2, 2); G (2, 2): to the world."""

    innovation: Array
    information: Array
    G: Array


def add_observation(e: Evidence, judged: Judgement | None, elsewhere: bool) -> Evidence:
    """Add an observation and what the others of its frame say of it; `elsewhere`: from another place than the last."""
    e = e._replace(seen=e.seen + 1, opportunities=e.opportunities + elsewhere, row=0)
    if judged is None:
        return e
    inverse = np.linalg.inv(judged.G)
    world = inverse.T @ judged.information @ inverse
    return e._replace(
        judged=e.judged + 1,
        squares=e.squares + float(judged.innovation @ judged.information @ judged.innovation),
        pull=e.pull + world @ (judged.G @ judged.innovation),
        information=e.information + world,
    )


def add_miss(e: Evidence) -> Evidence:
    """Add a missed detection."""
    return e._replace(missed=e.missed + 1, row=e.row + 1)


class Visibility(NamedTuple):
    """Counts over confirmed landmarks in view: detected and missed, after a detection and after a miss.

    Occlusions last, so misses come in rows.
    """

    seen_seen: int = 0
    seen_missed: int = 0
    missed_seen: int = 0
    missed_missed: int = 0

    def counting(self, before_missed: bool, seen: bool) -> Visibility:
        """Add one detection opportunity."""
        name = ("missed_" if before_missed else "seen_") + ("seen" if seen else "missed")
        return self._replace(**{name: getattr(self, name) + 1})

    def without(self, row: int) -> Visibility:
        """Leave out an unfinished row of misses: a landmark must not testify for itself."""
        if not row:
            return self
        return self._replace(
            seen_missed=max(0, self.seen_missed - 1), missed_missed=max(0, self.missed_missed - (row - 1))
        )

    @property
    def rate(self) -> float:
        """Detection probability of a landmark in view."""
        return detection_rate(self.seen_seen + self.missed_seen, self.seen_missed + self.missed_missed)

    def row(self, length: int, rate: float) -> float:
        """Probability (Markov chain) that an existing landmark of this detection probability is missed `length` times
        in a row.

        Before enough rows are known, misses count as independent.
        """
        if not length:
            return 1.0
        prior, missed = constants.INDEPENDENT_MISSES, self.missed_missed
        again = (missed + prior * (1.0 - rate)) / (missed + self.missed_seen + prior)
        return (1.0 - rate) * max(again, 1.0 - rate) ** (length - 1)


def detection_rate(seen: int, missed: int) -> float:
    """Mean of the beta distribution of a rate, from a uniform prior."""
    return (seen + 1) / (seen + missed + 2)


def confirmed(e: Evidence, v: Visibility) -> bool:
    """Whether a landmark has as many observations as `CONFIRMED` detection opportunities would give, and at
    least two.
    """
    return e.seen >= max(constants.CONFIRMED_AT_LEAST, constants.CONFIRMED * v.rate)


def verdict(e: Evidence, v: Visibility) -> str:
    """Why a landmark is to be retracted, `moved` or `missed`; or empty.

    A confirmed landmark has its own detection probability, if that is lower, and needs more evidence against it.
    """
    if e.judged:
        drift = float(e.pull @ np.linalg.solve(e.information, e.pull))
        if drift > gate_threshold(constants.MOVED) or e.squares > gate_threshold(constants.RESTLESS, 2 * e.judged):
            return "moved"
    if confirmed(e, v):
        v = v.without(e.row)
        own = min(v.rate, detection_rate(e.opportunities, e.missed - e.row))
        return "missed" if v.row(e.row, own) < constants.UNLIKELY**constants.UNLIKELY_POWER else ""
    return "missed" if v.row(e.row, v.rate) < constants.UNLIKELY else ""


def missing(e: Expectation, decisions: IntArray, sensor: Sensor) -> BoolArray:
    """Candidates (n,) with a missed detection: in the field of view by `IN_VIEW_SIGMAS`, not occluded, not paired."""
    expected, seen = sensor.polar(e.z_hat), sensor.polar(e.z)
    sigma = constants.IN_VIEW_SIGMAS * polar_sigma(sensor, e.z_hat, e.HPHt)
    inside = sensor.in_view(e.z_hat, margin_range=-sigma[:, 0], margin_angle=-sigma[:, 1])
    before = np.abs(wrap_angle(seen[None, :, 1] - expected[:, None, 1])) < constants.SHADOW
    hidden = (before & (seen[None, :, 0] < expected[:, None, 0])).any(axis=1)
    absent: BoolArray = inside & ~hidden & ~np.isin(e.number, decisions)
    return absent


@dataclass
class Record:
    """One landmark of the map, except its position."""

    observations: list[tuple[int, int]]  # (observation, decision) of all assigned to it; the first one initialized it
    place: tuple[float, float]  # (x, y) [m] of the robot at its last detection opportunity
    first: float  # distances travelled [m] at its first and its last observation
    last: float
    times: int = 0  # observations, by the decisions that were used
    evidence: Evidence = INITIALIZED
    covisible: set[int] = field(default_factory=set)  # landmarks seen in one frame with it: they cannot be the same
    # distance travelled [m] at the last judgement of its gate, by result
    gated: dict[bool, float] = field(default_factory=dict)
    opportunities: bytearray = field(default_factory=bytearray)  # after the first observation; 1 detected, 0 missed


class Judged(NamedTuple):
    """Judgement of a frame's pairings by its expectation, before the update changes the state.

    rows (k,) of the paired observations, the landmarks' numbers (k,), their innovations given each other; missed
    landmarks (n,), and those of them where something was observed before.
    """

    rows: IntArray
    number: IntArray
    alone: ConditionalInnovations
    missing: IntArray
    in_read: IntArray


class Epoch(NamedTuple):
    """Since when landmarks are ambiguous to the robot: distance travelled [m], number of the next landmark."""

    begun: float = -math.inf
    first: int = 0


Opportunities = Sequence[bytes | bytearray]  # of each landmark, after its first observation: 1 detected, 0 missed


class Persistence(NamedTuple):
    """Common parameters of a log's landmarks.

    persistent: share of persistent landmarks; at_once, later: probabilities that a transient one vanishes before the
    first and before each further opportunity; seen, again: detection probabilities after a detection and after a miss.
    """

    persistent: float
    at_once: float
    later: float
    seen: float
    again: float


def persistence(opportunities: Opportunities) -> Persistence:
    """Fit to the landmarks (n) of a log, retracted ones included; the prior if there are none."""
    fitted = _fitted(
        *_packed(opportunities), np.array([constants.PERSISTENCE_MEANS, constants.PERSISTENCE_WORTH]),
        constants.PERSISTENCE_OWN, constants.PERSISTENCE_CHANCE, constants.PERSISTENCE_LATER_LEAST,
        constants.PERSISTENCE_ROUNDS,
    )  # fmt: skip
    return Persistence(*fitted.tolist())


def persistent(opportunities: Opportunities, p: Persistence) -> Array:
    """Probability (n,) that each landmark is persistent."""
    return _probabilities(*_packed(opportunities), np.array(p), constants.PERSISTENCE_OWN, constants.PERSISTENCE_CHANCE)


def kept_at_end(opportunities: Opportunities, former: Opportunities, observations: IntArray) -> BoolArray:
    """Which landmarks (n,) of a map stay in it at the end of a log.

    These are persistent with probability `PERSISTENT_PROBABILITY`, and have as many observations as all but the fewest
    of them, or `CONFIRMED`. A landmark observed twice among often observed ones is a person who came by at the end. If
    fewer than half of the expected number would stay, the most probable ones are kept.

    `former`: opportunities of retracted landmarks; observations (n,): number of each landmark of the map.
    """
    often = observations >= constants.CONFIRMED_AT_LEAST
    probability = np.where(often, persistent(opportunities, persistence([*opportunities, *former])), 0.0)
    keep: BoolArray = probability > constants.PERSISTENT_PROBABILITY
    if keep.any():
        keep &= observations >= min(
            constants.CONFIRMED, float(np.quantile(observations[keep], constants.PERSISTENT_FEWEST))
        )
    expected = round(float(probability.sum()))
    if 2 * keep.sum() < expected:
        keep = np.zeros(len(probability), np.bool_)
        keep[np.argsort(-probability, kind="stable")[:expected]] = True
    return keep


def _packed(opportunities: Opportunities) -> tuple[IntArray, IntArray]:
    """All opportunities in a row (m,), and where those of each landmark begin (n + 1,)."""
    begin = np.cumsum(np.array([0, *(len(s) for s in opportunities)], np.int64))
    return np.frombuffer(b"".join(opportunities), np.uint8).astype(np.int64), begin


@njit(cache=True)
def _betas(seen: float, missed: float, mean: float, own: float) -> float:
    """Log-likelihood of opportunities whose rate is beta distributed, with this mean and weight `own`."""
    a, b = own * mean, own * (1.0 - mean)
    return lgamma(a + seen) - lgamma(a) + lgamma(b + missed) - lgamma(b) + lgamma(own) - lgamma(own + seen + missed)


@njit(cache=True)
def _transitions(opportunities: IntArray) -> tuple[Array, int]:
    """Counts (2, 2) of opportunities [after a miss or a detection, missed or detected], and number of misses at the
    end.
    """
    counts, before, row = np.zeros((2, 2)), 1, 0
    for now in opportunities:
        counts[before, now] += 1.0
        before, row = now, 0 if now else row + 1
    return counts, row


@njit(cache=True)
def _transient(opportunities: IntArray, p: Array, chance: float, expected: Array) -> float:
    """Log-likelihood of a transient landmark: sum over the opportunities k before which it may have vanished.

    expected (4,), written: vanished at once or not, for a landmark with opportunities; vanished later, and
    opportunities that it lasted.
    """
    at_once, later, seen, n = p[1], p[2], p[3], len(opportunities)
    terms = np.empty(n + 2)
    after = 0.0
    for k in range(n, -1, -1):  # by chance alone from look k on
        terms[k] = after
        if k:
            after += log(chance) if opportunities[k - 1] else log(1.0 - chance)
    terms[n + 1] = terms[0] + log(at_once)
    before = log(1.0 - at_once)
    for k in range(n):
        terms[k] += before + log(later)
        before += log(1.0 - later) + (log(seen) if opportunities[k] else log(1.0 - seen))
    terms[n] = before
    top = terms.max()
    total = top + log(np.exp(terms - top).sum())
    expected[:] = 0.0
    if n:
        expected[0] = exp(terms[n + 1] - total)
        expected[1] = 1.0 - expected[0]
    for k in range(n + 1):
        share = exp(terms[k] - total)
        expected[2] += share if k < n else 0.0
        expected[3] += share * k
    return float(total)


@njit(cache=True)
def _probability(opportunities: IntArray, counts: Array, p: Array, own: float, chance: float, expected: Array) -> float:
    """Probability that a landmark is persistent, given its opportunities and their counts (2, 2); `expected` as of
    `_transient`.
    """
    stay = log(p[0]) + _betas(counts[1, 1], counts[1, 0], p[3], own) + _betas(counts[0, 1], counts[0, 0], p[4], own)
    transient = log(1.0 - p[0]) + _transient(opportunities, p, chance, expected)
    return 1.0 / (1.0 + exp(min(transient - stay, 700.0)))


@njit(cache=True)
def _probabilities(opportunities: IntArray, begin: IntArray, p: Array, own: float, chance: float) -> Array:
    probability, expected = np.empty(len(begin) - 1), np.empty(4)
    for i in range(len(probability)):
        of = opportunities[begin[i] : begin[i + 1]]
        probability[i] = _probability(of, _transitions(of)[0], p, own, chance, expected)
    return probability


@njit(cache=True)
def _fitted(
    opportunities: IntArray, begin: IntArray, prior: Array, own: float, chance: float, least: float, rounds: int
) -> Array:
    """`Persistence` as an array (5,); prior (2, 5): mean and weight of each."""
    p: Array = prior[0].copy()
    expected = np.empty(4)
    for _ in range(rounds):
        yes, every = prior[0] * prior[1], prior[1].copy()
        for i in range(len(begin) - 1):
            of = opportunities[begin[i] : begin[i + 1]]
            counts, row = _transitions(of)
            q = _probability(of, counts, p, own, chance, expected)
            t = 1.0 - q  # transient
            if row:
                counts[1, 0] -= 1.0
                counts[0, 0] -= row - 1.0
            yes += np.array([q, t * expected[0], t * expected[2], q * counts[1, 1], q * counts[0, 1]])
            every[0] += 1.0
            every[1] += t * (expected[0] + expected[1])
            every[2] += t * (expected[2] + expected[3])
            every[3] += q * counts[1].sum()
            every[4] += q * counts[0].sum()
        p = yes / every
        p[2] = max(p[2], least)
    return p
