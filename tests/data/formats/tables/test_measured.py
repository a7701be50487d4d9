"""Fixes and closures in tables of another program."""

import numpy as np
import pytest
from scipy.io import savemat

from data.pose_measurements import FixKind

VELOCITIES = "t,v,omega\n0,1,0\n1,1,0.1\n2,1,0\n3,1,0\n"
POSES = "t,x,y,theta\n0,0,0,0\n1,1,0,0\n2,2,0,0\n3,3,0,0\n"
NOISE = ("--prior", "0,0,0", "--prior-sigma", "1,1,0.1")
OF = {VELOCITIES: ("--odometry-sigma", "0.1,0.1"), POSES: ("--odometry-sigma", "0.1,0.1,0.1,0.1")}


@pytest.fixture
def table(convert):
    """`table(odometry, {role: text}, *words)`: what `convert` gives."""

    def run(odometry, parts, *words, status=0):
        files = {"odo.csv": odometry} | {f"{role[:3]}.csv": text for role, text in parts.items()}
        named = [word for role in parts for word in (f"--{role}", f"{role[:3]}.csv")]
        return convert(files, "table", "odo.csv", "out", *OF[odometry], *NOISE, *words, *named, status=status)

    return run


@pytest.mark.parametrize("odometry", [VELOCITIES, POSES])
def test_what_a_row_fills_is_what_it_measures(table, odometry):
    text = "t,x,y,theta,sx,sy,source\n0.5,1,2,,,,\n1.25,,,90,,,compass\n2,3,4,45,0.5,0.25,\n2.5,,,,,,\n"
    words = ("--fix-sigma", "1,2,3deg", "--unit", "fixes.theta=deg", "--fix-lever", "0.3,-10cm")
    log, said = table(odometry, {"fixes": text}, *words)
    assert "fix.csv: 1 row without a fix" in said
    r = log.recorded
    assert r.time[r.fixes.frame].tolist() == [0.5, 1.25, 2.0]
    assert r.fixes.kind.tolist() == [FixKind.POSITION, FixKind.HEADING, FixKind.POSE]
    assert r.fixes.z == pytest.approx(np.array([[1, 2, 0], [0, 0, np.pi / 2], [3, 4, np.pi / 4]]))
    three = np.radians(3.0)
    sigma = np.sqrt(np.diagonal(r.fixes.covariance, axis1=1, axis2=2))
    assert sigma == pytest.approx(np.array([[1, 2, 0], [0, 0, three], [0.5, 0.25, three]]))
    assert [(s.name, s.lever) for s in r.fixes.sources] == [("fix", (0.3, -0.1)), ("compass", (0.3, -0.1))]
    assert len(r.observations.frame) == 0


@pytest.mark.parametrize("sigma", ["0.1,0.1", "0.1,0.1,2deg"])
def test_headings_of_fixes_that_nobody_named_are_read_only_with_their_noise(table, sigma):
    parts = {"fixes": "t,e,n,qx,qy,qz,qw\n1,1,0,0,0,0,1\n2,2,0,0,0,0,1\n"}
    log, said = table(VELOCITIES, parts, "--columns", "fixes.x=e,fixes.y=n", "--fix-sigma", sigma)
    assert ("fix.csv: the heading of fixes, qx,qy,qz,qw, is left out" in said) == (sigma == "0.1,0.1")
    assert set(log.recorded.fixes.kind) == {FixKind.POSITION if sigma == "0.1,0.1" else FixKind.POSE}


@pytest.mark.parametrize(("moves", "last", "held"), [(True, 2.01, True), (False, 2.01, False), (True, 9, False)])
def test_fixes_that_repeat_the_one_before_while_the_odometry_moves_are_left_out_and_said(convert, moves, last, held):
    odometry = POSES if moves else "t,x,y,theta\n0,0,0,0\n1,0,0,0\n2,0,0,0\n3,0,0,0\n"
    files = {"odo.csv": odometry, "fix.csv": f"t,x,y,theta\n0,1,2,\n1,1,2,\n1,,,0.1\n2,1,2,\n2,,,0.1\n3,1,{last},\n"}
    words = ("table", "odo.csv", "out", "--fixes", "fix.csv", "--fix-sigma", "1,1,1", *OF[POSES], *NOISE)
    log, said = convert(files, *words)
    assert log.recorded.fixes.frame.tolist() == ([0, 1, 2, 3] if held else [0, 1, 1, 2, 2, 3])
    assert ("2 of 6 fixes repeat the one before" in said) == held


