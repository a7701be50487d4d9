"""Trajectories in the formats of others, each the same path; what lies outside the plane is stated."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.errors import UsageError
from data.formats.results.path import ROBOT, Manner
from data.formats.results.reading import read_path
from data.formats.results.space import projection

TIME = np.array([1403636579.763555584, 1403636579.813555456, 1403636580.263555584])
POSE = np.array([[1.0, 2.0, 0.1], [1.5, -2.0, 3.1], [2.0, 0.5, -3.1]])


def quaternions(heading):
    return np.sin(heading / 2), np.cos(heading / 2)


def tum(folder):
    s, c = quaternions(POSE[:, 2])
    rows = ["# timestamp tx ty tz qx qy qz qw", ""]
    rows += [f"{t!r} {p[0]} {p[1]} 0.5 0 0 {a} {b}" for t, p, a, b in zip(TIME.tolist(), POSE, s, c)]
    (folder / "a.txt").write_text("\n".join(rows) + "\n")
    return "a.txt", Manner()


def euroc(folder):
    s, c = quaternions(POSE[:, 2])
    stamps = ["1403636579763555584", "1403636579813555456", "1403636580263555584"]
    rows = ["#timestamp [ns], p_RS_R_x [m], ..., q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_x"]
    rows += [f"{t},{p[0]},{p[1]},0.5,{b},0,0,{a},0.3,0,0" for t, p, a, b in zip(stamps, POSE, s, c)]
    (folder / "a.csv").write_text("\n".join(rows) + "\n")
    return "a.csv", Manner()


def kitti(folder):
    rows = []
    for x, y, h in POSE:
        R = [[math.cos(h), -math.sin(h), 0.0], [math.sin(h), math.cos(h), 0.0], [0.0, 0.0, 1.0]]
        rows.append(" ".join(repr(v) for row, t in zip(R, (x, y, 0.5)) for v in (*row, float(t))))
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    (folder / "times.txt").write_text("".join(f"{t!r}\n" for t in TIME.tolist()))
    return "poses.txt", Manner(times=folder / "times.txt", axes=ROBOT)


def camera(folder):
    """The same in a camera's axes: right, down, forward."""
    from_camera = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    rows = []
    for x, y, h in POSE:
        R = np.array([[math.cos(h), -math.sin(h), 0.0], [math.sin(h), math.cos(h), 0.0], [0.0, 0.0, 1.0]])
        T = np.column_stack([from_camera.T @ R @ from_camera, from_camera.T @ [x, y, 0.5]])
        rows.append(" ".join(repr(float(v)) for v in T.ravel()))
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    (folder / "times.txt").write_text("".join(f"{t!r}\n" for t in TIME.tolist()))
    return "poses.txt", Manner(times=folder / "times.txt")  # KITTI's own axes


def ours(folder):
    rows = ["t,x,y,theta", *(f"{t!r},{p[0]},{p[1]},{p[2]}" for t, p in zip(TIME.tolist(), POSE))]
    (folder / "final.csv").write_text("\n".join(rows) + "\n")
    return "final.csv", Manner()


@pytest.mark.parametrize("write", [tum, euroc, kitti, camera, ours])
def test_every_format_is_recognized_by_its_content(write, tmp_path):
    name, manner = write(tmp_path)
    other = tmp_path / "renamed.data"  # the ending says nothing
    (tmp_path / name).rename(other)
    path = read_path(str(other), manner)
    assert path.time == pytest.approx(TIME, abs=3e-7)
    assert path.pose == pytest.approx(POSE, abs=1e-12)
    said = projection(path)
    assert said == ("" if write is ours else "projected to the plane: z 0.5 to 0.5 m ignored")


def test_columns_of_ours_come_in_any_order_and_a_pose_may_be_blank(tmp_path):
    (tmp_path / "a").write_text("theta,x,t,y,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n0.1,1,0,2,4,1,0,3,0,1\n,,1,,,,,,,\n")
    path = read_path(str(tmp_path / "a"))
    assert path.pose[0].tolist() == [1.0, 2.0, 0.1]
    assert path.covariance[0].tolist() == [[4.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 1.0]]
    assert np.isnan(path.pose[1]).all()


def test_of_poses_with_one_stamp_the_last_counts(tmp_path):
    (tmp_path / "a").write_text("t,x,y,theta\n0,1,0,0\n0,2,0,0\n1,3,0,0\n")
    path = read_path(str(tmp_path / "a"))
    assert path.pose[:, 0].tolist() == [2.0, 3.0]
    assert path.notes[0].startswith("1 poses share their stamp")


T = "0 0 0 0 0 0 0 1"
FAULTS = {
    "cut": (f"{T}\n1 0 0 0 0 0\n", ":2: 6 fields; 8 are needed (the file ends here: was it cut off?)"),
    "nan": ("0 nan 0 0 0 0 0 1\n1 nan 0 0 0 0 0 1\n", ": each of 2 poses has a NaN; at least one without is needed"),
    "back": (f"# TUM\n1{T[1:]}\n{T}\n", ":3: stamp 0.0 is before 1.0"),
    "back, EuRoC": (
        "1403636579763555584,0,0,0,1,0,0,0\n1403636578763555584,0,0,0,1,0,0,0\n", ":2: stamp 14036365787",
    ),
    "quaternion": (f"{T}\n1 0 0 0 0 0 0 0\n", ":2: quaternion [0.0, 0.0, 0.0, 0.0] has length 0"),
    "strange": ("1 2 3\n", ":1: 3 fields, '1,2,3': no known trajectory format; a CSV with"),
    "covariance": ("t,x,y,theta,c_xx\n0,1,2,3,4\n", ":1: column c_xy: no such column, but c_xx"),
    "negative": ("t,x,y,theta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n0,0,0,0,1,0,0,1,0,-2\n", ":2: covariance of x, y"),
    "square": (f"#%FORMAT SQUARE/0.3\n#%REPRESENTATION gaussian_se3\n{T}\n", "the header lacks TANGENT_CONVENTION"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_is_named_with_its_line(fault, tmp_path):
    from data.errors import DataError

    text, wanted = FAULTS[fault]
    (tmp_path / "a").write_text(text)
    with pytest.raises(DataError) as error:
        read_path(str(tmp_path / "a"))
    assert str(error.value).startswith(str(tmp_path / "a"))
    assert wanted in str(error.value)


def test_what_a_file_does_not_say_must_be_said_and_nothing_else(tmp_path):
    name, _ = kitti(tmp_path)
    with pytest.raises(UsageError, match="--times FILE names them"):
        read_path(str(tmp_path / name), Manner(stamps="ns"))
    name, _ = tum(tmp_path)
    for manner, wanted in (
        (Manner(times=tmp_path / "times.txt"), "KITTI poses are needed"),
        (Manner(frame="local"), "has no covariance"),
    ):
        with pytest.raises(UsageError, match=wanted):
            read_path(str(tmp_path / name), manner)
    name, _ = ours(tmp_path)
    with pytest.raises(UsageError, match=r"--cov .*a TUM file"):
        read_path(str(tmp_path / name), Manner(cov=tmp_path / "a.txt"))
