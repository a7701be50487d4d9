"""Shape and geometry of a found picture: what is accepted, and how exact it is."""

from __future__ import annotations

import numpy as np
import pytest

import wings.camera.checks as checks
import wings.camera.features as features
from tests.wings.camera.wall import CENTRE, FOCAL, HEIGHT, WIDTH, wall

# --- shape ------------------------------------------------------------------------------------------------------------


SIZE = (400, 500)


SHAPES = {
    "as it hangs": ([[100, 100], [300, 110], [290, 250], [105, 240]], None),
    "upside down": ([[300, 250], [100, 250], [100, 100], [300, 100]], None),
    "mirrored": ([[300, 100], [100, 100], [100, 250], [300, 250]], checks.MIRRORED),
    "crossed": ([[100, 100], [300, 100], [100, 250], [300, 250]], checks.NOT_CONVEX),
    "one corner inside": ([[100, 100], [300, 100], [150, 140], [100, 250]], checks.NOT_CONVEX),
    "tiny": ([[100, 100], [115, 100], [115, 112], [100, 112]], checks.IMPLAUSIBLE_SHAPE),
    "a sliver": ([[100, 100], [130, 100], [130, 300], [100, 300]], checks.IMPLAUSIBLE_SHAPE),
    "a triangle": ([[190, 100], [210, 100], [300, 250], [100, 250]], checks.IMPLAUSIBLE_SHAPE),
    "a kite": ([[100, 200], [260, 150], [420, 200], [260, 210]], checks.IMPLAUSIBLE_SHAPE),
    "cut off": ([[-20, 100], [180, 100], [180, 250], [-20, 250]], checks.OUTSIDE),
    "below the frame": ([[100, 300], [300, 300], [300, 420], [100, 420]], checks.OUTSIDE),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_quadrilateral_is_judged_by_its_shape(name):
    pixels, expected = SHAPES[name]
    assert checks.shape_fault(np.array(pixels, float), SIZE, 0.8) == expected


def test_overlap_is_the_share_of_the_smaller_one():
    square = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
    assert checks.overlap(square, square + [5.0, 0.0]) == pytest.approx(0.5)
    assert checks.overlap(square, 0.5 * square + 1.0) == pytest.approx(1.0)
    assert checks.overlap(square, square + [20.0, 0.0]) == 0.0


# --- geometry ---------------------------------------------------------------------------------------------------------


def test_the_camera_is_read_off_its_stereo_points():
    camera = checks.pinhole(wall().xyz)
    pixels = np.array([[0.0, 0], [639, 479], [12.5, 300]])
    np.testing.assert_allclose(camera[:, 0] * pixels + camera[:, 1], (pixels - CENTRE) / FOCAL, atol=1e-6)
    assert checks.pinhole(np.full((HEIGHT, WIDTH, 3), np.nan, np.float32)) is None


def test_a_third_of_wrong_depths_does_not_move_the_plane():
    rng = np.random.default_rng(8)
    pixels = rng.uniform(100, 300, (600, 2))
    plane = np.array([4e-4, -2e-4, 0.4])
    depth = 1 / (pixels @ plane[:2] + plane[2])
    depth[:200] *= rng.uniform(1.3, 2.0, 200)
    np.testing.assert_allclose(checks.fit_plane(pixels, depth), plane, rtol=1e-6)


def test_refinement_finds_the_exact_homography_despite_wrong_pairs():
    rng = np.random.default_rng(2)
    truth = np.array([[0.5, 0.05, 120.0], [-0.03, 0.45, 90.0], [2e-4, -1e-4, 1.0]])
    place = rng.uniform(0, 480, (60, 2))
    source = features.Features(place, np.full(60, 3.0), np.zeros((60, 128), np.float32))
    seen = features.project(truth, place)
    seen[:10] += 8.0
    target = features.Features(seen, np.full(60, 1.5), source.descriptor)
    start = truth + np.array([[0, 0, 0.5], [0, 0, -0.5], [0, 0, 0]])
    fit = features.refine(start, source, target)
    np.testing.assert_allclose(fit.H, truth, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(fit.inlier, np.arange(60) >= 10)


def test_the_stated_uncertainty_of_corners_is_their_scatter():
    rng = np.random.default_rng(4)
    truth = np.array([[0.5, 0.05, 120.0], [-0.03, 0.45, 90.0], [2e-4, -1e-4, 1.0]])
    place, scale = rng.uniform(150, 480, (40, 2)), np.full(40, 4.0)
    corners = np.array([[0.0, 0.0], [480, 360]])
    source = features.Features(place, scale, np.zeros((40, 128), np.float32))
    sigma = 0.1 * np.hypot(2.0, features.magnification(truth, place) * 4.0)
    errors, stated = [], []
    for _ in range(300):
        seen = features.project(truth, place) + rng.normal(size=(40, 2)) * np.maximum(sigma, 0.25)[:, None]
        fit = features.refine(truth, source, features.Features(seen, np.full(40, 2.0), source.descriptor))
        pixels = features.project(fit.H, corners)
        errors.append(pixels - features.project(truth, corners))
        stated.append(features.corner_sigma(fit, corners, pixels))
    scatter = [np.sqrt(np.linalg.eigvalsh(np.cov(np.array(errors)[:, i].T))[-1]) for i in range(2)]
    np.testing.assert_allclose(np.mean(stated, axis=0), scatter, rtol=0.2)
    assert scatter[0] > 2 * scatter[1], "the corner beyond the features is the uncertain one"
