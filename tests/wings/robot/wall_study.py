"""Fits of a wall to the same readings, by share of outliers: weighted, the robot author's, RANSAC, and brute force.

    python -m tests.wings.robot.wall_study [TRIALS]

A robot passes a wall of random distance and direction; outliers are echoes of another sonar's ping, too early by any
amount, as in `wings.robot.simulated.physics`. Twenty readings first; then eight, as few as brute force can take.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple

import numpy as np

from data.se2 import Array, compose, wrap_angle
from wings.robot.packets import CONE_HALF_ANGLE, LONGEST_RANGE, RIGHT, SONARS
from wings.robot.walls import (
    CONVERGED,
    ITERATIONS,
    MIRROR,
    SIGMA,
    Line,
    _distances,
    _least_squares,
    _line,
    echo_points,
    fit_author,
    fit_weighted,
    total_least_squares,
)

SHARES = (0.0, 0.1, 0.2, 0.3, 0.4)
"""Of outliers among the readings."""
READINGS, FEW = 20, 8
PASSED = 1.0
"""m, way of the robot over which they are taken."""
DISTANCES = (0.4, 2.0)
"""m."""
INLIER = 1.96
"""Standard deviations; 95 % of good readings are within (Hartley and Zisserman, section 4.7.1)."""
SAMPLES = 100
"""Pairs of readings that RANSAC tries; neighbouring readings make a poor line, so the 17 of theory are too few."""
TRUNCATED = 0.759
"""1 - 2 t phi(t) / (2 Phi(t) - 1), t = `INLIER`: derivative of the truncated weight times distance, on average."""


def predicted_ranges(sensors, rho, alpha):
    """Readings (N,) of an infinite wall by the model above, inf where the cone misses it."""
    off = np.abs(wrap_angle(alpha - sensors[:, 2]))
    distance = rho - sensors[:, 0] * math.cos(alpha) - sensors[:, 1] * math.sin(alpha)
    slant = np.maximum(off - CONE_HALF_ANGLE, 0.0)
    seen = (slant < 0.5 * math.pi) & (distance > 0.0)
    return np.where(seen, distance / np.where(seen, np.cos(slant), 1.0), np.inf)


def fit_ransac(sensors: Array, ranges: Array, rng: np.random.Generator, sigma: float = SIGMA) -> Line:
    """The line most readings agree with, by total least squares through these (Fischler and Bolles 1981)."""
    n = len(ranges)
    first = rng.integers(n, size=SAMPLES)
    pairs = np.stack([first, (first + rng.integers(1, n, size=SAMPLES)) % n], axis=-1)
    two, both = sensors[pairs], np.ones(pairs.shape)
    alpha = two[..., 2]
    for _ in range(4):  # the first places both echoes on their axes, the others by the line
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
    d, weights = _distances(sensors, ranges, line_rho, line_alpha), inliers.astype(float)
    return _line(sensors, ranges, (line_rho, line_alpha), d, weights, TRUNCATED * weights)


def fit_brute_force(sensors: Array, ranges: Array, sigma: float = SIGMA) -> Line:
    """The line of least truncated cost among the least-squares lines of every three readings or more."""
    n, best = len(ranges), (math.inf, (), 0.0, 0.0)
    for size in range(3, n + 1):
        for chosen in combinations(range(n), size):
            rows = list(chosen)
            rho, alpha = 0.0, float(sensors[rows[0], 2])
            for _ in range(4):  # the first places the echoes on their axes
                rho, alpha = _least_squares(sensors[rows], ranges[rows], np.ones(size), alpha)
            agree = np.minimum((_distances(sensors, ranges, rho, alpha) / (INLIER * sigma)) ** 2, 1.0)
            best = min(best, (float(agree.sum()), chosen, rho, alpha))
    _, _, rho, alpha = best
    d = _distances(sensors, ranges, rho, alpha)
    weights = (np.abs(d) < INLIER * sigma).astype(float)
    return _line(sensors, ranges, (rho, alpha), d, weights, TRUNCATED * weights)


class Row(NamedTuple):
    """What T fits were worth.

    Attributes:
        method: "weighted", "author", "ransac", "brute" (force, of few readings) or "axis" (least squares through points
            on the sonars' axes, for the cone's bias).
        share: of outliers.
        bias: (2,) mean error of rho and alpha [m, rad].
        spread: (2,) standard deviation of the errors [m, rad].
        rmse: (2,) root mean squared error [m, rad].
        lost: share of fits that are more than 20 sigma of a reading off, or turned by more than 10 at the wall's ends.
        nees: mean of the squared errors over their covariance, 2 dof, without the lost.
    """

    method: str
    share: float
    bias: Array
    spread: Array
    rmse: Array
    lost: float
    nees: float


def passing(share: float, rng: np.random.Generator, readings: int = READINGS) -> tuple[Array, Array, Array]:
    """A wall passed on the right: sensors (N, 3), ranges (N,), true (rho, alpha), in the last body frame.

    The normal is at most the cone and `MIRROR` off the sonar's axis; the readings nearest the share, drawn at random,
    are outliers.
    """
    x = np.linspace(-PASSED, 0.0, readings)
    sensors = compose(np.stack([x, 0.0 * x, 0.0 * x], axis=-1), SONARS[RIGHT])
    while True:
        alpha = float(SONARS[RIGHT, 2] + rng.uniform(-1.0, 1.0) * (CONE_HALF_ANGLE + MIRROR))
        rho = float(rng.uniform(*DISTANCES))
        ranges = predicted_ranges(sensors, rho, alpha)
        if ranges.min() > 0.1 and ranges.max() < LONGEST_RANGE:
            break
    ranges = ranges + SIGMA * rng.standard_normal(readings)
    wrong = rng.permutation(readings)[: round(share * readings)]
    ranges[wrong] *= rng.random(len(wrong))
    return sensors, ranges, np.array([rho, alpha])


def on_axis(sensors: Array, ranges: Array) -> Line:
    """Least squares through the points on the sonars' axes."""
    points, ones = echo_points(sensors, ranges, sensors[:, 2]), np.ones(len(ranges))
    rho, alpha = (float(v) for v in total_least_squares(points, ones, sensors))
    return Line(rho, wrap_angle(alpha), np.full((2, 2), np.inf), ones, 0.0 * ones)


