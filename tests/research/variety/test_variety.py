"""The variety of worlds: what is drawn by index, and that a log is the drawn world with just that misstated."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from data.sensors import RangeBearing, RelativePoint
from tests.research.variety.worlds import (
    CHOOSE,
    JUDGE,
    WORLDS,
    Crowding,
    Misstated,
    Readings,
    crowded,
    draw,
    indices,
    log_of,
    sensor_sigma,
    stated_readings,
    stated_sensor,
)

EVERY = [draw(i) for i in range(WORLDS)]
HONEST = Misstated()
SMALL = [next(d for d in EVERY if d.name.startswith(world)) for world in ("arena", "park", "corridor")]


def test_an_index_always_draws_the_same_world():
    assert [draw(i) for i in range(20)] == EVERY[:20]


def test_an_exact_world_is_the_same_one_but_for_what_is_misstated_and_errs_in_system():
    for index in range(60):
        drawn, exact = draw(index), draw(index, exact=True)
        assert exact.misstated == HONEST
        assert (exact.readings, exact.crowding) == (drawn.readings, drawn.crowding)
        odometry = ("scale", "curvature", "left", "right", "drift")
        left = [part for part in drawn.name.split(":")[2].split("+") if part.split("=")[0] not in odometry]
        assert exact.name.split(":")[2] == "+".join(left)


def test_later_worlds_are_of_neither_half():
    later = indices("later", 1000)
    assert len(later) == 200
    assert not set(later) & set(indices(None, 1000))
    assert {draw(i).half for i in later[:6]} == {"later"}


def test_the_halves_share_no_world_and_have_the_same_kinds():
    halves = [[draw(i) for i in indices(half, WORLDS)] for half in (CHOOSE, JUDGE)]
    kinds = [Counter(d.name.partition(":")[0] for d in half) for half in halves]
    assert {d.half for d in halves[0]} == {CHOOSE}
    assert {d.half for d in halves[1]} == {JUDGE}
    assert kinds[0] == kinds[1] == {"arena": 34, "park": 33, "corridor": 33}
    assert len({d.name for d in EVERY}) == WORLDS


def test_the_ranges_are_those_demanded():
    for d in EVERY:
        m, r, c = d.misstated, d.readings, d.crowding
        assert all(0.25 <= f <= 4.0 for f in (m.odometry, m.range, m.bearing))
        assert 0.5 <= r.detection <= 1.0
        assert 0.0 <= r.clutter <= 0.2
        assert c.spacing >= 0.2
    for half in (EVERY[::2], EVERY[1::2]):
        assert min(d.misstated.odometry for d in half) < 0.5
        assert max(d.misstated.odometry for d in half) > 2.0
        assert min(d.crowding.spacing for d in half if d.crowding.paired) < 0.4
        assert 20 < sum("curvature" in d.name for d in half) < 90


def test_there_are_people_in_a_third_of_the_corridors():
    corridors = [d for d in EVERY if d.name.startswith("corridor")]
    among_people = [d for d in corridors if "people" in d.name]
    assert 0.2 < len(among_people) / len(corridors) < 0.47
    assert all(d.readings.clutter == 0.0 for d in among_people), "people are clutter enough"


@pytest.mark.parametrize("drawn", SMALL, ids=lambda d: d.name.partition(":")[0])
def test_a_log_is_made_again_byte_by_byte(drawn):
    one, other = log_of(drawn), log_of(drawn)
    assert one.recorded.observations.z.tobytes() == other.recorded.observations.z.tobytes()
    assert one.recorded.increments.covariance.tobytes() == other.recorded.increments.covariance.tobytes()
    assert one.name == f"variety-{drawn.index:03d}"


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


def test_neighbours_stand_at_the_spacing_and_landmarks_that_are_left_out_are_gone():
    xy = 10.0 * np.arange(80.0).reshape(40, 2)
    placed = crowded(xy, Crowding(kept=0.5, paired=0.5, spacing=0.2), 0.1, np.random.default_rng(0))
    assert len(placed) == 30
    apart = np.linalg.norm(placed[20:, None] - placed[None, :20], axis=2).min(axis=1)
    np.testing.assert_allclose(apart, 0.02)
    assert len(crowded(xy, Crowding(kept=0.01), 0.1, np.random.default_rng(0))) == 5
    assert len(crowded(xy, Crowding(paired=1.0, most=45), 0.1, np.random.default_rng(0))) == 45


def test_the_sigma_of_a_sensor_is_that_of_a_point_at_half_its_range():
    assert sensor_sigma(Readings(0.1, 0.0), RangeBearing(max_range=8.0)) == pytest.approx(0.1 / np.sqrt(2.0))
    assert sensor_sigma(Readings(0.1, 0.025), RangeBearing(max_range=8.0)) == pytest.approx(0.1)


def test_a_sensor_that_sees_all_around_is_never_stated_to_see_less():
    assert stated_sensor(RangeBearing(max_range=8.0), Misstated(view_angle=0.7)).min_angle == -np.pi
    half = stated_sensor(RangeBearing(max_range=8.0, min_angle=-1.0, max_angle=1.0), Misstated(view_angle=0.7))
    assert (half.min_angle, half.max_angle) == pytest.approx((-0.7, 0.7))


def test_a_point_sensor_states_the_ellipse_of_range_and_bearing():
    polar = np.array([[4.0, np.pi / 2]])
    z, R = stated_readings(RelativePoint(max_range=8.0), polar, Readings(0.1, 0.01), Misstated(range=2.0))
    np.testing.assert_allclose(z, [[0.0, 4.0]], atol=1e-12)
    np.testing.assert_allclose(R[0], np.diag([0.04**2, 0.2**2]), atol=1e-12)
