"""Which landmarks of a log are real, and which of these left: a persistence filter over detection opportunities.

Each landmark has a sequence of opportunities (`opportunities.py`). Three kinds of landmarks explain it:

* persistent: in place until the end, with detection probabilities of its own around common ones (beta distributions),
  from familiar viewpoints and from others;
* left: the same until an unknown opportunity, and detected by chance only from then on;
* transient: clutter that vanishes right after its first observation, or people who vanish before each later
  opportunity with a much larger probability.

Before its first detection a real landmark was missed, and a transient one had not appeared yet.

The time of leaving is summed out, as in the persistence filter (Rosen, Mason and Leonard, ICRA 2016) with a geometric
survival time. Shares and rates are fitted to all landmarks of the log by expectation maximization. Misses after the
last detection do not count for the rates: the landmark may have left.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log
from typing import NamedTuple

import numpy as np

from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from eval.replay.hindsight import constants
from eval.replay.hindsight.opportunities import BEFORE

Opportunities = Sequence[bytes | bytearray]  # of each landmark, after its first observation; see `opportunities.py`


class Persistence(NamedTuple):
    """Common parameters of a log's landmarks.

    real: share of landmarks that are no transient ones; at_once, later: probabilities that a transient one vanishes
    before the first and before each further opportunity; elsewhere, familiar, behind: detection probabilities by
    viewpoint; first: of a landmark that was not detected before; appearing: probability that a transient one appears.
    """

    real: float
    at_once: float
    later: float
    elsewhere: float
    familiar: float
    behind: float
    first: float
    appearing: float


class Kinds(NamedTuple):
    """Probabilities (n,) of each landmark's kind; they sum to one."""

    persistent: Array
    left: Array
    transient: Array


def persistence(opportunities: Opportunities) -> Persistence:
    """Fit to the landmarks (n) of a log; the prior if there are none."""
    fitted = _fitted(
        *_packed(opportunities), np.array([constants.PERSISTENCE_MEANS, constants.PERSISTENCE_WORTH]), _fixed(),
        constants.PERSISTENCE_LATER_LEAST, constants.PERSISTENCE_ROUNDS,
    )  # fmt: skip
    return Persistence(*fitted.tolist())


def kinds(opportunities: Opportunities, p: Persistence, leaving: float | None = None) -> Kinds:
    """The probability of each kind, of landmarks (n); `leaving`: before an opportunity, None: `PERSISTENCE_LEAVING`."""
    fixed = _fixed()
    if leaving is not None:
        fixed[2] = leaving
    return Kinds(*_probabilities(*_packed(opportunities), np.array(p), fixed))


def evidence(opportunities: Opportunities) -> Array:
    """Log-likelihood (n,) of each landmark's opportunities, whatever its kind, with the parameters fitted to them."""
    p = np.array(persistence(opportunities))
    return _evidences(*_packed(opportunities), p, _fixed())


class Kept(NamedTuple):
    """Landmarks (n,) of a map that stay in it at the end of a log.

    left: those that left the world before; folded: they were initialized again elsewhere, so none of these stays;
    few: real ones that were observed too few times to tell how the map is; they stay, too, unless it is folded.
    """

    stays: BoolArray
    left: BoolArray
    folded: bool
    few: BoolArray


def kept_at_end(opportunities: Opportunities, observations: IntArray, spans: IntArray) -> Kept:
    """Which landmarks (n,) of a map stay in it at the end of a log.

    To drop a landmark unpairs all its observations; to keep a transient one keeps as many wrong pairings. So the
    expected cost is least where landmarks stay that are real with a probability above one half. Whether the map is
    folded, and how likely it is, they tell with `CONFIRMED` observations, or with fewer where most have fewer.

    A world where landmarks leave has few that appear, where there was nothing before. If more appeared after the median
    landmark left than left, or if most left, the map is folded: these were initialized again elsewhere, and are
    dropped.

    observations (n,): number of each landmark; spans (n, 2): its first and its last observation.
    """
    p = persistence(opportunities)
    found = kinds(opportunities, p)
    real: BoolArray = (found.transient < 0.5) & (observations >= constants.CONFIRMED_AT_LEAST)
    keep = real.copy()
    if keep.any():
        times = np.sort(observations[keep])
        fewer = np.cumsum(times) > constants.PERSISTENT_FEWEST * times.sum()
        keep &= observations >= min(constants.CONFIRMED, int(times[fewer.argmax()]))
    left = keep & (found.left > found.persistent)
    if not left.any():
        return Kept(keep, left, False, real & ~keep)
    missed = np.array([len(s) - len(s.lstrip(bytes([BEFORE]))) for s in opportunities])  # before the first detection
    appeared = keep & ~left & (missed >= constants.CONFIRMED) & (spans[:, 0] > np.median(spans[left, 1]))
    if appeared.sum() <= left.sum() <= 0.5 * keep.sum():
        return Kept(keep, left, False, real & ~keep)
    often = float(left.sum()) / sum(len(s) for s in opportunities)  # leaving is not rare here
    found = kinds(opportunities, p, often)
    left = keep & (found.left > found.persistent)
    return Kept(keep & ~left, left, True, np.zeros_like(keep))


def _fixed() -> Array:
    """What is not fitted, for the kernels: weight of the common rates, chance detection, and leaving."""
    return np.array([constants.PERSISTENCE_OWN, constants.PERSISTENCE_CHANCE, constants.PERSISTENCE_LEAVING])


