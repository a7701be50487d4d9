"""Results whose stamps, formats or headings are not what they seem: asked for, refused or said."""

from __future__ import annotations

import numpy as np
import pytest

from tests.eval.test_score_faults import lines, scored

__all__ = ["scored"]

N = 300
TIME = 1_500_000_000.25 + 0.1 * np.arange(N)
PATH = np.column_stack([3.0 * np.cos(0.02 * np.arange(N)), 3.0 * np.sin(0.02 * np.arange(N))])
YAW = 0.5 * np.pi + 0.02 * np.arange(N)


def tum(time, path=PATH, yaw=YAW):
    zero = np.zeros(len(path))
    return lines(np.column_stack([time, path, zero, zero, zero, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]))


@pytest.mark.parametrize("of", ["estimate", "truth"])
@pytest.mark.parametrize(("stamps", "why"), [(np.floor(TIME), "whole seconds"), (np.full(N, TIME[0]), "all are equal"),
                                             (np.round(TIME / 3) * 3 + 0.5, "few digits")])  # fmt: skip
def test_stamps_that_do_not_tell_poses_apart_are_refused(scored, of, stamps, why):
    files = (tum(stamps), tum(TIME)) if of == "estimate" else (tum(TIME), tum(stamps))
    said = scored(*files, status=2)
    assert f"have the stamp of the next one ({why})" in said
    assert said.count("\n") == 1


def test_poses_that_are_repeated_are_merged(scored):
    text = tum(np.repeat(TIME, 2), np.repeat(PATH, 2, axis=0), np.repeat(YAW, 2))
    assert scored(text, tum(TIME))[0]["matched"] == N


@pytest.mark.parametrize(("step", "matched"), [(1.0009, 291), (2.0, 281), (30.0, 1)])
def test_the_largest_gap_follows_from_the_rate_of_the_truth(scored, step, matched):
    at = np.arange(TIME[0], TIME[-1], step)
    k = (at - TIME[0]) / 0.1
    truth = tum(at, 3.0 * np.column_stack([np.cos(0.02 * k), np.sin(0.02 * k)]), 0.5 * np.pi + 0.02 * k)
    assert scored(tum(TIME), truth)[0]["matched"] == matched


def matrices(separator):
    c, s = np.cos(YAW), np.sin(YAW)
    zero, one = np.zeros(N), np.ones(N)
    rows = np.column_stack([c, -s, zero, PATH[:, 0], s, c, zero, PATH[:, 1], zero, zero, one, zero])
    stamps = [str(round(t * 1e9)) for t in TIME]
    return "".join(separator.join([t, *map(repr, map(float, row))]) + "\n" for t, row in zip(stamps, rows, strict=True))


def echoed():
    """`rostopic echo -p` of nav_msgs/Odometry."""
    position, turn = "field.pose.pose.position.", "field.pose.pose.orientation."
    names = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id", "field.child_frame_id"]
    names += [position + a for a in "xyz"] + [turn + a for a in "xyzw"]
    names += [f"field.pose.covariance{k}" for k in range(36)]
    names += [f"field.twist.twist.{of}.{a}" for of in ("linear", "angular") for a in "xyz"]
    names += [f"field.twist.covariance{k}" for k in range(36)]
    P, rows = (0.01 * np.eye(6)).ravel().tolist(), []
    for k in range(N):
        stamp = str(round(TIME[k] * 1e9))
        pose = [*PATH[k], 0, 0, 0, np.sin(0.5 * YAW[k]), np.cos(0.5 * YAW[k])]
        rows.append([stamp, k, stamp, "odom", "base_link", *pose, *P, 1, 0, 0, 0, 0, 0.1, *P])
    return "\n".join(",".join(map(str, row)) for row in [names, *rows]) + "\n"


@pytest.mark.parametrize("text", [
    matrices(","), matrices(" "), echoed(), tum(TIME).replace(" ", "\t", 900),
    "t,x,y,yaw\n" + "".join(f"{t},{x},{y},{a},\n" for t, (x, y), a in zip(TIME, PATH, YAW, strict=True)),
], ids=["MulRan", "stamped KITTI", "rostopic echo", "tab beside space", "trailing comma"])  # fmt: skip
def test_a_format_is_known_by_its_whole_grammar(scored, text):
    values, asked, _ = scored(text, tum(TIME))
    assert values["matched"] == N
    assert max(values["rmse_position_m"], values["rmse_heading_deg"]) < 1e-6
    assert not asked


def test_numbers_that_are_no_poses_are_asked_for(scored):
    rows = "".join(f"{round(t * 1e9)},{x},{y},0,0.5,0.2,0.1,0.3\n" for t, (x, y) in zip(TIME, PATH, strict=True))
    assert "no known trajectory format" in scored(rows, tum(TIME), status=2)


def quaternions(x, y, z, w):
    return lines(np.column_stack([TIME, PATH, np.zeros(N), np.tile([x, y, z, w], (N, 1))]))


def rows(names, *columns):
    return names + "\n" + "\n".join(",".join(map(str, row)) for row in zip(*columns, strict=True)) + "\n"


@pytest.mark.parametrize("truth", [
    quaternions(0, 0, 0, 1), quaternions(0, 0, 0, 0), rows("t,x,y", TIME, *PATH.T),
    rows("timestamp [s],east,north,x,y,z", TIME, *PATH.T, *PATH.T, np.zeros(N)),
    rows("t,x,y,theta", TIME, *PATH.T, [""] * N),
], ids=["identity", "zeros", "no column", "prism", "blank"])  # fmt: skip
def test_a_heading_that_no_file_holds_is_absent_and_the_position_scored(scored, truth):
    variance = [np.full(N, v) for v in (0.04, 0, 0, 0.04, 0, 0.01)]
    estimate = rows("t,x,y,theta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt", TIME, *(PATH + 0.2).T, YAW, *variance)
    values, _, said = scored(estimate, truth)
    assert said.count("no heading in this file: positions alone are scored") == 1
    assert values["rmse_position_m"] == pytest.approx(0.2 * np.sqrt(2), abs=1e-6)
    assert values["nees_position"] == pytest.approx(2.0)
    assert not {"rmse_heading_deg", "rpe_frame_deg", "nees_pose", "nees_heading"} & set(values)
    assert scored(estimate, truth, "--align", "se2")[0]["rmse_position_m"] < 0.01


def test_headings_are_there_where_a_robot_drives_ahead(scored):
    straight = lines(np.column_stack([TIME, 0.1 * np.arange(N), *np.tile([0, 0, 0, 0, 0, 1.0], (N, 1)).T]))
    assert scored(straight, straight)[0]["rmse_heading_deg"] == 0.0
