"""The simulated robot as a process on a pseudo-terminal, and the link to it through pyserial, by the clock."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from data.errors import UsageError
from tests.builders.processes import python
from wings.robot.link import Clock, Link
from wings.robot.packets import command_of
from wings.robot.simulate import Terminal
from wings.robot.traffic import Recording, decoded, read_recording

ROOT = Path(__file__).parents[3]


def until(true, seconds=120.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.005)


def start(*arguments):
    return subprocess.Popen([sys.executable, "-m", *map(str, arguments)], cwd=ROOT, stdout=subprocess.PIPE)


@contextlib.contextmanager
def simulated(path, *flags):
    process = start("data.robot.simulate", "--link", path, *flags)
    try:
        until(path.exists)
        yield process
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


def ended(*flags):
    return python("-m", "data.robot.simulate", *flags)


def truth(path):
    lines = path.read_text().rpartition("\n")[0].splitlines()[1:]
    return np.array([[float(v) for v in line.split(",")] for line in lines])


@pytest.mark.slow
def test_a_link_through_pyserial_to_a_robot_on_a_terminal_and_its_log(tmp_path):
    path, log = tmp_path / "robot", tmp_path / "log"
    with simulated(path, "--speed", 10, "--truth", tmp_path / "truth.csv") as process:
        assert path.is_symlink()
        with Recording(log) as recording, Link(str(path), Clock(10.0), recording) as link:
            packets = [p for _ in range(30) for p in link.step(command_of(0.2, 0.5))]
        assert len(packets) > 10
        process.terminate()
        assert process.wait(60) == 0
    assert not path.is_symlink()
    records, framed, cut, *_ = read_recording(log)
    again, faults = decoded(records, framed=framed)
    assert list(map(repr, again)) == list(map(repr, packets))
    assert (cut, faults) == (0, link.exchange.faults)
    rows = truth(tmp_path / "truth.csv")
    assert np.diff(rows[:, 0]) == pytest.approx(0.05)
    assert np.hypot(*(rows[-1, 1:3] - [1.0, 1.0])) > 0.1


@pytest.mark.parametrize(("flags", "message"), [
    (("--world", "walls:x"), "walls:SEED or floorplan:SEED is one"),
    (("--drop", "2"), "--drop 2: a number from 0 to 1 is needed"),
])  # fmt: skip
def test_what_makes_no_sense_is_one_line(tmp_path, flags, message):
    result = ended("--link", tmp_path / "robot", *flags)
    assert (result.returncode, result.stdout) == (2, "")
    assert message in result.stderr
    assert "Traceback" not in result.stderr


def test_a_link_to_a_terminal_is_replaced_and_removed_by_whose_it_is_and_anything_else_of_that_name_left(tmp_path):
    path = tmp_path / "robot"
    path.symlink_to("/dev/pts/99999")
    with Terminal(path):
        old = os.readlink(path)
        with Terminal(path):
            assert old != os.readlink(path) != "/dev/pts/99999"
        assert not path.is_symlink()
        path.symlink_to("/dev/pts/99999")
    assert os.readlink(path) == "/dev/pts/99999"
    path.unlink()
    path.symlink_to(tmp_path)
    with pytest.raises(UsageError, match="exists already"):
        Terminal(path)
    assert path.resolve() == tmp_path.resolve()
    with pytest.raises(UsageError, match="No such file or directory"):
        Terminal(tmp_path / "no" / "robot")


@pytest.mark.slow
def test_the_reader_killed_50_times_leaves_a_log_whole_to_the_last_record_and_a_robot_that_stands_within_a_second(
    tmp_path,
):
    path, rng = tmp_path / "robot", np.random.default_rng(0)
    with simulated(path, "--truth", tmp_path / "truth.csv", "--world", "walls:0"):
        for turn in range(50):
            log = tmp_path / f"log{turn}"
            reader = start("tests.wings.robot.reader", path, log)
            said = os.read(reader.stdout.fileno(), 1)  # the first record: the link is open
            time.sleep(rng.uniform(0.0, 1.2))
            reader.send_signal(signal.SIGKILL)
            reader.wait()
            before = truth(tmp_path / "truth.csv")[-1, 0]
            until(lambda before=before: truth(tmp_path / "truth.csv")[-1, 0] > before)
            at = truth(tmp_path / "truth.csv")[-1, 0]  # a twentieth of a second after the kill, or less
            said += reader.stdout.read()
            reader.stdout.close()
            kept = int(said.split(b"\n")[-2]) if b"\n" in said else 0
            records, framed, cut, *_ = read_recording(log)
            assert kept <= len(records) <= kept + 1  # killed between writing and saying so
            assert cut == 0
            packets, _ = decoded(records, framed=framed)
            assert packets or len(records) < 6
            until(lambda at=at: truth(tmp_path / "truth.csv")[-1, 0] > at + 1.3)
            rows = truth(tmp_path / "truth.csv")
            after = rows[rows[:, 0] >= at + 1.0]
            np.testing.assert_array_equal(after[:, 1:], after[:1, 1:].repeat(len(after), 0))


@pytest.mark.slow
@pytest.mark.parametrize("flags", [(), ("--framed",)])
def test_by_the_clock_on_a_bad_line_nothing_is_raised_and_the_robot_drives(tmp_path, flags):
    path = tmp_path / "robot"
    with (
        simulated(path, "--drop", 0.01, "--flip", 0.001, "--stall", 2, "--truth", tmp_path / "truth.csv", *flags),
        Link(str(path), Clock(), with_frames=bool(flags)) as link,
    ):
        packets = [p for _ in range(240) for p in link.step(command_of(0.2, 0.5))]
    assert len(packets) > 240 * (0.96 * 0.8) * 0.7
    assert sum(not p.joined for p in packets) == 1
    assert np.ptp(truth(tmp_path / "truth.csv")[:, 1]) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize("flags", [(), ("--drop", 0.3), ("--flip", 0.2), ("--stall", 5), ("--framed", "--drop", 0.05)])
def test_by_the_clock_the_robot_stands_1_05_s_after_the_last_command(tmp_path, flags):
    path, rows = tmp_path / "robot", tmp_path / "truth.csv"
    with simulated(path, "--truth", rows, *flags):
        with Link(str(path), Clock(), with_frames="--framed" in flags) as link:
            for _ in range(12):
                link.step(command_of(0.2, 0.5))
                at = truth(rows)[-1, 0]
        until(lambda: truth(rows)[-1, 0] > at + 2.0)
    after = truth(rows)
    after = after[after[:, 0] >= at + 1.05]
    assert len(after) > 10
    np.testing.assert_array_equal(after[:, 1:], after[:1, 1:].repeat(len(after), 0))