def _packed(opportunities: Opportunities) -> tuple[IntArray, IntArray]:
    """All opportunities in a row (m,), and where those of each landmark begin (n + 1,)."""
    begin = np.cumsum(np.array([0, *(len(s) for s in opportunities)], np.int64))
    return np.frombuffer(b"".join(opportunities), np.uint8).astype(np.int64), begin


@njit
def _log_sum(terms: Array) -> float:
    top = terms.max()
    return float(top + log(np.exp(terms - top).sum()))


@njit
def _before(opportunities: IntArray) -> int:
    """How many opportunities were before the first detection."""
    k = 0
    while k < len(opportunities) and opportunities[k] == BEFORE:
        k += 1
    return k


@njit
def _likelihoods(opportunities: IntArray, p: Array, fixed: Array, expected: Array) -> Array:
    """Log-likelihoods (3,) of the kinds: sums over the opportunities k before which a landmark may have left.

    expected (4,), written: a transient landmark vanished at once or not, if it has opportunities; it vanished later,
    and opportunities that it lasted.
    """
    at_once, later, mean = p[1], p[2], p[3:6]
    own, chance, leaving = fixed[0], fixed[1], fixed[2]
    before = _before(opportunities)
    opportunities = opportunities[before:]
    n = len(opportunities)
    gone = np.zeros(n + 1)  # by chance alone from opportunity k on
    for k in range(n - 1, -1, -1):
        gone[k] = gone[k + 1] + (log(chance) if opportunities[k] % 2 else log(1.0 - chance))
    a, b = own * mean, own * (1.0 - mean)
    left, transient = np.full(n + 1, -np.inf), np.empty(n + 2)
    # detected for the first time after so many misses: beta-geometric, and geometric
    there, appearing = log(own * p[6]) - log(own + before), log(p[7]) + before * log(1.0 - p[7])
    for k in range(before):
        there += log(own * (1.0 - p[6]) + k) - log(own + k)
    passing = appearing + log(1.0 - at_once)
    for k in range(n):
        left[k] = there + log(leaving) + gone[k]
        transient[k] = passing + log(later) + gone[k]
        detected, familiar = opportunities[k] % 2, opportunities[k] // 2
        rate = a[familiar] / (a[familiar] + b[familiar])
        there += log(1.0 - leaving) + (log(rate) if detected else log(1.0 - rate))
        passing += log(1.0 - later) + (log(mean[familiar]) if detected else log(1.0 - mean[familiar]))
        a[familiar] += detected
        b[familiar] += 1 - detected
    transient[n], transient[n + 1] = passing, appearing + gone[0] + log(at_once)
    result = np.array([there, _log_sum(left) if n else -np.inf, _log_sum(transient)])
    expected[:] = 0.0
    if n:
        expected[0] = exp(transient[n + 1] - result[2])
        expected[1] = 1.0 - expected[0]
    for k in range(n + 1):
        share = exp(transient[k] - result[2])
        expected[2] += share if k < n else 0.0
        expected[3] += share * k
    return result


@njit
def _evidences(opportunities: IntArray, begin: IntArray, p: Array, fixed: Array) -> Array:
    result, expected = np.empty(len(begin) - 1), np.empty(4)
    for i in range(len(result)):
        terms = _likelihoods(opportunities[begin[i] : begin[i + 1]], p, fixed, expected)
        terms[:2] += log(p[0])
        terms[2] += log(1.0 - p[0])
        result[i] = _log_sum(terms)
    return result


@njit
def _posterior(opportunities: IntArray, p: Array, fixed: Array, expected: Array) -> Array:
    """Probabilities (3,) of the kinds of a landmark; `expected` as of `_likelihoods`."""
    terms = _likelihoods(opportunities, p, fixed, expected)
    terms[:2] += log(p[0])
    terms[2] += log(1.0 - p[0])
    weight: Array = np.exp(terms - terms.max())
    weight /= weight.sum()
    return weight


@njit
def _probabilities(opportunities: IntArray, begin: IntArray, p: Array, fixed: Array) -> Array:
    result, expected = np.empty((3, len(begin) - 1)), np.empty(4)
    for i in range(len(begin) - 1):
        result[:, i] = _posterior(opportunities[begin[i] : begin[i + 1]], p, fixed, expected)
    return result


@njit
def _fitted(opportunities: IntArray, begin: IntArray, prior: Array, fixed: Array, least: float, rounds: int) -> Array:
    """`Persistence` as an array (8,); prior (2, 8): mean and weight of each."""
    p: Array = prior[0].copy()
    expected = np.empty(4)
    for _ in range(rounds):
        yes, every = prior[0] * prior[1], prior[1].copy()
        for i in range(len(begin) - 1):
            of = opportunities[begin[i] : begin[i + 1]]
            transient = _posterior(of, p, fixed, expected)[2]
            real = 1.0 - transient
            yes[0] += real
            every[0] += 1.0
            yes[1] += transient * expected[0]
            every[1] += transient * (expected[0] + expected[1])
            yes[2] += transient * expected[2]
            every[2] += transient * (expected[2] + expected[3])
            before, last = _before(of), len(of)
            yes[6] += real
            every[6] += real * (before + 1)
            yes[7] += transient
            every[7] += transient * (before + 1)
            while last > before and of[last - 1] % 2 == 0:
                last -= 1
            for k in range(before, last):
                yes[3 + of[k] // 2] += real * (of[k] % 2)
                every[3 + of[k] // 2] += real
        p = yes / every
        p[2] = max(p[2], least)
    return p
