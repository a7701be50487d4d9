"""Names of the files of a trial in the result folder, and which trials stand beside it."""

from __future__ import annotations

from collections.abc import Sequence

from data.log import folder_name
from eval.referee.score import Trial

SYSTEMATIC = "systematic"
"""Picture and table of the systematic errors that were estimated along."""


def stem(trial: Trial, what: str) -> str:
    """Name of a trial's file, without suffix."""
    return f"{folder_name(trial.log.name)}-{trial.task}-{what}"


def variants(trial: Trial, trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """The trials that stand beside one."""
    if trial.variant_of is not None:
        return ()
    return tuple(t for t in trials if t.variant_of == trial.log.name and t.task == trial.task)
