"""Frame by frame: redundant key poses leave as the robot drives, and their number does not grow where it stays."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from data.inputs import Increment, Prior
from data.se2 import between, compose
from wings.laser.slam.incremental import MOST_AT_ONCE, ScanSlam
from wings.laser.slam.parameters import LaserParameters
from wings.robot.simulated.physics import Lidar
from wings.robot.simulated.room import room

ROUNDS, FRAMES = 4, 60  # on an ellipse through the room, frames each
EXACT = Prior(np.zeros(3), np.zeros((3, 3)))
SIGMA = np.array([0.01, 0.005, 0.01])


@cache
def driven():
    """True poses (N, 3) from the first one, increments, and scans (N, B)."""
    rng, lidar, place = np.random.default_rng(0), Lidar(beams=180), room(0)
    angle = 2.0 * math.pi * np.arange(ROUNDS * FRAMES) / FRAMES
    xy = np.column_stack([5.0 + 3.8 * np.sin(angle), 3.0 - 2.0 * np.cos(angle)])
    heading = np.arctan2(2.0 * np.sin(angle), 3.8 * np.cos(angle))
    world = np.column_stack([xy, heading])
    scans = [lidar.scan(place, pose, 0.0, (0, 0, 0), rng).metres for pose in world]
    motion = between(world[:-1], world[1:]) + SIGMA * rng.standard_normal((len(world) - 1, 3))
    return between(world[0], world), motion, scans, lidar.directions.scanner(lidar.sigma)


@cache
def found(least):
    """The front end's online poses (N, 3), the number of its key poses (N,), and itself."""
    _, motion, scans, scanner = driven()
    slam = ScanSlam(EXACT, scanner, 180, LaserParameters(), least=least, with_covariance=True)
    online, size, claimed = [], [], []
    for k, ranges in enumerate(scans):
        increment = Increment(motion[k - 1], np.diag(SIGMA**2)) if k else None
        online.append(slam.step(increment, ranges, 0.25))
        size.append(slam.size)
        claimed.append(slam.covariance)
    return np.array(online), np.array(size), np.array(claimed), slam


def off(least):
    return np.hypot(*(found(least)[0] - driven()[0])[2 * FRAMES :, :2].T)


def test_their_number_does_not_grow_from_round_to_round_and_without_it_does():
    third, last = (found(0.1)[1][rounds * FRAMES - 1] for rounds in (3, ROUNDS))
    assert last <= third + 2
    everything = found(None)[1]
    assert everything[-1] - everything[3 * FRAMES - 1] > 30
    assert last < 0.5 * everything[-1]


@pytest.mark.slow
def test_the_cost_is_millimetres():
    all_of_them, few = off(None), off(0.1)
    assert np.sqrt((all_of_them**2).mean()) < 0.01
    assert np.sqrt((few**2).mean()) < 0.02


def test_the_covariance_is_that_of_the_frame_and_safe():
    _, _, claimed, _ = found(0.1)
    error = found(0.1)[0] - driven()[0]
    error[:, 2] = np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2]))
    nees = np.einsum("ki,kij,kj->k", error[FRAMES:], np.linalg.inv(claimed[FRAMES:]), error[FRAMES:])
    assert (np.linalg.eigvalsh(claimed[1:]) > 0.0).all()
    assert nees.mean() < 6.0


def test_poses_of_those_that_left_are_unknown_and_their_scans_are_forgotten():
    slam, p = found(0.1)[3], LaserParameters()
    number, poses = slam.keys()
    assert len(number) == slam.size
    assert np.isfinite(poses).all()
    gone = np.setdiff1d(np.arange(len(slam.frames)), number)
    assert np.isnan(slam.poses[gone]).all()
    assert all(len(slam.closer.ranges(int(k))) == 0 for k in gone)
    assert number[0] == 0
    assert MOST_AT_ONCE * len(slam.frames) > len(gone) > 0
    assert len(slam.closer.candidates) <= p.loops_per_key * (p.wait + 2)
    assert compose(poses[-1], slam.tracker.pose).shape == (3,)
