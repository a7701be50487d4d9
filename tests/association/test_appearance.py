"""Appearance as evidence, against dense likelihoods computed elsewhere."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import multivariate_normal

from association.appearance import Evidence, Looks
from association.conditional import prune
from association.decide import decide, horizon
from association.expectation import gate_threshold, threshold_with
from association.jcbb import search
from association.truncated import of_places, truncated_square
from data.appearance import UNREAD, Appearance
from tests.association.problems import problem
from tests.quick import examples

GATE = 0.99


def descriptors(values, sigma=0.1):
    values = np.asarray(values, float)
    n = len(values)
    return Appearance(values, np.full(n, sigma), np.full(n, UNREAD), np.full(n, 0.5))


def classes(read, error=0.1, names=("a", "b", "c")):
    n = len(read)
    return Appearance(np.full(n, np.nan), np.ones(n), np.array(read), np.full(n, error), names)


def described(seed, m, n):
    """A problem with descriptors: the expectation, readings (m,), means (n,) and variances (n,) of the landmarks."""
    rng = np.random.default_rng([seed, 1])
    e = problem(seed, m, n, ambiguity=0.7)
    mean, variance, sigma = rng.normal(size=n), rng.uniform(0.0, 0.05, n), rng.uniform(0.1, 0.4, m)
    z = np.array([mean[rng.integers(n)] + 0.2 * rng.normal() if n else 0.0 for _ in range(m)])
    looks = Looks()
    known = Appearance(mean, np.sqrt(variance), np.full(n, UNREAD), np.full(n, 0.5))
    looks.see(np.arange(n), known)
    seen = Appearance(z, sigma, np.full(m, UNREAD), np.full(m, 0.5))
    return e.with_appearance(looks.unlike(e.number, seen)), z, sigma, mean, variance


def dense(e, z, sigma, mean, variance, pairs):
    """Innovation (3k,) of pairings and its covariance: the descriptor is a third number of each measurement."""
    k = len(pairs)
    full = e.joint(np.arange(len(e.number)))
    nu, S = np.zeros(3 * k), np.zeros((3 * k, 3 * k))
    for a, (i, j) in enumerate(pairs):
        nu[3 * a : 3 * a + 2] = e.z[i] - e.z_hat[j]
        nu[3 * a + 2] = z[i] - mean[j]
        for b, (_, other) in enumerate(pairs):
            S[3 * a : 3 * a + 2, 3 * b : 3 * b + 2] = full[2 * j : 2 * j + 2, 2 * other : 2 * other + 2]
        S[3 * a : 3 * a + 2, 3 * a : 3 * a + 2] += e.R[i]
        S[3 * a + 2, 3 * a + 2] = variance[j] + sigma[i] ** 2
    return nu, S


def distance(nu, S):
    return float(nu @ np.linalg.solve(S, nu)) if len(nu) else 0.0


@pytest.mark.parametrize("seed", range(6))
def test_the_distance_of_a_pair_is_that_of_three_numbers(seed):
    e, z, sigma, mean, variance = described(seed, 4, 5)
    log_det = e.log_determinants()
    for i, j in itertools.product(range(4), range(5)):
        nu, S = dense(e, z, sigma, mean, variance, [(i, j)])
        assert e.individual_distances()[i, j] == pytest.approx(distance(nu, S))
        likelihood = multivariate_normal(np.zeros(3), S).logpdf(nu)
        got = -0.5 * (e.individual_distances()[i, j] + log_det[i, j] + 3 * math.log(2 * math.pi))
        assert got == pytest.approx(likelihood)


def test_a_pairing_that_looks_different_is_pruned():
    e = problem(3, 3, 3, clutter=0.0, ambiguity=0.1)
    found = search(e, 0.999999)
    assert found.pairings == 3
    looks = Looks()
    looks.see(np.arange(3), descriptors([0.0, 1.0, 2.0]))
    read = found.decisions.astype(float)
    read[1] += 1.0
    left = prune(e.with_appearance(looks.unlike(e.number, descriptors(read))), found.decisions, 0.9999999)
    assert left.tolist() == [found.decisions[0], -1, found.decisions[2]]


def test_a_descriptor_is_learned_as_the_weighted_mean_of_its_readings():
    rng = np.random.default_rng(0)
    z, sigma = rng.normal(size=20), rng.uniform(0.1, 2.0, 20)
    looks = Looks()
    looks.see(np.full(20, 7), Appearance(z, sigma, np.full(20, UNREAD), np.full(20, 0.5)))
    mean, variance = looks.estimate(np.array([7, 8]))
    weight = sigma**-2
    assert mean[0] == pytest.approx((weight @ z) / weight.sum())
    assert variance[0] == pytest.approx(1.0 / weight.sum())
    assert np.isnan(mean[1])
    assert variance[1] == math.inf


def test_the_term_of_a_class_is_bayes_rule():
    looks = Looks()
    looks.see(np.array([0, 0]), classes([1, 1], 0.1))
    looks.see(np.array([0]), classes([2], 0.2))
    # by hand: the likelihood of each true class, then of each reading with error 0.1
    truth = np.array([0.05 * 0.05 * 0.1, 0.9 * 0.9 * 0.1, 0.05 * 0.05 * 0.8])
    truth /= truth.sum()
    read = [sum(truth[k] * (0.9 if k == c else 0.05) for k in range(3)) for c in range(3)]
    unlike = looks.unlike(np.array([0, 1]), classes([0, 1, 2, UNREAD], 0.1))
    assert unlike.distance[:3, 0] == pytest.approx([-2.0 * math.log(p / max(read)) for p in read])
    assert not unlike.distance[:, 1].any()  # a landmark without a reading
    assert not unlike.distance[3].any()
    assert unlike.right.dims == 0


def test_a_missing_descriptor_counts_as_its_mean():
    looks = Looks()
    looks.see(np.array([0]), descriptors([0.5]))
    unlike = looks.unlike(np.array([0, 1]), descriptors([0.5, np.nan]))
    assert unlike.distance.tolist() == [[0.0, 1.0], [1.0, 1.0]]
    assert unlike.right.dims == 1


def test_a_known_appearance_stays_as_it_is():
    known = Appearance(np.array([2.0]), np.zeros(1), np.array([1]), np.zeros(1), ("a", "b"))
    looks = Looks()
    looks.see(np.array([4]), known)
    before = looks.unlike(
        np.array([4]), Appearance(np.array([2.1]), np.array([0.1]), np.array([0]), np.array([0.2]), ("a", "b"))
    )
    looks.see(np.array([4]), Appearance(np.array([9.0]), np.array([0.1]), np.array([0]), np.array([0.2]), ("a", "b")))
    assert looks.estimate(np.array([4]))[0].tolist() == [2.0]
    assert before.distance[0, 0] == pytest.approx(1.0 + 2.0 * math.log(0.8 / 0.2))


def test_merged_landmarks_have_the_readings_of_both():
    z = np.array([1.0, 1.2, 0.9])
    apart, together = Looks(), Looks()
    apart.see(np.array([0, 0, 1]), descriptors(z))
    apart.see(np.array([1, 0]), classes([2, 1]))
    apart.merge([(1, 0)])
    together.see(np.zeros(3, np.int64), descriptors(z))
    together.see(np.zeros(2, np.int64), classes([2, 1]))
    for a, b in zip(apart.estimate(np.array([0])), together.estimate(np.array([0])), strict=True):
        assert a == pytest.approx(b)
    read = classes([0, 1, 2])
    assert apart.unlike(np.array([0]), read).distance == pytest.approx(together.unlike(np.array([0]), read).distance)
    assert not np.isfinite(apart.estimate(np.array([1]))[1]).any()


def test_landmarks_differ_by_the_noise_of_a_reading_not_of_their_means():
    looks = Looks()
    looks.see(np.zeros(1000, np.int64), descriptors(np.zeros(1000)))
    looks.see(np.ones(1000, np.int64), descriptors(np.full(1000, 0.2)))
    looks.see(np.full(10, 2), descriptors(np.full(10, 0.5)))
    limit = gate_threshold(GATE, 1)
    assert looks.differ(np.array([0]), np.array([1, 2, 3]), limit).tolist() == [[False, True, False]]
    looks.see(np.array([0, 1]), classes([0, 1], 0.01))
    assert looks.differ(np.array([0]), np.array([1]), limit).tolist() == [[True]]


@given(st.integers(0, 10_000))
@settings(max_examples=examples(20), deadline=None)
def test_the_horizon_holds_every_landmark_that_decides(seed):
    e, *_ = described(seed, 3, 6)
    for method in ("nn", "ml", "gnn", "jcbb", "singles"):
        reach = horizon(method, GATE, 0.99999, looks=(1, 0))
        near = e.only(np.flatnonzero((replace(e, unlike=None).individual_distances() <= reach).any(axis=0)))
        few = decide(method, near, GATE, 0.99999).decisions
        assert few.tolist() == decide(method, e, GATE, 0.99999).decisions.tolist()


@pytest.mark.parametrize(("error", "pairs"), [(0.05, 1), (0.1, 4), (0.02, 12)])
def test_right_pairings_pass_the_gate_as_often_as_it_says_whatever_was_misread(error, pairs):
    rng, n, names = np.random.default_rng(0), 200_000, ("a", "b", "c", "d")
    looks = Looks()
    looks.see(np.zeros(100, np.int64), classes(np.zeros(100, np.int64), error, names))
    e = problem(0, 1, 1).with_appearance(looks.unlike(np.array([0]), classes([0], error, names)))
    misread = looks.unlike(np.array([0]), classes([3], error, names)).distance[0, 0]
    drawn = rng.chisquare(2 * pairs, n) + misread * rng.binomial(pairs, error, n)
    for gate in (0.9, 0.99):
        passed = np.mean(drawn < e.threshold(gate, pairs))
        assert passed == pytest.approx(gate, abs=4.0 * math.sqrt(gate * (1.0 - gate) / n))
    assert e.threshold(None) == math.inf
    assert e.threshold(GATE) > gate_threshold(GATE)


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=examples(20), deadline=None)
def test_the_log_ratio_is_that_of_both_likelihoods(seed, classed):
    rng = np.random.default_rng(seed)
    mean, z = rng.normal(size=5), rng.normal(size=3)
    looks = Looks()
    looks.see(np.arange(5), descriptors(mean, 0.2))
    got = looks.log_ratio(np.arange(6), descriptors(z, 0.3))
    any_ = multivariate_normal(mean.mean(), mean.var() + 0.09).logpdf(z)
    for j in range(5):
        own = [multivariate_normal(mean[j], 0.04 + 0.09).logpdf(v) for v in z]
        assert got[:, j] == pytest.approx(own - any_)
    assert not got[:, 5].any()  # an unknown landmark
    if classed:
        looks.see(np.array([0]), classes([1], 0.1))
        likely = [0.9, 0.05, 0.05]  # of the reading's class, given the true one in turn
        for c in range(3):
            p = sum(w * (0.8 if k == c else 0.1) for k, w in zip((1, 0, 2), likely, strict=True))
            assert looks.log_ratio(np.array([0]), classes([c], 0.2))[0, 0] == pytest.approx(math.log(3 * p))


@pytest.mark.parametrize("right", [Evidence(1), Evidence(0, 0.05, 8.0), Evidence(1, 0.1, 5.0)])
@pytest.mark.parametrize("pairs", [1, 6])
def test_the_place_of_right_pairings_has_the_mean_that_the_gate_with_appearance_leaves(right, pairs):
    rng, n, gate = np.random.default_rng(1), 400_000, 0.99
    place = rng.chisquare(2 * pairs, n)
    more = right.cost * rng.binomial(pairs, right.error, n)
    if right.dims:
        more = more + rng.chisquare(pairs, n)
    left = place[place + more < threshold_with(gate, 2, pairs, right)]
    mean, variance = truncated_square(of_places(gate, 2, pairs, right), 2 * pairs)
    assert mean == pytest.approx(left.mean(), abs=4.0 * left.std() / math.sqrt(len(left)))
    assert variance == pytest.approx(left.var(), rel=0.05)
    assert of_places(gate, 2, pairs) == gate_threshold(gate, 2 * pairs)
