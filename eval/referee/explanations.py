"""Explanations of a log's residuals that compete by log-likelihood: systematic errors, noises, jumps, landmarks.

Every explanation is a model of the smoothed residuals with a few parameters more than the stated one. Its gain is the
rise of the log-likelihood, its penalty that of the Bayesian information criterion (Schwarz 1978) and the logarithm of
the number of places it was chosen from. A systematic error, a jump and a displaced landmark are columns of the
linearized problem (`graph.qr.score_test`), so path and map are estimated along.

Of each source of fixes and closures: another sigma, outliers, and errors that are correlated from one measurement to
the next; its systematic errors are among the columns. Which measurements are outliers is not told at a smoothed path
that bends to them, so `left_out` is found by a robust smoother (`eval.studies.diagnosis`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from data.inputs import Inputs, IntArray
from data.se2 import Array, BoolArray
from eval.referee.attribution import NOISE, Finding, of_variance
from eval.referee.consistency import successive
from eval.referee.effects import Effect, Scored, effects, score_of, without
from eval.referee.residuals import COMPONENTS, OUTLYING, Residuals, Used, correlation
from eval.referee.sources.residuals import ENTRIES, OfSource, entries_of, key_of, of_sources
from eval.referee.sources.scored import CLOSURE, sources_of

ALIKE = 3.0
"""Log-likelihood within which two explanations cannot be told apart: odds of 20."""
SAME = 0.25  # largest share of its gain that an indistinguishable explanation keeps beside the other
PLACES = 3  # frames, stretches and landmarks whose columns are formed: those with the largest residuals
LENGTHS = (5, 10, 20, 40)  # frames of a burst
CUTS = 24  # instants between which the noise may change
SLIGHT = 0.1  # share of a gain in variance, below which the gain of a correlation beside it does not count
CORRELATION, OUTLIERS = "correlation", "outliers"
HEAVY = (2.5, 3.0, 4.0, 6.0, 10.0)  # dof of Student's t
FEWEST = 8  # observations of a landmark, or of a stretch


@dataclass(frozen=True)
class Explanation:
    """One explanation with the logarithm of its odds against the stated model, already penalized."""

    finding: Finding
    net: float
    effects: tuple[int, ...] = ()  # its columns among the hypotheses of the score, if it has some


@dataclass(frozen=True, eq=False)
class Evidence:
    """What explanations are formed from: a smoother's path (N, 3), its pairings and residuals.

    usual: spread of residuals in replicates by component, in stated sigmas; lag1: their correlations; certain: relative
    standard deviation of the spreads.
    """

    inputs: Inputs
    path: Array
    used: Used
    residuals: Residuals
    usual: Mapping[str, float]
    lag1: Mapping[str, float]
    certain: Mapping[str, float]

    @property
    def observations(self) -> Array:
        """Residuals of observations (M, 2) in their usual spread."""
        return np.asarray(self.residuals.observations / np.array([self.usual.get(c, 1.0) for c in COMPONENTS[3:]]))

    @property
    def odometry(self) -> Array:
        """Residuals of odometry (N, 3) in their usual spread; NaN where it is hardly redundant."""
        usual = np.array([self.usual.get(c, 0.0) for c in COMPONENTS[:3]])
        return np.asarray(self.residuals.odometry / np.where(usual > 0.0, usual, np.nan))


def explanations(e: Evidence, taken: Sequence[str]) -> list[Explanation]:
    """All explanations of the residuals, the best first; `taken`: systematic errors that are estimated already."""
    landmarks = _landmarks(e)
    tails = [] if any(_are_of(e, x) for x in landmarks) else _tails(e, e.observations)
    found = [*_linear(e, taken), *_spreads(e), *_changes(e), *_correlations(e), *tails, *landmarks]
    for of in of_sources(e.inputs, e.path, e.used):
        found += [*_sigma(e, of), *_correlated(e, of)]
    return sorted((x for x in found if math.isfinite(x.net)), key=lambda x: -x.net)


def mirrored(e: Evidence) -> Explanation:
    """Bearings, or the y of points, to the other side: its gain is that of the corrected inputs alone."""
    return Explanation(Finding(NOISE, "mirrored", "z2", -1.0, gain=0.0), -penalty(e, 1))


def penalty(e: Evidence, parameters: int, places: int = 1) -> float:
    """Of the Bayesian information criterion, and the logarithm of the number of places that were searched."""
    known = np.isfinite(e.residuals.observations).sum() + np.isfinite(e.residuals.odometry).sum()
    return 0.5 * parameters * math.log(max(int(known), 2)) + math.log(max(places, 1))


# columns of the linearized problem


def _linear(e: Evidence, taken: Sequence[str]) -> list[Explanation]:
    """Systematic errors, jumps and bursts of the motion, and displaced landmarks of a known map."""
    plain = effects(e.inputs, e.path, e.used)
    groups: list[tuple[Finding, tuple[Effect, ...], int]]
    groups = [(Finding(NOISE, "systematic", x.name, math.nan), (x,), 1) for x in plain]
    of_points = e.inputs.map is not None and e.inputs.sensor.sees_points
    groups += [*_jumps(e), *_bursts(e), *(_displaced(e) if of_points else [])]
    hypotheses = list({x.name: x for _, columns, _ in groups for x in columns}.values())
    scored = score_of(e.inputs, e.path, e.used, hypotheses)
    place = {x.name: i for i, x in enumerate(hypotheses)}
    rows = [np.array([place[x.name] for x in columns]) for _, columns, _ in groups]
    known = np.array([i for i, x in enumerate(hypotheses) if x.name in taken], np.int64)
    left = Scored(scored.names, scored.score.given(known) if len(known) else scored.score)
    gains = [_gain(left, own) for own in rows]
    found = []
    for (finding, columns, places), own, gain in zip(groups, rows, gains, strict=True):
        if finding.name in taken or not gain > 0.0:
            continue
        sizes, errors = left.together(own)
        i = int(np.argmax(np.abs(sizes[:2]))) if finding.kind == "jump" else 0
        size = (
            float(np.hypot(*sizes[:2])) if finding.kind in ("jump", "displaced") and len(own) > 1 else float(sizes[i])
        )
        named = replace(finding, size=size, error=float(errors[i]), gain=gain)
        net = gain - penalty(e, len(columns), places)
        found.append(Explanation(named, net, tuple(own.tolist())))
    return [replace(x, finding=replace(x.finding, other=_ties(x, found, left))) for x in found]


def _gain(scored: Scored, own: IntArray) -> float:
    """Rise of the log-likelihood by all columns `own` together."""
    s, information = scored.score.score[own], scored.score.information[np.ix_(own, own)]
    return 0.5 * float(s @ np.linalg.pinv(information, rcond=1e-9, hermitian=True) @ s)


def _ties(best: Explanation, found: Sequence[Explanation], scored: Scored) -> tuple[str, ...]:
    """Systematic errors that explain the same as well: they gain next to nothing beside the best one."""
    beside = Scored(scored.names, scored.score.given(np.array(best.effects, np.int64)))
    return tuple(
        x.finding.name
        for x in found
        if x is not best
        and x.finding.kind == "systematic"
        and x.net > best.net - ALIKE
        and _gain(beside, np.array(x.effects)) < SAME * x.finding.gain
    )


def _largest(values: Array, apart: int) -> list[int]:
    """Places of the largest values (N,), NaN left out, at least `apart` from each other."""
    chosen: list[int] = []
    for k in np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")[: 20 * PLACES].tolist():
        if math.isfinite(values[k]) and all(abs(k - other) >= apart for other in chosen):
            chosen.append(k)
    return chosen[:PLACES]


def _jumps(e: Evidence) -> list[tuple[Finding, tuple[Effect, ...], int]]:
    """The frames with the largest residuals of odometry, each with an increment of its own."""
    odometry = e.odometry
    squared = np.where(np.isfinite(odometry).any(axis=1), np.nansum(odometry**2, axis=1), np.nan)
    found = []
    for k in _largest(squared, 2):
        columns = []
        for i in np.flatnonzero(np.isfinite(odometry[k])):
            motion = np.zeros((len(e.inputs), 3))
            motion[k, i] = 1.0
            columns.append(Effect(f"jump_{k}_{i}", motion=motion))
        found.append((Finding(NOISE, "jump", "odometry", math.nan, frames=((k, k),)), tuple(columns), len(e.inputs)))
    return found


def _bursts(e: Evidence) -> list[tuple[Finding, tuple[Effect, ...], int]]:
    """Stretches in which odometry reports more or less way than before and after: wheels that slip."""
    forward, step = e.odometry[:, 0], e.inputs.increments.mean
    found = []
    for length in LENGTHS:
        if 2 * length >= len(forward):
            break
        total = np.cumsum(np.concatenate([[0.0], np.nan_to_num(forward)]))
        sums = np.abs(total[length:] - total[:-length]) / math.sqrt(length)
        columns, frames = [], []
        for first in _largest(sums, length):
            motion = np.zeros_like(step)
            motion[first : first + length, :2] = step[first : first + length, :2]
            if np.any(motion):
                columns.append(Effect(f"burst_{first}_{length}", motion=motion))
                frames.append((first, first + length - 1))
        # one burst, two, and so on: of the same length each
        for count in range(1, len(columns) + 1):
            finding = Finding(NOISE, "burst", "odometry", math.nan, frames=tuple(frames[:count]))
            found.append((finding, tuple(columns[:count]), (len(forward) * len(LENGTHS)) ** count))
    return found


def _displaced(e: Evidence) -> list[tuple[Finding, tuple[Effect, ...], int]]:
    """The landmarks of the map with the largest mean residuals, each displaced by itself."""
    o, rows = e.inputs.observations, np.flatnonzero(e.used.number >= 0)
    if not len(rows):
        return []
    number = e.used.number[rows]
    sums = np.zeros((len(e.used.landmarks), 2))
    np.add.at(sums, number, np.nan_to_num(e.observations[rows]))
    counts = np.bincount(number, minlength=len(sums))
    strength = np.where(counts >= FEWEST, (sums**2).sum(axis=1) / np.maximum(counts, 1), np.nan)
    found = []
    for landmark in _largest(strength, 1):
        own = rows[number == landmark]
        place = np.repeat(e.used.landmarks[landmark][None], len(own), axis=0)
        _, _, Hm = e.inputs.sensor_of(own).linearize(e.path[o.frame[own]], place)
        columns = []
        for i in range(2):
            column = np.zeros((len(o.frame), 2))
            column[own] = Hm[:, :, i]
            columns.append(Effect(f"landmark_{landmark}_{i}", observations=column))
        name = str(e.used.identity[landmark])
        found.append((Finding(NOISE, "displaced", name, math.nan), tuple(columns), len(sums)))
    return found


# noises


def _spreads(e: Evidence) -> list[Explanation]:
    """Another sigma of one component, for the whole log; its dof from the replicates."""
    found: list[Explanation] = []
    for name, values in zip(COMPONENTS, [*e.odometry.T, *e.observations.T], strict=True):
        known = values[np.isfinite(values)]
        if len(known) >= FEWEST:
            found += _of_sigma(e, name, float(known.std()), len(known))
    return found


def _of_sigma(e: Evidence, name: str, factor: float, dof: int) -> list[Explanation]:
    """A sigma that is `factor` times the usual one; at most `dof` values show it."""
    spread = e.certain.get(name, math.nan)
    if not spread > 0.0:
        return []
    gain = float(of_variance(factor**2, min(0.5 / spread**2, dof)))
    return [Explanation(Finding(NOISE, "sigma", name, factor, gain=gain), gain - penalty(e, 1))]


def _lasting(r: float, usual: float, pairs: int) -> tuple[float, float]:
    """Correlation of errors (AR(1)) beyond the usual one, and its gain by so many pairs."""
    r = (r - usual) / (1.0 - r * usual)
    return r, -0.5 * pairs * math.log1p(-min(r * r, 0.9999))


def _changes(e: Evidence) -> list[Explanation]:
    """A stretch of frames in which the observations' noise is another one than before and after."""
    squares = np.nansum(e.observations**2, axis=1)
    rows = np.flatnonzero(np.isfinite(e.observations).any(axis=1))
    n = len(e.inputs)
    if len(rows) < 4 * FEWEST:
        return []
    frame = e.inputs.observations.frame[rows]
    cuts = np.unique(np.linspace(0, n, CUTS + 1).astype(int))
    total = np.concatenate([[0.0], np.cumsum(squares[rows])])
    at = np.searchsorted(frame, cuts)
    best = (-math.inf, 0, 0, math.nan)
    for i in range(len(cuts) - 1):
        for j in range(i + 1, len(cuts)):
            inside = int(at[j] - at[i])
            outside = len(rows) - inside
            if inside < FEWEST or outside < FEWEST:
                continue
            within = float(total[at[j]] - total[at[i]]) / (2 * inside)
            rest = float(total[-1] - total[at[j]] + total[at[i]]) / (2 * outside)
            gain = float(of_variance(within, 2 * inside) + of_variance(rest, 2 * outside))
            if gain > best[0] and within > rest:
                best = gain, int(cuts[i]), int(cuts[j]) - 1, math.sqrt(within / rest)
    gain, first, last, factor = best
    finding = Finding(NOISE, "change", "z", factor, gain=gain, frames=((first, last),))
    return [Explanation(finding, gain - penalty(e, 2, CUTS**2))] if math.isfinite(gain) else []


