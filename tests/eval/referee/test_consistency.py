"""Verdicts accept right covariances and reject wrong ones."""

import math

import numpy as np
import pytest
from scipy import stats

from association.decide import known_decisions
from data.worlds.arena import Arena, simulate
from ekf.whole_run import run_filter
from eval.referee import consistency

RUNS = 60
WORLD = Arena(frames=80, field_of_view=2 * math.pi, landmarks=15)


@pytest.fixture(scope="module")
def arenas():
    return [simulate(WORLD, seed) for seed in range(RUNS)]


def run_means(arenas, estimate, quantity="pose"):
    means = []
    for log in arenas:
        pose, covariance = estimate(log.inputs(labels=True))
        means.append(consistency.mean_or_nan(consistency.nees(pose, covariance, log.truth.pose, quantity)))
    return np.array(means)


def the_filter(inputs):
    run = run_filter(inputs, known_decisions(inputs)[0])
    return run.pose, run.covariance


def test_one_diverged_run_or_one_far_off_is_overconfident_and_a_generous_covariance_conservative(arenas):
    sample = np.random.default_rng(9).chisquare(3 * 20, 60) / 20
    sample[7] = 500.0
    v = consistency.verdict(sample, 3)
    assert v.lower < 3 < v.upper
    assert v.word == "overconfident"
    assert v.p_value < 1e-6
    v = consistency.verdict(run_means(arenas, lambda i: (the_filter(i)[0], 1.5 * the_filter(i)[1])), 3)
    assert v.word == "conservative"
    # P(chi-square of 3 > 46) is 6e-10: no correlation of the frames makes that a draw of a right filter.
    assert consistency.verdict(np.array([46.0]), 3).word == "overconfident"
    assert consistency.verdict(np.r_[np.full(19, 3.0), 46.0], 3).word == "overconfident"
    assert consistency.verdict(np.array([30.0]), 1, words=consistency.INNOVATIONS).word == "NIS too large"
    for undecided in ([6.5], [0.1], [math.nan], [46.0, math.nan], []):
        assert consistency.verdict(np.array(undecided), 3).word == "not enough runs", undecided


def test_the_interval_is_students_t_and_fewer_than_fifty_runs_are_never_consistent():
    rng = np.random.default_rng(0)
    assert consistency.verdict(rng.chisquare(3, 49), 3).word == "not enough runs"
    assert consistency.verdict(rng.chisquare(3, 1), 3).word == "not enough runs"
    assert consistency.verdict(3.0 + 0.01 * rng.standard_normal(50), 3).word == "consistent"
    rng = np.random.default_rng(1)
    sample = rng.chisquare(3, 80)
    v = consistency.verdict(sample, 3)
    low, high = stats.t.interval(0.95, 79, loc=sample.mean(), scale=stats.sem(sample))
    assert (v.lower, v.upper) == (pytest.approx(low), pytest.approx(high))
    assert v.p_value == pytest.approx(stats.ttest_1samp(sample, 3).pvalue)


def test_stated_power_is_the_rejection_rate_of_a_shrunken_covariance():
    draws = np.random.default_rng(2).chisquare(3 * 20, (400, 50)) / 20
    rejected = np.mean([consistency.verdict(d / 0.8, 3).word == "overconfident" for d in draws])
    assert np.mean([consistency.verdict(d, 3).power for d in draws]) == pytest.approx(rejected, abs=0.06)


def test_squared_distance_does_not_depend_on_units_wraps_and_skips_singular_covariances():
    rng = np.random.default_rng(4)
    A = rng.normal(size=(5, 3, 3))
    P, e = A @ A.transpose(0, 2, 1), rng.normal(size=(5, 3))
    expected = [x @ np.linalg.solve(C, x) for x, C in zip(e, P, strict=True)]
    assert np.allclose(consistency.squared_distance(e, P), expected)
    D = np.diag([1e6, 1e-6, 1.0])
    assert np.allclose(consistency.squared_distance(e @ D, D @ P @ D), expected)
    P[0] = 0.0
    P[1] = np.outer([1, 2, 3], [1, 2, 3])
    P[2, 0, 0] = np.nan
    assert np.isnan(consistency.squared_distance(e, P)).tolist() == [True, True, True, False, False]
    pose, truth = np.array([[0, 0, math.pi - 0.01]]), np.array([[0, 0, -math.pi + 0.01]])
    assert consistency.nees(pose, np.eye(3)[None], truth, "heading")[0] == pytest.approx(0.02**2)


def test_chi_square_bounds_hold_their_level_and_holm_rejects_in_order():
    rng = np.random.default_rng(5)
    assert consistency.inside_3sigma((rng.standard_normal((200_000, 2)) ** 2).sum(1)) == pytest.approx(
        consistency.INSIDE_3SIGMA, abs=1e-3
    )
    assert pytest.approx(0.98889, abs=1e-5) == consistency.INSIDE_3SIGMA
    low, high = consistency.nis_bounds(200)
    draws = np.random.default_rng(6).chisquare(200, 20_000) / 200
    assert np.mean((low < draws) & (draws < high)) == pytest.approx(0.95, abs=0.01)
    assert consistency.anees_band(3, 50) == pytest.approx([3 * bound for bound in consistency.nis_bounds(150)])
    assert all(math.isnan(b) for b in consistency.nis_bounds(0))
    assert consistency.holm_rejected([0.0001, 0.04, 0.03, 0.005], 0.05) == [True, False, False, True]
    assert consistency.holm_rejected([0.5, 0.5]) == [False, False]
    assert consistency.holm_rejected([]) == []
    lower, upper = consistency.share_interval(0, 100)
    assert lower == 0.0
    assert (1.0 - upper) ** 100 == pytest.approx(0.025)
    assert consistency.share_interval(100, 100) == pytest.approx((1.0 - upper, 1.0))


