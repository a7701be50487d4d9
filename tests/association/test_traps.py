"""Each association fault of the list of traps, put in on purpose, is caught by the check that is named after it.

A check passes with the method as it is, and fails with the fault; both are asserted.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from association.decide import decide
from association.expectation import Expectation, SingularInnovationError, plain_residual
from association.jcbb import jcbb
from association.methods import ml, nn
from association.names import METHODS
from data.inputs import FrameObservations, LandmarkMap, Prior
from data.result import NEW
from data.sensors import RangeBearing
from ekf.localizer import EkfLocalizer
from tests.association.plain_jcbb import least_distance
from tests.association.problems import GATE, distance_of, exhaustive, problem, shuffled


def flat(z, z_hat, joint, sigma=0.1):
    """A problem in the plane with equal measurement noise."""
    return Expectation.from_arrays(z, z_hat, joint, np.tile(sigma**2 * np.eye(2), (len(z), 1, 1)))


def with_fault(fault):
    """Plain JCBB with a fault, in the place of ours."""
    return lambda e, gate: least_distance(e, gate, fault)


# 1: bearing innovation not wrapped


def check_a_landmark_behind_is_recognised_across_the_cut(expectation_of):
    """A landmark straight behind, seen at +179.9 degrees and expected at -179.9."""
    half = math.radians(0.1)
    known = LandmarkMap(np.array([0, 1]), 5.0 * np.array([[-math.cos(half), -math.sin(half)], [0.0, 1.0]]))
    f = EkfLocalizer(Prior(np.zeros(3), np.diag([1e-4, 1e-4, 1e-4])), RangeBearing(), known)
    e = expectation_of(f, FrameObservations(np.array([[5.0, math.pi - half]]), np.diag([0.01, 1e-4])[None]))
    for method in METHODS:
        assert decide(method, e, GATE, GATE, known_map=True).decisions.tolist() == [0]


def test_trap_1_a_bearing_that_is_not_wrapped():
    check_a_landmark_behind_is_recognised_across_the_cut(lambda f, s: f.expect(s))
    with pytest.raises(AssertionError):
        check_a_landmark_behind_is_recognised_across_the_cut(lambda f, s: replace(f.expect(s), residual=plain_residual))


# 5: no joint test, or at the individual gate's dof


def check_pairs_that_contradict_each_other_are_not_both_made(method):
    """Two landmarks that move together, seen 2.8 sigma to the left and 2.8 sigma to the right."""
    e = flat([[-2.8, 0.0], [12.8, 0.0]], [[0.0, 0.0], [10.0, 0.0]], np.tile(np.eye(2), (2, 2)))
    assert (e.individual_distances().diagonal() < chi2.ppf(GATE, 2)).all()
    assert (method(e, GATE) >= 0).sum() == 1


def check_many_pairs_may_add_up_to_more_than_one_may_have(method):
    """Three independent pairs with d^2 = 4 each: 12 is too much at 2 dof and fine at 6."""
    z_hat = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]])
    assert method(flat(z_hat + [0.2, 0.0], z_hat, np.zeros((6, 6))), GATE).tolist() == [0, 1, 2]


def test_trap_5_the_joint_distance_is_never_tested():
    check_pairs_that_contradict_each_other_are_not_both_made(jcbb)
    with pytest.raises(AssertionError):
        check_pairs_that_contradict_each_other_are_not_both_made(with_fault("no joint test"))


def test_trap_5_the_joint_distance_is_tested_at_the_dof_of_one_pair():
    check_many_pairs_may_add_up_to_more_than_one_may_have(jcbb)
    with pytest.raises(AssertionError):
        check_many_pairs_may_add_up_to_more_than_one_may_have(with_fault("joint test at 2 dof"))


# 6: a bound that cuts branches that could tie


def check_a_tie_found_later_can_win(method):
    """The first observation is alone a worse match than the second one, and both cannot be had."""
    e = flat([[-2.8, 0.0], [12.0, 0.0]], [[0.0, 0.0], [10.0, 0.0]], np.tile(np.eye(2), (2, 2)))
    assert method(e, GATE).tolist() == [NEW, 1]


def check_as_good_as_an_exhaustive_search(method):
    for seed in range(12):
        e = problem(seed, 5, 5, ambiguity=1.0, correlation=3.0, clutter=0.5)
        pairings, d2 = exhaustive(e)
        assert distance_of(e, method(e, GATE)) == (pairings, pytest.approx(d2))


@pytest.mark.parametrize("check", [check_a_tie_found_later_can_win, check_as_good_as_an_exhaustive_search])
def test_trap_6_the_bound_cuts_branches_that_could_tie(check):
    check(jcbb)
    with pytest.raises(AssertionError):
        check(with_fault("ties cut"))


# 7: the distribution function for its inverse


def check_two_sigma_are_inside_a_gate_of_99_percent():
    e = flat([[0.2, 0.0]], [[0.0, 0.0]], np.zeros((2, 2)))
    for method in METHODS:
        if method != "ml-ratio":  # its own threshold is far narrower
            assert decide(method, e, GATE, GATE).decisions.tolist() == [0]


def test_trap_7_the_distribution_function_stands_for_its_inverse(monkeypatch):
    check_two_sigma_are_inside_a_gate_of_99_percent()
    monkeypatch.setattr("association.expectation._chi2", lambda probability, dof: float(chi2.cdf(probability, dof)))
    with pytest.raises(AssertionError):
        check_two_sigma_are_inside_a_gate_of_99_percent()


# 10: the joint covariance in the order of its keys


def check_the_order_of_the_map_does_not_matter(fault):
    """Landmarks of very different covariance, stored youngest first."""
    for seed in range(12):
        e = problem(seed, 4, 5, ambiguity=1.0, correlation=1.0)
        turned = shuffled(e, [4, 2, 0, 3, 1])
        assert distance_of(e, jcbb(fault(turned), GATE)) == (exhaustive(e)[0], pytest.approx(exhaustive(e)[1]))


def test_trap_10_the_joint_covariance_comes_in_the_order_of_its_keys():
    check_the_order_of_the_map_does_not_matter(lambda e: e)
    with pytest.raises(AssertionError):
        check_the_order_of_the_map_does_not_matter(
            lambda e: replace(e, joint=lambda indices, joint=e.joint: joint(np.sort(indices)))
        )


# 17: division by the range without a guard


def check_a_landmark_at_the_robot_is_expected_with_finite_numbers(expectation_of):
    known = LandmarkMap(np.array([0, 1]), np.array([[0.0, 0.0], [3.0, 0.0]]))
    f = EkfLocalizer(Prior(np.zeros(3), np.diag([1e-2, 1e-2, 1e-3])), RangeBearing(), known)
    e = expectation_of(f.expect(FrameObservations(np.array([[3.0, 0.0]]), np.diag([0.01, 1e-3])[None])))
    for method in METHODS:
        assert decide(method, e, GATE, GATE, known_map=True).decisions.tolist() == [1]


def unguarded(e):
    """The bearing's variance as sigma^2 / r^2, whatever r is."""
    blocks = e.HPHt.copy()
    with np.errstate(all="ignore"):
        blocks[:, 1, 1] = 0.01 * (0.0 * e.z_hat[:, 0]) / (e.z_hat[:, 0] * e.z_hat[:, 0])
    return replace(e, HPHt=blocks)


