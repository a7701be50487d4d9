"""Tentative landmarks wait until several observations agree; gates learn from what is inside and outside."""

from __future__ import annotations

import math

import numpy as np
import pytest

from association.expectation import Expectation
from data import se2
from data.result import DISCARD, NEW
from data.sensors import RelativePoint
from eval.replay.hindsight.gates import LearnedGates, Scales, as_stated, counted
from eval.replay.hindsight.ledger import Ledger, Record
from eval.replay.hindsight.noise import NoiseScale

SENSOR = RelativePoint(max_range=20.0)
LANDMARKS = np.array([[5.0, 0.0], [5.0, 8.0]])
BESIDE = np.array([5.5, 0.0])
"""By the stated noise it may be of the first landmark."""
FINE = Scales(NoiseScale(0.01, 100.0), NoiseScale(0.01, 100.0))


class Frames:
    """Of a robot that knows two landmarks, 3 and 7."""

    def __init__(self, scales=None):
        ledger = Ledger(SENSOR)
        ledger._read = SENSOR
        ledger.records = {n: Record([], (0.0, 0.0), 0.0, 0.0) for n in (3, 7)}
        self.gates = LearnedGates(ledger)
        if scales is not None:
            self.gates.scales = scales

    def put_off(self, points, decisions, pose=(0.0, 0.0, 0.0), R=None):
        """A frame that reads these points (in the world) and decided so by the noise that there is."""
        back = se2.inverse(np.array(pose))
        z, z_hat = (se2.transform_points(back, np.array(p, float).reshape(-1, 2)) for p in (points, LANDMARKS))
        noise = np.tile(0.01 * np.eye(2) if R is None else R, (len(z), 1, 1))
        e = Expectation.from_arrays(z, z_hat, 0.04 * np.eye(4), noise, number=np.array([3, 7]))
        return self.gates.put_off(e, np.array(decisions), np.array(pose), 0.99999).tolist()


def test_what_the_stated_noise_explains_waits_until_three_agree():
    frames = Frames()
    assert [frames.put_off([LANDMARKS[0], BESIDE], [3, NEW])[1] for _ in range(3)] == [DISCARD, DISCARD, NEW]


def test_what_no_noise_explains_is_new_at_once():
    assert Frames().put_off([LANDMARKS[0], [9.0, 0.0]], [3, NEW]) == [3, NEW]
    assert Frames().put_off([[9.0, 0.0]], [NEW]) == [NEW]


def test_sightings_agree_where_they_are_in_the_world():
    frames, poses = Frames(), [(0.0, 0.0, 0.0), (1.0, -2.0, 1.5), (2.0, 1.0, -0.7)]
    assert [frames.put_off([LANDMARKS[0], BESIDE], [3, NEW], pose)[1] for pose in poses] == [DISCARD, DISCARD, NEW]


def test_without_a_pairing_in_between_it_waits_on():
    frames = Frames()
    assert [frames.put_off([BESIDE], [NEW]) for _ in range(6)] == [[DISCARD]] * 6
    assert frames.put_off([LANDMARKS[0], BESIDE], [3, NEW]) == [3, NEW]


@pytest.mark.parametrize(("scales", "third"), [(as_stated(), NEW), (FINE, DISCARD)])
def test_a_second_reading_beside_a_paired_landmark_waits_too_where_noise_is_as_stated(scales, third):
    frames = Frames(scales)
    told = [frames.put_off([LANDMARKS[0], BESIDE], [3, DISCARD])[1] for _ in range(3)]
    assert told == [DISCARD, DISCARD, third]


def test_what_the_noise_that_there_is_leaves_open_does_not_wait():
    frames = Frames()
    assert [frames.put_off([LANDMARKS[1], BESIDE], [7, DISCARD])[1] for _ in range(5)] == [DISCARD] * 5


def test_each_landmark_is_inside_and_outside_its_gate_once_from_one_place():
    frames = Frames(FINE)
    frames.put_off([*LANDMARKS, BESIDE], [3, 7, NEW])
    assert frames.gates.scales == counted(FINE, 2, 1)
    gated = {n: sorted(r.gated) for n, r in frames.gates.ledger.records.items()}
    assert gated == {3: [False, True], 7: [True]}, "the nearest landmark left it out"
    frames.put_off([*LANDMARKS, BESIDE], [3, 7, NEW])
    assert frames.gates.scales.observations == 3.0


def test_a_landmark_that_is_new_in_the_end_takes_back_what_was_counted_against_its_neighbour():
    frames = Frames(FINE)
    for _ in range(3):
        frames.put_off([LANDMARKS[0], BESIDE], [3, NEW])
    assert frames.gates.scales == counted(counted(counted(FINE, 1, 1), 0, 0), 0, -1)


def test_a_sighting_waits_with_the_noise_of_its_reading_turned_to_the_world():
    seen = []

    class Spy:
        def see(self, observation, pairings, reach):
            seen.append((observation, pairings, reach))
            return False

        def suspect(self, observation):
            assert observation is seen[-1][0]

    frames, R = Frames(FINE), np.diag([0.09, 0.01])
    frames.gates._tentative, frames.gates.ledger.travelled = Spy(), 4.0
    frames.put_off([LANDMARKS[0], BESIDE], [3, NEW], (1.0, -2.0, math.pi / 2), R)
    ((observation, pairings, reach),) = seen
    assert observation.xy == pytest.approx(BESIDE)
    assert observation.covariance == pytest.approx(np.diag([0.01, 0.09]))
    assert (observation.travelled, pairings, reach) == (4.0, 1, 20.0)


def test_a_new_log_begins_with_what_was_stated_and_learns_from_its_pairings():
    frames = Frames()
    assert frames.gates.scales == as_stated()
    e = Expectation.from_arrays(LANDMARKS, LANDMARKS, 0.04 * np.eye(4), np.tile(0.01 * np.eye(2), (2, 1, 1)))
    for _ in range(5):
        frames.gates.learn(e, np.array([0, 1]))
    assert frames.gates.scales.motion.scale < 1.0
