"""What accepted innovations are expected to be: the formula for one pairing, simulation of the methods for several."""

import math

import numpy as np
import pytest

from association.conditional import jcbb_conditional
from association.decide import decide
from association.expectation import Expectation, gate_threshold
from association.truncated import Acceptance, acceptance, accepted_moments, truncated_square

GATE = 0.99
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
            decisions = jcbb_conditional(e, GATE, 0.99999)[0]
        else:
            decisions = decide(method, e, GATE, 0.99999).decisions
        rows = np.flatnonzero(decisions >= 0)
        both = (2 * rows[:, None] + np.arange(2)).ravel()
        m, v = accepted_moments(S[np.ix_(both, both)], passed, turn)
        mean, variance = mean + m, variance + v
        total, dof = total + e.innovation_statistics(rows, decisions[rows])[0], dof + len(both)
    assert (total - mean) / math.sqrt(variance) == pytest.approx(0.0, abs=3.0)
    if common < 1.0:  # gates on what all share leave out little
        assert (total - dof) / math.sqrt(2.0 * dof) < -2.0
