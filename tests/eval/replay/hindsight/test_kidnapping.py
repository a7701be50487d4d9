"""The monitor of SLAM: what raises the alarm, what is done until the place is found, and what it says of it."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from association.expectation import Expectation
from data.inputs import Frame, FrameObservations, Increment
from data.notice import Code, notice
from data.result import DISCARD, NEW
from data.sensors import RelativePoint
from eval.replay.hindsight import constants, kidnapping
from eval.replay.hindsight.kidnapping import Kidnapping, anywhere
from eval.replay.hindsight.ledger import Epoch, Ledger, Record
from eval.replay.hindsight.relocalize import EMPTY, Place
from eval.replay.settings import Setup

SENSOR = RelativePoint(max_range=20.0)
PLACES = np.array([[3.0, 0.0], [0.0, 4.0], [-3.0, 4.0]])
"""m, of the landmarks 0, 1, 2; the first two are confirmed."""


class World:
    """A ledger and filters that say what they are told to."""

    def __init__(self, monkeypatch):
        self.surprise, self.sigma, self.inflated, self.place, self.asked = 0.0, 5.0, [], None, []
        self.ledger = book = Ledger(SENSOR)
        book._read, book.created, book.frame = SENSOR, 3, -1
        book.surprise, book.confirmed = lambda: self.surprise, lambda: np.array([0, 1])
        book.paired = lambda decisions: int(np.isin(decisions, [0, 1]).sum())
        self.kidnapping = Kidnapping(book, Setup())
        slam = SimpleNamespace(
            sensor=SENSOR, xy=PLACES, mean=np.zeros(3), expect=self.expect,
            landmarks=lambda: SimpleNamespace(number=np.arange(3), xy=PLACES),
            estimate=lambda: SimpleNamespace(covariance=np.diag([self.sigma**2, self.sigma**2, 9.0])),
        )  # fmt: skip
        self.filters = SimpleNamespace(believed=slam, inflate=self.inflated.append)
        monkeypatch.setattr(kidnapping, "relocalize", self.relocalize)

    def expect(self, observations):
        joint = 0.01 * np.eye(2 * len(PLACES))
        return Expectation.from_arrays(observations.z, PLACES, joint, observations.R)

    def relocalize(self, scan, known):
        self.asked.append((scan, known.id.tolist()))
        return self.place

    def frame(self, *decisions, surprise=0.0, z=None):
        self.surprise, self.ledger.frame = surprise, self.ledger.frame + 1
        n = len(decisions)
        z = 20.0 * np.arange(1, 1 + 2 * n).reshape(-1, 2) if z is None else z
        observations = FrameObservations(z, np.tile(0.01 * np.eye(2), (n, 1, 1)))
        here = Frame(self.ledger.frame, 0.0, None, observations, None, 100 * self.ledger.frame)
        return self.kidnapping.decide(self.filters, here, np.array(decisions, np.int64))


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


ALARM = constants.ALARM + 0.1


def test_a_robot_that_misses_nothing_is_left_alone(world):
    done = world.frame(0, 1, NEW)
    assert done.decisions.tolist() == [0, 1, NEW]
    assert done.at is done.kidnapped is None
    assert (world.kidnapping.lost, world.inflated, world.kidnapping.notes()) == (False, [], [])


def test_surprises_add_up_to_an_alarm(world):
    for _ in range(2):
        assert world.frame(NEW, NEW, NEW, surprise=0.48 * ALARM).kidnapped is None
    assert world.frame(NEW, NEW, NEW, surprise=0.05 * ALARM).kidnapped is not None
    assert world.kidnapping.alarms == [2]
    assert world.kidnapping.lost


def test_a_pairing_with_a_certain_landmark_takes_something_off_and_trust_is_not_saved_up(world):
    world.frame(0, 1, 2)
    world.frame(NEW, NEW, NEW, surprise=0.9 * ALARM)
    world.frame(0, 2, NEW)
    assert world.frame(NEW, NEW, NEW, surprise=0.1 * ALARM + 0.9 * constants.PAIRING_TRUST).kidnapped is None
    assert world.frame(NEW, NEW, NEW, surprise=0.2 * constants.PAIRING_TRUST).kidnapped is not None


@pytest.mark.parametrize("seen", [0, constants.ALARM_OBSERVATIONS - 1, constants.ALARM_OBSERVATIONS])
def test_a_sensor_that_hardly_sees_is_covered_and_raises_no_alarm(world, seen):
    for _ in range(20):
        world.frame(*[NEW] * seen, surprise=ALARM)
    assert world.kidnapping.lost == (seen >= constants.ALARM_OBSERVATIONS)


def test_who_was_moved_unseen_may_be_anywhere_and_the_filter_gets_to_know(world):
    world.ledger.travelled = 12.0
    done = world.frame(NEW, NEW, NEW, surprise=ALARM)
    size = math.hypot(6.0, 4.0) + 20.0
    assert done.kidnapped == pytest.approx(np.diag([size**2, size**2, math.pi**2]))
    assert len(world.inflated) == 1
    assert world.inflated[0] is done.kidnapped
    assert world.ledger.epoch == Epoch(12.0, 3)
    again = world.frame(NEW, NEW, NEW, surprise=ALARM)
    assert again.kidnapped is None
    assert world.kidnapping.alarms == [0], "there is one alarm until the place is found"


def test_in_an_empty_map_anywhere_is_as_far_as_the_sensor_reaches():
    assert anywhere(np.empty((0, 2)), 7.0) == pytest.approx(np.diag([49.0, 49.0, math.pi**2]))


def test_while_lost_only_what_is_new_or_not_dense_may_be_paired(world):
    world.frame(NEW, NEW, NEW, surprise=ALARM)
    z = np.array([[3.0, 0.0], [0.0, 4.0], [7.0, -7.0]])
    assert world.frame(NEW, NEW, NEW, z=z).decisions.tolist() == [0, 1, NEW]
    crowd = np.tile([[1.0, 1.0]], (4000, 1))
    world.filters.believed.xy = crowd
    assert world.frame(NEW, NEW, NEW, z=z).decisions.tolist() == [NEW] * 3
    world.ledger.epoch = Epoch(0.0, 1)
    assert world.frame(NEW, NEW, NEW, z=z).decisions.tolist() == [NEW, 1, NEW]


def test_the_scan_since_the_alarm_is_looked_for_among_certain_landmarks_from_before(world):
    world.frame(0, 1, NEW)
    world.ledger.created = 1
    world.frame(NEW, NEW, NEW, surprise=0.9 * ALARM)  # here trouble begins: 0 alone was there before
    world.ledger.created = 3
    assert world.asked == []
    world.frame(NEW, NEW, NEW, surprise=0.2 * ALARM)
    world.kidnapping.move(Increment(np.array([1.0, 0.0, 0.0]), 1e-6 * np.eye(3)))
    world.frame(NEW)
    (first, among), (second, _) = world.asked
    assert among == [0]
    assert [len(first), len(second)] == [3, 4]
    assert first.rows == ((200,), (201,), (202,))
    assert sorted(second.xy[:, 0].tolist()) == pytest.approx([19.0, 20.0, 59.0, 99.0])


def test_before_an_alarm_nothing_is_collected(world):
    world.frame(NEW, NEW, NEW)
    world.kidnapping.move(Increment(np.ones(3), np.eye(3)))
    assert world.kidnapping._scan is EMPTY


@pytest.mark.parametrize(("sigma", "found"), [(2.0, False), (1.43, False), (1.4, True)])
def test_once_the_filter_knows_the_place_to_a_tenth_of_its_range_the_robot_is_found(world, sigma, found):
    assert constants.FOUND_AGAIN == 0.1
    world.frame(NEW, NEW, NEW, surprise=ALARM)
    world.sigma = sigma
    done = world.frame(0, NEW, NEW)
    assert world.kidnapping.lost != found
    assert world.kidnapping.found == [1] * found
    if found:
        assert done.decisions.tolist() == [0, NEW, NEW]


def lost_and_found(world):
    """Lost in frame 0, where rows 0 to 2 are read; in frame 1 its rows 100 and 101 and row 1 are found in the map."""
    world.frame(NEW, NEW, NEW, surprise=ALARM)
    world.ledger.records = {n: Record([(row, NEW)], (0.0, 0.0), 0.0, 0.0) for n, row in ((0, 900), (1, 901))}
    world.ledger.records |= {n: Record([(row, NEW)], (0.0, 0.0), 0.0, 0.0) for n, row in ((3, 0), (4, 1), (5, 2))}
    world.place = Place(np.array([1.0, 2.0, 0.3]), np.eye(3), np.array([-1, 1, -1, 0, -1]), 9.0)
    return world.frame(NEW, NEW, z=np.array([[1.0, 1.0], [2.0, -3.0]]))


def test_where_the_scan_has_one_place_the_frame_is_put_there(world):
    done = lost_and_found(world)
    assert done.at.tolist() == [1.0, 2.0, 0.3]
    assert done.decisions.tolist() == [0, DISCARD]
    assert done.kidnapped is None
    assert not world.kidnapping.lost
    assert world.kidnapping.found == [1]
    assert world.kidnapping.notes() == [notice(Code.MOVED_UNSEEN, times=1, first=0, found=1)]
    assert world.frame(NEW, NEW, NEW, surprise=0.9 * ALARM).kidnapped is None, "it begins at zero again"


def test_what_was_initialized_while_lost_and_stood_in_the_map_is_said_once(world):
    lost_and_found(world)
    assert world.kidnapping.duplicates() == [(4, 1)]
    assert world.kidnapping.duplicates() == []


@pytest.mark.parametrize("gone", [1, 4])
def test_a_landmark_that_is_not_in_the_map_any_more_is_no_duplicate(world, gone):
    lost_and_found(world)
    del world.ledger.records[gone]
    assert world.kidnapping.duplicates() == []
