"""UTIAS MRCLAM: what a log made from the files must hold, on a small noise-free dataset; a fault has its place."""

import hashlib
import math

import numpy as np
import pytest

from data import se2
from data.errors import DataError, UsageError
from data.formats.mrclam import Treatment, is_mrclam, load_mrclam, robots
from tests.data.formats.mrclam import world
from tests.data.formats.mrclam.world import (
    MEASURED,
    ODOMETRY,
    TRUTH,
    noted,
    replace_row,
    save_folder,
    save_zip,
    starts_at,
)


class TestANoiseFreeRecording:
    def test_every_frame_has_the_true_pose_of_its_instant_and_increments_lead_along_the_true_path(self, files, load):
        log = load(files)
        expected = np.array([world.pose_at(starts_at(log) + t) for t in log.recorded.time])
        assert log.truth.pose is not None
        # the truth is interpolated between rows 0.05 s apart: a chord of the circle
        np.testing.assert_allclose(se2.pose_error(log.truth.pose, expected), 0.0, atol=3e-4)
        pose = log.recorded.prior.mean
        for k in range(len(log.recorded)):
            pose = se2.compose(pose, log.recorded.increments.mean[k])
        expected = np.array(world.pose_at(starts_at(log) + log.recorded.time[-1]))
        np.testing.assert_allclose(se2.pose_error(pose, expected), 0.0, atol=1e-3)

    def test_the_sensor_predicts_each_reading_and_those_of_one_image_share_a_frame_in_their_order(self, files, load):
        log = load(files)
        o, known = log.recorded.observations, log.recorded.map
        assert known is not None and log.truth.pose is not None and log.truth.landmark_of is not None  # noqa: PT018
        places = known.xy[np.searchsorted(known.id, log.truth.landmark_of)]
        predicted = log.recorded.sensor.predict(log.truth.pose[o.frame], places)
        np.testing.assert_allclose(log.recorded.sensor.residual(o.z, predicted), 0.0, atol=5e-4)
        rows = [r for r in world.measurement_rows() if r[1] >= 6]
        np.testing.assert_allclose(starts_at(log) + log.recorded.time[o.frame], [r[0] for r in rows], atol=1e-6)
        assert log.truth.landmark_of.tolist() == [r[1] for r in rows]

    def test_the_prior_is_the_true_pose_with_5_cm_and_0_05_rad(self, files, load):
        prior = load(files).recorded.prior
        np.testing.assert_allclose(prior.mean, world.pose_at(1.0), atol=1e-6)
        np.testing.assert_allclose(prior.covariance, np.diag([0.05, 0.05, 0.05]) ** 2)
        wider = load(files, prior_sigma=(0.2, 0.1)).recorded.prior
        np.testing.assert_allclose(wider.covariance, np.diag([0.2, 0.2, 0.1]) ** 2)

    def test_the_source_names_file_robot_and_digest(self, files, tmp_path):
        path = save_zip(tmp_path / "set.zip", files)
        log = load_mrclam(path, 1, Treatment(2.0, 9.0))
        assert log.source["file"] == "set.zip"
        assert log.source["sha256"] == {"set.zip": hashlib.sha256(path.read_bytes()).hexdigest()}
        assert (log.source["robot"], log.source["start"], log.source["stop"]) == (1, 2.0, 9.0)
        folder = load_mrclam(save_folder(tmp_path / "f", files), 1)
        digests = folder.source["sha256"]
        assert isinstance(digests, dict)
        assert digests[ODOMETRY] == hashlib.sha256(files[ODOMETRY].encode()).hexdigest()
        assert set(digests) == set(files)


