"""The gallery: pictures hang as surveyed, the camera is a pinhole, the drive obeys commands, readings err as stated."""

import math
from dataclasses import replace

import numpy as np
import pytest

from data.errors import UsageError
from data.log import Log
from eval.referee.consistency import nees, verdict
from eval.replay.run import compare
from tests.data.worlds.samples import agrees
from wings.camera.gallery import Gallery, gallery, in_view, projections, simulate

PLAIN = Gallery()


def pinhole(g: Gallery, pose: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera points and pixels by homogeneous matrices: world <- body <- camera, then K."""
    x, y, t = pose
    body = np.array([[np.cos(t), -np.sin(t), 0, x], [np.sin(t), np.cos(t), 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
    a = g.camera_yaw
    # columns: the camera's right, down and forward in the body's frame, and where it is mounted
    mount = np.array([
        [np.sin(a), 0, np.cos(a), g.camera_x],
        [-np.cos(a), 0, np.sin(a), g.camera_y],
        [0, -1, 0, g.camera_height],
        [0, 0, 0, 1],
    ])  # fmt: skip
    homogeneous = np.concatenate([points.reshape(-1, 3), np.ones((points.size // 3, 1))], axis=1)
    camera = np.linalg.solve(body @ mount, homogeneous.T)[:3]
    f = (g.image_width / 2) / math.tan(g.field_of_view / 2)
    K = np.array([[f, 0, (g.image_width - 1) / 2], [0, f, (g.image_height - 1) / 2], [0, 0, 1]])
    image = K @ camera
    return camera.T.reshape(points.shape), (image[:2] / image[2]).T.reshape(*points.shape[:-1], 2)


class TestTheWorld:
    def test_the_defaults_are_sixty_seconds_eight_pictures_and_a_camera_of_60_degrees(self):
        scene = gallery(PLAIN, 0)
        assert scene.corners.shape == (8, 4, 3)
        assert scene.time[-1] + scene.time[1] == pytest.approx(60.0)
        assert (PLAIN.image_width, PLAIN.image_height) == (640, 480)
        assert PLAIN.focal == pytest.approx(554.256, abs=1e-3)

    @pytest.mark.parametrize("pictures", [1, 3, 8, 9])
    def test_pictures_hang_flat_on_walls_upright_and_apart(self, pictures):
        g = Gallery(pictures=pictures)
        corners = gallery(g, 3).corners
        assert len(corners) == pictures
        half = 0.5 * np.array([g.room_length, g.room_width])
        for c in corners:
            assert np.isclose(np.abs(c[:, :2]), half).all(axis=0).sum() == 1
            assert np.linalg.norm(c[1] - c[0]) == pytest.approx(g.picture_width)
            assert np.array_equal(c[0, :2], c[3, :2])
            assert np.array_equal(c[1, :2], c[2, :2])
            assert c[0, 2] == c[1, 2]
            assert c[0, 2] - c[3, 2] == pytest.approx(g.picture_height)
        middles = corners.mean(axis=1)
        gaps = np.linalg.norm(middles[:, None] - middles, axis=2) + 10 * np.eye(pictures)
        assert gaps.min() > g.picture_width + 0.2

    @pytest.mark.parametrize(("wrong", "names"), [
        ({"pictures": 0}, "pictures"), ({"rate": 0.0}, "rate"), ({"sigma_x": 0.0}, "sigma_x"),
        ({"sigma_v": -1.0}, "sigma_v"), ({"speed": math.nan}, "speed"), ({"image_width": 640.5}, "image_width"),
        ({"pictures": 40}, "spacing"), ({"spacing": 0.75}, "spacing"), ({"wall_distance": 2.6}, "wall_distance"),
        ({"end_distance": 3.5}, "end_distance"), ({"hang": 2.5}, "room_height"),
        ({"field_of_view": 3.2}, "field_of_view"), ({"camera_x": 2.25}, "camera_x"),
    ])  # fmt: skip
    def test_parameters_that_make_no_room_are_refused_by_name(self, wrong, names):
        with pytest.raises(UsageError, match=names) as caught:
            Gallery(**wrong)
        assert "\n" not in str(caught.value)


class TestTheCamera:
    @pytest.mark.parametrize("yaw", [-80.0, 0.0, 37.0, 180.0])
    def test_points_and_pixels_are_those_of_a_pinhole(self, yaw):
        g = Gallery(camera_yaw=math.radians(yaw))
        scene = gallery(g, 2)
        for pose in scene.pose[::40]:
            points, pixels = pinhole(g, pose, scene.corners)
            for s in projections(g, scene.corners, pose):
                assert np.allclose(s.points, points[s.picture], atol=1e-12)
                front = points[s.picture][:, 2] > 0
                assert np.allclose(s.pixels[front], pixels[s.picture][front], atol=1e-9)
                assert np.isnan(s.pixels[~front]).all()

    def test_the_setup_takes_points_of_the_body_to_the_camera_and_looks_ahead_at_90_degrees(self):
        scene = gallery(PLAIN, 0)
        c, s = math.cos(scene.setup.rotation), math.sin(scene.setup.rotation)
        for pose in scene.pose[::50]:
            turn = np.array([[np.cos(pose[2]), np.sin(pose[2])], [-np.sin(pose[2]), np.cos(pose[2])]])
            body = (scene.setup.corners - pose[:2]) @ turn.T
            camera = body @ np.array([[c, -s], [s, c]]).T + scene.setup.translation
            assert np.allclose(camera, pinhole(PLAIN, pose, scene.corners)[0][:, :, [0, 2]], atol=1e-12)
        assert Gallery(camera_yaw=0.0).rotation == pytest.approx(0.5 * math.pi)
        # the two readings of the transform differ, so that a mistaken one shows
        assert np.hypot(*scene.setup.translation) > 0.1
        assert abs(s) > 0.1

    def test_distance_and_obliquity_are_those_of_the_line_of_sight(self):
        scene = gallery(PLAIN, 0)
        pose = scene.pose[10]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x, y = PLAIN.camera_x, PLAIN.camera_y
        eye = [pose[0] + c * x - s * y, pose[1] + s * x + c * y, PLAIN.camera_height]
        for sight in projections(PLAIN, scene.corners, pose):
            line = eye - scene.corners[sight.picture].mean(axis=0)
            wall = int(np.argmax(np.ptp(scene.corners[sight.picture][:, :2], axis=0) < 1e-9))
            assert sight.distance == pytest.approx(np.linalg.norm(line))
            assert math.cos(sight.obliquity) == pytest.approx(abs(line[wall]) / np.linalg.norm(line))

    def test_a_picture_seen_from_behind_is_more_than_90_degrees_oblique_and_out_of_view(self):
        corners = gallery(PLAIN, 0).corners[:1]
        beyond = np.array([corners[0, :, 0].mean(), -0.5 * PLAIN.room_width - 2.0, 0.5 * math.pi - PLAIN.camera_yaw])
        (sight,) = projections(PLAIN, corners, beyond)
        assert (sight.points[:, 2] > 0).all()
        assert sight.obliquity > 0.5 * math.pi
        assert in_view(replace(PLAIN, max_obliquity=1.5), corners, beyond) == []

    @pytest.mark.parametrize(("distance", "degrees"), [(2.4, 80.0), (9.0, 20.0)])
    def test_in_view_is_whole_near_and_not_too_oblique(self, distance, degrees):
        scene = gallery(PLAIN, 4)
        limits = replace(PLAIN, max_distance=distance, max_obliquity=math.radians(degrees))
        counts = {"in view": 0, "cut": 0, "beyond a limit": 0}
        for pose in scene.pose[::3]:
            near = {s.picture for s in in_view(limits, scene.corners, pose)}
            points, pixels = pinhole(PLAIN, pose, scene.corners)
            for s in projections(limits, scene.corners, pose):
                p, uv = points[s.picture], pixels[s.picture]
                whole = (p[:, 2] > 0).all() and (uv >= 0).all() and (uv <= [639, 479]).all()
                beyond = s.distance > distance or s.obliquity > math.radians(degrees)
                assert (s.picture in near) == (whole and not beyond)
                counts["cut" if not whole else "beyond a limit" if beyond else "in view"] += 1
        assert min(counts.values()) > 6


class TestTheDrive:
    def test_the_true_path_obeys_the_true_commands(self):
        scene = gallery(PLAIN, 0)
        pose, parts = scene.pose[0].copy(), 400
        for k in range(40):
            v, omega = scene.command[k]
            for _ in range(parts):  # small straight steps at the middle heading
                dt = (scene.time[k + 1] - scene.time[k]) / parts
                middle = pose[2] + 0.5 * omega * dt
                pose += dt * np.array([v * np.cos(middle), v * np.sin(middle), omega])
            assert np.allclose(pose[:2], scene.pose[k + 1, :2], atol=1e-6)
            assert abs(math.remainder(pose[2] - scene.pose[k + 1, 2], 2 * math.pi)) < 1e-9

    def test_the_robot_drives_loops_that_close_and_keeps_its_distance(self):
        g = replace(PLAIN, duration=200.0)
        pose = gallery(g, 0).pose
        back = np.flatnonzero(np.linalg.norm(pose[1:, :2] - pose[0, :2], axis=1) < 1e-9)
        assert len(back) >= 3
        assert np.allclose(pose[back[0] + 1, 2], pose[0, 2])
        assert np.abs(pose[:, 0]).max() == pytest.approx(0.5 * g.room_length - g.end_distance, abs=0.01)
        assert np.abs(pose[:, 1]).max() == pytest.approx(0.5 * g.room_width - g.wall_distance, abs=0.01)
        assert np.abs(pose[:, 2]).max() < math.pi + 1e-12


def exact_readings(log: Log) -> np.ndarray:
    """Noise-free (x, z) of every observation, by the pinhole above."""
    corners = gallery(PLAIN, log.source["seed"]).corners.reshape(-1, 3)
    pose, ids = log.truth.pose[log.recorded.observations.frame], log.truth.landmark_of
    return np.array([pinhole(PLAIN, p, corners[i][None])[0][0, [0, 2]] for p, i in zip(pose, ids)])


class TestLogsWithoutImages:
    @pytest.mark.slow
    def test_readings_are_the_corners_in_view_with_the_stated_noise(self):
        errors = []
        for seed in range(5):
            log = simulate(PLAIN, seed)
            errors.append(log.recorded.observations.z - exact_readings(log))
            scene = gallery(PLAIN, seed)
            seen = [(k, s.picture) for k, pose in enumerate(scene.pose) for s in in_view(PLAIN, scene.corners, pose)]
            expected = [(k, 4 * picture + c) for k, picture in seen for c in range(4)]
            assert expected == list(zip(log.recorded.observations.frame.tolist(), log.truth.landmark_of.tolist()))
        error = np.concatenate(errors)
        assert agrees(error[:, 0], 0.02)
        assert agrees(error[:, 1], 0.05)
        assert abs(np.corrcoef(error.T)[0, 1]) < 0.05
        assert np.allclose(log.recorded.observations.R, np.diag([0.02**2, 0.05**2]))

    def test_the_sensor_predicts_the_readings_and_has_them_in_its_field_of_view(self):
        log = simulate(PLAIN, 0)
        o, known = log.recorded.observations, log.recorded.map
        assert known.id.tolist() == list(range(32))
        predicted = log.recorded.sensor.predict(log.truth.pose[o.frame], known.xy[log.truth.landmark_of])
        assert np.allclose(predicted, exact_readings(log), atol=1e-12)
        assert log.recorded.sensor.in_view(predicted).all()

    def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not(self):
        a, b, c = simulate(PLAIN, 3), simulate(PLAIN, 3), simulate(PLAIN, 4)
        assert a.recorded.observations.z.tobytes() == b.recorded.observations.z.tobytes()
        assert a.recorded.increments.mean.tobytes() == b.recorded.increments.mean.tobytes()
        assert a.recorded.prior.mean.tobytes() == b.recorded.prior.mean.tobytes()
        assert a.truth.pose.tobytes() == b.truth.pose.tobytes()
        assert a.recorded.prior.mean.tobytes() != c.recorded.prior.mean.tobytes()


def run_means(g: Gallery, runs: int, factor: float = 1.0) -> dict[tuple[str, str], np.ndarray]:
    """Mean NEES per run of EKF and batch smoother, R and Q stated `factor` times as large as they are."""
    found: dict[tuple[str, str], list[float]] = {}
    for seed in range(runs):
        log = simulate(g, seed)
        inputs = log.inputs(labels=True)
        observations = replace(inputs.observations, R=factor * inputs.observations.R)
        increments = replace(inputs.increments, covariance=factor * inputs.increments.covariance)
        inputs = replace(inputs, observations=observations, increments=increments)
        for run in compare(inputs, "localization", ["ekf", "batch"]):
            path = run.online if run.estimator == "ekf" else run.final
            for quantity in ("pose", "position", "heading"):
                values = nees(path.pose, path.covariance, log.truth.pose, quantity)
                found.setdefault((run.estimator, quantity), []).append(values.mean())
    return {key: np.array(values) for key, values in found.items()}


DOF = {"pose": 3, "position": 2, "heading": 1}


@pytest.mark.slow
def test_filter_and_smoother_are_consistent_over_fifty_runs_and_with_too_small_a_noise_are_not():
    means = run_means(PLAIN, 50)
    assert [key for key, values in means.items() if verdict(values, DOF[key[1]]).word != "consistent"] == []
    means = run_means(PLAIN, 50, factor=0.8)
    for estimator in ("ekf", "batch"):
        assert verdict(means[estimator, "pose"], 3).word == "overconfident"
