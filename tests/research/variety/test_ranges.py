"""What is drawn for a world lies in the range that is demanded of it, evenly (by factor or by difference)."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from data.worlds.registry import parse
from tests.research.variety.worlds import LARGE, draw

WORLDS = range(600)


@cache
def worlds(kind: str = "", *, large: bool | None = None):
    """Worlds of a kind with what their names say; `large`: those of many landmarks or long ways, or the others."""
    found = []
    for d in map(draw, WORLDS):
        name = d.name.partition(":")[0]
        if name.startswith(kind) and large in (None, d.index // 2 % LARGE == LARGE - 1):
            found.append((d, parse(d.name).parameters))
    return found


def even(values, low: float, high: float, *, by_factor: bool):
    """Shares of the way from low to high, of which all lie between 0 and 1 and the middle is a half."""
    v = np.asarray(values, float)
    share = np.log(v / low) / math.log(high / low) if by_factor else (v - low) / (high - low)
    assert len(v) > 30
    # whole numbers and four digits
    assert share.min() >= -0.01
    assert share.max() <= 1.01
    error = 1.0 / math.sqrt(12.0 * len(v))
    assert np.mean(share) == pytest.approx(0.5, abs=3.5 * error)
    assert np.quantile(share, [0.05, 0.95]) == pytest.approx([0.05, 0.95], abs=0.08)


READ = {"sigma_range": (0.02, 0.2), "sigma_bearing": (0.005, 0.04)}


@pytest.mark.parametrize(("what", "low", "high"), [(k, *v) for k, v in READ.items()])
def test_sensors_have_any_noise_between_a_good_and_a_bad_one_s(what, low, high):
    even([getattr(d.readings, what) for d, _ in worlds()], low, high, by_factor=True)


@pytest.mark.parametrize(("what", "ideal", "low", "high"), [("detection", 1.0, 0.5, 1.0), ("clutter", 0.0, 0.0, 0.2)])
def test_three_worlds_in_ten_have_ideal_readings_and_the_others_lose_or_add_some(what, ideal, low, high):
    values = np.array([getattr(d.readings, what) for d, p in worlds() if not getattr(p, "people", False)])
    assert np.mean(values == ideal) == pytest.approx(0.3, abs=0.07)
    even(values[values != ideal], low, high, by_factor=False)


def test_landmarks_are_left_out_of_corridors_alone_and_half_of_all_worlds_have_neighbours():
    crowding = [d.crowding for d, _ in worlds()]
    paired = np.array([c.paired for c in crowding])
    assert np.mean(paired > 0.0) == pytest.approx(0.5, abs=0.07)
    even(paired[paired > 0.0], 0.05, 0.5, by_factor=False)
    even([c.spacing for c in crowding], 0.2, 20.0, by_factor=True)
    even([d.crowding.kept for d, _ in worlds("corridor")], 0.1, 1.0, by_factor=True)
    assert all(d.crowding.kept == 1.0 for k in ("arena", "park") for d, _ in worlds(k))
    assert all(c.most == 1000 for c in crowding)


@pytest.mark.parametrize(
    ("what", "most", "share"),
    [
        ("odometry", 4, 3 / 4), ("range", 4, 3 / 4), ("bearing", 4, 3 / 4),
        ("view_range", 1.4, 1 / 3), ("view_angle", 1.4, 1 / 3),
    ],
)  # fmt: skip
def test_a_statement_is_wrong_by_some_factor_up_or_down_in_a_share_of_the_worlds(what, most, share):
    values = np.array([getattr(d.misstated, what) for d, _ in worlds()])
    assert np.mean(values != 1.0) == pytest.approx(share, abs=0.07)
    even(values[values != 1.0], 1.0 / most, most, by_factor=True)


@pytest.mark.parametrize(("what", "most"), [("scale", 0.05), ("curvature", 0.02), ("left", 0.05), ("right", 0.05)])
def test_two_worlds_in_three_have_odometry_that_errs_to_either_side(what, most):
    errs = np.array([getattr(p, what) for _, p in worlds()])
    assert np.mean(errs != 0.0) == pytest.approx(2 / 3, abs=0.07)
    even(errs[errs != 0.0], -most, most, by_factor=False)


def test_half_of_those_whose_odometry_errs_drift_as_well():
    erring = [p for _, p in worlds() if p.scale != 0.0]
    drift = np.array([p.drift for p in erring])
    assert np.mean(drift > 0.0) == pytest.approx(0.5, abs=0.07)
    even(drift[drift > 0.0], 0.0, 0.01, by_factor=False)
    assert all(p.drift == 0.0 for _, p in worlds() if p.scale == 0.0)


@pytest.mark.parametrize(
    ("kind", "what", "low", "high", "by_factor"),
    [
        ("arena", "landmarks", 5, 400, True), ("arena", "frames", 150, 600, True),
        ("arena", "sigma_v", 0.02, 0.1, True), ("arena", "sigma_omega", 0.005, 0.04, True),
        ("park", "frames", 200, 600, True), ("park", "block", 20, 40, False), ("park", "spacing", 2.0, 8.0, True),
        ("park", "max_range", 8.0, 18.0, False), ("park", "sigma_v", 0.02, 0.1, True),
        ("park", "sigma_omega", 0.005, 0.02, True),
        ("corridor", "frames", 44, 220, True), ("corridor", "range", 3.0, 7.0, False),
        ("corridor", "sx_move", 0.005, 0.02, True), ("corridor", "sy_move", 0.005, 0.02, True),
        ("corridor", "sx_turn", 0.015, 0.06, True), ("corridor", "sy_turn", 0.015, 0.06, True),
        ("corridor", "stheta_move", *np.radians([1, 3]), True), ("corridor", "stheta_turn", *np.radians([1, 3]), True),
    ],
)  # fmt: skip
def test_worlds_that_are_not_large_are_of_any_size_and_noise(kind, what, low, high, by_factor):
    even([getattr(p, what) for _, p in worlds(kind, large=False)], low, high, by_factor=by_factor)


@pytest.mark.parametrize(
    ("kind", "size"),
    [("arena", {"landmarks": 1000, "frames": 600}), ("park", {"frames": 2000}), ("corridor", {"frames": 440})],
)  # fmt: skip
def test_two_worlds_in_fifty_are_large_one_of_each_half(kind, size):
    big = worlds(kind, large=True)
    assert {tuple(getattr(p, k) for k in size) for _, p in big} == {tuple(size.values())}
    assert (
        len([d for d, _ in big if d.index % 2]) == len([d for d, _ in big if not d.index % 2]) == len(WORLDS) / 50 / 3
    )
    assert not any(tuple(getattr(p, k) for k in size) == tuple(size.values()) for _, p in worlds(kind, large=False))


@pytest.mark.parametrize(("kind", "views"), [("arena", np.radians([90, 180, 270, 360])), ("park", [120, 180, 360])])
def test_views_are_open_by_some_angles_each_as_often_as_the_others(kind, views):
    opened = np.array([p.field_of_view for _, p in worlds(kind)])
    shares = [np.mean(np.isclose(opened, v, rtol=1e-3)) for v in views]
    assert sum(shares) == pytest.approx(1.0)
    assert shares == pytest.approx([1.0 / len(views)] * len(views), abs=0.1)


def test_landmarks_of_an_arena_stand_apart_and_about_three_to_twelve_are_in_view():
    for _, p in worlds("arena"):
        assert p.side >= 6.0
        assert 3.0 <= p.radius <= 15.0
        assert 2.0 <= p.max_range <= 20.0
        if 9.0 < p.side < 45.0:
            assert p.radius == pytest.approx(p.side / 3.0, rel=1e-3)
        density = p.landmarks / p.side**2
        if p.side > 6.0:
            assert 1.001 / math.sqrt(density) >= 0.6
            assert 0.999 / math.sqrt(density) <= (1.2 if p.landmarks == 1000 else 4.0)
    seen = [
        p.landmarks / p.side**2 * 0.5 * p.field_of_view * p.max_range**2
        for _, p in worlds("arena") if 2.0 < p.max_range < 20.0
    ]  # fmt: skip
    assert min(seen) * 1.005 >= 3.0
    assert max(seen) <= 12.0 * 1.005
    assert min(seen) < 3.3
    assert max(seen) > 11.0
    apart = [p.side / math.sqrt(p.landmarks) for _, p in worlds("arena", large=False) if p.side > 6.0]
    assert min(apart) < 0.75
    assert max(apart) > 3.6


def test_corridors_have_one_noise_in_both_ways_and_turns_are_three_times_as_uncertain():
    for _, p in worlds("corridor"):
        assert p.sx_move == p.sy_move
        assert p.sx_turn == p.sy_turn == pytest.approx(3.0 * p.sx_move, rel=1e-3)
        assert p.stheta_move == p.stheta_turn
