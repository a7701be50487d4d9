"""The variety of worlds: what is drawn by index, and that a log is the drawn world with just that misstated."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.research.variety.worlds import (
    CHOOSE,
    JUDGE,
    WORLDS,
    Misstated,
    Readings,
    draw,
    indices,
    log_of,
)

EVERY = [draw(i) for i in range(WORLDS)]
HONEST = Misstated()
SMALL = [next(d for d in EVERY if d.name.startswith(world)) for world in ("arena", "park", "corridor")]


def test_the_halves_share_no_world_and_have_the_same_kinds():
    halves = [[draw(i) for i in indices(half, WORLDS)] for half in (CHOOSE, JUDGE)]
    kinds = [Counter(d.name.partition(":")[0] for d in half) for half in halves]
    assert {d.half for d in halves[0]} == {CHOOSE}
    assert {d.half for d in halves[1]} == {JUDGE}
    assert kinds[0] == kinds[1] == {"arena": 34, "park": 33, "corridor": 33}
    assert len({d.name for d in EVERY}) == WORLDS


@pytest.mark.parametrize("drawn", SMALL, ids=lambda d: d.name.partition(":")[0])
def test_what_is_misstated_changes_what_is_stated_alone(drawn):
    honest = log_of(replace(drawn, misstated=HONEST))
    wrong = log_of(replace(drawn, misstated=Misstated(2.0, 3.0, 3.0, 0.5, 0.5)))
    a, b = honest.recorded, wrong.recorded
    np.testing.assert_array_equal(a.observations.z, b.observations.z)
    np.testing.assert_array_equal(a.increments.mean, b.increments.mean)
    np.testing.assert_allclose(9.0 * a.observations.R, b.observations.R, atol=1e-12)
    np.testing.assert_allclose(4.0 * a.increments.covariance[1:], b.increments.covariance[1:], atol=1e-8)
    np.testing.assert_array_equal(honest.truth.pose, wrong.truth.pose)
    assert b.sensor.max_range == 0.5 * a.sensor.max_range


@pytest.mark.parametrize("drawn", SMALL, ids=lambda d: d.name.partition(":")[0])
def test_readings_have_the_noise_that_an_honest_log_states(drawn):
    log = log_of(replace(drawn, misstated=HONEST, readings=Readings(0.02, 0.01)))
    o, who = log.recorded.observations, log.truth.landmark_of
    of = np.flatnonzero(who >= 0)
    nu = log.recorded.sensor.residual(
        o.z[of], log.recorded.sensor.predict(log.truth.pose[o.frame[of]], log.truth.landmarks.xy[who[of]])
    )
    square = np.einsum("ij,ijk,ik->i", nu, np.linalg.inv(o.R[of]), nu)
    assert np.mean(square) == pytest.approx(2.0, abs=5.0 * 2.0 / np.sqrt(len(of)) + 0.1)


def test_clutter_and_detection_are_those_drawn():
    (arena, _, _) = SMALL
    all_there, half = (
        log_of(replace(arena, readings=replace(arena.readings, detection=p, clutter=0.0))) for p in (1.0, 0.5)
    )
    ratio = len(half.truth.landmark_of) / len(all_there.truth.landmark_of)
    assert ratio == pytest.approx(0.5, abs=0.06)
    cluttered = log_of(replace(arena, readings=replace(arena.readings, detection=1.0, clutter=0.2)))
    assert np.mean(cluttered.truth.landmark_of < 0) == pytest.approx(0.2, abs=0.04)
