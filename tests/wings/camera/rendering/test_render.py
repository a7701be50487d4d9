"""Rendered frames and stereo points tell the story of the truth; light, lens, noise and holes are as stated."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from data.errors import UsageError
from tests.wings.camera.rendering import galleries
from wings.camera.gallery import Gallery, in_camera, to_pixels
from wings.camera.rendering.render import Rendered, sideways_motion, smeared_noise, stereo_points


def rectified(recording: Rendered, frame: int, number: int) -> np.ndarray:
    """A picture cut out of the image by its true corners, as large as its reference, grey."""
    h, w = recording.references[number].shape[:2]
    own = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    pixels = galleries.true_pixels(recording, frame)[number]
    H = cv2.getPerspectiveTransform(own.astype(np.float32), pixels.astype(np.float32))
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    cut = cv2.warpPerspective(recording.frame(frame).rgb, H, (w, h), flags=flags)
    return cv2.cvtColor(cut, cv2.COLOR_RGB2GRAY).astype(np.float32)


def soft(image: np.ndarray) -> np.ndarray:
    """A reference, grey, as soft as a picture that fills a third of its width."""
    return cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.6)


def shift(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """How far (dx, dy) px the content of b lies to the right of and below that of a (least squares, small shifts)."""
    slope = np.stack([np.gradient(a, axis=1).ravel(), np.gradient(a, axis=0).ravel()], axis=1)
    return -np.linalg.lstsq(slope, (b - a).ravel(), rcond=None)[0]


class TestImagesAreTrueToTheGeometry:
    @pytest.mark.parametrize("width", [96, 120])
    @pytest.mark.slow
    def test_a_picture_finer_than_the_image_is_averaged_and_neither_glitters_nor_blurs(self, width):
        small = replace(galleries.SMALL_CLEAN, image_width=width, image_height=width * 3 // 4, pictures=4)
        recording = Rendered(small, 0)
        seen = galleries.ends(recording)
        assert len(seen) == 8
        for k, number in seen:
            image, covered, colour = galleries.averaged(recording, k, number)
            whole = covered > 0.999
            beside = whole[:, 1:] & whole[:, :-1]
            drawn, wanted = (np.abs(np.diff(i, axis=1))[beside].mean() for i in (image, colour))
            assert 0.85 < drawn / wanted < 1.0
            assert np.sqrt(np.mean((image - colour)[whole] ** 2)) < 0.25 * colour[whole].std()

    def test_a_pixel_on_a_picture_s_edge_has_of_its_colour_the_share_that_is_covered(self):
        recording = Rendered(replace(galleries.SMALL_CLEAN, image_width=160, image_height=120, pictures=4), 0)
        checked = {0.9: 0, 0.5: 0}
        for k, number in galleries.ends(recording):
            image, covered, colour = galleries.averaged(recording, k, number)
            beside = (cv2.dilate((covered > 0.0).astype(np.uint8), np.ones((5, 5))) > 0) & (covered == 0.0)
            wall = np.median(image[beside], axis=0)
            assert wall.min() > 20.0
            h, w = covered.shape
            v, u = np.mgrid[:h, :w]
            for side in (u < w // 4, u > w - w // 4, v < h // 4, v > h - h // 4):
                # pixels that are covered in part, and those of them that are covered by less than a half
                for most, fewest in ((0.9, 35), (0.5, 15)):
                    at = side & (covered > 0.1) & (covered < most)
                    if at.sum() >= fewest:
                        wanted = covered[at][:, None] * (colour[at] - wall)
                        assert 0.6 < (wanted * (image[at] - wall)).sum() / (wanted**2).sum() < 1.4
                        checked[most] += 1
        assert checked[0.9] >= 20
        assert checked[0.5] >= 10

    @pytest.mark.slow
    def test_no_picture_is_off_by_a_tenth_of_a_pixel(self, clean):
        shifts = []
        for frame, number in galleries.views(clean):
            cut, reference = rectified(clean, frame, number), soft(clean.references[number])
            scale = np.linalg.norm(np.diff(galleries.true_pixels(clean, frame)[number][:2], axis=0)) / cut.shape[1]
            shifts.append(shift(reference, cut) * scale)
        assert np.abs(np.median(shifts, axis=0)).max() < 0.03
        assert np.abs(shifts).max() < 0.1

    def test_walls_beside_the_pictures_stay_plain(self, clean):
        k = next(k for k in range(len(clean)) if not galleries.visible(clean, k))
        grey = cv2.cvtColor(clean.frame(k).rgb, cv2.COLOR_RGB2GRAY)
        outside = np.ones_like(grey)
        for s in clean.projections(k):
            if np.isfinite(s.pixels).all():
                cv2.fillConvexPoly(outside, np.rint(s.pixels).astype(np.int32), 0)
        assert 0.1 < np.abs(np.diff(grey.astype(float), axis=1))[outside[:, 1:] > 0].mean() < 3.0


class TestLightAndLens:
    def light(self, **options: float) -> np.ndarray:
        """Gain, and grey level added to a middle grey, of six frames: (6, 2)."""
        lit, plain = Rendered(replace(galleries.SMALL_CLEAN, **options), 0), Rendered(galleries.SMALL_CLEAN, 0)
        found = []
        for k in range(6):
            a, b = plain.frame(k).rgb.astype(float).ravel(), lit.frame(k).rgb.astype(float).ravel()
            middle = (b > 0) & (b < 255)
            gain, offset = np.polyfit(a[middle], b[middle], 1)
            assert np.abs(gain * a + offset - b)[middle].max() < 1.5
            found.append([gain, offset + 127.5 * (gain - 1.0)])
        return np.array(found)

    @pytest.mark.slow
    def test_brightness_and_contrast_change_from_frame_to_frame_each_by_itself(self):
        gain, offset = self.light(brightness=20.0).T
        assert np.allclose(gain, 1.0, atol=0.01)
        assert 5.0 < offset.std() < 50.0
        gain, offset = self.light(contrast=0.2).T
        assert 0.05 < np.log(gain).std() < 0.5
        assert np.abs(offset).max() < 1.0

    def test_image_noise_has_the_stated_size(self):
        noisy, plain = Rendered(replace(galleries.SMALL_CLEAN, image_noise=3.0), 0), Rendered(galleries.SMALL_CLEAN, 0)
        a, b = (r.frame(0).rgb.astype(float) for r in (noisy, plain))
        middle = (b > 20) & (b < 235)
        assert (a - b)[middle].std() == pytest.approx(math.sqrt(9.0 + 1.0 / 12.0), rel=0.02)
        assert abs((a - b)[middle].mean()) < 0.05
        assert abs(np.corrcoef((a - b)[:, 1:].ravel(), (a - b)[:, :-1].ravel())[0, 1]) < 0.02
        later = noisy.frame(1).rgb.astype(float) - plain.frame(1).rgb
        assert abs(np.corrcoef((a - b).ravel(), later.ravel())[0, 1]) < 0.02

    @pytest.mark.slow
    def test_blur_follows_the_robots_turn_and_stays_where_it_is(self):
        plain, blurred = Rendered(galleries.CLEAN, 0), Rendered(replace(galleries.CLEAN, exposure=0.03), 0)
        moving = np.abs(plain.scene.command[:, 1]) > 0.1
        kept = {True: [], False: []}
        for k in range(2, 100, 9):
            if moving[k] != moving[k - 1]:
                continue
            for s in plain.in_view(k):
                (left, top), (right, bottom) = s.pixels.min(axis=0).astype(int), s.pixels.max(axis=0).astype(int)
                a, b = (
                    cv2.cvtColor(r.frame(k).rgb, cv2.COLOR_RGB2GRAY)[top:bottom, left:right].astype(np.float32)
                    for r in (plain, blurred)
                )
                kept[bool(moving[k])].append(np.abs(np.diff(b, axis=1)).mean() / np.abs(np.diff(a, axis=1)).mean())
                # to the left and to the right it fits equally ill
                left, middle, right = (
                    np.corrcoef(a[:, 8:-8].ravel(), b[:, 8 + d : b.shape[1] - 8 + d].ravel())[0, 1] for d in (-3, 0, 3)
                )
                assert max(left, right) < middle
                assert abs(left - right) < 0.02
        assert max(kept[True]) < 0.6 < min(kept[False])

    @pytest.mark.parametrize(("v", "omega"), [(0.3, 0.0), (0.0, 0.5), (0.2, -0.7)])
    def test_the_motion_that_blurs_is_that_of_a_point_ahead_of_the_camera(self, v, omega):
        g, depth, dt = galleries.CLEAN, 2.3, 1e-5
        eye, a = np.array([g.camera_x, g.camera_y]), g.camera_yaw
        point = np.append(eye + depth * np.array([math.cos(a), math.sin(a)]), g.camera_height)
        before, after = (
            to_pixels(g, in_camera(g, np.array([v * t, 0.0, omega * t]), point[None]))[0, 0] for t in (-dt, dt)
        )
        assert sideways_motion(g, v, omega, depth) == pytest.approx((after - before) / (2 * dt), rel=1e-5)


class TestTheRecording:
    @pytest.mark.slow
    def test_the_same_seed_gives_the_same_bytes_in_any_order(self):
        a, b, c = Rendered(galleries.SMALL, 3), Rendered(galleries.SMALL, 3, frames=20), Rendered(galleries.SMALL, 4)
        frames = list(b.frames())
        assert len(frames) == len(b) == 20
        for k in (7, 2, 7):
            f = a.frame(k)
            assert f.rgb.tobytes() == frames[k].rgb.tobytes()
            assert f.xyz.tobytes() == frames[k].xyz.tobytes()
            assert (f.time, f.v, f.omega) == (frames[k].time, frames[k].v, frames[k].omega)
        assert all(np.array_equal(x, y) for x, y in zip(a.references, b.references))
        assert not np.array_equal(a.references[0], c.references[0])
        assert a.frame(0).rgb.tobytes() != c.frame(0).rgb.tobytes()

    def test_frames_carry_time_and_recorded_commands_and_come_again(self, default):
        scene = default.scene
        short = Rendered(galleries.SMALL, 5, frames=4)
        for _ in range(2):
            for k, f in enumerate(short.frames()):
                assert f.time == short.scene.time[k]
                assert [f.v, f.omega] == short.scene.recorded[k].tolist()
                assert f.rgb.shape == f.xyz.shape == (240, 320, 3)
        assert len(default) == len(scene.time) == 360

    @pytest.mark.parametrize("frames", [0, -1, 49])
    def test_more_frames_than_there_are_are_refused(self, frames):
        with pytest.raises(UsageError, match=rf"frames = {frames}; from 1 to 48"):
            Rendered(galleries.SMALL, 0, frames=frames)

    def test_images_of_odd_size_and_a_camera_that_looks_along_an_axis_are_fine(self):
        g = replace(galleries.SMALL_CLEAN, image_width=321, image_height=241, camera_yaw=0.0)
        frame = Rendered(g, 0).frame(0)
        assert frame.rgb.shape == (241, 321, 3)
        assert np.isfinite(frame.xyz).all()
        assert (frame.xyz[:, :, 2] > 0).all()


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
        g, low, high = galleries.CLEAN, np.array([-3.5, -2.6, 0.0]), np.array([3.5, 2.6, 2.6])
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
        for k, number in galleries.views(clean):
            xyz, (x, y, t) = clean.frame(k).xyz, clean.scene.pose[k]
            for corner, pixel in enumerate(galleries.true_pixels(clean, k)[number]):
                p = bilinear(xyz, pixel)
                body = R.T @ (p[[0, 2]] - T)
                world = np.array([x, y]) + [[math.cos(t), -math.sin(t)], [math.sin(t), math.cos(t)]] @ body
                assert np.allclose(world, clean.setup.corners[number, corner], atol=1e-4)
                height = clean.scene.corners[number, corner, 2]
                assert galleries.CLEAN.camera_height - p[1] == pytest.approx(height, abs=1e-4)
                checked += 1
        assert checked == 96

    @pytest.mark.slow
    def test_with_noise_the_corner_errs_by_the_noise_of_stereo(self):
        g = replace(galleries.CLEAN, disparity_noise=0.25, reference_width=120)
        noisy, score = Rendered(g, 0), []
        for k, number in galleries.views(noisy, 4):
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
        return stereo_points(g, flat, np.zeros((*flat.shape, 3), np.uint8), [], rng, rng).astype(float)

    @pytest.mark.parametrize("depth", [1.0, 2.0, 3.0])
    def test_depth_noise_grows_with_the_square_of_the_depth(self, depth):
        z = self.points(replace(galleries.CLEAN, disparity_noise=0.25), depth)[:, :, 2]
        assert z.std() == pytest.approx(depth**2 * 0.25 / (galleries.CLEAN.focal * galleries.CLEAN.baseline), rel=0.03)
        assert z.mean() == pytest.approx(depth, rel=2e-3)

    def test_points_err_along_their_rays(self):
        p = self.points(replace(galleries.CLEAN, disparity_noise=0.25), 2.0)
        u, v = np.meshgrid(np.arange(640), np.arange(480))
        assert np.allclose(p[:, :, 0] / p[:, :, 2], (u - 319.5) / galleries.CLEAN.focal, atol=1e-6)
        assert np.allclose(p[:, :, 1] / p[:, :, 2], (v - 239.5) / galleries.CLEAN.focal, atol=1e-6)

    def test_disparities_are_whole_steps(self):
        p = self.points(replace(galleries.CLEAN, disparity_noise=0.3, disparity_step=0.125), 2.5)
        steps = galleries.CLEAN.focal * galleries.CLEAN.baseline / p[:, :, 2] / 0.125
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
        z = self.points(replace(galleries.CLEAN, disparity_noise=5.0), 20.0)[:, :, 2]
        assert np.isnan(z).any()
        assert np.nanmin(z) > 0


class TestHoles:
    def share(self, **options: float) -> float:
        return float(np.isnan(Rendered(replace(galleries.SMALL_CLEAN, **options), 1).frame(5).xyz[:, :, 2]).mean())

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
        for k, number in galleries.views(default):
            z = default.frame(k).xyz[:, :, 2]
            corners = galleries.true_pixels(default, k)[number]
            for pixel in np.rint(corners).astype(int):
                assert np.isnan(z[pixel[1], pixel[0]])
            inside = np.zeros(z.shape, np.uint8)
            middle = corners.mean(axis=0)
            cv2.fillConvexPoly(inside, np.rint(middle + 0.9 * (corners - middle)).astype(np.int32), 1)
            filled.append(np.isfinite(z[inside > 0]).mean())
        assert np.mean(filled) > 0.9
