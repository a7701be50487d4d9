"""From packets to frames, one at a time, and a recording of the link as a log: what a live estimator got, replayed.

Every packet is a frame. Its increment is the difference of odometry with the covariance of wheel slip and of rounding
to whole mm and mrad; its observations are the walls that the packet completes (`data.robot.observe`).
`--log LOG` opens the folder finished or cut off; `complete` adds the files of an open log, which others can read.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data.errors import DataError
from data.formats.open_log.writer import contents
from data.inputs import Frame, FrameObservations, Increment, Increments, Inputs, LandmarkMap, Observations, Prior
from data.log import Log
from data.robot.observe import SLIP, WallObserver
from data.robot.packets import FASTEST, FASTEST_TURN, LONGEST_RANGE, RADIUS, WATCHDOG, WHEEL_BASE
from data.robot.traffic.motion import Packet
from data.robot.traffic.recording import PACKETS, read_recording
from data.robot.traffic.stream import decoded
from data.robot.walls import SIGMA
from data.se2 import Array, between
from data.sensors import Line
from data.truth import Truth

SENSOR = Line(max_range=LONGEST_RANGE + RADIUS)
"""Distances are from the robot's middle, sonars sit on its rim."""
ROUNDING = 1e-3 * math.sqrt(2.0 / 12.0)
"""m, rad, standard deviation of the difference of two numbers that were rounded to whole mm or mrad. With half of its
variance the increments' NEES is 3.9 of 3, with it 2.9; over many steps such errors cancel, which is not made use of."""
FLOOR = 1e-10
"""m^2, rad^2, of a robot at rest, whose counters stand still; the smallest eigenvalue of an open log's increments."""


class Noise(NamedTuple):
    """What a robot's numbers are worth.

    Attributes:
        slip: m per square root of a metre of a wheel's way, standard deviation, each wheel for itself.
        sonar_sigma: m, standard deviation of a distance.
    """

    slip: float = SLIP
    sonar_sigma: float = SIGMA


USUAL = Noise()
"""Of the simulated robot."""


class Framing:
    """Makes the frames; the first frame is the world's origin.

    Attributes:
        count: frames so far.
        observations: walls seen so far.
        at_rest: frames so far whose increments hold the floor.
    """

    def __init__(self, noise: Noise = USUAL) -> None:
        """Before the first packet."""
        self.count = self.observations = self.at_rest = 0
        self._noise, self._walls = noise, WallObserver(noise.sonar_sigma, noise.slip)
        self._before: Packet | None = None

    def frame(self, packet: Packet) -> Frame:
        """The next frame; packets come in the order of their times."""
        before, self._before = self._before, packet
        increment = None if before is None else _increment(before, packet, self._noise.slip)
        if increment is not None:
            self.at_rest += bool(increment.covariance[0, 0] == FLOOR)
        seen = self._walls.observe(packet)
        # as the arrays of `Inputs` are: compiled functions make a difference
        for array in (seen.z, seen.R, *(() if increment is None else increment)):
            array.setflags(write=False)
        number, first = self.count, self.observations
        self.count, self.observations = number + 1, first + len(seen.z)
        return Frame(number, packet.t, increment, FrameObservations(seen.z, seen.R), None, first)


def prior() -> Prior:
    """The first frame is the origin."""
    return Prior(np.zeros(3), np.zeros((3, 3)))


def inputs_of(frames: Sequence[Frame], at_rest: int, known: LandmarkMap | None = None) -> Inputs:
    """Frames as one log's inputs, at least one; the same numbers to the bit. `at_rest`: of `Framing`."""
    n = len(frames)
    mean, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
    for k, frame in enumerate(frames):
        if frame.increment is not None:
            mean[k], covariance[k] = frame.increment
    counts = [len(frame.observations.z) for frame in frames]
    observations = Observations(
        np.repeat(np.arange(n, dtype=np.int64), counts),
        np.concatenate([frame.observations.z for frame in frames]),
        np.concatenate([frame.observations.R for frame in frames]),
    )
    time = np.array([frame.time for frame in frames])
    motion = Increments(mean, covariance)
    return Inputs(prior(), time, motion, observations, SENSOR, known, covariance_floor=FLOOR, floored=at_rest)


