"""Which landmarks of a log are there for good, and which for a while: clutter, people, what a bent map has twice.

Every landmark that was initialized is a row of looks: places from which it should have been seen, and was or was not.
One kind stays: it is seen and missed as a Markov chain has it, each landmark with rates of its own around the common
ones (beta distributions). The other kind goes: at once after the reading that it was initialized by (clutter), or at
each later look (people); from then on it is read by chance only. Which shares the kinds have, how soon the second one
goes and how often the first one is seen is fitted to all landmarks of the log together, by expectation maximization.
What is missed at the end of a row of looks does not tell how often landmarks are missed: they may be gone.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, lgamma, log
from typing import NamedTuple

import numpy as np
from numba import njit

from association.evidence import constants
from data.inputs import IntArray
from data.se2 import Array, BoolArray

Looks = Sequence[bytes | bytearray]
"""Of each landmark, after the reading that it was initialized by: 1 seen, 0 missed, in their order."""


class Permanence(NamedTuple):
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


def permanence(looks: Looks) -> Permanence:
    """Of the landmarks (n) of a log, those that were retracted included; without any it is the prior."""
    own, chance, least = constants.PERMANENCE_OWN, constants.PERMANENCE_CHANCE, constants.PERMANENCE_LATER_LEAST
    prior = np.array([constants.PERMANENCE_MEANS, constants.PERMANENCE_WORTH])
    return Permanence(*_fitted(*_packed(looks), prior, own, chance, least, constants.PERMANENCE_ROUNDS).tolist())


def staying(looks: Looks, p: Permanence) -> Array:
    """Probability (n,) that each of n landmarks is there for good."""
    return _staying(*_packed(looks), np.array(p), constants.PERMANENCE_OWN, constants.PERMANENCE_CHANCE)


def lasting(looks: Looks, former: Looks, sightings: IntArray) -> BoolArray:
    """Which landmarks (n,) of a map stay in it at the end of a log.

    Those that stay by odds of two to one (`STAYS`). Where most of these are read often, one that was read two or three
    times is somebody who came along in the end: it needs as many sightings as all but the fewest of them have, or
    `CERTAIN`. Where that leaves less than half of those that may be expected to stay, their number is better known than
    which they are: then it is as many, the likeliest.

    Args:
        looks: at each of the map's landmarks (n).
        former: at the landmarks that were retracted before.
        sightings: (n,) of each of the map's.
    """
    often = sightings >= constants.CERTAIN_AT_LEAST
    stay = np.where(often, staying(looks, permanence([*looks, *former])), 0.0)
    keep: BoolArray = stay > constants.STAYS
    if keep.any():
        keep &= sightings >= min(constants.CERTAIN, float(np.quantile(sightings[keep], constants.STAYS_FEWEST)))
    expected = round(float(stay.sum()))
    if 2 * keep.sum() < expected:
        keep = np.zeros(len(stay), np.bool_)
        keep[np.argsort(-stay, kind="stable")[:expected]] = True
    return keep


def _packed(looks: Looks) -> tuple[IntArray, IntArray]:
    """All looks in a row (m,), and where those of each landmark begin (n + 1,)."""
    begin = np.cumsum(np.array([0, *(len(s) for s in looks)], np.int64))
    return np.frombuffer(b"".join(looks), np.uint8).astype(np.int64), begin


@njit(cache=True)
def _betas(seen: float, missed: float, mean: float, own: float) -> float:
    """Log-likelihood of looks whose rate is beta distributed: mean, and as many looks `own` as the mean is worth."""
    a, b = own * mean, own * (1.0 - mean)
    return lgamma(a + seen) - lgamma(a) + lgamma(b + missed) - lgamma(b) + lgamma(own) - lgamma(own + seen + missed)


@njit(cache=True)
def _transitions(looks: IntArray) -> tuple[Array, int]:
    """Counts (2, 2) of looks [after a miss or a sighting, missed or seen], and how many misses are at the end."""
    counts, before, row = np.zeros((2, 2)), 1, 0
    for now in looks:
        counts[before, now] += 1.0
        before, row = now, 0 if now else row + 1
    return counts, row


@njit(cache=True)
def _goes(looks: IntArray, p: Array, chance: float, expected: Array) -> float:
    """Log-likelihood of the looks at a landmark that goes: the sum over the looks k before which it may have gone.

    expected (4,), written: gone at once or not, for a landmark that was looked at; gone at a later look, and looks that
    it lasted.
    """
    at_once, later, seen, n = p[1], p[2], p[3], len(looks)
    terms = np.empty(n + 2)
    after = 0.0
    for k in range(n, -1, -1):  # by chance alone from look k on
        terms[k] = after
        if k:
            after += log(chance) if looks[k - 1] else log(1.0 - chance)
    terms[n + 1] = terms[0] + log(at_once)
    before = log(1.0 - at_once)
    for k in range(n):
        terms[k] += before + log(later)
        before += log(1.0 - later) + (log(seen) if looks[k] else log(1.0 - seen))
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
def _stays(looks: IntArray, counts: Array, p: Array, own: float, chance: float, expected: Array) -> float:
    """Probability that a landmark stays, given the looks at it and their counts (2, 2); `expected` as of `_goes`."""
    there = log(p[0]) + _betas(counts[1, 1], counts[1, 0], p[3], own) + _betas(counts[0, 1], counts[0, 0], p[4], own)
    gone = log(1.0 - p[0]) + _goes(looks, p, chance, expected)
    return 1.0 / (1.0 + exp(min(gone - there, 700.0)))


@njit(cache=True)
def _staying(looks: IntArray, begin: IntArray, p: Array, own: float, chance: float) -> Array:
    stays, expected = np.empty(len(begin) - 1), np.empty(4)
    for i in range(len(stays)):
        of = looks[begin[i] : begin[i + 1]]
        stays[i] = _stays(of, _transitions(of)[0], p, own, chance, expected)
    return stays


@njit(cache=True)
def _fitted(
    looks: IntArray, begin: IntArray, prior: Array, own: float, chance: float, least: float, rounds: int
) -> Array:
    """`Permanence` as an array (5,); prior (2, 5): mean of each, and what it is worth."""
    p: Array = prior[0].copy()
    expected = np.empty(4)
    for _ in range(rounds):
        yes, every = prior[0] * prior[1], prior[1].copy()
        for i in range(len(begin) - 1):
            of = looks[begin[i] : begin[i + 1]]
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
