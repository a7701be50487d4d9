"""The linear world: linearized at the truth it is itself, noise is as stated, and right estimators are consistent."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data import se2
from data.convert.__main__ import main
from data.errors import UsageError
from data.formats.open_log import load_folder
from data.log import Log
from data.worlds.linear import LinearWorld, simulate
from eval.referee.consistency import nees, verdict
from eval.replay.run import compare
from tests.data.worlds.samples import agrees
from tests.quick import slow


def linear_solution(log: Log, slam: bool) -> tuple[np.ndarray, np.ndarray]:
    """Error (N, 3) and standard deviation (N, 3) of the poses by least squares, every model linearized at the truth."""
    inputs, pose, point = log.recorded, log.truth.pose, log.truth.landmarks.xy
    n = 3 * len(pose)
    information, vector = np.zeros((n + 2 * len(point),) * 2), np.zeros(n + 2 * len(point))

    def add(at: list[int], H: np.ndarray, error: np.ndarray, covariance: np.ndarray) -> None:
        weighted = H.T @ np.linalg.inv(covariance)
        information[np.ix_(at, at)] += weighted @ H
        vector[at] += weighted @ error

    def relative(k: int, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A point in the frame of pose k, that frame's world-to-body rotation, and the slope over the heading."""
        c, s = math.cos(pose[k, 2]), math.sin(pose[k, 2])
        R = np.array([[c, s], [-s, c]])
        p = R @ (xy - pose[k, :2])
        return p, R, np.array([p[1], -p[0]])

    add([0, 1, 2], np.eye(3), se2.pose_error(inputs.prior.mean, pose[0]), inputs.prior.covariance)
    for k in range(1, len(pose)):
        p, R, slope = relative(k - 1, pose[k, :2])
        H = np.zeros((3, 6))
        H[:2, :2], H[:2, 2], H[:2, 3:5], H[2, 2], H[2, 5] = -R, slope, R, -1.0, 1.0
        error = se2.pose_error(inputs.increments.mean[k], np.array([*p, pose[k, 2] - pose[k - 1, 2]]))
        add(list(range(3 * k - 3, 3 * k + 3)), H, error, inputs.increments.covariance[k])
    o = inputs.observations
    for k, i, z, covariance in zip(o.frame.tolist(), log.truth.landmark_of.tolist(), o.z, o.R):
        p, R, slope = relative(k, point[i])
        add([3 * k, 3 * k + 1, 3 * k + 2, n + 2 * i, n + 2 * i + 1], np.column_stack([-R, slope, R]), z - p, covariance)
    used = np.flatnonzero(np.diag(information)) if slam else np.arange(n)
    P = np.linalg.inv(information[np.ix_(used, used)])
    return (P @ vector[used])[:n].reshape(-1, 3), np.sqrt(np.diag(P))[:n].reshape(-1, 3)


def nonlinearity(log: Log, task: str) -> tuple[float, float]:
    """How far filter (last pose) and smoother (all poses) are from the linear solution, in standard deviations."""
    error, sigma = linear_solution(log, task == "slam")
    ekf, batch = compare(log.inputs(labels=True), task, ["ekf", "batch"])
    last = se2.pose_error(ekf.online.pose, log.truth.pose)[-1] - error[-1]
    every = se2.pose_error(batch.final.pose, log.truth.pose) - error
    return float(np.abs(last / sigma[-1]).max()), float(np.abs(every / sigma).max())


class TestLinearity:
    @pytest.mark.parametrize("task", ["localization", "slam"])
    def test_filter_and_smoother_find_the_solution_of_the_problem_linearized_at_the_truth(self, task: str):
        for seed in range(3):
            filtered, smoothed = nonlinearity(simulate(LinearWorld(frames=60), seed), task)
            assert filtered < 5e-3
            assert smoothed < 1e-3

    def test_an_ordinary_heading_error_makes_it_an_ordinary_world(self):
        """The twin that must fail: the check sees nonlinearity where there is some."""
        world = LinearWorld(frames=60, prior_sigma_heading=0.2, sigma_turn=0.05)
        filtered, smoothed = nonlinearity(simulate(world, 0), "slam")
        assert filtered > 0.05
        assert smoothed > 0.05

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
            found = verdict(np.array(means[quantity]), dof)
            assert found.p_value > 0.001, quantity