def _correlations(e: Evidence) -> list[Explanation]:
    """Errors of a landmark's observations that are correlated from one frame to the next (AR(1))."""
    before, after = successive(e.residuals.observations, e.inputs.observations.frame, e.used.number)
    if len(before) < 4 * FEWEST:
        return []
    gain, ordered, both = 0.0, 0.0, []
    for i, name in enumerate(COMPONENTS[3:]):
        values = e.observations[:, i]
        a, b = values[before], values[after]
        r, more = _lasting(correlation(a, b), e.lag1.get(name, 0.0), len(before))
        known = values[np.isfinite(values)]
        gain += float(of_variance(float(known.var()), len(known)))
        ordered += more
        both.append(r)
    finding = Finding(NOISE, CORRELATION, "z", max(both), gain=gain + ordered)
    apart = max(both) > 0.0 and ordered > SLIGHT * gain
    return [Explanation(finding, gain + ordered - penalty(e, 4))] if apart else []


def _are_of(e: Evidence, landmark: Explanation) -> bool:
    """Whether heavy tails are those of one landmark: without its observations they gain next to nothing."""
    row = np.flatnonzero(e.used.identity == int(landmark.finding.name))
    others = np.where(np.isin(e.used.number, row)[:, None], np.nan, e.observations)
    gain = [sum(x.finding.gain for x in _tails(e, values)) for values in (others, e.observations)]
    return landmark.net > 0.0 and gain[0] < SAME * gain[1]


