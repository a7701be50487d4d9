"""Smoothed residuals of odometry and observations, in stated sigmas.

A smoothed residual has covariance R - H P H', so its spread is below 1 by an amount that depends on the log: bootstrap
replicates are its reference. Biases and scale errors show in its mean and its slopes.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from data import se2
from data.inputs import Inputs, IntArray
from data.result import Run
from data.se2 import Array, BoolArray
from eval.referee.consistency import squares, successive
from eval.referee.errors import observed

COMPONENTS = ("odometry_x", "odometry_y", "odometry_theta", "z1", "z2")
OUTLYING = float(special.chdtri(2, 1e-5))  # squared residual (2 dof) of an outlier: exceeded by 1 in 100 000, about 23
FITTING = float(special.chdtri(2, 0.01))  # squared residual inside which an observation fits another landmark: 99 %


@dataclass(frozen=True, eq=False)
class Used:
    """The pairings of a run's last map, and the fixes and closures that it stands on."""

    number: IntArray  # (M,) row of `landmarks` for every observation of the log; -1: not paired
    landmarks: Array  # (L, 2)
    identity: IntArray  # (L,) landmark numbers; in localization the map's ids
    fixes: BoolArray | None = None  # (F,) which of the log's fixes were used; None: none
    closures: BoolArray | None = None  # (K,) the same of its closures


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals in stated sigmas, each component by itself."""

    odometry: Array  # (N, 3) in the previous body frame; NaN in the first frame and where the stated variance is 0
    observations: Array  # (M, 2), NaN where not paired
    squared: Array  # (M,) squared distance under R, NaN where not paired


def used_by(run: Run, inputs: Inputs) -> Used:
    """The pairings of a run by its final decisions; `inputs` has the map in localization and none in SLAM."""
    number = observed(run)
    if inputs.map is not None and run.map is None:
        identity, xy = inputs.map.id, inputs.map.xy
    else:
        m = run.map
        identity, xy = (np.empty(0, np.int64), np.empty((0, 2))) if m is None else (m.number, m.xy)
    row = np.full(len(number), -1, np.int64)
    known = np.isin(number, identity)
    order = np.argsort(identity)
    row[known] = order[np.searchsorted(identity, number[known], sorter=order)]
    fixes, closures = run.fixes_final or run.fixes, run.closures_final or run.closures
    return Used(row, xy, identity, None if fixes is None else fixes.used, None if closures is None else closures.used)


def smoothed_residuals(inputs: Inputs, path: Array, used: Used) -> Residuals:
    """Residuals at a smoothed path (N, 3) and its landmarks."""
    n, m = len(inputs), len(used.number)
    odometry = np.full((n, 3), np.nan)
    off = inputs.increments.mean[1:] - se2.between(path[:-1], path[1:])
    off[:, 2] = se2.wrap_angle(off[:, 2])
    sigma = np.sqrt(np.einsum("nii->ni", inputs.increments.covariance[1:]))
    np.divide(off, sigma, out=odometry[1:], where=sigma > 0.0)
    observations, squared = np.full((m, 2), np.nan), np.full(m, np.nan)
    rows = np.flatnonzero(used.number >= 0)
    if len(rows):
        o = inputs.observations
        sensor = inputs.sensor_of(rows)
        nu = sensor.residual(o.z[rows], sensor.predict(path[o.frame[rows]], used.landmarks[used.number[rows]]))
        observations[rows] = np.where(inputs.measured(rows), nu / np.sqrt(np.einsum("mii->mi", o.R[rows])), np.nan)
        squared[rows] = squares(nu, o.R[rows])
    return Residuals(odometry, observations, squared)


def summaries(residuals: Residuals, inputs: Inputs, used: Used) -> dict[str, float]:
    """Mean, spread, lag-1 correlation about the mean, and maximum of each component, by name of the statistic. Lag 1 is
    from a frame to the next; for observations from the same landmark's in the previous frame.
    """
    series = [*residuals.odometry.T, *residuals.observations.T]
    frames = np.arange(len(inputs) - 1)
    again = successive(residuals.observations, inputs.observations.frame, used.number)
    pairs = [(frames, frames + 1)] * 3 + [again] * 2
    result: dict[str, float] = {}
    for name, values, (before, after) in zip(COMPONENTS, series, pairs, strict=True):
        result |= described(name, values, before, after)
    return result


def described(name: str, values: Array, before: IntArray | slice, after: IntArray | slice) -> dict[str, float]:
    """Statistics of one component, of which the rows `before` precede those `after`; NaN values are left out."""
    known = values[np.isfinite(values)]
    if len(known) < 2:
        return {}
    mean = float(known.mean())
    lag1 = correlation(values[before] - mean, values[after] - mean)
    found = {"mean": mean, "spread": float(known.std()), "lag1": lag1, "largest": float(np.abs(known).max())}
    return {f"residual_{name}_{what}": value for what, value in found.items() if math.isfinite(value)}


def typical(residuals: Residuals) -> dict[str, float]:
    """Spread of the residuals about their mean by component, without those above `OUTLYING`."""
    kept = residuals.squared <= OUTLYING
    series = [*residuals.odometry.T, *np.where(kept[:, None], residuals.observations, np.nan).T]
    known = [values[np.isfinite(values)] for values in series]
    return {name: float(values.std()) for name, values in zip(COMPONENTS, known, strict=True) if len(values)}


def correlation(before: Array, after: Array) -> float:
    """Correlation of values (n,) about zero; NaN: too few."""
    both = np.isfinite(before) & np.isfinite(after)
    a, b = before[both], after[both]
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale > 0.0 else math.nan


def from_all(inputs: Inputs, path: Array, landmarks: Array, i: int) -> Array:
    """Squared distance (L,) of observation i from every landmark (L, 2), under its stated covariance."""
    o, sensor = inputs.observations, inputs.sensor_at(i)
    nu = sensor.residual(o.z[i], sensor.predict(path[o.frame[i]], landmarks))
    return np.asarray(np.einsum("li,li->l", nu, np.linalg.solve(o.R[i], nu.T).T))


def misfits(inputs: Inputs, path: Array, used: Used, residuals: Residuals) -> tuple[int, int, float]:
    """Number of outliers, of those that fit another landmark (wrong pairings), and half their excess squares."""
    outlying: BoolArray = residuals.squared > OUTLYING
    elsewhere = 0
    for i in np.flatnonzero(outlying):
        squared = from_all(inputs, path, used.landmarks, int(i))
        squared[used.number[i]] = np.inf
        elsewhere += bool(squared.min(initial=np.inf) < FITTING)
    return int(outlying.sum()), elsewhere, 0.5 * float(np.sum(residuals.squared[outlying] - FITTING))


def rate_of(poses: Array, time: Array) -> Array:
    """Derivative (N, 3) of poses or increments by time, by central differences; zero of a single one."""
    if len(poses) < 2:
        return np.zeros_like(poses)
    smooth = poses.copy()
    smooth[:, 2] = np.unwrap(poses[:, 2])
    return np.asarray(np.gradient(smooth, time, axis=0))
