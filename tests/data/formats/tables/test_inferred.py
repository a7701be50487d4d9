"""What only one reading of the data explains is read so, and said: units of headings, several observations in a row."""

import numpy as np
import pytest

from data.convert.__main__ import main
from data.formats.open_log import load_folder
from data.origin import Origin
from data.se2 import wrap_angle

BASE = 0.5  # m, between the axles


@pytest.fixture
def world():
    """Stamps, speeds, steering angles, poses, and landmarks of a car."""
    t = np.arange(300) * 0.1
    v, steering = 1.0 + 0.2 * np.sin(0.2 * t), 0.2 * np.cos(0.05 * t)
    omega = v * np.tan(steering) / BASE
    theta = np.concatenate([[0.0], np.cumsum(0.1 * omega[:-1])])
    middle = theta[:-1] + 0.05 * omega[:-1]
    way = 0.1 * v[:-1] * np.sinc(0.05 * omega[:-1] / np.pi)
    x, y = (np.concatenate([[0.0], np.cumsum(way * f(middle))]) for f in (np.cos, np.sin))
    return t, v, steering, np.column_stack([x, y, theta]), np.array([[3.0, 4.0], [-2.0, 5.0], [6.0, 1.0], [1.0, -3.0]])


@pytest.fixture
def converted(world, tmp_path, capsys, refused):
    """`converted(names, columns, *flags)`: the log of an odometry, and what is said; two observations in each row."""
    t, _, _, pose, places = world
    rows = []
    for k in range(0, 300, 10):
        off = places - pose[k, :2]
        seen = np.column_stack([range(4), np.hypot(*off.T), wrap_angle(np.arctan2(off[:, 1], off[:, 0]) - pose[k, 2])])
        rows.append([t[k], *seen[np.argsort(seen[:, 1])[:2]].ravel()])
    seen = "time,id_1,range_1,bearing_1,id_2,range_2,bearing_2"
    np.savetxt(tmp_path / "seen.csv", rows, "%.9g", ",", header=seen, comments="")
    degrees = np.column_stack([t, pose * [1.0, 1.0, np.rad2deg(1.0)]])
    np.savetxt(tmp_path / "truth.csv", degrees, "%.9g", ",", header="time,x,y,yaw", comments="")

    def run(names, columns, *flags, status=0):
        np.savetxt(tmp_path / "odometry.csv", np.column_stack(columns), "%.9g", ",", header=names, comments="")
        files = ["--observations", str(tmp_path / "seen.csv"), "--truth", str(tmp_path / "truth.csv")]
        given = ["table", str(tmp_path / "odometry.csv"), str(tmp_path / "log"), *files, *flags]
        if status:
            return refused(lambda words: main(words, "slamref convert"), given)
        assert main(given, "slamref convert") == 0
        return load_folder(tmp_path / "log"), capsys.readouterr().out

    return run


def test_speed_and_steering_of_a_car(converted, world):
    t, v, steering, pose, places = world
    error = converted("time,speed,steer_deg", (t, v, np.rad2deg(steering)), status=2)
    assert "--wheel-base" in error
    log, said = converted("time,speed,steer_deg", (t, v, np.rad2deg(steering)), "--wheel-base", "50cm")
    assert "warning" not in said
    np.testing.assert_allclose(log.truth.pose[:30, 2], wrap_angle(pose[::10, 2]), atol=1e-6)
    step = log.recorded.increments.mean[1:30]
    np.testing.assert_allclose(step[:, 2], np.diff(pose[::10, 2]), atol=1e-6)
    assert log.origins["units"] is Origin.INFERRED
    assert "inferred: --unit truth.theta=deg" in said
    # each row holds two observations, whose ids name the landmarks
    assert len(log.recorded.observations.z) == 60
    for frame, z, label in zip(log.recorded.observations.frame, log.recorded.observations.z, log.label, strict=True):
        assert z[0] == pytest.approx(np.hypot(*(places[label] - pose[10 * frame, :2])), abs=1e-6)


def test_headings_in_degrees_that_are_stated_otherwise_are_asked_about(converted, world):
    t, v, steering, _, _ = world
    flags = ("--wheel-base", "0.5", "--unit", "truth.theta=rad,observations.bearing=rad")
    log, said = converted("time,speed,steering", (t, v, steering), *flags)
    assert "heading unit" in said
    assert log.origins["units"] is Origin.GIVEN


def test_steps_without_a_sideways_motion(converted, world):
    t, _, _, pose, _ = world
    way, turn = np.hypot(*np.diff(pose[:, :2], axis=0, prepend=pose[:1, :2]).T), np.diff(pose[:, 2], prepend=0.0)
    log, said = converted("time,d,delta_theta", (t, way, turn))
    assert "assumed: steps have no dy" in said
    assert "warning" not in said
    np.testing.assert_allclose(log.recorded.increments.mean[1:30, 2], np.diff(pose[::10, 2]), atol=1e-6)


def test_fixes_tell_the_start_and_files_side_by_side_are_one_table(world, tmp_path, capsys):
    t, v, _, pose, _ = world
    for name, column in (("clock", t), ("speed", v), ("turn", np.gradient(pose[:, 2], t))):
        np.savetxt(tmp_path / f"{name}.txt", column)
    c, s = np.cos(0.7), np.sin(0.7)
    moved = pose[:, :2] @ [[c, s], [-s, c]] + [5.0, -3.0]
    np.savetxt(tmp_path / "gps.csv", np.column_stack([t, moved])[::10], "%.9g", ",", header="t,x,y", comments="")
    words = [str(tmp_path / "clock.txt") + "+speed.txt+turn.txt", str(tmp_path / "log"), "--fixes"]
    words += [str(tmp_path / "gps.csv"), "--columns", "odometry.t=clock,v=speed,omega=turn"]
    assert main(["table", *words], "slamref convert") == 2  # of assumed noise the way is too short
    assert main(["table", *words, "--fix-sigma", "5cm,5cm"], "slamref convert") == 0
    log, said = load_folder(tmp_path / "log"), capsys.readouterr().out
    assert log.recorded.prior.mean == pytest.approx([5.0, -3.0, 0.7], abs=0.05)
    assert log.origins["prior"] is Origin.INFERRED
    assert "inferred: --prior=" in said


def test_a_folder_of_observations_a_file_for_each_row(world, tmp_path):
    """Rows without stamps at a stated period; observations are points in the sensor's frame."""
    t, v, _, pose, places = world
    np.savetxt(tmp_path / "control.txt", np.column_stack([v, np.gradient(pose[:, 2], t)]))
    (tmp_path / "seen").mkdir()
    for k, (x, y, theta) in enumerate(pose):
        c, s = np.cos(theta), np.sin(theta)
        near = (places - [x, y]) @ [[c, -s], [s, c]]
        np.savetxt(tmp_path / "seen" / f"{k:05d}.txt", near[: 1 + k % 3])
    names = "odometry.v=1,odometry.omega=2,observations.x=1,observations.y=2"
    words = [str(tmp_path / "control.txt"), str(tmp_path / "log"), "--observations", str(tmp_path / "seen")]
    assert main(["table", *words, "--columns", names, "--period", "0.1s"], "slamref convert") == 0
    log = load_folder(tmp_path / "log")
    assert len(log.recorded.observations.z) == sum(1 + k % 3 for k in range(300))
    assert log.recorded.time[-1] == pytest.approx(29.9)