def _tails(e: Evidence, observations: Array) -> list[Explanation]:
    """Student's t instead of the Gaussian, for residuals (M, 2) in their usual spread; NaN: not paired."""
    rows = np.flatnonzero(np.isfinite(observations).all(axis=1))
    if len(rows) < 4 * FEWEST:
        return []
    squared = (observations[rows] ** 2).sum(axis=1)
    best = (-math.inf, math.nan)
    for dof in HEAVY:
        scale = 1.0
        for _ in range(20):  # maximum likelihood of the scale, by the EM algorithm of Lange, Little and Taylor (1989)
            weight = (dof + 2.0) / (dof + squared / scale)
            scale = max(float((weight * squared).mean()) / 2.0, 1e-12)
        t = special.gammaln(0.5 * (dof + 2.0)) - special.gammaln(0.5 * dof) - math.log(0.5 * dof * scale)
        likelihood = float(np.sum(t - 0.5 * (dof + 2.0) * np.log1p(squared / (dof * scale)) + 0.5 * squared))
        best = max(best, (likelihood, dof))
    gain, dof = best
    outlying = int((e.residuals.squared > OUTLYING).sum())
    return [Explanation(Finding(NOISE, "tails", "readings", dof, gain=gain, outliers=outlying), gain - penalty(e, 2))]


