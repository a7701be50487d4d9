"""Scan-matching odometry: from where a scan is matched, which match is believed, and surroundings that change."""

import numpy as np
import pytest

from data.se2 import between, compose
from tests.wings.laser.scans.rooms import ROOM, SCANNER, scan
from wings.laser.scans.matching import Match
from wings.laser.scans.points import Points, beams_of, scan_points
from wings.laser.slam import incremental as module
from wings.laser.slam.incremental import Tracker
from wings.laser.slam.parameters import LaserParameters

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


POINTS = Points(np.tile([1.0, 0.0], (100, 1)), np.tile([1.0, 0.0], (100, 1)))
FINE = 1e-4 * np.eye(3)


class Made:
    """A tracker with one key pose whose matches are given: pose or None for the start, cost, share."""

    def __init__(self, monkeypatch):
        self.asked, self.given = [], []
        monkeypatch.setattr(module, "match", self.match)
        self.tracker = Tracker(LaserParameters(), 0.01)
        self.tracker.make_key(POINTS)

    def match(self, points, reference, start, prior, sigma, scale, least):
        pose, cost, share = self.given[len(self.asked)]
        self.asked.append((np.array(start), scale))
        return Match(np.array(start if pose is None else pose, float), 1e-6 * np.eye(3), cost, share)

    def correct(self, *given):
        self.asked, self.given = [], list(given)
        fits = self.tracker.correct(POINTS)
        assert len(self.asked) == len(given)
        return fits

    @property
    def starts(self):
        return [start.tolist() for start, _ in self.asked]


@pytest.fixture
def made(monkeypatch):
    return Made(monkeypatch)


@pytest.mark.parametrize(("share", "fits"), [(0.99, False), (1.01, True)])
def test_a_scan_that_does_not_fit_leaves_the_prediction(made, share, fits):
    made.tracker.predict(np.array([0.01, 0.0, 0.0]), FINE)
    assert made.correct(([0.02, 0.0, 0.0], 0.1, share * LaserParameters().least_share)) == fits
    assert made.tracker.pose[0] == (0.02 if fits else 0.01)
    assert made.tracker.covariance == pytest.approx(1e-6 * np.eye(3) if fits else FINE)


def test_a_key_pose_is_due_when_the_last_is_far_or_saw_nothing(made):
    p, tracker = LaserParameters(), made.tracker
    due = []
    for pose in ([0.0, 0.0, 0.0], [0.72, 0.72, 0.0], [0.7, 0.7, 0.0]):
        tracker.pose = np.array([p.keyframe_distance * pose[0], p.keyframe_distance * pose[1], 0.0])
        due.append(tracker.is_due)
    for angle in (-0.99, -1.01, 0.99, 1.01):
        tracker.pose = np.array([0.0, 0.0, angle * p.keyframe_angle])
        due.append(tracker.is_due)
    assert due == [False, True, False, False, True, False, True]
    empty = Tracker(p, 0.01)
    assert empty.is_due
    empty.make_key(Points(np.empty((0, 2)), np.empty((0, 2))))
    assert empty.is_due
