"""All questions about a log, in the order they are asked."""

from __future__ import annotations

from collections.abc import Callable

from data.log import Log
from data.questions import counts, units, view
from data.questions.question import Question

CHECKS: tuple[Callable[[Log], list[Question]], ...] = (
    units.stamps,
    units.bearings,
    units.turn_rates,
    view.reach,
    view.prior,
    view.labels_against_map,
    view.truth_start,
    counts.truth_rate,
    counts.labels,
)


def ask(log: Log) -> tuple[Question, ...]:
    """What a careful person would ask before working with this log; nothing where it looks as it should."""
    return tuple(question for check in CHECKS for question in check(log))
