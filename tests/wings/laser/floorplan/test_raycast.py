"""Ray casting: ranges known on paper, and a beam-by-segment reference on scenes at random."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.inputs import Scanner
from data.se2 import compose, inverse
from wings.laser.floorplan.world import scan_ranges

ROUND = Scanner(-math.pi, math.radians(2.0), 20.0, 0.01)
SQUARE = np.array([[-2, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2]], float)


def reference(pose, scanner, beams, walls, discs):
    """Every beam against every wall as a 2 x 2 system, and against every disc as a quadratic."""
    x, y, theta = compose(pose, inverse(np.array([*scanner.translation, scanner.rotation])))
    ranges = np.full(beams, np.inf)
    for b in range(beams):
        angle = theta + scanner.angle_min + b * scanner.angle_step
        d, o = np.array([math.cos(angle), math.sin(angle)]), np.array([x, y])
        for w in walls:
            a, e = w[:2], w[2:] - w[:2]
            r, u = np.linalg.solve(np.stack([d, -e], 1), a - o)
            if r > 0 and 0 <= u <= 1:
                ranges[b] = min(ranges[b], r)
        for cx, cy, radius in discs:
            c = np.array([cx, cy]) - o
            roots = np.roots([1.0, -2.0 * d @ c, c @ c - radius**2])
            if np.isreal(roots).all() and roots.min() > 0:
                ranges[b] = min(ranges[b], roots.min())
    return np.where(ranges < scanner.max_range, ranges, np.inf)


@pytest.mark.parametrize("seed", range(2))
def test_the_nearest_of_all_that_a_beam_meets(seed):
    rng = np.random.default_rng(seed)
    walls = rng.uniform(-6, 6, (12, 4))
    discs = np.column_stack([rng.uniform(-6, 6, (3, 2)), rng.uniform(0.1, 0.5, 3)])
    poses = np.column_stack([rng.uniform(-3, 3, (3, 2)), rng.uniform(-9, 9, 3)])
    fan = Scanner(-2.0, 0.05, 3.0, 0.01, rotation=0.7, translation=(0.2, -0.1))
    for scanner, beams in ((ROUND, 180), (fan, 60)):
        found = scan_ranges(poses, scanner, beams, walls, discs=np.broadcast_to(discs, (3, 3, 3)))
        expected = [reference(p, scanner, beams, walls, discs) for p in poses]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.isinf(found).any()  # the second one's reach is short
    assert np.isfinite(found).any()


def test_glass_returns_nothing_and_hides_what_is_behind():
    ahead = Scanner(0.0, 0.1, 20.0, 0.01)
    walls = np.array([[1.0, -1, 1, 1], [2, -1, 2, 1]])
    at = np.zeros((1, 3))
    assert scan_ranges(at, ahead, 1, walls)[0, 0] == 1.0
    assert scan_ranges(at, ahead, 1, walls, glass=np.array([True, False]))[0, 0] == np.inf
    assert scan_ranges(at, ahead, 1, walls, glass=np.array([False, True]))[0, 0] == 1.0
    person = np.array([[[0.8, 0.0, 0.25]]])
    assert scan_ranges(at, ahead, 1, walls, glass=np.array([True, True]), discs=person)[0, 0] == pytest.approx(0.55)
