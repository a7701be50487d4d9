"""Files of a laser log that belong to no single estimator: the map as a picture and for map servers, the loops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from association.scans.constraints import Loops
from association.scans.laser_run import LaserRun
from association.scans.occupancy import Grid, occupancy_grid
from data.graphs.g2o import MOTION, written
from data.log import folder_name
from data.se2 import Array
from eval.figures.laser import map_picture
from eval.figures.style import save
from eval.referee.files.of_runs import LOOPS
from eval.referee.laser.rows import kept
from eval.referee.score import Trial
from eval.report.laser.map_files import write_map

GRAPH = "graph.g2o"


def mapping_run(trial: Trial) -> LaserRun | None:
    """The run whose final poses the map is drawn from: isam2's, or the first that has some; None: no laser log."""
    found = [r for r in trial.runs if isinstance(r, LaserRun) and r.failure is None and r.last is not None]
    return min(found, key=lambda r: r.estimator != "isam2", default=None)


def phase_of(run: LaserRun) -> str:
    """Phase that its last path belongs to, in words."""
    return "final" if run.final is not None else "last state"


def grid_of(trial: Trial, run: LaserRun) -> Grid:
    """The occupancy grid of a run's key scans at its last key poses."""
    scans = trial.log.recorded.scans
    assert scans is not None
    assert run.chain is not None
    assert run.key_pose is not None
    row = np.searchsorted(scans.frame, run.chain.frame)
    row = np.minimum(row, len(scans.frame) - 1)
    there = scans.frame[row] == run.chain.frame
    return occupancy_grid(run.key_pose[there], scans.ranges[row[there]], scans.scanner)


def write_laser_files(folder: Path, trial: Trial) -> None:
    """`map.png`, `map.pgm`, `map.yaml`, `loops.csv`, `graph.g2o` in `runs/<log>/`; nothing if no run matched scans."""
    run = mapping_run(trial)
    if run is None or run.last is None or run.loops is None:
        return
    place = folder / "runs" / folder_name(trial.log.name)
    place.mkdir(parents=True, exist_ok=True)
    grid = grid_of(trial, run)
    write_map(grid, place)
    figure = map_picture(grid, run.last, name=trial.log.name, estimator=run.estimator, phase=phase_of(run))
    save(figure, place, "map", ("png",))
    LOOPS.write(loops_table(run.loops, run.weight), place)
    (place / GRAPH).write_text(graph_of(run), encoding="utf-8")


def graph_of(run: LaserRun) -> str:
    """The key poses with the motion between them and the loop closures that kept their weight, as text for g2o."""
    assert run.chain is not None
    assert run.loops is not None
    assert run.key_pose is not None
    chain, loops = run.chain, run.loops
    keys = range(len(run.key_pose))
    edges = [(MOTION, k - 1, k, chain.motion[k], chain.covariance[k]) for k in keys[1:]]
    for i in np.flatnonzero(kept(loops, run.weight, "final")).tolist():
        edges.append((MOTION, int(loops.key1[i]), int(loops.key2[i]), loops.relative[i], loops.covariance[i]))
    return written((keys, run.key_pose), ((), np.zeros((0, 2))), (0,), edges)


def loops_table(loops: Loops, weight: Array | None) -> pd.DataFrame:
    """loops.csv: every loop closure looked at; accepted: it joined the graph, final: it kept its weight."""
    rows, columns = np.triu_indices(3)
    values = [
        loops.key1, loops.key2, *loops.relative.T, *loops.covariance[:, rows, columns].T, loops.score,
        kept(loops, weight, "online").astype(int), kept(loops, weight, "final").astype(int),
    ]  # fmt: skip
    return pd.DataFrame(dict(zip(LOOPS.names, values, strict=True)))
