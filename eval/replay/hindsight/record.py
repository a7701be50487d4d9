"""Evidence for a landmark: how often it was seen, how often it should have been, and whether it stood still.

An observation gives the landmark's innovation given its frame's other pairings (`association.conditional.alone`).
Of a landmark that stands still these are independent, their squares chi-square and their weighted mean in the world
zero; one that moves drags its estimate behind it, so that they all point where it goes.

Which landmarks of a log are there for good, and which for a while (clutter, people, what a bent map has twice)? Every
landmark that was initialized is a row of looks: places from which it should have been seen, and was or was not. One
kind stays: it is seen and missed as a Markov chain has it, each landmark with rates of its own around the common ones
(beta distributions). The other kind goes: at once after the reading that it was initialized by (clutter), or at each
later look (people); from then on it is read by chance only. Which shares the kinds have, how soon the second one goes
and how often the first one is seen is fitted to all landmarks of the log together, by expectation maximization. What is
missed at the end of a row of looks does not tell how often landmarks are missed: they may be gone.
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
from association.conditional import Alone
from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import Sensor
from eval.replay.hindsight import constants


class Evidence(NamedTuple):
    """What speaks for one landmark and against it.

    seen: observations, `opportunities` of them from different places; missed: places of a missed detection,
    `row` of them since the last observation;
    judged: observations judged by others of their frame; squares: the sum of these squared; pull (2,),
    information (2, 2): these in the world, weighted, summed.
    """

    seen: int
    opportunities: int
    missed: int
    row: int
    judged: int
    squares: float
    pull: Array
    information: Array


INITIALIZED = Evidence(1, 1, 0, 0, 0, 0.0, np.zeros(2), np.zeros((2, 2)))
"""Of a landmark that was initialized just now."""


class Judgement(NamedTuple):
    """Innovation (2,) of an observation given others of its frame, its information (2, 2); G (2, 2): to the world."""

    innovation: Array
    information: Array
    G: Array


def sighted(e: Evidence, judged: Judgement | None, elsewhere: bool) -> Evidence:
    """Add an observation, judged by the others of its frame; `elsewhere`: from another place than the last."""
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


def overlooked(e: Evidence) -> Evidence:
    """It should have been seen, and was not."""
    return e._replace(missed=e.missed + 1, row=e.row + 1)


class Visibility(NamedTuple):
    """Counts over confirmed landmarks in view: seen and missed after an observation, and after a miss.

    A landmark that is hidden from here stays hidden for a while, so misses come in rows; where a sensor sees all there
    is in view, a second miss in a row is as unlikely as the first.
    """

    seen_seen: int = 0
    seen_missed: int = 0
    missed_seen: int = 0
    missed_missed: int = 0

    def counting(self, before_missed: bool, seen: bool) -> Visibility:
        """With one more landmark in view."""
        name = ("missed_" if before_missed else "seen_") + ("seen" if seen else "missed")
        return self._replace(**{name: getattr(self, name) + 1})

    def without(self, row: int) -> Visibility:
        """Without a row of misses that is not over: a landmark must not testify for itself."""
        if not row:
            return self
        return self._replace(
            seen_missed=max(0, self.seen_missed - 1), missed_missed=max(0, self.missed_missed - (row - 1))
        )

    @property
    def rate(self) -> float:
        """With which a landmark in view is seen."""
        return detection_rate(self.seen_seen + self.missed_seen, self.seen_missed + self.missed_missed)

    def row(self, length: int, rate: float) -> float:
        """Probability that a landmark which is there is missed so often in a row; `rate`: with which it is seen.

        A Markov chain; before much is known of rows, misses are taken for independent.
        """
        if not length:
            return 1.0
        prior, missed = constants.INDEPENDENT_MISSES, self.missed_missed
        again = (missed + prior * (1.0 - rate)) / (missed + self.missed_seen + prior)
        return (1.0 - rate) * max(again, 1.0 - rate) ** (length - 1)


def detection_rate(seen: int, missed: int) -> float:
    """Mean of the beta distribution of a rate after so many observations and misses, from a uniform prior."""
    return (seen + 1) / (seen + missed + 2)


def certain(e: Evidence, v: Visibility) -> bool:
    """Whether a landmark was seen as often as `CONFIRMED` times in view would give, and at least twice."""
    return e.seen >= max(constants.CONFIRMED_AT_LEAST, constants.CONFIRMED * v.rate)


def verdict(e: Evidence, v: Visibility) -> str:
    """Why a landmark is to be retracted, `moved` or `missed`; empty: it stays.

    A certain landmark has its own rate of detection, if that is lower, and there must be more against it.
    """
    if e.judged:
        drift = float(e.pull @ np.linalg.solve(e.information, e.pull))
        if drift > gate_threshold(constants.MOVED) or e.squares > gate_threshold(constants.RESTLESS, 2 * e.judged):
            return "moved"
    if certain(e, v):
        v = v.without(e.row)
        own = min(v.rate, detection_rate(e.opportunities, e.missed - e.row))
        return "missed" if v.row(e.row, own) < constants.UNLIKELY**constants.UNLIKELY_POWER else ""
    return "missed" if v.row(e.row, v.rate) < constants.UNLIKELY else ""


def missing(e: Expectation, decisions: IntArray, sensor: Sensor) -> BoolArray:
    """Candidates (n,) that should have been seen in a frame and were not paired.

    They stand in the field of view by `IN_VIEW_SIGMAS`, and nothing that was seen stands before them.
    """
    expected, seen = sensor.polar(e.z_hat), sensor.polar(e.z)
    sigma = constants.IN_VIEW_SIGMAS * polar_sigma(sensor, e.z_hat, e.HPHt)
    inside = sensor.in_view(e.z_hat, margin_range=-sigma[:, 0], margin_angle=-sigma[:, 1])
    before = np.abs(wrap_angle(seen[None, :, 1] - expected[:, None, 1])) < constants.SHADOW
    hidden = (before & (seen[None, :, 0] < expected[:, None, 0])).any(axis=1)
    absent: BoolArray = inside & ~hidden & ~np.isin(e.number, decisions)
    return absent


@dataclass
class Record:
    """What is known of one landmark of the map, but for where it stands.

    Attributes:
        observations: (observation, decision) of all that are taken for it; the first one initialized it.
        looked_from: (x, y) [m] of the robot where it was last seen, or should have been.
        first, last: distances travelled [m] at its first and its last observation.
        times: observations, by the decisions that were used.
        evidence: what speaks for it and against it.
        covisible: landmarks that were seen in one frame with it: they cannot be the same.
        gated: distance travelled [m] where its gate was judged last, by whether the observation was inside.
        opportunities: detection opportunities after the first observation; 1 seen, 0 missed.
    """

    observations: list[tuple[int, int]]
    looked_from: tuple[float, float]
    first: float
    last: float
    times: int = 0
    evidence: Evidence = INITIALIZED
    covisible: set[int] = field(default_factory=set)
    gated: dict[bool, float] = field(default_factory=dict)
    opportunities: bytearray = field(default_factory=bytearray)


class Judged(NamedTuple):
    """What a frame's expectation says about its pairings, to be taken before the update, which it does not survive.

    rows (k,) of the paired observations, the landmarks' numbers (k,), their innovations given each other; the landmarks
    (n,) that should have been seen and were not, and those of them where something was read before.
    """

    rows: IntArray
    number: IntArray
    alone: Alone
    missing: IntArray
    in_read: IntArray


class Epoch(NamedTuple):
    """Since when the robot cannot tell which landmark is which: distance travelled [m], number of the next landmark."""

    begun: float = -math.inf
    first: int = 0


Opportunities = Sequence[bytes | bytearray]
"""Of each landmark, after the reading that it was initialized by: 1 seen, 0 missed, in their order."""


class Persistence(NamedTuple):
    """What a log's landmarks are like.

    stays: share of those that are there for good; at_once, later: probability that one of the others is gone at the
    first look, and that it goes before each further one; seen, again: probability that what is there is seen at a look
    after it was seen, and after it was missed.
    """

    stays: float
    at_once: float
    later: float
    seen: float
    again: float


def persistence(opportunities: Opportunities) -> Persistence:
    """Of the landmarks (n) of a log, those that were retracted included; without any it is the prior."""
    own, chance, least = constants.PERSISTENCE_OWN, constants.PERSISTENCE_CHANCE, constants.PERSISTENCE_LATER_LEAST
    prior = np.array([constants.PERSISTENCE_MEANS, constants.PERSISTENCE_WORTH])
    return Persistence(
        *_fitted(*_packed(opportunities), prior, own, chance, least, constants.PERSISTENCE_ROUNDS).tolist()
    )


def persistent(opportunities: Opportunities, p: Persistence) -> Array:
    """Probability (n,) that each of n landmarks is there for good."""
    return _staying(*_packed(opportunities), np.array(p), constants.PERSISTENCE_OWN, constants.PERSISTENCE_CHANCE)


def lasting(opportunities: Opportunities, former: Opportunities, observations: IntArray) -> BoolArray:
    """Which landmarks (n,) of a map stay in it at the end of a log.

    Those that stay by odds of two to one (`PERSISTENT_PROBABILITY`). Where most of these are read often, one that was read two or three
    times is somebody who came along in the end: it needs as many observations as all but the fewest of them have, or
    `CONFIRMED`. Where that leaves less than half of those that may be expected to stay, their number is better known than
    which they are: then it is as many, the likeliest.

    Args:
        opportunities: at each of the map's landmarks (n).
        former: at the landmarks that were retracted before.
        observations: (n,) of each of the map's.
    """
    often = observations >= constants.CONFIRMED_AT_LEAST
    stay = np.where(often, persistent(opportunities, persistence([*opportunities, *former])), 0.0)
    keep: BoolArray = stay > constants.PERSISTENT_PROBABILITY
    if keep.any():
        keep &= observations >= min(
            constants.CONFIRMED, float(np.quantile(observations[keep], constants.PERSISTENT_FEWEST))
        )
    expected = round(float(stay.sum()))
    if 2 * keep.sum() < expected:
        keep = np.zeros(len(stay), np.bool_)
        keep[np.argsort(-stay, kind="stable")[:expected]] = True
    return keep


def _packed(opportunities: Opportunities) -> tuple[IntArray, IntArray]:
    """All looks in a row (m,), and where those of each landmark begin (n + 1,)."""
    begin = np.cumsum(np.array([0, *(len(s) for s in opportunities)], np.int64))
    return np.frombuffer(b"".join(opportunities), np.uint8).astype(np.int64), begin


@njit(cache=True)
def _betas(seen: float, missed: float, mean: float, own: float) -> float:
    """Log-likelihood of looks whose rate is beta distributed: mean, and as many looks `own` as the mean is worth."""
    a, b = own * mean, own * (1.0 - mean)
    return lgamma(a + seen) - lgamma(a) + lgamma(b + missed) - lgamma(b) + lgamma(own) - lgamma(own + seen + missed)


@njit(cache=True)
def _transitions(opportunities: IntArray) -> tuple[Array, int]:
    """Counts (2, 2) of looks [after a miss or an observation, missed or seen], and how many misses are at the end."""
    counts, before, row = np.zeros((2, 2)), 1, 0
    for now in opportunities:
        counts[before, now] += 1.0
        before, row = now, 0 if now else row + 1
    return counts, row


@njit(cache=True)
def _goes(opportunities: IntArray, p: Array, chance: float, expected: Array) -> float:
    """Log-likelihood of the looks at a landmark that goes: the sum over the looks k before which it may have gone.

    expected (4,), written: gone at once or not, for a landmark that was looked at; gone at a later look, and looks that
    it lasted.
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
def _stays(opportunities: IntArray, counts: Array, p: Array, own: float, chance: float, expected: Array) -> float:
    """Probability that a landmark stays, given the looks at it and their counts (2, 2); `expected` as of `_goes`."""
    there = log(p[0]) + _betas(counts[1, 1], counts[1, 0], p[3], own) + _betas(counts[0, 1], counts[0, 0], p[4], own)
    gone = log(1.0 - p[0]) + _goes(opportunities, p, chance, expected)
    return 1.0 / (1.0 + exp(min(gone - there, 700.0)))


