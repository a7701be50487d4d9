"""Walls from sonar readings, packet by packet and as fits: exact without noise, and as good as their covariances."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from data.se2 import Array, between, compose, wrap_angle
from wings.robot.driving import WallFollower
from wings.robot.observe import WallObserver
from wings.robot.packets import CONE_HALF_ANGLE, LONGEST_RANGE, PERIOD, RIGHT, SONARS, WHEEL_BASE, Answer
from wings.robot.simulated import Physics, Room, cast, drive, room
from wings.robot.traffic import Packet
from wings.robot.walls import FADING, MIRROR, SIGMA, WELSCH, echo_points, fit_author, fit_weighted, visible

OFF = (-0.38, -0.2, -0.1, 0.0, 0.05, 0.13, 0.3)
"""rad, of the wall's normal from the sonar's axis."""
READINGS = 20


def wall(rho, alpha):
    """100 m of a wall."""
    foot, along = rho * np.array([math.cos(alpha), math.sin(alpha)]), np.array([-math.sin(alpha), math.cos(alpha)])
    return Room(np.array([[foot - 50 * along, foot + 50 * along]]), np.zeros(3))


def passed(alpha, rho=0.8, n=12):
    """Sensors (n, 3) of the sonar on the right on a metre ahead, and what the room's cones give of a wall."""
    x = np.linspace(-1.0, 0.0, n)
    sensors = compose(np.stack([x, 0 * x, 0 * x], -1), SONARS[RIGHT])
    return sensors, cast(wall(rho, alpha), sensors, CONE_HALF_ANGLE).distance


def predicted_ranges(sensors, rho, alpha):
    """Readings (N,) of an infinite wall as the cone says, inf where the cone misses it."""
    off = np.abs(wrap_angle(alpha - sensors[:, 2]))
    distance = rho - sensors[:, 0] * math.cos(alpha) - sensors[:, 1] * math.sin(alpha)
    slant = np.maximum(off - CONE_HALF_ANGLE, 0.0)
    seen = (slant < 0.5 * math.pi) & (distance > 0.0)
    return np.where(seen, distance / np.where(seen, np.cos(slant), 1.0), np.inf)


def passing(share: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """A wall passed on the right: sensors (N, 3), ranges (N,), true (rho, alpha), in the last body frame; the normal is
    near the sonar's axis, readings nearest the share are outliers.
    """
    x = np.linspace(-1.0, 0.0, READINGS)
    sensors = compose(np.stack([x, 0.0 * x, 0.0 * x], axis=-1), SONARS[RIGHT])
    while True:
        alpha = float(SONARS[RIGHT, 2] + rng.uniform(-1.0, 1.0) * (CONE_HALF_ANGLE + MIRROR))
        rho = float(rng.uniform(0.4, 2.0))
        ranges = predicted_ranges(sensors, rho, alpha)
        if ranges.min() > 0.1 and ranges.max() < LONGEST_RANGE:
            break
    ranges = ranges + SIGMA * rng.standard_normal(READINGS)
    wrong = rng.permutation(READINGS)[: round(share * READINGS)]
    ranges[wrong] *= rng.random(len(wrong))
    return sensors, ranges, np.array([rho, alpha])


@pytest.mark.parametrize("off", OFF)
def test_echoes_are_laid_where_the_cone_meets_the_wall_and_without_noise_a_fit_is_the_wall(off):
    alpha = SONARS[RIGHT, 2] + off
    sensors, ranges = passed(alpha)
    assert predicted_ranges(sensors, 0.8, alpha) == pytest.approx(ranges, abs=1e-12)
    assert echo_points(sensors, ranges, alpha) @ (math.cos(alpha), math.sin(alpha)) == pytest.approx(0.8, abs=1e-12)
    line = fit_weighted(sensors, ranges)
    assert (line.rho, line.alpha) == pytest.approx((0.8, alpha), abs=1e-6)
    assert visible(line, sensors)


def test_a_line_beyond_the_origin_is_told_with_rho_above_zero():
    """Seen from behind: sensors two metres to the left of the origin, the wall between."""
    sensors = compose(np.array([[0.1 * k, 2.0, 0.0] for k in range(8)]), SONARS[RIGHT])
    line = fit_weighted(sensors, cast(wall(1.0, math.pi / 2), sensors, CONE_HALF_ANGLE).distance)
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


def test_the_weighted_fit_withstands_a_fifth_of_outliers_and_says_how_good_it_is():
    """Student's t makes the mean NEES of 20 readings 2 x 18 / 16, and more with outliers; the author's fit is lost."""
    rng, errors, nees, lost = np.random.default_rng(1), [], [], 0
    for _ in range(40):
        sensors, ranges, truth = passing(0.2, rng)
        fit, author = fit_weighted(sensors, ranges), fit_author(sensors, ranges)
        errors.append([fit.rho - truth[0], wrap_angle(fit.alpha - truth[1])])
        nees.append(errors[-1] @ np.linalg.solve(fit.cov, errors[-1]))
        lost += abs(author.rho - truth[0]) > 20.0 * SIGMA or abs(wrap_angle(author.alpha - truth[1])) > 20.0 * SIGMA
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < [0.006, 0.010]).all()
    assert 1.0 < np.mean(nees) < 4.5
    assert lost > 20


