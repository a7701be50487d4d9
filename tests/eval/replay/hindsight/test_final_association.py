"""All readings paired anew at the end: the noise that there is, one-to-one pairs, the floor, landmarks that are one."""

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import multivariate_normal

from association.expectation import gate_threshold
from data.inputs import LandmarkMap, Observations
from data.notice import Code
from data.result import CHI_SQUARE, DISCARD
from data.se2 import wrap_angle
from data.sensors import RangeBearing, RelativePoint
from data.worlds.registry import named_log
from eval.referee.confusion import confuse
from eval.replay.hindsight import constants, whole_log
from eval.replay.hindsight.final_association import Reassociation, beginnings, noise_share, reassociate
from eval.replay.hindsight.opportunities import Detections, evidence
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from graph.problem import Start

SENSORS = (RangeBearing(max_range=8.0), RelativePoint(max_range=8.0))
each_sensor = pytest.mark.parametrize("sensor", SENSORS, ids=["range-bearing", "point"])
SIGMA = np.array([0.1, 0.05])


def seen_from(sensor, pose, xy, rng, stated=1.0):
    """Each of the landmarks (L, 2) read from each pose; R is `stated` times the variance that there is."""
    frame = np.repeat(np.arange(len(pose)), len(xy))
    number = np.tile(np.arange(len(xy)), len(pose))
    z = sensor.predict(pose[frame], xy[number]) + SIGMA * rng.standard_normal((len(frame), 2))
    return Observations(frame, z, np.tile(stated * np.diag(SIGMA**2), (len(frame), 1, 1))), number


def poses(rng, count):
    return np.column_stack([rng.uniform(-3.0, 3.0, (count, 2)), rng.uniform(-np.pi, np.pi, count)])


@each_sensor
@pytest.mark.parametrize("stated", [0.25, 1.0, 9.0])
def test_the_noise_that_there_is_is_told_as_a_share_of_what_is_stated(sensor, stated):
    rng = np.random.default_rng(3)
    pose, known = poses(rng, 400), LandmarkMap(np.arange(5), rng.uniform(-4.0, 4.0, (5, 2)))
    seen, number = seen_from(sensor, pose, known.xy, rng, stated)
    assert noise_share(sensor, pose, known, seen, number) == pytest.approx(1.0 / stated, rel=0.1)


def test_a_landmark_read_three_times_tells_nothing_of_the_noise_and_one_read_four_times_does():
    sensor, rng = SENSORS[0], np.random.default_rng(4)
    known = LandmarkMap(np.array([0]), np.array([[2.0, 1.0]]))
    pose = poses(rng, 4)
    seen, _ = seen_from(sensor, pose, known.xy, rng, 100.0)
    assert noise_share(sensor, pose, known, seen, np.array([0, 0, 0, -1])) == 1.0
    assert noise_share(sensor, pose, known, seen, np.full(4, -1)) == 1.0
    assert noise_share(sensor, pose, known, seen, np.zeros(4, np.int64)) < 0.1


def test_it_is_the_quantile_of_the_squared_distances_and_never_less_than_the_finest():
    sensor, known = SENSORS[1], LandmarkMap(np.array([2]), np.array([[1.0, 0.0]]))
    pose, off = np.zeros((11, 3)), np.arange(11.0)
    z = np.column_stack([1.0 + off, np.zeros(11)])
    seen = Observations(np.arange(11), z, np.tile(np.eye(2), (11, 1, 1)))
    own = np.full(11, 2)
    assert noise_share(sensor, pose, known, seen, own) == pytest.approx(81.0 / gate_threshold(0.9))
    exact = Observations(np.arange(11), np.tile([1.0, 0.0], (11, 1)), seen.R)
    assert noise_share(sensor, pose, known, exact, own) == constants.LEAST_SCALE


def by_trying_all(d2, gate):
    """The cheapest one-to-one assignment (m,) among all, an observation left alone costing `gate`."""
    m, n = d2.shape
    best, found = np.inf, None
    for choice in permutations([*range(n), *[-1] * m], m):
        cost = sum(gate if j < 0 else d2[i, j] for i, j in enumerate(choice))
        if cost < best and all(j < 0 or d2[i, j] < gate for i, j in enumerate(choice)):
            best, found = cost, choice
    return list(found)


