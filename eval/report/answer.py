"""Filter or smoother: what one log and task say about the two, from rows of metrics.csv and association.csv."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import pandas as pd

from eval.referee.plausibility import IMPLAUSIBLE
from eval.replay.settings import INCREMENTAL, Setup
from eval.report.comparison import Difference, difference_of
from eval.report.deciding import SAME, Deciding, deciding_facts
from eval.report.rows import Scored, filters_in, rows_of, scored_rows, smoothers_in
from eval.report.words import one_line, paragraph, say
from eval.studies.trusted import Trust

LINEARIZATION = 2.0
"""So many times the RMSE of a smoother with the same data at the same instants: linearization, not luck."""
FAR = 20.0
"""A filter's NIS so many times the smoother's is linearization: a wrong map or prior, or a jump, gives up to 10."""


class Outcome(StrEnum):
    """What came of a comparison; the first that applies."""

    FAILED = "failed"
    IMPLAUSIBLE = "implausible"
    NONE_RAN = "none ran"
    ONE_RAN = "one ran"
    LOST = "lost"
    NO_TRUTH = "no truth"
    COMPARED = "compared"


class Nearer(StrEnum):
    """Which path is nearer to the truth; `EITHER`: the same within `SAME`."""

    SMOOTHER = "smoother"
    EITHER = "either"
    FILTER = "filter"
    UNKNOWN = "unknown"


class Because(StrEnum):
    """What the difference is due to, as an online smoother at the same instants shows."""

    LATER_DATA = "later data"
    LINEARIZATION = "linearization"
    NOT_STATED = "not told"


@dataclass(frozen=True)
class AnswerFacts:
    """Filter and smoother on one log and task."""

    association: str | None  # under which they are compared; None: nothing decides
    several: bool  # whether there are others
    outcome: Outcome  # what came of the comparison
    filtered: Scored | None  # filtered, smoothed: their rows, of the online and the final phase; None: none ran
    smoothed: Scored | None
    lost_to_linearization: bool  # whether the filter alone is lost, with observations that fit the smoother far better
    newest: Scored | None  # the online row of a smoother that steps, if its error is known
    nearer: Nearer  # to the truth
    because: Because  # of what
    difference: Difference | None  # of their errors, with what chance makes of it
    deciding: Deciding | None  # how the association methods without labels did


def answer_facts(
    metrics: pd.DataFrame,
    association: pd.DataFrame | None = None,
    labelled: int | None = None,
    differences: pd.DataFrame | None = None,
    trust: Sequence[Trust] = (),
) -> AnswerFacts:
    """Filter and smoother compared, from the rows of metrics.csv, association.csv and `Scores.differences` of one log.

    `labelled`: number of landmarks that the log's ids tell apart; `trust`: diagnoses, for their bootstrap replicates.
    """
    table = rows_of(metrics)
    rows = scored_rows(table, trust)
    chosen = chosen_association(rows)
    own = [r for r in rows if r.association == chosen]
    filtered, smoothed = pick(own, filters_in(own), "online"), pick(own, smoothers_in(own), "final")
    newest = pick([r for r in own if r.status == "ok"], INCREMENTAL, "online")
    known = newest is not None and math.isfinite(newest.rmse)
    a, b = (math.nan if r is None else r.rmse for r in (filtered, smoothed))
    pair = None if filtered is None or smoothed is None else (filtered, smoothed)
    return AnswerFacts(
        association=chosen,
        several=len({r.association for r in rows if r.association != "none"}) > 1,
        outcome=_outcome(filtered, smoothed),
        filtered=filtered,
        smoothed=smoothed,
        lost_to_linearization=pair is not None and bool(pair[0].lost_why) and not pair[1].lost_why and fits(*pair),
        newest=newest if known else None,
        nearer=nearer(a, b),
        because=because(a, b, newest.rmse if newest is not None else math.nan),
        difference=None if pair is None or differences is None else difference_of(rows_of(differences), *pair),
        deciding=None if association is None else deciding_facts(rows, table, rows_of(association), labelled),
    )


def answer(facts: AnswerFacts, trust: str = "") -> str:
    """The facts in a few sentences; `trust`, the diagnosis, comes first without ground truth."""
    points = re.split(r"\n(?=\* )", say("answer", facts, trust=trust))
    return "\n".join(map(one_line, points))


def _outcome(filtered: Scored | None, smoothed: Scored | None) -> Outcome:
    there = [r for r in (filtered, smoothed) if r is not None]
    if any(r.status not in ("ok", IMPLAUSIBLE) for r in there):
        return Outcome.FAILED
    if any(r.status == IMPLAUSIBLE for r in there):
        return Outcome.IMPLAUSIBLE
    if len(there) < 2:
        return Outcome.ONE_RAN if there else Outcome.NONE_RAN
    if any(r.lost_why for r in there):
        return Outcome.LOST
    return Outcome.COMPARED if all(math.isfinite(r.rmse) for r in there) else Outcome.NO_TRUTH


def nearer(filtered: float, smoothed: float) -> Nearer:
    """By the RMSE of both."""
    if not (math.isfinite(filtered) and math.isfinite(smoothed)):
        return Nearer.UNKNOWN
    if smoothed < filtered * (1.0 - SAME):
        return Nearer.SMOOTHER
    return Nearer.EITHER if smoothed <= filtered * (1.0 + SAME) else Nearer.FILTER


def because(filtered: float, smoothed: float, online: float) -> Because:
    """The fair comparison: the RMSE of an online smoother (or NaN), which has seen exactly what the filter has."""
    if abs(online - filtered) <= SAME * filtered and nearer(filtered, smoothed) == Nearer.SMOOTHER:
        return Because.LATER_DATA
    return Because.LINEARIZATION if filtered > LINEARIZATION * online else Because.NOT_STATED


def fits(filtered: Scored, smoothed: Scored) -> bool:
    """Whether prior, map and observations agree in a smoother's solution, or at least far better than here."""
    return smoothed.nis <= smoothed.nis_upper or FAR * smoothed.nis < filtered.nis


def pick(rows: Sequence[Scored], names: Sequence[str], phase: str) -> Scored | None:
    """The first of the named estimators with a row in the phase; one that reached the end is preferred."""
    found = [r for name in names for r in rows if r.estimator == name and r.phase == phase]
    return min(found, key=lambda r: r.status != "ok", default=None)


def chosen_association(rows: Sequence[Scored]) -> str | None:
    """The association to compare under: known, or else the first that a filter and a smoother share, or else any."""
    filters = {r.association for r in rows if r.estimator in filters_in(rows)}
    smoothers = {r.association for r in rows if r.estimator in smoothers_in(rows)}
    given = dict.fromkeys(r.association for r in rows if r.association != "none")
    return min(given, key=lambda a: (a != "known", a not in filters or a not in smoothers), default=None)


def gate_sentence(setup: Setup, *, sensed: bool) -> str:
    """The gate of observations paired by label; `sensed`: a sensor read the labels of this log."""
    gate, by_default = setup.settled(sensed).label_gate, setup.gate_known == "auto"
    smoothers = setup.gate_smoothers
    return paragraph("settings#gate", gate=gate, by_default=by_default, smoothers=smoothers, sensed=sensed)