def test_the_author_s_fit_regresses_y_on_x_with_weights_by_the_range_to_the_robot():
    """Oracle: numpy's polynomials on echoes on the axes. Square to the wall it is exact, with the errors it claims."""
    rng = np.random.default_rng(3)
    sensors, exact = passed(SONARS[RIGHT, 2])
    assert fit_author(sensors, exact)[:2] == pytest.approx((0.8, SONARS[RIGHT, 2]), abs=1e-12)
    nees = []
    for _ in range(200):
        ranges = exact + SIGMA * rng.standard_normal(len(exact))
        fit = fit_author(sensors, ranges)
        error = np.array([fit.rho - 0.8, fit.alpha - SONARS[RIGHT, 2]])
        nees.append(error @ np.linalg.solve(fit.cov, error))
    assert np.mean(nees) == pytest.approx(2.5, abs=0.5)  # 12 readings: Student's t makes 2 x 10 / 8
    points = echo_points(sensors, ranges, sensors[:, 2])
    weights = np.exp(-np.sum(points**2, axis=1) / FADING)
    np.testing.assert_allclose(fit.weights, weights / weights.max(), rtol=1e-12)
    m, b = np.polyfit(*points.T, 1, w=np.sqrt(weights))
    assert points @ (math.cos(fit.alpha), math.sin(fit.alpha)) - fit.rho == pytest.approx(fit.residuals, abs=1e-12)
    assert (-1.0 / math.tan(fit.alpha), fit.rho / math.sin(fit.alpha)) == pytest.approx((m, b), abs=1e-9)
    assert np.isinf(fit_author(sensors[:2], ranges[:2]).cov).all()
    ahead = sensors.copy()
    ahead[:, 0], ahead[:, 2] = 0.0, 0.0
    assert not fit_author(ahead, np.full(len(ahead), 0.8)).weights.any()  # a wall ahead has no slope


RAW = Answer((4000,) * 8, 0, 0, 0)
WALL = Room(np.array([[[-90.0, -0.8], [90.0, -0.8]]]), np.zeros(3))
STEP = 0.055


def packets(place, steps, rng, sigma=0.005, slip=0.0, start=(0.0, 0.0, 0.0)):
    """Packets of a robot whose wheels count `steps` (way, turn) and slip, and its true poses."""
    true, counted = np.array(start), np.zeros(3)
    out, poses = [], []
    for k, (way, turn) in enumerate([(0.0, 0.0), *steps]):
        wheels = np.array([way - 0.5 * WHEEL_BASE * turn, way + 0.5 * WHEEL_BASE * turn])
        counted = compose(counted, [way, 0.0, turn])
        wheels = wheels + slip * np.sqrt(np.abs(wheels)) * rng.standard_normal(2)
        true = compose(true, [wheels.mean(), 0.0, (wheels[1] - wheels[0]) / WHEEL_BASE])
        echo = cast(place, compose(true, SONARS), CONE_HALF_ANGLE)
        ranges = np.where(echo.incidence < MIRROR, echo.distance, np.inf) + sigma * rng.standard_normal(8)
        out.append(Packet(k * PERIOD, np.where(ranges < 4.0, ranges, np.inf), counted, k > 0, RAW))
        poses.append(true)
    return out, poses


def lines_of(place):
    """(rho, alpha) of a room's walls in the world; rho may be negative."""
    a, e = place.segments[:, 0], place.segments[:, 1] - place.segments[:, 0]
    normal = np.stack([-e[:, 1], e[:, 0]], -1) / np.linalg.norm(e, axis=1)[:, None]
    return np.stack([np.sum(normal * a, -1), np.arctan2(normal[:, 1], normal[:, 0])], -1)


def expected(pose, line):
    """z (2,) of a line of the world, and its Jacobian (2, 3) to the pose."""
    d = line[0] - pose[0] * math.cos(line[1]) - pose[1] * math.sin(line[1])
    side = 1.0 if d >= 0 else -1.0
    z = np.array([abs(d), wrap_angle(line[1] - pose[2] + (0.0 if d >= 0 else math.pi))])
    return z, np.array([[-side * math.cos(line[1]), -side * math.sin(line[1]), 0.0], [0.0, 0.0, -1.0]])


def innovation(z, z_hat):
    return np.array([z[0] - z_hat[0], wrap_angle(z[1] - z_hat[1])])


