"""Outcomes of loop closures and NEES of relative poses, counted by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.se2 import between, inverse, transform_points
from wings.laser.scans.constraints import Chain, Loops
from wings.laser.score import (
    ClosureCounts,
    chain_squares,
    count_closures,
    fits,
    loop_squares,
    revisits,
)

TRUTH = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 1.5], [4.0, 4.0, 3.0], [0.0, 4.0, -1.6], [0.5, 0.0, 0.1]])


def loops(errors, believed, sigma=0.01):
    """Loop closures 0-4 with these errors (L, 3)."""
    n = len(errors)
    relative = between(TRUTH[[0] * n], TRUTH[[4] * n]) + np.array(errors)
    C = np.tile(np.diag(np.broadcast_to(sigma, 3) ** 2), (n, 1, 1))
    zero = np.zeros(n, np.int64)
    return Loops(zero, zero + 4, relative, C, np.ones(n), np.array(believed))


def test_four_kinds():
    near, far = [0.1, 0.0, 0.0], [1.0, 0.0, 0.0]
    counts = count_closures(loops([near, near, far, far, far, [0.0, 0.0, 6.28]], [4, -1, 4, -1, -1, 4]), TRUTH)
    assert (counts.tp, counts.fn, counts.fp, counts.tn) == (2, 1, 1, 2)
    assert counts.precision == counts.recall_of_found == pytest.approx(2 / 3)
    assert math.isnan(counts.recall)


def test_a_rejected_closure_is_missed_only_where_the_scans_overlap():
    near = [0.1, 0.0, 0.0]
    wall = np.stack([np.linspace(-3.0, 3.0, 60), np.full(60, 2.0)], 1)
    elsewhere = wall + [0.0, 5.0]
    seen = [wall] * 4 + [transform_points(inverse(TRUTH[4]), wall)]
    apart = [wall] * 4 + [transform_points(inverse(TRUTH[4]), elsewhere)]
    for points, missed in ((seen, 1), (apart, 0)):
        counts = count_closures(loops([near, near], [4, -1]), TRUTH, points=points)
        assert (counts.tp, counts.fp, counts.fn, counts.tn) == (1, 0, missed, 1 - missed)


def test_nothing_believed_has_no_precision_and_counts_add_up():
    none = count_closures(loops([[0.0, 0.0, 0.0]], [-1]), TRUTH)
    assert math.isnan(none.precision)
    assert none.recall_of_found == 0.0
    assert ClosureCounts(1, 2, 3, 4, 5, 3) + ClosureCounts(1, 0, 0, 0, 5, 5) == ClosureCounts(2, 2, 3, 4, 10, 8)
    assert ClosureCounts(0, 0, 0, 0, 10, 8).recall == 0.8


def square_room(pose):
    """Points (P, 2) of the walls of a room 8 m wide around (2, 2), in the frame of a pose."""
    side = np.linspace(-4.0, 4.0, 161)
    walls = [np.stack(w, 1) for w in ((side, 0 * side + 4), (side, 0 * side - 3.9), (0 * side - 4.1, side))]
    return transform_points(inverse(pose), np.concatenate(walls) + 2.0)


def test_a_revisit_is_near_later_and_overlaps():
    seen = [square_room(pose) for pose in TRUTH]
    assert revisits(TRUTH, seen).tolist() == [False, False, False, False, True]
    seen[4] = seen[4] + 0.5  # walls that stand elsewhere
    assert not revisits(TRUTH, seen).any()
    away = TRUTH.copy()
    away[4, 1] = -3.0
    assert not revisits(away, [square_room(pose) for pose in away]).any()
    turned = TRUTH[[0, 0, 4]]
    assert not revisits(turned, [square_room(pose) for pose in turned]).any()


def test_scans_overlap_only_if_each_matches_the_other():
    wall = np.stack([np.linspace(0, 5, 101), np.ones(101)], 1)
    both = np.concatenate([wall, wall + [0.0, 3.0], wall - [0.0, 4.0]])
    assert fits(wall, wall, np.zeros(3))
    assert not fits(wall, both, np.zeros(3))
    assert not fits(both, wall, np.zeros(3))
    assert not fits(wall, np.empty((0, 2)), np.zeros(3))


def test_a_possible_revisit_is_closed_by_a_right_and_believed_loop_closure_of_its_key_pose_alone():
    possible = np.array([False, False, False, True, True])
    right, wrong = [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]
    for errors, believed, closed in (
        ([right], [4], 1),
        ([right], [-1], 0),
        ([wrong], [4], 0),
        ([right] * 2, [4, 4], 1),
    ):
        counts = count_closures(loops(errors, believed), TRUTH, possible)
        assert (counts.possible, counts.closed) == (2, closed)


def test_nees_of_honest_factors_is_one_and_that_of_sigmas_at_half_is_four():
    rng = np.random.default_rng(0)
    keys, sigma = 400, np.array([0.03, 0.02, 0.01])
    truth = np.cumsum(rng.normal(0, 1, (keys, 3)), 0)
    motion = np.zeros((keys, 3))
    motion[1:] = between(truth[:-1], truth[1:]) + rng.normal(0, sigma, (keys - 1, 3))
    C = np.tile(np.diag(sigma**2), (keys, 1, 1))
    zero = np.zeros(keys, np.int64)

    for scale in (1.0, 0.25):
        squares = chain_squares(Chain(np.arange(keys), motion, scale * C, zero, motion, C), truth)
        assert len(squares) == keys - 1
        assert (scale * squares / 3).mean() == pytest.approx(1.0, abs=0.13)  # three standard deviations


def test_nees_of_loop_closures_is_that_of_the_believed_ones():
    some = loops([[0.02, 0.0, 0.0], [0.0, 0.03, 0.0], [9.0, 0.0, 0.0]], [4, -1, 4])
    np.testing.assert_allclose(loop_squares(some, TRUTH), [4.0, 810000.0])
