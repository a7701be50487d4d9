"""slamref score: numbers of metrics.csv, verdicts on many runs, the border of a truth."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import slamref
from data.logs import open_log
from eval.referee.consistency import nees, verdict
from eval.referee.score import Trial, score
from eval.replay.run import compare
from eval.report.publish import trajectory_table, write_run, write_tum
from eval.score import main
from tests.eval.test_score_faults import lines as rows_of, scored
from tests.quick import slow


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder of runs of an arena, and its rows of metrics.csv."""
    folder = tmp_path_factory.mktemp("score")
    log = open_log("arena:1")
    trial = Trial(log, "slam", tuple(compare(log.inputs(labels=True), "slam", ("ekf", "batch"))))
    for run in trial.runs:
        write_run(folder, trial, run)
    write_tum(folder / "truth.tum", log.recorded.time, log.truth.pose)
    return folder, score([trial]).metrics


def lines(capsys):
    return {line.split()[0]: line.split(maxsplit=1)[1] for line in capsys.readouterr().out.splitlines()}


def test_numbers_are_those_of_the_run_with_six_digits(made, capsys):
    folder, metrics = made
    for name, phase, row in (("ekf", "online", 0), ("batch", "final", 1)):
        assert main([str(folder / f"runs/arena_1/slam-{name}-known/{phase}.csv"), str(folder / "truth.tum")]) == 0
        said = lines(capsys)
        assert next(iter(said)) == "rmse_position_m"
        assert said["matched"] == "200"
        shared = [c for c in said if c in metrics and c not in ("matched", "unmatched")]
        assert {"nees_pose", "rpe_10m_m", "inside_3sigma", "log_score"} <= set(shared)
        for column in shared:
            assert float(said[column]) == pytest.approx(metrics[column][row], rel=5e-6, abs=1e-12), column


def test_the_command_and_a_log_as_truth(made, capsys):
    folder, _ = made
    estimate = str(folder / "runs/arena_1/slam-ekf-known/online.tum")
    assert slamref.main(["score", estimate, "arena:1"]) == 0
    first = lines(capsys)
    assert main([estimate, str(folder / "truth.tum")]) == 0
    assert first.items() <= lines(capsys).items()  # a log's truth is in the plane
    assert "nees_pose" not in first  # there is no covariance


def test_alignment_is_only_done_if_asked(made, capsys):
    folder, metrics = made
    files = [str(folder / "runs/arena_1/slam-ekf-known/online.tum"), str(folder / "truth.tum")]
    assert main([*files, "--align", "se2"]) == 0
    captured = capsys.readouterr()
    assert f"rmse_position_m {metrics['rmse_aligned_m'][0]:.6g}\n" in captured.out
    assert "best rigid fit" in captured.err


@pytest.mark.parametrize(("files", "wanted"), [
    (["a"], "1 file without --truth: type ESTIMATE TRUTH"), (["a", "b", "c"], "3 files without --truth"),
    (["a", "b", "c", "--truth", "d", "e"], "2 truths for 3 estimates"),
    (["a", "b", "--align", "zzz"], "--align 'zzz': unknown; known: none, first, shift, se2, se3, sim3, yaw"),
    (["/nowhere/a.tum", "/nowhere/b.tum"], "no such"),
])  # fmt: skip
def test_what_makes_no_sense_is_one_line_and_status_2(files, wanted, refused):
    assert wanted in refused(main, files)


def simulated(folder, runs, claimed):
    """Errors of 0.1 m and 0.02 rad, white, with a covariance claimed `claimed` times the true one."""
    rng = np.random.default_rng(5)
    time, P = np.arange(40.0), np.diag([0.01, 0.01, 0.0004])
    means = []
    for k in range(runs):
        truth = np.column_stack([time, 0.1 * time, np.zeros(40)])
        pose = truth + rng.multivariate_normal(np.zeros(3), P, 40)
        covariance = np.tile(claimed * P, (40, 1, 1))
        place = folder / f"{k:02d}"
        place.mkdir()
        from data.result import Trajectory

        trajectory_table(time, Trajectory(pose, covariance)).to_csv(place / "est.csv", index=False)
        pd.DataFrame(np.column_stack([time, truth]), columns=["t", "x", "y", "theta"]).to_csv(
            place / "truth.csv", index=False
        )
        means.append(nees(pose, covariance, truth, "pose").mean())
    files = sorted(str(f) for f in folder.glob("*/est.csv"))
    return [*files, "--truth", *sorted(str(f) for f in folder.glob("*/truth.csv"))], np.array(means)


