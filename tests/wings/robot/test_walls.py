"""Lines from sonar readings: exact without noise, by the simulator's cones, and as good as their covariance says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from data.se2 import compose, wrap_angle
from tests.wings.robot.wall_study import (
    fit_ransac,
    passing,
    predicted_ranges,
    study,
    table,
)
from wings.robot.packets import CONE_HALF_ANGLE, RIGHT, SONARS
from wings.robot.simulated.room import Room, cast
from wings.robot.walls import (
    FADING,
    SIGMA,
    WELSCH,
    echo_points,
    fit_author,
    fit_weighted,
    visible,
)

OFF = (-0.38, -0.2, -0.1, 0.0, 0.05, 0.13, 0.3)
"""rad, of the wall's normal from the sonar's axis."""


def wall(rho, alpha):
    """100 m of a wall."""
    foot, along = rho * np.array([math.cos(alpha), math.sin(alpha)]), np.array([-math.sin(alpha), math.cos(alpha)])
    return Room(np.array([[foot - 50 * along, foot + 50 * along]]), np.zeros(3))


def passed(alpha, rho=0.8, n=12):
    """Sensors (n, 3) of the sonar on the right on a metre ahead, and what the room's cones give of a wall."""
    x = np.linspace(-1.0, 0.0, n)
    sensors = compose(np.stack([x, 0 * x, 0 * x], -1), SONARS[RIGHT])
    return sensors, cast(wall(rho, alpha), sensors, CONE_HALF_ANGLE).distance


@pytest.mark.parametrize("off", OFF)
def test_echoes_are_laid_where_the_cone_meets_the_wall(off):
    alpha = SONARS[RIGHT, 2] + off
    sensors, ranges = passed(alpha)
    assert predicted_ranges(sensors, 0.8, alpha) == pytest.approx(ranges, abs=1e-12)
    assert echo_points(sensors, ranges, alpha) @ (math.cos(alpha), math.sin(alpha)) == pytest.approx(0.8, abs=1e-12)


@pytest.mark.parametrize("off", OFF)
def test_without_noise_a_fit_is_the_wall(off):
    sensors, ranges = passed(SONARS[RIGHT, 2] + off)
    for line in (fit_weighted(sensors, ranges), fit_ransac(sensors, ranges, np.random.default_rng(0))):
        assert line.rho == pytest.approx(0.8, abs=1e-6)
        assert line.alpha == pytest.approx(SONARS[RIGHT, 2] + off, abs=1e-6)
        assert visible(line, sensors)


def test_a_line_beyond_the_origin_is_told_with_rho_above_zero():
    """Seen from behind: sensors two metres to the left of the origin, the wall between."""
    sensors = compose(np.array([[0.1 * k, 2.0, 0.0] for k in range(8)]), SONARS[RIGHT])
    ranges = cast(wall(1.0, math.pi / 2), sensors, CONE_HALF_ANGLE).distance
    for line in (fit_weighted(sensors, ranges), fit_ransac(sensors, ranges, np.random.default_rng(0))):
        assert (line.rho, line.alpha) == pytest.approx((1.0, math.pi / 2), abs=1e-6)


@pytest.mark.parametrize("beyond", [False, True], ids=["origin before the wall", "origin beyond it"])
def test_the_frame_does_not_matter(beyond):
    """A line moved by a pose is the line fitted to sensors moved by it, with the covariance moved by the Jacobian."""
    sensors, ranges, _ = passing(0.1, np.random.default_rng(3))
    here = fit_weighted(sensors, ranges)
    heading, way = 0.4, (-5.0 if beyond else -0.3)
    alpha = here.alpha + heading
    pose = np.array([way * math.cos(alpha) + 0.2, way * math.sin(alpha), heading])
    there = fit_weighted(compose(pose, sensors), ranges)
    side = -1.0 if beyond else 1.0
    rho = here.rho + pose[0] * math.cos(alpha) + pose[1] * math.sin(alpha)
    assert there.rho == pytest.approx(side * rho, abs=1e-7)
    assert wrap_angle(there.alpha - alpha - (math.pi if beyond else 0.0)) == pytest.approx(0.0, abs=1e-7)
    J = np.array([[side, side * (pose[1] * math.cos(alpha) - pose[0] * math.sin(alpha))], [0.0, 1.0]])
    assert there.cov == pytest.approx(J @ here.cov @ J.T, rel=1e-4, abs=1e-12)


