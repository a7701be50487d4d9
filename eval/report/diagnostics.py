"""Judgements in a report: runs that share one stand together, and what is asked has a section of its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from data.notice import Code, Notice
from data.words import sentence, title
from eval.report.page.blocks import Section
from eval.report.words import say

QUESTIONS = (
    *(Code.TRUTH_RATE, Code.LABELS, Code.LABEL_NAMES, Code.BEARING_UNIT, Code.TURN_RATE, Code.TURN_RATES),
    *(Code.TIME_UNIT, Code.MAX_RANGE, Code.FIELD_OF_VIEW, Code.PRIOR, Code.TRUTH_FRAME, Code.UNUSED, Code.LANDMARKS),
)
"""What a person is asked about a log or a run."""


def together(found: Iterable[Notice]) -> list[Notice]:
    """Each notice once: estimators of one log, task and association that have it are named together."""
    names: dict[Notice, list[str]] = {}
    for notice in found:
        names.setdefault(notice.about(estimator=""), []).append(notice.estimator)
    return [notice.about(estimator=", ".join(dict.fromkeys(who))) for notice, who in names.items()]


def questions(found: Iterable[Notice]) -> list[Notice]:
    """The questions among them."""
    return together(n for n in found if n.code in QUESTIONS)


def whose(notice: Notice) -> str:
    """The log, task and runs that it is about."""
    place = ", ".join(part for part in (notice.log, notice.task, notice.association) if part)
    return f"{place}: {notice.estimator}" if notice.estimator else place


def said(notice: Notice) -> str:
    """Whom it is about, and the sentence."""
    return ": ".join(filter(None, (whose(notice), sentence(notice))))


def asked(question: Notice) -> str:
    """A question as the terminal shows it."""
    return f"question ({whose(question)}, {title(question)}): {sentence(question)}"


def of_runs(found: Iterable[Notice | None]) -> list[str]:
    """A sentence for each, with the runs of one log in front that it is about."""
    each = [(n, f"{n.estimator} ({n.association}): " if n.estimator else "") for n in together(filter(None, found))]
    return [f"{who}{sentence(n)}." for n, who in each]


def questions_section(found: Sequence[Notice]) -> list[Section]:
    """A section with all questions; none where there is nothing to ask."""
    asking = [(title(n), whose(n), sentence(n)) for n in questions(found)]
    return [Section("Questions", (say("questions#about"), say("questions#asked", asking=asking)))] if asking else []