@each_sensor
@given(seed=st.integers(0, 10**6))
def test_each_frame_is_paired_at_least_cost_and_what_one_landmark_alone_explains_is_told(sensor, seed):
    rng = np.random.default_rng(seed)
    known = LandmarkMap(np.array([0, 5, 8]), rng.uniform(1.0, 2.0, (3, 2)))
    pose = 0.2 * rng.standard_normal((2, 3))
    frame = np.array([0, 0, 1, 1, 1])
    R = np.tile(np.diag([0.2, 0.1]) ** 2, (5, 1, 1))
    z = sensor.predict(pose[frame], known.xy[rng.integers(3, size=5)]) + 0.3 * rng.standard_normal((5, 2))
    found = reassociate(sensor, pose, known, Observations(frame, z, R))
    gate = gate_threshold(constants.REASSOCIATION_GATE)
    for k in (0, 1):
        rows = np.flatnonzero(frame == k)
        nu = z[rows][:, None] - sensor.predict(pose[k], known.xy)[None]
        if sensor.kind == "range_bearing":
            nu[..., 1] = wrap_angle(nu[..., 1])
        d2 = (nu**2 / np.diagonal(R[0])).sum(axis=2)
        expected = by_trying_all(d2, gate)
        assert found.number[rows].tolist() == [-1 if j < 0 else known.id[j] for j in expected]
        single = (d2 < gate).sum(axis=1) == 1
        own = [np.inf if j < 0 else d2[i, j] + (0.0 if single[i] else gate) for i, j in enumerate(expected)]
        assert found.misfit[rows].tolist() == pytest.approx(own)


def test_a_landmark_begins_with_its_surest_reading():
    number = np.array([4, 4, -1, 6, 4, 6, 9, 9])
    misfit = np.array([15.0, 2.0, np.inf, 1.0, 0.5, 3.0, 14.0, 14.0])
    assert beginnings(Reassociation(number, misfit)) == {4: 4, 6: 3, 9: 6}
    assert beginnings(Reassociation(number[:0], misfit[:0])) == {}


VIEW = RelativePoint(max_range=10.0, min_angle=-1.0, max_angle=1.0)
NOISE = 0.1
SEEN = b"\3\3"
"""Detected twice from familiar viewpoints, after the first time."""


def decided(number, z, xy, looks=None, motion=0.0, share=1.0):
    """Observations z (m, 2) of landmarks at xy, one a frame, from the origin."""
    m, number = len(z), np.array(number)
    seen = Observations(np.arange(m), np.asarray(z, float), np.tile(NOISE**2 * np.eye(2), (m, 1, 1)))
    ids = np.arange(len(xy))
    found = Reassociation(number, np.zeros(m))
    known = LandmarkMap(ids, np.asarray(xy, float))
    return whole_log.Smoothed(
        VIEW, np.zeros((m, 3)), known, seen, found, share, motion,
        {n: Detections(each) for n, each in (looks or dict.fromkeys(ids.tolist(), SEEN)).items()},
        Start(np.zeros((m, 3)), known.xy), CHI_SQUARE,
    )  # fmt: skip


Z = [[5.0, 0.1], [5.1, 0.0], [4.95, -0.05], [7.0, 2.0]]


def test_the_likelihood_is_that_of_observations_with_the_position_integrated_out():
    s = decided([0, 0, 0, -1], Z, [np.mean(Z[:3], axis=0)])
    clutter = 2.0 / (2.0 * 10.0**2)
    # the marginal of three observations of a point anywhere: by integration on a grid
    grid = np.arange(-0.6, 0.6, 0.01)
    at = np.stack(np.meshgrid(5.0 + grid, grid), axis=-1)
    product = np.prod([multivariate_normal(z, NOISE**2 * np.eye(2)).pdf(at) for z in Z[:3]], axis=0)
    integrated = clutter * product.sum() * 0.01**2
    expected = math.log(integrated) - 3.0 * math.log(clutter) + evidence([Detections(SEEN)])[0]
    assert whole_log.log_likelihood(s, 1.0, VIEW) == pytest.approx(expected, abs=1e-3)


