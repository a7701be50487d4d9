"""Which landmarks leave a map, and when, by frames and times alone."""

from __future__ import annotations

import numpy as np

from eval.replay.map_management import MapManagement
from eval.replay.settings import Setup


def left(setup, seen, *, frames, seconds=0.5):
    """(frame, retracted, forgotten, parked) wherever something leaves; `seen`: numbers by frame."""
    management, found = MapManagement(setup), []
    for k in range(frames):
        management.begin(k, seconds * k)
        management.see(np.array(seen.get(k, []), np.int64))
        leaving = management.leaving()
        if any(map(len, leaving)):
            found.append((k, *(numbers.tolist() for numbers in leaving)))
    return found, management


def test_what_was_seen_once_goes_in_the_third_frame_after_and_only_once():
    found, management = left(Setup(maintain=True), {0: [0, 1], 1: [0, 2], 4: [3], 6: [3]}, frames=9)
    assert found == [(3, [1], [], []), (4, [2], [], [])]
    assert management.retracted == {1, 2}
    assert management.removal_frames(4).tolist() == [-1, 3, 4, -1]


def test_what_was_not_seen_for_longer_than_a_span_is_forgotten():
    found, management = left(Setup(forget_after=1.0), {0: [0, 1], 2: [1, 2]}, frames=9)
    assert found == [(3, [], [0], []), (5, [], [1, 2], [])], "1 s and a frame later"
    assert management.retracted == set()
    assert management.removal_frames(3).tolist() == [3, 5, 5]


def test_what_was_not_seen_for_longer_than_a_span_is_parked_until_it_is_restored():
    setup = Setup(deactivate_after=1.0)
    found, management = left(setup, {0: [0, 1], 1: [1]}, frames=7)
    assert found == [(3, [], [], [0]), (4, [], [], [1])]
    assert management.removal_frames(2).tolist() == [-1, -1]
    management.begin(10, 5.0)
    management.restored(np.array([0]))
    for frame, time, parked in ((11, 5.5, []), (12, 6.0, []), (13, 6.5, [0])):
        management.begin(frame, time)
        assert management.leaving().parked.tolist() == parked


def test_what_is_gone_is_neither_forgotten_nor_parked_again():
    setup = Setup(maintain=True, forget_after=1.0, deactivate_after=0.6)
    found, management = left(setup, {0: [0, 1], 1: [1]}, frames=9)
    assert found == [(2, [], [], [0]), (3, [0], [], [1]), (4, [], [1], [])]
    management.see(np.array([2]))
    management.remove(np.array([2]))
    management.begin(20, 10.0)
    assert [numbers.tolist() for numbers in management.leaving()] == [[], [], []]
    assert management.removal_frames(4).tolist() == [3, 4, 8, -1]
