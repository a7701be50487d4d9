"""The linear world: linearized at the truth it is itself, noise is as stated, and right estimators are consistent."""

import numpy as np
import pytest

from data import se2
from data.worlds.linear import LinearWorld, simulate
from eval.referee.consistency import nees, verdict
from eval.replay.run import compare
from tests.data.worlds.samples import agrees
from tests.quick import slow


class TestLinearity:
    @pytest.mark.parametrize("runs", [70, pytest.param(200, marks=pytest.mark.slow)])
    @pytest.mark.parametrize("task", [slow("localization"), "slam"])
    def test_the_filter_is_consistent_in_pose_position_and_heading(self, task: str, runs: int):
        means: dict[str, list[float]] = {"pose": [], "position": [], "heading": []}
        for seed in range(runs):
            log = simulate(LinearWorld(), seed)
            run = compare(log.inputs(labels=True), task, ["ekf"])[0].online
            for quantity, values in means.items():
                values.append(float(np.mean(nees(run.pose, run.covariance, log.truth.pose, quantity))))
        for quantity, dof in (("pose", 3), ("position", 2), ("heading", 1)):
            assert verdict(np.array(means[quantity]), dof).p_value > 0.001, quantity


class TestNoise:
    def test_every_noise_has_the_sigma_that_the_inputs_state(self):
        logs = [simulate(LinearWorld(), seed) for seed in range(40)]
        increment = np.concatenate(
            [log.recorded.increments.mean[1:] - se2.between(log.truth.pose[:-1], log.truth.pose[1:]) for log in logs]
        )
        for column, sigma in enumerate((0.05, 0.05, 3e-5)):
            assert agrees(increment[:, column], sigma)
            assert np.allclose(logs[0].recorded.increments.covariance[1:, column, column], sigma**2, rtol=1e-12)
        reading = np.concatenate([log.recorded.observations.z for log in logs])
        at = np.concatenate([log.truth.pose[log.recorded.observations.frame] for log in logs])
        seen = np.concatenate([log.truth.landmarks.xy[log.truth.landmark_of] for log in logs])
        exact = se2.between(at, np.pad(seen, ((0, 0), (0, 1))))[:, :2]
        assert agrees(reading - exact, 0.1)
        assert np.allclose(logs[0].recorded.observations.R, 0.01 * np.eye(2))
        priors = [simulate(LinearWorld(frames=1), seed) for seed in range(400)]
        error = np.array([se2.pose_error(log.recorded.prior.mean, log.truth.pose[0]) for log in priors])
        for column, sigma in enumerate((0.01, 0.01, 3e-5)):
            assert agrees(error[:, column], sigma)
            assert priors[0].recorded.prior.covariance[column, column] == pytest.approx(sigma**2)

    def test_noise_below_the_floor_is_drawn_from_the_floor(self):
        log = simulate(LinearWorld(frames=4000, sigma_turn=0.0), 0)
        assert log.recorded.floored == 3999
        assert agrees(se2.wrap_angle(log.recorded.increments.mean[1:, 2] - np.diff(log.truth.pose[:, 2])), 1e-5)


class TestStreams:
    def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_log(self):
        one, two, other = (simulate(LinearWorld(), s) for s in (4, 4, 5))
        assert one.recorded.observations.z.tobytes() == two.recorded.observations.z.tobytes()
        assert one.recorded.increments.mean.tobytes() == two.recorded.increments.mean.tobytes()
        assert one.recorded.prior.mean.tobytes() == two.recorded.prior.mean.tobytes()
        assert np.array_equal(one.truth.pose, other.truth.pose)
        assert not np.isin(one.recorded.increments.mean[1:], other.recorded.increments.mean).any()
        assert not np.isin(one.recorded.observations.z, other.recorded.observations.z).any()
        assert not np.isin(one.recorded.prior.mean, other.recorded.prior.mean).any()

    def test_changing_one_noise_leaves_the_others(self):
        def drawn(**change: float) -> list[bytes]:
            r = simulate(LinearWorld(**change), 6).recorded  # type: ignore[arg-type]
            return [r.increments.mean.tobytes(), r.observations.z.tobytes(), r.prior.mean.tobytes()]

        plain = drawn()
        for i, key in enumerate(("sigma_odometry", "sigma_point", "prior_sigma")):
            assert [a == b for a, b in zip(drawn(**{key: 0.3}), plain)] == [j != i for j in range(3)]
