"""Intervals of one log, and p values by rank."""

import math
import re

import numpy as np
import pytest
from scipy import signal
from scipy.special import ndtr

from eval.referee import battery
from eval.referee.battery import evened, family_p, gaussian_p, rank_p, shared_p, standardized
from eval.referee.intervals import MIN_FRAMES, REPLICATES, block_length, independent_frames, intervals, resampled_means


def rng(seed=0):
    return np.random.default_rng(seed)


def correlated(coefficient, frames, series, seed):
    """Stationary AR(1) series (series, frames) of variance 1."""
    burn = 300 if coefficient <= 0.95 else 3000
    noise = rng(seed).standard_normal((series, burn + frames)) * math.sqrt(1.0 - coefficient**2)
    return signal.lfilter([1.0], [1.0, -coefficient], noise, axis=1)[:, burn:]


def squares(coefficient, frames, series, seed):
    """Squared distances (series, frames), mean 2, of two such coordinates."""
    x = correlated(coefficient, frames, 2 * series, seed)
    return x[:series] ** 2 + x[series:] ** 2


@pytest.mark.parametrize("block", [1.0, 4.0, 25.0])
def test_resampled_means_scatter_as_the_stationary_bootstrap_does(block):
    """Politis & Romano 1994, lemma 1: n var = R(0) + 2 sum (1 - i/n)(1 - p)^i R(i), R the log's circular covariance."""
    x = squares(0.8, 200, 1, 2)[0]
    n, centred = len(x), x - x.mean()
    i = np.arange(1, n)
    R = np.array([centred @ np.roll(centred, k) / n for k in range(n)])
    variance = (R[0] + 2.0 * np.sum((1.0 - i / n) * (1.0 - 1.0 / block) ** i * R[1:])) / n
    means = resampled_means(x[:, None], block, rng(3), 20_000)[:, 0]
    assert means.mean() == pytest.approx(x.mean(), abs=4.0 * math.sqrt(variance / 20_000))
    assert means.var() == pytest.approx(variance, rel=0.05)  # its standard error is 1 %


@pytest.mark.parametrize(("x", "stationary"), [
    (squares(-0.5, 50, 1, 13)[0], 1.8638037597058494), (squares(0.0, 101, 1, 13)[0], 2.02307657513805),
    (squares(0.3, 1000, 1, 13)[0], 5.5938061084971205), (squares(0.999, 5000, 1, 13)[0], 160.48225394997152),
    (np.sin(0.3 * np.arange(1000)), 65.13186691421105), (np.arange(1000) % 7.0, 95.0),
])  # fmt: skip
def test_the_block_length_is_that_of_arch(x, stationary):
    """`arch.bootstrap.optimal_block_length` of arch 8.0.0."""
    assert block_length(x) == pytest.approx(stationary, rel=1e-12)


def test_a_log_is_worth_as_many_frames_as_theory_says():
    """For AR(1) squares, whose correlation is the coefficient's square: n (1 - a)/(1 + a)."""
    worth = [independent_frames(x) for x in squares(0.8, 2000, 40, 3)]
    assert np.mean(worth) == pytest.approx(2000 * (1.0 - 0.64) / (1.0 + 0.64), rel=0.1)
    assert independent_frames(squares(0.0, 2001, 1, 4)[0]) > 1600.0


def test_frames_without_truth_or_nees_are_left_out_and_both_intervals_have_the_longer_block():
    x = squares(0.5, 400, 1, 6)[0]
    gaps = np.insert(x, [0, 50, 50, 399], np.nan)
    assert repr(intervals(gaps, gaps, rng())) == repr(intervals(x, x, rng()))  # with a NaN
    x = squares(0.5, 400, 1, 8)[0]
    rmse, nees = intervals(x, np.full(400, np.nan), rng())
    assert rmse.lower < rmse.value < rmse.upper
    assert nees.why
    assert math.isnan(nees.value)
    smooth, white, drift = squares(0.9, 1000, 1, 1)[0], squares(0.0, 1000, 1, 2)[0], np.linspace(0.0, 1.0, 1000)
    for pair in ((smooth, white), (white, smooth)):
        assert [i.block for i in intervals(*pair, rng())] == [block_length(smooth)] * 2
    refused, given = intervals(drift, white, rng())
    assert refused.why
    assert given.block == block_length(white) < refused.block


