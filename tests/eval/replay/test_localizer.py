"""A robot in a known map without labels: what counts as paired, when it is lost, and how it is found again."""

import math

import numpy as np
import pytest

from data.errors import UsageError
from data.inputs import Frame, FrameObservations, Increment, LandmarkMap, Prior
from data.notice import Code, notice
from data.result import DISCARD
from data.sensors import RelativePoint
from eval.replay.hindsight.localizing_frontend import LocalizingFrontEnd
from eval.replay.settings import HINDSIGHT, Beginning, Setup

SENSOR = RelativePoint(max_range=20.0)
R = np.diag([0.05, 0.05]) ** 2
IDS = np.array([0, 3, 4, 7, 8, 9])
PLACES = np.array([[4.0, 1.0], [2.0, -3.0], [-3.0, 2.5], [-1.0, -4.0], [5.5, 4.0], [0.5, 5.0]])
PRIOR = Prior(np.zeros(3), np.diag([0.1, 0.1, 0.05]) ** 2)
STILL = Increment(np.zeros(3), np.diag([0.02, 0.02, 0.01]) ** 2)
START = (0.0, 0.0, 0.0)
THERE = (2.0, 1.0, 2.0)
"""Where it is carried to, m and rad."""
STRANGE = np.array([[-9.0, 6.0], [8.0, -7.0], [-11.0, -2.0], [10.0, 9.0], [1.0, -12.0], [-5.0, 13.0]])
"""m, in the body frame: no places of the map."""


def body(pose, places=PLACES):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return (places - np.array(pose[:2])) @ np.array([[c, -s], [s, c]])


class Robot:
    """Hands its readings to a localizer, frame by frame, without moving by its odometry."""

    def __init__(self, ids=IDS, places=PLACES):
        self.localizer = LocalizingFrontEnd(
            "ekf", HINDSIGHT, Beginning(PRIOR, SENSOR, LandmarkMap(ids, places)), Setup()
        )
        self.frames = self.rows = 0

    def sees(self, z):
        z = np.asarray(z, float)
        seen = FrameObservations(z, np.tile(R, (len(z), 1, 1)))
        frame = Frame(self.frames, 0.1 * self.frames, STILL if self.frames else None, seen, None, self.rows)
        self.localizer.move(frame)
        decisions = self.localizer.associate(frame).decisions.tolist()
        self.frames, self.rows = self.frames + 1, self.rows + len(z)
        return decisions


def test_without_a_map_there_is_nothing_to_decide_about():
    with pytest.raises(UsageError, match="need a known map"):
        LocalizingFrontEnd("ekf", HINDSIGHT, Beginning(PRIOR, SENSOR), Setup())


def test_a_robot_that_was_carried_away_is_lost_and_found_where_it_stands():
    robot = Robot()
    for _ in range(3):
        assert robot.sees(body(START)) == IDS.tolist()
    assert robot.sees(body(THERE)) == [DISCARD] * 6
    assert robot.localizer.alarms == []
    assert robot.sees(body(THERE)[::-1]) == IDS[::-1].tolist()
    localizer = robot.localizer
    assert (localizer.alarms, localizer.found) == ([4], [4])
    assert localizer.bank.estimate().mean == pytest.approx(THERE, abs=1e-6)
    assert not localizer.health.lost
    for _ in range(2):
        assert robot.sees(body(THERE)) == IDS.tolist()
    localizer.close()
    assert (localizer.alarms, localizer.found) == ([4], [4])
    assert localizer.online == [*IDS.tolist() * 3, *[DISCARD] * 6, *IDS[::-1].tolist(), *IDS.tolist() * 2]
    # the frame before the alarm was seen from there, too
    assert [(e.frame, e.observation, e.old, e.new) for e in localizer.events()] == [
        (4, 18 + i, DISCARD, number) for i, number in enumerate(IDS.tolist())
    ]
    assert localizer.notes() == [
        notice(Code.REVISED_POSES, decisions=6),
        notice(Code.FOUND_AGAIN, times=1, first=4, found=1),
    ]


def test_a_robot_that_is_found_nowhere_is_lost_once_and_stays_lost():
    robot = Robot()
    robot.sees(body(START))
    for _ in range(6):
        assert robot.sees(STRANGE) == [DISCARD] * 6
    assert robot.localizer.health.lost
    assert (robot.localizer.alarms, robot.localizer.found) == ([2], [])
    assert robot.localizer.events() == ()


def test_what_was_seen_on_the_way_does_not_keep_a_robot_from_being_found():
    robot = Robot()
    robot.sees(body(START))
    robot.sees(STRANGE)
    assert robot.sees(STRANGE[::-1] + 3.0) == [DISCARD] * 6
    assert robot.sees(body(THERE)) == IDS.tolist()
    assert (robot.localizer.alarms, robot.localizer.found) == ([2], [3])
    assert robot.localizer.bank.estimate().mean == pytest.approx(THERE, abs=1e-6)
    robot.localizer.close()
    assert robot.localizer.events() == ()


@pytest.mark.parametrize(("shown", "number", "frame", "why"), [
    (0.15, 1, 1, "another hypothesis leads"), (-0.15, 2, 3, "put off until the end"),
])  # fmt: skip
def test_a_reading_that_may_be_of_four_landmarks_waits_until_more_is_known(shown, number, frame, why):
    # around what is seen; beside it they are as likely at twice the distance, as the heading is not known well
    near = np.array([[4.15, 0.0], [3.85, 0.0], [4.0, 0.31], [4.0, -0.31]])
    robot = Robot(np.array([1, 2, 5, 6, 9]), np.vstack([near, [[0.0, 6.0]]]))
    assert robot.sees([[3.995, 0.0]]) == [DISCARD]  # the one that leads is 2
    for _ in range(3):  # at 0.15 m before or behind where it was thought to be, as its other readings show
        assert robot.sees([[-shown, 6.0]]) == [9]
    robot.localizer.close()
    (event,) = robot.localizer.events()
    assert (event.frame, event.observation, event.old, event.new, event.why) == (frame, 0, DISCARD, number, why)
    assert robot.localizer.online == [DISCARD, 9, 9, 9]
    assert robot.localizer.notes() == [notice(Code.REVISED_POSES, decisions=1)]
