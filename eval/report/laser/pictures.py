"""Pictures of a laser log in the report: the map with the path, the pose graph with the fate of its loop closures."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from eval.figures.laser import loop_picture, map_picture
from eval.referee.laser.closures import right_closures
from eval.referee.score import Trial
from eval.report.laser.files import grid_of, mapping_run, phase_of

GRID, LOOPS = "grid", "loops"


def laser_kinds(trial: Trial) -> tuple[str, ...]:
    """Which of these pictures a trial gets."""
    run = mapping_run(trial)
    if run is None:
        return ()
    return (GRID, LOOPS) if run.loops is not None and len(run.loops) else (GRID,)


def laser_picture(trial: Trial, kind: str) -> tuple[Figure, str, str]:
    """Figure, caption and what it shows in a sentence."""
    run, name = mapping_run(trial), trial.log.name
    assert run is not None
    assert run.last is not None
    phase = phase_of(run)
    if kind == GRID:
        return (
            map_picture(grid_of(trial, run), run.last, name=name, estimator=run.estimator, phase=phase),
            f"`{name}`: occupancy grid of the key scans at the key poses of `{run.estimator}` ({phase}), its path on"
            " it. The same as `map.pgm` for map servers. Double walls would be poses that do not agree.",
            f"Occupancy grid of {name} with the path of {run.estimator}",
        )
    assert run.loops is not None
    assert run.chain is not None
    assert run.key_pose is not None
    truth = trial.log.truth.pose
    false = None if truth is None else ~right_closures(run.loops, truth[run.chain.frame])
    weight = np.ones(len(run.loops)) if run.weight is None else run.weight
    return (
        loop_picture(run.key_pose, run.loops, weight, name=name, false=false, estimator=run.estimator),
        f"`{name}`: key poses of `{run.estimator}` ({phase}) and the loop closures that the front end looked at, by"
        " fate. Two that agree with each other are needed before any is believed.",
        f"Pose graph of {name} with its loop closures",
    )
