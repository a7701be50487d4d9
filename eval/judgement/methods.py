"""How the association methods without labels did on one log and task: the best, the worst, and by their paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from eval.judgement.runs import Counts, RunJudgement, filters_in
from eval.replay.settings import steps

SAME = 0.02  # relative difference of two RMSE values below which they are called equal
USABLE = 0.9  # an association method is usable whose path has less than this share of dead reckoning's error


@dataclass(frozen=True)
class MethodOutcome:
    """A run that decided without labels, in its last phase."""

    run: RunJudgement
    counts: Counts


@dataclass(frozen=True)
class Methods:
    """How the association methods without labels did on one log and task."""

    first: MethodOutcome  # first, worst: by their decisions alone, the same if there is one
    worst: MethodOutcome
    best: MethodOutcome  # by its decisions, of those with a usable path (of all, where none has one)
    usable: bool  # whether one has: a usable run, and nearer to the truth than dead reckoning
    nearest: MethodOutcome | None  # whose path is clearly nearer to the truth than that of the best, if one is
    measured: bool  # whether errors of paths are known
    dead_reckoning: float  # its RMSE [m], or NaN
    labelled: int | None = None  # landmarks that the log's ids tell apart

    @property
    def decides(self) -> bool:
        """Whether one of them gives a usable path and pairs rightly more often than not."""
        return self.usable and not self.best.counts.mostly_wrong


def deciding(runs: Sequence[RunJudgement]) -> list[MethodOutcome]:
    """The plausible runs that decided without labels, in their last phase."""
    filters = filters_in(runs)
    own = [
        MethodOutcome(r, r.counts)
        for r in runs
        if r.association not in ("known", "none")
        and r.status == "ok"
        and r.counts is not None
        and r.phase == ("online" if r.estimator in filters else "final")
    ]
    # batch smoothers take the decisions of another run, which speaks for itself where it is there
    own = [w for w in own if steps(w.run.estimator)] or own
    return [w for w in own if math.isfinite(w.counts.f1)]


def methods_of(runs: Sequence[RunJudgement], labelled: int | None = None) -> Methods | None:
    """The best and the worst association method; None where nobody decided, or nothing is known of it."""
    own = deciding(runs)
    if not own:
        return None
    reckoned = next((r.rmse for r in runs if r.estimator == "dead-reckoning"), math.nan)
    usable = [w for w in own if w.run.usable and not w.run.rmse >= USABLE * reckoned]
    best = max(usable or own, key=lambda w: w.counts.quality)
    nearest = min(usable, key=lambda w: w.run.rmse, default=best)
    return Methods(
        first=max(own, key=lambda w: w.counts.quality),
        worst=min(own, key=lambda w: w.counts.quality),
        best=best,
        usable=bool(usable),
        nearest=nearest if nearest.run.rmse < (1.0 - SAME) * best.run.rmse else None,
        measured=any(math.isfinite(r.rmse) for r in runs),
        dead_reckoning=reckoned,
        labelled=labelled,
    )
