"""Estimators on identical inputs, as `eval.replay` drives them and `eval.referee` judges them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from data.inputs import Inputs
from data.result import Run
from eval.referee.plausibility import judged
from eval.replay import run
from eval.replay.external.load import Thing
from eval.replay.recorder import Writing
from eval.replay.settings import Setup


def compare(
    inputs: Inputs,
    task: str,
    estimators: Sequence[str | Thing],
    association: str | Thing = "known",
    setup: Setup = run.PLAIN,
    watch: Callable[[Inputs], Writing] | None = None,
) -> list[Run]:
    """Runs in the order of `estimators`, as of `eval.replay.run.compare`; those that cannot be so say it (`doubt`)."""
    return run.compare(inputs, task, estimators, association, setup, watch, judged)
