"""Scan-matching odometry where odometry or the surroundings are not what they were; truth by plain geometry."""

from __future__ import annotations

import numpy as np
import pytest

from data.se2 import between, compose
from tests.wings.laser.scans.rooms import ROOM, SCANNER, scan
from wings.laser.scans.points import beams_of, scan_points
from wings.laser.slam.parameters import LaserParameters
from wings.laser.slam.tracker import Tracker

BEAMS = beams_of(SCANNER, 180)


def seen(pose, walls):
    return scan_points(scan(pose, walls), BEAMS, 20.0)


def started(pose, walls):
    tracker = Tracker(LaserParameters(), SCANNER.sigma)
    tracker.correct(seen(pose, walls))
    tracker.make_key(seen(pose, walls))
    return tracker


def test_who_reverses_ever_faster_while_odometry_says_forward_is_followed():
    start = np.array([0.0, 1.0, 0.3])
    tracker, pose = started(start, ROOM), start
    for distance in (0.05, 0.15, 0.3, 0.5, 0.7):
        pose = compose(pose, np.array([-distance, 0.0, 0.0]))
        tracker.predict(np.array([distance, 0.0, 0.0]), 1e-4 * np.eye(3))
        tracker.correct(seen(pose, ROOM))
        assert np.hypot(*(tracker.pose - between(start, pose))[:2]) < 0.02


def corridor(end):
    return np.array([[-60, -1, 60, -1], [-60, 1, 60, 1], [end, -1, end, 1]], float)


@pytest.mark.parametrize("moved", [-0.28, -0.1, 0.2])
def test_a_door_that_moves_at_the_end_of_a_corridor_does_not_move_the_robot(moved):
    tracker, step = started(np.zeros(3), corridor(6.0)), np.array([0.2, 0.0, 0.0])
    tracker.predict(step, 1e-5 * np.eye(3))
    tracker.correct(seen(step, corridor(6.0 + moved)))
    assert tracker.pose == pytest.approx(step, abs=0.005)