class TestWhereTheFilesAre:
    def test_folder_subfolder_and_zip_give_the_same_log(self, files, tmp_path):
        save_folder(tmp_path / "top" / "MRCLAM_Dataset77", files)
        sources = [
            save_folder(tmp_path / "flat", files), tmp_path / "top", save_zip(tmp_path / "a.zip", files),
            save_zip(tmp_path / "b.zip", files, top=""),
        ]  # fmt: skip
        logs = [load_mrclam(s, 1) for s in sources]
        for log in logs[1:]:
            np.testing.assert_array_equal(log.recorded.increments.mean, logs[0].recorded.increments.mean)
            np.testing.assert_array_equal(log.recorded.observations.z, logs[0].recorded.observations.z)
        assert logs[1].name == logs[2].name == "mrclam77-robot1"
        assert all(robots(s) == [1] and is_mrclam(s) for s in sources)

    @pytest.mark.parametrize("missing", ["Barcodes.dat", "Landmark_Groundtruth.dat", ODOMETRY, MEASURED])
    def test_a_missing_file_is_named(self, files, tmp_path, missing):
        del files[missing]
        for source in (save_folder(tmp_path / "set", files), save_zip(tmp_path / "set.zip", files)):
            with pytest.raises(DataError, match=f"{missing}: no such file"):
                load_mrclam(source, 1)

    def test_a_robot_that_is_not_there_is_named_with_those_that_are(self, files, tmp_path):
        with pytest.raises(DataError, match=r"Robot4_Odometry\.dat: no such file; robots .* here: 1$"):
            load_mrclam(save_folder(tmp_path / "set", files), 4)

    def test_what_is_no_dataset_is_told_so(self, files, tmp_path):
        (tmp_path / "text.zip").write_text("not a zip")
        (tmp_path / "empty").mkdir()
        for n in (1, 2):
            save_folder(tmp_path / "two" / f"MRCLAM_Dataset{n}", files)
        for name, why in (
            ("text.zip", "not a readable zip"), ("empty", "Barcodes.dat: no such file"),
            ("two", "more than one dataset"), ("nothing", "no such folder"),
        ):  # fmt: skip
            with pytest.raises(DataError, match=why):
                load_mrclam(tmp_path / name, 1)
            assert not is_mrclam(tmp_path / name)


class TestReadingsLeftOut:
    def test_a_barcode_of_nobody_is_skipped_and_counted(self, files, load):
        before = load(files)
        files[MEASURED], _ = replace_row(files[MEASURED], 4, f"{world.T0 + 1.6:.3f} 999 2.0 0.1")
        log = load(files)
        assert len(log.recorded.observations.z) == len(before.recorded.observations.z) - 1
        assert noted(log, "1 observation of a barcode that no subject has (999)", "skipped")

    def test_a_landmark_without_a_place_is_dropped_and_named(self, files, load):
        seen = world.measurement_rows()[0][1]
        row = list(world.LANDMARKS).index(seen)
        files["Landmark_Groundtruth.dat"], _ = replace_row(files["Landmark_Groundtruth.dat"], row, None)
        log = load(files)
        assert noted(log, f"landmark file does not have ({seen})", "dropped")
        assert log.truth.landmark_of is not None
        assert seen not in log.truth.landmark_of


class TestTheWindow:
    def test_start_and_stop_count_from_the_first_ground_truth_row(self, files, load):
        log = load(files, start=3.0, stop=7.5)
        assert starts_at(log) == pytest.approx(3.0, abs=1e-5)
        assert log.recorded.time[-1] == pytest.approx(4.5, abs=1e-6)
        np.testing.assert_allclose(log.recorded.prior.mean, world.pose_at(3.0), atol=1e-6)
        rows = [r for r in world.measurement_rows() if 3.0 <= r[0] <= 7.5 and r[1] >= 6]
        assert len(log.recorded.observations.z) == len(rows)

    def test_an_empty_window_is_an_error(self, files, load):
        with pytest.raises(DataError, match="nothing between"):
            load(files, stop=0.9)
        with pytest.raises(UsageError, match="does not come after"):
            load(files, start=5.0, stop=5.0)
        with pytest.raises(DataError, match="no instant with both odometry and ground truth"):
            load(files, exclude_truth=[(0.0, 100.0)])

    def test_excluded_truth_is_blank_there_and_nowhere_else(self, files, load):
        log = load(files, exclude_truth=[(4.0, 5.2), (8.0, 8.4)])
        t = starts_at(log) + log.recorded.time
        bad = ((t > 3.9999) & (t < 5.2001)) | ((t > 7.9999) & (t < 8.4001))
        assert log.truth.pose is not None
        np.testing.assert_array_equal(np.isnan(log.truth.pose).all(axis=1), bad)
        assert bad.any()
        assert len(log.recorded) == len(load(files).recorded)

    def test_truth_is_not_interpolated_across_more_than_a_second(self, files, load):
        lines = files[TRUTH].splitlines()
        header, rows = lines[:4], lines[4:]
        kept = rows[:100] + rows[125:]  # a gap from 4.95 to 6.25 s
        log = load({**files, TRUTH: "\n".join(header + kept) + "\n"})
        t = starts_at(log) + log.recorded.time
        assert log.truth.pose is not None
        np.testing.assert_array_equal(np.isnan(log.truth.pose[:, 0]), (t > 4.95) & (t < 6.25))


