"""Outcomes of loop closures, counted by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.se2 import between, inverse, transform_points
from wings.laser.scans.constraints import Loops
from wings.laser.score import count_closures, fits

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


def test_a_rejected_closure_is_missed_only_where_the_scans_overlap():
    near = [0.1, 0.0, 0.0]
    wall = np.stack([np.linspace(-3.0, 3.0, 60), np.full(60, 2.0)], 1)
    elsewhere = wall + [0.0, 5.0]
    seen = [wall] * 4 + [transform_points(inverse(TRUTH[4]), wall)]
    apart = [wall] * 4 + [transform_points(inverse(TRUTH[4]), elsewhere)]
    for points, missed in ((seen, 1), (apart, 0)):
        counts = count_closures(loops([near, near], [4, -1]), TRUTH, points=points)
        assert (counts.tp, counts.fp, counts.fn, counts.tn) == (1, 0, missed, 1 - missed)


def test_nothing_believed_has_no_precision():
    none = count_closures(loops([[0.0, 0.0, 0.0]], [-1]), TRUTH)
    assert math.isnan(none.precision)
    assert none.recall_of_found == 0.0


def test_scans_overlap_only_if_each_matches_the_other():
    wall = np.stack([np.linspace(0, 5, 101), np.ones(101)], 1)
    both = np.concatenate([wall, wall + [0.0, 3.0], wall - [0.0, 4.0]])
    assert fits(wall, wall, np.zeros(3))
    assert not fits(wall, both, np.zeros(3))
    assert not fits(both, wall, np.zeros(3))
    assert not fits(wall, np.empty((0, 2)), np.zeros(3))
