"""How the association methods without labels did on one log and task: the best, the worst, and by their paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from eval.judgement.runs import RunJudgement, filters_in
from eval.replay.settings import steps

SAME = 0.02  # relative difference of two RMSE values below which they are called equal
USABLE = 0.9  # an association method is usable whose path has less than this share of dead reckoning's error


@dataclass(frozen=True)
class Methods:
    """How the association methods without labels did on one log and task: runs in their last phase, with counts."""

    first: RunJudgement  # first, worst: by their decisions alone, the same if there is one
    worst: RunJudgement
    best: RunJudgement  # by its decisions, of those with a usable path (of all, where none has one)
    usable: bool  # whether one has: a usable run, and nearer to the truth than dead reckoning
    nearest: RunJudgement | None  # whose path is clearly nearer to the truth than that of the best, if one is
    measured: bool  # whether errors of paths are known
    dead_reckoning: float  # its RMSE [m], or NaN
    labelled: int | None = None  # landmarks that the log's ids tell apart

    @property
    def decides(self) -> bool:
        """Whether one of them gives a usable path and pairs rightly more often than not."""
        return self.usable and self.best.counts is not None and not self.best.counts.mostly_wrong


def deciding(runs: Sequence[RunJudgement]) -> list[RunJudgement]:
    """The plausible runs that decided without labels, in their last phase."""
    filters = filters_in(runs)
    own = [
        r
        for r in runs
        if r.association not in ("known", "none")
        and r.status == "ok"
        and r.phase == ("online" if r.estimator in filters else "final")
    ]
    # batch smoothers take the decisions of another run, which speaks for itself where it is there
    own = [r for r in own if steps(r.estimator)] or own
    return [r for r in own if r.counts is not None and math.isfinite(r.counts.f1)]


def methods_of(runs: Sequence[RunJudgement], labelled: int | None = None) -> Methods | None:
    """The best and the worst association method; None where nobody decided, or nothing is known of it."""
    own = deciding(runs)
    if not own:
        return None
    reckoned = next((r.rmse for r in runs if r.estimator == "dead-reckoning"), math.nan)
    usable = [r for r in own if r.usable and not r.rmse >= USABLE * reckoned]
    best = max(usable or own, key=_quality)
    nearest = min(usable, key=lambda r: r.rmse, default=best)
    return Methods(
        first=max(own, key=_quality),
        worst=min(own, key=_quality),
        best=best,
        usable=bool(usable),
        nearest=nearest if nearest.rmse < (1.0 - SAME) * best.rmse else None,
        measured=any(math.isfinite(r.rmse) for r in runs),
        dead_reckoning=reckoned,
        labelled=labelled,
    )


def _quality(run: RunJudgement) -> tuple[float, int]:
    """By which association methods are ordered: F1, then the number of wrong decisions."""
    return (-1.0, 0) if run.counts is None else (run.counts.f1, -run.counts.fp - run.counts.fn)
