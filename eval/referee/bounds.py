"""Bounds inside which averages of squared normalized errors lie by chance: chi-square, and behind a gate."""

from __future__ import annotations

import math

from scipy import special

from data.result import Run

LEVEL = 0.95


def chi2_bounds(dof: int, level: float = LEVEL) -> tuple[float, float]:
    """Two-sided interval of a chi-square variable divided by its degrees of freedom."""
    if dof <= 0:
        return math.nan, math.nan
    tail = 0.5 * (1.0 - level)
    return float(special.chdtri(dof, 1.0 - tail) / dof), float(special.chdtri(dof, tail) / dof)


def nis_bounds(dof: int, gated: tuple[float, float] = (1.0, 2.0), level: float = LEVEL) -> tuple[float, float]:
    """Two-sided interval of NIS per degree of freedom, `gated` its mean and variance per degree of freedom.

    The gamma distribution with these moments: without a gate that is chi-square, exactly.
    """
    mean, variance = gated
    if dof <= 0 or mean <= 0.0 or variance <= 0.0:
        return math.nan, math.nan
    shape, scale = mean**2 * dof / variance, variance / mean / dof
    tail = 0.5 * (1.0 - level)
    return float(special.gammaincinv(shape, tail) * scale), float(special.gammaincinv(shape, 1.0 - tail) * scale)


def gated(run: Run, phase: str) -> tuple[float, float]:
    """Mean and variance per degree of freedom of the squared innovations that gates let a right estimator use."""
    return run.gated_final if phase == "final" and run.gated_final is not None else run.gated


def share_interval(hits: int, n: int, level: float = LEVEL) -> tuple[float, float]:
    """Exact interval of a share seen `hits` times in n (Clopper and Pearson, Biometrika 26, 1934)."""
    tail = 0.5 * (1.0 - level)
    lower = float(special.betaincinv(hits, n - hits + 1, tail)) if hits else 0.0
    upper = float(special.betaincinv(hits + 1, n - hits, 1.0 - tail)) if hits < n else 1.0
    return lower, upper


def anees_band(dof: int, runs: int, level: float = LEVEL) -> tuple[float, float]:
    """Band of the per-step average NEES over runs: for a plot (5 % of steps lie outside by design), no verdict."""
    lower, upper = chi2_bounds(dof * runs, level)
    return dof * lower, dof * upper