def study(
    trials: int, rng: np.random.Generator, shares: tuple[float, ...] = SHARES, readings: int = READINGS
) -> list[Row]:
    """A row per method and share of outliers; the methods see the same readings. Brute force takes `FEW` at most."""
    fits: dict[str, Callable[[Array, Array], Line]] = {
        "weighted": fit_weighted,
        "author": fit_author,
        "ransac": lambda sensors, ranges: fit_ransac(sensors, ranges, rng),
    }
    if readings <= FEW:
        fits["brute"] = fit_brute_force
    rows = []
    for share in shares:
        used = fits | ({"axis": on_axis} if share == 0.0 else {})
        errors: dict[str, list[Array]] = {method: [] for method in used}
        nees: dict[str, list[float]] = {method: [] for method in used}
        for _ in range(trials):
            sensors, ranges, truth = passing(share, rng, readings)
            for method, fit in used.items():
                line = fit(sensors, ranges)
                error = np.array([line.rho - truth[0], wrap_angle(line.alpha - truth[1])])
                errors[method].append(error)
                finite = np.isfinite(line.cov).all()
                nees[method].append(float(error @ np.linalg.solve(line.cov, error)) if finite else math.nan)
        rows += [_row(method, share, np.array(errors[method]), np.array(nees[method])) for method in errors]
    return rows


def _row(method: str, share: float, errors: Array, nees: Array) -> Row:
    # a line through readings over PASSED, 10 sigma off at their ends
    lost = (np.abs(errors[:, 1]) > 20.0 * SIGMA / PASSED) | (np.abs(errors[:, 0]) > 20.0 * SIGMA)
    kept = nees[~lost & np.isfinite(nees)]
    return Row(
        method,
        share,
        errors.mean(axis=0),
        errors.std(axis=0),
        np.sqrt(np.mean(errors**2, axis=0)),
        float(lost.mean()),
        float(kept.mean()) if len(kept) else math.nan,
    )


def table(rows: list[Row]) -> str:
    """The rows as text: mm and mrad."""
    lines = ["outliers  method    bias mm    mrad  spread mm    mrad    RMSE mm    mrad   lost   NEES(2)"]
    for r in rows:
        b, s, e = 1000.0 * r.bias, 1000.0 * r.spread, 1000.0 * r.rmse
        lines.append(
            f"{r.share:7.0%}   {r.method:8}{b[0]:9.2f}{b[1]:8.2f}{s[0]:11.2f}{s[1]:8.2f}{e[0]:11.2f}{e[1]:8.2f}"
            f"{r.lost:7.1%}{r.nees:9.2f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    for count in (READINGS, FEW):
        made = table(study(asked, np.random.default_rng(0), readings=count))
        sys.stdout.write(f"{count} readings\n{made}\n\n")
