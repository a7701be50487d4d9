"""Rows that are merged, blank, repeated, or outside the odometry: they keep their numbers, and count once or not."""

import numpy as np
import pytest

from data import se2
from data.convert.__main__ import main
from data.formats.open_log import load_folder

NOISE = ("--odometry-sigma", "0.01,0.01,0.001,0.001", "--observation-sigma", "0.1,0.1", "--max-range", "20")
SPEED, LANDMARK = 0.5, 9.0
DRIVE = [f"{k},{SPEED * k},0,0" for k in range(12)]
REPEATED = [row for k, row in enumerate(DRIVE) for row in [row] * (1 + (k % 3 == 0))]
BLANK = [*DRIVE[:4], "3.5,,,", *DRIVE[4:]]


@pytest.fixture
def rows(convert):
    def run(odometry: list[str], *words: str, names: str = "t,x,y,theta", **parts: str):
        files = {"odo.csv": "\n".join([names, *odometry]) + "\n"} | {f"{r}.csv": text for r, text in parts.items()}
        named = [word for role in parts for word in (f"--{role}", f"{role}.csv")]
        return convert(files, "table", "odo.csv", "out", *NOISE, *words, *named)

    return run


@pytest.mark.parametrize("odometry", [DRIVE, REPEATED, BLANK])
def test_frame_is_the_row_of_the_file(rows, odometry):
    seen = [(i, LANDMARK - SPEED * float(row.split(",")[0])) for i, row in enumerate(odometry)]
    truth = "x,y,theta\n" + "".join(f"{LANDMARK - ahead},0,0\n" for _, ahead in seen)
    text = "frame,x,y,label\n" + "".join(f"{i},{ahead},0,7\n" for i, ahead in seen[::-1])
    start = ("--prior", "truth", "--prior-sigma", "0,0,0")
    log, _ = rows(odometry, *start, observations=text, truth=truth)
    r = log.recorded
    path = se2.dead_reckoned(r.prior.mean, r.increments.mean)
    assert path[r.observations.frame, 0] + r.observations.z[:, 0] == pytest.approx(LANDMARK)
    assert log.truth.pose == pytest.approx(path)


def test_rows_before_the_first_message_of_a_sensor_are_left_out(rows):
    """Those with a blank, and places at 0, 0 that are far from all others."""
    fixes = "t,x,y\n3,0,0\n4,0,0\n" + "".join(f"{5 + k},{500 + 0.5 * k},{0.1 * k}\n" for k in range(4))
    odometry = [row.removesuffix("0") for row in DRIVE[:2]] + DRIVE[2:]
    words = ("--prior", "0,0,0", "--prior-sigma", "1,1,1", "--fix-sigma", "1,1")
    log, said = rows(odometry, *words, fixes=fixes, observations="t,x,y\n9,2,0\n")
    assert "odo.csv: 2 rows before the first that has t, x, y, theta: left out" in said
    assert "2 places of fixes at 0, 0, far from all others" in said
    assert (log.recorded.time[0], len(log.recorded.fixes)) == (2.0, 4)


@pytest.mark.parametrize("twice", ["odometry", "observations", "fixes", "closures", "truth", "map"])
def test_a_repeated_row_counts_once_in_every_file(rows, twice):
    parts = {
        "observations": ["t,x,y,label", "1,2,0,4", "2,3,0,5"], "fixes": ["t,x,y,sx,sy", "1,0.5,0,1,1", "2,1,0,1,1"],
        "closures": ["t1,t2,dx,dy,dtheta,sx,sy,stheta", "0,4,2,0,0,1,1,1"], "truth": ["t,x,y,theta", *DRIVE],
        "map": ["id,x,y", "4,2.5,0", "5,4,0"],
    }  # fmt: skip
    parts = {role: "\n".join([head, *(row for row in rows for _ in range(1 + (role == twice)))]) + "\n"
             for role, (head, *rows) in parts.items()}  # fmt: skip
    odometry = [row for row in DRIVE for _ in range(1 + (twice == "odometry"))]
    log, said = rows(odometry, "--prior", "0,0,0", "--prior-sigma", "0,0,0", **parts)
    r = log.recorded
    counts = len(r), len(r.observations.frame), len(r.fixes), len(r.closures), log.truth.known_poses, len(r.map.id)
    assert counts == (12, 2, 2, 1, 12, 2)
    assert f"of {twice} repeated, counted once" in said


@pytest.mark.parametrize(("names", "said"), [
    ("t,x,y,id", "observations.csv: column not used: id (label=id?)"),
    ("t,x,y,gt_id", "observations.csv: column not used: gt_id (true_id=gt_id?)"),
    ("t,x,y,coneTag", "observations.csv: column not used: coneTag (label=coneTag?)"),
    ("t,x,y,quality", "observations.csv: column not used: quality"),
])  # fmt: skip
def test_a_column_that_nothing_used_is_named_with_what_it_likely_is(rows, names, said):
    log, out = rows(DRIVE, observations=f"{names}\n1,2,0,4\n2,3,0,5\n")
    assert f"- {said}\n" in out
    assert log.label is None