def _increment(before: Packet, after: Packet, slip: float) -> Increment:
    """Motion (3,) from packet to packet in the body frame of the first, with its covariance (3, 3).

    Of an unknown motion the covariance is that of a robot at its fastest until its watchdog stopped it.
    """
    mean = between(before.odometry, after.odometry)
    if not after.joined:
        far = min(after.t - before.t, WATCHDOG) + WATCHDOG
        turn = min(FASTEST_TURN * far, math.pi)
        return Increment(np.zeros(3), np.diag([(FASTEST * far) ** 2, (FASTEST * far) ** 2, turn**2]))
    moved = (after.answer.x, after.answer.y, after.answer.heading) != (
        *(before.answer.x, before.answer.y, before.answer.heading),
    )
    if not moved:
        return Increment(np.zeros(3), FLOOR * np.eye(3))
    return Increment(mean, slip_covariance(mean, slip) + ROUNDING**2 * np.eye(3))


def slip_covariance(motion: Array, slip: float) -> Array:
    """Covariance (3, 3) of a motion (3,) by the slip of each wheel, in the body frame it begins in.

    On an arc that turns by theta the wheels' ways are f -+ b theta / 2, b the wheels' base. A slip s of the left or the
    right one moves the middle by s / 2 in the direction of the chord and turns by -+ s / b, which turns the chord by
    half of that.
    """
    half = 0.5 * float(motion[2])
    c, s = math.cos(half), math.sin(half)
    forward = float(motion[0]) * c + float(motion[1]) * s
    cov = np.zeros((3, 3))
    for side in (-1.0, 1.0):
        way = abs(forward + side * WHEEL_BASE * half)
        turn = side / WHEEL_BASE
        change = np.array([0.5 * c - 0.5 * turn * forward * s, 0.5 * s + 0.5 * turn * forward * c, turn])
        cov += slip**2 * way * np.outer(change, change)
    return cov


def is_recording(folder: Path) -> bool:
    """Whether a folder holds what went over a robot's link."""
    return (folder / PACKETS).exists()


def load_recording(folder: Path) -> Log:
    """The log of a recording, without labels or truth; what was cut off or went wrong on the line is in its notes.

    Raises:
        DataError: it is damaged, or not one packet came over the line.
    """
    recorded = read_recording(folder)
    packets, faults = decoded(recorded.records, framed=recorded.framed)
    if not packets:
        raise DataError.at(folder / PACKETS, f"{len(recorded.records)} records, and no answer of the robot among them")
    framing = Framing(Noise(*recorded.noise))
    frames = [framing.frame(packet) for packet in packets]
    counted = [f"{count} {name}" for name, count in faults.items() if count]
    notes = [f"Faults of the link: {', '.join(counted)}."] if counted else []
    again = sum(not packet.joined for packet in packets[1:])
    if again:
        notes.append(f"Odometry began anew {again} times; how far the robot moved meanwhile is not known.")
    if recorded.cut:
        notes.append(f"The recording was cut off: {recorded.cut} bytes of an unfinished record at its end.")
    return Log(
        folder.absolute().name, inputs_of(frames, framing.at_rest), Truth(), source=recorded.source, notes=tuple(notes)
    )


def complete(folder: Path) -> Log:
    """Add the files of an open log to a recording that has ended, each whole or not at all, `log.toml` last.

    Raises:
        DataError: as of `load_recording`, or a file cannot be written.
    """
    log = load_recording(folder)
    files = contents(log, log.name)
    header = "log.toml"
    try:
        for name in [*(n for n in files if n != header), header]:
            partial = folder / f".{name}.partial"
            partial.write_text(files[name], encoding="utf-8", newline="")
            os.replace(partial, folder / name)
    except OSError as error:
        raise DataError.at(folder, f"cannot be written: {error.strerror}") from error
    return log
