"""Filter, smoother and wheels against the reference relations of a log, in a sentence."""

from __future__ import annotations

from association.names import SCAN
from eval.referee.relations import relation_errors
from eval.referee.score import Trial
from eval.report.words import say


def against_relations(trial: Trial) -> str:
    """Filter, smoother and wheels against the reference relations, in a sentence; empty where there are none."""
    relations, paths = trial.log.truth.relations, against(trial)
    return say("comparison#against", relations=len(relations), paths=paths) if relations is not None and paths else ""


def against(trial: Trial) -> list[dict[str, object]]:
    """Errors [m, deg] of filter, smoother and wheels against the relations tied by row, and whose path that is."""
    relations = trial.log.truth.relations
    found: list[dict[str, object]] = []
    for name, association, phase in (
        ("ekf", SCAN, "online"),
        ("ekf", SCAN, "final"),
        ("isam2", SCAN, "online"),
        ("isam2", SCAN, "final"),
        ("dead-reckoning", "none", "online"),
    ):
        run = trial.find(name, association)
        if relations is None or run is None or run.failure is not None or phase not in run.phases:
            continue
        e = relation_errors(run.trajectory(phase).pose, relations, trial.log.recorded.time)
        if e is not None:
            found.append({"estimator": name, "phase": phase, "mean": e.trans_mean_m, "std": e.trans_std_m})
            found[-1]["heading"] = e.rot_mean_deg
    return found
