"""Explanations of a log's residuals that compete by log-likelihood: systematic errors, noises, jumps, landmarks.

Every explanation is a model of the smoothed residuals with a few parameters more than the stated one. Its gain is the
rise of the log-likelihood, its penalty that of the Bayesian information criterion (Schwarz 1978) and the logarithm of
the number of places it was chosen from. A systematic error, a jump and a displaced landmark are columns of the
linearized problem (`graph.qr.score_test`), so path and map are estimated along.

An explanation declares those that it contains, and stands only where it beats each of them by more than the penalty of
its additional parameters: a vector its components, heavy tails and correlations a scale of the whole sensor, a noise
that changes both.

Of each source of fixes and closures: another sigma, outliers, and errors that are correlated from one measurement to
the next; its systematic errors are among the columns. Which measurements are outliers is not told at a smoothed path
that bends to them, so `left_out` is found by a robust smoother (`eval.studies.diagnosis`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from data.inputs import Inputs, IntArray
from data.se2 import Array, BoolArray
from eval.referee.attribution import NOISE, Finding, of_variance
from eval.referee.consistency import successive
from eval.referee.effects import Effect, Scored, effects, poses_of, score_of, without
from eval.referee.residuals import COMPONENTS, OUTLYING, Residuals, Used, correlation, smoothed_residuals
from eval.referee.sources import CLOSURE, OfSource, key_of, of_sources, sources_of
from graph.qr.score_test import Redundancy, redundancy

ALIKE = 3.0  # Log-likelihood within which two explanations cannot be told apart: odds of 20
SURELY = 3.0  # standard errors
SAME = 0.25  # largest share of its gain that an indistinguishable explanation keeps beside the other
PLACES = 3  # frames, stretches and landmarks whose columns are formed: those with the largest residuals
SPREAD = 3  # frames on either side of the largest residual of odometry that may be those of a jump
LENGTHS = (5, 10, 20, 40)  # frames of a burst
CUTS = 24  # instants between which the noise may change
CORRELATION, OUTLIERS = "correlation", "outliers"
NOISES = ("sigma", "change", CORRELATION, "tails")
HEAVY = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0)  # dof of Student's t
WHOLE = {"odometry": COMPONENTS[:3], "z": COMPONENTS[3:]}  # components with one factor together
SCALE, TAILS = "sigma z", "tails readings"
ALIKE_WHEELS = "odometry_scale"
VECTORS: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "mount": (("mount_x",), ("mount_y",)), "bias": (("z1_constant",), ("z2_constant",)),
    ALIKE_WHEELS: (("odometry_x_distance", "odometry_theta_turn"),),
    "odometry_wheels": (("odometry_x_distance", "odometry_theta_turn"), ("odometry_theta_distance",)),
    "odometry_current": (("odometry_current_x",), ("odometry_current_y",)), "lever": (("lever_x",), ("lever_y",)),
    "offset": (("x",), ("y",)),
}  # fmt: skip
"""Systematic errors that one cause makes together; those of one column have one size. Wheels that are smaller than
stated, both alike (`odometry_scale`) or not, overstate ways and turns; two that differ curve."""
LENGTHS_OF = ("mount", "lever", "offset", "odometry_current")  # vectors with one length
TINY = 1e-300  # least variance that is divided by
REDUNDANT = 0.05  # Least share of its stated variance that a residual has which counts
FEWEST = 8  # observations of a landmark, or of a stretch


@dataclass(frozen=True)
class Explanation:
    """One explanation with the logarithm of its odds against the stated model, already penalized."""

    finding: Finding
    net: float
    effects: tuple[int, ...] = ()  # its columns among the hypotheses of the score, if it has some
    contains: tuple[str, ...] = ()  # `Finding.said` of its special cases
    beyond: float = math.inf  # its net over that of the best of them, where it is computed otherwise than `net`


@dataclass(frozen=True, eq=False)
class Evidence:
    """What explanations are formed from: a smoother's path (N, 3), its pairings, residuals and their covariances."""

    inputs: Inputs
    path: Array
    used: Used
    residuals: Residuals
    pairs: tuple[IntArray, IntArray]  # rows (q,), (q,) of a landmark's observations in successive frames
    redundancy: Redundancy

    @property
    def observations(self) -> Array:
        """Residuals (M, 2), independent and of unit variance if all is as stated; NaN where hardly redundant."""
        found, sigma = self.residuals.observations, np.sqrt(np.einsum("mii->mi", self.inputs.observations.R))
        size, axes = np.linalg.eigh(self.redundancy.observations / np.einsum("mi,mj->mij", sigma, sigma))
        root = axes / np.sqrt(np.maximum(size, REDUNDANT))[:, None]
        white = np.einsum("mik,mjk,mj->mi", root, axes, np.nan_to_num(found))
        return np.where(np.isfinite(found) & (size[:, :1] > REDUNDANT), white, np.nan)

    @property
    def odometry(self) -> Array:
        """The same of odometry (N, 3), each component by itself."""
        own, stated = (np.einsum("nii->ni", C) for C in (self.redundancy.odometry, self.inputs.increments.covariance))
        known = (own > REDUNDANT * stated) & (stated > 0.0)
        share = np.divide(own, stated, out=np.ones_like(own), where=known)
        return np.where(known, self.residuals.odometry / np.sqrt(share), np.nan)

    def dof(self, i: int) -> float:
        """Degrees of freedom of a component, by its place in `COMPONENTS`."""
        whole = (self.redundancy.odometry, self.inputs.increments.covariance, self.odometry)
        if i >= 3:
            whole = (self.redundancy.observations, self.inputs.observations.R, self.observations)
        i -= 3 * (i >= 3)
        known = np.isfinite(whole[2][:, i])
        return float(np.sum(whole[0][known, i, i] / whole[1][known, i, i]))


