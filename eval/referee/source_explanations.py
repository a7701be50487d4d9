"""Explanations of the residuals of fixes and closures, beside those of odometry and observations.

Of each source: another sigma, outliers, and errors that are correlated from one measurement to the next. Systematic
errors of sources are among the columns of `explanations`. Which measurements are outliers is not told at a smoothed
path that bends to them, so `left_out` is found by a robust smoother (`eval.studies.diagnosis`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from data.inputs import Inputs
from data.se2 import Array, BoolArray
from eval.referee.attribution import NOISE, Finding, of_variance
from eval.referee.explanations import (
    CORRELATION,
    FEWEST,
    SLIGHT,
    UNINFORMATIVE,
    Evidence,
    Explanation,
    penalty,
)
from eval.referee.residuals import correlation
from eval.referee.sources.residuals import ENTRIES, OfSource, entries_of, key_of, of_sources
from eval.referee.sources.scored import CLOSURE, sources_of

OUTLIERS = "outliers"


def source_explanations(e: Evidence) -> list[Explanation]:
    """Another sigma, and correlated errors, of each source."""
    found: list[Explanation] = []
    for of in of_sources(e.inputs, e.path, e.used):
        found += [*_sigma(e, of), *_correlated(e, of)]
    return found


def _sigma(e: Evidence, of: OfSource) -> list[Explanation]:
    name = key_of(of.source)
    usual, spread = e.usual.get(name, 0.0), e.certain.get(name, math.nan)
    if len(of.rows) < FEWEST or not (usual > 0.0 and spread > 0.0):
        return []
    factor = math.sqrt(float(of.squared.mean()) / of.dof) / usual
    gain = float(of_variance(factor**2, min(0.5 / spread**2, len(of.rows) * of.dof)))
    return [Explanation(Finding(NOISE, "sigma", name, factor, gain=gain), gain - penalty(e, 1))]


def _correlated(e: Evidence, of: OfSource) -> list[Explanation]:
    """Errors that are correlated from one measurement to the next (AR(1))."""
    if len(of.rows) < 2 * FEWEST:
        return []
    name, both, ordered = key_of(of.source), list[float](), 0.0
    for entry, values in zip(entries_of(of.source), of.white.T, strict=True):
        usual = e.lag1.get(f"{name}/{ENTRIES[entry]}", 0.0)
        r = correlation(values[:-1], values[1:])
        r = (r - usual) / (1.0 - r * usual)
        both.append(r)
        ordered -= 0.5 * (len(values) - 1) * math.log1p(-min(r * r, 0.9999))
    usual = e.usual.get(name, 1.0)
    gain = float(of_variance(float(of.squared.mean()) / of.dof / usual**2, len(of.rows) * of.dof))
    if max(both) <= 0.0 or ordered <= SLIGHT * gain:
        return []
    finding = Finding(NOISE, CORRELATION, name, max(both), gain=gain + ordered)
    return [Explanation(finding, gain + ordered - penalty(e, len(both) + 1))]


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


def source_corrected(e: Evidence, finding: Finding) -> Inputs:
    """The inputs with the sigma, or the correlation, of a source taken into account."""
    factor = finding.size
    if finding.kind == CORRELATION:  # n measurements are worth n (1 - r) / (1 + r)
        factor = math.sqrt((1.0 + finding.size) / max(1.0 - finding.size, 0.02))
    return with_sigma(e.inputs, finding.name, factor)


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
