"""What is wrong in somebody's files, or was not said, is one line with the place and what would be right."""

import numpy as np
import pytest

from data.questions.asked import ask

GOOD = "t,v,omega,range,bearing\n0,1,0,2,0.1\n1,1,0,2,0.2\n2,1,0,,\n3,1,0,3,-0.5\n"
GAPS = GOOD[:24] + "".join(f"{k},{1 + k / 99 if k < 31 else -999},0,2,0.1\n" for k in range(34))
SIGMAS = ("--odometry-sigma", "0.1,0.1", "--observation-sigma", "0.1,0.1")


@pytest.fixture
def table(convert):
    """`table(text, *words)`: what `convert` gives of a file with that text (or bytes)."""
    return lambda text, *words, **status: convert({"robot.csv": text}, "table", "robot.csv", "out", *words, **status)


@pytest.mark.parametrize(("text", "words", "said"), [
    (GOOD, (*SIGMAS, "--columns", "pressure=v"), "unknown quantity 'pressure'; known: t,"),
    (GOOD, (*SIGMAS, "--columns", "odometry.t=stamp"), "no column 'stamp' (odometry.t); it has columns t, v,"),
    (GOOD, (*SIGMAS, "--unit", "time=fortnight"), "unknown unit 'fortnight'; one of s, ms,"),
    (GOOD, (*SIGMAS, "--prior", "truth", "--prior-sigma", "0,0,0"), "--prior truth: --truth FILE is needed"),
    (GOOD, (*SIGMAS, "--view", "1,1"), "--view 1,1: the smaller bearing first"),
    (GOOD.replace("1,1,0,2", "1,1,0,x"), SIGMAS, ":3: column range: 'x' is not a number"),
    (GOOD.replace("1,1,0,2", '1,1,"0,2'), SIGMAS, ":3: a quote that is not closed within its line"),
    (GOOD.replace("0,1,0,2", "5,1,0,2"), SIGMAS, ":3: column t: 1 follows 5.0; t must not decrease"),
    (GOOD.replace("3,1,0,3", "3,1,0,-3"), SIGMAS, "column range: -3 is a negative range"),
    (GAPS, SIGMAS, ":33: column v: -999 in 3 of 34 rows, far beyond all others, is no measurement"),
    (GOOD.replace("omega", "gyro"), SIGMAS, "no odometry: columns t, v, gyro"),
    (GOOD.replace("omega", "v"), SIGMAS, "columns 2 and 3 are named 'v'; name one by its number"),
    (GOOD.partition("\n")[2], SIGMAS, "columns 1 to 5, without names"),
    (b"PK\x03\x04\x00\x00", SIGMAS, "cannot be unpacked: File is not a zip file"),
    ("t,v,omega,range,bearing\n0,1,0,2,0.1\n1e9,1,0,2,0.2\n", SIGMAS, "--unit time=ns"),
])  # fmt: skip
def test_one_line_says_what_is_wrong(table, text, words, said):
    assert said in table(text, *words, status=2)


@pytest.mark.parametrize("text", [
    "\ufeff" + GOOD.replace("\n", "\r\n"),
    GOOD.encode("utf-16"), 2 * GOOD[:24] + GOOD,
    GOOD.replace("range", "range ").replace("0,1,0,2,0.1", " 0 , 1,0,2,0.1"),
])  # fmt: skip
def test_any_way_of_writing_a_table_gives_the_same_log(table, text):
    r = table(text, *SIGMAS)[0].recorded
    assert r.time.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert r.increments.mean[1].tolist() == [1.0, 0.0, 0.0]
    assert r.observations.frame.tolist() == [0, 1, 3]
    assert r.observations.z.tolist() == [[2.0, 0.1], [2.0, 0.2], [3.0, -0.5]]


def test_dates_are_stamps(table):
    text = GOOD.replace("\n0,", "\n2024-05-01T12:00:00Z,").replace("\n1,", "\n2024-05-01T14:00:01+02:00,")
    text = text.replace("\n2,", "\n2024-05-01 12:00:02,").replace("\n3,", "\n2024-05-01T12:00:03.000,")
    log, _ = table(text, *SIGMAS, "--unit", "time=iso")
    assert np.diff(log.recorded.time).tolist() == [1.0, 1.0, 1.0]
    assert "is not a date" in table(GOOD, *SIGMAS, "--unit", "time=iso", status=2)


