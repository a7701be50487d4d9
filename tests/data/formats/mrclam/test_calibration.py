"""UTIAS MRCLAM: corrections of odometry and camera, the survey of landmarks, logs without truth."""

import math

import numpy as np
import pytest

from data.errors import UsageError
from data.formats.mrclam import Calibration
from data.truth_windows import misplaced
from tests.data.formats.mrclam.world import MEASURED, TRUTH, exchange, noted


def test_without_ground_truth_the_robot_is_in_its_own_frame(files, load):
    del files[TRUTH]
    log = load(files)
    assert log.truth.pose is None
    np.testing.assert_array_equal(log.recorded.prior.mean, 0.0)
    assert log.recorded.map is None
    assert log.truth.landmarks is None
    assert noted(log, "No ground truth", "map is withheld")


class TestCalibration:
    def test_a_late_camera_is_undone(self, files, load):
        late = files[MEASURED].splitlines()
        for i, line in enumerate(late[4:], start=4):
            stamp, rest = line.split(None, 1)
            late[i] = f"{float(stamp) + 0.1:.3f} {rest}"
        log = load({**files, MEASURED: "\n".join(late) + "\n"}, calibration=Calibration(latency=0.1))
        exact = load(files)
        np.testing.assert_allclose(log.recorded.time, exact.recorded.time, atol=2e-6)
        np.testing.assert_array_equal(log.recorded.observations.frame, exact.recorded.observations.frame)
        np.testing.assert_allclose(log.truth.pose, exact.truth.pose, atol=1e-6)  # type: ignore[arg-type]

    def test_scales_and_biases_are_undone(self, files, load):
        calibration = Calibration(scale_v=1.1, scale_omega=0.5, range_scale=0.9, range_bias=0.3, bearing_bias=0.2)
        log, exact = load(files, calibration=calibration), load(files)
        r, b = exact.recorded.observations.z.T
        np.testing.assert_allclose(log.recorded.observations.z, np.stack([(r - 0.3) / 0.9, b - 0.2], axis=-1))
        turned = exact.recorded.increments.mean[:, 2]
        np.testing.assert_allclose(log.recorded.increments.mean[:, 2], 0.5 * turned, atol=1e-12)

    def test_a_turn_limit_holds_only_commands_beyond_it(self):
        v, omega = Calibration(turn_limit=0.5).velocities(np.ones(4), np.array([0.4, -0.5, 0.9, -2.0]))
        assert omega.tolist() == [0.4, -0.5, 0.5, -0.5]
        assert v.tolist() == [1.0, 1.0, 1.0, 1.0]

    def test_a_turning_robot_is_slower_in_either_direction_and_never_reverses(self):
        drag = Calibration(turn_drag=0.5, turn_limit=1.0)
        v, _ = drag.velocities(np.array([1.0, 1.0, -1.0, 0.1, 0.0]), np.array([0.4, -9.0, 0.4, 1.0, 1.0]))
        assert v.tolist() == [0.8, 0.5, -0.8, 0.0, 0.0]

    def test_depth_along_the_axis_becomes_range(self, files, load):
        log, exact = load(files, calibration=Calibration(range_is_depth=True)), load(files)
        r, b = exact.recorded.observations.z.T
        np.testing.assert_allclose(log.recorded.observations.z, np.stack([r / np.cos(b), b], axis=-1))
        assert np.abs(b).max() > 0.1

    def test_a_command_acts_from_halfway_to_the_stamp_before(self):
        stamps = np.array([1.0, 1.0, 1.2, 4.2])
        assert Calibration(midpoint_hold=True, odometry_delay=0.1).instants(stamps) == pytest.approx(
            [1.1, 1.1, 1.2, 3.8]
        )
        assert Calibration(odometry_delay=0.1).instants(stamps) == pytest.approx(stamps + 0.1)

    def test_noise_grows_with_the_measured_range(self, files, load):
        log = load(files, calibration=Calibration(sigma_range=0.1, sigma_range_growth=0.2, sigma_bearing=0.3))
        o = log.recorded.observations
        np.testing.assert_allclose(o.R[:, 0, 0], (0.1 + 0.2 * o.z[:, 0]) ** 2)
        np.testing.assert_allclose(o.R[:, 1, 1], 0.09)
        np.testing.assert_array_equal(o.R[:, 0, 1], 0.0)

    @pytest.mark.parametrize(
        "wrong", [{"range_scale": 0.0}, {"sigma_range": -1.0}, {"latency": math.inf}, {"turn_limit": 0.0}]
    )
    def test_senseless_numbers_are_refused(self, wrong):
        with pytest.raises(UsageError, match=next(iter(wrong))):
            Calibration(**wrong)  # type: ignore[arg-type]


class TestLandmarks:
    def test_exchanged_rows_are_noticed_and_named(self, files, load):
        assert misplaced(load(files)) == ()
        # two of the landmarks that are seen most often
        log = load({**files, "Landmark_Groundtruth.dat": exchange(files["Landmark_Groundtruth.dat"], 20, 7)})
        assert [(row.id, row.at) for row in misplaced(log)] == [(7, 20), (20, 7)]
