"""Names of the files of a trial in the result folder."""

from __future__ import annotations

from data.log import folder_name
from eval.referee.score import Trial

SYSTEMATIC = "systematic"
"""Picture and table of the systematic errors that were estimated along."""


def stem(trial: Trial, what: str) -> str:
    """Name of a trial's file, without suffix."""
    return f"{folder_name(trial.log.name)}-{trial.task}-{what}"
