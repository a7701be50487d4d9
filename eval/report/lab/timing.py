"""How long a filter's update takes, frame by frame, measured: never the same twice."""

from __future__ import annotations

import time

import numpy as np

from data.inputs import Frame, IntArray
from data.log import Log
from data.se2 import Array
from eval.replay.frontend import FrontEnd, Pairing
from eval.replay.run import step_by_step
from eval.replay.settings import Setup

REPEATS = 7
"""Runs measured; of each frame the fastest counts, as whatever else the machine does only adds time."""


class _Stopwatch:
    """Looks on while a log is replayed, and measures from the decision to the end of the frame."""

    def __init__(self, frames: int) -> None:
        self.seconds = np.zeros(frames)
        self.began: float | None = None

    def moved(self, front: FrontEnd) -> None:
        """A frame without observations has no update."""
        self.began = None

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        """Update, new landmarks and map maintenance begin."""
        self.began = time.perf_counter()

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """They are over."""
        if self.began is not None:
            self.seconds[front.k] = time.perf_counter() - self.began


def update_times(log: Log, estimator: str, association: str, setup: Setup, repeats: int = REPEATS) -> Array:
    """Seconds (N,) that update, new landmarks and maintenance of each frame take in SLAM: the fastest of `repeats`."""
    inputs = log.inputs(labels=association == "known").without_map()
    measured = []
    for _ in range(repeats):
        watch = _Stopwatch(len(inputs))
        step_by_step(estimator, inputs, "slam", association, setup, finish=False, observer=watch)
        measured.append(watch.seconds)
    fastest: Array = np.min(measured, axis=0)
    return fastest