def evidence_of(inputs: Inputs, path: Array, used: Used) -> Evidence:
    """The evidence of a smoothed path (N, 3)."""
    found = smoothed_residuals(inputs, path, used)
    pairs = successive(found.observations, inputs.observations.frame, used.number)
    own = redundancy(inputs, used.number, path, used.landmarks, pairs, poses_of(inputs, used))
    return Evidence(inputs, path, used, found, pairs, own)


def explanations(e: Evidence, taken: Sequence[str]) -> list[Explanation]:
    """All explanations of the residuals, the best first; `taken`: systematic errors that are estimated already."""
    landmarks, spreads = _landmarks(e), _spreads(e)
    tails, even = _tails(e, e.observations)
    for x in landmarks:  # are the tails those of one landmark, without whose observations they gain next to nothing?
        own = np.isin(e.used.number, np.flatnonzero(e.used.identity == int(x.finding.name)))
        gain = sum(t.finding.gain for t in _tails(e, np.where(own[:, None], np.nan, e.observations))[0])
        tails = [] if x.net > 0.0 and gain < SAME * sum(t.finding.gain for t in tails) else tails
    scale = max((x.net for x in spreads if x.finding.said == SCALE), default=0.0)
    found = [*_linear(e, taken), *spreads, *_changes(e, even), *_correlations(e, scale), *tails, *landmarks]
    for of in of_sources(e.inputs, e.path, e.used):
        found += [*_sigma(e, of), *_correlated(e, of)]
    net = {x.finding.said: x.net for x in found}
    found = [x for x in found if x.beyond > 0.0 and all(x.net > net.get(name, -math.inf) for name in x.contains)]
    return sorted((x for x in found if math.isfinite(x.net)), key=lambda x: -x.net)


