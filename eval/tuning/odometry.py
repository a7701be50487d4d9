"""Recorded odometry, and increments of it that may stand a little earlier without averaging its noise.

Cut between two samples, an increment holds a part of either, and the average of two noises is smaller than each: where
the frames stand at the odometry's own stamps, a likelihood of increments cut anew at every latency has a maximum half a
sample before the right one and another half a sample after it (the interpolation artefact of image registration: Pluim,
Maintz and Viergever, Computer Vision and Image Understanding 77, 2000). So an increment is cut once and moved from
there with the velocity averaged over `HALF_WIDTH` either side, an instrument that its own noise does not favour: the
covariance of that average with the noise of the increment is the same at both ends and cancels (instrumental variables
against errors in variables: Söderström and Stoica, System Identification, 1989, chapter 8).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data import se2
from data.errors import DataError
from data.inputs import Increments
from data.motion.velocity import MAX_HOLD, VelocityModel
from data.open_log.csv_table import read_table
from data.open_log.header import read_header
from data.open_log.reader import HEADER, ODOMETRY
from data.se2 import Array

HALF_WIDTH = 0.3
"""s. Either side of an instant, for its velocity: many samples, and short against the manoeuvres of a robot."""
SAMPLES = 3
"""Odometry samples that the velocity of an instant is averaged over, either side, at least."""


@dataclass(frozen=True, eq=False)
class Odometry:
    """odometry.csv as recorded: stamps [s], v [m/s], omega [rad/s] (K,), and how they become increments."""

    time: Array
    v: Array
    omega: Array
    model: VelocityModel


def read_odometry(folder: Path) -> Odometry | None:
    """The recorded odometry of a log folder that has loaded; None for one with frames.csv, or for a log by name."""
    if not (folder / ODOMETRY).is_file():
        return None
    motion = read_header(folder / HEADER).motion
    if motion is None:
        raise DataError.at(folder / HEADER, f"no [motion] table; {ODOMETRY} needs one")
    table = read_table(folder / ODOMETRY, ("t", "v", "omega"))
    return Odometry(table.columns["t"], table.columns["v"], table.columns["omega"], motion)


def smooth_velocity(odometry: Odometry, at: Array) -> Array:
    """Mean v [m/s] and omega [rad/s] (N, 2) over the same time before and after each instant `at` (N,); 0 in gaps."""
    time = odometry.time
    if len(time) < 2:
        return np.zeros((len(at), 2))
    length = np.diff(time)
    width = max(HALF_WIDTH, SAMPLES * float(np.median(length)))
    hold = np.minimum(length, MAX_HOLD)
    # distance and rotation so far, at the end of every sample and where it stops to hold
    knots = np.column_stack([time[:-1], time[:-1] + hold]).ravel()
    mean = np.empty((len(at), 2))
    for column, rate in enumerate((odometry.v, odometry.omega)):
        moved = rate[:-1] * hold
        end = np.cumsum(moved)
        so_far = np.column_stack([end - moved, end]).ravel()
        mean[:, column] = (np.interp(at + width, knots, so_far) - np.interp(at - width, knots, so_far)) / (2.0 * width)
    return mean


def moved_later(increments: Increments, velocity: Array, by: float) -> Increments:
    """Increments (N, 3) between instants `by` s later each, at velocities (N, 2) of the instants; the same noise."""
    arc = _arc(by * velocity[:, 0], by * velocity[:, 1])
    mean = increments.mean.copy()
    mean[1:] = se2.compose(se2.inverse(arc[:-1]), se2.compose(mean[1:], arc[1:]))
    return Increments(mean, increments.covariance)


def _arc(distance: Array, rotation: Array) -> Array:
    """End (N, 3) of arcs of constant curvature."""
    half = 0.5 * rotation
    chord = distance * np.sinc(half / np.pi)
    return np.column_stack([chord * np.cos(half), chord * np.sin(half), rotation])
