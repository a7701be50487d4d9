"""The circle world: truth, map and view are the published ones, noise is as stated."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from data.log import Log
from data.worlds.circle import Circle, simulate
from tests.data.worlds.samples import LIMIT, agrees

SENSORS_JOURNAL = Circle(
    frames=400, turn_rate=0.075, sigma_speed=0.03 / math.sqrt(2), sigma_turn=0.03 * math.sqrt(8),
    landmarks=15, ring=1.0, centre_x=0.1251, centre_y=3.3318, min_range=0.5,
)  # fmt: skip
"""Brossard, Barrau, Bonnabel, IEEE Sensors Journal 19(4), 2019, with the noise of the stored run."""


def seen(log: Log) -> set[tuple[int, int]]:
    return set(zip(log.recorded.observations.frame.tolist(), log.truth.landmark_of.tolist()))


def exact_readings(log: Log) -> np.ndarray:
    """Noise-free readings (M, 2), by complex numbers."""
    pose = log.truth.pose[log.recorded.observations.frame]
    z = ((log.truth.landmarks.xy[log.truth.landmark_of] - pose[:, :2]) @ [1, 1j]) * np.exp(-1j * pose[:, 2])
    return np.column_stack([z.real, z.imag])


@pytest.fixture(scope="module")
def stored(shared_data: Path) -> dict[str, Any]:
    file = shared_data / "esde" / "results.mat"
    if not file.is_file():
        pytest.skip("no stored run")
    return loadmat(file)


class TestAgainstTheStoredRun:
    def test_the_true_path_is_the_stored_one(self, stored):
        ours = simulate(SENSORS_JOURNAL, 0).truth.pose
        theirs = stored["xR_true"][:, :, 1].T
        assert np.abs(ours[:, :2] - theirs[:, :2]).max() < 1e-9
        assert np.abs(np.exp(1j * ours[:, 2]) - np.exp(1j * theirs[:, 2])).max() < 1e-9

    def test_the_landmarks_are_the_stored_ones_which_count_the_angles_from_one(self, stored):
        ours = simulate(SENSORS_JOURNAL, 0).truth.landmarks
        assert ours.id.tolist() == list(range(15))
        assert np.abs(np.roll(ours.xy, -1, axis=0) - stored["xL_true_fixed"].T).max() < 1e-9

    def test_the_visible_sets_are_the_stored_ones(self, stored):
        number = stored["z"][2].astype(int)
        slots, frames = np.nonzero(number)
        theirs = {(f, n % 15) for f, n in zip(frames.tolist(), number[slots, frames].tolist()) if f > 0}
        assert seen(simulate(SENSORS_JOURNAL, 0)) == theirs

    def test_the_noise_is_the_stored_one(self, stored):
        assert SENSORS_JOURNAL.sigma_speed == pytest.approx(stored["sigma_v"].item())
        assert SENSORS_JOURNAL.sigma_turn == pytest.approx(stored["sigma_w"].item())


class TestWorld:
    @pytest.mark.parametrize("circle", [Circle(), Circle(period=0.5, speed=0.7, turn_rate=0.3, frames=100)])
    def test_the_truth_takes_straight_steps_and_then_turns(self, circle):
        place, heading, path = 0j, 0.0, []
        for _ in range(circle.frames):
            path.append((place.real, place.imag, math.remainder(heading, 2 * math.pi)))
            place += circle.speed * circle.period * np.exp(1j * heading)
            heading += circle.turn_rate * circle.period
        pose = simulate(circle, 0).truth.pose
        assert np.abs(pose[:, :2] - np.array(path)[:, :2]).max() < 1e-9
        assert np.abs(np.exp(1j * pose[:, 2]) - np.exp(1j * np.array(path)[:, 2])).max() < 1e-9
        assert np.abs(pose[:, 2]).max() <= math.pi + 1e-9

    def test_a_ring_lies_around_the_path_at_its_distance_unless_told_where(self):
        xy = simulate(Circle(landmarks=4), 0).truth.landmarks.xy
        r = 0.25 / math.radians(1.5)
        assert np.allclose(xy, [[r + 3, r], [0, 2 * r + 3], [-r - 3, r], [0, -3]], rtol=0, atol=1e-12)
        moved = simulate(Circle(landmarks=4, centre_x=1.0, centre_y=2.0), 0).truth.landmarks.xy
        assert np.allclose(moved, xy - [0, r] + [1, 2], rtol=0, atol=1e-12)
        assert simulate(Circle(landmarks=4, centre_y=0.0), 0).truth.landmarks.xy[0, 1] == 0.0

    def test_landmarks_are_seen_strictly_between_the_ranges_and_never_at_the_start(self):
        log = simulate(Circle(landmarks=40, ring=0.5, min_range=0.6, max_range=3.0, frames=300), 0)
        distance = np.linalg.norm(log.truth.pose[:, None, :2] - log.truth.landmarks.xy, axis=2)
        wanted = {(f, i) for f, i in np.argwhere((distance > 0.6) & (distance < 3.0)).tolist() if f > 0}
        assert seen(log) == wanted
        assert (distance[0] < 3.0).any()


class TestNoise:
    def test_odometry_and_readings_have_their_sigmas(self):
        log = simulate(Circle(period=0.5, sigma_speed=0.02, sigma_turn=0.01, sigma_point=0.2, frames=5000), 1)
        mean = log.recorded.increments.mean
        speed, turn = mean[1:, 0] / 0.5 - 0.25, mean[1:, 2] / 0.5 - math.radians(1.5)
        assert agrees(speed, 0.02)
        assert agrees(turn, 0.01)
        assert abs(np.corrcoef(speed, turn)[0, 1]) * math.sqrt(5000) < LIMIT
        assert np.array_equal(mean[:, 1], np.zeros(5000))
        assert np.array_equal(mean[0], np.zeros(3))
        error = log.recorded.observations.z - exact_readings(log)
        assert len(error) > 5000
        assert agrees(error[:, 0], 0.2)
        assert agrees(error[:, 1], 0.2)
        assert np.allclose(log.recorded.observations.R, 0.04 * np.eye(2), rtol=1e-12, atol=0)

    @pytest.mark.parametrize("heading_noise", ["after", "before"])
    @pytest.mark.parametrize("speed_noise", ["start", "end"])
    def test_the_stated_covariance_is_that_of_the_described_motion(self, heading_noise, speed_noise):
        """Oracle: central differences of the motion."""
        h = 0.8
        circle = Circle(
            frames=4, period=h, speed=1.5, turn_rate=0.4, sigma_speed=0.1, sigma_turn=0.2,
            heading_noise=heading_noise, speed_noise=speed_noise, covariance_floor=0.0,
        )  # fmt: skip
        increments = simulate(circle, 2).recorded.increments

        def move(v: float, omega: float, noise: np.ndarray) -> np.ndarray:
            n_v, n_omega = noise
            place = h * v * np.exp(1j * (h * n_omega if heading_noise == "before" else 0.0))
            place += h * n_v * np.exp(1j * (h * omega if speed_noise == "end" else 0.0))
            return np.array([place.real, place.imag, h * (omega + n_omega)])

        for mean, covariance in zip(increments.mean[1:], increments.covariance[1:]):
            v, omega = mean[0] / h, mean[2] / h
            J = np.stack([(move(v, omega, d) - move(v, omega, -d)) / 2e-6 for d in 1e-6 * np.eye(2)], axis=1)
            assert np.allclose(covariance, J @ np.diag([0.01, 0.04]) @ J.T, rtol=0, atol=1e-9)
            assert np.array_equal(covariance, covariance.T)
        assert np.array_equal(increments.covariance[0], np.zeros((3, 3)))


class TestStreams:
    def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_log(self):
        circle = Circle(frames=100, prior_sigma=0.1)
        one, two, other = (simulate(circle, s).recorded for s in (4, 4, 5))
        assert one.observations.z.tobytes() == two.observations.z.tobytes()
        assert one.increments.mean.tobytes() == two.increments.mean.tobytes()
        assert one.prior.mean.tobytes() == two.prior.mean.tobytes()
        assert one.increments.mean.shape == (100, 3)
        assert not np.isin(one.increments.mean[1:, 0], other.increments.mean[:, 0]).any()
        assert not np.isin(one.observations.z, other.observations.z).any()
        assert not np.isin(one.prior.mean, other.prior.mean).any()