def excess(e: Evidence, name: str) -> float:
    """Variance of the residuals that an error shows in, over the expected one, times what correlation adds: at least 1.

    Where noise is larger than stated, or lasts, the gain of a systematic error is so many times too large.
    """
    if ":" in name:
        return 1.0
    values = e.odometry if name.startswith("odometry") else e.observations
    larger = float(np.nanmean(values**2)) if np.isfinite(values).any() else 1.0
    for x in [] if name.startswith("odometry") else _correlations(e, 0.0):
        larger *= (1.0 + x.finding.size) / max(1.0 - x.finding.size, 0.02)
    return max(larger, 1.0)


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
    every = effects(e.inputs, e.path, e.used)
    known, plain = ([x for x in every if (x.name in taken) is there] for there in (True, False))
    groups: list[tuple[Finding, tuple[Effect, ...], int]]
    groups = [(Finding(NOISE, "systematic", x.name, math.nan), (x,), 1) for x in plain]
    vectors = _vectors(plain)
    groups += [(Finding(NOISE, "systematic", name, math.nan), columns, 1) for name, (columns, _) in vectors.items()]
    groups += [*_jumps(e), *_bursts(e), *(_displaced(e) if e.inputs.known_points is not None else [])]
    hypotheses = list({x.name: x for x in (*known, *(x for _, columns, _ in groups for x in columns))}.values())
    scored = score_of(e.inputs, e.path, e.used, hypotheses)
    place = {x.name: i for i, x in enumerate(hypotheses)}
    left = Scored(scored.names, scored.score.given(np.arange(len(known))) if known else scored.score)
    found = []
    for finding, columns, places in groups:
        own = np.array([place[x.name] for x in columns])
        gain = _gain(left, own)
        if not gain > 0.0:
            continue
        sizes, errors = left.together(own)
        if finding.name == "odometry_integration" and abs(sizes[0]) > 1.0 + SURELY * errors[0]:
            continue  # all of a turn before its way, or all after it, is a share of 1: it is a displaced sensor
        i = int(np.argmax(np.abs(sizes[:2]))) if finding.kind == "jump" else 0
        length = finding.kind in ("jump", "displaced") or finding.name.rpartition("/")[2] in LENGTHS_OF
        size = float(np.hypot(*sizes[:2])) if length and len(own) > 1 else float(sizes[i])
        error = float(errors[i])
        if finding.kind == "displaced":
            if not _nearer(e, finding.name, sizes):
                continue  # across the line of sight, as of ranges from one place
            error = float(np.hypot(*(sizes * errors))) / size  # along the displacement
        named, contains = replace(finding, size=size, error=error, gain=gain), tuple[str, ...]()
        if finding.name in vectors:
            parts = tuple(
                _named(names, s, error)
                for names, s, error in zip(vectors[finding.name][1], sizes.tolist(), errors.tolist(), strict=True)
            )
            named = replace(named, parts=parts if len(parts) > 1 else parts[0].parts)
            contains = tuple(f"systematic {x.name}" for x in columns if x.name != finding.name)
        if finding.kind == "jump":
            axes = (int(x.name.rpartition("_")[2]) for x in columns)
            named = replace(
                named, parts=tuple(_named([COMPONENTS[i]], s, 0.0) for i, s in zip(axes, sizes.tolist(), strict=True))
            )
        found.append(Explanation(named, gain - penalty(e, len(columns), places), tuple(own.tolist()), contains))
    return [replace(x, finding=replace(x.finding, other=_ties(x, found, left))) for x in found]


def _vectors(plain: Sequence[Effect]) -> dict[str, tuple[tuple[Effect, ...], tuple[tuple[str, ...], ...]]]:
    """Columns, and names of the parts of each, of the vectors whose parts the log can all show."""
    by_name = {x.name: x for x in plain}
    found = {}
    for source in dict.fromkeys(x.name.rpartition("/")[0] for x in plain):
        before = f"{source}/" if source else ""
        for vector, names in VECTORS.items():
            parts = tuple(tuple(before + name for name in column) for column in names)
            if all(name in by_name for column in parts for name in column):
                found[before + vector] = tuple(_together([by_name[name] for name in own]) for own in parts), parts
    return found


