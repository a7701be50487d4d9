"""Names of a trial's files, and the variants that share its table."""

from __future__ import annotations

from collections.abc import Sequence

from data.log import folder_name
from eval.referee.score import Trial

SYSTEMATIC = "systematic"  # picture and table of the systematic errors that were estimated along


def stem(trial: Trial, what: str = "") -> str:
    """Name of a trial's file, without suffix; without `what` that of its page in `details/`."""
    return "-".join(filter(None, (folder_name(trial.log.name), trial.task, what)))


def variants(trial: Trial, trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """The variants of a trial: the same log with another setup or other knowledge."""
    if trial.variant_of is not None:
        return ()
    return tuple(t for t in trials if t.variant_of == trial.log.name and t.task == trial.task)
