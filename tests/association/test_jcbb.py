"""JCBB finds what an exhaustive search finds; `jcbb-first` what the recorded lab program finds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import chi2

from association.decide import decide
from association.expectation import Expectation, SingularInnovationError
from association.jcbb import SearchBudgetWarning, jcbb, jcbb_first, search
from data.result import NEW
from tests.association.problems import GATE, distance_of, exhaustive, joint_distances, problem, shuffled
from tests.quick import examples


def problems(largest):
    return st.builds(
        problem, st.integers(0, 2**32 - 1), st.integers(0, largest), st.integers(0, largest),
        ambiguity=st.sampled_from([0.3, 1.0, 3.0, 8.0]), clutter=st.sampled_from([0.0, 0.3]),
        correlation=st.sampled_from([0.0, 1.0, 3.0]),
    )  # fmt: skip


PROBLEMS = problems(6)


@settings(max_examples=examples(150), deadline=None)
@given(PROBLEMS, st.sampled_from([0.9, 0.99, None]))
def test_as_many_pairings_at_the_same_joint_distance_as_an_exhaustive_search(e, gate):
    pairings, d2 = exhaustive(e, gate)
    found = search(e, gate)
    assert found.complete
    assert found.pairings == pairings
    assert found.distance == pytest.approx(d2, rel=1e-9, abs=1e-9)
    assert distance_of(e, found.decisions) == (pairings, pytest.approx(d2, rel=1e-9, abs=1e-9))


def lab_rule(e, gate):
    """Order of operations of the recorded program: decisions (m,), -1 for unpaired."""
    m, n = len(e.z), len(e.number)
    compatible = e.individual_distances() < chi2.ppf(gate, 2)
    best = []

    def descend(i, pairs):
        nonlocal best
        if i == m:
            if len(pairs) > len(best):
                best = pairs
            return
        for j in range(n):
            if compatible[i, j]:
                more = [*pairs, (i, j)]
                if joint_distances(e, np.array([more]))[0] < chi2.ppf(gate, 2 * len(more)):
                    descend(i + 1, more)
        if len(pairs) + compatible[i + 1 :].any(axis=1).sum() >= len(best):
            descend(i + 1, pairs)

    descend(0, [])
    decisions = np.full(m, -1)
    for i, j in best:
        decisions[i] = e.number[j]
    return decisions


@settings(max_examples=examples(80), deadline=None)
@given(problems(5))
def test_jcbb_first_decides_as_the_lab_program_is_described(e):
    np.testing.assert_array_equal(jcbb_first(e, GATE), lab_rule(e, GATE))


def test_a_beginning_may_exceed_its_own_gate_where_the_whole_passes():
    far = 0.88 * np.sqrt(chi2.ppf(GATE, 2))
    z_hat = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0], [300.0, 0.0]])
    z = z_hat + np.array([[far, 0.0], [far, 0.0], [0.0, 0.0], [0.0, 0.0]])
    e = Expectation.from_arrays(z, z_hat, np.zeros((8, 8)), np.tile(np.eye(2), (4, 1, 1)))
    assert chi2.ppf(GATE, 4) < 2 * far**2 < chi2.ppf(GATE, 8)
    assert jcbb(e, GATE).tolist() == [0, 1, 2, 3]
    assert search(e, GATE, first=True).pairings == 3  # the lab program asks it of every beginning


def test_what_cannot_grow_is_held_to_its_own_gate():
    """Two of the three observations want the second landmark, so no three pairings can be made, and two are too far."""
    far = 0.88 * np.sqrt(chi2.ppf(GATE, 2))
    z_hat = np.array([[0.0, 0.0], [100.0, 0.0]])
    z = np.array([[1.01 * far, 0.0], [100.0 + far, 0.0], [100.0, 1.01 * far]])
    e = Expectation.from_arrays(z, z_hat, np.zeros((4, 4)), np.tile(np.eye(2), (3, 1, 1)))
    assert jcbb(e, GATE).tolist() == [NEW, 1, NEW]


def test_identical_landmarks_go_oldest_first_whatever_the_order_of_the_map():
    z, z_hat = np.array([[0.1, 0.0], [5.1, 0.0]]), np.array([[0.0, 0.0], [0.0, 0.0], [5.0, 0.0], [5.0, 0.0]])
    joint = np.kron(0.01 * np.ones((4, 4)) + 0.02 * np.kron(np.eye(2), np.ones((2, 2))), np.eye(2))
    e = Expectation.from_arrays(z, z_hat, joint, np.tile(0.01 * np.eye(2), (2, 1, 1)))
    for order in ([0, 1, 2, 3], [3, 2, 1, 0], [1, 3, 0, 2]):
        assert jcbb(shuffled(e, order), GATE).tolist() == [0, 2]


def test_a_window_of_frames_pairs_a_landmark_once_in_each_of_them():
    z = np.array([[0.1, 0.0], [5.1, 0.0]])
    e = Expectation.from_arrays(
        z, np.array([[5.0, 0.0], [0.0, 0.0]]), np.tile(np.eye(2), (2, 2)), np.tile(0.01 * np.eye(2), (2, 1, 1)),
        number=np.array([7, 7]), frame=np.array([4, 3]), observed_frame=np.array([3, 4]),
    )  # fmt: skip
    assert jcbb(e, GATE).tolist() == [7, 7]
    assert jcbb(replace(e, observed_frame=np.array([4, 3])), GATE).tolist() == [NEW, NEW]


def hard():
    """Half of it clutter, landmarks closer than their uncertainty: neither rule is through after 25 nodes."""
    return problem(3, 10, 10, ambiguity=0.3, correlation=3.0, clutter=0.6)


@pytest.mark.parametrize("first", [False, True])
def test_a_search_over_budget_says_so_and_returns_valid_pairings(first):
    e = hard()
    short = search(e, GATE, first=first, budget=25)
    assert not short.complete
    assert short.nodes == 25
    assert short.pairings == (short.decisions >= 0).sum() > 0
    assert short.distance < chi2.ppf(GATE, 2 * short.pairings)
    assert not decide("jcbb-first" if first else "jcbb", e, GATE, GATE, budget=25).complete
    with pytest.warns(SearchBudgetWarning, match="25 nodes"):
        (jcbb_first if first else jcbb)(e, GATE, budget=25)
    whole = search(e, GATE, first=first)
    assert whole.complete
    assert whole.pairings > short.pairings


def test_a_budget_of_nothing_is_an_error():
    with pytest.raises(ValueError, match="budget 0"):
        search(hard(), GATE, budget=0)


@pytest.mark.parametrize("first", [False, True])
def test_pairings_whose_joint_covariance_is_singular_are_an_error(first):
    """Each covariance is fine, but without measurement noise two fully correlated landmarks are not."""
    e = Expectation.from_arrays(
        np.array([[0.1, 0.0], [5.1, 0.0]]), np.array([[0.0, 0.0], [5.0, 0.0]]), np.tile(np.eye(2), (2, 2)),
        np.zeros((2, 2, 2)),
    )  # fmt: skip
    with pytest.raises(SingularInnovationError, match="joint innovation covariance"):
        search(e, GATE, first=first)