def _named(names: Sequence[str], size: float, error: float) -> Finding:
    """A systematic error of one size; of several names it is a vector itself."""
    parts = tuple(Finding(NOISE, "systematic", name, size, error) for name in names)
    return parts[0] if len(parts) == 1 else Finding(NOISE, "systematic", ALIKE_WHEELS, size, error, parts=parts)


def _together(own: Sequence[Effect]) -> Effect:
    """Effects of one size; several are of odometry."""
    motions = [x.motion for x in own if x.motion is not None]
    return own[0] if len(own) == 1 else Effect(ALIKE_WHEELS, motion=np.sum(motions, axis=0))


def _gain(scored: Scored, own: IntArray) -> float:
    """Rise of the log-likelihood by all columns `own` together."""
    s, information = scored.score.score[own], scored.score.information[np.ix_(own, own)]
    return 0.5 * float(s @ np.linalg.pinv(information, rcond=1e-9, hermitian=True) @ s)


def _ties(best: Explanation, found: Sequence[Explanation], scored: Scored) -> tuple[str, ...]:
    """Systematic errors that explain the same as well: they gain next to nothing beside the best one."""
    beside = Scored(scored.names, scored.score.given(np.array(best.effects, np.int64)))
    return tuple(
        x.finding.name for x in found if x is not best and x.finding.kind == "systematic" and x.net > best.net - ALIKE
        and best.finding.said not in x.contains and x.finding.said not in best.contains
        and _gain(beside, np.array(x.effects)) < SAME * x.finding.gain
    )  # fmt: skip


def _largest(values: Array, apart: int) -> list[int]:
    """Places of the largest values (N,), NaN left out, at least `apart` from each other."""
    chosen: list[int] = []
    for k in np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")[: 20 * PLACES].tolist():
        if math.isfinite(values[k]) and all(abs(k - other) >= apart for other in chosen):
            chosen.append(k)
    return chosen[:PLACES]


def _jumps(e: Evidence) -> list[tuple[Finding, tuple[Effect, ...], int]]:
    """Frames around the largest residuals of odometry (a smoother spreads a jump), each with an own increment."""
    odometry = e.odometry
    squared = np.where(np.isfinite(odometry).any(axis=1), np.nansum(odometry**2, axis=1), np.nan)
    found = []
    largest = _largest(squared, 2)
    around = [k for at in largest[:1] for k in range(max(at - SPREAD, 1), min(at + SPREAD + 1, len(squared)))]
    for k in (k for k in dict.fromkeys([*largest, *around]) if math.isfinite(squared[k])):
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
        for count in range(1, len(columns) + 1):  # one burst, two, and so on: of the same length each
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
        found.append((Finding(NOISE, "displaced", str(e.used.identity[landmark]), math.nan), tuple(columns), len(sums)))
    return found


def _nearer(e: Evidence, name: str, by: Array) -> bool:
    """Whether the observations of a landmark fit better with it moved by (2,), beyond linear terms, too."""
    o, k = e.inputs.observations, int(np.flatnonzero(e.used.identity == int(name))[0])
    own = np.flatnonzero(e.used.number == k)
    sensor, path, place = e.inputs.sensor_of(own), e.path[o.frame[own]], e.used.landmarks[k]
    off = [sensor.residual(o.z[own], sensor.predict(path, np.tile(at, (len(own), 1)))) for at in (place, place + by)]
    before, after = (np.einsum("ki,kij,kj->", d, np.linalg.inv(o.R[own]), d) for d in off)
    return bool(after < before)


# noises


