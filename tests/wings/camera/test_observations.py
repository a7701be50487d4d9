"""From detections to a log: ids, units, covariances, identities as the referee sees them, and what is kept on disk."""

import math
from dataclasses import replace

import numpy as np
import pytest

from data.errors import UsageError
from data.inputs import Prior
from data.pictures import Found, InView, VisualSetup, true_pictures
from data.sensors import RelativePoint
from eval.referee.score import Trial, confusion_of, score
from eval.replay.run import compare
from eval.replay.settings import Setup
from tests.data.formats.open_log.same_log import assert_same_log
from wings.camera.gallery import Gallery, gallery
from wings.camera.observations import ENOUGH, cached, log_of, measure_noise, noise_of
from wings.camera.opening import parse_name

CORNERS = np.array(
    [[[3.0, 1.0], [3.0, 0.2], [3.0, 0.2], [3.0, 1.0]], [[3.0, -0.2], [3.0, -1.0], [3.0, -1.0], [3.0, -0.2]]]
)
SETUP = VisualSetup(0.5 * math.pi, (0.1, -0.2), CORNERS, Prior(np.zeros(3), np.diag([0.01, 0.01, 0.001])))
FOCAL, CENTRE, HEIGHT = 500.0, 320.0, 0.5


def sight(pose, picture):
    """Pixels (4, 2) and points (4, 3) of a picture from a pose, without noise."""
    sensor = RelativePoint(rotation=SETUP.rotation, translation=SETUP.translation)
    plan = sensor.predict(np.asarray(pose, float), CORNERS[picture])
    points = np.stack([plan[:, 0], np.array([-HEIGHT, -HEIGHT, HEIGHT, HEIGHT]), plan[:, 1]], axis=1)
    return FOCAL * points[:, :2] / points[:, 2:] + CENTRE, points


def made(frames=6, noise=0.0, seed=0, pictures=(0, 1)):
    rng = np.random.default_rng(seed)
    frame, picture, pixels, points = [], [], [], []
    for k in range(frames):
        for p in pictures:
            q, x = sight([0.02 * k, 0.0, 0.0], p)
            z = x[:, 2] + noise * x[:, 2] ** 2 * rng.standard_normal(4)
            q = q + (100.0 * noise * rng.standard_normal((4, 2)))
            x = np.stack([(q[:, 0] - CENTRE) / FOCAL * z, x[:, 1], z], axis=1)
            frame.append(k)
            picture.append(p)
            pixels.append(q)
            points.append(x)
    focal, pixel, depth = measure_noise(np.array(pixels), np.array(points))
    n = np.arange(frames, dtype=float)
    return Found(
        0.2 * n, np.full(frames, 0.1), np.zeros(frames), np.array(frame), np.array(picture),
        np.full(len(frame), 50), np.array(pixels), np.array(points), ({}, {}), (), focal, pixel, depth,
    )  # fmt: skip


def test_corners_are_landmarks_and_observations_in_the_cameras_plan():
    log = log_of(SETUP, made(), "x", pose=np.stack([[0.02 * k, 0.0, 0.0] for k in range(6)]))
    inputs = log.inputs(labels=True)
    assert inputs.map.id.tolist() == list(range(8))
    np.testing.assert_array_equal(inputs.map.xy, CORNERS.reshape(-1, 2))
    assert inputs.observations.label[:8].tolist() == list(range(8))
    expected = inputs.sensor.predict(np.zeros(3), inputs.map.xy)
    np.testing.assert_allclose(inputs.observations.z[:8], expected, atol=1e-12)
    np.testing.assert_allclose(inputs.observations.R[0], np.diag([0.02**2, 0.05**2]))
    np.testing.assert_allclose(inputs.increments.mean[1:], [[0.02, 0.0, 0.0]] * 5, atol=1e-12)
    (run,) = compare(inputs, "localization", ["ekf"])
    assert score([Trial(log, "localization", (run,))]).metrics.loc[0, "rmse_position_m"] < 1e-3


def test_a_corner_without_a_stereo_point_is_no_observation():
    found = made()
    points = found.points.copy()
    points[0, 2] = np.nan
    log = log_of(SETUP, replace(found, points=points), "x")
    assert len(log.recorded.observations.z) == 4 * len(found.frame) - 1
    assert 2 not in log.label[:7].tolist()


