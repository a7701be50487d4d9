"""Walls packet by packet: right within their covariance, each reading used once, no wall where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.se2 import between, compose, wrap_angle
from wings.robot.driving import WallFollower
from wings.robot.observe import WallObserver
from wings.robot.packets import CONE_HALF_ANGLE, PERIOD, SONARS, WHEEL_BASE, Answer
from wings.robot.simulated.physics import Physics, drive
from wings.robot.simulated.room import Room, cast, room
from wings.robot.traffic.stream import Packet
from wings.robot.walls import MIRROR

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


SLIPS = pytest.mark.parametrize("slip", [0.0, 0.02], ids=["the sonars' noise is all", "most is the wheels' slip"])


@SLIPS
@pytest.mark.slow
def test_errors_are_as_large_as_their_covariance_says(slip):
    """2 dof; 0.7 is 2.5 sigma of the mean of 50."""
    assert nees_at_random(slip, 50) == pytest.approx(2.0, abs=0.7)


def test_a_gross_outlier_now_and_then_and_a_missed_echo_do_no_harm():
    rng = np.random.default_rng(3)
    heard, poses = packets(WALL, [(STEP, 0.0)] * 90, rng)
    for k in range(5, 90, 7):
        heard[k].ranges[6] = rng.uniform(0.05, 0.5) if k % 2 else np.inf
    found = errors(WALL, heard, poses, WallObserver())
    assert len(found) > 10
    assert nees(found).max() < 16.0


@pytest.mark.parametrize("heading", [0.0, -0.2])
def test_on_the_way_to_a_wall_there_is_no_observation(heading):
    """Weaving a little, as any robot does, so that the cone sweeps."""
    place, rng = Room(np.array([[[4.0, -9.0], [4.0, 9.0]]]), np.zeros(3)), np.random.default_rng(4)
    turns = np.diff(0.1 * rng.standard_normal(56))
    heard, poses = packets(place, [(STEP, turn) for turn in turns], rng, start=(0.0, 0.0, heading))
    assert not errors(place, heard, poses, WallObserver())


def test_ends_of_a_wall_are_not_walls_at_an_angle():
    """Past a box, 2 m away: near its ends the cone hears a point, and the line through it is 8 degrees off."""
    place = Room(np.array([[[2.0, -2.0], [4.0, -2.0]]]), np.zeros(3))
    found = []
    for seed in range(3):
        heard, poses = packets(place, [(STEP, 0.0)] * 90, np.random.default_rng(seed))
        found += errors(place, heard, poses, WallObserver())
    assert len(found) >= 6
    assert nees(found).max() < 16.0


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
