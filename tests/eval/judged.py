"""Judgements of rows of metrics.csv and association.csv that are written by hand."""

from collections.abc import Mapping, Sequence

from data.log import Log
from data.truth import Truth
from eval.judgement.judgement import Judgement, judgement_of
from eval.judgement.runs import RunJudgement, judged_runs
from eval.referee.score import Trial
from eval.studies.diagnosis import Trust
from tests.eval.handmade import circle_log

LOG = circle_log(name="home")
BLIND = Log("blind", LOG.recorded, Truth())
Rows = Sequence[Mapping[str, object]]


def run_of(row: Mapping[str, object], *, measured: bool = True, **changed: object) -> RunJudgement:
    return judged_runs([dict(row) | changed], measured=measured)[0]


def judgement(
    *rows: Mapping[str, object] | None, log: Log = LOG, task: str = "slam", outcomes: Rows = (),
    differences: Rows = (), trust: Trust | None = None, idle: frozenset[tuple[str, str]] = frozenset(),
) -> Judgement:  # fmt: skip
    """Of rows by hand; None: no such row."""
    measured = log.truth.known_poses > 0
    drawn = () if trust is None else (trust,)
    made = [dict(r) for r in rows if r is not None]
    runs = judged_runs(made, [dict(r) for r in outcomes], measured=measured, idle=idle, diagnoses=drawn)
    return judgement_of(Trial(log, task, ()), runs, [dict(r) for r in differences], trust)
