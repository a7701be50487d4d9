"""The pace of a film: which frame of the log each of its pictures shows, as a multiple of real time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data.inputs import Inputs, IntArray

FPS = 20
"""Pictures a second."""
LONGEST = 60.0
"""s; a film whose speed nobody asked for lasts no longer."""
STEPS = (1.0, 2.0, 5.0)
"""Speeds that are chosen: these, and their multiples by powers of ten."""
FRAMES_A_SECOND = 5.0
"""The slowest speed that is chosen for a log whose time counts frames: each can be looked at."""


@dataclass(frozen=True)
class Pace:
    """Seconds of the log in one of the film (frames, without stamps); the frame (P,) of each picture."""

    speed: float
    frame: IntArray
    counts_frames: bool

    @property
    def text(self) -> str:
        """The speed in words."""
        return f"{self.speed:g} frames a second" if self.counts_frames else f"{self.speed:g} x real time"


def pace_of(inputs: Inputs, speed: float | None = None, fps: int = FPS, longest: float = LONGEST) -> Pace:
    """The pace asked for, or the slowest of the round ones from real time on with which the film is short enough.

    Each picture shows the newest frame at its instant; the last one shows the log's last frame.
    """
    time = inputs.time - inputs.time[0]
    length = float(time[-1])
    if speed is None:
        speed = FRAMES_A_SECOND if inputs.time_is_index else 1.0
        speed = _round_up(max(speed, length / longest))
    pictures = max(math.ceil(length / speed * fps - 1e-9), 0) + 1
    instant = np.minimum(np.arange(pictures) * (speed / fps), length)
    return Pace(speed, np.searchsorted(time, instant + 1e-9, side="right").astype(np.int64) - 1, inputs.time_is_index)


def _round_up(speed: float) -> float:
    """The smallest of 1, 2, 5, 10, ... that is no less."""
    power = 10.0 ** math.floor(math.log10(speed))
    return next(step * power for step in (*STEPS, 10.0) if step * power >= speed * (1.0 - 1e-12))