def test_a_landmark_that_explains_less_than_clutter_does_counts_as_clutter():
    assert whole_log.log_likelihood(decided([0, 0, 0, -1], Z, [[9.0, 0.0]]), 1.0, VIEW) == 0.0
    assert whole_log.log_likelihood(decided([0, -1, -1, -1], Z, [Z[0]]), 1.0, VIEW) == 0.0


def test_odometry_and_missed_detections_speak_against_decisions():
    number, xy = [0, 0, 0, -1], [np.mean(Z[:3], axis=0)]
    plain_ = whole_log.log_likelihood(decided(number, Z, xy), 1.0, VIEW)
    assert whole_log.log_likelihood(decided(number, Z, xy, motion=8.0), 1.0, VIEW) == pytest.approx(plain_ - 4.0)
    missed = {0: b"\3\3" + b"\2\3" * 4}
    assert whole_log.log_likelihood(decided(number, Z, xy, looks=missed), 1.0, VIEW) < plain_


def test_two_sets_are_compared_under_the_smaller_noise():
    number, xy = [0, 0, 0, -1], [np.mean(Z[:3], axis=0)]
    ours, theirs = decided(number, Z, xy, share=4.0), decided([0, 0, -1, -1], Z, xy, share=1.0)
    odds = whole_log.log_likelihood(theirs, 1.0, VIEW) - whole_log.log_likelihood(ours, 1.0, VIEW)
    assert whole_log.likelier(ours, theirs, VIEW) == pytest.approx(odds)
    assert odds < 0.0


def test_jcbb_is_asked_where_an_often_observed_landmark_would_not_stay():
    z, number = [[5.0, 0.0], [7.0, 2.0]] * 5, [0, 1] * 5
    xy, seen = [[5.0, 0.0], [7.0, 2.0]], b"\3" * 8
    assert decided(number, z, xy, looks={0: seen, 1: seen}).consistent
    assert not decided(number, z, xy, looks={0: seen, 1: b"\2" * 8}).consistent


def test_a_landmark_that_would_not_stay_counts_as_clutter():
    z, number = [[5.0, 0.0], [7.0, 2.0]] * 5, [0, 1] * 5
    looks = {0: b"\3" * 8, 1: b"\2" * 8}
    both = decided(number, z, [[5.0, 0.0], [7.0, 2.0]], looks=looks)
    one = decided([0, -1] * 5, z, [[5.0, 0.0], [7.0, 2.0]], looks=looks)
    assert whole_log.log_likelihood(both, 1.0, VIEW) == pytest.approx(whole_log.log_likelihood(one, 1.0, VIEW))


def test_landmarks_get_the_numbers_of_those_with_most_observations_in_common():
    found = Reassociation(np.array([0, 0, 0, 1, 1, 2, -1]), np.zeros(7))
    held = np.array([7, 7, 4, 7, 4, DISCARD, 4])
    assert whole_log.renumbered(found, held).number.tolist() == [7, 7, 7, 4, 4, -1, -1]
    assert whole_log.renumbered(found, np.full(7, DISCARD)).number.tolist() == [-1] * 7


def test_what_was_observed_once_is_no_landmark():
    assert whole_log.observed_again(np.array([3, 1, 3, -1])).tolist() == [3, DISCARD, 3, DISCARD]


def test_plain_decisions_are_those_of_jcbb():
    inputs = named_log("arena:2:frames=60+clutter=0.5").inputs(labels=False).without_map()
    run = step_by_step("ekf", inputs, "slam", "jcbb")
    frames = [inputs.frame(k) for k in range(len(inputs))]
    found = whole_log.plain(inputs, Setup(), frames, 1000)
    assert found is not None
    assert whole_log.plain(inputs, Setup(), frames, int(run.created.max())) is None, "more landmarks than are allowed"
    assert np.array_equal(found[0], np.where(run.created >= 0, run.created, run.decisions))
    np.testing.assert_allclose(found[1], run.online.pose, atol=1e-9)


