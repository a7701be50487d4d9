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
