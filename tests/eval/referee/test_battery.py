"""P values by rank: exact, and family-wise as small as the twins allow."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr

from eval.referee import battery
from eval.referee.battery import evened, family_p, gaussian_p, rank_p, shared_p, standardized


def test_a_rank_p_value_counts_the_twins_on_its_smaller_side_twice():
    twins = np.arange(1.0, 10.0)  # 1 ... 9
    assert rank_p(10.0, twins) == pytest.approx(2 * 1 / 10)
    assert rank_p(8.5, twins) == pytest.approx(2 * 2 / 10)
    assert rank_p(1.5, twins) == pytest.approx(2 * 2 / 10)
    assert rank_p(5.0, twins) == 1.0
    assert np.isnan(rank_p(1.0, np.empty(0)))
    assert np.isnan(rank_p(np.nan, twins))


def by_hand(own, others):
    """Westfall and Young's algorithm 2.8, step by step, on absolute standardized values."""
    order = sorted(range(len(own)), key=lambda i: -own[i])
    p, before = [0.0] * len(own), 0.0
    for rank, i in enumerate(order):
        left = order[rank:]
        exceed = sum(max(row[j] for j in left) >= own[i] for row in others)
        before = max(before, (1 + exceed) / (len(others) + 1))
        p[i] = before
    return p


def test_the_family_wise_p_value_is_that_of_the_step_down_procedure():
    rng = np.random.default_rng(3)
    for _ in range(20):
        real, twins = rng.normal(size=6) * 3, rng.normal(size=(19, 6))
        t, T = standardized(real, twins)
        assert family_p(real, twins) == pytest.approx(by_hand(*evened(t, T)))


@pytest.mark.slow
def test_the_family_rejects_one_in_twenty_where_real_and_twins_are_alike():
    rng = np.random.default_rng(1)
    mixing = rng.normal(size=(12, 12))
    rejected = 0
    for _ in range(1000):
        draws = rng.standard_t(4, size=(40, 12)) @ mixing
        rejected += np.nanmin(family_p(draws[0], draws[1:])) <= 0.05
    assert abs(rejected / 1000 - 0.05) < 0.02


def test_a_heavy_tail_does_not_hide_what_another_statistic_says():
    rng = np.random.default_rng(7)
    found = {"heavy": 0, "none": 0}
    for _ in range(100):
        draws = rng.normal(size=(100, 24))
        draws[0, 0] += 5.5
        found["none"] += family_p(draws[0], draws[1:])[0] <= 0.05
        draws[:, 20:] = rng.standard_t(2, size=(100, 4))
        found["heavy"] += family_p(draws[0], draws[1:])[0] <= 0.05
    assert found["none"] > 90
    assert found["heavy"] > 0.8 * found["none"]


def test_the_parts_of_a_family_share_its_level():
    rng = np.random.default_rng(8)
    draws, theory, none = rng.normal(size=(40, 24)), np.arange(24) < 12, np.eye(24)
    p = shared_p(draws[0], draws[1:], draws[0], theory, none)
    # of 39 twins the farthest one is 1 in 40: half of the level of 5 %, and the other half is left for theory
    assert p[~theory] == pytest.approx(np.minimum(2.0 * family_p(draws[0, 12:], draws[1:, 12:]), 1.0))
    assert p[theory] == pytest.approx(np.minimum(2.0 * gaussian_p(draws[0, :12], np.eye(12)), 1.0))
    few = rng.normal(size=(20, 24))
    assert shared_p(few[0], few[1:], few[0], theory, none) == pytest.approx(family_p(few[0], few[1:]))


def test_the_largest_of_gaussian_statistics_is_corrected_for_their_number():
    p = gaussian_p(np.array([0.1, 5.0, np.nan, 2.5]), np.eye(4))
    assert p[1] == pytest.approx(3 * 5.733e-7, rel=1e-3)
    assert p[3] == pytest.approx(1 - (1 - 0.012419) ** 2, rel=0.1)
    assert np.isnan(p[2])


@pytest.mark.parametrize("r", [0.0, 0.5, 0.9])
def test_the_correlation_of_gaussian_statistics_is_taken_into_account(r):
    n, farthest, u = 12, 2.6, np.linspace(-8.0, 8.0, 4001)
    a, b = ((side * farthest - math.sqrt(r) * u) / math.sqrt(1.0 - r) for side in (-1.0, 1.0))
    inside = np.sum((ndtr(b) - ndtr(a)) ** n * np.exp(-0.5 * u**2)) * (u[1] - u[0]) / math.sqrt(2.0 * math.pi)
    z = np.r_[farthest, np.zeros(n - 1)]
    assert gaussian_p(z, np.full((n, n), r) + (1.0 - r) * np.eye(n))[0] == pytest.approx(1.0 - inside, rel=0.06)


def test_constant_and_unknown_statistics_do_not_count():
    rng = np.random.default_rng(2)
    twins = np.column_stack([rng.normal(size=39), np.full(39, 0.25), rng.normal(size=39)])
    p = family_p(np.array([0.1, 0.25, np.nan]), twins)
    assert p[0] > 0.05
    assert p[1] == 1.0
    assert np.isnan(p[2])


def test_a_share_that_is_constant_in_twins_rejects_a_log_that_differs():
    twins = np.column_stack([np.ones(39), np.random.default_rng(4).normal(size=39)])
    assert family_p(np.array([0.3, 0.0]), twins)[0] == pytest.approx(1 / 40)


@pytest.mark.parametrize("n", [5, 19, 39, 99])
def test_one_more_draw_is_within_the_bounds_of_the_others_in_95_of_100(n):
    rng = np.random.default_rng(n)
    drawn = rng.standard_normal((4000, n + 1))
    bounds = np.array([battery.bounds(row[1:]) for row in drawn])
    inside = np.mean((bounds[:, 0] <= drawn[:, 0]) & (drawn[:, 0] <= bounds[:, 1]))
    assert inside == pytest.approx(0.95, abs=0.014)


def test_two_draws_bound_nothing():
    assert np.isnan(battery.bounds(np.array([1.0, 2.0, np.nan]))).all()
