"""Verdicts accept what is right and reject what is broken; every bound here has been given a chance to fail."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from association.known import known_decisions
from data.arena import Arena, simulate
from ekf.whole_run import run_filter
from eval import consistency
from eval.consistency import anees_band, chi2_bounds, holm_rejected, nees, squared_distance, verdict

_spec = importlib.util.spec_from_file_location("faulty", Path(__file__).parents[1] / "oracle" / "faulty_localizer.py")
faulty = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(faulty)

RUNS = 60
WORLD = Arena(frames=80, field_of_view=2 * math.pi, landmarks=15)


@pytest.fixture(scope="module")
def arenas():
    return [simulate(WORLD, seed) for seed in range(RUNS)]


def run_means(arenas, estimate, quantity="pose"):
    means = []
    for log in arenas:
        pose, covariance = estimate(log.inputs(labels=True))
        means.append(consistency.mean_or_nan(nees(pose, covariance, log.truth.pose, quantity)))
    return np.array(means)


def the_filter(inputs):
    run = run_filter(inputs, known_decisions(inputs)[0])
    return run.pose, run.covariance


@pytest.mark.parametrize(("quantity", "dof"), [("pose", 3), ("position", 2), ("heading", 1)])
def test_the_localizer_is_consistent(arenas, quantity, dof):
    v = verdict(run_means(arenas, the_filter, quantity), dof)
    assert v.word == "consistent", v
    assert v.power > 0.9, "a verdict without power says nothing"


def test_the_oracle_without_a_fault_is_the_filter(arenas):
    for log in arenas[:3]:
        inputs = log.inputs(labels=True)
        pose, covariance = faulty.run(inputs)
        ours, P = the_filter(inputs)
        assert np.abs(pose[:, :2] - ours[:, :2]).max() < 1e-9
        assert np.abs(covariance - P).max() < 1e-9


@pytest.mark.parametrize("fault", [f for f in faulty.FAULTS if f != "none"])
def test_each_broken_twin_is_called_overconfident(arenas, fault):
    v = verdict(run_means(arenas, lambda inputs: faulty.run(inputs, fault)), 3)
    assert v.word == "overconfident", (fault, v)


def test_one_diverged_run_among_many_is_overconfident_although_its_spread_widens_the_interval():
    sample = np.random.default_rng(9).chisquare(3 * 20, 60) / 20
    sample[7] = 500.0
    v = verdict(sample, 3)
    assert v.lower < 3 < v.upper
    assert v.word == "overconfident"
    assert v.p_value < 1e-6


def test_a_generous_covariance_is_called_conservative(arenas):
    v = verdict(run_means(arenas, lambda i: (the_filter(i)[0], 1.5 * the_filter(i)[1])), 3)
    assert v.word == "conservative"


def test_fewer_than_fifty_runs_are_never_called_consistent():
    rng = np.random.default_rng(0)
    assert verdict(rng.chisquare(3, 49), 3).word == "not enough runs"
    assert verdict(rng.chisquare(3, 1), 3).word == "not enough runs"
    assert verdict(3.0 + 0.01 * rng.standard_normal(50), 3).word == "consistent"


def test_the_interval_is_students_t():
    rng = np.random.default_rng(1)
    sample = rng.chisquare(3, 80)
    v = verdict(sample, 3)
    low, high = stats.t.interval(0.95, 79, loc=sample.mean(), scale=stats.sem(sample))
    assert (v.lower, v.upper) == (pytest.approx(low), pytest.approx(high))
    assert v.p_value == pytest.approx(stats.ttest_1samp(sample, 3).pvalue)


def test_stated_power_is_the_rejection_rate_of_a_shrunken_covariance():
    rng = np.random.default_rng(2)
    draws = rng.chisquare(3 * 20, (400, 50)) / 20
    rejected = np.mean([verdict(d / 0.8, 3).word == "overconfident" for d in draws])
    stated = np.mean([verdict(d, 3).power for d in draws])
    assert stated == pytest.approx(rejected, abs=0.06)


def test_perfect_samples_are_accepted_95_percent_of_the_time():
    rng = np.random.default_rng(3)
    words = [verdict(d, 3).word for d in rng.chisquare(3 * 20, (2000, 50)) / 20]
    assert np.mean([w == "consistent" for w in words]) == pytest.approx(0.95, abs=0.015)


def test_squared_distance_does_not_depend_on_units_and_skips_singular_covariances():
    rng = np.random.default_rng(4)
    A = rng.normal(size=(5, 3, 3))
    P, e = A @ A.transpose(0, 2, 1), rng.normal(size=(5, 3))
    expected = [x @ np.linalg.solve(C, x) for x, C in zip(e, P, strict=True)]
    assert np.allclose(squared_distance(e, P), expected)
    D = np.diag([1e6, 1e-6, 1.0])
    assert np.allclose(squared_distance(e @ D, D @ P @ D), expected)
    P[0] = 0.0
    P[1] = np.outer([1, 2, 3], [1, 2, 3])
    P[2, 0, 0] = np.nan
    assert np.isnan(squared_distance(e, P)).tolist() == [True, True, True, False, False]


def test_heading_nees_wraps():
    pose, truth = np.array([[0, 0, math.pi - 0.01]]), np.array([[0, 0, -math.pi + 0.01]])
    assert nees(pose, np.eye(3)[None], truth, "heading")[0] == pytest.approx(0.02**2)


def test_three_sigma_ellipse_holds_98_89_percent():
    rng = np.random.default_rng(5)
    assert consistency.inside_3sigma((rng.standard_normal((200_000, 2)) ** 2).sum(1)) == pytest.approx(
        consistency.INSIDE_3SIGMA, abs=1e-3
    )
    assert pytest.approx(0.98889, abs=1e-5) == consistency.INSIDE_3SIGMA


def test_chi2_bounds_hold_their_level():
    low, high = chi2_bounds(200)
    draws = np.random.default_rng(6).chisquare(200, 20_000) / 200
    assert np.mean((low < draws) & (draws < high)) == pytest.approx(0.95, abs=0.01)
    assert anees_band(3, 50) == (pytest.approx(3 * chi2_bounds(150)[0]), pytest.approx(3 * chi2_bounds(150)[1]))
    assert all(math.isnan(b) for b in chi2_bounds(0))


def test_holm_rejects_in_order_and_stops_at_the_first_that_survives():
    assert holm_rejected([0.0001, 0.04, 0.03, 0.005], 0.05) == [True, False, False, True]
    assert holm_rejected([0.5, 0.5]) == [False, False]
    assert holm_rejected([]) == []
