"""The floor: decisions of `jcbb` replace those in hindsight where all observations are more probable with them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from data.inputs import LandmarkMap, Observations
from data.notice import Code
from data.result import CHI_SQUARE, DISCARD
from data.sensors import RelativePoint
from data.worlds.registry import named_log
from eval.referee.confusion import confuse
from eval.replay.hindsight import constants, whole_log
from eval.replay.hindsight.final_association import Reassociation
from eval.replay.hindsight.opportunities import evidence
from eval.replay.hindsight.whole_log import Smoothed, likelier, log_likelihood, observed_again, plain, renumbered
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from graph.problem import Start

VIEW = RelativePoint(max_range=10.0, min_angle=-1.0, max_angle=1.0)
SIGMA = 0.1
SEEN = b"\3\3"
"""Detected twice from familiar viewpoints, after the first time."""


def decided(number, z, xy, looks=None, motion=0.0, share=1.0):
    """Observations z (m, 2) of landmarks at xy, one a frame, from the origin."""
    m, number = len(z), np.array(number)
    seen = Observations(np.arange(m), np.asarray(z, float), np.tile(SIGMA**2 * np.eye(2), (m, 1, 1)))
    ids = np.arange(len(xy))
    found = Reassociation(number, np.ones(m, np.bool_))
    known = LandmarkMap(ids, np.asarray(xy, float))
    return Smoothed(
        VIEW,
        np.zeros((m, 3)),
        known,
        seen,
        found,
        share,
        motion,
        looks or dict.fromkeys(ids.tolist(), SEEN),
        Start(np.zeros((m, 3)), known.xy),
        CHI_SQUARE,
    )


Z = [[5.0, 0.1], [5.1, 0.0], [4.95, -0.05], [7.0, 2.0]]


def test_the_likelihood_is_that_of_observations_with_the_position_integrated_out():
    s = decided([0, 0, 0, -1], Z, [np.mean(Z[:3], axis=0)])
    clutter = 2.0 / (2.0 * 10.0**2)
    # the marginal of three observations of a point anywhere: by integration on a grid
    grid = np.arange(-0.6, 0.6, 0.01)
    at = np.stack(np.meshgrid(5.0 + grid, grid), axis=-1)
    product = np.prod([multivariate_normal(z, SIGMA**2 * np.eye(2)).pdf(at) for z in Z[:3]], axis=0)
    integrated = clutter * product.sum() * 0.01**2
    expected = math.log(integrated) - 3.0 * math.log(clutter) + evidence([SEEN])[0]
    assert log_likelihood(s, 1.0, VIEW) == pytest.approx(expected, abs=1e-3)


def test_a_landmark_that_explains_less_than_clutter_does_counts_as_clutter():
    far = decided([0, 0, 0, -1], Z, [[9.0, 0.0]])
    assert log_likelihood(far, 1.0, VIEW) == 0.0
    once = decided([0, -1, -1, -1], Z, [Z[0]])
    assert log_likelihood(once, 1.0, VIEW) == 0.0


def test_odometry_and_missed_detections_speak_against_decisions():
    number, xy = [0, 0, 0, -1], [np.mean(Z[:3], axis=0)]
    plain_ = log_likelihood(decided(number, Z, xy), 1.0, VIEW)
    assert log_likelihood(decided(number, Z, xy, motion=8.0), 1.0, VIEW) == pytest.approx(plain_ - 4.0)
    missed = {0: b"\3\3" + b"\2\3" * 4}
    assert log_likelihood(decided(number, Z, xy, looks=missed), 1.0, VIEW) < plain_


def test_two_sets_are_compared_under_the_smaller_noise():
    number, xy = [0, 0, 0, -1], [np.mean(Z[:3], axis=0)]
    ours, theirs = decided(number, Z, xy, share=4.0), decided([0, 0, -1, -1], Z, xy, share=1.0)
    odds = log_likelihood(theirs, 1.0, VIEW) - log_likelihood(ours, 1.0, VIEW)
    assert likelier(ours, theirs, VIEW) == pytest.approx(odds)
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
    assert log_likelihood(both, 1.0, VIEW) == pytest.approx(log_likelihood(one, 1.0, VIEW))


def test_landmarks_get_the_numbers_of_those_with_most_observations_in_common():
    found = Reassociation(np.array([0, 0, 0, 1, 1, 2, -1]), np.ones(7, np.bool_))
    held = np.array([7, 7, 4, 7, 4, DISCARD, 4])
    assert renumbered(found, held).number.tolist() == [7, 7, 7, 4, 4, -1, -1]
    assert renumbered(found, np.full(7, DISCARD)).number.tolist() == [-1] * 7


def test_what_was_observed_once_is_no_landmark():
    assert observed_again(np.array([3, 1, 3, -1])).tolist() == [3, DISCARD, 3, DISCARD]


def test_plain_decisions_are_those_of_jcbb():
    inputs = named_log("arena:2:frames=60+clutter=0.5").inputs(labels=False).without_map()
    run = step_by_step("ekf", inputs, "slam", "jcbb")
    frames = [inputs.frame(k) for k in range(len(inputs))]
    found = plain(inputs, Setup(), frames, 1000)
    assert found is not None
    assert plain(inputs, Setup(), frames, int(run.created.max())) is None, "more landmarks than are allowed"
    assert np.array_equal(found.number, np.where(run.created >= 0, run.created, run.decisions))
    np.testing.assert_allclose(found.path, run.online.pose, atol=1e-9)


@pytest.mark.slow
def test_where_they_are_likelier_the_decisions_of_jcbb_are_the_final_ones_and_it_is_said(monkeypatch):
    log = named_log("arena:2:frames=60")
    inputs = log.inputs(labels=False).without_map()
    usual = step_by_step("ekf", inputs, "slam", "jcbb-hindsight")
    assert Code.PLAIN_LIKELIER not in [n.code for n in usual.notes]
    monkeypatch.setattr(whole_log, "likelier", lambda *_: 2.0 * constants.PLAIN_ODDS)
    monkeypatch.setattr(Smoothed, "consistent", False)
    run = step_by_step("ekf", inputs, "slam", "jcbb-hindsight")
    (note,) = [n for n in run.notes if n.code is Code.PLAIN_LIKELIER]
    assert note.named == {"odds": 2.0 * constants.PLAIN_ODDS}
    o, who = log.recorded.observations, log.truth.landmark_of
    assert confuse(o.frame, who, run.final_decisions, run.initialized, None, run.removed).fp == 0
    assert np.array_equal(run.decisions, usual.decisions)
    assert set(run.final_decisions[run.final_decisions >= 0].tolist()) <= set(run.map.number.tolist())