def _spreads(e: Evidence) -> list[Explanation]:
    """Another sigma of one component, or of a whole sensor, for the whole log; its dof are redundancies."""
    squares = {}
    for i, (name, values) in enumerate(zip(COMPONENTS, [*e.odometry.T, *e.observations.T], strict=True)):
        known = values[np.isfinite(values)]
        if len(known) >= FEWEST:
            squares[name] = float(np.mean(known**2)), e.dof(i)
    found = [_of_sigma(e, name, [own]) for name, own in squares.items()]
    for whole, names in WHOLE.items():
        own = [squares[name] for name in names if name in squares]
        found += [_of_sigma(e, whole, own)] if len(own) > 1 else []
    return found


def _of_sigma(e: Evidence, name: str, squares: Sequence[tuple[float, float]]) -> Explanation:
    """One factor of the sigma of all components with these mean squares, over the expected ones, and dof."""
    F = sum(f * dof for f, dof in squares) / sum(dof for _, dof in squares)
    gain = sum(0.5 * dof * (f - f / F - math.log(F)) for f, dof in squares) if F > 0.0 else 0.0
    return Explanation(Finding(NOISE, "sigma", name, math.sqrt(F), gain=gain), gain - penalty(e, 1))


def _lasting(r: float, usual: float, pairs: int) -> tuple[float, float]:
    """Correlation of errors (AR(1)) beyond the usual one, and its gain by so many pairs."""
    r = (r - usual) / (1.0 - r * usual)
    return r, -0.5 * pairs * math.log1p(-min(r * r, 0.9999))


def _changes(e: Evidence, even: Array) -> list[Explanation]:
    """A stretch of larger noise than stated, and than before and after, which `even` squares (M,) show, too."""
    rows = np.flatnonzero(np.isfinite(e.observations).any(axis=1))
    n = len(e.inputs)
    if len(rows) < 4 * FEWEST:
        return []
    frame = e.inputs.observations.frame[rows]
    cuts = np.unique(np.linspace(0, n, CUTS + 1).astype(int))
    i, j = np.triu_indices(len(cuts), 1)
    at = np.searchsorted(frame, cuts)
    dof = np.isfinite(e.observations).sum(axis=1)[rows]
    sums = [np.concatenate([[0.0], np.cumsum(v)]) for v in (np.nansum(e.observations**2, 1)[rows], even[rows], dof)]
    (own, alike, inside), (_, all_alike, every) = ([v[at[j]] - v[at[i]] for v in sums], [float(v[-1]) for v in sums])
    fits = (inside >= 2 * FEWEST) & (every - inside >= 2 * FEWEST)
    i, j, own, alike, inside = (v[fits] for v in (i, j, own, alike, inside))
    if not len(i):
        return []
    within, rest = alike / inside, (all_alike - alike) / (every - inside)
    apart = of_variance(within, inside) + of_variance(rest, every - inside) - of_variance(all_alike / every, every)
    gain = np.where((within > rest) & (own > inside), of_variance(own / inside, inside), -np.inf)
    k = int(np.argmax(gain))
    frames = int(cuts[i[k]]), int(cuts[j[k]]) - 1
    finding = Finding(NOISE, "change", "z", math.sqrt(own[k] / inside[k]), gain=float(gain[k]), frames=(frames,))
    net, beyond = (float(g[k]) - penalty(e, 1, CUTS**2) for g in (gain, apart))
    return [Explanation(finding, net, (), (SCALE, TAILS), beyond)]