@njit(cache=True)
def _staying(opportunities: IntArray, begin: IntArray, p: Array, own: float, chance: float) -> Array:
    stays, expected = np.empty(len(begin) - 1), np.empty(4)
    for i in range(len(stays)):
        of = opportunities[begin[i] : begin[i + 1]]
        stays[i] = _stays(of, _transitions(of)[0], p, own, chance, expected)
    return stays


@njit(cache=True)
def _fitted(
    opportunities: IntArray, begin: IntArray, prior: Array, own: float, chance: float, least: float, rounds: int
) -> Array:
    """`Permanence` as an array (5,); prior (2, 5): mean of each, and what it is worth."""
    p: Array = prior[0].copy()
    expected = np.empty(4)
    for _ in range(rounds):
        yes, every = prior[0] * prior[1], prior[1].copy()
        for i in range(len(begin) - 1):
            of = opportunities[begin[i] : begin[i + 1]]
            counts, row = _transitions(of)
            there = _stays(of, counts, p, own, chance, expected)
            gone = 1.0 - there
            if row:
                counts[1, 0] -= 1.0
                counts[0, 0] -= row - 1.0
            yes += np.array([there, gone * expected[0], gone * expected[2], there * counts[1, 1], there * counts[0, 1]])
            every[0] += 1.0
            every[1] += gone * (expected[0] + expected[1])
            every[2] += gone * (expected[2] + expected[3])
            every[3] += there * counts[1].sum()
            every[4] += there * counts[0].sum()
        p = yes / every
        p[2] = max(p[2], least)
    return p
