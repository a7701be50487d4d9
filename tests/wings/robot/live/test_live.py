"""`slamref live` as a process: killed at any moment, interrupted once and twice, its device gone and back."""

import os
import signal
import sys
import time

import numpy as np
import pytest

from data.errors import UsageError
from data.formats.open_log import load_folder
from data.logs import open_log
from eval import run_all
from eval.replay.run import compare
from eval.replay.settings import ASSOCIATIONS, Setup
from eval.report import writing
from tests.wings.robot.live.driven import (
    online,
    replayed,
    replayed_bits,
    simulator,
    started,
    true_path,
    wait,
    written_bits,
)
from wings.robot.live import __main__
from wings.robot.traffic import GONE, OPENED, read_recording

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals and fork as Linux has them")
FAST = ["--speed", "5"]
SLACK = 0.15
"""s of real time between what the simulator writes down and what is read of it here."""


@pytest.mark.slow
def test_killed_at_any_moment_the_robot_stops_and_the_log_replays_to_the_bit(tmp_path):
    random, speed = np.random.default_rng(0), 5
    with simulator(tmp_path, "--speed", speed) as (link, truth):
        with started(tmp_path, link, "--speed", speed, "--estimates", tmp_path / "now.csv", "--port", 0) as process:
            wait(lambda: len(path := true_path(truth)) > 0 and np.ptp(path[:, 1]) > 0.02)
            time.sleep(random.uniform(0.0, 1.5) / speed)
            process.signal(signal.SIGKILL)
            process.status()
            at = true_path(truth)[-1, 0]
        wait(lambda: true_path(truth)[-1, 0] > at + 1.0 + SLACK * speed + 0.5)
        path = true_path(truth)
    moving = np.flatnonzero(np.any(np.diff(path[:, 1:], axis=0) != 0.0, axis=1))
    assert path[moving[-1] + 1, 0] - at <= 1.0 + SLACK * speed  # s of the robot's time
    written = written_bits(tmp_path / "now.csv", "ekf-fej")
    log = open_log(str(tmp_path / "log"))
    # what was recorded last may not have been estimated yet
    assert len(written) <= len(log.recorded) <= len(written) + 2
    again = replayed_bits(replayed(tmp_path / "log", "ekf-fej"))
    assert [written[k] for k in range(len(written))] == again[: len(written)]


@pytest.mark.slow  # a report takes seconds
def test_interrupted_it_leaves_the_whole_log_and_a_report(tmp_path):
    words = ["--gate", "0.95", "--estimates", tmp_path / "now.csv"]
    with simulator(tmp_path, *FAST) as (link, truth), started(tmp_path, link, *FAST, *words) as process:
        process.until("walls 1")
        process.signal(signal.SIGINT)
        assert process.status() == 0, process.said
        path = true_path(truth)
    assert np.ptp(path[:, 1]) > 0.1
    assert "report: " in process.said
    assert {f.name for f in (tmp_path / "log").iterdir()} == {
        "log.toml", "packets.bin", "frames.csv", "observations.csv",
    }  # fmt: skip
    read, packets = load_folder(tmp_path / "log"), open_log(str(tmp_path / "log"))
    assert read.recorded.observations.z.tobytes() == packets.recorded.observations.z.tobytes()
    (run,) = compare(packets.inputs(), "slam", ["ekf-fej"], "jcbb", Setup(gate=0.95))
    assert list(written_bits(tmp_path / "now.csv", "ekf-fej").values()) == replayed_bits(run), "as run_all makes it"
    command = (tmp_path / "log-report" / "report.md").read_text()
    assert "--gate 0.95" in command
    assert "--association jcbb" in command


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_interrupted_again_in_the_report_the_log_is_whole_and_there_is_no_report(tmp_path, number, monkeypatch):
    written = writing.write_results

    def slowly(*what, **more):
        done = written(*what, **more)
        time.sleep(20.0)  # a report of so short a drive would be done before anyone could press a key
        return done

    monkeypatch.setattr(writing, "write_results", slowly)
    with simulator(tmp_path, *FAST) as (link, _), started(tmp_path, link, *FAST, "--no-page") as process:
        process.until("ekf-fej x")
        process.signal(signal.SIGTERM)
        process.until("log: ")
        process.signal(number)
        assert process.status() == 130, process.said
    assert len(load_folder(tmp_path / "log").recorded) > 1
    assert not [f for f in tmp_path.iterdir() if "report" in f.name], "neither whole nor half"
    assert "no report; the log is whole: " in process.said
    assert "Traceback" not in process.said


