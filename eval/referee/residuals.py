"""Smoothed residuals: what prior, odometry and readings say less what the smoother makes of them all, in stated sigmas.

A smoothed residual has covariance R - H P H', not R (H P H': what the smoother knows of the reading), so its spread is
below 1 by an amount that only the log's own geometry tells: twins of the log are its reference. Its mean and its slope
against distance, turn, speed or range are where a bias or a scale error shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from data import se2
from data.inputs import Inputs, IntArray
from data.result import Run
from data.se2 import Array, BoolArray
from eval.referee.consistency import successive

COMPONENTS = ("odometry_x", "odometry_y", "odometry_theta", "z1", "z2")
OUTLYING = float(special.chdtri(2, 1e-5))
"""Squared residual (2 dof) of a reading that does not fit its landmark: 1 in 100 000, some 23."""
FITTING = float(special.chdtri(2, 0.01))
"""Squared residual inside which a reading fits another landmark: 99 %."""


@dataclass(frozen=True, eq=False)
class Used:
    """The readings that a smoother used, for which landmarks, and where those are.

    Attributes:
        number: (M,) row of `landmarks` for every observation of the log, -1 for one that was not used.
        landmarks: (L, 2).
        identity: (L,) landmark numbers, in localization the map's ids.
    """

    number: IntArray
    landmarks: Array
    identity: IntArray


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals in stated sigmas, each component by itself.

    Attributes:
        odometry: (N, 3) by frame, in the body frame before; NaN in the first and where the stated variance is 0.
        readings: (M, 2), NaN where not used.
        squared: (M,) squared distance of each reading under its covariance R, NaN where not used.
    """

    odometry: Array
    readings: Array
    squared: Array


def used_by(run: Run, inputs: Inputs) -> Used:
    """What a smoother's run used; `inputs` has the map in localization and none in SLAM."""
    final = run.final_decisions
    initialized = run.initialized
    number = np.where(initialized >= 0, initialized, final)
    if inputs.map is not None:
        identity, xy = inputs.map.id, inputs.map.xy
    elif run.map is not None:
        identity, xy = run.map.number, run.map.xy
    else:
        identity, xy = np.empty(0, np.int64), np.empty((0, 2))
    row = np.full(int(max(number.max(initial=-1), identity.max(initial=-1))) + 1, -1, np.int64)
    row[identity] = np.arange(len(identity))
    return Used(np.where(number >= 0, row[np.maximum(number, 0)] if len(row) else -1, -1), xy, identity)


def smoothed_residuals(inputs: Inputs, path: Array, used: Used) -> Residuals:
    """Residuals of increments and readings at a smoothed path (N, 3) and its landmarks."""
    n, m = len(inputs), len(used.number)
    odometry = np.full((n, 3), np.nan)
    off = inputs.increments.mean[1:] - se2.between(path[:-1], path[1:])
    off[:, 2] = se2.wrap_angle(off[:, 2])
    sigma = np.sqrt(np.einsum("nii->ni", inputs.increments.covariance[1:]))
    np.divide(off, sigma, out=odometry[1:], where=sigma > 0.0)
    readings, squared = np.full((m, 2), np.nan), np.full(m, np.nan)
    rows = np.flatnonzero(used.number >= 0)
    if len(rows):
        o = inputs.observations
        expected = inputs.sensor.predict(path[o.frame[rows]], used.landmarks[used.number[rows]])
        nu = inputs.sensor.residual(o.z[rows], expected)
        readings[rows] = nu / np.sqrt(np.einsum("mii->mi", o.R[rows]))
        squared[rows] = np.einsum("mi,mi->m", nu, np.linalg.solve(o.R[rows], nu[:, :, None])[:, :, 0])
    return Residuals(odometry, readings, squared)


def summaries(residuals: Residuals, inputs: Inputs, used: Used) -> dict[str, float]:
    """Mean, spread, lag-1 correlation and largest of each component's residuals, by name of the statistic.

    Lag 1 is from one frame to the next, of a reading from its landmark's reading in the frame before; the correlation
    is about the mean. A component without any variation has only its mean and its spread.
    """
    series = [residuals.odometry[:, i] for i in range(3)] + [residuals.readings[:, i] for i in range(2)]
    frames = np.arange(len(inputs) - 1)
    pairs = [(frames, frames + 1)] * 3 + [successive(residuals.readings, inputs.observations.frame, used.number)] * 2
    result: dict[str, float] = {}
    for name, values, (before, after) in zip(COMPONENTS, series, pairs, strict=True):
        known = values[np.isfinite(values)]
        if len(known) < 2:
            continue
        mean, spread = float(known.mean()), float(known.std())
        result[f"residual_{name}_mean"], result[f"residual_{name}_spread"] = mean, spread
        result[f"residual_{name}_lag1"] = _correlation(values[before] - mean, values[after] - mean)
        result[f"residual_{name}_largest"] = float(np.abs(known).max())
    return {name: value for name, value in result.items() if math.isfinite(value)}


def typical(residuals: Residuals, *, outliers: bool = False) -> dict[str, float]:
    """By component, the spread of the residuals about their mean; `outliers`: with the readings that do not fit."""
    kept = np.isfinite(residuals.squared) if outliers else residuals.squared <= OUTLYING
    series = [*residuals.odometry.T, *np.where(kept[:, None], residuals.readings, np.nan).T]
    known = [values[np.isfinite(values)] for values in series]
    return {name: float(values.std()) for name, values in zip(COMPONENTS, known, strict=True) if len(values)}


def _correlation(before: Array, after: Array) -> float:
    both = np.isfinite(before) & np.isfinite(after)
    a, b = before[both], after[both]
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale > 0.0 else math.nan


def misfits(inputs: Inputs, path: Array, used: Used, residuals: Residuals) -> tuple[int, int, float]:
    """How many readings do not fit their landmark, how many of those fit another one, and half their excess squares.

    A wrong pairing leaves a reading that another landmark explains; an outlier of the sensor is explained by none.
    """
    outlying: BoolArray = residuals.squared > OUTLYING
    elsewhere = 0
    o = inputs.observations
    for i in np.flatnonzero(outlying):
        expected = inputs.sensor.predict(path[o.frame[i]], used.landmarks)
        nu = inputs.sensor.residual(o.z[i], expected)
        squared = np.einsum("li,li->l", nu, np.linalg.solve(o.R[i], nu.T).T)
        squared[used.number[i]] = np.inf
        elsewhere += bool(squared.min(initial=np.inf) < FITTING)
    return int(outlying.sum()), elsewhere, 0.5 * float(np.sum(residuals.squared[outlying] - FITTING))