def test_other_usual_names_of_a_quantity_are_read_and_named_where_there_is_one(rows):
    log, out = rows(DRIVE, names="Time_,x,y,yaw", observations="timestamp,range,angle\n1,2,0.5\n2,3,0.25\n")
    assert log.recorded.observations.z.tolist() == [[2.0, 0.5], [3.0, 0.25]]
    said = ("odo.csv: t of odometry is read from Time_", "odo.csv: theta of odometry is read from yaw")
    assert all(f"- {text}\n" in out for text in (*said, "observations.csv: bearing of observations is read from angle"))
    with pytest.raises(AssertionError, match="no column 't'"):
        rows(DRIVE, names="time,x,y,yaw", observations="time,stamp,x,y\n1,1,2,0\n")


def test_a_table_with_usual_names_and_units_needs_no_flag(tmp_path, capsys):
    """Noise and start are assumed, and that is said."""
    drive = "0,0,0,0,3,10\n500,50,0,5,2.6,12\n1000,100,3,10,2.2,15\n"
    (tmp_path / "drive.csv").write_text(f"stamp_ms,pos_x_cm,pos_y_cm,yaw_deg,dist_m,angle_deg\n{drive}")
    (tmp_path / "truth.csv").write_text("t [ms],x,y,yaw_deg\n0,5,7,90\n500,5,7.5,90\n1000,5,8,90\n")
    files = [str(tmp_path / "drive.csv"), str(tmp_path / "log"), "--truth", str(tmp_path / "truth.csv")]
    assert main(["table", *files]) == 0
    log = load_folder(tmp_path / "log")
    assert log.recorded.prior.mean == pytest.approx([5.0, 7.0, 0.5 * np.pi])
    assert log.recorded.observations.z[1] == pytest.approx([2.6, np.radians(12.0)])
    assert log.recorded.increments.mean[1] == pytest.approx([0.5, 0.0, np.radians(5.0)], abs=1e-9)
    assert {q for q, origin in log.origins.items() if origin == "assumed"} >= {
        "odometry_noise", "observation_noise", "prior",
    }  # fmt: skip
    assert "theta of odometry is read from yaw_deg, in deg" in capsys.readouterr().out


@pytest.mark.parametrize("names", ["t,x,y,theta", "t,dx,dy,dtheta"])
def test_a_covariance_that_is_the_same_of_each_row_is_so_of_each_frame(rows, names):
    odometry = DRIVE if "theta" in names and "dx" not in names else [f"{k},{SPEED},0,0" for k in range(12)]
    noise = ("--frames", "odometry", "--odometry-noise", "step", "--odometry-sigma", "0.01,0.02,0.5deg")
    log, _ = rows(odometry, *noise, names=names, observations="t,x,y\n1,2,0\n3.5,2,0\n4,2,0\n")
    P, C = log.recorded.increments.covariance, np.diag(np.square([0.01, 0.02, np.radians(0.5)]))
    assert log.recorded.time.tolist() == [0, 1, 2, 3, 3.5, 4, *range(5, 12)]
    assert P[1] == pytest.approx(C)
    assert P[4][0, 0] == P[5][0, 0] == pytest.approx(0.5 * C[0, 0])


def test_the_unit_of_lengths_is_that_of_flags_too(rows):
    words = ("--unit", "length=cm", "--prior", "100,20,0", "--prior-sigma", "10,5,0", "--sensor-pose", "30,0,0")
    said = ("--odometry-sigma", "1,1,0.001,0.001", "--observation-sigma", "10,0.2m", "--max-range", "20m")
    log, _ = rows([f"{k},{100 * SPEED * k},0,0" for k in range(12)], *words, *said, observations="t,x,y\n1,200,0\n")
    r = log.recorded
    assert r.prior.mean.tolist() == [1.0, 0.2, 0.0]
    assert np.sqrt(np.diag(r.prior.covariance)) == pytest.approx([0.1, 0.05, 0])
    assert np.sqrt(np.diagonal(r.observations.R[0])) == pytest.approx([0.1, 0.2])
    assert (r.sensor.max_range, r.sensor.translation) == (20.0, (-0.3, 0.0))
    assert r.increments.covariance[1, 0, 0] == pytest.approx(0.01**2 * SPEED, rel=1e-6)


NORTH = 0.5 * np.pi


@pytest.mark.parametrize(("names", "more", "words", "heading"), [
    ("", "", (), None), (",theta", ",", (), None), (",qx,qy,qz,qw", ",0,0,0,0", (), None),
    *((f",{name},qx,qy,qz,qw", ",,0,0,1,1", (), NORTH) for name in ("orientation", "theta")),
    (",theta", ",0", ("--unit", "truth.theta=compass"), NORTH),
    (",theta,a,b,c,d", ",9,0,0,1,1", ("--columns", "truth.qx=a,truth.qy=b,truth.qz=c,truth.qw=d"), NORTH),
])  # fmt: skip
def test_a_truth_has_headings_or_is_one_of_positions_alone(rows, names, more, words, heading):
    """Not those of a blank column, nor of one that nobody named beside a stated quaternion."""
    start, truth = ("--prior", "0,0,0", "--prior-sigma", "0,0,0"), [f"{k},{SPEED * k},0{more}\n" for k in range(12)]
    truth = f"t,x,y{names}\n{''.join(truth)}"
    log, said = rows(DRIVE, *start, *words, observations="t,x,y\n1,2,0\n2.5,2,0\n", truth=truth)
    assert ("truth.csv: no heading in this file: positions alone are scored" in said) == (heading is None)
    assert log.truth.known_poses == len(log.recorded)
    assert not log.truth.has_headings if heading is None else log.truth.pose[:, 2] == pytest.approx(heading)
    assert log.truth.pose[:, 0] == pytest.approx(SPEED * log.recorded.time)