class TestTheGrid:
    def test_frames_are_a_grid_step_apart_and_readings_move_to_the_nearest(self, files, load):
        log = load(files, grid=0.03)
        np.testing.assert_allclose(np.diff(log.recorded.time), 0.03, atol=1e-9)
        assert 10.0 - 0.03 < log.recorded.time[-1] <= 10.0 + 1e-9
        rows = np.array([r[0] for r in world.measurement_rows() if r[1] >= 6])
        np.testing.assert_array_equal(log.recorded.observations.frame, np.rint((rows - 1.0) / 0.03))

    def test_odometry_is_interpolated_and_held_for_a_step(self, files, load):
        head = files[ODOMETRY].splitlines()[:4]
        ramp = [f"{world.T0 + 1.0 + k / 10:.3f} {0.01 * k:.3f} 0.000" for k in range(101)]
        log = load({**files, ODOMETRY: "\n".join(head + ramp) + "\n"}, grid=0.02)
        # v = 0.1 (t - 1) exactly, on the grid; each step goes as far as the speed at its beginning
        expected = 0.1 * log.recorded.time[:-1] * 0.02
        np.testing.assert_allclose(log.recorded.increments.mean[1:, 0], expected, atol=1e-9)

    def test_readings_older_than_0_05_s_at_their_frame_are_dropped(self, files, load):
        log = load(files, grid=0.5)
        rows = np.array([r[0] for r in world.measurement_rows() if r[1] >= 6])
        frame = np.rint((rows - 1.0) / 0.5)
        age = 1.0 + 0.5 * frame - rows
        np.testing.assert_array_equal(log.recorded.observations.frame, frame[age < 0.0501])
        assert noted(log, f"{int((age > 0.0501).sum())} observations more than 0.05 s before")

    @pytest.mark.parametrize("grid", [0.0, -1.0, 1.5, math.inf])
    def test_a_senseless_grid_is_refused(self, files, load, grid):
        with pytest.raises(UsageError, match="grid"):
            load(files, grid=grid)


class TestFaults:
    def fails(self, files, tmp_path, name, line, *words):
        with pytest.raises(DataError) as caught:
            load_mrclam(save_folder(tmp_path / "set", files), 1)
        message = str(caught.value)
        assert "\n" not in message
        assert f"{name}:{line}" in message
        for word in words:
            assert word in message

    @pytest.mark.parametrize("name", [TRUTH, ODOMETRY, MEASURED])
    def test_a_decreasing_stamp(self, files, tmp_path, name):
        rest = files[name].splitlines()[20].split(None, 1)[1]
        files[name], line = replace_row(files[name], 16, f"{world.T0 - 5:.3f} {rest}")
        self.fails(files, tmp_path, name, line, "column time", "1248272258.361", "must not decrease")

    @pytest.mark.parametrize("name", [TRUTH, ODOMETRY, MEASURED])
    def test_a_last_number_that_lost_its_tail(self, files, tmp_path, name):
        last = len(files[name].splitlines())
        files[name] = files[name].rstrip()[:-1]
        self.fails(files, tmp_path, name, last, "cut off")

    @pytest.mark.parametrize(("name", "row", "words"), [
        (MEASURED, "T 94 -0.5 0.1", ("column range", "negative")),
        (MEASURED, "T 94 0.5 nan", ("column bearing", "not a number")), (ODOMETRY, "T 0.1", ("2 fields where 3",)),
        (ODOMETRY, "T fast 0.2", ("column forward velocity", "'fast'")),
        (TRUTH, "T 0.1 inf 0.2", ("column y", "not a number")),
        ("Barcodes.dat", "6 63", ("column subject", "is in two rows")),
        ("Landmark_Groundtruth.dat", "3 1 2 0 0", ("column subject", "robot")),
    ])  # fmt: skip
    def test_a_wrong_row_is_named_with_line_and_column(self, files, tmp_path, name, row, words):
        stamp = files[name].splitlines()[14].split()[0]
        files[name], line = replace_row(files[name], 10, row.replace("T", stamp))
        self.fails(files, tmp_path, name, line, *words)

    def test_a_stamp_far_in_the_future(self, files, tmp_path):
        files[ODOMETRY], line = replace_row(files[ODOMETRY], -1, "9248272263.361 0.4 0.2")
        self.fails(files, tmp_path, ODOMETRY, line, "9248272263.361", "seconds")