def _landmarks(e: Evidence) -> list[Explanation]:
    """One landmark whose observations fit worse than all others: moved, or two under one label."""
    rows = np.flatnonzero(np.isfinite(e.observations).all(axis=1))
    number, squared = e.used.number[rows], (e.observations[rows] ** 2).sum(axis=1)
    sums = np.bincount(number, np.minimum(squared, 1e6), minlength=len(e.used.landmarks))
    counts = np.bincount(number, minlength=len(sums))
    gains = np.where(counts >= FEWEST, of_variance(sums / np.maximum(2 * counts, 1), 2 * counts), -np.inf)
    gains = np.where(sums > 2 * counts, gains, -np.inf)
    if not np.isfinite(gains).any():
        return []
    i = int(np.argmax(gains))
    factor = math.sqrt(float(sums[i]) / (2 * int(counts[i])))
    finding = Finding(NOISE, "landmark", str(e.used.identity[i]), factor, gain=float(gains[i]))
    return [Explanation(finding, float(gains[i]) - penalty(e, 1, len(sums)))]


# sources of fixes and closures


def _sigma(e: Evidence, of: OfSource) -> list[Explanation]:
    name = key_of(of.source)
    usual = e.usual.get(name, 0.0)
    if len(of.rows) < FEWEST or not usual > 0.0:
        return []
    return _of_sigma(e, name, math.sqrt(float(of.squared.mean()) / of.dof) / usual, len(of.rows) * of.dof)


