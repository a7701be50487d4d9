"""The simulated robot, its sonars, lidar and rooms: known on paper, by independent computations, with stated noise."""

import math

import numpy as np
import pytest

from data.se2 import compose
from wings.robot.packets import PERIOD, RADIUS, SONARS, command_of
from wings.robot.simulated import (
    FRICTION,
    FULL_SPEED,
    GAP,
    LAG,
    Lidar,
    Physics,
    Robot,
    Room,
    SpeedLoop,
    cast,
    clearance,
    drive,
    room,
    turned,
)

IDEAL = Physics(slip=0.0, range_sigma=0.0, dropout=0.0, crosstalk=0.0)
LARGE = Room(np.array([[[-99.0, -99.0], [-99.0, 99.0]]]), np.zeros(3))


def driven(commands, place=LARGE, how=IDEAL, seed=0):
    """A robot that was given commands a period apart, and its last answer."""
    robot = Robot(place, np.random.default_rng(seed), how)
    for k, (v, omega) in enumerate(commands):
        robot.command(k * PERIOD, command_of(v, omega))
    return robot, robot.answer(len(commands) * PERIOD)


def test_it_drives_straight_turns_in_place_and_along_an_arc():
    """A wheel's loop lags by 0.05 to 0.1 s: that much way, and turn, is lacking; a stop would bring none of it back."""
    x, y, theta = driven([(0.4, 0.0)] * 8)[0].pose
    assert 0.4 * (2.0 - 0.1) < x < 0.4 * (2.0 - 0.05)
    assert (y, theta) == pytest.approx((0.0, 0.0), abs=1e-9)
    x, y, theta = driven([(0.0, 1.0)] * 4)[0].pose
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert 1.0 - 0.1 < theta < 1.0 - 0.04
    robot, _ = driven([(0.2, 0.5)] * 8)
    turned = robot.pose[2]
    assert robot.pose[:2] == pytest.approx([0.4 * math.sin(turned), 0.4 * (1 - math.cos(turned))], abs=6e-3)


def test_a_wall_holds_the_body_and_not_the_wheels():
    robot, answer = driven([(0.4, 0.0)] * 100, Room(np.array([[[1.0, -1.0], [1.0, 1.0]]]), np.zeros(3)))
    assert 0.0 < 1.0 - RADIUS - robot.pose[0] < 0.01
    assert answer.x > 9000


def test_wherever_it_is_driven_it_stays_in_its_room():
    rng = np.random.default_rng(0)
    place = room(4)
    made = drive(place, lambda _: (0.4, float(rng.uniform(-2, 2))), 15.0, np.random.default_rng(1))
    assert min(clearance(place, pose) for pose in made.poses) >= RADIUS - 1e-9


def test_without_noise_a_sonar_reads_the_nearest_wall_in_its_cone_unless_that_mirrors_the_sound_away():
    place = room(0)
    for pose in np.random.default_rng(0).uniform([0.3, 0.3, -9.0], [2.0, 3.0, 9.0], (20, 3)):
        heard = Robot(Room(place.segments, pose), np.random.default_rng(0), IDEAL).answer(0.0).distances
        echo = cast(place, compose(pose, SONARS))
        seen = (echo.distance < 4.0) & (echo.incidence <= math.radians(15.0))
        assert heard == tuple(np.where(seen, np.round(1000.0 * echo.distance), 4000).astype(int).tolist())


DT = 0.01


def speeds(wanted, load=lambda t: 0.0, loop=None):
    """Speeds of a wheel after each step for the speeds wanted."""
    loop, speed, out = loop or SpeedLoop(), 0.0, []
    for k, w in enumerate(wanted):
        speed = turned(speed, loop.duty(w, speed, DT), DT, load(k * DT))
        out.append(speed)
    return np.array(out)


def test_without_loop_the_motor_lags_and_friction_slows_it():
    speed = 0.0
    for _ in range(round(LAG / 1e-4)):
        speed = turned(speed, 0.5, 1e-4)
    assert speed == pytest.approx((0.5 - FRICTION) * FULL_SPEED * (1 - np.exp(-1.0)), rel=1e-3)
    assert turned(0.0, 0.9 * FRICTION, DT) == 0.0


