"""Worlds where landmarks hide: what is drawn, and that nothing is read of what is hidden, turned away or gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.se2 import wrap_angle
from tests.research.variety.hiding import FRONT, WORLDS, Hiding, draw, log_of

OPEN = Hiding(0.02, 100.0, 0.0, 0.0, 0.0, 0.0, 1.0)
ARENA = next(d for d in map(draw, range(WORLDS)) if d.kind == "arena" and len(log_of(d).truth.landmark_of) > 300)


def read(**hiding):
    """The log of one arena where landmarks hide in one way only, or in none."""
    clean = replace(ARENA.drawn, readings=replace(ARENA.drawn.readings, clutter=0.0))
    return log_of(replace(ARENA, drawn=clean, hiding=replace(OPEN, **hiding)))


def distances(log):
    """Range, and side of the landmark from which it is read, of every reading of a landmark."""
    o, who = log.recorded.observations, log.truth.landmark_of
    of = np.flatnonzero(who >= 0)
    d = log.truth.pose[o.frame[of], :2] - log.truth.landmarks.xy[who[of]]
    return np.hypot(*d.T), np.arctan2(d[:, 1], d[:, 0]), who[of]


def test_wide_landmarks_hide_others():
    assert len(read(diameter=1.5).truth.landmark_of) < 0.9 * len(read().truth.landmark_of)


def test_a_landmark_with_a_front_is_read_from_there_only():
    """No landmark is read from more than the width of its front, and many are otherwise."""

    def most(log):
        """Widest angle between two sides from which each landmark is read."""
        _, side, who = distances(log)
        return np.array([np.abs(wrap_angle(side[who == i][:, None] - side[who == i])).max() for i in np.unique(who)])

    assert most(read(fronted=1.0)).max() < 2.0 * FRONT + 1e-6
    assert np.mean(most(read()) > 2.0 * FRONT) > 0.1


def test_removed_landmarks_are_read_no_more():
    log = read(removed=0.99)
    n = len(log.recorded)
    last = [log.recorded.observations.frame[log.truth.landmark_of == i].max() for i in np.unique(log.truth.landmark_of)]
    assert np.mean(np.array(last) < 0.65 * n + 1) > 0.9


def test_an_optimistic_view_is_stated_and_nothing_is_read_beyond():
    plain, wide = read(), read(optimistic=2.0)
    assert wide.recorded.sensor.max_range == pytest.approx(2.0 * plain.recorded.sensor.max_range)
    np.testing.assert_array_equal(plain.recorded.observations.z, wide.recorded.observations.z)
