"""How long a filter's update takes, frame by frame, and map maintenance beside it: measured, never the same twice."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data.inputs import Inputs
from data.log import Log
from data.se2 import Array
from eval.replay.frontend import FrontEnd
from eval.replay.run import front_end
from eval.replay.settings import Setup

REPEATS = 15
"""Runs measured; of each frame the fastest counts, as whatever else the machine does only adds time."""


class Times(NamedTuple):
    """Seconds (N,) of each frame: update and new landmarks; map maintenance."""

    update: Array
    maintenance: Array


def update_times(
    log: Log, estimator: str, association: str, setups: Sequence[Setup], repeats: int = REPEATS
) -> list[Times]:
    """What each frame's update takes in SLAM, and map maintenance after it, with each setup: the fastest of `repeats`.

    Setups take turns, so that a busy machine slows all of them.
    """
    inputs = log.inputs(labels=association == "known").without_map()
    measured = np.zeros((repeats, len(setups), 2, len(inputs)))
    for turn in measured:
        for setup, seconds in zip(setups, turn, strict=True):
            _measure(inputs, front_end(estimator, association, inputs, setup), seconds)
    return [Times(update, maintenance) for update, maintenance in measured.min(axis=0)]


def _measure(inputs: Inputs, front: FrontEnd, seconds: Array) -> None:
    """Drive a front end over a log, as `eval.replay.run` does, and fill seconds (2, N): update, maintenance."""
    for k in range(len(inputs)):
        frame = inputs.frame(k)
        front.move(frame)
        begin = end = time.perf_counter()
        if len(frame.sightings.z):
            pairing = front.associate(frame)
            begin = time.perf_counter()
            front.update(frame, pairing)
            end = time.perf_counter()
        front.tidy()
        seconds[:, k] = end - begin, time.perf_counter() - end
