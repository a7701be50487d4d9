"""The simulated robot moves as its wheels do, stops by itself, and hears what the walls give."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.se2 import compose
from wings.robot.packets import PERIOD, RADIUS, SONARS, WHEEL_BASE, command_of
from wings.robot.simulated import physics
from wings.robot.simulated.physics import Physics, Robot, drive
from wings.robot.simulated.room import Room, cast, clearance, room

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


def test_odometry_follows_the_wheels_to_a_few_ticks_and_the_ground_follows_with_slip():
    commands = [(0.3, 0.4)] * 8
    robot, answer = driven(commands)
    tick = 1000.0 * physics.METRES_PER_TICK
    assert answer.x == pytest.approx(1000.0 * robot.pose[0], abs=2.0 * tick + 1.0)
    assert answer.y == pytest.approx(1000.0 * robot.pose[1], abs=2.0 * tick + 1.0)
    ends = np.array([driven(commands, how=Physics(), seed=s)[0].pose for s in range(80)])
    expected = (
        0.005 * math.sqrt(2.0 * 0.3 * len(commands) * PERIOD) / WHEEL_BASE
    )  # of the heading, by both wheels' ways
    assert ends[:, 2].std() == pytest.approx(expected, rel=0.25)
    assert {driven(commands, how=Physics(), seed=s)[1][1:] for s in range(3)} == {answer[1:]}


@pytest.mark.parametrize("told", [0.0, 0.003, 0.0099])
@pytest.mark.parametrize("command", [(0.4, 0.0), (-0.4, 0.0), (0.0, 3.2)])
def test_it_stands_a_second_after_the_last_command_and_not_much_before(told, command):
    robot = Robot(LARGE, np.random.default_rng(0))
    robot.command(told, command_of(*command))
    robot.advance(told + 0.85)
    assert max(map(abs, robot.wheels)) == pytest.approx(0.4, rel=1e-3)
    robot.advance(told + 1.0)
    at = robot.pose.copy()
    assert robot.wheels == (0.0, 0.0)
    robot.advance(10.0)
    np.testing.assert_array_equal(robot.pose, at)


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


def test_readings_scatter_drop_out_and_come_too_early_as_often_as_is_said():
    how = Physics(range_sigma=0.02, dropout=0.1, crosstalk=0.2)
    wall = np.array([[[1.15, -9.0], [1.15, 9.0]]])
    robot = Robot(Room(wall, np.zeros(3)), np.random.default_rng(0), how)
    ahead = np.array([robot.answer(0.0).distances[0] for _ in range(800)])
    assert np.mean(ahead == 4000) == pytest.approx(0.1 * 0.8, abs=0.03)
    near = ahead[(ahead > 930) & (ahead < 1070)]
    assert near.std() == pytest.approx(20.0, rel=0.15)
    assert np.mean(ahead < 930) == pytest.approx(0.2 * 0.9 * 0.93 + 0.2 * 0.1 * 0.23, abs=0.04)
