"""Several pose hypotheses in a known map: weights, revision, merging; they branch where an observation is ambiguous."""

import itertools
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import multivariate_t, norm

from data import se2
from data.inputs import FrameObservations, Increment, LandmarkMap, Prior
from data.result import DISCARD, NEW
from data.sensors import RangeBearing, RelativePoint
from data.worlds.registry import named_log
from ekf.localizer import EkfLocalizer
from eval.referee.score import confusion_of
from eval.replay.hindsight.constants import FREEDOM
from eval.replay.hindsight.hypotheses import FIRST, STRAY, DetectionRates, Hypotheses
from eval.replay.hindsight.multi_hypothesis import best_assignments
from eval.replay.run import compare, front_end, through
from eval.replay.settings import MHT, Setup

SENSOR = RelativePoint(max_range=20.0)
R = np.diag([0.1, 0.1]) ** 2


def one(x, y):
    return FrameObservations(np.array([[x, y]], float), R[None])


def bank(xy, sigma=(1.0, 1.0, 0.01), sensor=SENSOR):
    known = LandmarkMap(np.arange(len(xy)) + 10, np.array(xy, float))
    return Hypotheses(Prior(np.zeros(3), np.diag(np.square(sigma))), sensor, known), known


def test_weights_are_the_posterior_of_all_pairings():
    b, known = bank([[5.0, 0.0], [6.5, 0.0], [5.0, 3.0]], sigma=(0.6, 0.6, 1e-6))
    b._detection._seen[:] = 0.0  # a miss says nothing here
    z = np.array([[5.6, 0.1], [5.4, 2.9]])
    b.observe(FrameObservations(z, np.array([R, R])), 0)
    reach = max(float(np.hypot(*np.ptp(known.xy, axis=0))), 1.0)
    stray = np.log(STRAY / (0.5 * reach**2 * 2 * np.pi))
    P0, weight = 0.36 * np.eye(2), {}
    for pair in itertools.product([-1, 0, 1, 2], repeat=2):
        used = [(i, j) for i, j in enumerate(pair) if j >= 0]
        if len({j for _, j in used}) < len(used):
            continue
        # one after the other: Student's t of each, given those before; the position moves and narrows in between
        log, shift, P = stray * (2 - len(used)), np.zeros(2), P0
        for i, j in used:
            S, nu = P + R, z[i] - (known.xy[j] - shift)
            log += multivariate_t.logpdf(nu, np.zeros(2), S, df=FREEDOM)
            shift, P = shift - P @ np.linalg.solve(S, nu), P - P @ np.linalg.solve(S, P)
        weight[tuple(int(known.id[j]) if j >= 0 else DISCARD for j in pair)] = log
    best = max(weight.values())
    total = sum(np.exp(w - best) for w in weight.values())
    for h in b.members:
        assert h.past is not None
        expected = weight[h.past.before.number, h.past.number] - best - np.log(total)
        assert h.weight == pytest.approx(expected, abs=2e-3)
    assert len(b.members) >= 2
    assert sum(w > best - 5.0 for w in weight.values()) <= len(b.members)


def test_an_opinion_tells_what_all_agree_on():
    b, _ = bank([[5.0, 0.0], [6.6, 0.0], [0.0, 8.0]])
    b.observe(one(0.0, 8.0), 0)
    b.observe(one(5.6, 0.0), 1)
    number, share = b.opinion(2)
    by_hand = {h.past.number: 0.0 for h in b.members}
    for h in b.members:
        by_hand[h.past.number] += np.exp(h.weight)
    assert {10, 11} <= set(by_hand)
    assert number[1] == b.members[0].past.number == 10
    assert share[1] == pytest.approx(by_hand[10])
    assert 0.5 < share[1] < 1.0
    b.restart(np.zeros(3), np.eye(3))
    assert b.opinion(2)[0].tolist() == number.tolist()
    assert b.opinion(2)[1].tolist() == [1.0, 1.0]


