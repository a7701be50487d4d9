"""Walls from sonar readings: where an echo came from, and the straight line through several of them.

A line is (rho, alpha): rho >= 0 its distance from the origin [m], alpha the direction of its normal [rad], from the
origin to the line. Sensors and lines share one frame, usually the newest body frame.

A reading is the distance to the nearest point inside the cone: the foot of the perpendicular if the wall's normal is
inside the cone, else the point where the nearer edge of the cone meets the wall. So a line fixes the direction of each
echo, and directions and line are found by iteration. Echoes taken on the sonar's axis would misplace the wall by up to
1 - cos(22.5 degrees) = 7.6 % of the distance.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from data.se2 import Array, wrap_angle
from wings.robot.packets import CONE_HALF_ANGLE

SIGMA = 0.005  # m, standard deviation of a distance, as of the simulated sonars (`wings.robot.simulated`)
MIRROR = math.radians(15.0)  # rad, largest angle between an echo and the wall's normal that a smooth wall returns
WELSCH = 2.985
"""Standard deviations. The weight exp(-(d / (WELSCH sigma))^2) has 95 % efficiency on normal errors (Holland and Welsch
1977)."""
NORMAL_MEDIAN = 1.4826  # standard deviation of normal residuals over their median absolute value
FADING = 0.75  # m^2, of the robot's author: the weight of a reading at range r is exp(-r^2 / FADING), a half at 0.72 m
STEEP = 1e6  # condition of the normal equations of y on x, from which on a wall has no slope
ITERATIONS = 50
CONVERGED = 1e-9  # rad or m; a smaller step ends the iteration


class Line(NamedTuple):
    """A wall."""

    rho: float  # m, >= 0
    alpha: float  # rad, (-pi, pi]
    cov: Array  # (2, 2) covariance of rho and alpha [m, rad]
    weights: Array  # (N,) of the readings, 0 to 1
    residuals: Array  # (N,) m, signed distances of the echoes from the line, positive beyond it


def echo_points(sensors: Array, ranges: Array, alpha: float | Array) -> Array:
    """Points (..., N, 2) that the echoes came from: within the cone, nearest to the normal's direction `alpha` [rad].
    `sensors` (..., N, 3) are sonar poses, `ranges` (..., N) distances [m]; `alpha` is scalar or (..., 1).
    """
    way = sensors[..., 2] + np.clip(wrap_angle(alpha - sensors[..., 2]), -CONE_HALF_ANGLE, CONE_HALF_ANGLE)
    return np.stack([sensors[..., 0] + ranges * np.cos(way), sensors[..., 1] + ranges * np.sin(way)], axis=-1)


def total_least_squares(points: Array, weights: Array, sensors: Array) -> tuple[Array, Array]:
    """(rho, alpha) (...) of lines with least weighted squares from points (..., N, 2), two `weights` (..., N) above
    zero, behind `sensors` (..., N, 3); rho < 0: the origin lies beyond the line.
    """
    total = weights.sum(-1)
    mean = (weights[..., None] * points).sum(-2) / total[..., None]
    d = points - mean[..., None, :]
    sxx, syy = (weights * d[..., 0] ** 2).sum(-1), (weights * d[..., 1] ** 2).sum(-1)
    alpha = 0.5 * np.arctan2(-2.0 * (weights * d[..., 0] * d[..., 1]).sum(-1), syy - sxx)
    before = mean - (weights[..., None] * sensors[..., :2]).sum(-2) / total[..., None]
    alpha = np.where(before[..., 0] * np.cos(alpha) + before[..., 1] * np.sin(alpha) < 0.0, alpha + math.pi, alpha)
    return mean[..., 0] * np.cos(alpha) + mean[..., 1] * np.sin(alpha), alpha


def fit_weighted(sensors: Array, ranges: Array, sigma: float = SIGMA) -> Line:
    """The line through N >= 3 readings by weighted total least squares, w = exp(-d^2 / c).

    d is the distance from the last line, c = (`WELSCH` sigma)^2. Iteration starts at the repeated median line, since a
    few outliers would turn a least-squares line away from all good readings; the scale in c starts at the median of its
    d and is halved until sigma. The covariance is that of an M-estimate (Huber, Robust Statistics, section 7.6).
    """
    rho, alpha = _repeated_median(sensors, ranges)
    scale = NORMAL_MEDIAN * float(np.median(np.abs(_distances(sensors, ranges, rho, alpha))))
    for _ in range(ITERATIONS):
        weights = np.exp(-((_distances(sensors, ranges, rho, alpha) / (WELSCH * max(scale, sigma))) ** 2))
        if weights.sum() < 1.0:  # not a line
            break
        before = rho, alpha
        rho, alpha = map(float, total_least_squares(echo_points(sensors, ranges, alpha), weights, sensors))
        if scale <= sigma and max(abs(rho - before[0]), abs(wrap_angle(alpha - before[1]))) < CONVERGED:
            break
        scale *= 0.5
    d = _distances(sensors, ranges, rho, alpha)
    u = (d / (WELSCH * sigma)) ** 2
    return _line(sensors, ranges, (rho, alpha), d, np.exp(-u), np.exp(-u) * (1.0 - 2.0 * u))


def fit_author(sensors: Array, ranges: Array, sigma: float = SIGMA) -> Line:
    """The line y = m x + b of the robot's author: weights exp(-r^2 / `FADING`), r the range to the robot, in one pass.

    Echoes are taken on the sonars' axes, and no reading is an outlier. `sigma` is unused: the spread comes from the
    residuals. The nearest reading has weight 1; a wall straight ahead has no slope m, and all weights are 0.
    Source: A. Kramer, "Weighted Linear Regression for Wall Following" (andrewjkramer.net), and its program.
    """
    x, y = points = echo_points(sensors, ranges, sensors[:, 2]).T
    nearness = -np.sum(points**2, axis=0) / FADING
    weights = np.exp(nearness - nearness.max())
    X, cov = np.stack([np.ones(len(x)), x], axis=-1), np.full((2, 2), np.inf)
    XtW = (weights[:, None] * X).T
    if np.linalg.cond(XtW @ X) > STEEP:
        return Line(0.0, 0.0, cov, np.zeros(len(x)), np.zeros(len(x)))
    of_y = np.linalg.solve(XtW @ X, XtW)
    b, m = (of_y @ y).tolist()
    c, side = 1.0 / math.hypot(m, 1.0), math.copysign(1.0, b)
    d = side * c * (y - m * x - b)
    if len(d) > 2:
        gain = np.array([[side * c, -side * b * m * c**3], [0.0, c**2]]) @ of_y / c
        cov = float(weights @ d**2) / float(weights.sum()) * len(d) / (len(d) - 2) * gain @ gain.T
    return Line(abs(b) * c, math.atan2(side, -side * m), cov, weights, d)


FITS: dict[str, Callable[[Array, Array, float], Line]] = {"weighted": fit_weighted, "author": fit_author}
"""Ways to fit a wall, by name: with weights that find outliers, and the robot author's."""
USUAL_FIT = "weighted"


