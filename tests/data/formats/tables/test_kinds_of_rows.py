"""Files with rows of several kinds, columns of one name, and scans."""

import numpy as np
import pytest

from data.convert.__main__ import main

NOISE = ("--odometry-sigma", "0.05,2deg", "--observation-sigma", "0.1")
MIXED = "\n".join(line for k in range(9) for line in (f"odom2 {k} 0.5 0.1 0 0", f"range2 {k}.5 {9 - k} 7")) + "\n"


def test_rows_of_one_kind_are_named_behind_the_file(convert, refused, tmp_path, monkeypatch):
    words = ("--columns", "odometry.t=2,v=3,omega=4,observations.t=2,range=3,label=4")
    log, _ = convert(
        {"in.txt": MIXED}, "table", "in.txt:odom2", "out", "--observations", "in.txt:range2", *words, *NOISE
    )
    assert log.recorded.observations.z[:, 0] == pytest.approx(9.0 - np.arange(9))
    assert log.recorded.increments.mean[2, 2] == pytest.approx(0.1)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.txt").write_text(MIXED)
    said = refused(main, ["table", "in.txt", "out2", *NOISE])
    assert "rows begin with odom2 (9), range2 (9): name those of one kind, as in in.txt:range2" in said


def test_of_two_columns_of_one_name_a_number_tells_which(convert, refused, tmp_path, monkeypatch):
    text = "time,v,omega,time\n" + "".join(f"{10 * k},0.5,0,{k}\n" for k in range(9))
    seen = "t,range,bearing\n" + "".join(f"{k},{9 - k},0.1\n" for k in range(9))
    sigma = ("--observations", "seen.csv", "--odometry-sigma", "0.05,2deg", "--observation-sigma", "0.1,1deg")
    log, _ = convert({"o.csv": text, "seen.csv": seen}, "table", "o.csv", "out", *sigma, "--columns", "odometry.t=4")
    assert np.diff(log.recorded.time) == pytest.approx(1.0)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "o.csv").write_text(text)
    (tmp_path / "seen.csv").write_text(seen)
    said = refused(main, ["table", "o.csv", "out2", *sigma, "--columns", "odometry.t=time"])
    assert "columns 1 and 4 are named 'time'; name one by its number" in said


BEAMS, STEP = 36, np.radians(10.0)


def scans(named):
    rows = []
    for k in range(20):
        angle = -np.pi + STEP * np.arange(BEAMS)
        with np.errstate(divide="ignore"):  # a room of 8 x 6 m, from a place 0.2 m further on in each scan
            x, y = -2.0 + 0.2 * k, 0.0
            far = np.min([np.where(c > 1e-9, d / c, np.inf) for c, d in (
                (np.cos(angle), 4 - x), (-np.cos(angle), 4 + x), (np.sin(angle), 3 - y), (-np.sin(angle), 3 + y),
            )], axis=0)  # fmt: skip
        about = [1700000000_000000000 + 500000000 * k, *([-np.pi, np.pi - STEP, STEP, 0.1, 20.0] if named else [])]
        rows.append(",".join(map(repr, map(float, [*about[1:], *far]))).join([f"{about[0]},", ""]))
    names = ["stamp", "angle_min", "angle_max", "angle_increment", "range_min", "range_max"]
    header = [",".join(f"field.header.{n}" for n in (*names, *(f"ranges{b}" for b in range(BEAMS))))]
    return "\n".join([*(header if named else []), *rows]) + "\n"


ODOMETRY = "%time,field.header.stamp,field.x,field.y,field.theta\n" + "".join(
    f"{1700000009_000000000 + k},{1700000000_000000000 + 250000000 * k},{0.1 * k},0,0\n" for k in range(41)
)


@pytest.mark.parametrize("named", [True, False])
def test_scans_of_a_table_are_those_of_a_laser_log(convert, named):
    """As rostopic echo -p writes them, or without names."""
    words = (
        ()
        if named
        else ("--scanner", "-180deg,10deg,20", "--columns", "scans.t=1,scans.range=2", "--unit", "scans.t=ns")
    )
    log, _ = convert(
        {"odo.csv": ODOMETRY, "scan.csv": scans(named)}, "table", "odo.csv", "out", "--scans", "scan.csv", *words
    )
    r = log.recorded
    assert r.scans.ranges.shape == (20, BEAMS)
    assert np.diff(r.time[r.scans.frame]) == pytest.approx(0.5)
    ahead = r.scans.ranges[:, np.argmin(np.abs(r.scans.scanner.angle_min + STEP * np.arange(BEAMS)))]
    assert np.diff(ahead) == pytest.approx(-0.2)
    assert r.increments.mean[r.scans.frame[1:], 0] == pytest.approx(0.2, abs=1e-6)
    assert (r.scans.scanner.max_range, r.scans.scanner.angle_step) == pytest.approx((20.0, STEP))


@pytest.mark.parametrize(("text", "words", "wanted"), [
    ("t,a,b\n0,1,2\n1,1,2\n", (), "columns such as range0, range1 are needed"),
    ("t,range0,range1\n0,1,2\n1,1,2\n", (), "--scanner LOW,STEP,MAX"),
    ("t,range0,range1\n0,1,two\n1,1,2\n", ("--scanner", "0,1deg,9"), "'two' is not a number"),
])  # fmt: skip
def test_what_is_no_scan_is_refused(refused, tmp_path, monkeypatch, text, words, wanted):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scan.csv").write_text(text)
    (tmp_path / "odo.csv").write_text("t,x,y,theta\n0,0,0,0\n1,1,0,0\n")
    assert wanted in refused(main, ["table", "odo.csv", "out", "--scans", "scan.csv", *words])