@pytest.mark.slow
def test_where_they_are_likelier_the_decisions_of_jcbb_are_the_final_ones_and_it_is_said(monkeypatch):
    log = named_log("arena:2:frames=60")
    inputs = log.inputs(labels=False).without_map()
    usual = step_by_step("ekf", inputs, "slam", "jcbb-hindsight")
    assert Code.PLAIN_LIKELIER not in [n.code for n in usual.notes]
    monkeypatch.setattr(whole_log, "likelier", lambda *_: 2.0 * constants.PLAIN_ODDS)
    monkeypatch.setattr(whole_log.Smoothed, "consistent", False)
    run = step_by_step("ekf", inputs, "slam", "jcbb-hindsight")
    (note,) = [n for n in run.notes if n.code is Code.PLAIN_LIKELIER]
    assert note.named == {"odds": 2.0 * constants.PLAIN_ODDS}
    o, who = log.recorded.observations, log.truth.landmark_of
    assert confuse(o.frame, who, run.final_decisions, run.initialized, None, run.removed).fp == 0
    assert np.array_equal(run.decisions, usual.decisions)
    assert set(run.final_decisions[run.final_decisions >= 0].tolist()) <= set(run.map.number.tolist())


SENSOR = RelativePoint(max_range=10.0, min_angle=-math.pi, max_angle=math.pi)
PATH = np.stack([np.linspace(0.0, 30.0, 31), np.zeros(31), np.zeros(31)], axis=1)
XY = np.array([[10.0, 2.0], [10.05, 2.0], [20.0, 2.0]])


def observed(*frames):
    """The first two landmarks in these frames, the third one in every frame in which it is in range."""
    third = np.flatnonzero(np.abs(PATH[:, 0] - XY[2, 0]) < 9.0)
    frame = np.concatenate([*frames, third])
    number = np.repeat(np.arange(3), [*map(len, frames), len(third)])
    order = np.argsort(frame, kind="stable")
    frame, number = frame[order], number[order]
    z = XY[number] - PATH[frame, :2] + (NOISE * np.random.default_rng(0).standard_normal((len(frame), 2)))
    return Observations(frame, z, np.tile(NOISE**2 * np.eye(2), (len(frame), 1, 1))), number


def found(*frames, xy=XY):
    seen, number = observed(*(np.array(f) for f in frames))
    return whole_log.same_landmarks(SENSOR, PATH, LandmarkMap(np.arange(3), xy), seen, number)


def test_what_is_observed_as_one_or_the_other_is_one():
    assert found(range(2, 18, 2), range(3, 18, 2)) == [(1, 0)]


def test_what_is_observed_together_is_two():
    assert found(range(2, 18), range(2, 18)) == []
    assert found(range(2, 18), range(2, 18, 4)) == []


def test_once_together_by_chance_among_many_frames_is_one():
    assert found(range(2, 18, 2), [2, *range(3, 18, 2)]) == [(1, 0)]


def test_what_is_farther_apart_than_the_noise_is_two():
    apart = XY + np.array([[0.0, 0.0], [6.0 * NOISE, 0.0], [0.0, 0.0]])
    assert found(range(2, 18, 2), range(3, 18, 2), xy=apart) == []


def test_the_odds_are_those_of_frames_at_different_places():
    r, chance = constants.SAME_DETECTED, constants.SAME_CHANCE
    both = r**2 / (1.0 - (1.0 - r) ** 2)
    one, other = np.array([1, 2, 3, 4]), np.array([4, 5])
    expected = 4 * -math.log(1.0 - both) + math.log(chance / both)
    assert whole_log.log_odds(one, other, PATH, 0.5) == pytest.approx(expected)
    assert whole_log.log_odds(one, other, np.zeros((6, 3)), 0.5) == pytest.approx(
        -math.log(1.0 - both) + math.log(chance / both)
    )