def visible(line: Line, sensors: Array) -> bool:
    """Whether a smooth wall there would return echoes to the sensors (N, 3), by the weighted mean of the angle."""
    off = np.abs(wrap_angle(line.alpha - sensors[:, 2]))
    return bool(line.weights @ off < line.weights.sum() * (CONE_HALF_ANGLE + MIRROR))


def geometry(sensors: Array, ranges: Array, alpha: float) -> Array:
    """Jacobian (N, 2) of the echoes' distances from a line to rho and alpha: -1 and their position along it. An echo on
    the cone's edge moves along the wall with alpha, which does not change its distance.
    """
    along = echo_points(sensors, ranges, alpha) @ (-math.sin(alpha), math.cos(alpha))
    return np.stack([-np.ones(len(ranges)), along], axis=-1)


def _line(sensors: Array, ranges: Array, fitted: tuple[float, float], d: Array, weights: Array, slope: Array) -> Line:
    """The line with its covariance, rho >= 0; `slope` (N,): derivative of weight times distance d."""
    J = geometry(sensors, ranges, fitted[1])
    information, cov = (weights[:, None] * J).T @ J, np.full((2, 2), np.inf)
    total, curvature = float(weights.sum()), float(slope.sum())
    if total > 2.0 and curvature > 0.0 and np.linalg.det(information) > 0.0:
        variance = float(np.sum((weights * d) ** 2)) / curvature * total / (total - 2.0)
        cov = variance * total / curvature * np.linalg.inv(information)
    rho, alpha = fitted
    if rho < 0.0:
        rho, alpha = -rho, alpha + math.pi
        cov = cov * [[1.0, -1.0], [-1.0, 1.0]] if np.isfinite(cov).all() else cov
    return Line(rho, wrap_angle(alpha), cov, weights, d)


def _distances(sensors: Array, ranges: Array, rho: float | Array, alpha: float | Array) -> Array:
    points = echo_points(sensors, ranges, alpha)
    return np.asarray(points[..., 0] * np.cos(alpha) + points[..., 1] * np.sin(alpha) - rho)


def _repeated_median(sensors: Array, ranges: Array) -> tuple[float, float]:
    """Rho and alpha of a line that tolerates half of the readings as outliers (repeated median, Siegel 1982)."""
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
