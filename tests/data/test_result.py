"""The map of a run: when each landmark was seen first, and how often."""

import numpy as np

from data.result import DISCARD, NEW, MapState, map_estimate


def test_a_landmark_is_first_seen_where_it_was_initialized_and_as_often_as_was_decided():
    decisions = np.array([NEW, NEW, DISCARD, 0, NEW, 0, 1, 2, NEW])
    created = np.array([0, 1, -1, -1, 2, -1, -1, -1, 3])
    frame = np.array([0, 2, 2, 3, 5, 5, 6, 8, 9])
    state = MapState(np.array([0, 2, 3, 5]), np.zeros((4, 2)), np.zeros((4, 2, 2)))
    found = map_estimate(state, frame, decisions, created)
    assert found.number.tolist() == [0, 2, 3, 5]
    assert found.first_frame.tolist() == [0, 5, 9, -1], "-1: never, one that was known"
    assert found.times_seen.tolist() == [3, 2, 1, 0]