def _correlated(e: Evidence, of: OfSource) -> list[Explanation]:
    """Errors that are correlated from one measurement to the next (AR(1))."""
    if len(of.rows) < 2 * FEWEST:
        return []
    name, both, ordered = key_of(of.source), list[float](), 0.0
    for entry, values in zip(entries_of(of.source), of.white.T, strict=True):
        usual = e.lag1.get(f"{name}/{ENTRIES[entry]}", 0.0)
        r, more = _lasting(correlation(values[:-1], values[1:]), usual, len(values) - 1)
        ordered += more
        both.append(r)
    usual = e.usual.get(name, 1.0)
    gain = float(of_variance(float(of.squared.mean()) / of.dof / usual**2, len(of.rows) * of.dof))
    if max(both) <= 0.0 or ordered <= SLIGHT * gain:
        return []
    finding = Finding(NOISE, CORRELATION, name, max(both), gain=gain + ordered)
    return [Explanation(finding, gain + ordered - penalty(e, len(both) + 1))]


MODELLED = (
    "systematic",
    "sigma",
    "change",
    "jump",
    "burst",
    "landmark",
    "mirrored",
)  # kinds whose corrected inputs have a likelihood
FREED = 10.0  # times its mean squared residual, the variance of an increment that jumped: the residual is what is left
UNINFORMATIVE = 1e6
"""Factor of the covariance of a measurement that is left out, so that its variables stay determined."""


def with_noise(inputs: Inputs, factors: Mapping[str, float]) -> Inputs:
    """The inputs with the stated sigmas of components multiplied by factors (correlations stay)."""
    motion = np.array([factors.get(name, 1.0) for name in COMPONENTS[:3]])
    sensor = np.array([factors.get(name, 1.0) for name in COMPONENTS[3:]])
    increments, o = inputs.increments, inputs.observations
    return replace(
        inputs,
        increments=replace(increments, covariance=motion[:, None] * increments.covariance * motion),
        observations=replace(o, R=sensor[:, None] * o.R * sensor),
    )