def test_fixes_and_closures_beyond_the_odometry_are_left_out_and_said(table):
    parts = {"fixes": "t,x,y\n-1,0,0\n1,1,2\n", "closures": "t1,t2,dx,dy,dtheta\n0,9,1,0,0\n0,1,1,0,0\n"}
    log, said = table(POSES, parts, "--fix-sigma", "1,1", "--closure-sigma", "1,1,1")
    assert "1 of 2 fixes before or after all odometry" in said
    assert "1 of 2 closures before or after all odometry" in said
    assert (len(log.recorded.fixes), len(log.recorded.closures)) == (1, 1)


@pytest.mark.parametrize(("stamps", "way", "note", "seconds"), [
    (np.arange(0.0, 42.0, 2.0), 40.0, "", ""),
    (np.arange(0.0, 80.0, 8.0), 45.0, "9 gaps longer than 5 s, where", "assumed over 27 of 72 s"),
    ([0.0, 2.0, 4.0, 6.0, 16.0, 18.0], 11.0, "1 gap longer than 3 s, where", "assumed over 7 of 18 s"),
    ([0.0, 0.5, 1.0, 1.5, 8.0, 8.5], 3.0, "1 gap longer than 1 s, where", "assumed over 5.5 of 8.5 s"),
])  # fmt: skip
def test_velocities_of_slow_rows_hold_until_the_next_one_and_what_a_gap_leaves_out_is_said(
    convert, stamps, way, note, seconds
):
    odometry = "t,v,omega\n" + "".join(f"{t},1,0\n" for t in stamps)
    fixes = f"t,x,y\n{stamps[0]},0,0\n{stamps[-1]},9,0\n"
    words = ("--fixes", "fix.csv", *OF[VELOCITIES], *NOISE, "--fix-sigma", "1,1")
    log, said = convert({"odo.csv": odometry, "fix.csv": fixes}, "table", "odo.csv", "out", *words)
    assert log.recorded.increments.mean[:, 0].sum() == pytest.approx(way)
    assert [text in said for text in (note, seconds, "moved unseen")] == [True, True, bool(note)]


@pytest.mark.parametrize(("parts", "words", "said"), [
    ({"fixes": "t,x,y,sx,sy\n0.5,1,2,,\n"}, (), "fix.csv:2: unknown noise of this fix; --fix-sigma SX,SY (m)"),
    ({"fixes": "t,x,y\n0.5,1,\n"}, ("--fix-sigma", "1,1"), "fix.csv:2: column y: blank; both x and y, or neither"),
    ({"fixes": "frame,x,y\n4,1,1\n"}, ("--fix-sigma", "1,1"), ":2: column frame: 4 is out of range; the odometry"),
    ({"fixes": "t,x,y,sx\n0.5,1,1,-1\n"}, ("--fix-sigma", "1,1"), ":2: column sx: -1 is no standard deviation > 0"),
    ({"fixes": "t,x,y\n99,1,1\n"}, ("--fix-sigma", "1,1"), "fixes from 99 to 99 s, odometry from 0 to 3 s do not"),
    ({"closures": "t1,t2,dx,dy,dtheta\n1,1,1,0,0\n"}, ("--closure-sigma", "1,1,1"), ":2: column t2: 1 is t1, too"),
    ({"closures": "t1,t2,dx,dy,dtheta\n1,2,1,0,0\n"}, (), ":2: unknown noise of this closure; --closure-sigma"),
    ({"closures": "t1,t2,range\n1,2,1\n"}, (), ": ranges between poses or robots are not read"),
    ({"fixes": "t,x,y\n0.5,1,1\n"}, ("--closure-sigma", "1,1,1"), "--closure-sigma 1,1,1: there are none"),
])  # fmt: skip
def test_one_line_says_what_is_wrong(table, parts, words, said):
    assert said in table(POSES, parts, *words, status=2)


