"""An open log folder says what it means."""

import dataclasses
import math

import numpy as np
import pytest

from data.errors import DataError
from data.formats.open_log import read_relations, write_folder
from data.inputs import CLUTTER, UNLABELLED
from data.motion.velocity import VelocityModel, VelocityNoise, floor_covariances, preintegrate
from data.sensors import RangeBearing, RelativePoint
from data.truth import UNKNOWN_ID
from tests.data.formats.open_log.same_log import assert_same_log, load


def test_frames_folder_is_read_as_written(small_log_files, save, tmp_path):
    log = load(save(tmp_path / "any", small_log_files("frames", "relative_point")))
    inputs = log.recorded
    assert log.name == "small"
    assert log.labels_are_sensed
    assert log.source == {"maker": "hand"}
    assert log.notes[0] == "made by hand"
    assert inputs.time.tolist() == [0.0, 0.5, 1.25, 2.0]
    assert inputs.increments.mean[2].tolist() == [0.5, -0.02, -0.3]
    assert inputs.increments.covariance[1].tolist() == [[1e-3, 1e-4, 0], [1e-4, 2e-3, 1e-5], [0, 1e-5, 1e-4]]
    assert inputs.observations.frame.tolist() == [0, 1, 1, 3]
    assert inputs.observations.z[1].tolist() == [1.5, -0.75]
    assert inputs.observations.R[0].tolist() == [[0.01, 0.001], [0.001, 0.02]]
    assert log.truth.landmark_of.tolist() == [3, CLUTTER, UNKNOWN_ID, 7]
    assert log.label.tolist() == [3, 7, UNLABELLED, CLUTTER]
    assert inputs.prior.mean.tolist() == [1.0, 2.0, 0.5]
    assert inputs.prior.covariance.tolist() == [[0.02, 0.01, 0], [0.01, 0.02, 0], [0, 0, 0.01]]
    assert inputs.sensor == RelativePoint(8.0, -1.0, 2.0, 0.1, (0.2, -0.1))
    assert np.array_equal(log.truth.pose[:2], [[1, 2, 0.5], [1.2, 2.1, 0.6]])
    assert np.isnan(log.truth.pose[2:]).all()


def test_a_simulated_map_may_state_where_its_landmarks_truly_are(small_log_files, save, tmp_path):
    files = small_log_files("frames", "range_bearing")
    files["landmarks.csv"] = "id,x,y,sx,sy,true_x,true_y\n7,4.5,1.25,0.1,0.2,4.4,1.5\n3,-2.5,3,0,,,\n"
    log = load(save(tmp_path, files))
    assert log.recorded.map.sigma.tolist() == [[0.0, 0.0], [0.1, 0.2]]
    assert log.recorded.map.xy.tolist() == [[-2.5, 3.0], [4.5, 1.25]]
    assert (log.truth.landmarks.id.tolist(), log.truth.landmarks.xy.tolist()) == ([7], [[4.4, 1.5]])


def test_odometry_folder_has_a_frame_at_each_observation_and_no_long_gap(small_log_files, save, tmp_path):
    log = load(save(tmp_path, small_log_files("odometry", "range_bearing")))
    inputs = log.recorded
    # first odometry 10, observations 10.25 and 12, last observation 13.75; two keyframes cut 1.75 s in two, twice
    assert inputs.time.tolist() == [10.0, 10.25, 11.125, 12.0, 12.875, 13.75]
    assert inputs.observations.frame.tolist() == [1, 1, 3, 5]
    model = VelocityModel(VelocityNoise("density", sigma=(0.05, 0.02)))
    t, v, w = np.array([[10, 0.5, 0.1], [10.5, 0.6, -0.2], [11, 0, 0], [13.25, 0.4, 0.3], [13.5, 0.4, 0.3]]).T
    expected, gaps = preintegrate(model, t, v, w, inputs.time)
    assert np.array_equal(inputs.increments.mean, expected.mean)
    assert np.array_equal(inputs.increments.covariance, floor_covariances(expected.covariance, 1e-10)[0])
    assert gaps == 1
    assert any("1 gap longer" in note for note in log.notes)


