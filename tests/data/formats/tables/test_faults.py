"""What is wrong in somebody's files, or was not said, is one line with the place and what would be right."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from data.convert.__main__ import main
from data.formats.open_log.reader import load_folder

GOOD = "t,v,omega,range,bearing\n0,1,0,2,0.1\n1,1,0,2,0.2\n2,1,0,,\n3,1,0,3,-0.5\n"
SIGMAS = ("--odometry-sigma", "0.1,0.1", "--observation-sigma", "0.1,0.1")
Run = Callable[..., tuple[int, str]]


@pytest.fixture
def table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """`table(text, *words)`: exit status and what was said, of a file with that text (or bytes)."""

    def run(text: str | bytes, *words: str) -> tuple[int, str]:
        source = tmp_path / "robot.csv"
        source.write_bytes(text if isinstance(text, bytes) else text.encode())
        (tmp_path / "more.csv").write_text("t,x,y,theta\n0,0,0,0\n3,3,0,0\n")
        status = main(["table", str(source), str(tmp_path / "out"), *words])
        said = capsys.readouterr()
        return status, said.err if status else said.out

    return run


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        (GOOD, ("--observation-sigma", "1,1"), "unknown odometry noise; --odometry-sigma is needed"),
        (GOOD, ("--odometry-sigma", "1,1"), "unknown observation noise; --observation-sigma is needed"),
        (GOOD, ("--odometry-sigma", "1", "--observation-sigma", "1,1"), "2 numbers are needed"),
        (GOOD, ("--odometry-sigma", "1,1", "--observation-sigma", "1,5furlong"), "unknown unit 'furlong'"),
        (GOOD, ("--odometry-sigma", "1,-1", "--observation-sigma", "1,1"), "must be 0 or more"),
        (GOOD, (*SIGMAS, "--columns", "t=stamp"), "--columns t=stamp: not used: no file has a column 'stamp'"),
        (GOOD, (*SIGMAS, "--columns", "speed=v"), "unknown quantity 'speed'; known: t,"),
        (GOOD, (*SIGMAS, "--columns", "odometry.t=stamp"), "no column 'stamp' (odometry.t); it has columns t, v,"),
        (GOOD, (*SIGMAS, "--columns", "t"), "KEY=NAME is needed"),
        (GOOD, (*SIGMAS, "--unit", "time=fortnight"), "unknown unit 'fortnight'; one of s, ms,"),
        (GOOD, (*SIGMAS, "--unit", "v=km"), "of m, mm, cm, km, ft, in per s,"),
        (GOOD, (*SIGMAS, "--odometry-kind", "legs"), "known: velocities, poses, steps, ticks"),
        (GOOD, (*SIGMAS, "--truth", "{more}"), "unknown start in the frame of the truth"),
        (GOOD, (*SIGMAS, "--truth", "{more}", "--prior", "truth"), "--prior: --prior-sigma"),
        (GOOD, (*SIGMAS, "--prior", "truth", "--prior-sigma", "0,0,0"), "--prior truth: --truth FILE is needed"),
        (GOOD, (*SIGMAS, "--max-range", "0"), "--max-range 0: must be more than 0"),
        (GOOD, (*SIGMAS, "--view", "1,1"), "--view 1,1: the smaller bearing first"),
        (GOOD.replace("1,1,0,2", "1,1,0,x"), SIGMAS, ":3: column range: 'x' is not a number"),
        (GOOD.replace("1,1,0,2,0.2", "1,1,,2,0.2"), SIGMAS, ":3: column omega: blank; a number is needed"),
        (GOOD.replace("1,1,0,2,0.2", "1,1,NaN,2,0.2"), SIGMAS, ":3: column omega: 'NaN'; a number is needed"),
        (GOOD.replace("1,1,0,2", '1,1,"0,2'), SIGMAS, ":3: a quote that is not closed within its line"),
        (GOOD.replace("2,1,0,,", "2,1,0,"), SIGMAS, ":4: 4 fields where 5 are needed"),
        (GOOD.replace("0,1,0,2", "5,1,0,2"), SIGMAS, ":3: column t: 1 follows 5.0; t must not decrease"),
        (GOOD.replace("3,1,0,3", "3,1,0,-3"), SIGMAS, "column range: -3 is a negative range"),
        (GOOD.replace("t,v", "when,v"), SIGMAS, "no column 't' for t"),
        (GOOD.replace("omega", "gyro"), SIGMAS, "no odometry: columns t, v, gyro"),
        (GOOD.replace("bearing", "azimuth"), SIGMAS, "no column 'bearing' for bearing"),
        (GOOD.replace("omega", "v"), SIGMAS, "two columns are named 'v'"),
        ("", SIGMAS, "no rows"),
        ("t,v,omega,range,bearing\n", SIGMAS, "a header and no rows"),
        (b"PK\x03\x04\x00\x00", SIGMAS, "not a text file"),
        ("t,v,omega,range,bearing\n0,1,0,2,0.1\n1e9,1,0,2,0.2\n", SIGMAS, "--unit time=ns"),
    ],
)  # fmt: skip
def test_one_line_says_what_is_wrong(table, tmp_path, text, words, said):
    status, message = table(text, *(w.replace("{more}", str(tmp_path / "more.csv")) for w in words))
    assert status == 2
    assert message.count("\n") == 1
    assert said in message


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace(",", ";"),
        GOOD.replace(",", "\t"),
        GOOD.replace(",,", ",nan,nan").replace(",", " "),
        GOOD.replace(",", ";").replace(".", ","),
        "\ufeff" + GOOD.replace("\n", "\r\n"),
        "# made by a robot\n# " + GOOD,
        "% t v omega range bearing\n" + GOOD.partition("\n")[2].replace(",,", ",nan,nan").replace(",", "  "),
        '"t","v","omega","range","bearing"\n' + GOOD.partition("\n")[2],
        GOOD.encode("utf-16"),
        GOOD.replace("range", "range ").replace("0,1,0,2,0.1", " 0 , 1,0,2,0.1"),
    ],
)
def test_any_way_of_writing_a_table_gives_the_same_log(table, tmp_path, text):
    status, message = table(text, *SIGMAS)
    assert status == 0, message
    r = load_folder(tmp_path / "out").recorded
    assert r.time.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert r.increments.mean[1].tolist() == [1.0, 0.0, 0.0]
    assert r.observations.frame.tolist() == [0, 1, 3]
    assert r.observations.z.tolist() == [[2.0, 0.1], [2.0, 0.2], [3.0, -0.5]]


def test_a_file_without_names_has_columns_by_number(table, tmp_path):
    text = GOOD.partition("\n")[2]
    assert "columns 1 to 5, without names" in table(text, *SIGMAS)[1]
    status, _ = table(text, *SIGMAS, "--columns", "t=1,v=2,omega=3,range=4,bearing=5")
    assert status == 0
    assert len(load_folder(tmp_path / "out").recorded) == 4


def test_dates_are_stamps(table, tmp_path):
    text = GOOD.replace("\n0,", "\n2024-05-01T12:00:00Z,").replace("\n1,", "\n2024-05-01T14:00:01+02:00,")
    text = text.replace("\n2,", "\n2024-05-01 12:00:02,").replace("\n3,", "\n2024-05-01T12:00:03.000,")
    assert table(text, *SIGMAS, "--unit", "time=iso")[0] == 0
    assert np.diff(load_folder(tmp_path / "out").recorded.time).tolist() == [1.0, 1.0, 1.0]
    assert "is not a date" in table(GOOD, *SIGMAS, "--unit", "time=iso")[1]


def test_clockwise_bearings_are_turned_round(table, tmp_path):
    assert table(GOOD, *SIGMAS, "--unit", "bearing=-rad")[0] == 0
    assert load_folder(tmp_path / "out").recorded.observations.z[0].tolist() == [2.0, -0.1]


def test_readings_as_points_seen_by_a_sensor_that_is_mounted_ahead(table, tmp_path):
    text = "t,v,omega,px,py\n0,1,0,2,0.5\n1,1,0,1,0.5\n"
    words = ("--columns", "observations.x=px,observations.y=py", "--sensor-pose", "0.5,0,0", *SIGMAS)
    assert table(text, *words)[0] == 0
    r = load_folder(tmp_path / "out").recorded
    assert r.sensor.name == "relative_point"
    # both rows show the same landmark, 2.5 m ahead of where the body was first
    points, _ = r.sensor.body_points(r.observations.z, r.observations.R)
    assert points[0].tolist() == [2.5, 0.5]
    assert points[1].tolist() == [1.5, 0.5]


def test_poses_with_quaternions_without_stamps(table, tmp_path):
    a = 0.25
    rows = f"0,0,0,0,0,1,0,2,0.1\n1,0,0,0,{float(np.sin(a / 2))!r},{float(np.cos(a / 2))!r},1,2,0.2\n"
    words = ("--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,0.1")
    status, message = table("x,y,qx,qy,qz,qw,frame,range,bearing\n" + rows, *words)
    assert status == 0, message
    r = load_folder(tmp_path / "out").recorded
    assert r.time_is_index
    assert r.increments.mean[1] == pytest.approx([1.0, 0.0, a])


def test_headings_that_look_like_degrees_are_asked_about(table):
    rows = "".join(f"{k},{k},0,{10 * k},2,0.1\n" for k in range(100))
    words = ("--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,0.1")
    assert "are they degrees?" in table("t,x,y,theta,range,bearing\n" + rows, *words)[1]
    assert "are they degrees?" not in table("t,x,y,theta,range,bearing\n" + rows, *words, "--unit", "angle=deg")[1]


def test_a_robot_that_mostly_stands_is_asked_about_its_degrees_too(table):
    rows = "".join(f"{k},{k},0,{45 * (k // 200)},2,0.1\n" for k in range(2000))
    words = ("--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,0.1")
    assert "are they degrees?" in table("t,x,y,theta,range,bearing\n" + rows, *words)[1]


def test_the_converter_asks_what_inspect_asks(table):
    said = table(GOOD.replace("-0.5", "-50"), *SIGMAS)[1]
    assert "bearings reach 50 rad: are they in degrees?" in said


def test_readings_before_and_after_all_odometry_are_left_out_and_said(table, tmp_path):
    seen = tmp_path / "seen.csv"
    seen.write_text("t,range,bearing\n-1,2,0.1\n1,3,0.1\n2,4,0.1\n9,5,0.1\n")
    words = ("--observations", str(seen), "--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,0.1")
    status, said = table("t,x,y,theta\n0,0,0,0\n1,1,0,0\n2,2,0,0\n3,3,0,0\n", *words)
    assert status == 0
    assert "2 of 4 observations before or after all odometry, 0 to 3 s, dropped" in said
    assert load_folder(tmp_path / "out").recorded.observations.z[:, 0].tolist() == [3.0, 4.0]


def test_readings_at_the_very_first_and_last_stamp_of_the_odometry_are_kept(table, tmp_path):
    seen = written(tmp_path / "seen.csv", (0.0, 3.0, 3.5))
    words = ("--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,0.1")
    status, said = table("t,x,y,theta\n0,0,0,0\n1,1,0,0\n3,3,0,0\n", "--observations", str(seen), *words)
    assert status == 0
    assert "1 of 3 observations before or after all odometry, 0 to 3 s, dropped" in said
    r = load_folder(tmp_path / "out").recorded
    assert r.observations.z[:, 0].tolist() == [2.0, 3.0]
    assert r.time.tolist() == [0.0, 1.0, 2.0, 3.0]


def written(path: Path, stamps: tuple[float, ...]) -> Path:
    """A file of readings at these stamps [s], the first 2 m away, each next one a metre farther."""
    path.write_text("t,range,bearing\n" + "".join(f"{t!r},{2.0 + i},0.1\n" for i, t in enumerate(stamps)))
    return path


DRIVEN = "t,v,omega\n0,1,0\n0.5,1,0\n1,1,0\n"


@pytest.mark.parametrize(
    ("stamps", "time"),
    [
        ((0.25, 0.75), (0.0, 0.25, 0.75, 1.0)),
        ((-0.75, -0.5, 0.5), (0.0, 0.5, 1.0)),
        ((0.5, 1.25, 1.75), (0.0, 0.5, 1.25)),
        ((0.5, 1.8e6), (0.0, 0.5, 1.0)),
    ],
)
def test_with_velocities_the_log_ends_as_long_after_the_last_row_as_rows_are_apart(table, tmp_path, stamps, time):
    status, said = table(DRIVEN, "--observations", str(written(tmp_path / "seen.csv", stamps)), *SIGMAS)
    assert status == 0, said
    kept = [t for t in stamps if t in time]
    lost = len(stamps) - len(kept)
    assert (f"{lost} of {len(stamps)} observations before or after all odometry" in said) == bool(lost)
    r = load_folder(tmp_path / "out").recorded
    assert r.time.tolist() == list(time)
    assert r.time[r.observations.frame].tolist() == kept
    assert r.observations.z[:, 0].tolist() == [2.0 + i for i, t in enumerate(stamps) if t in time]
    assert r.increments.mean[:, 0].sum() == pytest.approx(time[-1])


def test_every_odometry_row_is_a_frame_where_that_is_asked_for(table, tmp_path):
    seen = str(written(tmp_path / "seen.csv", (0.25,)))
    for words, time in (((), [0.0, 0.25, 1.0]), (("--frames", "odometry"), [0.0, 0.25, 0.5, 1.0])):
        assert table(DRIVEN, "--observations", seen, *SIGMAS, *words)[0] == 0
        r = load_folder(tmp_path / "out").recorded
        assert r.time.tolist() == time
        assert r.observations.frame.tolist() == [1]


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        ((2.0, 3.5), "observations from 2 to 3.5 s, odometry from 0 to 1 s do not overlap"),
        ((-3.5, -2.0), "observations from -3.5 to -2 s, odometry from 0 to 1 s do not overlap"),
    ],
)
def test_readings_far_from_all_odometry_are_refused_with_both_spans(table, tmp_path, stamps, said):
    status, message = table(DRIVEN, "--observations", str(written(tmp_path / "seen.csv", stamps)), *SIGMAS)
    assert status == 2
    assert message.count("\n") == 1
    assert said in message


@pytest.mark.parametrize(
    ("readings", "reach"),
    [
        (((2.0, 0.1), (3.0, -0.5), (1.0, 2.9)), 3.003),
        (((0.5, 1.5), (0.25, 3.0)), 0.5005),
        (((2.0, -0.1), (3.0, -0.5), (1.0, -1.5)), 3.003),
        (((0.0, 1.0), (0.0, 2.0)), np.inf),
        ((), np.inf),
    ],
)
def test_a_sensor_whose_range_nobody_states_reaches_a_thousandth_beyond_its_farthest_reading(
    table, tmp_path, readings, reach
):
    seen = tmp_path / "seen.csv"
    seen.write_text("t,range,bearing\n" + ("".join(f"{k},{r},{b}\n" for k, (r, b) in enumerate(readings)) or "0,,\n"))
    status, said = table("t,v,omega\n0,1,0\n1,1,0\n2,1,0\n", "--observations", str(seen), *SIGMAS)
    assert status == 0, said
    assert "inferred: max range" in said
    sensor = load_folder(tmp_path / "out").recorded.sensor
    assert sensor.max_range == pytest.approx(reach, rel=1e-12)
    assert (sensor.min_angle, sensor.max_angle) == (-np.pi, np.pi)


def test_points_are_as_far_as_they_are_ahead_and_aside_together(table, tmp_path):
    text = "t,v,omega,px,py\n0,1,0,3,-4\n1,1,0,-4.5,0\n"
    status, said = table(text, "--columns", "observations.x=px,observations.y=py", *SIGMAS)
    assert status == 0, said
    assert load_folder(tmp_path / "out").recorded.sensor.max_range == pytest.approx(5.005, rel=1e-12)


def test_a_range_and_a_view_that_are_stated_are_the_sensor_s(table, tmp_path):
    status, said = table(GOOD, *SIGMAS, "--max-range", "8", "--view=-1,0.75")
    assert status == 0, said
    assert "the farthest reading" not in said
    sensor = load_folder(tmp_path / "out").recorded.sensor
    assert (sensor.max_range, sensor.min_angle, sensor.max_angle) == (8.0, -1.0, 0.75)