def test_depth_noise_moves_a_corner_along_its_ray():
    found = made(40, noise=0.004)
    R = noise_of(found, "depth")
    d, c = 3, 1
    x, z = found.points[d, c, 0], found.points[d, c, 2]
    u = (x / z) * found.focal

    def corner(u, z):
        return np.array([u / found.focal * z, z])

    step = 1e-6
    J = np.stack([(corner(u + step, z) - corner(u - step, z)), (corner(u, z + step) - corner(u, z - step))], 1) / (
        2 * step
    )
    expected = J @ np.diag([found.pixel_noise**2, (found.depth_noise * z**2) ** 2]) @ J.T
    np.testing.assert_allclose(R[d, c], expected, rtol=1e-6)
    assert (np.linalg.eigvalsh(R) > 0).all()


def test_noise_is_measured_without_the_truth():
    found = made(200, noise=0.003, seed=2)
    assert found.focal == pytest.approx(FOCAL, rel=0.01)
    assert found.depth_noise == pytest.approx(0.003, rel=0.15)
    assert found.pixel_noise == pytest.approx(0.3, rel=0.15)
    few = made(ENOUGH // 4 - 1)
    assert math.isnan(few.depth_noise)
    with pytest.raises(UsageError, match="too few"):
        noise_of(few, "depth")


def test_a_picture_taken_for_another_is_a_wrong_pairing():
    found = made()
    in_view = InView(found.frame, found.picture, found.pixels)
    assert true_pictures(found, in_view).tolist() == found.picture.tolist()
    swapped = replace(found, picture=np.where(np.arange(12) == 4, 1, found.picture))
    assert true_pictures(swapped, in_view)[4] == 0
    log = log_of(SETUP, swapped, "x", pose=np.zeros((6, 3)), in_view=in_view)
    for setup, wrong in ((Setup(gate_known=None), 4), (Setup(), 0)):  # by itself the gate leaves its corners out
        (run,) = compare(log.inputs(labels=True), "localization", ["ekf"], setup=setup)
        counts = confusion_of(run, log, "online")
        assert (counts.fp, counts.tp) == (wrong, 44)
    elsewhere = replace(found, pixels=found.pixels + np.where(np.arange(12) == 4, 300.0, 0.0)[:, None, None])
    assert true_pictures(elsewhere, in_view)[4] == -1


def test_what_was_found_is_kept_by_content_and_a_folder_that_cannot_be_written_told(tmp_path):
    found = replace(made(40, noise=0.002), refused=({"too few inliers": 3}, {}), tiles=((2, b"jpeg"),))
    found = replace(found, small=((0, b"small"), (3, b"one")))
    looked = []

    def look():
        looked.append(1)
        return found

    first, note = cached(tmp_path / "deep", "key", look)
    again, _ = cached(tmp_path / "deep", "key", look)
    assert (len(looked), note) == (1, None)
    assert_same_log(first, again)
    cached(tmp_path / "deep", "other", look)
    assert len(looked) == 2
    (kept,) = [f for f in (tmp_path / "deep").iterdir() if f.stat().st_size][:1]
    kept.write_bytes(b"PK broken")
    for key in ("key", "other"):
        cached(tmp_path / "deep", key, look)
    assert len(looked) == 3
    blocked = tmp_path / "file"
    blocked.write_text("")
    _, note = cached(blocked / "inside", "key", made)
    assert "could not be kept" in note


@pytest.mark.parametrize(("name", "words"), [
    ("visual:x", "whole number"), ("visual:0:colour=red", "'colour=red' is not known"),
    ("visual:0:frames=0", "at least 1"), ("visual:0:frames=many", "a whole number"),
    ("visual:0:duration=long", "a number is needed"),
])  # fmt: skip
def test_names_with_faults_are_refused(name, words):
    with pytest.raises(UsageError, match=words):
        parse_name(name)


def test_a_name_says_seed_parameters_and_frames():
    g, seed, frames = parse_name("visual:3:duration=20+frames=7")
    assert (g, seed, frames) == (Gallery(duration=20.0), 3, 7)
    assert len(gallery(g, seed).time) < len(gallery(Gallery(), seed).time)