def _correlations(e: Evidence, alike: float) -> list[Explanation]:
    """Errors of a landmark that are correlated over frames (AR(1)), if they gain more than `alike`."""
    before, after = e.pairs
    if len(before) < 4 * FEWEST:
        return []
    sigma = np.sqrt(np.maximum(np.einsum("mii->mi", e.redundancy.observations), 0.0))
    scale = np.maximum(sigma[before] * sigma[after], TINY)
    usual = np.where(np.isfinite(e.observations[before]), np.einsum("qii->qi", e.redundancy.successive) / scale, np.nan)
    lasting = [
        _lasting(correlation(values[before], values[after]), float(np.nanmean(own)), len(before))
        for values, own in zip(e.observations.T, usual.T, strict=True) if np.isfinite(values[before]).any()
    ]  # fmt: skip
    if not lasting:
        return []
    r, ordered = max(r for r, _ in lasting), sum(more for _, more in lasting)
    beyond = ordered - penalty(e, 2)
    finding = Finding(NOISE, CORRELATION, "z", r, gain=max(alike, 0.0) + ordered)
    apart = r > 0.0 and beyond > max(alike, 0.0)
    return [Explanation(finding, max(alike, 0.0) + beyond, (), (SCALE,), beyond)] if apart else []


def _tails(e: Evidence, observations: Array) -> tuple[list[Explanation], Array]:
    """Student's t instead of the Gaussian, for residuals (M, 2) in their sigmas and squares (M,)."""
    rows = np.flatnonzero(np.isfinite(observations).all(axis=1))
    even = np.nansum(observations**2, axis=1)
    if len(rows) < 4 * FEWEST:
        return [], even
    squared = even[rows]

    def likelihood(dof: float, scale: float) -> float:
        t = special.gammaln(0.5 * (dof + 2.0)) - special.gammaln(0.5 * dof) - math.log(0.5 * dof * scale)
        return float(np.sum(t - 0.5 * (dof + 2.0) * np.log1p(squared / (dof * scale)) + 0.5 * squared))

    free, best = (-math.inf, math.nan, math.nan), (-math.inf, math.nan)
    for dof in HEAVY:
        scale = 1.0
        for _ in range(20):  # maximum likelihood of the scale, by the EM algorithm of Lange, Little and Taylor (1989)
            weight = (dof + 2.0) / (dof + squared / scale)
            scale = max(float((weight * squared).mean()) / 2.0, 1e-12)
        free = max(free, (likelihood(dof, scale), dof, scale))
        best = max(best, *((likelihood(dof, s), dof) for s in (1.0, 1.0 - 2.0 / dof) if s > 0.0))
    beyond = free[0] - float(of_variance(float(squared.mean()) / 2.0, 2 * len(squared))) - penalty(e, 1)
    if beyond > 0.0:
        even = free[1] * np.log1p(even / (free[1] * free[2]))
    gain, dof = best
    finding = Finding(NOISE, "tails", "readings", dof, gain=gain, outliers=int((e.residuals.squared > OUTLYING).sum()))
    return [Explanation(finding, gain - penalty(e, 2), (), (SCALE,), beyond)], even


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
    dof = _dof(e, of)
    if len(of.rows) < FEWEST or not dof > REDUNDANT * of.squared.size:
        return []
    return [_of_sigma(e, key_of(of.source), [(float(of.squared.sum()) / dof, dof)])]


def _dof(e: Evidence, of: OfSource) -> float:
    """Degrees of freedom of the residuals of a source."""
    return float((e.redundancy.closures if of.source.of_closures else e.redundancy.fixes)[of.rows].sum())


def _correlated(e: Evidence, of: OfSource) -> list[Explanation]:
    """Errors that are correlated from one measurement to the next (AR(1))."""
    if len(of.rows) < 2 * FEWEST:
        return []
    name, both, ordered = key_of(of.source), list[float](), 0.0
    for values in of.white.T:
        r, more = _lasting(correlation(values[:-1], values[1:]), 0.0, len(values) - 1)
        ordered += more
        both.append(r)
    dof = max(_dof(e, of), REDUNDANT)
    gain = float(of_variance(float(of.squared.sum()) / dof, dof))
    if max(both) <= 0.0 or ordered <= gain:
        return []
    finding = Finding(NOISE, CORRELATION, name, max(both), gain=gain + ordered)
    return [Explanation(finding, gain + ordered - penalty(e, len(both) + 1))]


