"""Packets to frames, and a recording of the link as a log: a replay of what the live estimator received.

Every packet is a frame. Its increment is the odometry difference with the covariance of wheel slip and rounding; its
observations are the walls the packet completes (`wings.robot.observe`). `--log LOG` opens finished and truncated
recordings; `complete` adds the files of an open log.
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data.columns.scans import scans_content
from data.errors import DataError
from data.formats.open_log import SCANS, contents
from data.inputs import Frame, Increment, Increments, Inputs, LandmarkMap, Observations, Prior, Scans
from data.log import Log
from data.origin import Origin
from data.se2 import Array, between
from data.sensors import Line
from data.truth import Truth
from wings.robot.observe import SLIP, WallObserver
from wings.robot.packets import FASTEST, FASTEST_TURN, LONGEST_RANGE, RADIUS, WATCHDOG, WHEEL_BASE
from wings.robot.traffic import HEADER, PACKETS, Packet, decoded, read_recording
from wings.robot.walls import SIGMA, USUAL_FIT

SENSOR = Line(max_range=LONGEST_RANGE + RADIUS)  # distances are from the robot's centre; the sonars sit on its rim
PRIOR = Prior(np.zeros(3), np.zeros((3, 3)))  # exact: the first frame is the origin
ROUNDING = 1e-3 * math.sqrt(2.0 / 12.0)
"""m, rad, standard deviation of a difference of two numbers rounded to whole mm or mrad; measured increment NEES 2.9
(expected 3). These errors cancel over many steps, which the model ignores."""
FLOOR = 1e-10  # m^2, rad^2, variance of a robot at rest: the smallest eigenvalue of an open log's increments


class Noise(NamedTuple):
    """Slip [m per sqrt(m) of a wheel's travel] of each wheel, and standard deviation of a sonar distance [m]."""

    slip: float = SLIP
    sonar_sigma: float = SIGMA


USUAL = Noise()  # noise of the simulated robot


class Framing:
    """Make frames of packets; the first frame is the world's origin. `fit`: of walls, see `wings.robot.walls.FITS`."""

    def __init__(self, noise: Noise = USUAL, fit: str = USUAL_FIT) -> None:
        self.count = self.observations = 0  # frames and wall observations so far
        self._noise, self._walls = noise, WallObserver(noise.sonar_sigma, noise.slip, fit)
        self._before: Packet | None = None

    def frame(self, packet: Packet) -> Frame:
        """The next frame; packets come in the order of their times."""
        before, self._before = self._before, packet
        increment = None if before is None else _increment(before, packet, self._noise.slip)
        seen = self._walls.observe(packet)
        # as the arrays of `Inputs` are: compiled functions distinguish them
        for array in (seen.z, seen.R, *(increment or ())):
            array.setflags(write=False)
        number, first = self.count, self.observations
        self.count, self.observations = number + 1, first + len(seen.z)
        return Frame(number, packet.t, increment, seen, None, first)


def inputs_of(frames: Sequence[Frame], known: LandmarkMap | None = None, scans: Scans | None = None) -> Inputs:
    """Frames (at least one) as the inputs of a log, bit for bit."""
    n = len(frames)
    mean, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
    for k, frame in enumerate(frames):
        if frame.increment is not None:
            mean[k], covariance[k] = frame.increment
    counts = [len(frame.observations.z) for frame in frames]
    z, R = (np.concatenate([getattr(f.observations, name) for f in frames]) for name in ("z", "R"))
    seen = Observations(np.repeat(np.arange(n, dtype=np.int64), counts), z, R)
    time = np.array([frame.time for frame in frames])
    at_rest = int((covariance[:, 0, 0] == FLOOR).sum())
    motion = Increments(mean, covariance)
    return Inputs(PRIOR, time, motion, seen, SENSOR, known, covariance_floor=FLOOR, floored=at_rest, scans=scans)


def scans_of(packets: Sequence[Packet], sigma: float) -> Scans | None:
    """The scans of packets, one frame each; None where there is none. `sigma` [m]: standard deviation of a range."""
    found = [(k, packet.scan) for k, packet in enumerate(packets) if packet.scan is not None]
    if not found:
        return None
    frame = np.array([k for k, _ in found], np.int64)
    return Scans(found[0][1].beams.scanner(sigma), frame, np.array([scan.metres for _, scan in found]))


def _increment(before: Packet, after: Packet, slip: float) -> Increment:
    """Motion (3,) in the body, covariance (3, 3); an unknown one as of full speed until the watchdog stopped it."""
    mean = between(before.odometry, after.odometry)
    if not after.joined:
        far = min(after.t - before.t, WATCHDOG) + WATCHDOG
        turn = min(FASTEST_TURN * far, math.pi)
        return Increment(np.zeros(3), np.diag([(FASTEST * far) ** 2, (FASTEST * far) ** 2, turn**2]))
    if after.answer[1:] == before.answer[1:]:
        return Increment(np.zeros(3), FLOOR * np.eye(3))
    return Increment(mean, slip_covariance(mean, slip) + ROUNDING**2 * np.eye(3))


def slip_covariance(motion: Array, slip: float) -> Array:
    """Covariance (3, 3) of a motion (3,) from the slip of each wheel, in the body frame at its start.

    On an arc that turns by theta the wheels travel f -+ b theta / 2, with base b. A slip s of one wheel moves the
    centre by s / 2 along the chord and turns the body by -+ s / b, the chord by half of that.
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


def opened(folder: Path) -> Log | None:
    """The log of a recording; None for another folder. Raises DataError as `load_recording`."""
    return load_recording(folder) if (folder / PACKETS).exists() else None


def load_recording(folder: Path) -> Log:
    """The log of a recording; its notes name truncation and faults of the line. DataError: damaged, or no packet."""
    recorded = read_recording(folder)
    lidar = recorded.lidar_sigma
    packets, faults = decoded(recorded.records, framed=recorded.framed, scans=lidar is not None)
    if not packets:
        raise DataError.at(folder / PACKETS, f"{len(recorded.records)} records, none of them an answer of the robot")
    framing = Framing(Noise(*recorded.noise), recorded.fit)
    frames = [framing.frame(packet) for packet in packets]
    counted = [f"{count} {name}" for name, count in faults.items() if count]
    notes = [f"Faults of the link: {', '.join(counted)}."] if counted else []
    again = sum(not packet.joined for packet in packets[1:])
    if again:
        notes.append(f"The odometry restarted {again} times; the motion in between is unknown.")
    if recorded.cut:
        notes.append(f"The recording is truncated: it ends with {recorded.cut} bytes of an unfinished record.")
    inputs = inputs_of(frames, scans=None if lidar is None else scans_of(packets, lidar))
    origins = {} if recorded.noise else dict.fromkeys(("odometry_noise", "observation_noise"), Origin.ASSUMED)
    return Log(folder.absolute().name, inputs, Truth(), source=recorded.source, notes=tuple(notes), origins=origins)


def complete(folder: Path) -> Log:
    """Add an open log's files to a recording, `log.toml` last. DataError as `load_recording`, or not writable."""
    log = load_recording(folder)
    files = {name: text.encode() for name, text in contents(log, log.name).items()}
    if log.recorded.scans is not None:
        files[SCANS] = scans_content(log.recorded.scans)
    try:
        for name in [*(n for n in files if n != HEADER), HEADER]:
            partial = folder / f".{name}.partial"
            partial.write_bytes(files[name])
            os.replace(partial, folder / name)
    except OSError as error:
        raise DataError.at(folder, f"cannot be written: {error.strerror}") from error
    return log
