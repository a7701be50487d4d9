"""TP, TN, FP and FN, counted by hand."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data.inputs import LandmarkMap
from eval.referee.confusion import confuse, ground_truth, majority_agreement, share_within

NEW, DISCARD = -1, -2


def test_decisions_are_counted_by_hand():
    # frame 0 initializes 7 and 9; frame 1: right, taken for the neighbour, taken for new, clutter paired and left out
    frame = np.array([0, 0, 1, 1, 1, 1, 1])
    true_id = np.array([7, 9, 7, 9, 7, -1, -1])
    decisions = np.array([NEW, NEW, 0, 0, NEW, 1, DISCARD])
    created = np.array([0, 1, -1, -1, 2, -1, -1])
    c = confuse(frame, true_id, decisions, created, None)
    assert c.ground_truth.tolist() == [-1, -1, 0, 1, 0, -1, -1]
    assert (c.tp, c.tn, c.fp, c.fn) == (1, 3, 2, 1)
    assert (c.wrong, c.spurious, c.duplicate, c.missed) == (1, 1, 1, 0)
    assert (c.precision, c.recall) == (1 / 3, 1 / 2)
    frame, true_id = np.array([0, 1, 2]), np.array([5, 5, 5])
    c = confuse(frame, true_id, np.array([NEW, NEW, 1]), np.array([0, 1, -1]), None)
    assert c.outcome.tolist() == [1, 3, 2]
    assert c.wrong == 1
    gt = ground_truth(np.array([0, 0, 1]), np.array([5, 5, 5]), np.array([0, -1, -1]), None)
    assert gt.tolist() == [-1, -1, 0]
    known = LandmarkMap(np.array([5, 6]), np.zeros((2, 2)))
    c = confuse(np.zeros(4, int), np.array([5, 6, 7, -1]), np.array([5, DISCARD, 6, DISCARD]), np.full(4, -1), known)
    assert c.ground_truth.tolist() == [5, 6, -1, -1]
    assert (c.tp, c.tn, c.fp, c.fn) == (1, 1, 1, 1)
    assert c.missed == 1
    assert confuse(np.array([0]), np.array([-2]), np.array([NEW]), np.array([0]), None) is None
    known = LandmarkMap(np.array([3, 5]), np.zeros((2, 2)))
    frame, true_id = np.arange(5), np.array([3, 3, 3, 5, 3])
    decisions, final = np.array([3, DISCARD, DISCARD, DISCARD, 5]), np.array([3, 3, DISCARD, 3, 3])
    nothing = np.full(5, -1)
    online = confuse(frame, true_id, decisions, nothing, known, None, final)
    assert (online.tp, online.fp, online.fn) == (1, 1, 3)
    assert (online.missed, online.deferred) == (1, 2)
    settled = confuse(frame, true_id, final, nothing, known)
    assert (settled.missed, settled.deferred) == (1, 0)


def test_a_pairing_is_near_if_its_landmark_is_near_the_right_one():
    places = LandmarkMap(np.array([3, 5, 9]), np.array([[0.0, 0.0], [0.0, 0.25], [4.0, 0.0]]))
    own = np.array([3, 3, 3, 9, -1, 3, 9])
    taken = np.array([3, 5, 9, 7, 3, -1, -2])
    # right, neighbour, far, without a position, person paired, initialized on a person; the last one is not paired
    decisions = np.array([0, 1, 2, 3, 0, 4, NEW])
    assert share_within(decisions, own, taken, places) == pytest.approx(2 / 6)
    assert np.isnan(share_within(decisions[-1:], own[-1:], taken[-1:], places))
    assert share_within(decisions[:2], own[:2], taken[:2], LandmarkMap(np.empty(0, int), np.empty((0, 2)))) == 0.0


def test_the_majority_agrees_where_a_neighbour_initialized_a_landmark_and_clutter_with_nothing():
    decisions, true_id = np.array([NEW, 0, 0, 0]), np.array([9, 7, 7, 7])
    created = np.array([0, -1, -1, -1])
    assert confuse(np.arange(4), true_id, decisions, created, None).fp == 3
    assert majority_agreement(decisions, true_id) == 1.0
    assert majority_agreement(np.array([0, 0, 0, 1]), np.array([-1, -1, 7, 7])) == 0.5
    assert np.isnan(majority_agreement(np.array([NEW, DISCARD]), np.array([1, 1])))


@given(st.lists(st.tuples(st.integers(-2, 4), st.integers(-1, 4)), min_size=1))
def test_the_majority_is_counted_landmark_by_landmark(pairs):
    paired = [(d, t) for d, t in pairs if d >= 0]
    counts = {d: Counter(t for e, t in paired if e == d and t >= 0) for d, _ in paired}
    expected = sum(max(c.values(), default=0) for c in counts.values())
    found = majority_agreement(*np.array(pairs).T)
    assert np.isnan(found) if not paired else found == pytest.approx(expected / len(paired))