def test_one_hypothesis_is_the_localizer():
    rng = np.random.default_rng(0)
    sensor = RangeBearing(max_range=10.0)
    known = LandmarkMap(np.arange(4), np.array([[5.0, 0.0], [0.0, 5.0], [-5.0, 0.0], [0.0, -5.0]]))
    prior = Prior(np.zeros(3), 1e-4 * np.eye(3))
    b, ekf = Hypotheses(prior, sensor, known), EkfLocalizer(prior, sensor, known)
    step = Increment(np.array([0.1, 0.0, 0.05]), 1e-5 * np.eye(3))
    pose = np.zeros(3)
    for k in range(30):
        b.predict(step)
        ekf.predict(step)
        pose = se2.compose(pose, step.mean)
        z = sensor.predict(pose, known.xy[k % 4 : k % 4 + 1]) + 0.01 * rng.standard_normal((1, 2))
        seen = FrameObservations(z, np.diag([1e-4, 1e-4])[None])
        assert b.observe(seen, k).decisions.tolist() == [k % 4]
        ekf.update(seen, np.array([k % 4]))
        leader = b.members[0]  # others, in which an observation was a stray, have next to no weight
        assert leader.weight > -1e-3
        assert np.array_equal(leader.mean, ekf.estimate().mean)
        assert np.array_equal(leader.P, ekf.estimate().covariance)


@pytest.mark.parametrize("kind", [RangeBearing, RelativePoint])
def test_a_landmark_is_in_view_with_the_probability_that_its_range_and_bearing_are(kind):
    sensor = kind(max_range=8.0, min_angle=-0.5, max_angle=0.5)
    polar = np.array([[5.0, 0.0], [5.0, -0.5], [5.0, 0.7], [8.0, 0.0], [8.2, 0.5], [5.0, np.pi]])
    plane = np.stack([polar[:, 0] * np.cos(polar[:, 1]), polar[:, 0] * np.sin(polar[:, 1])]).T
    z = polar if kind is RangeBearing else plane
    sigma = np.array([[0.2, 0.2]] * 6) if kind is RangeBearing else 0.2 * polar[:, :1] * [0.5, 1.0]
    found, part = DetectionRates(sensor).in_view(z, np.array([np.diag(s**2) for s in sigma]), 8.0)
    off = [1.0, 1.0, 1.0, 0.5, norm.cdf(-0.2 / (0.2 if kind is RangeBearing else 1.64)), 1.0]
    across = norm.cdf([2.5, 0.0, -1.0, 2.5, 0.0, -13.0]) - norm.cdf([-2.5, -5.0, -6.0, -2.5, -5.0, -18.0])
    assert found == pytest.approx(off * across, abs=1e-6 if kind is RangeBearing else 2e-3)
    assert part.tolist() == [6, 6, 6, 9, 9, 6]


def seen_and_expected(b):
    """What was added to either, by distance."""
    return (b._detection._seen - FIRST[0]).round(3).tolist(), (b._detection._expected - FIRST[1]).round(3).tolist()


def test_how_often_landmarks_are_seen_is_learned_by_their_distance():
    # up to 20 m in ten parts of 2 m: at 1, 5, 5.5 and 17 m in view, at 30 m out of view;
    # at 19.9 m a quarter of a sigma inside the limit of 20 m (0.4 m)
    b, _ = bank([[1.0, 0.0], [0.0, 5.0], [-5.5, 0.0], [0.0, -17.0], [19.9, 0.0], [30.0, 0.0]], sigma=(0.1, 0.1, 1e-3))
    b.observe(FrameObservations(np.array([[0.0, 5.0], [1.0, 0.0]]), np.array([R, R])), 0)
    seen, expected = seen_and_expected(b)
    assert seen == [1, 0, 1, 0, 0, 0, 0, 0, 0, 0]
    assert expected == [1, 0, 2, 0, 0, 0, 0, 0, 1, 0.599]


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 3))
def test_assignments_are_the_cheapest_of_all_in_order(seed, m, more):
    rng = np.random.default_rng(seed)
    cost = rng.normal(size=(m, m + more))
    cost[rng.random(cost.shape) < 0.3] = np.inf
    every = sorted(sum(cost[i, j] for i, j in enumerate(p)) for p in permutations(range(m + more), m))
    expected = [total for total in every if np.isfinite(total) and total <= every[0] + 2.0][:5]
    found = best_assignments(cost, 5, 2.0)
    assert [total for total, _ in found] == pytest.approx(expected)
    assert all(sum(cost[np.arange(m), columns]) == pytest.approx(total) for total, columns in found)