@pytest.mark.parametrize(("column", "sigma", "kind", "z", "R"), [
    ("range", "0.5", "range", [[2.0, 0.0], [3.0, 0.0]], [0.25, 1.0]),
    ("bearing", "2", "bearing", [[0.0, 2.0], [0.0, 3.0]], [1.0, 4.0]),
])  # fmt: skip
def test_ranges_or_bearings_alone_are_of_a_sensor_of_one_number(table, column, sigma, kind, z, R):
    text = f"t,{column},label\n0.5,2,7\n1,3,9\n"
    log, _ = table(POSES, {"observations": text}, "--observation-sigma", sigma)
    assert (log.recorded.sensor.name, log.recorded.sensor.measures) == (kind, (0,) if kind == "range" else (1,))
    assert log.recorded.observations.z.tolist() == z
    assert np.diag(log.recorded.observations.R[0]) == pytest.approx(R)
    assert log.label.tolist() == [7, 9]


def test_a_place_in_degrees_is_metres_east_and_north_of_the_first_one(table):
    """An equatorial degree of longitude is 2 pi 6378137 / 360 m, one of latitude 110 574 m (WGS 84)."""
    parts = {"fixes": "t,Latitude,Longitude\n1,0,10\n2,0.001,10.001\n", "truth": "t,lat,lon\n0,0,10\n3,0,10.002\n"}
    log, said = table(POSES, parts, "--fix-sigma", "1,1")
    assert "x and y are metres east and north of latitude and longitude 0, 10 deg" in said
    assert log.recorded.fixes.z[:, :2] == pytest.approx(np.array([[0.0, 0.0], [111.31949, 110.5743]]), rel=1e-6)
    assert log.truth.pose[-1, 0] == pytest.approx(222.63898, rel=1e-6)
    assert log.source["datum"] == [0.0, 10.0]
    wrong = {"fixes": "t,lat,lon\n1,4870,10\n"}
    assert "are needed" in table(POSES, wrong, "--fix-sigma", "1,1", status=2)


@pytest.mark.parametrize("form", ["structs", "vectors"])
def test_vectors_of_a_matlab_file_are_columns(convert, form):
    t = np.arange(4.0)
    odometry = {"t": t, "v": np.ones(4), "omega": 0.1 * t}
    seen = {"t": np.array([0.5, 2.0]), "range": np.array([2.0, 1.0]), "bearing": np.array([0.1, -0.1])}
    values = {"odo": odometry, "seen": seen}
    names = "t=odo.t,v=odo.v,omega=odo.omega,observations.t=seen.t,range=seen.range,bearing=seen.bearing"
    if form == "vectors":
        values = {"odo": np.column_stack([*odometry.values()]), "rb": np.column_stack([*seen.values()][1:])}
        values["t_seen"] = seen["t"]
        names = "t=odo_1,v=odo_2,omega=odo_3,observations.t=t_seen,range=rb_1,bearing=rb_2"
    savemat("log.mat", values)
    words = ["--columns", names, "--odometry-sigma", "0.1,0.1", "--observation-sigma", "0.1,0.02"]
    inputs = convert({}, "table", "log.mat", "out", *words)[0].recorded
    assert inputs.observations.z.tolist() == [[2.0, 0.1], [1.0, -0.1]]
    assert inputs.time[inputs.observations.frame].tolist() == [0.5, 2.0]
    assert inputs.increments.mean[1:, 0].sum() == pytest.approx(3.0, rel=1e-2)
    savemat("wide.mat", {"s": np.ones((3, 30))})
    assert "columns s_1, s_2, s_3;" in convert({}, "table", "wide.mat", "out", *words[2:], status=2)
    savemat("none.mat", {"name": "robot"})
    assert "no vector of numbers; it has name" in convert({}, "table", "none.mat", "out", *words, status=2)
