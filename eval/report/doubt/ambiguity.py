"""Landmarks that cannot be told from a neighbour, or may be two: how many of a run's map, in a sentence."""

from __future__ import annotations

from association.evidence.ambiguity import ambiguous
from eval.referee.score import Trial

APART = (
    "cannot be told from a neighbour",
    "no frame saw both, and they are nearer than their covariances and the noise of a reading can tell",
)
TWO = (
    "may be two each",
    "what is read beside them in the same frames, or the scatter of their own readings, speaks for two",
)
"""What is said of a kind, and why."""


def ambiguity_statements(trial: Trial) -> list[str]:
    """A sentence for each kind and outcome that some run of a trial has, where it is not that all are told apart."""
    told: dict[tuple[str, str, str], list[str]] = {}
    for run in trial.runs:
        if run.map is None:
            continue
        of = ambiguous(run, trial.log.recorded)
        own = of == run.map.number
        for which, (what, why), column in (
            ((of >= 0) & ~own, APART, ""),
            (own, TWO, ", which then names the same one"),
        ):
            if which.any():
                text = f"{run.association}: {int(which.sum())} of {len(of)} landmarks {what}"
                told.setdefault((text, why, column), []).append(run.estimator)
    return [
        f"{', '.join(names)} with {text}: {why}; column ambiguous in landmarks.csv{column}"
        for (text, why, column), names in told.items()
    ]
