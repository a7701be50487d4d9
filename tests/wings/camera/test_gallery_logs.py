"""The gallery without images: readings are as stated, and right estimators are consistent on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.log import Log
from eval.referee.consistency import nees, verdict
from eval.replay.run import compare
from tests.data.worlds.samples import agrees
from tests.wings.camera.pinhole import PLAIN, pinhole
from wings.camera.gallery import Gallery, gallery, in_view, simulate


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
            expected = [
                (k, 4 * s.picture + c)
                for k, pose in enumerate(scene.pose)
                for s in in_view(PLAIN, scene.corners, pose)
                for c in range(4)
            ]
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
def test_filter_and_smoother_are_consistent_over_fifty_runs():
    means = run_means(PLAIN, 50)
    assert {key: verdict(values, DOF[key[1]]).word for key, values in means.items()} == dict.fromkeys(
        means, "consistent"
    )


@pytest.mark.slow
def test_filter_and_smoother_with_too_small_a_noise_are_not():
    means = run_means(PLAIN, 50, factor=0.8)
    for estimator in ("ekf", "batch"):
        assert verdict(means[estimator, "pose"], 3).word == "overconfident"
