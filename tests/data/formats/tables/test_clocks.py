"""Velocities are written as recorded; stamps of each file are shifted, held and begun as stated."""

import shutil

import numpy as np
import pytest

from data import se2
from data.csv_table import read_table
from data.formats.open_log import load_folder
from tests.builders.logs import same
from tests.eval.tuning.stamped import Stamped, stamped_folder

LATENCY = 0.12


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The files of a robot at 20 Hz, whose readings are stamped late."""
    return stamped_folder(tmp_path_factory.mktemp("robot") / "files", Stamped(latency=LATENCY))


NOISE = ("--columns", "range=z1,bearing=z2", "--odometry-sigma", "0.02,0.01", "--observation-sigma", "0.05,0.01")
PRIOR = ("--prior", "truth", "--prior-sigma", "0.01,0.01,0.01")


@pytest.fixture
def table(convert, monkeypatch):
    """`table(folder, *words)`: what `convert` gives of its files, without its questions about them."""
    monkeypatch.setattr("data.questions.asked.ask", lambda _: ())

    def run(folder, *words, status=0):
        files = {"observations": "observations", "map": "landmarks", "truth": "truth"}.items()
        named = [word for role, name in files for word in (f"--{role}", folder / f"{name}.csv")]
        return convert({}, "table", folder / "odometry.csv", "out", *named, *NOISE, *PRIOR, *words, status=status)

    return run


def test_velocities_stay_velocities(robot, table, tmp_path):
    log, said = table(robot)
    assert same(log, load_folder(robot))
    assert log.recorded.floored == load_folder(robot).recorded.floored
    assert (tmp_path / "out" / "odometry.csv").read_text() == (robot / "odometry.csv").read_text()
    assert "v and omega are taken to hold until the next row (--hold backward: since the row before)" in said
    rows, _ = table(robot, "--frames", "odometry")  # the format cannot have them as frames
    assert len(rows.recorded) > 900
    assert not (tmp_path / "out" / "odometry.csv").exists()


def test_offsets_with_units_move_each_file_alone(robot, table):
    log, _ = table(robot)
    all_later, _ = table(robot, "--time-offset", "observations=250ms,truth=0.25,odometry=0.25")
    assert all_later.recorded.time == pytest.approx(log.recorded.time + 0.25)
    assert all_later.recorded.increments.mean == pytest.approx(log.recorded.increments.mean, abs=1e-9)
    truth_alone, _ = table(robot, "--time-offset", "truth=-0.05")
    known = np.isfinite(truth_alone.truth.pose).all(axis=1)
    table = read_table(robot / "truth.csv", ("t", "x", "y", "theta"))
    expected = se2.interpolate(table.columns["t"] - 0.05, table.stack(("x", "y", "theta")), log.recorded.time)
    assert truth_alone.truth.pose[known] == pytest.approx(expected[known], abs=1e-9)


def test_velocities_that_held_backward_are_those_of_the_row_before(robot, table, tmp_path):
    """A recorder that writes the mean speed since its last row."""
    rows = (robot / "odometry.csv").read_text().splitlines()
    stamps = [row.split(",", 1)[0] for row in rows[1:]]
    speeds = [row.split(",", 1)[1] for row in rows[1:]]
    late = tmp_path / "late"
    shutil.copytree(robot, late)
    lines = [f"{t},{v}" for t, v in zip(stamps, [speeds[-1], *speeds[:-1]], strict=True)]
    (late / "odometry.csv").write_text("\n".join([rows[0], *lines]) + "\n")
    backward, said = table(late, "--hold", "backward")
    assert "to hold since the row before (--hold forward: until the next row)" in said
    forward = load_folder(robot)
    # but for what follows the last row
    assert backward.recorded.increments.mean[:-1].tolist() == forward.recorded.increments.mean[:-1].tolist()


def test_poses_and_readings_by_row_begin_with_the_truth_too(convert):
    poses = "t,x,y,theta,frame,range,bearing\n" + "".join(f"{k},{k},0,0,{k},2,0\n" for k in range(6))
    truth = "t,x,y,theta\n" + "".join(f"{k + 0.5},{k},5,0\n" for k in range(2, 6))
    files = {"o.csv": poses, "o2.csv": poses.replace("t,", "when,", 1), "g.csv": truth}
    words = ["--truth", "g.csv", "--prior", "truth", "--prior-sigma", "0,0,0"]
    words += ["--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,0.1"]
    for by_frame, first, frames in ((True, 3.0, [0, 1, 2]), (False, 2.5, [1, 2, 3])):
        more = ["--observations", "o2.csv"] if by_frame else []
        log, _ = convert(files, "table", "o.csv", "out", *words, *more)
        assert log.recorded.time[0] == first
        assert log.recorded.observations.frame.tolist() == frames
        assert log.recorded.increments.mean[:, 0].sum() == pytest.approx(5.0 - first)
        assert np.isfinite(log.recorded.prior.mean).all()


@pytest.mark.parametrize(("words", "said"), [
    (("--time-offset", "gps=1"), "--time-offset gps=1: unknown; known: odometry, observations, truth"),
    (("--time-offset", "truth"), "PART=SECONDS is needed, as in truth=-0.5"),
])  # fmt: skip
def test_one_line_says_what_is_wrong(robot, table, words, said):
    assert said in table(robot, *words, status=2)


def test_truth_in_milliseconds_beside_a_prior_from_it_is_named_with_its_flag(robot, table, tmp_path):
    late = tmp_path / "late"
    shutil.copytree(robot, late)
    header, *rows = (robot / "truth.csv").read_text().splitlines()
    scaled = [f"{1e3 * float(t)},{rest}" for t, _, rest in (row.partition(",") for row in rows)]
    (late / "truth.csv").write_text("\n".join([header, *scaled]) + "\n")
    said = table(late, status=2)
    assert "--unit truth.t=ms" in said, said
    log, _ = table(late, "--unit", "truth.t=ms")
    np.testing.assert_allclose(log.truth.pose, table(robot)[0].truth.pose, atol=1e-6)
