"""Key poses and loop closures of a laser run in a chunk."""

from __future__ import annotations

from typing import Any

import numpy as np

from association.scans.laser_run import LaserRun
from eval.figures.laser import FATES, fates
from eval.figures.style import Line
from eval.player.pack import Pack
from eval.referee.laser.closures import right_closures
from eval.referee.score import Trial


def add_loops(pack: Pack, key: str, run: LaserRun, trial: Trial, step: float) -> list[dict[str, Any]]:
    """Arrays named `key` and a name; colour, line and name of each fate a loop closure can have."""
    if run.loops is None or run.chain is None or run.key_pose is None or not len(run.loops):
        return []
    truth = trial.log.truth.pose
    false = None if truth is None else ~right_closures(run.loops, truth[run.chain.frame])
    weight = np.ones(len(run.loops)) if run.weight is None else run.weight
    names = list(FATES)
    fate = fates(run.loops, weight, false)
    pack.add(f"{key}key_frame", run.chain.frame)
    pack.add(f"{key}key_xy", run.key_pose[:, :2], step)
    pack.add(f"{key}loop_keys", np.column_stack([run.loops.key1, run.loops.key2]))
    pack.add(f"{key}loop_fate", np.array([names.index(f) for f in fate]))
    return [
        {"name": name, "colour": colour, "dash": dashes(line)}
        for name, (colour, line, _) in FATES.items()
        if false is not None or name != names[-1]
    ]


def dashes(line: Line) -> list[float]:
    """Lengths of dash and gap in turn; none of a solid line."""
    return [] if line == "-" else list(line[1])
