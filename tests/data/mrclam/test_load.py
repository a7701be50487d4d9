"""UTIAS MRCLAM: what a log made from the files must hold, on a small noise-free dataset and on the published ones."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from data import se2
from data.errors import DataError, UsageError
from data.log import Log
from data.motion import VelocityModel, VelocityNoise
from data.mrclam.calibration import FROZEN, Calibration
from data.mrclam.first_fix import rigid_fit
from data.mrclam.load import corrected_landmarks, is_mrclam, load_mrclam, robots
from tests.data.mrclam import world
from tests.data.mrclam.world import Texts, replace_row, save_folder, save_zip

PLAIN = Calibration()
TRUTH, ODOMETRY, MEASURED = "Robot1_Groundtruth.dat", "Robot1_Odometry.dat", "Robot1_Measurement.dat"


@pytest.fixture
def files() -> Texts:
    return world.texts()


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., Log]:
    """`load(files, **arguments)`: save as a folder and load robot 1, uncorrected unless said otherwise."""

    def run(files: Texts, **arguments: object) -> Log:
        return load_mrclam(save_folder(tmp_path / "set", files), 1, **{"calibration": PLAIN, **arguments})  # type: ignore[arg-type]

    return run


def starts_at(log: Log) -> float:
    """First frame, in seconds after the first ground-truth row."""
    return float(log.source["first_stamp"]) - world.T0  # type: ignore[arg-type]


def noted(log: Log, *words: str) -> bool:
    return any(all(w in note for w in words) for note in log.notes)


def exchange(survey: str, one: int, other: int) -> str:
    """A landmark file with the numbers of two rows exchanged."""
    return (
        survey.replace(f" {one:2d} \t", " AA \t")
        .replace(f" {other:2d} \t", f" {one:2d} \t")
        .replace(" AA \t", f" {other:2d} \t")
    )


class TestANoiseFreeRecording:
    def test_every_frame_has_the_true_pose_of_its_instant(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files)
        expected = np.array([world.pose_at(starts_at(log) + t) for t in log.recorded.time])
        assert log.truth.pose is not None
        # the truth is interpolated between rows 0.05 s apart: a chord of the circle
        np.testing.assert_allclose(se2.pose_error(log.truth.pose, expected), 0.0, atol=3e-4)

    def test_the_increments_lead_along_the_true_path(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files)
        pose = log.recorded.prior.mean
        for k in range(len(log.recorded)):
            pose = se2.compose(pose, log.recorded.increments.mean[k])
        expected = np.array(world.pose_at(starts_at(log) + log.recorded.time[-1]))
        np.testing.assert_allclose(se2.pose_error(pose, expected), 0.0, atol=1e-3)

    def test_the_sensor_predicts_each_reading_from_the_true_pose_and_the_map(
        self, files: Texts, load: Callable[..., Log]
    ) -> None:
        log = load(files)
        o, known = log.recorded.observations, log.recorded.map
        assert known is not None and log.truth.pose is not None and log.truth.landmark_of is not None  # noqa: PT018
        places = known.xy[np.searchsorted(known.id, log.truth.landmark_of)]
        predicted = log.recorded.sensor.predict(log.truth.pose[o.frame], places)
        np.testing.assert_allclose(log.recorded.sensor.residual(o.z, predicted), 0.0, atol=5e-4)

    def test_readings_of_one_image_share_a_frame_and_keep_their_order(
        self, files: Texts, load: Callable[..., Log]
    ) -> None:
        log = load(files)
        rows = [r for r in world.measurement_rows() if r[1] >= 6]
        stamps = starts_at(log) + log.recorded.time[log.recorded.observations.frame]
        np.testing.assert_allclose(stamps, [r[0] for r in rows], atol=1e-6)
        assert log.truth.landmark_of is not None
        assert log.truth.landmark_of.tolist() == [r[1] for r in rows]

    def test_it_starts_with_the_odometry_and_says_what_it_skipped(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files)
        assert starts_at(log) == pytest.approx(1.0, abs=1e-5)
        assert noted(log, "Skipped the first 1.000 s", "odometry")

    def test_no_two_frames_are_more_than_a_second_apart(self, files: Texts, load: Callable[..., Log]) -> None:
        header, rows = files[MEASURED].splitlines()[:4], files[MEASURED].splitlines()[4:]
        log = load({**files, MEASURED: "\n".join([*header, rows[0], rows[-1]]) + "\n"})
        step = np.diff(log.recorded.time)
        assert step.min() > 0.0
        assert step.max() <= 1.0 + 1e-6

    def test_the_prior_is_the_true_pose_with_5_cm_and_0_05_rad(self, files: Texts, load: Callable[..., Log]) -> None:
        prior = load(files).recorded.prior
        np.testing.assert_allclose(prior.mean, world.pose_at(1.0), atol=1e-6)
        np.testing.assert_allclose(prior.covariance, np.diag([0.05, 0.05, 0.05]) ** 2)
        wider = load(files, prior_sigma=(0.2, 0.1)).recorded.prior
        np.testing.assert_allclose(wider.covariance, np.diag([0.2, 0.2, 0.1]) ** 2)

    def test_labels_are_sensed_and_are_the_subjects(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files)
        assert log.labels_are_sensed
        assert log.label is None
        labels = log.inputs(labels=True).observations.label  # type: ignore[attr-defined]
        assert set(labels.tolist()) <= set(world.LANDMARKS)

    def test_the_source_names_file_robot_and_digest(self, files: Texts, tmp_path: Path) -> None:
        path = save_zip(tmp_path / "set.zip", files)
        log = load_mrclam(path, 1, start=2.0, stop=9.0)
        assert log.source["path"] == str(path)
        assert log.source["sha256"] == {"set.zip": hashlib.sha256(path.read_bytes()).hexdigest()}
        assert (log.source["robot"], log.source["start"], log.source["stop"]) == (1, 2.0, 9.0)
        folder = load_mrclam(save_folder(tmp_path / "f", files), 1)
        digests = folder.source["sha256"]
        assert isinstance(digests, dict)
        assert digests[ODOMETRY] == hashlib.sha256(files[ODOMETRY].encode()).hexdigest()
        assert set(digests) == set(files)


class TestWhereTheFilesAre:
    def test_folder_subfolder_and_zip_give_the_same_log(self, files: Texts, tmp_path: Path) -> None:
        save_folder(tmp_path / "top" / "MRCLAM_Dataset77", files)
        sources = [
            save_folder(tmp_path / "flat", files),
            tmp_path / "top",
            save_zip(tmp_path / "a.zip", files),
            save_zip(tmp_path / "b.zip", files, top=""),
        ]
        logs = [load_mrclam(s, 1) for s in sources]
        for log in logs[1:]:
            np.testing.assert_array_equal(log.recorded.increments.mean, logs[0].recorded.increments.mean)
            np.testing.assert_array_equal(log.recorded.observations.z, logs[0].recorded.observations.z)
        assert logs[1].name == logs[2].name == "mrclam77-robot1"
        assert all(robots(s) == [1] and is_mrclam(s) for s in sources)

    def test_a_zip_is_not_unpacked(self, files: Texts, tmp_path: Path) -> None:
        load_mrclam(save_zip(tmp_path / "set.zip", files), 1)
        assert [p.name for p in tmp_path.iterdir()] == ["set.zip"]

    @pytest.mark.parametrize("missing", ["Barcodes.dat", "Landmark_Groundtruth.dat", ODOMETRY, MEASURED])
    def test_a_missing_file_is_named(self, files: Texts, tmp_path: Path, missing: str) -> None:
        del files[missing]
        for source in (save_folder(tmp_path / "set", files), save_zip(tmp_path / "set.zip", files)):
            with pytest.raises(DataError, match=f"{missing}: no such file"):
                load_mrclam(source, 1)

    def test_a_robot_that_is_not_there_is_named_with_those_that_are(self, files: Texts, tmp_path: Path) -> None:
        with pytest.raises(DataError, match=r"Robot4_Odometry\.dat: no such file; robots .* here: 1$"):
            load_mrclam(save_folder(tmp_path / "set", files), 4)

    def test_what_is_no_dataset_is_told_so(self, files: Texts, tmp_path: Path) -> None:
        (tmp_path / "text.zip").write_text("not a zip")
        (tmp_path / "empty").mkdir()
        for n in (1, 2):
            save_folder(tmp_path / "two" / f"MRCLAM_Dataset{n}", files)
        for name, why in (
            ("text.zip", "not a readable zip"),
            ("empty", "Barcodes.dat: no such file"),
            ("two", "more than one dataset"),
            ("nothing", "no such folder"),
        ):
            with pytest.raises(DataError, match=why):
                load_mrclam(tmp_path / name, 1)
            assert not is_mrclam(tmp_path / name)

    def test_a_damaged_zip_is_a_data_error(self, files: Texts, tmp_path: Path) -> None:
        path = save_zip(tmp_path / "set.zip", files)
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 0xFF
        path.write_bytes(bytes(content))
        with pytest.raises(DataError, match=r"set\.zip"):
            load_mrclam(path, 1)


class TestReadingsLeftOut:
    def test_sightings_of_robots_are_dropped_and_counted(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files)
        seen = sum(r[1] == 2 for r in world.measurement_rows())
        assert len(log.recorded.observations.z) == len(world.measurement_rows()) - seen
        assert noted(log, f"{seen} readings of other robots", "dropped")

    def test_kept_robots_are_clutter(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files, keep_robots=True)
        rows = world.measurement_rows()
        assert len(log.recorded.observations.z) == len(rows)
        assert log.truth.landmark_of is not None
        assert log.truth.landmark_of.tolist() == [r[1] if r[1] >= 6 else -1 for r in rows]
        labels = log.inputs(labels=True).observations.label  # type: ignore[attr-defined]
        assert (labels == -1).sum() == sum(r[1] < 6 for r in rows)
        assert noted(log, "kept as clutter")

    def test_a_barcode_of_nobody_is_skipped_and_counted(self, files: Texts, load: Callable[..., Log]) -> None:
        before = load(files)
        files[MEASURED], _ = replace_row(files[MEASURED], 4, f"{world.T0 + 1.6:.3f} 999 2.0 0.1")
        log = load(files)
        assert len(log.recorded.observations.z) == len(before.recorded.observations.z) - 1
        assert noted(log, "1 reading of a barcode that no subject has (999)", "skipped")

    def test_a_landmark_without_a_place_is_dropped_and_named(self, files: Texts, load: Callable[..., Log]) -> None:
        seen = world.measurement_rows()[0][1]
        row = list(world.LANDMARKS).index(seen)
        files["Landmark_Groundtruth.dat"], _ = replace_row(files["Landmark_Groundtruth.dat"], row, None)
        log = load(files)
        assert noted(log, f"landmark file does not have ({seen})", "dropped")
        assert log.truth.landmark_of is not None
        assert seen not in log.truth.landmark_of

    def test_readings_before_the_first_and_after_the_last_odometry_are_dropped_and_counted(
        self, files: Texts, load: Callable[..., Log]
    ) -> None:
        whole = load(files)
        lines = files[MEASURED].splitlines()
        code = world.BARCODES[7]
        lines.insert(4, f"{world.T0 + 0.5:.3f} {code} 2.0 0.1")
        lines.append(f"{world.T0 + 11.5:.3f} {code} 2.0 0.1")
        log = load({**files, MEASURED: "\n".join(lines) + "\n"})
        np.testing.assert_array_equal(log.recorded.observations.z, whole.recorded.observations.z)
        assert noted(log, "1 reading before the first odometry")
        assert noted(log, "1 reading after the last odometry")


class TestTheWindow:
    def test_start_and_stop_count_from_the_first_ground_truth_row(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files, start=3.0, stop=7.5)
        assert starts_at(log) == pytest.approx(3.0, abs=1e-5)
        assert log.recorded.time[-1] == pytest.approx(4.5, abs=1e-6)
        np.testing.assert_allclose(log.recorded.prior.mean, world.pose_at(3.0), atol=1e-6)
        rows = [r for r in world.measurement_rows() if 3.0 <= r[0] <= 7.5 and r[1] >= 6]
        assert len(log.recorded.observations.z) == len(rows)

    def test_a_start_before_the_odometry_changes_nothing(self, files: Texts, load: Callable[..., Log]) -> None:
        assert load(files, start=0.5).recorded.time.tolist() == load(files).recorded.time.tolist()

    def test_an_empty_window_is_an_error(self, files: Texts, load: Callable[..., Log]) -> None:
        with pytest.raises(DataError, match="nothing between"):
            load(files, stop=0.9)
        with pytest.raises(UsageError, match="does not come after"):
            load(files, start=5.0, stop=5.0)
        with pytest.raises(DataError, match="no instant with both odometry and ground truth"):
            load(files, exclude_truth=[(0.0, 100.0)])

    def test_excluded_truth_is_blank_there_and_nowhere_else(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files, exclude_truth=[(4.0, 5.2), (8.0, 8.4)])
        t = starts_at(log) + log.recorded.time
        bad = ((t > 3.9999) & (t < 5.2001)) | ((t > 7.9999) & (t < 8.4001))
        assert log.truth.pose is not None
        np.testing.assert_array_equal(np.isnan(log.truth.pose).all(axis=1), bad)
        assert bad.any()
        assert len(log.recorded) == len(load(files).recorded)

    def test_the_log_starts_after_truth_that_is_excluded_or_missing(
        self, files: Texts, load: Callable[..., Log]
    ) -> None:
        log = load(files, exclude_truth=[(0.0, 3.02)])
        assert starts_at(log) == pytest.approx(3.05, abs=1e-5)
        np.testing.assert_allclose(log.recorded.prior.mean, world.pose_at(3.05), atol=1e-6)

    def test_truth_is_not_interpolated_across_more_than_a_second(self, files: Texts, load: Callable[..., Log]) -> None:
        lines = files[TRUTH].splitlines()
        header, rows = lines[:4], lines[4:]
        kept = rows[:100] + rows[125:]  # a gap from 4.95 to 6.25 s
        log = load({**files, TRUTH: "\n".join(header + kept) + "\n"})
        t = starts_at(log) + log.recorded.time
        assert log.truth.pose is not None
        np.testing.assert_array_equal(np.isnan(log.truth.pose[:, 0]), (t > 4.95) & (t < 6.25))


class TestWithoutGroundTruth:
    def test_the_prior_is_fitted_to_the_first_sightings_and_those_are_spent(
        self, files: Texts, load: Callable[..., Log]
    ) -> None:
        del files[TRUTH]
        log = load(files)
        assert log.truth.pose is None
        assert log.recorded.map is not None
        # seconds count from the first odometry row here, 1 s after the first ground-truth row that is gone
        true = np.array(world.pose_at(starts_at(log)))
        error = se2.pose_error(log.recorded.prior.mean, true)
        assert np.hypot(*error[:2]) < 0.02
        assert abs(error[2]) < 0.01
        spent = [r for r in world.measurement_rows() if r[1] >= 6 and r[0] < starts_at(log) + 1e-4]
        total = sum(r[1] >= 6 for r in world.measurement_rows())
        assert len(log.recorded.observations.z) == total - len(spent)
        assert log.recorded.observations.frame.min() > 0
        np.testing.assert_array_equal(log.recorded.increments.mean[0], 0.0)
        assert noted(log, "No ground truth", "the prior is a fit to ")

    def test_readings_that_do_not_fix_the_pose_leave_the_robot_in_its_own_frame(
        self, files: Texts, load: Callable[..., Log]
    ) -> None:
        del files[TRUTH]
        lines = files[MEASURED].splitlines()
        log = load({**files, MEASURED: "\n".join(lines[:5]) + "\n"})
        np.testing.assert_array_equal(log.recorded.prior.mean, 0.0)
        assert log.recorded.map is None
        assert log.truth.landmarks is None
        assert noted(log, "No ground truth", "map is withheld")

    def test_the_rigid_fit_finds_the_pose_that_made_the_points(self) -> None:
        pose = np.array([1.0, -2.0, 3.0])
        body = np.array([[1.0, 0.5], [2.0, -1.0], [4.0, 0.0]])
        found = rigid_fit(body, se2.transform_points(pose, body))
        np.testing.assert_allclose(se2.pose_error(found, pose), 0.0, atol=1e-12)


class TestTheGrid:
    def test_frames_are_a_grid_step_apart_and_readings_move_to_the_nearest(
        self, files: Texts, load: Callable[..., Log]
    ) -> None:
        log = load(files, grid=0.03)
        np.testing.assert_allclose(np.diff(log.recorded.time), 0.03, atol=1e-9)
        assert 10.0 - 0.03 < log.recorded.time[-1] <= 10.0 + 1e-9
        rows = np.array([r[0] for r in world.measurement_rows() if r[1] >= 6])
        np.testing.assert_array_equal(log.recorded.observations.frame, np.rint((rows - 1.0) / 0.03))

    def test_odometry_is_interpolated_and_held_for_a_step(self, files: Texts, load: Callable[..., Log]) -> None:
        head = files[ODOMETRY].splitlines()[:4]
        ramp = [f"{world.T0 + 1.0 + k / 10:.3f} {0.01 * k:.3f} 0.000" for k in range(101)]
        log = load({**files, ODOMETRY: "\n".join(head + ramp) + "\n"}, grid=0.02)
        # v = 0.1 (t - 1) exactly, on the grid; each step goes as far as the speed at its beginning
        expected = 0.1 * log.recorded.time[:-1] * 0.02
        np.testing.assert_allclose(log.recorded.increments.mean[1:, 0], expected, atol=1e-9)

    def test_readings_older_than_0_05_s_at_their_frame_are_dropped(
        self, files: Texts, load: Callable[..., Log]
    ) -> None:
        log = load(files, grid=0.5)
        rows = np.array([r[0] for r in world.measurement_rows() if r[1] >= 6])
        frame = np.rint((rows - 1.0) / 0.5)
        age = 1.0 + 0.5 * frame - rows
        np.testing.assert_array_equal(log.recorded.observations.frame, frame[age < 0.0501])
        assert noted(log, f"{int((age > 0.0501).sum())} readings older than 0.05 s")

    @pytest.mark.parametrize("grid", [0.0, -1.0, 1.5, math.inf])
    def test_a_senseless_grid_is_refused(self, files: Texts, load: Callable[..., Log], grid: float) -> None:
        with pytest.raises(UsageError, match="grid"):
            load(files, grid=grid)


class TestCalibration:
    def test_a_late_camera_is_undone(self, files: Texts, load: Callable[..., Log]) -> None:
        late = files[MEASURED].splitlines()
        for i, line in enumerate(late[4:], start=4):
            stamp, rest = line.split(None, 1)
            late[i] = f"{float(stamp) + 0.1:.3f} {rest}"
        log = load({**files, MEASURED: "\n".join(late) + "\n"}, calibration=Calibration(latency=0.1))
        exact = load(files)
        np.testing.assert_allclose(log.recorded.time, exact.recorded.time, atol=2e-6)
        np.testing.assert_array_equal(log.recorded.observations.frame, exact.recorded.observations.frame)
        np.testing.assert_allclose(log.truth.pose, exact.truth.pose, atol=1e-6)  # type: ignore[arg-type]

    def test_scales_and_biases_are_undone(self, files: Texts, load: Callable[..., Log]) -> None:
        calibration = Calibration(scale_v=1.1, scale_omega=0.5, range_scale=0.9, range_bias=0.3, bearing_bias=0.2)
        log, exact = load(files, calibration=calibration), load(files)
        r, b = exact.recorded.observations.z.T
        np.testing.assert_allclose(log.recorded.observations.z, np.stack([(r - 0.3) / 0.9, b - 0.2], axis=-1))
        turned = exact.recorded.increments.mean[:, 2]
        np.testing.assert_allclose(log.recorded.increments.mean[:, 2], 0.5 * turned, atol=1e-12)

    def test_a_turn_limit_holds_only_commands_beyond_it(self) -> None:
        v, omega = Calibration(turn_limit=0.5).velocities(np.ones(4), np.array([0.4, -0.5, 0.9, -2.0]))
        assert omega.tolist() == [0.4, -0.5, 0.5, -0.5]
        assert v.tolist() == [1.0, 1.0, 1.0, 1.0]

    def test_a_turning_robot_is_slower_in_either_direction_and_never_reverses(self) -> None:
        drag = Calibration(turn_drag=0.5, turn_limit=1.0)
        v, _ = drag.velocities(np.array([1.0, 1.0, -1.0, 0.1, 0.0]), np.array([0.4, -9.0, 0.4, 1.0, 1.0]))
        assert v.tolist() == [0.8, 0.5, -0.8, 0.0, 0.0]

    def test_depth_along_the_axis_becomes_range(self, files: Texts, load: Callable[..., Log]) -> None:
        log, exact = load(files, calibration=Calibration(range_is_depth=True)), load(files)
        r, b = exact.recorded.observations.z.T
        np.testing.assert_allclose(log.recorded.observations.z, np.stack([r / np.cos(b), b], axis=-1))
        assert np.abs(b).max() > 0.1

    def test_a_command_acts_from_halfway_to_the_stamp_before(self) -> None:
        stamps = np.array([1.0, 1.0, 1.2, 4.2])
        assert Calibration(midpoint_hold=True, odometry_delay=0.1).instants(stamps) == pytest.approx(
            [1.1, 1.1, 1.2, 3.8]
        )
        assert Calibration(odometry_delay=0.1).instants(stamps) == pytest.approx(stamps + 0.1)

    def test_delayed_odometry_starts_later(self, files: Texts, load: Callable[..., Log]) -> None:
        assert starts_at(load(files, calibration=Calibration(odometry_delay=0.1))) == pytest.approx(1.1, abs=1e-5)

    def test_noise_grows_with_the_measured_range(self, files: Texts, load: Callable[..., Log]) -> None:
        log = load(files, calibration=Calibration(sigma_range=0.1, sigma_range_growth=0.2, sigma_bearing=0.3))
        o = log.recorded.observations
        np.testing.assert_allclose(o.R[:, 0, 0], (0.1 + 0.2 * o.z[:, 0]) ** 2)
        np.testing.assert_allclose(o.R[:, 1, 1], 0.09)
        np.testing.assert_array_equal(o.R[:, 0, 1], 0.0)

    def test_sigma_and_motion_replace_the_calibrations(self, files: Texts, load: Callable[..., Log]) -> None:
        motion = VelocityModel(VelocityNoise("density", (0.5, 0.25)))
        log = load(files, calibration=FROZEN, sigma=(2.0, 3.0), motion=motion)
        np.testing.assert_allclose(
            log.recorded.observations.R, np.tile(np.diag([4.0, 9.0]), (len(log.recorded.observations.z), 1, 1))
        )
        span = np.diff(log.recorded.time)
        np.testing.assert_allclose(log.recorded.increments.covariance[1:, 2, 2], 0.25**2 * span, atol=1e-9)

    @pytest.mark.parametrize(
        "wrong", [{"range_scale": 0.0}, {"sigma_range": -1.0}, {"latency": math.inf}, {"turn_limit": 0.0}]
    )
    def test_senseless_numbers_are_refused(self, wrong: dict[str, float]) -> None:
        with pytest.raises(UsageError, match=next(iter(wrong))):
            Calibration(**wrong)  # type: ignore[arg-type]


class TestLandmarks:
    def test_another_file_replaces_the_datasets(self, files: Texts, load: Callable[..., Log], tmp_path: Path) -> None:
        other = tmp_path / "moved.dat"
        other.write_text("6 1.0 2.0 0 0\n7 3.0 4.0 0 0\n")
        log = load(files, landmarks=other)
        assert log.recorded.map is not None
        assert log.recorded.map.id.tolist() == [6, 7]
        assert log.recorded.map.xy.tolist() == [[1.0, 2.0], [3.0, 4.0]]
        assert log.source["landmarks"] == str(other)

    def test_exchanged_rows_are_noticed_and_named(self, files: Texts, load: Callable[..., Log]) -> None:
        assert not noted(load(files), "contradict")
        # two of the landmarks that are seen most often
        log = load({**files, "Landmark_Groundtruth.dat": exchange(files["Landmark_Groundtruth.dat"], 20, 7)})
        assert noted(log, "contradict", "20 (", "seen where 7 should be", "7 (", "seen where 20 should be")

    def test_a_corrected_file_beside_the_dataset_is_found_if_it_is_about_it(self, files: Texts, tmp_path: Path) -> None:
        source = save_zip(tmp_path / "set.zip", files)
        assert corrected_landmarks(source) is None
        beside = tmp_path / "Landmark_Groundtruth.corrected.dat"
        survey = files["Landmark_Groundtruth.dat"]
        beside.write_text(exchange(survey, 11, 17))
        assert corrected_landmarks(source) == beside
        beside.write_text(survey.replace("4.5", "4.6", 1).replace("0.9", "0.8", 1))
        assert corrected_landmarks(source) is None


class TestFaults:
    def fails(self, files: Texts, tmp_path: Path, name: str, line: int, *words: str) -> None:
        with pytest.raises(DataError) as caught:
            load_mrclam(save_folder(tmp_path / "set", files), 1)
        message = str(caught.value)
        assert "\n" not in message
        assert f"{name}: line {line}" in message
        for word in words:
            assert word in message

    @pytest.mark.parametrize("name", [TRUTH, ODOMETRY, MEASURED])
    def test_a_decreasing_stamp(self, files: Texts, tmp_path: Path, name: str) -> None:
        rest = files[name].splitlines()[20].split(None, 1)[1]
        files[name], line = replace_row(files[name], 16, f"{world.T0 - 5:.3f} {rest}")
        self.fails(files, tmp_path, name, line, "column time", "1248272258.361", "must not decrease")

    @pytest.mark.parametrize("name", [ODOMETRY, MEASURED])
    def test_equal_consecutive_stamps_are_fine(self, files: Texts, load: Callable[..., Log], name: str) -> None:
        lines = files[name].splitlines()
        lines.insert(21, lines[20])
        assert len(load({**files, name: "\n".join(lines) + "\n"}).recorded) == len(load(files).recorded)

    @pytest.mark.parametrize("name", sorted(world.texts()))
    def test_a_truncated_last_line(self, files: Texts, tmp_path: Path, name: str) -> None:
        last = len(files[name].splitlines())
        files[name] = files[name].rstrip().rsplit(None, 1)[0]
        self.fails(files, tmp_path, name, last, "fields where", "cut off")

    @pytest.mark.parametrize("name", [TRUTH, ODOMETRY, MEASURED])
    def test_a_last_number_that_lost_its_tail(self, files: Texts, tmp_path: Path, name: str) -> None:
        last = len(files[name].splitlines())
        files[name] = files[name].rstrip()[:-1]
        self.fails(files, tmp_path, name, last, "cut off")

    def test_a_missing_last_line_end_alone_is_fine(self, files: Texts, load: Callable[..., Log]) -> None:
        bare = {name: text.rstrip() for name, text in files.items()}
        assert len(load(bare).recorded) == len(load(files).recorded)

    @pytest.mark.parametrize(
        ("name", "row", "words"),
        [
            (MEASURED, "T 94 -0.5 0.1", ("column range", "negative")),
            (MEASURED, "T 94.5 0.5 0.1", ("column barcode", "whole number")),
            (MEASURED, "T 94 0.5 nan", ("column bearing", "not a number")),
            (ODOMETRY, "T 0.1", ("2 fields where 3",)),
            (ODOMETRY, "T 0.1 0.2 0.3", ("4 fields where 3",)),
            (ODOMETRY, "T fast 0.2", ("column forward velocity", "'fast'")),
            (ODOMETRY, "T 1_0 0.2", ("column forward velocity", "'1_0'")),
            (TRUTH, "T 0.1 inf 0.2", ("column y", "not a number")),
            ("Barcodes.dat", "6 63", ("column subject", "stands in two rows")),
            ("Barcodes.dat", "30 94", ("column barcode", "stands in two rows")),
            ("Landmark_Groundtruth.dat", "3 1 2 0 0", ("column subject", "robot")),
            ("Landmark_Groundtruth.dat", "8 1 2 0 0", ("column subject", "two rows")),
        ],
    )
    def test_a_wrong_row_is_named_with_line_and_column(
        self, files: Texts, tmp_path: Path, name: str, row: str, words: tuple[str, ...]
    ) -> None:
        stamp = files[name].splitlines()[14].split()[0]
        files[name], line = replace_row(files[name], 10, row.replace("T", stamp))
        self.fails(files, tmp_path, name, line, *words)

    def test_a_file_without_rows(self, files: Texts, tmp_path: Path) -> None:
        files[ODOMETRY] = "# nothing\n"
        with pytest.raises(DataError, match=rf"{ODOMETRY}: line \d+: no rows"):
            load_mrclam(save_folder(tmp_path / "set", files), 1)

    def test_a_stamp_far_in_the_future(self, files: Texts, tmp_path: Path) -> None:
        files[ODOMETRY], line = replace_row(files[ODOMETRY], -1, "9248272263.361 0.4 0.2")
        self.fails(files, tmp_path, ODOMETRY, line, "9248272263.361", "seconds")


CORRUPTIONS = st.sampled_from(["delete", "insert", "replace", "cut", "swap lines", "double line", "drop line"])


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(sorted(world.texts())), how=CORRUPTIONS, where=st.floats(0.0, 1.0, exclude_max=True),
    put=st.sampled_from([*"0123456789-.eE+#nai _\t\n\r\"',\x00", "\xff", "\n\n", "1e400", "-9", "e9"]),
)  # fmt: skip
def test_a_corrupted_folder_is_a_data_error_with_its_place_or_loads_with_finite_numbers(
    tmp_path: Path, name: str, how: str, where: float, put: str
) -> None:
    files = world.texts()
    text, lines = files[name], files[name].splitlines(keepends=True)
    at, line = int(where * len(text)), int(where * len(lines))
    files[name] = {
        "delete": text[:at] + text[at + 1 :],
        "insert": text[:at] + put + text[at:],
        "replace": text[:at] + put + text[at + 1 :],
        "cut": text[:at],
        "swap lines": "".join([*lines[:line], *lines[line : line + 2][::-1], *lines[line + 2 :]]),
        "double line": "".join([*lines[: line + 1], *lines[line:]]),
        "drop line": "".join([*lines[:line], *lines[line + 1 :]]),
    }[how]
    folder = save_folder(tmp_path / "set", files)
    try:
        log = load_mrclam(folder, 1)
    except DataError as error:
        message = str(error)
        assert "\n" not in message
        assert f"{name}: line " in message or "no instant with both" in message or "nothing between" in message
        return
    recorded = log.recorded
    for values in (recorded.time, recorded.increments.mean, recorded.increments.covariance, recorded.prior.mean):
        assert np.isfinite(values).all()
    assert np.isfinite(recorded.observations.z).all()
    assert np.isfinite(recorded.observations.R).all()
    assert (np.diff(recorded.time) > 0.0).all()
    assert log.truth.landmark_of is not None
    assert set(log.truth.landmark_of.tolist()) <= set(world.LANDMARKS)


# --- the published recordings -----------------------------------------------------------------------------------------

BAD_NINE = [(755.0, 836.0), (945.0, 1050.0), (376.0, 380.0)]


@pytest.fixture(scope="module")
def mrclam(shared_data: Path) -> Path:
    folder = shared_data / "mrclam"
    if not folder.is_dir():
        pytest.skip("no MRCLAM recordings beside the project (../shared/data/mrclam)")
    return folder


@pytest.fixture(scope="module")
def published(mrclam: Path) -> Callable[..., Log]:
    """`published(dataset, robot, **arguments)`: a log of a published zip, uncorrected unless said otherwise."""

    def load(dataset: int, robot: int, **arguments: object) -> Log:
        source = mrclam / f"MRCLAM_Dataset{dataset}.zip"
        return load_mrclam(source, robot, **{"calibration": PLAIN, **arguments})  # type: ignore[arg-type]

    return load


def misses(log: Log) -> dict[int, float]:
    """Median distance [m] between each landmark and its readings projected from the true poses."""
    o, known, pose = log.recorded.observations, log.recorded.map, log.truth.pose
    assert known is not None and pose is not None and log.truth.landmark_of is not None  # noqa: PT018
    x, y, heading = pose[o.frame].T
    r, b = o.z.T
    points = np.stack([x + r * np.cos(heading + b), y + r * np.sin(heading + b)], axis=-1)
    away = np.hypot(*(points - known.xy[np.searchsorted(known.id, log.truth.landmark_of)]).T)
    return {n: float(np.nanmedian(away[log.truth.landmark_of == n])) for n in known.id.tolist()}


class TestThePublishedRecordings:
    @pytest.mark.parametrize(
        ("dataset", "robot", "rows", "unknown", "median", "worst", "worst_miss"),
        [
            (1, 3, 8742, 2, 0.101, 6, 0.195),
            (6, 4, 2399, 3, 0.125, 9, 0.176),
            (9, 3, 6167, 0, 0.114, 18, 0.193),
        ],
    )
    def test_counts_and_median_residuals_are_those_measured_elsewhere(
        self, mrclam: Path, published: Callable[..., Log], dataset: int, robot: int, rows: int, unknown: int,
        median: float, worst: int, worst_miss: float,
    ) -> None:  # fmt: skip
        corrected = corrected_landmarks(mrclam / f"MRCLAM_Dataset{dataset}.zip")
        log = published(dataset, robot, landmarks=corrected, keep_robots=True)
        early = sum(int(n.split()[0]) for n in log.notes if "before the first odometry" in n)
        late = sum(int(n.split()[0]) for n in log.notes if "after the last odometry" in n)
        assert len(log.recorded.observations.z) + unknown + early + late == rows
        assert noted(log, "that no subject has") == (unknown > 0)
        alone = published(dataset, robot, landmarks=corrected)
        share = 1.0 - len(alone.recorded.observations.z) / len(log.recorded.observations.z)
        assert 0.15 <= share <= 0.24
        miss = misses(alone)
        assert np.median(list(miss.values())) == pytest.approx(median, abs=0.003)
        assert max(miss, key=lambda n: miss[n]) == worst
        assert miss[worst] == pytest.approx(worst_miss, abs=0.003)

    def test_every_robot_with_odometry_is_listed(self, mrclam: Path) -> None:
        assert robots(mrclam / "MRCLAM_Dataset1.zip") == [1, 2, 3, 4, 5]
        assert robots(mrclam / "MRCLAM_Dataset9.zip") == [3]

    def test_dataset_1_as_published_has_landmarks_11_and_17_exchanged(
        self, mrclam: Path, published: Callable[..., Log]
    ) -> None:
        assert noted(published(1, 4), "11 (6.1 m, seen where 17 should be), 17 (6.1 m, seen where 11 should be).")
        corrected = mrclam / "Landmark_Groundtruth.corrected.dat"
        assert corrected_landmarks(mrclam / "MRCLAM_Dataset1.zip") == corrected
        assert not noted(published(1, 4, landmarks=corrected), "contradict")
        for other in (6, 9):
            assert corrected_landmarks(mrclam / f"MRCLAM_Dataset{other}.zip") is None

    def test_the_camera_is_late_not_early(self, published: Callable[..., Log]) -> None:
        spread = {}
        for latency in (-0.06, 0.04, 0.14):
            log = published(9, 3, calibration=Calibration(latency=latency), exclude_truth=BAD_NINE)
            o, known, pose = log.recorded.observations, log.recorded.map, log.truth.pose
            assert known is not None and pose is not None and log.truth.landmark_of is not None  # noqa: PT018
            places = known.xy[np.searchsorted(known.id, log.truth.landmark_of)]
            residual = log.recorded.sensor.residual(o.z, log.recorded.sensor.predict(pose[o.frame], places))[:, 1]
            known_ones = residual[np.abs(residual) < 0.3]
            spread[latency] = known_ones.std()
        assert spread[0.04] < 0.9 * min(spread[-0.06], spread[0.14])

    def test_the_frozen_corrections_make_dead_reckoning_follow_the_truth(self, published: Callable[..., Log]) -> None:
        drift = {}
        for name, calibration in (("frozen", FROZEN), ("plain", PLAIN)):
            log = published(9, 3, calibration=calibration, start=165.0, stop=345.0)
            pose = log.recorded.prior.mean
            for step in log.recorded.increments.mean:
                pose = se2.compose(pose, step)
            assert log.truth.pose is not None
            drift[name] = abs(se2.pose_error(pose, log.truth.pose[-1])[2])
        assert drift["frozen"] < 0.5 < drift["plain"]

    def test_a_fit_to_the_first_sightings_agrees_with_the_truth(self, mrclam: Path, tmp_path: Path) -> None:
        import zipfile

        with zipfile.ZipFile(mrclam / "MRCLAM_Dataset6.zip") as archive:
            for robot in (5,):
                for name in ("Barcodes", "Landmark_Groundtruth", f"Robot{robot}_Odometry", f"Robot{robot}_Measurement"):
                    (tmp_path / f"{name}.dat").write_bytes(archive.read(f"MRCLAM_Dataset6/{name}.dat"))
                blind = load_mrclam(tmp_path, robot)
                seen = load_mrclam(mrclam / "MRCLAM_Dataset6.zip", robot)
                assert seen.truth.pose is not None
                stamp = float(blind.source["first_stamp"]) - float(seen.source["first_stamp"])  # type: ignore[arg-type]
                true = seen.truth.pose[int(np.argmin(np.abs(seen.recorded.time - stamp)))]
                error = se2.pose_error(blind.recorded.prior.mean, true)
                assert np.hypot(*error[:2]) < 0.5
                # within the fit's own covariance: chi-square with 3 degrees of freedom, 99.9 %
                assert error @ np.linalg.solve(blind.recorded.prior.covariance, error) < 16.3