@pytest.mark.parametrize(("claimed", "word"), [
    (0.5, "overconfident"), slow(1.0, "consistent"), slow(2.0, "conservative"),
])  # fmt: skip
def test_many_runs_of_somebody_else_get_the_verdict_of_a_study(claimed, word, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("eval.referee.consistency.MIN_RUNS", 20)
    command, means = simulated(tmp_path, 20, claimed)
    assert main(command) == 0
    said = lines(capsys)
    v = verdict(means, 3)
    assert v.word == word
    assert said["nees_pose"].startswith(f"{v.mean:.6g} {word} (95 % interval ")
    assert said["nees_pose"].endswith(f"3 expected, power {v.power:.2f} against 0.8 P)")
    assert said["runs"] == "20"


def test_few_runs_get_no_verdict(tmp_path, capsys):
    command, _ = simulated(tmp_path, 5, 0.5)
    assert main(command) == 0
    captured = capsys.readouterr()
    assert "nees_pose 6" in captured.out or "nees_pose 5" in captured.out
    assert "not enough runs" in captured.out
    assert "needs at least 50 runs" in captured.err


__all__ = ["scored"]

N = 300
TIME = 1_500_000_000.25 + 0.1 * np.arange(N)
PATH = np.column_stack([3.0 * np.cos(0.02 * np.arange(N)), 3.0 * np.sin(0.02 * np.arange(N))])
YAW = 0.5 * np.pi + 0.02 * np.arange(N)


def tum(time, path=PATH, yaw=YAW):
    zero = np.zeros(len(path))
    return rows_of(np.column_stack([time, path, zero, zero, zero, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]))


@pytest.mark.parametrize("of", ["estimate", "truth"])
@pytest.mark.parametrize(("stamps", "why"), [(np.floor(TIME), "whole seconds"), (np.full(N, TIME[0]), "all are equal"),
                                             (np.round(TIME / 3) * 3 + 0.5, "few digits")])  # fmt: skip
def test_stamps_that_do_not_tell_poses_apart_are_refused(scored, of, stamps, why):
    files = (tum(stamps), tum(TIME)) if of == "estimate" else (tum(TIME), tum(stamps))
    assert f"have the stamp of the next one ({why})" in scored(*files, status=2)


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
], ids=["MulRan", "stamped KITTI", "rostopic echo", "tab beside space"])  # fmt: skip
def test_a_format_is_known_by_its_whole_grammar(scored, text):
    values, asked, _ = scored(text, tum(TIME))
    assert values["matched"] == N
    assert max(values["rmse_position_m"], values["rmse_heading_deg"]) < 1e-6
    assert not asked


def test_numbers_that_are_no_poses_are_asked_for(scored):
    rows = "".join(f"{round(t * 1e9)},{x},{y},0,0.5,0.2,0.1,0.3\n" for t, (x, y) in zip(TIME, PATH, strict=True))
    assert "no known trajectory format" in scored(rows, tum(TIME), status=2)


def quaternions(x, y, z, w):
    return rows_of(np.column_stack([TIME, PATH, np.zeros(N), np.tile([x, y, z, w], (N, 1))]))


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


def test_positions_alone_in_space_are_aligned_in_space(scored):
    """A scaled estimate whose world is upside down beside a truth of positions with heights."""
    place = np.column_stack([PATH, np.sin(TIME)])
    truth = rows_of(np.column_stack([TIME, place + [1e5, 2e5, -30.0], np.tile([0.0, 0, 0, 1], (N, 1))]))
    turned = Rotation.from_euler("yz", [1.2, 0.4]).apply(place) / 3.6
    rolled = Rotation.from_rotvec(TIME[:, None] / 9.0 * [1.0, 0.0, 0.0]).as_quat()
    values, _, said = scored(rows_of(np.column_stack([TIME, turned, rolled])), truth, "--align", "sim3")
    assert said.count("no heading in this file: positions alone are scored") == 1
    assert max(values["rmse_position_m"], values["rmse_position_3d_m"]) < 1e-5
    assert values["scale_sim3"] == pytest.approx(3.6)
    assert "rmse_rotation_3d_deg" not in values


def test_headings_are_there_where_a_robot_drives_ahead(scored):
    straight = rows_of(np.column_stack([TIME, 0.1 * np.arange(N), *np.tile([0, 0, 0, 0, 0, 1.0], (N, 1)).T]))
    assert scored(straight, straight)[0]["rmse_heading_deg"] == 0.0