@pytest.mark.parametrize(("values", "why"), [
    (np.full(200, np.nan), "no frame has a true pose"),
    (rng().chisquare(2, MIN_FRAMES - 1), f"{MIN_FRAMES - 1} frames with truth are too few, {MIN_FRAMES} are needed"),
    (np.full(200, 0.3), "do not vary"),
    (np.linspace(0.0, 1.0, 200) ** 2, "worth about . independent ones, 20 are needed"),
    (squares(0.99, 200, 1, 7)[0], "independent ones"),
], ids=["no truth", "short", "constant", "drift", "correlated"])  # fmt: skip
def test_a_missing_interval_has_a_reason(values, why):
    for found in intervals(values, values, rng()):
        assert re.search(why, found.why)
        assert math.isnan(found.lower)
        assert math.isnan(found.upper)
        assert found.value == pytest.approx(np.sqrt(values.mean()), nan_ok=True) or found.value == values.mean()


def test_what_two_runs_share_cancels_in_their_difference():
    common = squares(0.9, 1000, 1, 9)[0]
    a, b = common + 0.1 + (0.05 * rng(10).standard_normal(1000)), common
    paired, _ = intervals((a, b), (a, b), rng())
    alone, _ = intervals(a, a, rng())
    assert paired.value == pytest.approx(math.sqrt(a.mean()) - math.sqrt(b.mean()))
    assert 0.0 < paired.lower < paired.value < paired.upper
    assert paired.upper - paired.lower < 0.2 * (alone.upper - alone.lower)
    assert paired.p == 1.0 / (1 + REPLICATES)


def test_a_rank_p_value_counts_the_twins_on_its_smaller_side_twice():
    twins = np.arange(1.0, 10.0)  # 1 ... 9
    assert rank_p(10.0, twins) == pytest.approx(2 * 1 / 10)
    assert rank_p(8.5, twins) == pytest.approx(2 * 2 / 10)
    assert rank_p(1.5, twins) == pytest.approx(2 * 2 / 10)
    assert rank_p(5.0, twins) == 1.0
    assert np.isnan(rank_p(1.0, np.empty(0)))
    assert np.isnan(rank_p(np.nan, twins))
    assert np.isnan(battery.bounds(np.array([1.0, 2.0, np.nan]))).all()


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


def test_constant_and_unknown_statistics_do_not_count_but_a_log_that_differs_from_them():
    rng = np.random.default_rng(2)
    twins = np.column_stack([rng.normal(size=39), np.full(39, 0.25), rng.normal(size=39)])
    p = family_p(np.array([0.1, 0.25, np.nan]), twins)
    assert p[0] > 0.05
    assert p[1] == 1.0
    assert np.isnan(p[2])
    twins = np.column_stack([np.ones(39), np.random.default_rng(4).normal(size=39)])
    assert family_p(np.array([0.3, 0.0]), twins)[0] == pytest.approx(1 / 40)


@pytest.mark.parametrize("n", [5, 19, 39, 99])
def test_one_more_draw_is_within_the_bounds_of_the_others_in_95_of_100(n):
    drawn = np.random.default_rng(n).standard_normal((4000, n + 1))
    bounds = np.array([battery.bounds(row[1:]) for row in drawn])
    inside = np.mean((bounds[:, 0] <= drawn[:, 0]) & (drawn[:, 0] <= bounds[:, 1]))
    assert inside == pytest.approx(0.95, abs=0.014)