@pytest.mark.slow
def test_a_device_that_goes_and_comes_back_is_a_fault_and_the_drive_goes_on(tmp_path):
    words = ["--estimates", tmp_path / "now.csv", "--speed", 5]
    with simulator(tmp_path, *FAST) as (link, _):
        process = started(tmp_path, link, *words)
        running = process.__enter__()
        running.until("ekf-fej x")
    try:
        running.until("device gone 1")
        with simulator(tmp_path, *FAST):
            frames = len(written_bits(tmp_path / "now.csv", "ekf-fej"))
            wait(lambda: len(written_bits(tmp_path / "now.csv", "ekf-fej")) > frames + 20)
            running.signal(signal.SIGINT)
            running.until("log: ")
            running.signal(signal.SIGINT)
            running.status()
    finally:
        process.__exit__(None, None, None)
    kinds = [r.kind for r in read_recording(tmp_path / "log").records]
    assert kinds.count(GONE) == 1
    assert kinds.count(OPENED) == 2
    written = written_bits(tmp_path / "now.csv", "ekf-fej")
    assert [written[k] for k in range(len(written))] == replayed_bits(replayed(tmp_path / "log", "ekf-fej"))


@pytest.mark.slow
def test_told_to_rest_it_rests_and_ends_by_itself(tmp_path):
    words = [*FAST, "--drive", "none", "--seconds", 4, "--no-page", "--framed"]
    with simulator(tmp_path, *FAST, "--framed") as (link, truth), started(tmp_path, link, *words) as process:
        process.until("log: ")
        process.signal(signal.SIGINT)
        process.status()
        assert np.ptp(true_path(truth)[:, 1]) == 0.0
    assert read_recording(tmp_path / "log").framed
    assert len(open_log(str(tmp_path / "log")).recorded) >= 10
    assert "page" not in process.said


@pytest.mark.slow
def test_with_a_lidar_it_matches_scans_shows_a_grid_and_reports_both(tmp_path):
    words = [*FAST[:1], "2", "--lidar", "--seconds", 12, "--estimates", tmp_path / "now.csv"]
    with simulator(tmp_path, *FAST[:1], "2", "--lidar") as (link, truth), started(tmp_path, link, *words) as process:
        assert process.status(180.0) == 0, process.said
        path = true_path(truth)
    assert "isam2 scan x " in process.said
    assert "ms a frame; period 125" in process.said
    log = open_log(str(tmp_path / "log")).inputs()
    assert len(log.scans.frame) > 0.9 * len(log)
    assert len(written_bits(tmp_path / "now.csv", "isam2 scan")) > 0.9 * len(log)
    assert np.ptp(path[:, 1]) > 0.5
    assert "--association jcbb,scan" in (tmp_path / "log-report" / "report.md").read_text()


def test_a_device_that_is_not_there_leaves_nothing(tmp_path, capsys):
    assert __main__.main(["--link", str(tmp_path / "robot"), "--out", str(tmp_path / "log"), "--no-page"]) == 2
    said = capsys.readouterr()
    assert "cannot be opened as a serial line" in said.err
    assert said.out == "getting ready ...\n"
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("status", "presses"), [(0, 0), (0, 1), (1, 1), (2, 0), (130, 1), (0, 2), (None, 0)])
def test_after_the_drive_it_says_where_the_log_is_and_whether_there_is_a_report(
    tmp_path, capsys, monkeypatch, status, presses
):
    folder, asked = tmp_path / "log", []

    def driven(wish, pressed, stack):  # a second of the robot's time, and not of ours
        assert "getting ready ..." in capsys.readouterr().out
        online(wish.out, 1.0)
        with (wish.out / "packets.bin").open("ab") as file:
            file.write(b"R")
        for _ in range(presses):
            signal.raise_signal(signal.SIGINT)

    def report(words):
        asked.append(words)
        if status is None:
            signal.raise_signal(signal.SIGINT)  # from here on it ends the report
        return status

    monkeypatch.setattr(__main__, "_drive", driven)
    monkeypatch.setattr(run_all, "main", report)
    ended = __main__.main(["--link", "robot", "--out", str(folder), "--gate", "0.95"])
    made = status in (0, 1) and presses < 2
    assert ended == (status if made or status == 2 else 130)
    end = [] if made else [f"no report; the log is whole: {folder}"]
    lines = capsys.readouterr().out.splitlines()
    cut, rest = lines[-2 - len(end)], lines[-1 - len(end) :]
    assert cut == "The recording is truncated: it ends with 1 bytes of an unfinished record."
    assert rest == [f"log: {folder}", *end]
    assert (folder / "frames.csv").is_file()
    words = ["--log", str(folder), "--task", "slam", "--out", f"{folder}-report"]
    assert [a[:6] for a in asked] == ([words] if presses < 2 else [])
    assert all(a[a.index("--gate") + 1] == "0.95" for a in asked)


