"""The wall follower stays off the walls, goes round, and keeps its distance."""

from __future__ import annotations

import numpy as np
import pytest

from wings.robot.driving import SPEED, WANTED, WallFollower
from wings.robot.packets import PERIOD, RADIUS, SONARS, Answer
from wings.robot.simulated.physics import Physics, drive
from wings.robot.simulated.room import Room, clearance, room
from wings.robot.traffic.stream import Packet

QUIET = Physics(slip=0.0, range_sigma=0.0, dropout=0.0, crosstalk=0.0)


def heard(*rows, k=0, joined=True, **distances):
    """A packet with distances [m] of rows of sonars."""
    ranges = np.full(len(SONARS), np.inf)
    for row, distance in rows:
        ranges[row] = distance
    return Packet(k * PERIOD, ranges, np.zeros(3), joined, Answer((4000,) * 8, 0, 0, 0))


def margin(place, way):
    """Least distance [m] of the rim from a wall on the way driven."""
    return min(clearance(place, pose) for pose in way.poses) - RADIUS


def test_it_stops_and_turns_left_at_a_wall_ahead_but_not_for_one_short_reading():
    follower = WallFollower()
    follower(heard())
    assert follower(heard((0, 0.2), k=1))[0] > 0.0
    assert follower(heard((0, 0.2), k=2))[0] == 0.0
    v, omega = follower(heard((0, 0.2), k=3))
    assert v == 0.0
    assert omega > 0.0


def test_it_comes_to_its_distance_along_a_wall():
    corridor = Room(np.array([[[-5.0, 0.0], [40.0, 0.0]]]), np.array([0.0, 1.0, 0.0]))
    way = drive(corridor, WallFollower(), 40.0, np.random.default_rng(0), QUIET)
    assert way.poses[80:, 1] == pytest.approx(WANTED, abs=0.03)
    assert way.poses[:, 1].min() > WANTED - 0.05
    assert way.poses[-1, 0] > 8.0


def test_after_odometry_began_anew_what_was_seen_before_is_forgotten():
    follower = WallFollower()
    for k in range(6):
        follower(heard((6, 0.9), k=k))
    assert follower(heard(k=6, joined=False)) == pytest.approx((SPEED, 0.0))


def five_minutes(seed):
    """Margin [m] in the room of a seed, and the shares of its width and depth that were driven."""
    place = room(seed)
    way = drive(place, WallFollower(), 300.0, np.random.default_rng(100 + seed))
    return margin(place, way), np.ptp(way.poses[:, :2], axis=0) / np.ptp(place.segments.reshape(-1, 2), axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(15))
def test_five_minutes_round_a_room_without_touching_a_wall(seed):
    least, extent = five_minutes(seed)
    assert least > 0.1
    assert (extent > 0.75).all()
