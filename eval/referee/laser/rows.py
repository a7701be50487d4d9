"""Rows of relations.csv and association.csv for runs over laser logs."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from association.scans.constraints import Loops
from association.scans.laser_run import LaserRun
from data.log import Log
from data.result import Run
from data.se2 import Array, BoolArray
from eval.referee.laser.closures import knowable, right_closures, scan_points_of
from eval.referee.laser.relations import SUBSETS, TIES, relation_errors

KEPT = 0.05
"""Weight below which a robust back end has left a loop closure out: Cauchy's at 4.4 sigma, beyond which one honest one
in 5000 lies (3 dof); GNC's are 0 or 1."""


def paths_of(run: Run) -> dict[str, Array]:
    """Phase to path (N, 3); of a filter over key poses `final` is the path of its last state."""
    found = {phase: run.trajectory(phase).pose for phase in run.phases}
    if isinstance(run, LaserRun) and run.last is not None:
        found["final"] = run.last
    return found


def relation_rows(run: Run, log: Log) -> list[dict[str, object]]:
    """Errors of a run against the log's reference relations, by row and by time, all and exact ones."""
    relations = log.truth.relations
    if relations is None or run.failure is not None:
        return []
    rows = []
    for phase, path in paths_of(run).items():
        for tie in TIES:
            for subset in SUBSETS:
                found = relation_errors(path, relations, log.recorded.time, tie=tie, subset=subset)
                if found is not None:
                    rows.append({
                        "log": log.name, "estimator": run.estimator, "association": run.association, "phase": phase,
                        "tie": tie, "subset": subset, **asdict(found),
                    })  # fmt: skip
    return rows


def kept(loops: Loops, weight: Array | None, phase: str) -> BoolArray:
    """Which loop closures (L,) count as believed: online what joined the graph, in the end what kept its weight."""
    believed: BoolArray = loops.believed >= 0
    if phase == "final" and weight is not None:
        believed = believed & ~(weight < KEPT)
    return believed


def closure_counts(run: LaserRun, log: Log, phase: str) -> dict[str, object] | None:
    """Loop closures as columns of association.csv; None where the true poses of their key poses are not known."""
    truth = log.truth.pose
    if truth is None or run.loops is None or run.chain is None:
        return None
    keys = truth[run.chain.frame]
    loops = run.loops
    ends = np.concatenate([loops.key1, loops.key2])
    if not np.isfinite(keys[ends]).all():
        return None
    right, believed = right_closures(loops, keys), kept(loops, run.weight, phase)
    if log.recorded.scans is not None:
        joined = loops.believed >= 0
        right &= joined | knowable(loops, keys, scan_points_of(log.recorded.scans, run.chain.frame))
    tp, fp = int((right & believed).sum()), int((~right & believed).sum())
    tn, fn = int((~right & ~believed).sum()), int((right & ~believed).sum())
    return {
        "tp": tp, "tn": tn, "fp": fp, "fn": fn,
        "precision": tp / (tp + fp) if tp + fp else None, "recall": tp / (tp + fn) if tp + fn else None,
        "wrong": fp, "spurious": 0, "duplicate": 0, "missed": fn, "deferred": 0,
    }  # fmt: skip
