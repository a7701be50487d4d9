"""Landmarks that may be the same as a neighbour."""

from dataclasses import replace

import numpy as np
import pytest

from data.result import MapEstimate
from data.worlds.arena import Arena, simulate
from eval.referee.ambiguity import NONE, ambiguous, neighbours, variance_of
from eval.replay.run import compare


def map_of(xy, sigma=0.02, number=None):
    xy = np.asarray(xy, float)
    n = np.arange(len(xy)) if number is None else np.asarray(number)
    return MapEstimate(n, xy, np.tile(sigma**2 * np.eye(2), (len(xy), 1, 1)), np.zeros(len(xy)), np.ones(len(xy)))


def found(m, number, frame, sigma=0.1):
    return neighbours(m, np.full(len(m), sigma**2), np.array(number), np.array(frame)).tolist()


def test_two_inside_the_noise_without_a_common_frame_are_ambiguous():
    assert found(map_of([[0.0, 0.0], [0.18, 0.0]]), [0, 1, 0], [0, 1, 2]) == [1, 0]
    assert found(map_of([[0.0, 0.0], [0.18, 0.0]]), [0, 1, 0], [0, 0, 2]) == [NONE, NONE]
    m = map_of([[0.0, 0.0], [0.2, 0.0], [0.1, 0.0]], number=[3, 5, 9])
    assert found(m, [3, 5, 9], [0, 1, 2]) == [9, 9, 3] or found(m, [3, 5, 9], [0, 1, 2]) == [9, 9, 5]
    m = map_of([[0.0, 0.0], [2.0, 0.0], [9.0, 0.0]])
    wide = replace(m, covariance=m.covariance * np.array([1.0, 2500.0, 1.0])[:, None, None])
    assert found(m, [0, 1, 2], [0, 1, 2]) == [NONE] * 3
    assert found(wide, [0, 1, 2], [0, 1, 2]) == [1, 0, NONE]
    m = map_of([[0.0, 0.0], [5.0, 0.0]], number=[2, 4])
    assert variance_of(m, np.array([2, 2, 7]), np.array([1.0, 3.0, 9.0])).tolist() == [2.0, 0.0]


@pytest.mark.parametrize(("apart", "distinct"), [(0.309, False), (0.317, True)])
def test_the_gate_is_that_of_both_covariances_and_an_observation(apart, distinct):
    # sqrt(9.21 (2 * 0.02^2 + 0.1^2)) = 0.315; without the covariances 0.303
    assert (found(map_of([[0.0, 0.0], [apart, 0.0]]), [0, 1], [0, 1]) == [NONE, NONE]) is distinct


def test_nothing_is_ambiguous_with_labels_or_for_other_inputs():
    log = simulate(Arena(frames=60), 0)
    (run,) = compare(log.inputs(labels=True), "slam", ["ekf"])
    assert (ambiguous(run, log.recorded) == NONE).all()
    assert len(ambiguous(run, log.recorded)) == len(run.map)
    twin = replace(run.map, xy=run.map.xy * 0.0)
    assert (ambiguous(replace(run, map=twin, walls=True), log.recorded) == NONE).all()
    assert (ambiguous(replace(run, map=twin), simulate(Arena(frames=59), 0).recorded) == NONE).all()
    assert len(ambiguous(replace(run, map=None), log.recorded)) == 0
