"""The engine's handles on the factors of observations: by landmark or frame, forgotten with what left the graph."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L

from data.inputs import LandmarkMap
from data.sensors import RelativePoint
from graph.factors import ObservationFactors
from graph.incremental import Observed

KNOWN = LandmarkMap(np.array([0, 1, 2]), np.zeros((3, 2)))


def held(known, observations):
    """(frame, number) of observations of two factors each, with handles 0, 1, ... in their order."""
    observed = Observed(RelativePoint(), known)
    own = known is not None
    seen = [
        ObservationFactors(f, n, L(100 + i) if own else L(n), [object(), object()], None, np.ones(2) if own else None)
        for i, (f, n) in enumerate(observations)
    ]
    values = gtsam.Values()
    assert len(observed.add(seen, values)) == 2 * len(observations)
    assert values.size() == (len(observations) if own else 0)
    observed.hold(seen, list(range(2 * len(observations))))
    return observed


SEEN = [(0, 0), (0, 1), (3, 0), (5, 0), (5, 2)]


def test_a_landmarks_factors_are_taken_back_together():
    observed = held(None, SEEN)
    assert observed.numbers.tolist() == [0, 1, 2]
    assert observed.withdraw([2, 0]) == [8, 9, 0, 1, 4, 5, 6, 7]
    assert observed.numbers.tolist() == [1]
    assert [(s.frame, s.number) for s in observed.observations] == [(0, 1)]
    assert observed.withdraw([0]) == []
    assert observed.missing(np.array([0, 1])) == [0]


def test_a_frames_factors_are_taken_back_where_landmarks_are_known():
    observed = held(KNOWN, SEEN)
    assert observed.withdraw([5]) == [6, 7, 8, 9]
    assert [s.frame for s in observed.observations] == [0, 0, 3]
    assert observed.missing(np.array([0, 7])) == [7]
    assert observed.numbers.tolist() == []


def test_what_left_the_graph_is_not_taken_back_any_more():
    observed = held(None, SEEN)
    observed.forget(4, lambda handle: handle not in (0, 1, 2, 3, 5))
    assert [(s.frame, s.number) for s in observed.observations] == [(5, 0), (5, 2)]
    assert observed.numbers.tolist() == [0, 1, 2], "the landmark is there still"
    assert observed.withdraw([0, 1, 2]) == [4, 6, 7, 8, 9]


def test_frames_before_the_window_leave_nothing_behind_where_landmarks_are_known():
    observed = held(KNOWN, SEEN)
    observed.forget(5, lambda handle: True)
    assert observed.withdraw([0, 3, 5]) == [6, 7, 8, 9]


@pytest.mark.parametrize(
    ("frames", "numbers", "expected"), [(range(4), None, 3), (range(3, 6), [0], 2), (range(6, 9), None, 0)]
)
def test_copies_of_known_landmarks_are_found_by_frame_and_landmark(frames, numbers, expected):
    assert len(held(KNOWN, SEEN).own_variables(frames, numbers)) == expected
    assert held(None, SEEN).own_variables(frames, numbers) == []


def test_what_joins_late_is_put_in_the_order_of_frames():
    observed = held(None, SEEN)
    observed.add([ObservationFactors(2, 1, L(1), [object()])], gtsam.Values(), late=True)
    assert [s.frame for s in observed.observations] == [0, 0, 2, 3, 5, 5]
