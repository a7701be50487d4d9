"""Rendered stereo points tell the story of the truth; noise and holes are as stated."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.wings.camera.rendering.galleries import CLEAN, SMALL_CLEAN, true_pixels, views
from wings.camera.gallery import Gallery
from wings.camera.rendering.render import Rendered, smeared_noise, stereo_points


def bilinear(values: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """Values (3,) between the four pixels around (u, v)."""
    u, v = np.floor(pixel).astype(int)
    a, b = pixel - [u, v]
    rows = (1 - b) * values[v, u : u + 2] + b * values[v + 1, u : u + 2]
    return (1 - a) * rows[0] + a * rows[1]


class TestStereoIsTrueToTheGeometry:
    @pytest.mark.slow
    def test_every_depth_is_where_the_ray_meets_the_nearest_surface(self, clean):
        rng = np.random.default_rng(0)
        g, low, high = CLEAN, np.array([-3.5, -2.6, 0.0]), np.array([3.5, 2.6, 2.6])
        for k in range(0, len(clean), 24):
            xyz = clean.frame(k).xyz
            assert np.isfinite(xyz).all()
            x, y, t = clean.scene.pose[k]
            eye = np.array([x + math.cos(t) * g.camera_x - math.sin(t) * g.camera_y,
                            y + math.sin(t) * g.camera_x + math.cos(t) * g.camera_y, g.camera_height])  # fmt: skip
            a = t + g.camera_yaw
            axes = np.array([[math.sin(a), -math.cos(a), 0], [0, 0, -1], [math.cos(a), math.sin(a), 0]])
            for u, v in rng.integers([0, 0], [640, 480], (100, 2)):
                ray = np.array([(u - 319.5) / g.focal, (v - 239.5) / g.focal, 1.0]) @ axes
                z = min((high[i] if ray[i] > 0 else low[i]) - eye[i] for i in [0]) / ray[0] if ray[0] else math.inf
                for i in (1, 2):
                    z = min(z, ((high[i] if ray[i] > 0 else low[i]) - eye[i]) / ray[i])
                expected = z * np.array([(u - 319.5) / g.focal, (v - 239.5) / g.focal, 1.0])
                assert np.allclose(xyz[v, u], expected, atol=2e-5)

    def test_the_point_at_a_corner_lands_on_the_map(self, clean):
        checked = 0
        rotation, T = clean.setup.rotation, np.array(clean.setup.translation)
        R = np.array([[math.cos(rotation), -math.sin(rotation)], [math.sin(rotation), math.cos(rotation)]])
        for k, number in views(clean):
            xyz, (x, y, t) = clean.frame(k).xyz, clean.scene.pose[k]
            for corner, pixel in enumerate(true_pixels(clean, k)[number]):
                p = bilinear(xyz, pixel)
                body = R.T @ (p[[0, 2]] - T)
                world = np.array([x, y]) + [[math.cos(t), -math.sin(t)], [math.sin(t), math.cos(t)]] @ body
                assert np.allclose(world, clean.setup.corners[number, corner], atol=1e-4)
                height = clean.scene.corners[number, corner, 2]
                assert CLEAN.camera_height - p[1] == pytest.approx(height, abs=1e-4)
                checked += 1
        assert checked == 96

    @pytest.mark.slow
    def test_with_noise_the_corner_errs_by_the_noise_of_stereo(self):
        g = replace(CLEAN, disparity_noise=0.25, reference_width=120)
        noisy, score = Rendered(g, 0), []
        for k, number in views(noisy, 4):
            xyz = noisy.frame(k).xyz
            for sight in noisy.in_view(k):
                if sight.picture == number:
                    for pixel, point in zip(np.rint(sight.pixels).astype(int), sight.points):
                        z = xyz[pixel[1], pixel[0], 2]
                        score.append((z - point[2]) * g.focal * g.baseline / (point[2] ** 2 * g.disparity_noise))
        # half a pixel along an oblique wall adds some millimetres
        assert abs(np.mean(score)) < 4.5 / math.sqrt(len(score))
        assert np.std(score) == pytest.approx(1.0, abs=4.5 / math.sqrt(2 * len(score)))


class TestStereoNoise:
    def points(self, g: Gallery, depth: float, seed: int = 0) -> np.ndarray:
        rng = np.random.default_rng(seed)
        flat = np.full((g.image_height, g.image_width), depth, np.float32)
        rgb = np.zeros((*flat.shape, 3), np.uint8)
        return stereo_points(g, flat, rgb, [], rng, rng).astype(float)

    @pytest.mark.parametrize("depth", [1.0, 2.0, 3.0])
    def test_depth_noise_grows_with_the_square_of_the_depth(self, depth):
        z = self.points(replace(CLEAN, disparity_noise=0.25), depth)[:, :, 2]
        assert z.std() == pytest.approx(depth**2 * 0.25 / (CLEAN.focal * CLEAN.baseline), rel=0.03)
        assert z.mean() == pytest.approx(depth, rel=2e-3)

    def test_points_err_along_their_rays(self):
        p = self.points(replace(CLEAN, disparity_noise=0.25), 2.0)
        u, v = np.meshgrid(np.arange(640), np.arange(480))
        assert np.allclose(p[:, :, 0] / p[:, :, 2], (u - 319.5) / CLEAN.focal, atol=1e-6)
        assert np.allclose(p[:, :, 1] / p[:, :, 2], (v - 239.5) / CLEAN.focal, atol=1e-6)

    def test_disparities_are_whole_steps(self):
        p = self.points(replace(CLEAN, disparity_noise=0.3, disparity_step=0.125), 2.5)
        steps = CLEAN.focal * CLEAN.baseline / p[:, :, 2] / 0.125
        assert np.abs(steps - np.rint(steps)).max() < 1e-3
        assert len(np.unique(np.rint(steps))) > 5

    @pytest.mark.parametrize("smear", [0.0, 0.4, 1.5, 4.0])
    def test_the_noise_has_variance_one_everywhere_and_is_shared_by_neighbours(self, smear):
        noise = np.array([smeared_noise((60, 80), smear, np.random.default_rng(i)) for i in range(300)])
        assert noise.std() == pytest.approx(1.0, abs=0.03)
        assert noise[:, 0, :].std() == pytest.approx(1.0, abs=0.06)
        assert noise[:, :, -1].std() == pytest.approx(1.0, abs=0.06)
        shared = np.mean(noise[:, :, 1:] * noise[:, :, :-1]) / noise.var()
        # correlation of white noise seen through a Gaussian, one pixel apart
        assert shared == pytest.approx(math.exp(-0.25 / smear**2) if smear > 1 else shared, abs=0.01)
        assert (shared > 0.05) == (smear > 0)

    def test_a_disparity_below_zero_is_no_point(self):
        z = self.points(replace(CLEAN, disparity_noise=5.0), 20.0)[:, :, 2]
        assert np.isnan(z).any()
        assert np.nanmin(z) > 0


class TestHoles:
    def share(self, **options: float) -> float:
        return float(np.isnan(Rendered(replace(SMALL_CLEAN, **options), 1).frame(5).xyz[:, :, 2]).mean())

    @pytest.mark.slow
    def test_each_kind_of_hole_can_be_turned_on_by_itself(self):
        assert self.share() == 0.0
        assert 0.002 < self.share(patches=6) < 0.25
        assert 0.001 < self.share(edge_hole=1) < 0.05
        assert self.share(edge_hole=3) > 1.5 * self.share(edge_hole=1)
        assert 0.05 < self.share(least_texture=0.6) < 0.95
        assert self.share(least_texture=200.0) > 0.98

    @pytest.mark.slow
    def test_the_outline_of_a_picture_has_no_depth_and_its_inside_has(self, default):
        filled = []
        for k, number in views(default):
            z = default.frame(k).xyz[:, :, 2]
            corners = true_pixels(default, k)[number]
            for pixel in np.rint(corners).astype(int):
                assert np.isnan(z[pixel[1], pixel[0]])
            inside = np.zeros(z.shape, np.uint8)
            middle = corners.mean(axis=0)
            cv2.fillConvexPoly(inside, np.rint(middle + 0.9 * (corners - middle)).astype(np.int32), 1)
            filled.append(np.isfinite(z[inside > 0]).mean())
        assert np.mean(filled) > 0.9
