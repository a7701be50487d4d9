"""Measured times of the corridor lab's filter: of each update, and of map maintenance."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from data.log import Log
from data.se2 import Array
from eval.replay.run import front_end
from eval.replay.settings import Setup
from eval.report.page.files import write_table
from wings.labs.corridor import Lab, maintained_pair

REPEATS = 15  # runs measured; of each frame the fastest counts, as whatever else the machine does only adds time
NAME = "lab-update-time"
WHAT = ("without maintenance", "with maintenance")
HEADS = ("run", "median [ms]", "largest [ms]", "whole run [ms]", "removing landmarks [ms]")


class Times(NamedTuple):
    """Seconds (N,) of each frame: update and new landmarks; map maintenance."""

    update: Array
    maintenance: Array


def update_times(
    log: Log, estimator: str, association: str, setups: Sequence[Setup], repeats: int = REPEATS
) -> list[Times]:
    """Time of each frame's update in SLAM and of map maintenance, for each setup: the least of `repeats`, in turns."""
    inputs = log.inputs(labels=association == "known").without_map()
    measured = np.zeros((repeats, len(setups), 2, len(inputs)))
    for turn in measured:
        for setup, seconds in zip(setups, turn, strict=True):
            front = front_end(estimator, association, inputs, setup)
            for k in range(len(inputs)):  # as `eval.replay.run` drives it
                frame = inputs.frame(k)
                front.move(frame)
                begin = end = time.perf_counter()
                if len(frame.observations.z):
                    pairing = front.associate(frame)
                    begin = time.perf_counter()
                    front.update(frame, pairing)
                    end = time.perf_counter()
                front.tidy()
                seconds[:, k] = end - begin, time.perf_counter() - end
    return [Times(update, maintenance) for update, maintenance in measured.min(axis=0)]


def write_times(folder: Path, lab: Lab, setup: Setup, formats: tuple[str, ...]) -> str | None:
    """Write a table of times without and with maintenance, and return its name; None where no run of both ended."""
    both = maintained_pair(lab)
    if both is None:
        return None
    run, log = both[0].run, both[0].log
    setups = [replace(setup, maintain=maintain) for maintain in (False, True)]
    rows = [
        [what, *(1e3 * f(t.update) for f in (np.median, np.max, np.sum)), 1e3 * np.sum(t.maintenance)]
        for what, t in zip(WHAT, update_times(log, run.estimator, run.association, setups), strict=True)
    ]
    caption = f"{log.name}: measured time of a frame's update, fastest of {REPEATS}. Differs from run to run."
    write_table(pd.DataFrame(rows, columns=list(HEADS)), folder / "tables", NAME, caption, formats)
    return f"tables/{NAME}.csv"
