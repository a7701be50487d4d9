"""Detection opportunities of landmarks, and what they tell in the end: which are real, and which of these left.

A landmark may be hidden from most places: by others, by its own far side, by distance. So a missed detection counts by
its viewpoint, the range and the side from which the landmark is looked at. A viewpoint is familiar if the landmark was
detected before in the same cell of viewpoints or in one beside it. Behind a mapped landmark it may be occluded. How
often persistent landmarks are detected from familiar viewpoints, from others and behind others is learned for the log:
where landmarks hide, misses from elsewhere tell nothing; where they do not, every miss counts.

Online, the ledger collects opportunities with the path and the pairings of the moment; `recounted` does so with the
smoothed path, the map and the pairings of the end, and counts misses before the first detection, too.

Three kinds of landmarks explain a sequence of opportunities:

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

import math
from collections.abc import Sequence
from functools import cache
from math import exp, floor, hypot, log, pi
from typing import NamedTuple

import numpy as np
import scipy

from association.candidates import polar_sigma
from association.expectation import Expectation
from data.compiled import njit
from data.inputs import IntArray, LandmarkMap, Observations
from data.se2 import Array, BoolArray
from data.sensors import Sensor, wrap_angle_jit
from eval.replay.hindsight import constants

MISSED, DETECTED = 0, 1  # of an opportunity: the result, ...
FAMILIAR, BEHIND = 2, 4  # ... plus one of these if the viewpoint is familiar, or behind another landmark
BEFORE = 6  # missed before the first detection


def cell(distance: float, direction: float) -> int:
    """Cell of viewpoints from which a landmark is at this distance [m], in this direction [rad] in the world."""
    ring = math.floor(math.log(max(distance, 1e-3)) / math.log(constants.VIEW_RING))
    side = math.floor(constants.VIEW_SIDES * direction / (2.0 * math.pi)) % constants.VIEW_SIDES
    return ring * constants.VIEW_SIDES + side


@cache
def beside(of: int) -> frozenset[int]:
    """A cell and those beside it."""
    sides = constants.VIEW_SIDES
    ring, side = divmod(of, sides)
    return frozenset(r * sides + (side + s) % sides for r in (ring - 1, ring, ring + 1) for s in (-1, 0, 1))


class Sights(NamedTuple):
    """Landmarks (n) that are expected. open (n,): in view and not occluded by an observation; behind (n,): another one
    may occlude it; polar (n, 2): expected range [m] and bearing [rad].
    """

    open: BoolArray
    behind: BoolArray
    polar: Array


def sights(
    sensor: Sensor, z_hat: Array, covariance: Array, z: Array, at: IntArray | None = None, seen: IntArray | None = None
) -> Sights:
    """What can be seen of landmarks expected at z_hat (n, 2), beside observations z (m, 2). Those in view are inside
    the field of view by `IN_VIEW_SIGMAS` of their covariance (n, 2, 2). Of several frames: `at` (F + 1,) the landmarks
    and `seen` (F + 1,) the observations with which each begins, and the last one ends.
    """
    polar, sigma = np.array(sensor.polar(z_hat)), constants.IN_VIEW_SIGMAS * polar_sigma(sensor, z_hat, covariance)
    inside = sensor.in_view(z_hat, margin_range=-sigma[:, 0], margin_angle=-sigma[:, 1])
    behind, observed = np.zeros(len(polar), np.bool_), np.array(sensor.polar(z), float)
    if at is None or seen is None:
        at, seen = np.array([0, len(polar)]), np.array([0, len(z)])
    _occluded(polar, observed, at, seen, constants.SHADOW, constants.SHADOW_WIDTH, inside, behind)
    return Sights(inside, behind, polar)


@njit
def _occluded(
    polar: Array, seen: Array, at: IntArray, at_seen: IntArray, shadow: float, width: float, open_to: BoolArray,
    behind: BoolArray,
) -> None:  # fmt: skip
    """Which polar places (n, 2) are hidden by something seen (m, 2), and which may be hidden by one another."""
    for f in range(len(at) - 1):
        for i in range(at[f], at[f + 1]):
            r, b = polar[i, 0], polar[i, 1]
            for q in range(at_seen[f], at_seen[f + 1]):
                if seen[q, 0] < r and abs(wrap_angle_jit(seen[q, 1] - b)) < shadow:
                    open_to[i] = False
            for q in range(at[f], at[f + 1]):
                if polar[q, 0] < r - width and abs(wrap_angle_jit(polar[q, 1] - b)) < width / max(polar[q, 0], width):
                    behind[i] = True


def missing(e: Expectation, decisions: IntArray, sensor: Sensor) -> tuple[BoolArray, Sights]:
    """Candidates (n,) with a missed detection: in sight and not paired; and what can be seen of all."""
    unpaired, seen = (e.number[:, None] != decisions).all(axis=1), sights(sensor, e.z_hat, e.HPHt, e.z)
    return seen.open & unpaired, seen


def recounted(view: Sensor, path: Array, known: LandmarkMap, seen: Observations, number: IntArray) -> dict[int, bytes]:
    """The opportunities of each landmark of a map in a log, by number, without its first observation; `view` is that in
    which observations (M,) of landmarks `number` (M,), -1 for none, were made. A frame without any may lack the sensor.
    """
    noise, apart = np.median(seen.R, axis=0), constants.SAME_PLACE * view.max_range
    reach = math.hypot(*view.translation) + view.max_range
    frames, begin = np.unique(seen.frame, return_index=True)
    near = [np.flatnonzero(np.hypot(known.xy[:, 0] - x, known.xy[:, 1] - y) <= reach) for x, y in path[frames, :2]]
    every, at = np.concatenate([np.empty(0, np.int64), *near]), np.cumsum([0, *map(len, near)])
    of = np.repeat(frames, np.diff(at))
    z_hat, noises = view.predict(path[of], known.xy[every]), np.broadcast_to(noise, (len(every), 2, 2))
    sight = sights(view, z_hat, noises, seen.z, at, np.append(begin, len(number)))
    size = 1 + int(known.id.max(initial=0))
    here = np.isin(of * size + known.id[every], (seen.frame * size + number)[number >= 0])
    some = np.flatnonzero(sight.open | here)
    cells = constants.VIEW_RING, constants.VIEW_SIDES
    codes = _codes(every[some], here[some], sight.behind[some], path[of[some]], sight.polar[some], apart, *cells)
    told = np.flatnonzero(codes >= 0)
    owner = every[some[told]]
    each = codes[told][np.argsort(owner, kind="stable")].astype(np.uint8)
    ends = np.cumsum(np.bincount(owner, minlength=len(known.id)))
    return {n: part.tobytes() for n, part in zip(known.id.tolist(), np.split(each, ends), strict=False)}


@njit
def _codes(
    landmark: IntArray, found: BoolArray, behind: BoolArray, pose: Array, polar: Array, apart: float, ring: float,
    sides: int,
) -> IntArray:  # fmt: skip
    """The opportunity (m,) of a landmark from poses (m, 3) in polar places (m, 2); -1: nothing new."""
    m, codes = len(landmark), np.full(len(landmark), -1)
    if not m:
        return codes
    rings = np.empty(m, np.int64)
    for q in range(m):
        rings[q] = floor(log(max(polar[q, 0], 1e-3)) / log(ring))
    n, rings = landmark.max() + 1, rings - rings.min() + 1
    familiar, known = np.zeros((n, rings.max() + 2, sides), np.bool_), np.zeros(n, np.bool_)
    place, last, viewpoint = np.full((n, 2), np.inf), np.full(n, -1), np.full(n, -1)  # viewpoint: of the last detection
    for q in range(m):
        i, x, y = landmark[q], pose[q, 0], pose[q, 1]
        elsewhere = hypot(place[i, 0] - x, place[i, 1] - y) >= apart
        if not (found[q] or elsewhere):
            continue
        side = floor(sides * (pose[q, 2] + polar[q, 1]) / (2.0 * pi)) % sides
        if known[i] and (elsewhere or last[i] < 0 or last[i] == BEFORE):
            seen_from = BEHIND if behind[q] else FAMILIAR if familiar[i, rings[q], side] else 0
            codes[q] = last[i] = (DETECTED if found[q] else MISSED) + seen_from
        elif not (known[i] or found[q]):
            codes[q] = last[i] = BEFORE
        if found[q] and viewpoint[i] != rings[q] * sides + side:
            viewpoint[i], known[i] = rings[q] * sides + side, True
            for r in range(rings[q] - 1, rings[q] + 2):
                for s in range(side - 1, side + 2):
                    familiar[i, r, s % sides] = True
        if elsewhere:
            place[i, 0], place[i, 1] = x, y
    return codes


class Detections(NamedTuple):
    """What a log tells about one landmark after its first observation. opportunities: its detections and missed
    detections; chance: detection probability after it vanished.
    """

    opportunities: bytes | bytearray
    chance: float = constants.PERSISTENCE_CHANCE


class Persistence(NamedTuple):
    """Common parameters of a log's landmarks.

    shares (4,): of landmarks that are no transient ones; probabilities that a transient one vanishes before the first
    and before each further opportunity, and that it appears before an opportunity. seen, missed (4,): parameters of the
    beta distributions of detection probabilities: from unfamiliar and familiar viewpoints, behind another landmark, and
    before the first detection.
    """

    shares: Array
    seen: Array
    missed: Array


class Kinds(NamedTuple):
    """Probabilities (n,) of each landmark's kind; they sum to one."""

    persistent: Array
    left: Array
    transient: Array


