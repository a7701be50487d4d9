"""The methods that look at each observation, or each pair, by itself; newness; and what all methods have in common."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import chi2, multivariate_normal

from association.decide import decide
from association.expectation import Expectation, SingularInnovationError
from association.methods import gnn, ml, ml_ratio, newness, nn, singles
from association.names import METHODS
from data.errors import UsageError
from data.result import DISCARD, NEW
from tests.association.problems import GATE, problem, shuffled
from tests.quick import examples

ORDERLESS = [m for m in METHODS if m != "jcbb-first"]
"""Methods whose decisions do not depend on the order of the map."""
LINE = 0.01 * np.eye(2)


def on_a_line(z, landmarks, variance=None, R=LINE):
    """Observations and candidates on the x axis; S = (variance + 0.01) I, by default 0.01 I, and no correlations."""
    variance = np.zeros(len(landmarks)) if variance is None else np.asarray(variance, float)
    at = [np.stack([np.asarray(a, float), np.zeros(len(a))], 1) for a in (z, landmarks)]
    return Expectation.from_arrays(*at, np.diag(np.repeat(variance, 2)), np.tile(R, (len(z), 1, 1)))


small = st.builds(
    problem, st.integers(0, 2**32 - 1), st.integers(0, 6), st.integers(0, 6), ambiguity=st.sampled_from([0.3, 1.0, 5.0])
)


# nearest neighbour


def test_nn_gives_one_landmark_to_many_observations_and_the_oldest_on_a_tie():
    assert nn(on_a_line([0.0, 0.05, 5.0], [5.0, 0.02, 0.02]), GATE).tolist() == [1, 1, 0]


def test_nn_takes_a_distance_that_equals_the_gate_and_the_others_do_not(monkeypatch):
    monkeypatch.setattr("association.expectation.threshold_with", lambda *of: 4.0)
    e = on_a_line([2.0], [0.0], R=np.eye(2))
    assert e.individual_distances()[0, 0] == 4.0
    assert nn(e, GATE).tolist() == [0]
    for method in (ml, singles, gnn):
        assert method(e, GATE).tolist() == [NEW]
    for method in ("jcbb", "jcbb-first"):
        assert decide(method, e, GATE, GATE).decisions.tolist() == [NEW]
    assert newness(e, np.array([NEW]), GATE).tolist() == [NEW]


# maximum likelihood


@settings(max_examples=examples(40), deadline=None)
@given(small)
def test_ml_is_the_largest_gaussian_density_among_the_compatible(e):
    for i, decision in enumerate(ml(e, GATE)):
        density = []
        for j in range(len(e.number)):
            S, nu = e.HPHt[j] + e.R[i], e.z[i] - e.z_hat[j]
            d2 = nu @ np.linalg.inv(S) @ nu
            inside = d2 < chi2.ppf(GATE, 2)
            density.append(np.exp(-0.5 * d2) / np.sqrt(np.linalg.det(2 * np.pi * S)) if inside else 0.0)
        assert decision == (np.argmax(density) if any(density) else NEW)


def test_ml_ratio_takes_the_best_only_if_it_beats_the_true_second_best():
    R = np.eye(2)

    def decisions(*distances, **more):
        """One observation at the origin, landmarks at these squared distances."""
        return ml_ratio(on_a_line([0.0], np.sqrt(distances), R=R), None, **more).tolist()

    assert decisions(0.1, 50.0) == [0]
    assert decisions(50.0, 0.1) == [1]
    assert decisions(0.1, 0.15) == [DISCARD]  # ambiguous between two landmarks,
    assert decisions(0.15, 9.0, 0.1) == [DISCARD]  # whatever comes between them
    assert decisions(0.1, 9.0, 0.15) == [DISCARD]
    assert decisions(0.6) == [DISCARD]  # ambiguous between a landmark and "new" at 0.84
    assert decisions(1.3) == [DISCARD]
    assert decisions(1.35) == [NEW]
    assert decisions(0.52) == [0]
    assert decisions(0.53) == [DISCARD]
    assert decisions(0.53, ratio=1.5) == [0]
    assert decisions(1.3, alpha=0.5) == [NEW]
    assert ml_ratio(on_a_line([0.0], []), None).tolist() == [NEW]


def test_ml_ratio_in_a_known_map_chooses_among_landmarks_alone():
    e = on_a_line([0.0], [np.sqrt(2.0), 10.0], R=np.eye(2))
    assert decide("ml-ratio", e, GATE, None).decisions.tolist() == [NEW]
    assert decide("ml-ratio", e, GATE, None, known_map=True).decisions.tolist() == [0]


def test_ml_ratio_asks_no_second_gate():
    e = on_a_line([np.sqrt(2.0)], [0.0], R=np.eye(2))
    assert decide("ml-ratio", e, GATE, 0.99999).decisions.tolist() == [NEW]
    assert decide("nn", e, 0.1, 0.99999).decisions.tolist() == [DISCARD]


# singles


def test_singles_pairs_only_what_has_nobody_else():
    e = on_a_line([0.0, 0.05, 5.0, 7.0], [0.02, 5.0, 6.95, 7.05])
    assert singles(e, GATE).tolist() == [NEW, NEW, 1, NEW]


# global nearest neighbour


@settings(max_examples=examples(40), deadline=None)
@given(small)
def test_gnn_is_the_cheapest_of_all_one_to_one_assignments(e):
    d2, price = e.individual_distances(), chi2.ppf(GATE, 2)
    m, n = d2.shape
    best = np.inf
    for choice in itertools.product(range(-1, n), repeat=m) if m < 5 else ():
        taken = [j for j in choice if j >= 0]
        if len(set(taken)) == len(taken) and all(d2[i, j] < price for i, j in enumerate(choice) if j >= 0):
            best = min(best, sum(d2[i, j] if j >= 0 else price for i, j in enumerate(choice)))
    decisions = gnn(e, GATE)
    assert all(d2[i, j] < price for i, j in enumerate(decisions) if j >= 0)
    assert len(set(decisions[decisions >= 0])) == (decisions >= 0).sum()
    if np.isfinite(best):
        assert sum(d2[i, j] if j >= 0 else price for i, j in enumerate(decisions)) == pytest.approx(best)


def test_gnn_without_a_gate_pairs_as_many_as_there_are():
    assert sorted(gnn(on_a_line([0.0, 1.0, 900.0], [5.0, 6.0]), None).tolist()) == [NEW, 0, 1]
    assert gnn(on_a_line([0.0, 900.0], [5.0, 6.0, 7.0]), None).tolist() == [0, 2]


# newness


def test_an_observation_is_new_only_outside_the_second_gate_of_every_landmark():
    e = on_a_line([0.0, 0.4, 3.0], [0.0, 50.0])  # d^2 = 0, 16, 900
    assert chi2.ppf(0.99, 2) < 16 < chi2.ppf(0.99999, 2)
    assert decide("nn", e, 0.99, 0.99).decisions.tolist() == [0, NEW, NEW]
    assert decide("nn", e, 0.99, 0.99999).decisions.tolist() == [0, DISCARD, NEW]
    assert decide("nn", e, 0.99, None).decisions.tolist() == [0, DISCARD, DISCARD]
    assert decide("nn", e, 0.99, 0.99, known_map=True).decisions.tolist() == [0, DISCARD, DISCARD]


# what all have in common


@settings(max_examples=examples(60), deadline=None)
@given(small, st.randoms(use_true_random=False), st.sampled_from([0.99, None]))
def test_the_order_of_the_map_changes_no_decision(e, random, gate):
    order = list(range(len(e.number)))
    random.shuffle(order)
    for method in ORDERLESS:
        np.testing.assert_array_equal(
            decide(method, shuffled(e, order), gate, 0.99999).decisions, decide(method, e, gate, 0.99999).decisions
        )


@pytest.mark.parametrize("method", METHODS)
def test_landmarks_of_another_frame_are_no_candidates(method):
    e = replace(on_a_line([0.0, 0.0], [0.0]), frame=np.array([3]), observed_frame=np.array([3, 4]))
    for gate in (0.99, None):
        assert decide(method, e, gate, 0.99999).decisions.tolist() == [0, NEW]


@pytest.mark.parametrize("method", METHODS)
def test_a_singular_innovation_covariance_is_an_error_that_names_the_pair(method):
    for S in (np.zeros((2, 2)), np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([[1.0, 0.0], [0.0, -1.0]])):
        e = Expectation.from_arrays(np.zeros((1, 2)), np.array([[0.1, 0.0]]), S, np.zeros((1, 2, 2)), number=[42])
        with pytest.raises(SingularInnovationError, match="observation 0 and landmark 42"):
            decide(method, e, 0.99, 0.99)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("gate", [0.0, 1.0, -0.5, 9.21, float("nan")])
def test_a_gate_that_is_no_probability_is_an_error(method, gate):
    e = on_a_line([0.0], [0.0])
    with pytest.raises(ValueError, match="probability"):
        decide(method, e, gate, 0.99)
    if method != "ml-ratio":
        with pytest.raises(ValueError, match="probability"):
            decide(method, e, 0.99, gate)


def test_an_unknown_method_is_an_error_that_names_those_there_are():
    with pytest.raises(UsageError, match="'icp': unknown; known: nn, ml"):
        decide("icp", on_a_line([0.0], [0.0]), 0.99, 0.99)


@pytest.mark.parametrize("pairs", [[(0, 2)], [(2, 0), (0, 3)], [(0, 1), (1, 3), (3, 0)]])
def test_the_likelihood_of_pairings_is_their_joint_gaussian_density(pairs):
    e = problem(11, 4, 5)
    rows, chosen = np.array(pairs).T
    nis, dof, likelihood = e.innovation_statistics(rows, chosen)
    full, S = e.joint(np.arange(5)), np.empty((2 * len(pairs),) * 2)
    for a, (i, j) in enumerate(pairs):
        for b, (_, k) in enumerate(pairs):
            S[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] = full[2 * j : 2 * j + 2, 2 * k : 2 * k + 2] + (a == b) * e.R[i]
    nu = np.concatenate([e.z[i] - e.z_hat[j] for i, j in pairs])
    assert dof == 2 * len(pairs)
    assert nis == pytest.approx(nu @ np.linalg.inv(S) @ nu)
    assert likelihood == pytest.approx(multivariate_normal.logpdf(nu, np.zeros(dof), S))


def test_pairings_that_cannot_differ_are_an_error_that_names_their_landmarks():
    e = Expectation.from_arrays(
        np.zeros((2, 2)), np.zeros((2, 2)), np.tile(np.eye(2), (2, 2)), np.zeros((2, 2, 2)), number=np.array([4, 7])
    )
    with pytest.raises(SingularInnovationError, match=r"landmarks \[7, 4\] is singular"):
        e.innovation_statistics(np.array([0, 1]), np.array([1, 0]))
