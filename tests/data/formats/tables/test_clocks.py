"""Velocities are written as recorded; stamps of each file are shifted, held and begun as stated."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from data import se2
from data.convert.__main__ import main
from data.csv_table import read_table
from data.formats.open_log.reader import load_folder
from tests.eval.tuning.stamped import Stamped, stamped_folder

LATENCY = 0.12


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The files of a robot at 20 Hz, whose readings are stamped late."""
    return stamped_folder(tmp_path_factory.mktemp("robot") / "files", Stamped(latency=LATENCY))


@pytest.fixture
def convert(tmp_path, capsys):
    """`convert(folder, *words)`: the log of its files, and what was said."""

    def run(folder, *words, status=0):
        files = [w for part in ("observations", "map", "truth") for w in (f"--{part}", str(folder / f"{part}.csv"))]
        files[3] = str(folder / "landmarks.csv")
        given = [
            "--columns",
            "range=z1,bearing=z2",
            "--odometry-sigma",
            "0.02,0.01",
            "--observation-sigma",
            "0.05,0.01",
        ]
        given += ["--prior", "truth", "--prior-sigma", "0.01,0.01,0.01"]
        assert main(["table", str(folder / "odometry.csv"), str(tmp_path / "log"), *files, *given, *words]) == status
        said = capsys.readouterr()
        return (None, said.err) if status else (load_folder(tmp_path / "log"), said.out)

    return run


def same_inputs(one, two):
    a, b = one.recorded, two.recorded
    pairs = [(a.time, b.time), (a.increments.mean, b.increments.mean), (a.observations.z, b.observations.z)]
    pairs += [(a.increments.covariance, b.increments.covariance), (a.observations.frame, b.observations.frame)]
    pairs += [(a.observations.R, b.observations.R), (one.truth.pose, two.truth.pose)]
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs) and a.floored == b.floored


def test_velocities_stay_velocities(robot, convert, tmp_path):
    log, said = convert(robot)
    assert same_inputs(log, load_folder(robot))
    assert (tmp_path / "log" / "odometry.csv").read_text() == (robot / "odometry.csv").read_text()
    assert "v and omega are taken to hold until the next row (--hold backward: since the row before)" in said
    rows, _ = convert(robot, "--frames", "odometry")  # the format cannot have them as frames
    assert len(rows.recorded) > 900
    assert not (tmp_path / "log" / "odometry.csv").exists()


def test_offsets_with_units_move_each_file_alone(robot, convert):
    log, _ = convert(robot)
    all_later, _ = convert(robot, "--time-offset", "observations=250ms,truth=0.25,odometry=0.25")
    assert all_later.recorded.time == pytest.approx(log.recorded.time + 0.25)
    assert all_later.recorded.increments.mean == pytest.approx(log.recorded.increments.mean, abs=1e-9)
    truth_alone, _ = convert(robot, "--time-offset", "truth=-0.05")
    known = np.isfinite(truth_alone.truth.pose).all(axis=1)
    table = read_table(robot / "truth.csv", ("t", "x", "y", "theta"))
    expected = se2.interpolate(table.columns["t"] - 0.05, table.stack(("x", "y", "theta")), log.recorded.time)
    assert truth_alone.truth.pose[known] == pytest.approx(expected[known], abs=1e-9)


def test_velocities_that_held_backward_are_those_of_the_row_before(robot, convert, tmp_path):
    """A recorder that writes the mean speed since its last row."""
    rows = (robot / "odometry.csv").read_text().splitlines()
    stamps = [row.split(",", 1)[0] for row in rows[1:]]
    speeds = [row.split(",", 1)[1] for row in rows[1:]]
    late = tmp_path / "late"
    shutil.copytree(robot, late)
    lines = [f"{t},{v}" for t, v in zip(stamps, [speeds[-1], *speeds[:-1]], strict=True)]
    (late / "odometry.csv").write_text("\n".join([rows[0], *lines]) + "\n")
    backward, said = convert(late, "--hold", "backward")
    assert "to hold since the row before (--hold forward: until the next row)" in said
    forward = load_folder(robot)
    # but for what follows the last row
    assert backward.recorded.increments.mean[:-1].tolist() == forward.recorded.increments.mean[:-1].tolist()


def test_poses_and_readings_by_row_begin_with_the_truth_too(convert, tmp_path, capsys):
    (tmp_path / "o.csv").write_text(
        "t,x,y,theta,frame,range,bearing\n" + "".join(f"{k},{k},0,0,{k},2,0\n" for k in range(6))
    )
    (tmp_path / "g.csv").write_text("t,x,y,theta\n" + "".join(f"{k + 0.5},{k},5,0\n" for k in range(2, 6)))
    words = ["--truth", str(tmp_path / "g.csv"), "--prior", "truth", "--prior-sigma", "0,0,0"]
    words += ["--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,0.1"]
    for by_frame, first, frames in ((True, 3.0, [0, 1, 2]), (False, 2.5, [1, 2, 3])):
        (tmp_path / "o2.csv").write_text((tmp_path / "o.csv").read_text().replace("t,", "when,", 1))
        more = ["--observations", str(tmp_path / "o2.csv")] if by_frame else []
        assert main(["table", str(tmp_path / "o.csv"), str(tmp_path / "log"), *words, *more]) == 0
        log = load_folder(tmp_path / "log")
        assert log.recorded.time[0] == first
        assert log.recorded.observations.frame.tolist() == frames
        assert log.recorded.increments.mean[:, 0].sum() == pytest.approx(5.0 - first)
        assert np.isfinite(log.recorded.prior.mean).all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--time-offset", "gps=1"), "--time-offset gps=1: unknown; known: odometry, observations, truth"),
        (("--time-offset", "truth"), "PART=SECONDS is needed, as in truth=-0.5"),
        (("--time-offset", "truth=soon"), "'soon' is not a number"),
        (("--time-offset", "observations=1", "--columns", "observations.t=none"), "no column 'none'"),
        (("--hold", "sideways"), "--hold sideways: unknown; known: forward, backward"),
    ],
)
def test_one_line_says_what_is_wrong(robot, convert, words, said):
    message = convert(robot, *words, status=2)[1]
    assert message.count("\n") == 1
    assert said in message
