"""Estimators on identical inputs: replay with a plausibility check."""

from collections.abc import Callable, Sequence

from data.inputs import Inputs
from data.result import Run
from eval.referee.plausibility import judged
from eval.replay import run
from eval.replay.external.adapter import Thing
from eval.replay.recorder import Writing
from eval.replay.settings import Setup


def compare(
    inputs: Inputs, task: str, estimators: Sequence[str | Thing], association: str | Thing = "known",
    setup: Setup = run.PLAIN, watch: Callable[[Inputs], Writing] | None = None,
) -> list[Run]:  # fmt: skip
    """Run estimators on identical inputs, and check that their results are physically possible (`Run.implausible`).

    Args:
        inputs: of a log, `log.inputs(labels=True)` or, without labels, `log.inputs(labels=False)`.
        task: `localization` (with the map of `inputs`) or `slam`.
        estimators: names, texts `FILE.py:NAME`, or classes (docs/extending.md).
        association: name, text or function of one association method; `known` uses the labels.
        setup: gates and other settings.
        watch: makes an observer of every step, for the player.

    Returns:
        Runs in the order of `estimators`. A failed estimator gives a run with `Run.failure`, not an error.

    Raises:
        UsageError: unknown names, or an invalid combination.

    Example:
        >>> runs = slamref.compare(log.inputs(labels=True), "slam", ("ekf", "batch"))
        >>> runs[0].online.pose.shape  # (N, 3): x, y [m], theta [rad]
    """
    return run.compare(inputs, task, estimators, association, setup, watch, judged)
