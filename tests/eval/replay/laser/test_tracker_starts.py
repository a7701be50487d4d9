"""From where the tracker matches a scan, and which match it believes; the matches are made up."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from association.scans.matching import Match
from association.scans.points import Points
from eval.replay.laser import tracker as module
from eval.replay.laser.parameters import LaserParameters
from eval.replay.laser.tracker import BETTER, FIRM, MUCH_BETTER, OTHER_START, SURPRISE, Tracker

POINTS = Points(np.array([[1.0, 0.0]]), np.array([[1.0, 0.0]]))
FINE = 1e-4 * np.eye(3)


class Made:
    """A tracker with one key pose whose matches are given: pose or None for the start, cost, share."""

    def __init__(self, monkeypatch):
        self.asked, self.given = [], []
        monkeypatch.setattr(module, "match", self.match)
        self.tracker = Tracker(LaserParameters(), 0.01)
        self.tracker.make_key(POINTS)

    def match(self, points, reference, start, prior, sigma, scale):
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


GOOD = (None, 0.1, 1.0)


def test_at_first_there_is_one_start_where_odometry_says(made):
    made.tracker.predict(np.array([0.02, 0.0, 0.0]), FINE)
    assert made.correct(GOOD)
    assert made.starts == [[0.02, 0.0, 0.0]]
    assert made.asked[0][1] == LaserParameters().prior_scale


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("times", [-1.1, -0.9, 0.9, 1.1])
def test_where_the_last_motion_predicts_another_pose_that_is_a_second_start(made, axis, times):
    """It stood still until now."""
    step = times * OTHER_START[axis] * np.eye(3)[axis]
    made.tracker.predict(step, np.eye(3))
    made.correct(*[GOOD] * (2 if abs(times) > 1.0 else 1))
    assert made.starts[0] == pytest.approx(step.tolist())
    assert made.starts[1:] == ([[0.0, 0.0, 0.0]] if abs(times) > 1.0 else [])


def test_the_last_motion_goes_on_for_as_many_frames_as_were_predicted(made):
    for _ in range(2):
        made.tracker.predict(np.array([0.1, 0.0, 0.0]), np.eye(3))
    made.correct(([0.2, 0.04, 0.0], 0.1, 1.0), GOOD)
    assert made.tracker.pose.tolist() == [0.2, 0.04, 0.0]
    for _ in range(3):
        made.tracker.predict(np.zeros(3), np.eye(3))
    made.correct(GOOD, GOOD)
    assert made.starts == [[0.2, 0.04, 0.0], pytest.approx([0.5, 0.1, 0.0])]


@pytest.mark.parametrize(("better", "believed"), [(0.9 * BETTER, False), (1.1 * BETTER, True)])
def test_the_second_start_is_believed_where_it_fits_clearly_better(made, better, believed):
    made.tracker.predict(np.array([0.1, 0.0, 0.0]), np.eye(3))
    made.correct((None, 0.3, 1.0), (None, 0.3 - better, 1.0))
    assert made.tracker.pose[0] == (0.0 if believed else 0.1)


@pytest.mark.parametrize(("better", "believed"), [(0.9 * MUCH_BETTER, False), (1.1 * MUCH_BETTER, True)])
def test_what_contradicts_odometry_is_believed_where_it_fits_much_better(made, better, believed):
    made.tracker.predict(np.zeros(3), FINE)
    off = 0.011 * math.sqrt(SURPRISE)
    made.correct(([off, 0.0, 0.0], 0.3 - better, 1.0), ([0.001, 0.0, 0.0], 0.3, 1.0))
    assert made.asked[1][1] == FIRM
    assert made.starts[1] == [0.0, 0.0, 0.0]
    assert made.tracker.pose[0] == (off if believed else 0.001)


def test_what_does_not_contradict_odometry_is_believed_at_once(made):
    made.tracker.predict(np.zeros(3), FINE)
    made.correct(([0.0, 0.009 * math.sqrt(SURPRISE), 0.0], 0.3, 1.0))
    assert made.tracker.pose[1] > 0.04


def test_far_from_the_key_pose_what_agrees_with_odometry_is_no_surprise(made):
    made.tracker.predict(np.array([0.3, -0.2, 0.1]), FINE)
    made.correct(([0.301, -0.199, 0.1], 0.3, 1.0), (None, 0.9, 1.0))
    assert made.tracker.pose.tolist() == [0.301, -0.199, 0.1]


def test_headings_are_compared_over_the_half_turn(made):
    """Turned about once, it is matched from the other side of the half turn: that is no surprise."""
    tracker = made.tracker
    tracker.predict(np.array([0.0, 0.0, math.pi - 0.004]), FINE)
    made.correct(([0.0, 0.0, -math.pi + 0.004], 0.1, 1.0), (None, 0.9, 1.0))
    assert tracker.pose[2] == -math.pi + 0.004
    tracker._motion = np.zeros(3)
    tracker.predict(np.array([0.0, 0.0, -0.006]), FINE)
    made.correct(GOOD)
    assert tracker.pose[2] == pytest.approx(math.pi - 0.002)


@pytest.mark.parametrize(("share", "fits"), [(0.99, False), (1.01, True)])
def test_a_scan_that_does_not_fit_leaves_the_prediction(made, share, fits):
    made.tracker.predict(np.array([0.01, 0.0, 0.0]), FINE)
    least = LaserParameters().least_share
    assert made.correct(([0.02, 0.0, 0.0], 0.1, share * least)) == fits
    assert made.tracker.pose[0] == (0.02 if fits else 0.01)
    assert made.tracker.covariance == pytest.approx(1e-6 * np.eye(3) if fits else FINE)


def test_without_points_or_a_key_pose_nothing_is_matched(made):
    assert not Tracker(LaserParameters(), 0.01).correct(POINTS)
    assert not made.tracker.correct(Points(np.empty((0, 2)), np.empty((0, 2))))


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


def test_a_new_key_pose_is_the_origin_and_the_motion_goes_on_from_it(made):
    tracker = made.tracker
    tracker.predict(np.array([0.1, 0.0, math.pi / 2]), np.eye(3))
    made.correct(GOOD, (None, 0.9, 1.0))
    tracker.make_key(POINTS)
    assert tracker.pose.tolist() == [0.0, 0.0, 0.0]
    assert not tracker.covariance.any()
    tracker.predict(np.zeros(3), np.eye(3))
    made.correct(GOOD, GOOD)
    assert made.starts[1] == pytest.approx([0.1, 0.0, math.pi / 2])


def test_scans_of_the_last_key_poses_are_the_reference(made):
    seen = []
    made.tracker._grid = SimpleNamespace(reference=lambda xy, normal: seen.append((xy, normal)))
    for _ in range(LaserParameters().window + 1):
        made.tracker.pose = np.array([1.0, 2.0, math.pi / 2])
        made.tracker.make_key(POINTS)
    xy, normal = seen[0]
    assert xy == pytest.approx(np.array([[-2.0, 0.0], [1.0, 0.0]]))
    assert normal == pytest.approx(np.array([[0.0, -1.0], [1.0, 0.0]]))
    assert [len(points) for points, _ in seen[-2:]] == [LaserParameters().window] * 2