@pytest.mark.parametrize(("form", "unit", "column"), [
    ("13/5/2024 9:59:5{}.5", "dmy", "t"), ("5/13/2024 9:59:5{} PM", "mdy", "t"), ("2024:05:13 9:59:5{}", "iso", "t"),
    ("2024-05-13,9:59:5{}", "iso", "day"), ("f171559439{}500.png", "iso", "t"),
    ("1{}.05.2024,9:59:55", "dmy", "time"), ("a/b_2024_05_13_09_59_5{}_500.jpg", "iso", "image"),
])  # fmt: skip
def test_days_before_or_behind_months_and_times_of_day_apart_are_dates(table, form, unit, column):
    text = "\n".join(form.format(line[0]) + line[1:] if line[0].isdigit() else line for line in GOOD.split())
    text = text.replace("t,", {"t": "t,", "image": "image,"}.get(column, "day,time,"), 1)
    log, said = table(text, *SIGMAS, *("--columns", f"t={column}")[: 2 * (column != "image")])
    assert np.ptp(log.recorded.time) == pytest.approx(3.0 * (86400.0 if column == "time" else 1.0))
    assert f"inferred: --unit odometry.t={unit}" in said


def test_the_order_of_day_and_month_is_asked_where_none_is_above_twelve(table):
    text = "\n".join(f"5/6/2024 09:59:5{line}" if line[0].isdigit() else line for line in GOOD.split())
    assert "day or month first? --unit odometry.t=dmy, or odometry.t=mdy, is needed" in table(text, *SIGMAS, status=2)
    assert len(table(text, *SIGMAS, "--unit", "t=dmy")[0].recorded) == 4


def test_headings_that_look_like_degrees_are_asked_about(table):
    rows = "".join(f"{k},{k},0,{10 * k},2,0.1\n" for k in range(100))
    words = ("--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,0.1")
    log, said = table("t,x,y,theta,range,bearing\n" + rows, *words)
    assert "are they degrees?" in said
    assert ask(log)[0].named["flags"] == ("--unit odometry.theta=deg",)
    assert "are they degrees?" not in table("t,x,y,theta,range,bearing\n" + rows, *words, "--unit", "angle=deg")[1]


def written(path, stamps):
    """A file of readings at these stamps [s], the first 2 m away, each next one a metre farther."""
    path.write_text("t,range,bearing\n" + "".join(f"{t!r},{2.0 + i},0.1\n" for i, t in enumerate(stamps)))
    return path


DRIVEN = "t,v,omega\n0,1,0\n0.5,1,0\n1,1,0\n"


@pytest.mark.parametrize(("stamps", "time"), [
    ((0.25, 0.75), (0.0, 0.25, 0.75, 1.0)), ((-0.75, -0.5, 0.5), (0.0, 0.5, 1.0)),
    ((0.5, 1.25, 1.75), (0.0, 0.5, 1.25)), ((0.5, 1.8e6), (0.0, 0.5, 1.0)),
])  # fmt: skip
def test_with_velocities_the_log_ends_as_long_after_the_last_row_as_rows_are_apart(table, tmp_path, stamps, time):
    log, said = table(DRIVEN, "--observations", str(written(tmp_path / "seen.csv", stamps)), *SIGMAS)
    kept = [t for t in stamps if t in time]
    lost = len(stamps) - len(kept)
    assert (f"{lost} of {len(stamps)} observations before or after all odometry" in said) == bool(lost)
    r = log.recorded
    assert r.time.tolist() == list(time)
    assert r.time[r.observations.frame].tolist() == kept
    assert r.observations.z[:, 0].tolist() == [2.0 + i for i, t in enumerate(stamps) if t in time]
    assert r.increments.mean[:, 0].sum() == pytest.approx(time[-1])


@pytest.mark.parametrize(("readings", "reach"), [
    (((2.0, 0.1), (3.0, -0.5), (1.0, 2.9)), 3.003), (((0.5, 1.5), (0.25, 3.0)), 0.5005),
    (((2.0, -0.1), (3.0, -0.5), (1.0, -1.5)), 3.003), (((0.0, 1.0), (0.0, 2.0)), np.inf), ((), np.inf),
    (((3.0, 1.0), (0.0, 1.0), *[(-1.0, 0.5)] * 3), 3.003), (((-2.5, 1.0), *[(2.0, 0.5)] * 10), 2.002),
])  # fmt: skip
def test_a_sensor_whose_range_nobody_states_reaches_a_thousandth_beyond_its_farthest_reading(
    table, tmp_path, readings, reach
):
    seen = tmp_path / "seen.csv"
    seen.write_text("t,range,bearing\n" + ("".join(f"{k},{r},{b}\n" for k, (r, b) in enumerate(readings)) or "0,,\n"))
    log, said = table("t,v,omega\n0,1,0\n1,1,0\n2,1,0\n", "--observations", str(seen), *SIGMAS)
    assert "inferred: max range" in said
    nothing = sum(far <= 0.0 for far, _ in readings)  # zeros, few below, or one number below that stands for none
    assert (f"{nothing} of {len(readings)} observations are at 0 m or less" in said) == bool(nothing)
    sensor = log.recorded.sensor
    assert sensor.max_range == pytest.approx(reach, rel=1e-12)
    assert (sensor.min_angle, sensor.max_angle) == (-np.pi, np.pi)
