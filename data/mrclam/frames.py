"""The frames of a UTIAS MRCLAM log: at the readings' own instants or on a grid, with the motion between them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data.inputs import Increments, IntArray
from data.motion.velocity import MAX_HOLD, VelocityModel, preintegrate
from data.mrclam.readings import Readings
from data.se2 import Array
from data.terminal.words import counted
from data.timeline import frame_times

STALE = 0.05
"""s; on a grid, a reading older than this at its frame's instant is dropped, as the classic tutorials do."""


@dataclass(frozen=True)
class Odometry:
    """Corrected odometry: time (K,) s, v (K,) m/s, omega (K,) rad/s."""

    time: Array
    v: Array
    omega: Array


@dataclass(frozen=True)
class Grid:
    """Frames a fixed time apart, as the classic tutorials have them; the switches are what some of their programs do.

    Attributes:
        period: s.
        own: a frame moves with the odometry at its own instant; else with that of the frame before, held until it.
        gapless: odometry is interpolated across its gaps, too, and its first row holds from the first ground-truth
            row on, however long that is.
        skip_led_by: the readings of a frame are left out where the first of them is of this landmark.
    """

    period: float
    own: bool = False
    gapless: bool = False
    skip_led_by: int | None = None


@dataclass(frozen=True)
class Course:
    """Frames: time (N,) s, increments, readings (M,) and the frame (M,) of each."""

    time: Array
    increments: Increments
    readings: Readings
    frame: IntArray

    def after(self, first: int) -> Course:
        """The course from frame `first` on, without the readings of that frame and before."""
        mean, covariance = self.increments.mean[first:].copy(), self.increments.covariance[first:].copy()
        mean[0], covariance[0] = 0.0, 0.0
        rest = self.frame > first
        return Course(
            self.time[first:], Increments(mean, covariance), self.readings.where(rest), self.frame[rest] - first
        )


def lay_out(
    readings: Readings, odometry: Odometry, first: float, last: float, grid: Grid | None, motion: VelocityModel
) -> tuple[Course, list[str]]:
    """Frames from `first` to `last` [s], and sentences about what was lost on the way.

    Without `grid` they are the readings' instants and keyframes. With it they are its period apart, the odometry
    is interpolated at each, and readings move to the nearest.
    """
    notes = []
    if grid is None:
        readings = readings.where((readings.time >= first) & (readings.time <= last))
        time = frame_times(readings.time, first, last)
        frame = np.searchsorted(time, readings.time).astype(np.int64)
    else:
        time = np.asarray(first + grid.period * np.arange(math.floor((last - first) / grid.period + 1e-9) + 1))
        odometry = _on_grid(odometry, time, grid)
        nearest = np.rint((readings.time - first) / grid.period).astype(np.int64)
        inside = (nearest >= 0) & (nearest < len(time))
        stale = inside & (time[nearest.clip(0, len(time) - 1)] - readings.time > STALE)
        if stale.any():
            notes.append(
                f"{counted(int(stale.sum()), 'reading')} older than {STALE:g} s at the instant of their frame: dropped."
            )
        readings, frame = readings.where(inside & ~stale), nearest[inside & ~stale]
        led = np.zeros(len(frame), bool)
        if grid.skip_led_by is not None:
            led = readings.true_id[np.searchsorted(frame, frame)] == grid.skip_led_by
            why = f"the first of their frame is of landmark {grid.skip_led_by}"
            notes.append(f"{int(led.sum())} readings left out: {why}.")
        readings, frame = readings.where(~led), frame[~led]
    increments, gaps = preintegrate(motion, odometry.time, odometry.v, odometry.omega, time)
    if gaps:
        many = "1 gap" if gaps == 1 else f"{gaps} gaps"
        notes.append(f"{many} of more than {MAX_HOLD:g} s in the odometry: the increments' covariance grows there.")
    return Course(time, increments, readings, frame), notes


def held_back(odometry: Odometry) -> Odometry:
    """The first row holds from time 0 on: copies of it, close enough together to be no gap."""
    earlier = np.arange(0.0, odometry.time[0], 0.5 * MAX_HOLD)
    same = np.zeros(len(earlier), np.int64)
    return Odometry(
        np.concatenate([earlier, odometry.time]),
        np.concatenate([odometry.v[same], odometry.v]),
        np.concatenate([odometry.omega[same], odometry.omega]),
    )


def _on_grid(odometry: Odometry, time: Array, grid: Grid) -> Odometry:
    """Velocities from each of the grid's instants (N,) to the next; none inside a gap, unless `gapless`."""
    t = odometry.time
    after = np.searchsorted(t, time, side="left").clip(0, len(t) - 1)
    before = (np.searchsorted(t, time, side="right") - 1).clip(0)
    close = (t[after] - t[before] <= MAX_HOLD) | grid.gapless
    at = time[close]
    then = at + grid.period if grid.own else at
    return Odometry(at, np.interp(then, t, odometry.v), np.interp(then, t, odometry.omega))
