"""Worlds where landmarks hide: what is drawn, and that nothing is read of what is hidden, turned away or gone."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from data.se2 import wrap_angle
from tests.research.variety.goals import hiding_table, worlds_of
from tests.research.variety.hiding import FRONT, GROVE, REACH, WORLDS, Hiding, draw, indices, log_of
from tests.research.variety.measure import Row

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


def test_an_index_always_draws_the_same_world_and_bytes():
    assert [draw(i) for i in range(12)] == [draw(i) for i in range(12)]
    assert log_of(ARENA).recorded.observations.z.tobytes() == log_of(ARENA).recorded.observations.z.tobytes()


def test_halves_share_no_world_and_have_the_same_kinds():
    halves = [indices(half, 100) for half in ("choose", "judge", "later")]
    assert [len(h) for h in halves] == [40, 40, 80]
    assert len(set().union(*halves)) == 160
    kinds = [Counter(draw(i).kind for i in half) for half in halves]
    assert all(abs(k[kind] / sum(k.values()) - 1 / 3) < 0.03 for k in kinds for kind in ("arena", "park", "corridor"))


def test_every_way_of_hiding_is_drawn_in_a_share_of_the_worlds():
    every = [draw(i).hiding for i in range(2 * WORLDS)]
    shares = {
        "diameter": np.mean([h.diameter > 0.05 for h in every]), "uneven": np.mean([h.uneven > 0 for h in every]),
        "fronted": np.mean([h.fronted > 0 for h in every]), "removed": np.mean([h.removed > 0 for h in every]),
        "standing": np.mean([h.standing > 0 for h in every]), "view": np.mean([h.optimistic > 1 for h in every]),
    }  # fmt: skip
    wanted = {"diameter": 0.7, "uneven": 0.7, "fronted": 1 / 3, "removed": 0.5, "standing": 0.5, "view": 0.5}
    assert shares == pytest.approx(wanted, abs=0.13)


def test_wide_landmarks_hide_others():
    assert len(read(diameter=1.5).truth.landmark_of) < 0.9 * len(read().truth.landmark_of)


def test_far_landmarks_are_read_less_often():
    r, _, _ = distances(read(half=0.3))
    reach = REACH * 0.3 * read().recorded.sensor.max_range / REACH
    assert np.mean(r < reach) > 0.6 > 0.4 > np.mean(distances(read())[0] < reach)


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


def test_people_are_no_landmarks_and_stand_for_a_while():
    log = read(standing=0.3)
    frame = log.recorded.observations.frame[log.truth.landmark_of < 0]
    assert len(frame) > 0
    assert len(np.unique(frame)) < 0.9 * len(log.recorded)
    np.testing.assert_array_equal(log.truth.landmarks.id, read().truth.landmarks.id)


def test_an_optimistic_view_is_stated_and_nothing_is_read_beyond():
    plain, wide = read(), read(optimistic=2.0)
    assert wide.recorded.sensor.max_range == pytest.approx(2.0 * plain.recorded.sensor.max_range)
    np.testing.assert_array_equal(plain.recorded.observations.z, wide.recorded.observations.z)


def test_the_grove_has_299_trees_and_is_as_stated_but_for_the_view():
    grove = draw(GROVE)
    assert grove.kind == "grove"
    assert grove.hiding.optimistic > 1.0
    assert grove.drawn.misstated.odometry == grove.drawn.misstated.range == 1.0


def test_a_map_is_right_between_often_and_ever_seen():
    def row(method, landmarks, fp=0):
        return Row(1, method, "arena", 50, 1000, 100, 80, 1.0, fp, 0, landmarks, 1.0, "ok", smoothed_m=1.0)

    for landmarks, right in ((73, True), (71, False), (109, True), (112, False)):
        (world,) = worlds_of([row("jcbb", 100), row("jcbb-hindsight", landmarks)])
        assert world.right_count == right
    (world,) = worlds_of([row("jcbb", 100, 500), row("jcbb-hindsight", 100, 10)])
    assert world.right_ratio == pytest.approx(990 / 500)
    assert world.smoothed_ratio == 1.0
    assert len(hiding_table([row("jcbb", 100, 5), row("jcbb-hindsight", 100)])) == 4
    assert math.isinf(replace_smoothed(world))


def replace_smoothed(world):
    return world._replace(hindsight=world.hindsight._replace(smoothed_m=math.inf)).smoothed_ratio