def test_the_weighted_fit_is_the_minimum_of_welschs_loss():
    """scipy minimizes c / 2 (1 - exp(-d^2 / c)) over rho and alpha, each echo laid by alpha, from the true wall."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        sensors, ranges, truth = passing(0.2, rng)

        def root_loss(line):
            d = echo_points(sensors, ranges, line[1]) @ (math.cos(line[1]), math.sin(line[1])) - line[0]
            return np.sqrt(1.0 - np.exp(-((d / (WELSCH * SIGMA)) ** 2)))

        best = least_squares(root_loss, truth, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
        fit = fit_weighted(sensors, ranges)
        assert (fit.rho, fit.alpha) == pytest.approx(best, abs=2e-5)


def test_both_fits_withstand_a_fifth_of_outliers_and_say_how_good_they_are():
    rows = {(r.method, r.share): r for r in study(40, np.random.default_rng(1), shares=(0.0, 0.2))}
    for method in ("weighted", "ransac"):
        row = rows[method, 0.2]
        assert row.lost == 0.0
        assert (row.rmse < [0.006, 0.010]).all()
        assert 1.0 < row.nees < 4.5
    assert (rows["weighted", 0.2].rmse < 1.1 * rows["ransac", 0.2].rmse).all()
    assert rows["axis", 0.0].bias[0] < -5 * abs(rows["weighted", 0.0].bias[0])
    # an echo of another ping comes too early, so the author's weights prefer it
    assert rows["author", 0.2].lost > 0.5
    assert rows["author", 0.0].bias[0] == pytest.approx(rows["axis", 0.0].bias[0], abs=0.003)
    assert len(table(list(rows.values())).splitlines()) == 8


def test_the_author_s_fit_is_least_squares_with_weights_by_the_range_to_the_robot():
    """Oracle: scipy on the echoes on their axes. Square to the wall it is exact; the covariance is what errors have."""
    rng = np.random.default_rng(3)
    sensors, exact = passed(SONARS[RIGHT, 2])
    assert fit_author(sensors, exact)[:2] == pytest.approx((0.8, SONARS[RIGHT, 2]), abs=1e-12)
    nees = []
    for _ in range(200):
        ranges = exact + SIGMA * rng.standard_normal(len(exact))
        fit = fit_author(sensors, ranges)
        error = np.array([fit.rho - 0.8, fit.alpha - SONARS[RIGHT, 2]])
        nees.append(error @ np.linalg.solve(fit.cov, error))
    # 12 readings: Student's t makes 2 x 10 / 8
    assert np.mean(nees) == pytest.approx(2.5, abs=0.5)
    points = echo_points(sensors, ranges, sensors[:, 2])
    r = np.hypot(*points.T)
    weights = np.exp(-(r**2) / FADING)
    np.testing.assert_allclose(fit.weights, weights / weights.max(), rtol=1e-12)

    def cost(line):
        return np.sqrt(weights) * (points @ (math.cos(line[1]), math.sin(line[1])) - line[0])

    found = least_squares(cost, [0.8, SONARS[RIGHT, 2]], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert fit[:2] == pytest.approx(tuple(found.x), abs=1e-8)
    assert np.isinf(fit_author(sensors[:2], ranges[:2]).cov).all()


@pytest.mark.slow
def test_up_to_two_fifths_of_outliers_the_weighted_fit_is_no_worse_than_ransac():
    """800 walls each; 20 readings: Student's t makes the mean NEES 2 x 18 / 16 = 2.25 where the fit knows no sigma."""
    rows = {(r.method, r.share): r for r in study(800, np.random.default_rng(0))}
    for share in (0.0, 0.1, 0.2, 0.3, 0.4):
        weighted, ransac = rows["weighted", share], rows["ransac", share]
        assert (weighted.rmse < 1.1 * ransac.rmse).all()
        assert weighted.lost < 0.002
        assert (np.abs(weighted.bias) < [0.0005, 0.0006]).all()
    assert rows["weighted", 0.0].nees == pytest.approx(2.25, abs=0.2)
    assert rows["weighted", 0.2].nees < 3.0