def errors(place, heard, poses, observer):
    """Error (2,) and covariance of each observation against the wall of the room nearest to it."""
    lines, out = lines_of(place), []
    for packet, pose in zip(heard, poses):
        seen = observer.observe(packet)
        for z, R in zip(seen.z, seen.R):
            e = min((innovation(z, expected(pose, line)[0]) for line in lines), key=lambda e: np.abs(e).sum())
            out.append((e, R))
    return out


def nees(found):
    return np.array([e @ np.linalg.solve(R, e) for e, R in found])


def test_without_noise_a_wall_is_seen_where_it_is():
    heard, poses = packets(WALL, [(STEP, 0.02)] * 10 + [(STEP, -0.02)] * 10, np.random.default_rng(0), sigma=0.0)
    found = errors(WALL, heard, poses, WallObserver())
    assert len(found) >= 2
    for e, _ in found:
        assert e == pytest.approx(0.0, abs=1e-6)


def nees_at_random(slip, count):
    """Mean NEES of so many observations on weaving drives along a wall."""
    rng, found = np.random.default_rng(1), []
    while len(found) < count:
        turns = np.diff(0.05 * rng.standard_normal(82))
        heard, poses = packets(WALL, [(STEP, t) for t in turns], rng, slip=slip)
        found += errors(WALL, heard, poses, WallObserver(slip=slip))
    return nees(found).mean()


@pytest.mark.parametrize("slip", [0.0, 0.02], ids=["the sonars' noise is all", "most is the wheels' slip"])
@pytest.mark.slow
def test_errors_are_as_large_as_their_covariance_says(slip):
    """2 dof; 0.7 is 2.5 sigma of the mean of 50."""
    assert nees_at_random(slip, 50) == pytest.approx(2.0, abs=0.7)


@pytest.mark.parametrize("heading", [0.0, -0.2])
def test_on_the_way_to_a_wall_there_is_no_observation(heading):
    """Weaving a little, as any robot does, so that the cone sweeps."""
    place, rng = Room(np.array([[[4.0, -9.0], [4.0, 9.0]]]), np.zeros(3)), np.random.default_rng(4)
    turns = np.diff(0.1 * rng.standard_normal(56))
    heard, poses = packets(place, [(STEP, turn) for turn in turns], rng, start=(0.0, 0.0, heading))
    assert not errors(place, heard, poses, WallObserver())


def localized(way, place, observer, slip):
    """NEES (N,) of an EKF that knows the room's walls and the start."""
    x, P, before, out = np.array(place.start), np.zeros((3, 3)), way.packets[0].odometry, []
    lines = lines_of(place)
    for packet, pose in zip(way.packets, way.poses):
        step = between(before, packet.odometry)
        before = packet.odometry
        forward, turn, middle = math.hypot(step[0], step[1]), step[2], x[2] + 0.5 * step[2]
        F = np.eye(3)
        F[:2, 2] = forward * np.array([-math.sin(middle), math.cos(middle)])
        for side in (-1.0, 1.0):
            g = np.array([0.5 * math.cos(middle), 0.5 * math.sin(middle), side / WHEEL_BASE])
            g[:2] += 0.5 * side / WHEEL_BASE * F[:2, 2]
            P = P + slip**2 * abs(forward + 0.5 * side * WHEEL_BASE * turn) * np.outer(g, g)
        P = F @ P @ F.T + np.diag([1e-7, 1e-7, 1e-7])
        x = compose(x, step)
        seen = observer.observe(packet)
        for z, R in zip(seen.z, seen.R):
            line = min(lines, key=lambda line: np.abs(innovation(z, expected(pose, line)[0])).sum())
            z_hat, H = expected(x, line)
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x, P = x + K @ innovation(z, z_hat), (np.eye(3) - K @ H) @ P
        e = x - pose
        e[2] = wrap_angle(e[2])
        out.append(e @ np.linalg.solve(P, e))
    return np.array(out)


@pytest.mark.slow
def test_a_filter_that_knows_the_room_is_consistent_by_them():
    """12 drives of 2 minutes, from 30 s on; 3 dof. One drive's mean varies by 0.5, their mean by 0.15."""
    place, means = room(0), []
    for seed in range(12):
        way = drive(place, WallFollower(), 120.0, np.random.default_rng(seed))
        means.append(localized(way, place, WallObserver(), Physics().slip)[120:].mean())
    assert np.mean(means) == pytest.approx(3.0, abs=0.6)


@pytest.mark.slow
def test_in_the_room_walls_are_as_far_off_as_they_say_or_a_little_less():
    """1.75 to 1.85 for 2 dof: good readings are counted by their weights, 0.9, while the fit makes 0.95 of them."""
    found = []
    for seed in range(4):
        way = drive(room(0), WallFollower(), 300.0, np.random.default_rng(seed))
        found += errors(room(0), way.packets, way.poses, WallObserver())
    values = nees(found)
    assert len(found) > 600
    assert 1.6 < values.mean() < 2.1
    assert np.mean(values > 18.4) < 0.002
