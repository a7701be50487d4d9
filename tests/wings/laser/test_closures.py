"""Outcomes of loop closures, counted by hand."""

import math
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from association.names import SCAN
from data.se2 import between, inverse, transform_points
from tests.eval.handmade import run_with_error
from wings.laser.scans.constraints import Chain, LaserRun, Loops
from wings.laser.score import closure_counts, fits, knowable

TRUTH = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 1.5], [4.0, 4.0, 3.0], [0.0, 4.0, -1.6], [0.5, 0.0, 0.1]])


def loops(errors, believed, sigma=0.01):
    """Loop closures 0-4 with these errors (L, 3)."""
    n = len(errors)
    relative = between(TRUTH[[0] * n], TRUTH[[4] * n]) + np.array(errors)
    C = np.tile(np.diag(np.broadcast_to(sigma, 3) ** 2), (n, 1, 1))
    zero = np.zeros(n, np.int64)
    return Loops(zero, zero + 4, relative, C, np.ones(n), np.array(believed))


def outcomes(found):
    made, zero = run_with_error(np.zeros(3), association=SCAN, mapped=False), np.zeros((5, 3))
    chain = Chain(np.arange(5), zero, np.zeros((5, 3, 3)), np.arange(5), zero, np.zeros((5, 3, 3)))
    run = LaserRun(**{f.name: getattr(made, f.name) for f in fields(made)}, chain=chain, loops=found)
    log = SimpleNamespace(truth=SimpleNamespace(pose=TRUTH), recorded=SimpleNamespace(scans=None))
    return closure_counts(run, log, "online")


def test_four_kinds():
    near, far = [0.1, 0.0, 0.0], [1.0, 0.0, 0.0]
    counts = outcomes(loops([near, near, far, far, far, [0.0, 0.0, 6.28]], [4, -1, 4, -1, -1, 4]))
    assert [counts[name] for name in ("tp", "fn", "fp", "tn")] == [2, 1, 1, 2]
    assert counts["precision"] == counts["recall"] == pytest.approx(2 / 3)
    none = outcomes(loops([[0.0, 0.0, 0.0]], [-1]))
    assert math.isnan(none["precision"])
    assert none["recall"] == 0.0


def test_a_closure_can_be_known_only_where_the_scans_overlap():
    wall = np.stack([np.linspace(-3.0, 3.0, 60), np.full(60, 2.0)], 1)
    for last, known in ((wall, True), (wall + [0.0, 5.0], False)):
        points = [wall] * 4 + [transform_points(inverse(TRUTH[4]), last)]
        assert knowable(loops([[0.0, 0.0, 0.0]], [-1]), TRUTH, points).tolist() == [known]


def test_scans_overlap_only_if_each_matches_the_other():
    wall = np.stack([np.linspace(0, 5, 101), np.ones(101)], 1)
    both = np.concatenate([wall, wall + [0.0, 3.0], wall - [0.0, 4.0]])
    assert fits(wall, wall, np.zeros(3))
    assert not fits(wall, both, np.zeros(3))
    assert not fits(both, wall, np.zeros(3))
    assert not fits(wall, np.empty((0, 2)), np.zeros(3))
