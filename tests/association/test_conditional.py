"""What all other pairings of a frame say about one, what a landmark's observations say, and accepted innovations."""

import math

import numpy as np
import pytest

from association.conditional import conditional_expectation, conditional_innovations, jcbb_conditional
from association.decide import decide
from association.expectation import Expectation, SingularInnovationError, gate_threshold
from association.jcbb import jcbb
from association.truncated import Acceptance, acceptance, accepted_moments, truncated_square
from data.result import DISCARD, NEW
from tests.association.problems import problem

GATE, NEW_GATE = 0.99, 0.99999
EYE = np.eye(2)


def turned(sigma=0.035, turn=0.0, noise=0.01, shift=None):
    """Eight points around a robot whose heading has this sigma [rad] and is off by `turn`; noise [m] of a point."""
    angle = np.linspace(-1.5, 1.5, 8)
    z_hat = np.stack([np.cos(angle), np.sin(angle)], 1) * np.array([2.0, 3.0, 4.0, 5.0] * 2)[:, None]
    across = np.stack([-z_hat[:, 1], z_hat[:, 0]], 1).reshape(-1, 1)
    joint = sigma**2 * across @ across.T + noise**2 * np.eye(16)
    z = z_hat + turn * across.reshape(-1, 2)
    if shift is not None:
        z[shift[0]] += shift[1]
    return Expectation.from_arrays(z, z_hat, joint, np.tile(noise**2 * EYE, (8, 1, 1)))


@pytest.mark.parametrize("seed", range(4))
def test_an_innovation_given_the_others_is_that_of_conditioning_on_them(seed):
    e = problem(seed, 5, 5, clutter=0.0)
    every = np.arange(5)
    S = e.joint(every)
    for i in range(5):
        S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += e.R[i]
    nu = e.residual(e.z, e.z_hat).ravel()
    found = conditional_innovations(e, every, every)
    for j in range(5):
        own, rest = np.arange(2 * j, 2 * j + 2), np.delete(np.arange(10), [2 * j, 2 * j + 1])
        gain = S[np.ix_(own, rest)] @ np.linalg.inv(S[np.ix_(rest, rest)])
        innovation, covariance = nu[own] - gain @ nu[rest], S[np.ix_(own, own)] - gain @ S[np.ix_(rest, own)]
        np.testing.assert_allclose(found.innovation[j], innovation, atol=1e-9)
        np.testing.assert_allclose(found.information[j], np.linalg.inv(covariance), rtol=1e-7, atol=1e-6)
        assert found.distance[j] == pytest.approx(innovation @ np.linalg.inv(covariance) @ innovation)


def test_a_singular_joint_covariance_is_named():
    e = Expectation.from_arrays([[0.0, 0.0]], [[0.0, 0.0]], np.zeros((2, 2)), np.zeros((1, 2, 2)), number=np.array([7]))
    with pytest.raises(SingularInnovationError, match=r"\[7\] is singular"):
        conditional_innovations(e, np.array([0]), np.array([0]))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_given_the_pairings_is_what_a_linear_update_expects(seed):
    e = problem(seed, 4, 6, clutter=0.0)
    decisions = np.array([2, NEW, 0, DISCARD])
    rows, chosen = np.array([0, 2]), np.array([2, 0])
    H = np.zeros((4, 12))
    for k, c in enumerate(chosen):
        H[2 * k : 2 * k + 2, 2 * c : 2 * c + 2] = EYE
    P, R = e.joint(np.arange(6)), np.zeros((4, 4))
    R[:2, :2], R[2:, 2:] = e.R[0], e.R[2]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    mean = e.z_hat.ravel() + K @ (e.z[rows] - e.z_hat[chosen]).ravel()
    after = P - K @ H @ P
    some = np.array([5, 2, 1])
    g = conditional_expectation(e, decisions, some)
    index = (2 * some[:, None] + np.arange(2)).ravel()
    assert g.number.tolist() == some.tolist()
    np.testing.assert_allclose(g.z_hat.ravel(), mean[index], atol=1e-12)
    np.testing.assert_allclose(g.joint(np.arange(3)), after[np.ix_(index, index)], atol=1e-12)
    np.testing.assert_allclose(g.HPHt[1], after[4:6, 4:6], atol=1e-12)


def test_a_common_error_outside_every_single_gate_hides_nothing():
    e = turned(turn=4.0 * 0.035)
    assert (jcbb(e, GATE) >= 0).sum() <= 1
    assert jcbb_conditional(e, GATE, NEW_GATE)[0].tolist() == list(range(8))


CONDITIONAL = "jcbb-conditional"


def test_one_pairing_inside_99_percent_has_the_moments_of_the_formula():
    c = gate_threshold(GATE)
    tail = math.exp(-c / 2)
    mean = 2 - c * tail / (1 - tail)
    variance = (8 - tail * (c * c + 4 * c + 8)) / (1 - tail) - mean**2
    assert truncated_square(c) == pytest.approx((mean, variance), rel=1e-9)
    assert mean / 2 == pytest.approx(0.9535, abs=1e-4)
    assert variance == pytest.approx(3.134, abs=1e-3)


def _problem(rng: np.random.Generator, k: int, common: float) -> tuple[Expectation, np.ndarray]:
    """k landmarks far apart, seen once each with unit noise and an error that all share."""
    H = np.tile(np.eye(2), (k, 1))
    P = common * H @ H.T
    S = P + np.eye(2 * k)
    z_hat = np.column_stack([1000.0 * np.arange(k), np.zeros(k)])
    nu = np.linalg.cholesky(S) @ rng.standard_normal(2 * k)
    return Expectation.from_arrays(z_hat + nu.reshape(k, 2), z_hat, P, np.tile(np.eye(2), (k, 1, 1))), S


@pytest.mark.parametrize("method", ["nn", "jcbb", CONDITIONAL])
@pytest.mark.parametrize("common", [0.1, pytest.param(5.0, marks=pytest.mark.slow)])
def test_what_a_method_accepts_has_the_expected_mean_and_spread(method, common):
    rng, total, mean, variance, dof = np.random.default_rng(5), 0.0, 0.0, 0.0, 0
    conditional = Acceptance(conditional=gate_threshold(GATE))
    passed = conditional if method == CONDITIONAL else acceptance(method, GATE)
    for turn in range(1500):
        e, S = _problem(rng, 3, common)
        if method == CONDITIONAL:
            decisions = jcbb_conditional(e, GATE, NEW_GATE)[0]
        else:
            decisions = decide(method, e, GATE, NEW_GATE).decisions
        rows = np.flatnonzero(decisions >= 0)
        both = (2 * rows[:, None] + np.arange(2)).ravel()
        m, v = accepted_moments(S[np.ix_(both, both)], passed, turn)
        mean, variance = mean + m, variance + v
        total, dof = total + e.innovation_statistics(rows, decisions[rows])[0], dof + len(both)
    assert (total - mean) / math.sqrt(variance) == pytest.approx(0.0, abs=3.0)
    if common < 1.0:  # gates on what all share leave out little
        assert (total - dof) / math.sqrt(2.0 * dof) < -2.0
