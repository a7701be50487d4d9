"""Landmarks that cannot be told from a neighbour: how many of a run's map, in a sentence."""

from __future__ import annotations

from association.evidence.ambiguity import ambiguous
from eval.referee.score import Trial

WHY = "no frame saw both, and they are nearer than their covariances and the noise of a reading can tell"


def ambiguity_statements(trial: Trial) -> list[str]:
    """A sentence for each outcome that some run of a trial has, where it is not that all can be told apart."""
    told: dict[str, list[str]] = {}
    for run in trial.runs:
        count = int((ambiguous(run, trial.log.recorded) >= 0).sum())
        if count and run.map is not None:
            text = f"{run.association}: {count} of {len(run.map)} landmarks cannot be told from a neighbour"
            told.setdefault(text, []).append(run.estimator)
    column = "column ambiguous in landmarks.csv"
    return [f"{', '.join(names)} with {text}: {WHY}; {column}" for text, names in told.items()]
