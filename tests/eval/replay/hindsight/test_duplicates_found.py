"""Which landmarks are looked at for duplicates, and when; what is compared says which of them are one."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from association.appearance import Looks
from data.sensors import RelativePoint
from eval.replay.hindsight import constants, duplicates
from eval.replay.hindsight.duplicates import Duplicates, single
from eval.replay.hindsight.ledger import Epoch, Ledger, Record

REACH = 10.0
WINDOW, AGE = constants.WINDOW_SPAN * REACH, constants.WINDOW_AGE * REACH


class Asked:
    """A ledger of landmarks (first seen, last seen, how often), 100 m after the start, and what is asked of them."""

    def __init__(self, monkeypatch, *landmarks, epoch=10**6):
        self.ledger = book = Ledger(RelativePoint(max_range=REACH))
        book._read, book.travelled, book.created, book.frames = book.sensor, 100.0, len(landmarks), 50
        book.records = {n: Record([], (0.0, 0.0), a, b, times=c) for n, (a, b, c) in enumerate(landmarks)}
        book.epoch = Epoch(90.0, epoch)
        self.slam = SimpleNamespace(xy=np.zeros((7, 2)), mean=np.zeros(3))
        self.together, self.alone, self.found, self.one = [], [], [], []
        monkeypatch.setattr(duplicates, "constellation", self.constellation)
        monkeypatch.setattr(duplicates, "single", self.single)
        self.duplicates = Duplicates(book)

    def constellation(self, slam, ledger, young, old, density, scale):
        self.together.append((young, old, density, scale))
        return self.found if len(self.together) > 1 else []

    def single(self, slam, ledger, window, others, area, scale):
        self.alone.append((window, others, area, scale))
        return self.one

    def find(self):
        return self.duplicates.find(self.slam, 0.7)


DENSITY = 7 / (math.pi * REACH**2)
OLD, YOUNG = (10.0, 20.0, 3), (99.0, 99.0, 3)


def test_what_was_initialized_lately_and_is_in_the_window_is_compared_with_what_is_old(monkeypatch):
    landmarks = [
        (100.0 - AGE - 1.0, 30.0, 3),
        (100.0 - AGE + 1.0, 100.0 - WINDOW + 2.0, 2),
        (100.0 - AGE + 1.0, 100.0 - WINDOW - 1.0, 9),  # neither old nor in the window
        (99.0, 95.0, 1),  # seen once
        (60.0, 100.0 - WINDOW + 1.0, 2),
        OLD,
    ]
    asked = Asked(monkeypatch, *landmarks)
    asked.find()
    young, old, density, scale = asked.together[0]
    assert (young, old) == ([4, 1], [0, 5]), "in the order in which they were seen last"
    assert density == pytest.approx(DENSITY)
    assert scale == 0.7


def test_a_window_that_holds_old_landmarks_has_found_its_place(monkeypatch):
    asked = Asked(monkeypatch, OLD, (10.0, 95.0, 3), YOUNG, epoch=2)
    asked.find()
    assert [(young, old) for young, old, *_ in asked.together] == [([2], [0, 1])]  # what this epoch initialized alone


def test_what_this_epoch_initialized_is_compared_with_all_before_it(monkeypatch):
    asked = Asked(monkeypatch, OLD, (70.0, 97.0, 2), YOUNG, (98.0, 98.0, 2), epoch=2)
    asked.found = [(2, 0)]
    assert asked.find() == [(2, 0)]
    assert [(young, old) for young, old, *_ in asked.together] == [([1, 3, 2], [0]), ([3, 2], [0, 1])]
    assert asked.ledger.epoch == Epoch(-math.inf, 2), "it is known again which landmark is which"
    assert asked.alone == []


def test_single_pairs_are_looked_for_among_the_old_first_and_then_more_strictly_among_all(monkeypatch):
    asked = Asked(monkeypatch, OLD, (70.0, 97.0, 2), YOUNG)
    assert asked.find() == []
    (window, old, area, scale), (again, every, less, _) = asked.alone
    assert (window, old, scale) == ([1, 2], [0], 0.7)
    assert (again, every) == ([1, 2], [0, 1, 2])
    assert area == pytest.approx(constants.SINGLE_CHANCE / DENSITY)
    assert less == pytest.approx(constants.SINGLE_CHANCE_YOUNG * area)
    assert asked.ledger.epoch == Epoch(90.0, 10**6)
    asked = Asked(monkeypatch, OLD, YOUNG)
    asked.one = [(1, 0)]
    assert asked.find() == [(1, 0)]
    assert len(asked.alone) == 1


def test_it_is_looked_when_something_is_new_and_every_few_frames(monkeypatch):
    asked = Asked(monkeypatch, OLD, YOUNG)
    opportunities = []
    for frames, created in ((50, 2), (51, 2), (54, 2), (55, 2), (56, 3), (57, 3), (61, 3)):
        asked.ledger.frames, asked.ledger.created = frames, created
        before = len(asked.together)
        asked.find()
        opportunities.append(len(asked.together) > before)
    assert opportunities == [True, False, False, True, True, False, True]


def test_without_anything_young_there_is_nothing_to_compare(monkeypatch):
    asked = Asked(monkeypatch, OLD, (10.0, 99.0, 5))
    assert asked.find() == []
    assert asked.together == asked.alone == []


class Map:
    """Landmarks that are known with a standard deviation of 0.1 m each, independently."""

    def __init__(self, xy, together=()):
        self.xy = np.array(xy, float)
        records = {n: SimpleNamespace(covisible=set()) for n in range(len(xy))}
        self.ledger = SimpleNamespace(records=records, looks=Looks())
        for a, b in together:
            self.ledger.records[a].covisible.add(b)
            self.ledger.records[b].covisible.add(a)

    def places(self, numbers):
        return self.xy[numbers], np.full(len(numbers), 0.02)

    def position(self, numbers):
        return self.xy[numbers].ravel(), 0.01 * np.eye(2 * len(numbers))

    def single(self, window, others, area=10.0, scale=1.0):
        return single(self, self.ledger, window, others, area, scale)


def test_two_that_stand_where_one_does_are_one_and_the_older_one_stays():
    apart = Map([[0.0, 0.0], [9.0, 0.0], [0.2, 0.0], [30.0, 0.0]])
    assert apart.single([2, 3], [0, 1]) == [(2, 0)]
    assert apart.single([3], [0, 1]) == []
    assert apart.single([2], []) == []
    assert apart.single([0, 2], [0, 2]) == [(2, 0)], "nothing is compared with itself"


def test_two_that_were_seen_together_are_two():
    assert Map([[0.0, 0.0], [9.0, 0.0], [0.2, 0.0]], together=[(0, 2)]).single([2], [0, 1]) == []


def test_where_a_gate_is_so_large_that_others_fall_in_by_chance_nothing_is_one():
    """The gate of a difference with a variance of 0.02 m^2 in both directions: pi * 9.21 * 0.02 = 0.58 m^2."""
    assert Map([[0.0, 0.0], [0.2, 0.0]]).single([1], [0], area=0.60) == [(1, 0)]
    assert Map([[0.0, 0.0], [0.2, 0.0]]).single([1], [0], area=0.56) == []


def test_where_a_third_one_may_be_one_of_them_but_not_both_nothing_is_one():
    assert Map([[0.0, 0.0], [0.55, 0.0], [0.2, 0.0]]).single([2], [0, 1]) == []
    assert Map([[0.0, 0.0], [0.1, 0.1], [0.2, 0.0]]).single([2], [0, 1]) == [(2, 0)], "all three may be one"


def test_less_noise_than_stated_makes_the_gate_smaller():
    for off, area, scale, expected in ((0.23, 0.3, 0.25, []), (0.23, 0.3, 0.5, [(1, 0)]), (0.1, 0.28, 0.5, [])):
        assert Map([[0.0, 0.0], [off, 0.0]]).single([1], [0], area, scale) == expected
