"""Points of a scan, their nearest neighbours, and point-to-line matching."""

import math
from dataclasses import replace

import numpy as np
import pytest

from data.se2 import Array, compose, transform_points
from tests.wings.laser.scans.rooms import CORRIDOR, ROOM, SCANNER, scan
from wings.laser.scans.matching import MotionPrior, NearestGrid, match
from wings.laser.scans.points import beams_of, scan_points

WEAK = np.diag([1.0, 1.0, 1.0])


def _reference(walls: Array, pose: Array):  # type: ignore[no-untyped-def]
    points = scan_points(scan(pose, walls), beams_of(SCANNER, 180), 25.0)
    return NearestGrid(30.0).reference(points.xy, points.normal)


def _off_walls(xy: Array, walls: Array) -> Array:
    a, b = walls[None, :, :2], walls[None, :, 2:]
    t = np.clip(((xy[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + t[..., None] * (b - a) - xy[:, None], axis=-1).min(axis=1), float)


@pytest.mark.parametrize("mounting", [(0.0, (0.0, 0.0)), (0.7, (0.3, -0.2))])
def test_points_lie_on_walls_and_their_normals_face_the_scanner(mounting: tuple[float, tuple[float, float]]) -> None:
    scanner = replace(SCANNER, rotation=mounting[0], translation=mounting[1])
    pose = np.array([0.5, 0.3, 0.4])
    beams = beams_of(scanner, 180)
    points = scan_points(scan(pose, ROOM, scanner), beams, 25.0)
    assert len(points.xy) > 140
    off = _off_walls(transform_points(pose, points.xy), ROOM)
    # a run of neighbours that goes around a corner is cut short there, by as much as counts as flat
    assert np.quantile(off, 0.9) < 1e-9
    assert off.max() < 0.05
    np.testing.assert_allclose(np.linalg.norm(points.normal, axis=1), 1.0)
    assert (((beams.origin - points.xy) * points.normal).sum(axis=1) > 0.0).all()


def test_grid_gives_the_nearest_point_of_each_cell_also_when_used_again() -> None:
    rng = np.random.default_rng(3)
    grid = NearestGrid(2.0)
    for _ in range(2):
        xy = rng.uniform(-2.2, 2.2, (60, 2))
        found = grid.reference(xy, xy)
        cells = rng.integers(0, len(found.nearest), (400, 2))
        distance = np.linalg.norm((cells + 0.5)[:, None] * 0.05 - found.half - xy[None], axis=-1)
        expected = np.where(distance.min(axis=1) <= 0.3, distance.argmin(axis=1), -1)
        clear = np.abs(distance.min(axis=1) - 0.3) > 1e-6
        np.testing.assert_array_equal(found.nearest[cells[:, 0], cells[:, 1]][clear], expected[clear])


def test_match_finds_the_motion_that_was_made() -> None:
    first, motion = np.array([0.2, 0.1, 0.3]), np.array([0.25, -0.1, 0.12])
    points = scan_points(scan(compose(first, motion), ROOM), beams_of(SCANNER, 180), 25.0)
    found = match(points, _reference(ROOM, first), np.zeros(3), MotionPrior(np.zeros(3), WEAK), 0.01, 1e3)
    np.testing.assert_allclose(found.pose, motion, atol=2e-3)
    assert found.share > 0.8
    assert found.cost < 0.2


def test_covariance_is_long_along_a_corridor_and_is_what_repeated_scans_scatter_by() -> None:
    rng = np.random.default_rng(1)
    turn = 0.6
    pose = np.array([0.0, 0.1, turn])
    reference = _reference(CORRIDOR, pose)
    prior = MotionPrior(np.zeros(3), np.diag([1.0, 1.0, 1.0]))
    clean = scan(pose, CORRIDOR)
    across, found = [], None
    for _ in range(60):
        noisy = np.where(clean > 0.0, clean + 0.01 * rng.standard_normal(180), 0.0)
        found = match(scan_points(noisy, beams_of(SCANNER, 180), 25.0), reference, np.zeros(3), prior, 0.01, 1e3)
        across.append(found.pose[0] * math.sin(turn) + found.pose[1] * math.cos(turn))
    assert found is not None
    values, vectors = np.linalg.eigh(found.covariance[:2, :2])
    assert values[1] > 1e3 * values[0]
    assert abs(vectors[0, 1] * math.sin(turn) + vectors[1, 1] * math.cos(turn)) < 0.01
    # the points' share of their neighbours' noise (they lie on fitted lines) makes them less independent than assumed
    assert 0.4 < float(np.std(across)) / math.sqrt(values[0]) < 2.0