MODELLED = ("systematic", "sigma", "change", "jump", "burst", "landmark", "mirrored")
"""Kinds whose corrected inputs have a likelihood."""
FREED = 10.0  # times its mean squared residual, the variance of an increment that jumped: the residual is what is left
UNINFORMATIVE = 1e6  # Factor of the covariance of a measurement that is left out, so that its variables stay determined


def corrected(e: Evidence, finding: Finding) -> Inputs:
    """The inputs with an explanation taken into account."""
    if finding.kind == "systematic":
        return without(e.inputs, e.path, e.used, finding.sizes)
    F = finding.size**2  # n measurements are worth n (1 - r) / (1 + r)
    if finding.kind == CORRELATION:
        F = (1.0 + finding.size) / max(1.0 - finding.size, 0.02)
    if ":" in finding.name:
        (source,) = (s for s in sources_of(e.inputs) if key_of(s) == finding.name)
        return _scaled(e.inputs, finding.name, source.rows, F)
    o, increments = e.inputs.observations, e.inputs.increments
    z, R, Q, mean = o.z, o.R.copy(), increments.covariance.copy(), increments.mean.copy()
    if finding.kind == "mirrored":
        z = z * [1.0, -1.0]
    elif finding.kind == "sigma":
        names = WHOLE.get(finding.name, (finding.name,))
        motion, sensor = (np.where(np.isin(of, names), finding.size, 1.0) for of in WHOLE.values())
        Q, R = motion[:, None] * Q * motion, sensor[:, None] * R * sensor
    elif finding.kind == "change":
        ((first, last),) = finding.frames
        R[(o.frame >= first) & (o.frame <= last)] *= F
    elif finding.kind == CORRELATION:
        R *= F
    elif finding.kind == "tails":
        squared, dof = (e.observations**2).sum(axis=1), finding.size
        R *= np.nan_to_num(np.maximum((dof + squared) / (dof + 2.0), 0.5), nan=1.0)[:, None, None]
    elif finding.kind in ("landmark", "displaced"):
        row = np.flatnonzero(e.used.identity == int(finding.name))
        R[np.isin(e.used.number, row)] *= UNINFORMATIVE if finding.kind == "displaced" else F
    elif finding.kind in ("jump", "burst"):
        if finding.kind == "jump":  # a filter would linearize it at the place where the robot is not
            mean[finding.frames[0][0]] -= [finding.sizes.get(name, 0.0) for name in COMPONENTS[:3]]
        for first, last in finding.frames:
            stretch = slice(first, last + 1)
            Q[stretch] *= max(float(np.nanmean(e.odometry[stretch] ** 2)), 1.0) * FREED
    increments = replace(increments, mean=mean, covariance=Q)
    return replace(e.inputs, increments=increments, observations=replace(o, z=z, R=R))


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
    return _scaled(inputs, key, rows, UNINFORMATIVE)


def _scaled(inputs: Inputs, key: str, rows: IntArray | BoolArray, factor: float) -> Inputs:
    """Covariances of some fixes, or closures, times a factor."""
    name = "closures" if key.startswith(f"{CLOSURE}:") else "fixes"
    whole = getattr(inputs, name)
    covariance = whole.covariance.copy()
    covariance[rows] *= factor
    changed: dict[str, Any] = {name: replace(whole, covariance=covariance)}
    return replace(inputs, **changed)


def of_outliers(e: Evidence, key: str, count: int, gain: float) -> Explanation:
    """That so many measurements of a source are outliers: its penalty is that of their choice among all."""
    (source,) = (s for s in sources_of(e.inputs) if key_of(s) == key)
    n = len(source.rows)
    choices = special.gammaln(n + 1) - special.gammaln(count + 1) - special.gammaln(n - count + 1)
    return Explanation(
        Finding(NOISE, OUTLIERS, key, float(count), gain=gain, outliers=count), gain - penalty(e, 1) - float(choices)
    )
