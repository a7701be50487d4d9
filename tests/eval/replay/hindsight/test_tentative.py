"""Observations that are put off: several must agree, and the pose must have been right in between."""

import numpy as np

from eval.replay.hindsight.gates import Tentative, TentativeObservation

REACH = 10.0


def at(x, travelled=0.0):
    return TentativeObservation(np.array([x, 0.0]), 0.01 * np.eye(2), travelled)


def test_the_third_that_agrees_is_new_once_the_pose_was_confirmed():
    seen = Tentative()
    assert [seen.see(at(1.0), n, REACH) for n in (4, 5, 5)] == [False, False, True]


def test_without_a_pairing_in_between_nothing_is_new():
    seen = Tentative()
    assert not any(seen.see(at(1.0), 4, REACH) for _ in range(20))
    assert seen.see(at(1.0), 5, REACH)


def test_sightings_elsewhere_do_not_count():
    seen = Tentative()
    assert not any(seen.see(at(x), n, REACH) for n, x in enumerate((1.0, 3.0, 5.0, 1.0, 3.0, 5.0)))


def test_a_place_is_forgotten_after_a_distance_travelled():
    seen = Tentative()
    assert not any(seen.see(at(1.0, travelled), int(travelled), REACH) for travelled in (0.0, 1.0, 12.0, 13.0))
    assert seen.see(at(1.0, 14.0), 14, REACH)


def test_a_landmark_takes_its_own_doubts_and_leaves_the_others():
    seen = Tentative()
    for x in (1.0, 1.1, 4.0):
        seen.suspect(at(x))
    assert (seen.settle(at(1.0)), seen.settle(at(1.0)), seen.settle(at(4.0))) == (2, 0, 1)
