"""The pace of a film: real time or a multiple of it, whatever the frames' distances in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Increments, Inputs, Observations, Prior
from data.sensors import RangeBearing
from eval.figures.film import FPS, pace_of


def inputs_at(time, *, index=False) -> Inputs:
    n = len(time)
    nothing = Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))
    still = Increments(np.zeros((n, 3)), np.zeros((n, 3, 3)))
    inputs = Inputs(Prior(np.zeros(3), np.zeros((3, 3))), np.asarray(time, float), still, nothing, RangeBearing())
    return replace(inputs, time_is_index=index)


def test_a_second_of_the_film_is_as_many_seconds_of_the_log_as_asked_for():
    time = np.array([0.0, 0.1, 3.0, 3.05, 10.0])
    for speed in (1.0, 2.5, 0.5):
        _, frames = pace_of(inputs_at(time), speed)
        assert len(frames) == pytest.approx(10.0 / speed * FPS, abs=1.01)
        for picture, frame in enumerate(frames.tolist()):
            now = picture * speed / FPS
            assert time[frame] <= now + 1e-6  # the newest frame there is at that instant
            assert frame == 4 or time[frame + 1] > now
        assert frames[-1] == 4


@pytest.mark.parametrize(("length", "speed"), [(30.0, 1), (60.0, 1), (61.0, 2), (130.0, 3), (1500.0, 25), (1e4, 167)])
def test_unasked_it_is_real_time_or_the_next_whole_speed_that_fits_a_minute(length, speed):
    text, frames = pace_of(inputs_at(np.linspace(0.0, length, 50)))
    assert len(frames) <= 60 * 20 + 1
    assert text == f"{speed} x real time"


def test_where_time_counts_frames_it_is_frames_a_second_and_says_so():
    assert pace_of(inputs_at(np.arange(44.0), index=True))[0] == "5 frames a second"
    text, frames = pace_of(inputs_at(np.arange(44.0), index=True), 10.0)
    assert frames.tolist() == [k // 2 for k in range(87)]
    assert text == "10 frames a second"
