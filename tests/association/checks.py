"""What an association with a fault of the list of traps would get wrong; `tests.mutation` puts the faults in."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from association.decide import decide
from association.expectation import Expectation
from association.names import METHODS
from data.inputs import FrameObservations, LandmarkMap, Prior
from data.result import NEW
from data.sensors import RangeBearing
from ekf.localizer import EkfLocalizer
from tests.association.problems import GATE, distance_of, exhaustive, problem


def flat(z, z_hat, joint, sigma=0.1):
    """A problem in the plane with equal measurement noise."""
    return Expectation.from_arrays(z, z_hat, joint, np.tile(sigma**2 * np.eye(2), (len(z), 1, 1)))


def check_a_landmark_behind_is_recognised_across_the_cut(expectation_of):
    """A landmark straight behind, seen at +179.9 degrees and expected at -179.9."""
    half = math.radians(0.1)
    known = LandmarkMap(np.array([0, 1]), 5.0 * np.array([[-math.cos(half), -math.sin(half)], [0.0, 1.0]]))
    f = EkfLocalizer(Prior(np.zeros(3), np.diag([1e-4, 1e-4, 1e-4])), RangeBearing(), known)
    e = expectation_of(f, FrameObservations(np.array([[5.0, math.pi - half]]), np.diag([0.01, 1e-4])[None]))
    for method in METHODS:
        assert decide(method, e, GATE, GATE, known_map=True).decisions.tolist() == [0]


def check_pairs_that_contradict_each_other_are_not_both_made(method):
    """Two landmarks that move together, seen 2.8 sigma to the left and 2.8 sigma to the right."""
    e = flat([[-2.8, 0.0], [12.8, 0.0]], [[0.0, 0.0], [10.0, 0.0]], np.tile(np.eye(2), (2, 2)))
    assert (e.individual_distances().diagonal() < chi2.ppf(GATE, 2)).all()
    assert (method(e, GATE) >= 0).sum() == 1


def check_many_pairs_may_add_up_to_more_than_one_may_have(method):
    """Three independent pairs with d^2 = 4 each: 12 is too much at 2 dof and fine at 6."""
    z_hat = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]])
    assert method(flat(z_hat + [0.2, 0.0], z_hat, np.zeros((6, 6))), GATE).tolist() == [0, 1, 2]


def check_a_tie_found_later_can_win(method):
    """The first observation is alone a worse match than the second one, and both cannot be had."""
    e = flat([[-2.8, 0.0], [12.0, 0.0]], [[0.0, 0.0], [10.0, 0.0]], np.tile(np.eye(2), (2, 2)))
    assert method(e, GATE).tolist() == [NEW, 1]


def check_as_good_as_an_exhaustive_search(method):
    for seed in range(12):
        e = problem(seed, 5, 5, ambiguity=1.0, correlation=3.0, clutter=0.5)
        pairings, d2 = exhaustive(e)
        assert distance_of(e, method(e, GATE)) == (pairings, pytest.approx(d2))


def check_two_sigma_are_inside_a_gate_of_99_percent():
    e = flat([[0.2, 0.0]], [[0.0, 0.0]], np.zeros((2, 2)))
    for method in METHODS:
        if method != "ml-ratio":  # its own threshold is far narrower
            assert decide(method, e, GATE, GATE).decisions.tolist() == [0]


def check_a_landmark_at_the_robot_is_expected_with_finite_numbers(expectation_of):
    known = LandmarkMap(np.array([0, 1]), np.array([[0.0, 0.0], [3.0, 0.0]]))
    f = EkfLocalizer(Prior(np.zeros(3), np.diag([1e-2, 1e-2, 1e-3])), RangeBearing(), known)
    e = expectation_of(f.expect(FrameObservations(np.array([[3.0, 0.0]]), np.diag([0.01, 1e-3])[None])))
    for method in METHODS:
        assert decide(method, e, GATE, GATE, known_map=True).decisions.tolist() == [1]


def check_the_nearer_of_two_far_landmarks_is_the_likelier(method):
    e = flat([[100.0, 0.0]], [[0.0, 0.0], [60.0, 0.0], [-10.0, 0.0]], np.zeros((6, 6)))
    assert method(e, None).tolist() == [1]


def check_by_distance_an_uncertain_landmark_attracts_more(method):
    e = flat([[0.25, 0.0]], [[0.0, 0.0], [1.0, 0.0]], np.diag([0.0, 0.0, 1.0, 1.0]))
    assert method(e, GATE).tolist() == [1]


def check_by_likelihood_the_certain_one_is_taken(method):
    e = flat([[0.25, 0.0]], [[0.0, 0.0], [1.0, 0.0]], np.diag([0.0, 0.0, 1.0, 1.0]))
    assert method(e, GATE).tolist() == [0]