LOG = named_log("arena:1:frames=160")


def test_every_landmark_begins_once_and_the_map_has_those_that_the_final_decisions_name():
    log = named_log("corridor:2:people+frames=60")
    for run in compare(log.inputs(), "slam", ["ekf", "isam2", "batch"], MHT, Setup(hypotheses=3)):
        assert run.failure is None
        revised = {e.old == NEW or e.new == NEW for e in run.events}
        assert run.estimator == "batch" or revised == {True, False}, "another hypothesis took the lead"
        begun = run.initialized[run.initialized >= 0]
        assert len(set(begun.tolist())) == len(begun)
        assert set(run.final_decisions[run.final_decisions >= 0].tolist()) <= set(begun.tolist())
        assert ((run.final_decisions == NEW) == (run.initialized >= 0)).all()
        assert set(run.map.number.tolist()) == set(begun.tolist())


def test_later_observations_correct_pairings_that_one_frame_cannot_decide():
    runs = [*compare(LOG.inputs(), "slam", ["ekf"], "jcbb"), *compare(LOG.inputs(), "slam", ["ekf"], MHT)]
    wrong = {run.association: confusion_of(run, LOG, "final") for run in runs}
    assert wrong[MHT].fp + wrong[MHT].fn < wrong["jcbb"].fp + wrong["jcbb"].fn


@pytest.mark.parametrize("estimator", ["ekf", "isam2", "fixed-lag"])
def test_a_hypothesis_goes_on_as_if_it_were_alone(estimator):
    """A copy ends with the same bytes, whatever the original does meanwhile."""
    inputs = LOG.inputs().without_map()
    front = front_end(estimator, MHT, inputs, Setup(hypotheses=1))
    for k in range(40):
        through(front, inputs.frame(k), lambda *_: None)
    copied = front._copied(front.members[0].replay)
    for k in range(40, 60):
        front.move(inputs.frame(k))  # without its observations
        through(copied, inputs.frame(k), lambda *_: None)
    again = front_end(estimator, MHT, inputs, Setup(hypotheses=1))
    for k in range(40):
        through(again, inputs.frame(k), lambda *_: None)
    for k in range(40, 60):
        through(again.members[0].replay, inputs.frame(k), lambda *_: None)
    for found, expected in zip(copied.estimator.estimate(), again.members[0].replay.estimator.estimate(), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_in_a_known_map_it_localizes_without_labels():
    (run,) = compare(LOG.inputs(), "localization", ["ekf"], MHT)
    outcomes = confusion_of(run, LOG, "final")
    assert outcomes.fp + outcomes.fn <= 2
    assert not (run.decisions == NEW).any()


def test_more_hypotheses_than_one_are_only_kept_where_they_are_nearly_as_likely():
    inputs = LOG.inputs().without_map()
    kept = []
    for n in (1, 8):
        front = front_end("ekf", MHT, inputs, replace(Setup(), hypotheses=n))
        for k in range(30):
            through(front, inputs.frame(k), lambda *_: None)
            kept.append(len(front.members))
            assert kept[-1] <= n
    assert max(kept) == 8