def test_trap_17_a_landmark_at_the_robot_divides_by_its_range():
    check_a_landmark_at_the_robot_is_expected_with_finite_numbers(lambda e: e)
    with pytest.raises(SingularInnovationError, match="observation 0 and landmark 0"):
        check_a_landmark_at_the_robot_is_expected_with_finite_numbers(unguarded)


# 18: a likelihood that underflows


def check_the_nearer_of_two_far_landmarks_is_the_likelier(method):
    e = flat([[100.0, 0.0]], [[0.0, 0.0], [60.0, 0.0], [-10.0, 0.0]], np.zeros((6, 6)))
    assert method(e, None).tolist() == [1]


def exponentiated(e, gate):
    """Largest density, with the exponential taken."""
    S = e.HPHt[None] + e.R[:, None]
    density = np.exp(-0.5 * e.individual_distances()) / np.sqrt(np.linalg.det(2 * np.pi * S))
    return e.number[np.argmax(density, axis=1)]


def test_trap_18_a_likelihood_that_underflows_picks_the_first_landmark():
    check_the_nearer_of_two_far_landmarks_is_the_likelier(ml)
    with pytest.raises(AssertionError):
        check_the_nearer_of_two_far_landmarks_is_the_likelier(exponentiated)


# 19: nearest and likeliest are not the same


def check_by_distance_an_uncertain_landmark_attracts_more(method):
    e = flat([[0.25, 0.0]], [[0.0, 0.0], [1.0, 0.0]], np.diag([0.0, 0.0, 1.0, 1.0]))
    assert method(e, GATE).tolist() == [1]


def check_by_likelihood_the_certain_one_is_taken(method):
    e = flat([[0.25, 0.0]], [[0.0, 0.0], [1.0, 0.0]], np.diag([0.0, 0.0, 1.0, 1.0]))
    assert method(e, GATE).tolist() == [0]


def test_trap_19_nearest_neighbour_and_maximum_likelihood_are_told_apart():
    check_by_distance_an_uncertain_landmark_attracts_more(nn)
    check_by_likelihood_the_certain_one_is_taken(ml)
    with pytest.raises(AssertionError):
        check_by_distance_an_uncertain_landmark_attracts_more(ml)
    with pytest.raises(AssertionError):
        check_by_likelihood_the_certain_one_is_taken(nn)