def test_the_ways_of_association_that_are_offered_are_those_it_takes(tmp_path, capsys):
    link = ["--link", "robot", "--out", str(tmp_path / "log")]
    assert __main__.main([*link, "--association", "known"]) == 2
    offered = capsys.readouterr().err.strip().removesuffix(" do").rsplit("; ", 1)[1].split(", ")
    assert "jcbb" in offered
    taken = []
    for name in ASSOCIATIONS:
        try:
            taken.append(*__main__.read([*link, "--association", name]).options.selection.association)
        except UsageError:
            continue
    assert taken == offered


@pytest.mark.parametrize(("more", "estimators", "associations", "by_walls"), [
    ([], ("ekf-fej", "isam2"), ("jcbb", "scan"), "jcbb"), (["--association", "scan"], ("isam2",), ("scan",), None),
    (["--association", "nn"], ("ekf-fej", "isam2"), ("nn",), "nn"),
    (["--estimator", "isam2", "--association", "scan,ml"], ("isam2",), ("scan", "ml"), "ml"),
])  # fmt: skip
def test_with_a_lidar_scans_are_matched_beside_walls_unless_one_is_asked_for(
    tmp_path, more, estimators, associations, by_walls
):
    wish = __main__.read(["--link", "robot", "--out", str(tmp_path / "log"), "--lidar", *more])
    asked = wish.options.selection
    assert (asked.estimator, asked.association, wish.by_walls) == (estimators, associations, by_walls)
    assert wish.by_scans == ("scan" in associations)
    assert wish.lidar_sigma == 0.01
    words = __main__.report_words(wish)
    assert words[words.index("--association") + 1] == ",".join(associations)
    assert words[words.index("--estimator") + 1] == ",".join(estimators)


@pytest.mark.parametrize(("words", "why"), [
    (["--association", "known"], "--association known: walls have no labels"),
    (["--association", "jcbb-hindsight"], "--association jcbb-hindsight: needs point landmarks"),
    (["--association", "nn,jcbb"], "--association nn,jcbb: one name is needed"),
    (["--estimator", "batch"], "--estimator batch: does not work step by step"),
    (["--speed", "0"], "--speed 0: a number from 0.01 to 1000 is needed"),
    (["--slip", "much"], "--slip much: a number from 0 up is needed"),
    (["--port", "1.5"], "--port 1.5: a whole number from 0 to 65535 is needed"),
    (["--seconds", "nan"], "--seconds nan: a number from 0 up is needed"),
    (["--gate", "2"], "--gate 2: a probability"),
    (["--association", "jcbb,scan"], "--association scan: --lidar is needed"),
    (["--lidar-sigma", "0.02"], "--lidar-sigma 0.02: --lidar is needed"),
    (["--lidar", "--lidar-sigma", "0"], "--lidar-sigma 0: a number from 1e-06 up is needed"),
    (["--lidar", "--association", "nn,jcbb,scan"], "--association nn,jcbb,scan: one name is needed, and scan"),
    (["--lidar", "--estimator", "ekf"], "--estimator ekf: with --association scan isam2 is needed"),
    (["--lidar", "--association", "scan", "--estimator", "ekf,isam2"],
     "--estimator ekf: --association scan has isam2 alone"),
])  # fmt: skip
def test_what_makes_no_sense_is_one_line(tmp_path, refused, words, why):
    said = refused(__main__.main, ["--link", "robot", "--out", str(tmp_path / "log"), *words])
    assert said.startswith(f"slamref: {why}")
    assert os.listdir(tmp_path) == []
