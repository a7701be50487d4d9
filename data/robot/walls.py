"""Walls from sonar readings: where on a wall an echo came from, and the straight line through several of them.

A line is (rho, alpha): rho >= 0 its distance from the origin [m], alpha the direction of its normal, from the origin to
the line [rad]. Sensors and lines are in one frame, most often the robot's newest body frame.

Model of a reading: the distance to the nearest point inside the cone. If the wall's normal is inside the cone, that
point is the foot of the perpendicular, wherever in the cone it is; if not, it is where the cone's nearer edge meets the
wall. So a line fixes the direction of each echo, and directions and line are found in turns. Taking each echo for one
on the sonar's axis instead puts the wall too near or too far, by up to 1 - cos(22.5 degrees) = 7.6 % of the distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from data.robot.packets import CONE_HALF_ANGLE, SONARS
from data.se2 import Array, BoolArray, between, compose, wrap_angle

SIGMA = 0.005
"""m, standard deviation of a distance: that of the simulated sonars (`data.robot.simulated.physics`)."""
MIRROR = math.radians(15.0)
"""rad between an echo's way and the wall's normal; met at a larger angle, a smooth wall sends the sound elsewhere."""
WELSCH = 2.985
"""Standard deviations. The weight exp(-(d / (WELSCH sigma))^2) loses 5 % of precision on data without outliers (Holland
and Welsch 1977)."""
NORMAL_MEDIAN = 1.4826
"""Standard deviation of normal residuals over the median of their sizes."""
INLIER = 1.96
"""Standard deviations; 95 % of good readings are within (Hartley and Zisserman, section 4.7.1)."""
SAMPLES = 100
"""Pairs of readings that RANSAC tries. 17 would find two good ones among 40 % outliers 999 times in 1000; a pair near
each other makes a poor line, though, and the pairs that lie in different halves are only half of all."""
TRUNCATED = 0.759
"""1 - 2 t phi(t) / (2 Phi(t) - 1), t = `INLIER`: of the change that an error makes, the share that least squares
through the inliers shows; the rest is good readings that leave or join them."""
ITERATIONS = 50
CONVERGED = 1e-9
"""rad or m; a step this small ends the iteration."""


class Line(NamedTuple):
    """A wall.

    Attributes:
        rho: m, at least 0.
        alpha: rad, (-pi, pi].
        cov: (2, 2) covariance of rho and alpha [m, rad].
        weights: (N,) of the readings, 0 to 1.
        residuals: (N,) m, signed distances of the echoes from the line, positive beyond it.
    """

    rho: float
    alpha: float
    cov: Array
    weights: Array
    residuals: Array


def sensor_poses(odometry: Array) -> Array:
    """Poses (F, 8, 3) of the sonars at the poses `odometry` (F, 3) of the body, in the body frame of the last."""
    return compose(between(odometry[-1], odometry)[:, None], SONARS)


def echo_points(sensors: Array, ranges: Array, alpha: float | Array) -> Array:
    """Points (..., N, 2) the echoes of a wall with the normal `alpha` came from: within the cone as near it as can be.

    Args:
        sensors: (..., N, 3) poses of the sonars [m, m, rad].
        ranges: (..., N) distances [m].
        alpha: rad, one, or shaped (..., 1).
    """
    turn = np.clip(wrap_angle(alpha - sensors[..., 2]), -CONE_HALF_ANGLE, CONE_HALF_ANGLE)
    way = sensors[..., 2] + turn
    return np.stack([sensors[..., 0] + ranges * np.cos(way), sensors[..., 1] + ranges * np.sin(way)], axis=-1)


def predicted_ranges(sensors: Array, rho: float, alpha: float) -> Array:
    """Readings (N,) of an endless wall by the model above, inf where no way inside the cone leads to it."""
    off = np.abs(wrap_angle(alpha - sensors[:, 2]))
    distance = rho - sensors[:, 0] * math.cos(alpha) - sensors[:, 1] * math.sin(alpha)
    slant = np.maximum(off - CONE_HALF_ANGLE, 0.0)
    seen = (slant < 0.5 * math.pi) & (distance > 0.0)
    return np.where(seen, distance / np.where(seen, np.cos(slant), 1.0), np.inf)


def total_least_squares(points: Array, weights: Array, sensors: Array) -> tuple[Array, Array]:
    """(rho, alpha) (...) of the lines with the least weighted squared distances; the sensors are before them.

    Args:
        points: (..., N, 2).
        weights: (..., N), at least two above zero.
        sensors: (..., N, 3); rho is negative where the origin is beyond the line.
    """
    total = weights.sum(-1)
    mean = (weights[..., None] * points).sum(-2) / total[..., None]
    d = points - mean[..., None, :]
    sxx, syy = (weights * d[..., 0] ** 2).sum(-1), (weights * d[..., 1] ** 2).sum(-1)
    sxy = (weights * d[..., 0] * d[..., 1]).sum(-1)
    alpha = 0.5 * np.arctan2(-2.0 * sxy, syy - sxx)
    before = mean - (weights[..., None] * sensors[..., :2]).sum(-2) / total[..., None]
    alpha = np.where(before[..., 0] * np.cos(alpha) + before[..., 1] * np.sin(alpha) < 0.0, alpha + math.pi, alpha)
    rho = mean[..., 0] * np.cos(alpha) + mean[..., 1] * np.sin(alpha)
    return rho, alpha


def fit_weighted(sensors: Array, ranges: Array, sigma: float = SIGMA) -> Line:
    """The line through readings by weighted total least squares, w = exp(-d^2 / c).

    d is the distance from the line of the last iteration and c = (`WELSCH` sigma)^2. Least squares through all readings
    would be no line to begin with: a few gross outliers turn it until all good readings weigh nothing. The first line
    is that of the repeated median, and c comes down to its value from what the median of its d says, by halves of s.

    Args:
        sensors: (N, 3) poses [m, m, rad], N >= 3.
        ranges: (N,) distances [m], finite.
        sigma: m, of a reading.
    """
    rho, alpha = _repeated_median(sensors, ranges)
    scale = NORMAL_MEDIAN * float(np.median(np.abs(_distances(sensors, ranges, rho, alpha))))
    for _ in range(ITERATIONS):
        d = _distances(sensors, ranges, rho, alpha)
        weights = np.exp(-((d / (WELSCH * max(scale, sigma))) ** 2))
        if weights.sum() < 1.0:  # not a line: what agreed widely does not agree closely
            break
        before = rho, alpha
        rho, alpha = _least_squares(sensors, ranges, weights, alpha)
        if scale <= sigma and max(abs(rho - before[0]), abs(wrap_angle(alpha - before[1]))) < CONVERGED:
            break
        scale *= 0.5
    return _line(sensors, ranges, rho, alpha, sigma)


def fit_ransac(sensors: Array, ranges: Array, rng: np.random.Generator, sigma: float = SIGMA) -> Line:
    """The line most readings agree with, by total least squares through these (Fischler and Bolles 1981).

    Args:
        sensors: (N, 3) poses [m, m, rad], N >= 3.
        ranges: (N,) distances [m], finite.
        rng: draws `SAMPLES` pairs of readings.
        sigma: m, of a reading; within `INLIER` of it a reading agrees.
    """
    n = len(ranges)
    first = rng.integers(n, size=SAMPLES)
    pairs = np.stack([first, (first + rng.integers(1, n, size=SAMPLES)) % n], axis=-1)
    two, both = sensors[pairs], np.ones(pairs.shape)
    alpha = two[..., 2]
    for _ in range(4):  # the first lays both echoes on their axes, the others on the way to the line
        rho, angle = total_least_squares(echo_points(two, ranges[pairs], alpha), both, two)
        alpha = angle[:, None]
    d = _distances(sensors, ranges, rho[:, None], alpha)
    agree = np.minimum((d / (INLIER * sigma)) ** 2, 1.0)  # by cost, not by count: ties among few readings are common
    best = int(np.argmin(agree.sum(-1)))
    line_rho, line_alpha, inliers = float(rho[best]), float(angle[best]), agree[best] < 1.0
    for _ in range(ITERATIONS):
        if inliers.sum() < 2:
            break
        before = line_rho, line_alpha
        line_rho, line_alpha = _least_squares(sensors, ranges, inliers.astype(float), line_alpha)
        if max(abs(line_rho - before[0]), abs(wrap_angle(line_alpha - before[1]))) < CONVERGED:
            break
    return _line(sensors, ranges, line_rho, line_alpha, sigma, inliers)


def visible(line: Line, sensors: Array) -> bool:
    """Whether a smooth wall there sends echoes back to the sensors (N, 3) of the readings that count, on the whole."""
    off = np.abs(wrap_angle(line.alpha - sensors[:, 2]))
    return bool(line.weights @ off < line.weights.sum() * (CONE_HALF_ANGLE + MIRROR))


def geometry(sensors: Array, ranges: Array, alpha: float) -> Array:
    """Jacobian (N, 2) of the echoes' distances from a line to its rho and alpha: -1 and how far along it they lie.

    Where the wall's normal leaves the cone, the echo moves along the wall with it; its distance does not change for
    that, so the Jacobian is that of points at rest.
    """
    along = echo_points(sensors, ranges, alpha) @ (-math.sin(alpha), math.cos(alpha))
    return np.stack([-np.ones(len(ranges)), along], axis=-1)


def _line(
    sensors: Array, ranges: Array, rho: float, alpha: float, sigma: float, inliers: BoolArray | None = None
) -> Line:
    """The line with its covariance, rho >= 0.

    The covariance is that of an M-estimate (Huber, Robust Statistics, section 7.6) from the residuals, their number and
    the Jacobian. For RANSAC weights are 1 or 0, and good readings that come to lie beyond `INLIER` are missing.
    """
    d = _distances(sensors, ranges, rho, alpha)
    if inliers is None:
        u = (d / (WELSCH * sigma)) ** 2
        weights = np.exp(-u)
        slope = weights * (1.0 - 2.0 * u)  # of weight times distance
    else:
        weights = inliers.astype(float)
        slope = TRUNCATED * weights
    J = geometry(sensors, ranges, alpha)
    total, curvature = float(weights.sum()), float(slope.sum())
    information = (weights[:, None] * J).T @ J
    freedom = total - 2.0
    if freedom <= 0.0 or curvature <= 0.0 or np.linalg.det(information) <= 0.0:
        cov = np.full((2, 2), np.inf)
    else:
        variance = float(np.sum((weights * d) ** 2)) / curvature * total / freedom
        cov = variance * total / curvature * np.linalg.inv(information)
    if rho < 0.0:
        rho, alpha = -rho, alpha + math.pi
        cov = cov * [[1.0, -1.0], [-1.0, 1.0]] if np.isfinite(cov).all() else cov
    return Line(rho, wrap_angle(alpha), cov, weights, d)


def _distances(sensors: Array, ranges: Array, rho: float | Array, alpha: float | Array) -> Array:
    points = echo_points(sensors, ranges, alpha)
    d: Array = points[..., 0] * np.cos(alpha) + points[..., 1] * np.sin(alpha) - rho
    return d


def _least_squares(sensors: Array, ranges: Array, weights: Array, alpha: float) -> tuple[float, float]:
    """Line through the echoes as a wall with the normal `alpha` would send them."""
    line = total_least_squares(echo_points(sensors, ranges, alpha), weights, sensors)
    return float(line[0]), float(line[1])


def _repeated_median(sensors: Array, ranges: Array) -> tuple[float, float]:
    """Rho and alpha of a line that half the readings may be wrong for (Siegel 1982).

    Slopes are taken across the sonars' mean axis: a wall is seen only near its normal. Laid on their axes first, the
    echoes are laid again by the line found.
    """
    axis = math.atan2(float(np.sin(sensors[:, 2]).sum()), float(np.cos(sensors[:, 2]).sum()))
    c, s = math.cos(axis), math.sin(axis)
    laid: float | Array = sensors[:, 2]
    rho = alpha = 0.0
    for _ in range(2):
        x, y = np.moveaxis(echo_points(sensors, ranges, laid), -1, 0)
        ahead, across = c * x + s * y, c * y - s * x
        run = across[:, None] - across
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = np.where(run == 0.0, np.nan, (ahead[:, None] - ahead) / run)
        known = np.isfinite(slopes).any(axis=1)
        slope = float(np.median(np.nanmedian(slopes[known], axis=1))) if known.any() else 0.0
        tilt = math.atan(slope)
        laid = alpha = axis - tilt
        rho = float(np.median(ahead - slope * across)) * math.cos(tilt)
    return rho, alpha