@pytest.mark.parametrize("level", consistency.COVERAGE_LEVELS)
@pytest.mark.parametrize("inside", [0, 3, 40, 57, 60])
def test_coverage_bounds_and_p_value_are_the_exact_binomial_ones(level, inside):
    radius = stats.chi2.ppf(level, 3)
    v = consistency.coverage(np.r_[np.full(inside, 0.99 * radius), np.full(60 - inside, 1.01 * radius)], 3, level)
    bounds = stats.binomtest(inside, 60).proportion_ci(0.95, method="exact")
    assert (v.mean, v.lower, v.upper) == pytest.approx((inside / 60, bounds.low, bounds.high))
    assert (v.dof, v.expected, v.runs) == (3, level, 60)
    below, above = stats.binom.cdf(inside, 60, level), stats.binom.sf(inside - 1, 60, level)
    assert v.p_value == pytest.approx(min(1.0, 2 * min(below, above)))
    assert (v.word == "consistent") == (v.p_value >= 0.05)


@pytest.mark.slow
def test_coverage_power_is_the_rejection_rate_of_a_shrunken_covariance():
    drawn = np.random.default_rng(11).chisquare(3, (3000, 100)) / 0.8
    for level in consistency.COVERAGE_LEVELS:
        verdicts = [consistency.coverage(d, 3, level) for d in drawn]
        rejected = np.mean([v.word != "consistent" for v in verdicts])
        assert verdicts[0].power == pytest.approx(rejected, abs=0.03), level


def test_coverage_of_too_few_runs_or_of_an_undefined_nees_decides_nothing():
    assert consistency.coverage(np.zeros(49), 3, 0.5).word == "not enough runs"
    assert consistency.coverage(np.zeros(49), 3, 0.5).mean == 1.0
    assert consistency.coverage(np.zeros(50), 3, 0.5).word == "conservative"
    undefined = consistency.coverage(np.r_[np.zeros(59), np.nan], 3, 0.5)
    assert undefined.word == "not enough runs"
    assert math.isnan(undefined.mean)
    assert consistency.coverage(np.empty(0), 3, 0.5).word == "not enough runs"


def test_innovations_that_follow_each_other_are_correlated_before_their_size_is_judged():
    assert consistency.innovations_word(1.0, 0.9, 1.1, 0.72, 0.06) == "correlated"
    assert consistency.innovations_word(2.0, 0.9, 1.1, -0.3, 0.05) == "correlated"
    assert consistency.innovations_word(1.0, 0.9, 1.1, 0.15, 0.06) == "innovations fit", "2.5 standard errors"
    assert consistency.innovations_word(1.0, 0.9, 1.1, 0.05, 0.001) == "innovations fit", (
        "significant, and too small to matter"
    )
    few, more = (consistency.innovations_word(0.0, *consistency.nis_bounds(dof)) for dof in (6, 7))
    assert (few, more) == ("too few for a verdict", "NIS too small")
    assert consistency.innovations_word(math.nan, 0.9, 1.1, 0.72, 0.06) == ""
    r = 0.1 * np.random.default_rng(12).standard_normal(60)
    v = consistency.whiteness(r)
    assert (v.word, v.expected, v.dof, v.runs) == ("white", 0.0, 0, 60)
    assert (v.lower, v.upper) == pytest.approx(stats.t.interval(0.95, 59, loc=r.mean(), scale=stats.sem(r)))
    assert v.p_value == pytest.approx(stats.ttest_1samp(r, 0.0).pvalue)
    assert math.isnan(v.power), "blind to a claimed covariance: nothing to state"
    assert consistency.whiteness(r + 0.1).word == "correlated"
    assert consistency.whiteness(r - 0.1).word == "anticorrelated"
    assert consistency.whiteness(r[:49]).word == "not enough runs"
    assert consistency.whiteness(np.r_[r, np.nan]).word == "not enough runs"
    r = 0.1 * np.random.default_rng(13).standard_normal(60)
    for diverged in (40.0, -40.0):
        v = consistency.whiteness(np.r_[r, diverged])
        assert v.lower < 0.0 < v.upper
        assert v.word == "correlated"
        assert v.p_value < 1e-6
    # a run of a single pair may well be this large: one in 400 is, exp(-6)
    assert consistency.whiteness(np.r_[r, 3.0]).word == "white"


def test_lag_one_pairs_a_landmark_with_itself_in_the_next_frame_only():
    white = np.array([[1.0, 0.0], [0.0, 2.0], [3.0, 1.0], [5.0, 5.0], [1.0, 1.0], [7.0, 7.0], [np.nan, 1.0]])
    white = np.r_[white, np.ones((2, 2))]  # and two that initialize landmarks
    frame, number = np.array([0, 0, 1, 1, 2, 4, 2, 0, 1]), np.array([4, 9, 4, 8, 4, 4, 9, -1, -1])
    # landmark 4: (1,0).(3,1) = 3 into frame 1, (3,1).(1,1) = 4 into frame 2; frame 4 has no neighbour
    assert consistency.lag1(white, frame, number) == pytest.approx((7 / 4, math.sqrt(3**2 + 4**2) / 4))
    assert all(math.isnan(x) for x in consistency.lag1(white[:2], frame[:2], number[:2]))
    assert all(math.isnan(x) for x in consistency.lag1(np.empty((0, 2)), np.empty(0, int), np.empty(0, int)))
    shuffled = np.random.default_rng(14).permutation(len(white))
    assert consistency.lag1(white[shuffled], frame[shuffled], number[shuffled]) == pytest.approx(
        consistency.lag1(white, frame, number)
    )