def persistence(every: Sequence[Detections]) -> Persistence:
    """Fit to the landmarks (n) of a log; the prior if there are none."""
    codes, begin, chance = _packed(every)
    mean, worth = np.array([constants.PERSISTENCE_MEANS, constants.PERSISTENCE_WORTH])
    n, of, detected = len(begin) - 1, np.repeat(np.arange(len(begin) - 1), np.diff(begin)), codes % 2 == 1
    before, last = np.bincount(of[codes == BEFORE], minlength=n), np.full(n, -1)
    np.maximum.at(last, of[detected], np.flatnonzero(detected))
    counts = (codes != BEFORE) & (np.arange(len(codes)) <= last[of])  # later it may have left
    rates, weight = np.array([constants.RATE_MEANS, constants.RATE_WORTH])
    view = 4 * of[counts] + codes[counts] // 2
    seen = np.bincount(view, detected[counts], minlength=4 * n).reshape(n, 4).astype(float)
    total = np.bincount(view, minlength=4 * n).reshape(n, 4).astype(float)
    seen[:, BEFORE // 2], total[:, BEFORE // 2] = 1.0, before + 1
    seen, total = np.vstack([seen, rates * weight]), np.vstack([total, weight])  # the prior
    p = Persistence(mean, constants.PERSISTENCE_OWN * rates, constants.PERSISTENCE_OWN * (1.0 - rates))
    for _ in range(constants.PERSISTENCE_ROUNDS):
        terms, (at_once, later, lasted) = _terms(codes, begin, chance, np.array(p), constants.PERSISTENCE_LEAVING)
        transient = _softmax(terms)[2]
        real = 1.0 - transient
        yes = np.array([real.sum(), transient @ at_once, transient @ later, transient.sum()])
        out_of = np.array([
            n, transient @ (np.diff(begin) > before), transient @ (later + lasted), transient @ (before + 1),
        ])  # fmt: skip
        shares = (mean * worth + yes) / (worth + out_of)
        shares[2] = max(shares[2], constants.PERSISTENCE_LATER_LEAST)
        p = Persistence(shares, *_rates(seen, total, np.append(real, 1.0), p.seen, p.missed))
    return p


def _rates(seen: Array, total: Array, weight: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """One step (Minka 2000) towards the likeliest beta distributions of detection probabilities, by viewpoint."""
    psi = scipy.special.digamma
    out_of = weight @ (psi(a + b + total) - psi(a + b))
    detected, missed = weight @ (psi(a + seen) - psi(a)), weight @ (psi(b + total - seen) - psi(b))
    return np.clip(a * detected / out_of, *constants.RATE_BOUNDS), np.clip(b * missed / out_of, *constants.RATE_BOUNDS)


def kinds(every: Sequence[Detections], p: Persistence, leaving: float = constants.PERSISTENCE_LEAVING) -> Kinds:
    """The probability of each kind, of landmarks (n); `leaving`: before an opportunity."""
    return Kinds(*_softmax(_terms(*_packed(every), np.array(p), leaving)[0]))


def _softmax(terms: Array) -> Array:
    """Exponentials of (3, n), of which each column sums to one."""
    each = np.exp(terms - terms.max(axis=0))
    return np.asarray(each / each.sum(axis=0))


def evidence(every: Sequence[Detections]) -> Array:
    """Log-likelihood (n,) of each landmark's opportunities, whatever its kind, with the parameters fitted to them."""
    terms = _terms(*_packed(every), np.array(persistence(every)), constants.PERSISTENCE_LEAVING)[0]
    return np.asarray(scipy.special.logsumexp(terms, axis=0))


class Kept(NamedTuple):
    """Landmarks (n,) of a map that stay in it at the end of a log.

    left: those that left the world before; folded: they were initialized again elsewhere, so none of these stays;
    few: real ones that were observed too few times to tell how the map is; they stay, too, unless it is folded.
    """

    stays: BoolArray
    left: BoolArray
    folded: bool
    few: BoolArray


def remaining(every: Sequence[Detections], observations: IntArray, spans: IntArray) -> Kept:
    """Which landmarks (n,) of a map stay in it at the end of a log.

    To drop a landmark unpairs all its observations; to keep a transient one keeps as many wrong pairings. So the
    expected cost is least where landmarks stay that are real with a probability above one half. Whether the map is
    folded, and how likely it is, they tell with `CONFIRMED` observations, or with fewer where most have fewer.

    A world where landmarks leave has few that appear, where there was nothing before. If more appeared after the median
    landmark left than left, or if most left, the map is folded: these were initialized again elsewhere, and are
    dropped.

    observations (n,): number of each landmark; spans (n, 2): its first and its last observation.
    """
    p = persistence(every)
    found = kinds(every, p)
    real: BoolArray = (found.transient < 0.5) & (observations >= constants.CONFIRMED_AT_LEAST)
    keep = real.copy()
    if keep.any():
        times = np.sort(observations[keep])
        fewer = np.cumsum(times) > constants.PERSISTENT_FEWEST * times.sum()
        keep &= observations >= min(constants.CONFIRMED, int(times[fewer.argmax()]))
    left = keep & (found.left > found.persistent)
    if not left.any():
        return Kept(keep, left, False, real & ~keep)
    missed = np.array([len(s) - len(s.lstrip(bytes([BEFORE]))) for s, _ in every])  # before the first detection
    appeared = keep & ~left & (missed >= constants.CONFIRMED) & (spans[:, 0] > np.median(spans[left, 1]))
    if appeared.sum() <= left.sum() <= 0.5 * keep.sum():
        return Kept(keep, left, False, real & ~keep)
    often = float(left.sum()) / sum(len(s) for s, _ in every)  # leaving is not rare here
    found = kinds(every, p, often)
    left = keep & (found.left > found.persistent)
    return Kept(keep & ~left, left, True, np.zeros_like(keep))


def _packed(every: Sequence[Detections]) -> tuple[IntArray, IntArray, Array]:
    """All opportunities in a row (m,), where those of each landmark begin (n + 1,), and its chance (n,)."""
    begin = np.cumsum(np.array([0, *(len(d.opportunities) for d in every)], np.int64))
    codes = np.frombuffer(b"".join(d.opportunities for d in every), np.uint8).astype(np.int64)
    return codes, begin, np.array([d.chance for d in every])


@njit
def _log_sum(terms: Array) -> float:
    most, total = terms.max(), 0.0
    for term in terms:
        total += exp(term - most)
    return float(most + log(total))


@njit
def _likelihoods(codes: IntArray, p: Array, chance: float, leaving: float, result: Array, expected: Array) -> None:
    """Log-likelihoods `result` (3,) of the kinds of landmarks, summed over the times at which one may have left."""
    (real, at_once, later, appears), a, b = p[0], p[1].copy(), p[2].copy()
    rate, before = a / (a + b), 0
    while before < len(codes) and codes[before] == BEFORE:
        before += 1
    codes = codes[before:]
    n = len(codes)
    gone = np.zeros(n + 1)  # by chance alone from opportunity k on
    by_chance, not_by_chance = log(chance), log(1.0 - chance)
    for k in range(n - 1, -1, -1):
        gone[k] = gone[k + 1] + (by_chance if codes[k] % 2 else not_by_chance)
    left, transient = np.empty(n), np.empty(n + 2)
    # detected for the first time after so many misses: beta-geometric, and geometric
    there = log(real) + log(a[3]) - log(a[3] + b[3] + before)
    for k in range(before):
        there += log(b[3] + k) - log(a[3] + b[3] + k)
    appearing = log(1.0 - real) + log(appears) + before * log(1.0 - appears)
    passing = appearing + log(1.0 - at_once)
    leaves, stays, ends, lasts = log(leaving), log(1.0 - leaving), log(later), log(1.0 - later)
    detects, misses = np.log(rate), np.log(1.0 - rate)
    for k in range(n):
        left[k] = there + leaves + gone[k]
        transient[k] = passing + ends + gone[k]
        detected, view = codes[k] % 2, codes[k] // 2
        there += stays + log(a[view] if detected else b[view]) - log(a[view] + b[view])
        a[view] += detected
        b[view] += 1 - detected
        passing += lasts + (detects[view] if detected else misses[view])
    transient[n], transient[n + 1] = passing, appearing + gone[0] + log(at_once)
    result[0], result[1], result[2] = there, _log_sum(left) if n else -np.inf, _log_sum(transient)
    expected[0], expected[1], expected[2] = exp(transient[n + 1] - result[2]) if n else 0.0, 0.0, 0.0
    for k in range(n + 1):
        share = exp(transient[k] - result[2])
        expected[1] += share if k < n else 0.0
        expected[2] += k * share


@njit
def _terms(opportunities: IntArray, begin: IntArray, chance: Array, p: Array, leaving: float) -> tuple[Array, Array]:
    """Log-likelihood (3, n) of each kind and landmark, with the share of the kind; `expected` (3, n) of each."""
    n = len(begin) - 1
    terms, expected = np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        _likelihoods(opportunities[begin[i] : begin[i + 1]], p, chance[i], leaving, terms[i], expected[i])
    return terms.T, expected.T
