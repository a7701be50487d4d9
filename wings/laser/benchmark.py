"""How good laser SLAM is where the truth is known: simulated floor plans, errors, consistency, loop closures."""

from __future__ import annotations

import os
from collections.abc import Sequence

import pandas as pd
from joblib import Parallel, delayed

from association.names import SCAN
from data.worlds.registry import named_log
from eval.compare import compare
from eval.referee.consistency import verdict
from eval.referee.score import Scores, Trial, score

SEEDS = 50


def measured(name: str) -> Scores:
    """The scores of one log of a floor plan."""
    log = named_log(name)
    runs = compare(log.recorded, "slam", ["dead-reckoning", "ekf", "isam2"], SCAN)
    return score([Trial(log, "slam", tuple(runs))])


def plan_lines(found: Sequence[Scores]) -> list[str]:
    """Errors and NEES of each estimator and phase, and iSAM2's loop closures, in lines of text."""
    lines = [f"{len(found)} simulated plans, position RMSE [mm]: median (largest), median aligned; pose NEES"]
    metrics = pd.concat([scores.metrics for scores in found])
    for (estimator, phase), rows in metrics.groupby(["estimator", "phase"], sort=False):
        position, aligned = 1e3 * rows["rmse_position_m"], 1e3 * rows["rmse_aligned_m"]
        v = verdict(rows["nees_pose"].to_numpy(float), 3)
        lines.append(
            f"  {estimator} {phase}: {position.median():.1f} ({position.max():.1f}), {aligned.median():.1f};"
            f" {v.mean:.2f} [{v.lower:.2f}, {v.upper:.2f}] where 3 is expected: {v.word}"
        )
    decided = pd.concat([scores.association for scores in found])
    closures = decided[(decided["estimator"] == "isam2") & (decided["phase"] == "online")]
    tp, fp, tn, fn = (int(closures[outcome].sum()) for outcome in ("tp", "fp", "tn", "fn"))
    lines.append(
        f"loop closures: {tp} TP, {fp} FP, {tn} TN, {fn} FN; precision {100 * tp / max(tp + fp, 1):.2f} %,"
        f" recall {100 * tp / max(tp + fn, 1):.1f} %"
    )
    return lines


def lines(quick: bool) -> list[str]:
    """The measurements of all plans, of a tenth of them if `quick`."""
    jobs = Parallel(n_jobs=os.cpu_count() or 1)
    names = (f"floorplan:{seed}" for seed in range(SEEDS // 10 if quick else SEEDS))
    return plan_lines(list(jobs(delayed(measured)(name) for name in names)))
