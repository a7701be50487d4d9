"""Proper scores against closed forms and numeric integration; the true covariance has the best expected score."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats

from eval.referee.proper_scores import crps, energy_score, log_score, mean_scores

P = np.array([[0.09, 0.02, 0.004], [0.02, 0.04, -0.003], [0.004, -0.003, 0.0025]])


def test_the_log_score_is_the_negative_log_density():
    e = np.array([[0.1, -0.3, 0.02], [0.0, 0.0, 0.0], [3.0, 1.0, -0.2]])
    found = log_score(e, np.tile(P, (3, 1, 1)))
    assert found == pytest.approx(-stats.multivariate_normal(np.zeros(3), P).logpdf(e), rel=1e-12)


def test_the_crps_is_the_integral_of_the_squared_difference_of_distributions():
    """Matheson & Winkler 1976: of the distribution functions of belief and truth, the latter a step."""
    for e, s in ((0.0, 1.0), (0.7, 0.4), (-2.0, 0.5), (1e-3, 2.0)):
        below = integrate.quad(lambda x, s=s: stats.norm.cdf(x, scale=s) ** 2, -20.0 * s, e)[0]
        above = integrate.quad(lambda x, s=s: stats.norm.sf(x, scale=s) ** 2, e, e + 20.0 * s)[0]
        assert float(crps(np.array(e), np.array(s))) == pytest.approx(below + above, rel=1e-8)


def distance_by_integration(y, S):
    """E|X - y| for X from N(0, S), over radius and direction of the whitened plane."""
    L = np.linalg.cholesky(S)

    def integrand(a, r):
        x = r * (L @ np.array([math.cos(a), math.sin(a)])) - y
        return math.hypot(*x) * r * math.exp(-0.5 * r * r) / (2.0 * math.pi)

    return integrate.dblquad(integrand, 0.0, 9.0, 0.0, 2.0 * math.pi, epsabs=1e-8)[0]


@pytest.mark.parametrize("y", [(0.0, 0.0), (0.3, -0.2), (1.5, 0.9)], ids=str)
def test_the_energy_score_is_that_of_numeric_integration(y):
    S = P[:2, :2]
    expected = distance_by_integration(np.array(y), S) - 0.5 * distance_by_integration(np.zeros(2), 2.0 * S)
    assert energy_score(np.array([y]), S[None])[0] == pytest.approx(expected, rel=1e-6)


def test_the_energy_score_of_a_belief_without_width_is_the_distance_and_of_a_line_the_crps():
    far = energy_score(np.array([[3.0, 4.0]]), 1e-14 * np.eye(2)[None])[0]
    assert far == pytest.approx(5.0, rel=1e-6)
    for y in (0.0, 0.5, -2.0):
        line = energy_score(np.array([[y, 0.0]]), np.diag([0.25, 1e-14])[None])[0]
        assert line == pytest.approx(float(crps(np.array(y), np.array(0.5))), rel=1e-5)


@pytest.mark.parametrize("claimed", [0.5, 0.8, 1.25, 2.0])
def test_the_true_covariance_has_the_best_mean_score(claimed):
    """Errors from N(0, P): every score is larger on average for a covariance of another size (strictly proper)."""
    rng = np.random.default_rng(1)
    n = 20_000
    errors = rng.multivariate_normal(np.zeros(3), P, n)
    right, wrong = np.tile(P, (n, 1, 1)), np.tile(claimed * P, (n, 1, 1))
    best, other = (mean_scores(errors, C, np.zeros((n, 3)), np.ones(n, bool)) for C in (right, wrong))
    assert all(best[name] < other[name] for name in best)


def test_a_heading_error_across_the_seam_is_a_small_one():
    pose, truth = np.array([[0.0, 0.0, math.pi - 0.01]]), np.array([[0.0, 0.0, -math.pi + 0.01]])
    near = mean_scores(np.array([[0.0, 0.0, -0.02]]), P[None], np.zeros((1, 3)), np.ones(1, bool))
    assert mean_scores(pose, P[None], truth, np.ones(1, bool)) == pytest.approx(near)


def test_scores_of_a_trajectory_are_means_over_its_frames():
    pose, truth = np.array([[0.1, -0.3, 0.02], [0.0, 0.4, -0.1]]), np.zeros((2, 3))
    both = mean_scores(pose, np.tile(P, (2, 1, 1)), truth, np.ones(2, bool))
    each = [mean_scores(pose[k : k + 1], P[None], truth[:1], np.ones(1, bool)) for k in range(2)]
    assert both == pytest.approx({name: 0.5 * (each[0][name] + each[1][name]) for name in both})
    assert each[0]["crps_y_m"] == pytest.approx(float(crps(np.array(-0.3), np.array(0.2))))


def test_frames_without_truth_and_with_a_singular_covariance_are_in_no_score():
    pose = np.array([[0.1, 0.0, 0.0], [9.0, 9.0, 1.0], [0.1, 0.0, 0.0]])
    scored = np.array([True, False, False])
    covariance = np.stack([P, np.zeros((3, 3)), np.full((3, 3), np.nan)])
    truth = np.zeros((3, 3))
    assert mean_scores(pose, covariance, truth, scored) == mean_scores(pose[:1], P[None], truth[:1], scored[:1])
    assert mean_scores(pose, covariance, truth, np.zeros(3, bool)) == {}
    assert np.isnan(energy_score(np.array([[np.nan, 0.0]]), P[None, :2, :2])).all()