def test_stamped_truth_is_interpolated_at_frames_where_it_is_known_around_them(small_log_files, save, tmp_path):
    pose = load(save(tmp_path, small_log_files("odometry", "range_bearing"))).truth.pose
    # rows at 11 (blank) and a gap from 11.5 to 13.4 leave 11.125, 12 and 12.875 unknown
    assert np.isnan(pose[:, 0]).tolist() == [False, False, True, True, True, False]
    assert pose[1] == pytest.approx([1.1, 2.05, math.pi])
    assert pose[5] == pytest.approx([1.7, 2.2, -2.8])


def test_observations_whose_motion_no_odometry_tells_are_left_out_and_counted(small_log_files, save, tmp_path):
    files = small_log_files("odometry", "range_bearing")
    files["observations.csv"] = "t,z1,z2\n9.5,1,0\n11,2,0\n15,1,0\n"
    del files["truth.csv"]
    log = load(save(tmp_path, files))
    assert log.recorded.observations.z[:, 0].tolist() == [2.0]
    assert log.recorded.time[0] == 10.0
    assert any(note.startswith("observations.csv: 2 of 3 rows before or after all odometry") for note in log.notes)


def test_everything_optional_may_be_absent(save, tmp_path):
    toml = 'format = 1\nname = "least"\n[prior]\nmean = [0, 0, 0]\nsigma = [0, 0, 0]\n'
    toml += '[sensor]\nkind = "range_bearing"\nsigma = [0.1, 0.1]\n'
    header = "t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n"
    files = {"log.toml": toml, "frames.csv": header + "0" + ",0" * 9, "observations.csv": "frame,z1,z2\n"}
    log = load(save(tmp_path, files))
    assert log.recorded.map is None
    assert log.label is None
    assert (log.truth.pose, log.truth.landmarks, log.truth.landmark_of) == (None, None, None)
    assert not log.has_labels
    assert len(log.recorded.observations.frame) == 0
    assert log.recorded.sensor == RangeBearing()
    assert log.recorded.covariance_floor == 1e-10
    write_folder(log, tmp_path / "again")
    again = load(tmp_path / "again").truth
    assert (again.pose, again.landmarks, again.landmark_of) == (None, None, None)


@pytest.mark.parametrize("source", ["frames", "odometry"])
def test_byte_order_mark_crlf_and_blank_lines_at_the_end_change_nothing(small_log_files, save, tmp_path, source):
    files = small_log_files(source, "range_bearing")
    plain = load(save(tmp_path / "plain", files))
    dressed = {
        name: b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode() + b"\r\n\r\n" if name.endswith(".csv") else text
        for name, text in files.items()
    }
    assert_same_log(load(save(tmp_path / "dressed", dressed)), plain)


def test_columns_come_in_any_order_and_unknown_ones_are_named_in_a_note(small_log_files, save, tmp_path):
    files = small_log_files("frames", "relative_point")
    plain = load(save(tmp_path / "plain", files))
    rows = [line.split(",") for line in files["observations.csv"].splitlines()]
    files["observations.csv"] = "\n".join(
        ",".join([*row[::-1], "colour" if i == 0 else "red"]) for i, row in enumerate(rows)
    )
    shuffled = load(save(tmp_path / "shuffled", files))
    assert any("not used: colour" in note for note in shuffled.notes)
    assert_same_log(dataclasses.replace(shuffled, notes=plain.notes), plain)


@pytest.mark.parametrize(("shift", "rows"), [(0.0, [(0, 3), (2, 1)]), (0.01, [(0, 3), (2, 1)]), (500.0, None)])
def test_relations_as_published_are_tied_to_frames_by_their_stamps(tmp_path, shift, rows):
    stamp = 976052857.0 + np.array([0.0, 0.5, 1.0, 1.5])
    lines = [(stamp[i] + shift, stamp[j] + shift, 1.0, 0.2, 0, 0, 0, 0.1) for i, j in [(0, 3), (2, 1)]]
    path = tmp_path / "lab.relations"
    path.write_text("".join(" ".join(f"{v:.6f}" for v in line) + "\n" for line in lines))
    if rows is None:
        with pytest.raises(DataError, match="no relation lies within it"):
            read_relations(path, 4, stamp)
        return
    found = read_relations(path, 4, stamp)
    assert list(zip(found.row1.tolist(), found.row2.tolist(), strict=True)) == rows
    assert found.relative.tolist() == [[1.0, 0.2, 0.1]] * 2
    assert found.exact.tolist() == [int(shift == 0.0)] * 2
