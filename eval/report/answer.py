"""Filter against smoother on one log and task, in words."""

from __future__ import annotations

import math
import re
from enum import StrEnum

from eval.judgement.judgement import Comparison, Judgement
from eval.referee.plausibility import IMPLAUSIBLE
from eval.replay.settings import Setup
from eval.report.words import one_line, paragraph, say


class Outcome(StrEnum):
    """What came of a comparison; the first that applies."""

    FAILED = "failed"
    IMPLAUSIBLE = "implausible"
    NONE_RAN = "none ran"
    ONE_RAN = "one ran"
    LOST = "lost"
    NO_TRUTH = "no truth"
    COMPARED = "compared"


def outcome(compared: Comparison) -> Outcome:
    """By status and errors of the two."""
    there = compared.pair
    if any(r.status not in ("ok", IMPLAUSIBLE) for r in there):
        return Outcome.FAILED
    if any(r.status == IMPLAUSIBLE for r in there):
        return Outcome.IMPLAUSIBLE
    if len(there) < 2:
        return Outcome.ONE_RAN if there else Outcome.NONE_RAN
    if any(r.lost_why for r in there):
        return Outcome.LOST
    return Outcome.COMPARED if all(math.isfinite(r.rmse) for r in there) else Outcome.NO_TRUTH


def answer(j: Judgement, trust: str = "") -> str:
    """The comparison in a few sentences; `trust`, the diagnosis, comes first without ground truth."""
    about = {"outcome": outcome(j.compared), "verdict": j.verdict, "linearized": j.compared.lost_to_linearization}
    words = say("answer", j.compared, **about, methods=j.methods, trust=trust)
    return "\n".join(map(one_line, re.split(r"\n(?=\* )", words)))


def gate_sentence(setup: Setup, *, sensed: bool) -> str:
    """The gate of observations paired by label; `sensed`: a sensor read the labels of this log."""
    gate, by_default = setup.settled(sensed).label_gate, setup.gate_known == "auto"
    smoothers = setup.gate_smoothers
    return paragraph("settings#gate", gate=gate, by_default=by_default, smoothers=smoothers, sensed=sensed)