def test_a_wheel_that_was_held_does_not_run_on():
    """Held for 5 s by a load it cannot move, then let go: it is at its speed within 0.3 s and never 10 % above."""
    out = speeds([0.2] * 700, load=lambda t: 1.0 if 1.0 <= t < 6.0 else 0.0)
    assert (out[150:600] == 0.0).all()
    assert out[600:].max() < 1.1 * 0.2
    assert out[630:] == pytest.approx(0.2, rel=0.05)


def test_without_noise_a_range_is_where_the_beam_meets_a_wall():
    place, lidar = room(0), Lidar(beams=90, reach=9.0, sigma=0.0, dropout=0.0)
    pose = np.array([4.0, 2.0, 0.7])
    scan = lidar.scan(place, pose, 1.2345, (1, 2, 3), np.random.default_rng(0))
    angle = pose[2] - np.pi + 2.0 * np.pi * np.arange(90) / 90
    true = cast(place, np.column_stack([np.tile(pose[:2], (90, 1)), angle]), 0.0).distance
    np.testing.assert_allclose(scan.metres, np.where(true < 9.0, true, 0.0), atol=0.0006)
    assert (scan.stamp, scan.odometry) == (1234, (1, 2, 3))


def by_beams(segments, pose, half_angle, beams=4001):
    """Nearest hit of beams all over the cone, each against every segment."""
    angle = pose[2] + np.linspace(-half_angle, half_angle, beams)[:, None]
    d = np.stack([np.cos(angle), np.sin(angle)], -1)
    a, e = segments[:, 0] - pose[:2], segments[:, 1] - segments[:, 0]
    cross = d[..., 0] * e[:, 1] - d[..., 1] * e[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        r = (a[:, 0] * e[:, 1] - a[:, 1] * e[:, 0]) / cross
        u = (a[:, 0] * d[..., 1] - a[:, 1] * d[..., 0]) / cross
    return np.where((cross != 0) & (r > 0) & (u >= 0) & (u <= 1), r, np.inf).min()


def test_a_cone_across_a_wall_reads_the_perpendicular_and_one_aslant_the_nearer_edge():
    start = np.array([[5.0, 1.0, -math.pi / 2], [5.0, 1.0, -math.pi / 2 + math.radians(30.0)]])
    echo = cast(room(0), start)
    np.testing.assert_allclose(echo.distance, [1.0, 1.0 / math.cos(math.radians(22.5))], rtol=1e-12)
    np.testing.assert_allclose(echo.incidence, [0.0, math.radians(22.5)], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_wall_in_the_cone_is_that_of_a_fan_of_fine_beams(seed):
    rng = np.random.default_rng(seed)
    place = room(seed)
    poses = np.column_stack([rng.uniform(0.2, 4.8, (20, 2)), rng.uniform(-9, 9, 20)])
    for half_angle in (math.radians(7.5), 0.4, math.pi):
        expected = [by_beams(place.segments, p, half_angle) for p in poses]
        np.testing.assert_allclose(cast(place, poses, half_angle).distance, expected, rtol=2e-3)


def test_clearance_is_the_distance_to_the_nearest_wall_all_round():
    place = room(3)
    for point in np.random.default_rng(0).uniform(0.5, 4.5, (20, 2)):
        round_about = cast(place, np.array([[*point, 0.3]]), math.pi).distance[0]
        assert clearance(place, point) == pytest.approx(round_about)


@pytest.mark.parametrize("seed", range(30))
def test_every_room_is_that_of_its_seed_and_lets_the_robot_start_and_pass(seed):
    place, again = room(seed), room(seed)
    np.testing.assert_array_equal(place.segments, again.segments)
    assert clearance(place, place.start) >= 1.0 - 1e-12 > GAP > 2 * RADIUS
    assert cast(place, place.start[None], 0.0).distance[0] > 1.0


def test_rooms_differ():
    assert len({room(seed).segments.tobytes() for seed in range(30)}) == 30