class TestWorld:
    def test_the_robot_drives_a_figure_of_eight_with_its_heading_along_the_path(self):
        pose = simulate(LinearWorld(frames=4000, laps=1.0), 0).truth.pose
        assert np.allclose(pose[[0, 2000], :2], 0.0, rtol=0, atol=1e-9)
        assert pose[:, 0].max() == pytest.approx(120.0, abs=1e-3)
        assert pose[:, 1].max() == pytest.approx(80.0, abs=1e-3)
        step = np.diff(pose[:, :2], axis=0) @ [1, 1j]
        middle = pose[:-1, 2] + 0.5 * se2.wrap_angle(np.diff(pose[:, 2]))
        assert np.abs(np.angle(step * np.exp(-1j * middle))).max() < 1e-4

    def test_landmarks_form_a_grid_around_the_crossing(self):
        landmarks = simulate(LinearWorld(rows=2, columns=3, spacing=4.0), 0).truth.landmarks
        assert landmarks.id.tolist() == list(range(6))
        assert landmarks.xy.tolist() == [[-4, -2], [0, -2], [4, -2], [-4, 2], [0, 2], [4, 2]]

    def test_what_is_near_enough_is_seen_in_every_frame_and_labelled_in_order(self):
        log = simulate(LinearWorld(), 0)
        distance = np.linalg.norm(log.truth.pose[:, None, :2] - log.truth.landmarks.xy, axis=2)
        o = log.inputs(labels=True).observations
        assert np.array_equal(np.column_stack([o.frame, o.label]), np.argwhere(distance < 120.0))
        assert np.bincount(o.frame).min() >= 4

    def test_the_map_is_granted_and_nothing_is_singular(self):
        inputs = simulate(LinearWorld(), 0).recorded
        assert inputs.map is not None
        assert inputs.floored == 0
        assert np.linalg.eigvalsh(inputs.increments.covariance[1:]).min() > 1e-10
        assert np.linalg.eigvalsh(inputs.prior.covariance).min() > 1e-10

    def test_time_name_and_source(self):
        world = LinearWorld(frames=3, period=0.5)
        log = simulate(world, 7)
        assert log.recorded.time.tolist() == [0.0, 0.5, 1.0]
        assert log.name == "linear:7"
        assert log.source == {"kind": "linear", "seed": 7, "linear": asdict(world)}
        assert simulate(world, 7, "mine").name == "mine"
        assert len(simulate(LinearWorld(frames=1), 0).recorded) == 1


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
        exact = np.concatenate(
            [
                se2.between(
                    log.truth.pose[log.recorded.observations.frame],
                    np.pad(log.truth.landmarks.xy[log.truth.landmark_of], ((0, 0), (0, 1))),
                )[:, :2]
                for log in logs
            ]
        )
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
        turn = se2.wrap_angle(log.recorded.increments.mean[1:, 2] - np.diff(log.truth.pose[:, 2]))
        assert agrees(turn, 1e-5)


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

    def test_a_wider_view_keeps_the_readings_it_had(self):
        logs = [simulate(LinearWorld(max_range=r), 6) for r in (120.0, 500.0)]
        near, far = (
            {(f, i): tuple(z) for f, i, z in zip(o.frame.tolist(), log.truth.landmark_of.tolist(), o.z.tolist())}
            for log in logs
            for o in [log.recorded.observations]
        )
        assert len(far) == 100 * 30
        assert {k: far[k] for k in near} == near

    def test_no_two_streams_share_their_draws(self):
        log = simulate(LinearWorld(frames=20, sigma_odometry=1.0, sigma_point=1.0, prior_sigma=1.0, max_range=1e3), 6)
        truth, r = log.truth.pose, log.recorded
        odometry = (r.increments.mean[1:] - se2.between(truth[:-1], truth[1:]))[:, :2].ravel()
        exact = np.stack([r.sensor.predict(pose, log.truth.landmarks.xy) for pose in truth]).reshape(-1, 2)
        sensor, prior = (r.observations.z - exact).ravel(), (r.prior.mean - truth[0])[:2]
        for a, b in ((odometry, sensor), (prior, odometry), (prior, sensor)):
            assert not np.isclose(a[:, None], b, rtol=0, atol=1e-9).any()


class TestParameters:
    @pytest.mark.parametrize(
        ("change", "why"),
        [
            ({"sigma_odometry": -0.1}, "sigma_odometry = -0.1; must not be negative"),
            ({"sigma_turn": -1e-4}, "sigma_turn = -0.0001; must not"),
            ({"prior_sigma": -0.1}, "prior_sigma = -0.1; must not"),
            ({"prior_sigma_heading": -0.1}, "prior_sigma_heading = -0.1; must not"),
            ({"sigma_point": 0.0}, "sigma_point = 0.0; a positive number"),
            ({"frames": 0}, "frames = 0; at least 1"),
            ({"rows": 0}, "rows = 0; at least 1"),
            ({"columns": 1.5}, "columns = 1.5; a whole number"),
            *(
                ({key: 0.0}, f"{key} = 0.0; a positive")
                for key in ("period", "laps", "half_length", "half_width", "spacing", "max_range")
            ),
            ({"laps": "two"}, "laps = 'two'; a number"),
            ({"max_range": math.inf}, "max_range = inf; a finite number"),
        ],
    )
    def test_a_senseless_value_is_named_with_its_key(self, change: dict[str, Any], why: str):
        with pytest.raises(UsageError) as error:
            LinearWorld(**change)
        assert why in str(error.value)
        assert str(error.value).startswith("linear: ")
        assert "\n" not in str(error.value)


class TestCommand:
    def test_every_parameter_has_a_flag_that_reaches_the_log(self, tmp_path: Path):
        world = LinearWorld(
            frames=30, period=0.5, laps=1.0, half_length=50.0, half_width=40.0, rows=4, columns=5, spacing=30.0,
            max_range=90.0, sigma_odometry=0.1, sigma_turn=1e-4, sigma_point=0.2, prior_sigma=0.02,
            prior_sigma_heading=1e-3,
        )  # fmt: skip
        assert all(getattr(world, f.name) != f.default for f in fields(world))
        flags = [w for f in fields(world) for w in (f"--{f.name.replace('_', '-')}", str(getattr(world, f.name)))]
        assert main(["linear", str(tmp_path / "eight"), "--seed", "7", *flags]) == 0
        log, wanted = load_folder(tmp_path / "eight"), simulate(world, 7)
        assert np.array_equal(log.recorded.observations.z, wanted.recorded.observations.z)
        assert np.array_equal(log.recorded.increments.mean, wanted.recorded.increments.mean)
        assert np.array_equal(log.recorded.increments.covariance, wanted.recorded.increments.covariance)
        assert log.source == {"kind": "linear", "seed": 7, "linear": asdict(world)}

    def test_every_flag_is_described(self, capsys: pytest.CaptureFixture[str]):
        with pytest.raises(SystemExit) as end:
            main(["linear", "--help"])
        assert end.value.code == 0
        text = capsys.readouterr().out
        for f in fields(LinearWorld):
            flag = text.index(f"  --{f.name.replace('_', '-')} ")
            assert len(text[flag : text.index("(default", flag)].split()) > 2
