"""What the first screen knows of a log and task: the filter and the smoother compared, and what failed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from eval.page.tables import is_blank
from eval.referee.score import Scores, Trial
from eval.replay.names import INCREMENTAL
from eval.report.answer import chosen_association, pick
from eval.report.deciding import extremes
from eval.report.doubt.questions import is_unused
from eval.report.rows import Row, filters_in, rows_of, smoothers_in, value_of
from eval.report.trust.sections import of_trial
from eval.studies.trusted import Trust


@dataclass(frozen=True)
class Facts:
    """Of one log and task.

    Attributes:
        trial: whose.
        rows: of metrics.csv.
        association: under which filter and smoother are compared, None: nothing decides.
        filtered, smoothed: their rows; None: none ran.
        newest: the online row of a smoother that steps, plausible.
        errors: position error [m] of both: RMSE, or with reference relations alone the mean of theirs; NaN: unknown.
        related: whether the errors are those of relations.
        decided: best and worst way of deciding, rows of association.csv.
        trust: what the log says of itself; None: nothing.
        unused: runs that paired next to nothing, (estimator, association).
    """

    trial: Trial
    rows: tuple[Row, ...]
    association: str | None
    filtered: Row | None
    smoothed: Row | None
    newest: Row | None
    errors: tuple[float, float]
    related: bool
    decided: tuple[Row, Row] | None
    trust: Trust | None
    unused: frozenset[tuple[str, str]] = frozenset()

    def sound(self, row: Row | None) -> bool:
        """Whether a row is there, got to the end, is plausible and not lost, and more than dead reckoning."""
        return row is not None and sound(row) and (row["estimator"], row["association"]) not in self.unused

    @property
    def measured(self) -> bool:
        """Whether errors are known at all."""
        return self.trial.log.truth.known_poses > 0 or self.trial.log.truth.relations is not None

    @property
    def failed(self) -> list[Row]:
        """Rows of runs that did not get to the end, are implausible, lost or dead reckoning, at the last phase."""
        last = {(r["estimator"], r["association"]): r for r in self.rows}
        return [r for r in last.values() if not self.sound(r)]

    @property
    def runs(self) -> int:
        """How many there were."""
        return len({(r["estimator"], r["association"]) for r in self.rows})


def sound(row: Row) -> bool:
    """Whether a run got to the end, is plausible and not lost."""
    return row["status"] == "ok" and is_blank(row.get("lost_why"))


def facts_of(trial: Trial, scores: Scores, trust: Sequence[Trust]) -> Facts:
    """Everything the first screen needs of a log and task."""
    rows = [r for r in rows_of(scores.metrics) if (r["log"], r["task"]) == (trial.log.name, trial.task)]
    outcomes = [r for r in rows_of(scores.association) if (r["log"], r["task"]) == (trial.log.name, trial.task)]
    chosen = chosen_association(rows)
    own = [r for r in rows if r["association"] == chosen]
    filtered, smoothed = pick(own, filters_in(own), "online"), pick(own, smoothers_in(own), "final")
    newest = pick([r for r in own if sound(r)], INCREMENTAL, "online")
    errors = (_error(filtered), _error(smoothed))
    related = not any(map(math.isfinite, errors)) and trial.log.truth.relations is not None
    if related:
        errors = (_relation(filtered, scores), _relation(smoothed, scores))
    said = of_trial(trial, trust)[:1]
    return Facts(
        trial, tuple(rows), chosen, filtered, smoothed, newest, errors, related, extremes(rows, outcomes),
        said[0] if said else None, frozenset((r.estimator, r.association) for r in trial.runs if is_unused(r)),
    )  # fmt: skip


def _error(row: Row | None) -> float:
    return math.nan if row is None else value_of(row, "rmse_position_m")


def _relation(row: Row | None, scores: Scores) -> float:
    """Mean error against the reference relations, all of them tied by row."""
    if row is None:
        return math.nan
    keys = ("log", "estimator", "association", "phase")
    for r in rows_of(scores.relations):
        if (r["tie"], r["subset"]) == ("row", "all") and all(r[k] == row[k] for k in keys):
            return value_of(r, "trans_mean_m")
    return math.nan
