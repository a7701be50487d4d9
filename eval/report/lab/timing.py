"""How long a filter's update takes, frame by frame, and map maintenance beside it: measured, never the same twice."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from data.log import Log
from data.se2 import Array
from eval.replay.run import front_end
from eval.replay.settings import Setup

REPEATS = 7
"""Runs measured; of each frame the fastest counts, as whatever else the machine does only adds time."""


class Times(NamedTuple):
    """Seconds (N,) of each frame: update and new landmarks; map maintenance."""

    update: Array
    maintenance: Array


def update_times(log: Log, estimator: str, association: str, setup: Setup, repeats: int = REPEATS) -> Times:
    """What the update of each frame takes in SLAM, and map maintenance after it: the fastest of `repeats`."""
    inputs = log.inputs(labels=association == "known").without_map()
    measured = np.zeros((repeats, 2, len(inputs)))
    for seconds in measured:
        front = front_end(estimator, association, inputs, setup)
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
    update, maintenance = measured.min(axis=0)
    return Times(update, maintenance)
