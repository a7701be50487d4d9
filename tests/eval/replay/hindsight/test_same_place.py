"""Two landmarks of a smoothed map that are one: at one place, and hardly ever observed together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.inputs import LandmarkMap, Observations
from data.sensors import RelativePoint
from eval.replay.hindsight import constants
from eval.replay.hindsight.whole_log import log_odds, same_landmarks
from tests.research.variety.hiding import world_of
from tests.research.variety.measure import measure

SENSOR = RelativePoint(max_range=10.0, min_angle=-math.pi, max_angle=math.pi)
SIGMA = 0.1
PATH = np.stack([np.linspace(0.0, 30.0, 31), np.zeros(31), np.zeros(31)], axis=1)
XY = np.array([[10.0, 2.0], [10.05, 2.0], [20.0, 2.0]])


def observed(*frames):
    """The first two landmarks in these frames, the third one in every frame in which it is in range."""
    third = np.flatnonzero(np.abs(PATH[:, 0] - XY[2, 0]) < 9.0)
    frame = np.concatenate([*frames, third])
    number = np.repeat(np.arange(3), [*map(len, frames), len(third)])
    order = np.argsort(frame, kind="stable")
    frame, number = frame[order], number[order]
    noise = SIGMA * np.random.default_rng(0).standard_normal((len(frame), 2))
    z = XY[number] - PATH[frame, :2] + noise
    seen = Observations(frame, z, np.tile(SIGMA**2 * np.eye(2), (len(frame), 1, 1)))
    return seen, number


def found(*frames, xy=XY):
    seen, number = observed(*(np.array(f) for f in frames))
    return same_landmarks(SENSOR, PATH, LandmarkMap(np.arange(3), xy), seen, number)


def test_what_is_observed_as_one_or_the_other_is_one():
    assert found(range(2, 18, 2), range(3, 18, 2)) == [(1, 0)]


def test_what_is_observed_together_is_two():
    assert found(range(2, 18), range(2, 18)) == []
    assert found(range(2, 18), range(2, 18, 4)) == []


def test_once_together_by_chance_among_many_frames_is_one():
    assert found(range(2, 18, 2), [2, *range(3, 18, 2)]) == [(1, 0)]


def test_what_is_farther_apart_than_the_noise_is_two():
    apart = XY + np.array([[0.0, 0.0], [6.0 * SIGMA, 0.0], [0.0, 0.0]])
    assert found(range(2, 18, 2), range(3, 18, 2), xy=apart) == []


def test_the_odds_are_those_of_frames_at_different_places():
    r, chance = constants.SAME_DETECTED, constants.SAME_CHANCE
    both = r**2 / (1.0 - (1.0 - r) ** 2)
    one, other = np.array([1, 2, 3, 4]), np.array([4, 5])
    expected = 4 * -math.log(1.0 - both) + math.log(chance / both)
    assert log_odds(one, other, PATH, 0.5) == pytest.approx(expected)
    assert log_odds(one, other, np.zeros((6, 3)), 0.5) == pytest.approx(-math.log(1.0 - both) + math.log(chance / both))


@pytest.mark.slow
def test_landmarks_that_were_initialized_twice_are_one_in_the_end(monkeypatch):
    """World 28 of those where landmarks hide."""
    log, kind = world_of(28)
    merged = measure(log, 28, kind, "jcbb-hindsight")
    monkeypatch.setattr(constants, "SAME_ROUNDS", 0)
    apart = measure(log, 28, kind, "jcbb-hindsight")
    assert apart.landmarks > merged.landmarks
    assert apart.fp > merged.fp + 5
