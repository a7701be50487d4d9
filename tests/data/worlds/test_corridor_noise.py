"""The corridor lab: noise of readings, odometry and people is as stated, from streams of their own."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from data import se2
from data.inputs import CLUTTER
from data.log import Log
from data.worlds.corridor import Corridor, simulate
from tests.data.worlds.corridor_readings import ALL_ROUND, exact_polar, measured_polar
from tests.data.worlds.samples import LIMIT, agrees


@pytest.fixture(scope="module")
def logs() -> list[Log]:
    """Ten laps with each of four seeds."""
    return [simulate(Corridor(frames=440), seed) for seed in range(4)]


class TestNoise:
    def test_range_noise_is_a_share_of_the_range(self, logs):
        exact, measured = (np.concatenate([f(log) for log in logs]) for f in (exact_polar, measured_polar))
        share = measured[:, 0] / exact[:, 0] - 1.0
        for low, high in ((0.0, 1.0), (1.0, 3.0), (3.0, 5.0)):
            part = share[(exact[:, 0] > low) & (exact[:, 0] <= high)]
            assert len(part) > 2000
            assert agrees(part, 0.01)

    def test_bearing_noise_is_the_same_everywhere_and_independent(self, logs):
        exact, measured = (np.concatenate([f(log) for log in logs]) for f in (exact_polar, measured_polar))
        error = np.angle(np.exp(1j * (measured[:, 1] - exact[:, 1])))
        for near in (True, False):
            assert agrees(error[(exact[:, 0] < 2.0) == near], math.radians(0.125))
        share = measured[:, 0] / exact[:, 0] - 1.0
        assert abs(np.corrcoef(error, share)[0, 1]) * math.sqrt(len(error)) < LIMIT

    def test_R_comes_from_the_measured_reading_and_not_from_the_true_one(self):
        """With noise this large the two differ by far more than rounding; trap: truth leaking into the inputs."""
        log = simulate(Corridor(srho=0.1, sphi=math.radians(10)), 0)

        def covariances(polar: np.ndarray) -> np.ndarray:
            result = []
            for r, b in polar:
                c, s = math.cos(b), math.sin(b)
                J = np.array([[c, -r * s], [s, r * c]])
                result.append(J @ np.diag([(0.1 * r) ** 2, math.radians(10) ** 2]) @ J.T)
            return np.array(result)

        R = log.recorded.observations.R
        assert np.allclose(R, covariances(measured_polar(log)), rtol=1e-10, atol=1e-15)
        assert not np.allclose(R, covariances(exact_polar(log)), rtol=1e-2, atol=1e-4)
        assert np.array_equal(R, np.swapaxes(R, 1, 2))

    def test_odometry_noise_of_moves_and_turns(self, logs):
        error = np.concatenate(
            [log.recorded.increments.mean[1:] - se2.between(log.truth.pose[:-1], log.truth.pose[1:]) for log in logs]
        )
        turn = np.concatenate([np.abs(np.diff(np.unwrap(log.truth.pose[:, 2]))) > 1.0 for log in logs])
        assert turn.sum() == 4 * 39
        for which, sigma in ((~turn, (0.01, 0.01, 2.0)), (turn, (0.03, 0.03, 2.5))):
            assert agrees(error[which, 0], sigma[0])
            assert agrees(error[which, 1], sigma[1])
            assert agrees(error[which, 2], math.radians(sigma[2]))

    def test_every_odometry_sigma_has_its_own_key(self):
        for i, axis in enumerate(("sx", "sy", "stheta")):
            for motion, other in (("move", "turn"), ("turn", "move")):
                log = simulate(Corridor(**{f"{axis}_{motion}": 0.07}), 0)
                changed = np.isclose(log.recorded.increments.covariance[:, i, i], 0.07**2)
                assert changed.sum() == (40 if motion == "move" else 3)
                assert changed[11] == (motion == "turn")
                assert not changed[0], other


class TestPeople:
    @staticmethod
    def walks(corridor: Callable[..., Corridor], seed: int, **change: float) -> np.ndarray:
        """Positions (N, K, 2) as an all-seeing, all but noiseless sensor reports them."""
        c = corridor(people=True, srho=1e-9, sphi=1e-9, **ALL_ROUND, **change)
        log = simulate(c, seed)
        frame, ids = log.recorded.observations.frame, log.truth.landmark_of
        person = ids == CLUTTER
        assert person.sum() == c.frames * c.crowd
        points = se2.transform_points(log.truth.pose[frame[person]], log.recorded.observations.z[person])
        return points.reshape(c.frames, c.crowd, 2)

    def test_people_start_anywhere_in_the_square_after_one_step(self):
        """One step with a velocity of 5 m widens the square's 10 m / sqrt(12) to sqrt(100 / 12 + 25) m."""
        first = self.walks(Corridor, 0, frames=1, crowd=4000, sv_people=5.0).ravel()
        assert agrees(first, math.sqrt(100 / 12 + 25), 5.0)
        still = self.walks(Corridor, 0, frames=1, crowd=4000, sv_people=0.0)
        assert still.min() > -1e-6
        assert still.max() < 10.0 + 1e-6
        assert abs(still.mean() - 5.0) < LIMIT * 10 / math.sqrt(12 * still.size)
        assert abs(still.std() - 10 / math.sqrt(12)) < 0.1

    def test_velocity_starts_with_its_sigma_and_changes_by_its_own(self):
        walks = self.walks(Corridor, 1, crowd=300)
        velocity = np.diff(walks, axis=0)
        change = np.diff(velocity, axis=0)
        assert agrees(change.ravel(), 0.01)
        for k in (0, 20, 42):
            # from frame k to k + 1: the first velocity and k + 1 changes
            assert agrees(velocity[k].ravel(), math.sqrt(0.05**2 + (k + 1) * 0.01**2))


class TestStreams:
    @staticmethod
    def points(log: Log) -> dict[tuple[int, int], tuple[float, float]]:
        """Reading of each (frame, id)."""
        ids, o = log.truth.landmark_of, log.recorded.observations
        return {(f, i): tuple(z) for f, i, z in zip(o.frame.tolist(), ids.tolist(), o.z.tolist()) if i != CLUTTER}

    def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_log(self):
        one, two, other = (simulate(Corridor(people=True), s).recorded for s in (4, 4, 5))
        for name in ("frame", "z", "R"):
            assert getattr(one.observations, name).tobytes() == getattr(two.observations, name).tobytes()
        assert one.increments.mean.tobytes() == two.increments.mean.tobytes()
        assert not np.isin(one.increments.mean[1:11], other.increments.mean).any()

    def test_people_and_odometry_change_no_reading_of_a_point(self):
        plain = self.points(simulate(Corridor(), 6))
        for change in ({"people": True}, {"odometry": False}, {"people": True, "odometry": False}):
            assert self.points(simulate(Corridor(**change), 6)) == plain