def corrected(e: Evidence, finding: Finding) -> Inputs:
    """The inputs with an explanation taken into account."""
    if finding.kind == "mirrored":
        o = e.inputs.observations
        return replace(e.inputs, observations=replace(o, z=o.z * [1.0, -1.0]))
    if finding.kind == "systematic":
        return without(e.inputs, e.path, e.used, {finding.name: finding.size})
    if ":" in finding.name:
        # n measurements are worth n (1 - r) / (1 + r)
        correlated = math.sqrt((1.0 + finding.size) / max(1.0 - finding.size, 0.02))
        return with_sigma(e.inputs, finding.name, correlated if finding.kind == CORRELATION else finding.size)
    if finding.kind == "sigma":
        return with_noise(e.inputs, {finding.name: finding.size})
    o, increments = e.inputs.observations, e.inputs.increments
    R, Q = o.R.copy(), increments.covariance.copy()
    if finding.kind == "change":
        squares = np.nansum(e.observations**2, axis=1)
        ((first, last),) = finding.frames
        inside = (o.frame >= first) & (o.frame <= last)
        paired = np.isfinite(e.observations).any(axis=1)
        for part in (inside, ~inside):
            rows = part & paired
            R[part] *= float(squares[rows].sum()) / max(2 * int(rows.sum()), 1)
    elif finding.kind == CORRELATION:
        R *= (1.0 + finding.size) / max(1.0 - finding.size, 0.02)  # n readings are worth n (1 - r) / (1 + r)
    elif finding.kind == "tails":
        squared, dof = (e.observations**2).sum(axis=1), finding.size
        R *= np.nan_to_num(np.maximum((dof + squared) / (dof + 2.0), 0.5), nan=1.0)[:, None, None]
    elif finding.kind in ("landmark", "displaced"):
        row = np.flatnonzero(e.used.identity == int(finding.name))
        R[np.isin(e.used.number, row)] *= UNINFORMATIVE if finding.kind == "displaced" else finding.size**2
    elif finding.kind in ("jump", "burst"):
        for first, last in finding.frames:
            stretch = slice(first, last + 1)
            Q[stretch] *= max(float(np.nanmean(e.odometry[stretch] ** 2)), 1.0) * FREED
    return replace(e.inputs, increments=replace(increments, covariance=Q), observations=replace(o, R=R))


def outlying(of: Sequence[OfSource], inputs: Inputs) -> dict[str, BoolArray]:
    """Outliers of each source that has some, among all fixes (F,) or closures (K,) of the log."""
    found: dict[str, BoolArray] = {}
    for each in of:
        rows = each.rows[each.squared > each.outlying]
        whole = inputs.closures if each.source.of_closures else inputs.fixes
        if len(rows) and whole is not None:
            found[key_of(each.source)] = np.isin(np.arange(len(whole)), rows)
    return found


def left_out(inputs: Inputs, key: str, rows: BoolArray) -> Inputs:
    """The inputs with measurements (F,) or (K,) of a source that say nothing."""
    factor = np.where(rows, UNINFORMATIVE, 1.0)[:, None, None]
    return _scaled(inputs, key, factor)


def with_sigma(inputs: Inputs, key: str, factor: float) -> Inputs:
    """The inputs with the stated sigma of a source multiplied by a factor."""
    (source,) = (s for s in sources_of(inputs) if key_of(s) == key)
    whole = inputs.closures if source.of_closures else inputs.fixes
    assert whole is not None
    squares = np.ones((len(whole), 1, 1))
    squares[source.rows] = factor**2
    return _scaled(inputs, key, squares)


def _scaled(inputs: Inputs, key: str, factor: Array) -> Inputs:
    """Covariances of the fixes, or closures, times factors (n, 1, 1)."""
    if key.startswith(f"{CLOSURE}:"):
        assert inputs.closures is not None
        closures = replace(inputs.closures, covariance=factor * inputs.closures.covariance)
        return replace(inputs, closures=closures)
    assert inputs.fixes is not None
    return replace(inputs, fixes=replace(inputs.fixes, covariance=factor * inputs.fixes.covariance))


def of_outliers(e: Evidence, key: str, count: int, gain: float) -> Explanation:
    """That so many measurements of a source are outliers: its penalty is that of their choice among all."""
    (source,) = (s for s in sources_of(e.inputs) if key_of(s) == key)
    n = len(source.rows)
    choices = special.gammaln(n + 1) - special.gammaln(count + 1) - special.gammaln(n - count + 1)
    return Explanation(
        Finding(NOISE, OUTLIERS, key, float(count), gain=gain, outliers=count), gain - penalty(e, 1) - float(choices)
    )
