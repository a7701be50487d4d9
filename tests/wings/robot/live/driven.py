"""Drives for tests: without a clock, and with the simulator and the command as processes that can be killed."""

import contextlib
import csv
import multiprocessing
import os
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from data.logs import open_log
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from tests.wings.robot.line import linked
from wings.robot import simulate
from wings.robot.driving import WallFollower
from wings.robot.live import __main__
from wings.robot.live.drive import drive as drive_on_line
from wings.robot.live.session import Session
from wings.robot.packets import PERIOD
from wings.robot.simulated import Faults, drive, room
from wings.robot.traffic import Recording

FORK = multiprocessing.get_context("fork")
BAD = Faults(0.002, 0.001, 0.0)


@cache
def _longest():
    return drive(room(0), WallFollower(), 135.0, np.random.default_rng(0)).packets


def packets(seconds):
    assert seconds <= 135.0
    return _longest()[: round(seconds / PERIOD)]


def online(folder, seconds, names=("ekf",), association="jcbb", setup=None, *, faults=BAD, look=lambda t: None):
    """A drive over a line without a clock, recorded in a folder; all that was taken."""
    taken = []
    session = Session(names, association, setup or Setup(), processed=taken.append)
    with Recording(folder) as recording:
        link, _, clock = linked(faults, 1, recording=recording)
        drive_on_line(link, clock, session, WallFollower(), lambda: clock.now() >= seconds, look)
    return taken, session


def estimate_bits(mean, covariance):
    return np.concatenate([mean, covariance[np.triu_indices(3)]]).tobytes()


def replayed(folder, name, association="jcbb", setup=None):
    """The run of a recording, as `run_all` makes it."""
    inputs = open_log(str(folder)).inputs().without_map()
    return step_by_step(name, inputs, "slam", association, setup or Setup(), finish=False)


def replayed_bits(run):
    t = run.trajectory("online")
    return [estimate_bits(*row) for row in zip(t.pose, t.covariance, strict=True)]


def written_bits(path, name):
    """Estimates that `--estimates` wrote, by frame; a line that was cut off is left out."""
    columns = ["x", "y", "theta", "xx", "xy", "xt", "yy", "yt", "tt"]
    whole = path.read_text()
    rows = csv.DictReader(whole[: whole.rindex("\n") + 1].splitlines())
    found = {}
    for row in rows:
        if row["estimator"] == name:
            found[int(row["frame"])] = np.array([float(row[c]) for c in columns]).tobytes()
    return found


def _quietly(main, words, output):
    os.setpgrp()
    with open(output, "w", buffering=1) as file:
        sys.stdout = sys.stderr = file  # pytest's own would go on into its files
        status = 99
        try:
            status = main(words)
        finally:
            if sys.exc_info()[0] is not None:
                traceback.print_exc(file=file)
            file.flush()
            os._exit(status)


class Process:
    def __init__(self, main, words, output):
        self.output = output
        self._process = FORK.Process(target=_quietly, args=(main, [str(w) for w in words], output))
        self._process.start()

    @property
    def said(self):
        return self.output.read_text() if self.output.exists() else ""

    def signal(self, number):
        os.kill(self._process.pid, number)

    def until(self, text, seconds=30.0):
        wait(lambda: text in self.said or not self._process.is_alive(), seconds)
        assert text in self.said, self.said

    def status(self, seconds=60.0):
        self._process.join(seconds)
        assert self._process.exitcode is not None, self.said
        return self._process.exitcode

    def kill(self):
        with contextlib.suppress(ProcessLookupError):
            self.signal(signal.SIGKILL)
        self._process.join()


def wait(until, seconds=120.0):
    end = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


@contextlib.contextmanager
def simulator(folder: Path, *more) -> Iterator[tuple[Path, Path]]:
    """The simulated robot; yields its link and the file with its true path."""
    link, truth = folder / "robot", folder / "truth.csv"
    process = Process(simulate.main, ["--link", link, "--truth", truth, *more], folder / "simulator.out")
    try:
        wait(link.exists)
        yield link, truth
    finally:
        process.kill()


@contextlib.contextmanager
def started(folder: Path, link: Path, *more, out="log") -> Iterator[Process]:
    process = Process(__main__.main, ["--link", link, "--out", folder / out, *more], folder / f"{out}.out")
    try:
        yield process
    finally:
        process.kill()


def true_path(file):
    """Rows t, x, y, theta that are whole."""
    text = file.read_text()
    lines = text[: text.rindex("\n")].splitlines()[1:]
    return np.array([[float(cell) for cell in line.split(",")] for line in lines]).reshape(-1, 4)
