"""The terminal: a table of the main numbers for each log and study that fits 80 columns, and whom to trust."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from data.notice import Notice
from data.result import Failure
from data.words import number
from eval.judgement.judgement import Judgement
from eval.judgement.runs import RunJudgement
from eval.plan.execute import Outcome
from eval.referee.consistency import CONSISTENT, FAMILY_LEVEL, LEVEL, MIN_RUNS
from eval.referee.score import Scores, Trial
from eval.report.diagnosis import source_facts, source_lines
from eval.report.overview import trust_mark
from eval.report.words import paragraph, say
from eval.studies.montecarlo import Judged, Study, failed_declarations, judge_estimators

ROWS = 10  # rows of a log that is alone; of several logs the best and the worst row of each are shown
WIDTH = 80  # characters of a line
HEADS = ("estimator", "association", "RMSE [m]", "NEES", "NIS", "verdict", "wrong")
LEFT = (*HEADS[:2], "verdict")
DISPENSABLE = ("NIS", "NEES")  # columns that are left out where a line would not fit, in this order
UNWANTED = 3  # rank of what is shown only where there is nothing else
GATED = 0.005  # difference of expected NIS from which each row has its own
TASKS = {"slam": "SLAM", "localization": "localization"}
Line = tuple[str, ...]


class Group(NamedTuple):
    """The rows of a log and task, or of a study, that are shown, and how many more there are."""

    log: str
    task: str
    rows: tuple[RunJudgement, ...]
    more: int
    notes: tuple[str, ...] = ()  # a line for each source of fixes or closures, and estimator with marked means


def groups_of(
    judgements: Sequence[tuple[Trial, Judgement]], scores: Scores, studies: Sequence[Study], judged: Sequence[Judged]
) -> list[Group]:
    """The rows of every log and study; none where nothing was estimated."""
    found: dict[tuple[str, str], list[tuple[int, RunJudgement]]] = {}  # with how soon each is wanted (0: first)
    for trial, j in judgements:
        pair = {(r.estimator, r.association) for r in j.compared.pair}  # wanted first
        ranks = ((2 if trial.variant_of else 0 if (r.estimator, r.association) in pair else 1) for r in j.last)
        own = "" if trial.variant_of is None else f" ({j.log.removeprefix(trial.variant_of).strip(':')})"
        named = [replace(r, estimator=f"{r.estimator}{own}") for r in j.last]
        rows = [(_rank(r.estimator, rank), n) for r, n, rank in zip(j.last, named, ranks, strict=True)]
        found.setdefault((trial.variant_of or j.log, j.task), []).extend(rows)
    marks: dict[tuple[str, str], list[str]] = {}
    for e in (e for study in studies for e in judge_estimators(study, judged)):
        (task, estimator, association, phase), name = e.key, say("terminal#study", name=e.study, runs=e.runs)
        row = RunJudgement(estimator, association, phase, e.word or "ok", e.rmse)  # the word stands for the status
        row = replace(row, nees=e.mean("pose"), nis=e.mean("nis"), nis_expected=1.0)
        found.setdefault((name, task), []).append((_rank(estimator, 0), row))
        marks.setdefault((name, task), []).extend(filter(None, [paragraph("terminal#marked", e=e)]))
    found = {key: rows for key, rows in found.items() if rows}
    groups = []
    for key, ranked in found.items():
        if len(found) == 1:  # those wanted first, up to `ROWS`
            kept = sorted(sorted(range(len(ranked)), key=lambda i: (ranked[i][0], i))[:ROWS])
        else:  # the best and the worst by RMSE
            usual = [i for i, (rank, _) in enumerate(ranked) if rank < UNWANTED] or list(range(len(ranked)))
            known = sorted((i for i in usual if math.isfinite(ranked[i][1].rmse)), key=lambda i: ranked[i][1].rmse)
            kept = list(dict.fromkeys(((known or usual)[0], (known or usual)[-1])))
        notes = (*source_lines(source_facts(scores, *key)), *marks.get(key, ()))
        groups.append(Group(*key, tuple(ranked[i][1] for i in kept), len(ranked) - len(kept), notes))
    return groups


def _rank(estimator: str, rank: int) -> int:
    return UNWANTED if estimator == "dead-reckoning" else rank


def _related(row: RunJudgement) -> bool:
    """Whether the mean error of the translation against reference relations stands for the RMSE."""
    return not math.isfinite(row.rmse) and math.isfinite(row.related)


def _number(value: float) -> str:
    return number(value) if math.isfinite(value) else ""


def lines(groups: Sequence[Group]) -> list[str]:
    """The lines of the terminal; none where nothing was estimated."""
    if not groups:
        return []
    rows = [r for g in groups for r in g.rows]
    of_nis = sorted(r.nis_expected for r in rows if math.isfinite(r.nis) and math.isfinite(r.nis_expected))
    differ = bool(of_nis) and of_nis[-1] - of_nis[0] >= GATED
    cells = [_cells(row, differ) for row in rows]
    shown = [c for c in range(len(HEADS)) if any(row[c] for row in cells)]
    table = _table([[row[c] for c in shown] for row in (HEADS, *cells)])
    named = set(table[0].split())
    text, place = list[str](), 1
    for g in groups:
        more = f" ({say('terminal#more', rows=g.more)})" if g.more else ""
        text += ["", f"{g.log}, {TASKS[g.task]}{more}", table[0], *table[place : place + len(g.rows)]]
        text += [f"  {line}" for line in g.notes]
        place += len(g.rows)
    nis = ("differ" if differ else f"{of_nis[0]:.3g}") if of_nis and "NIS" in named else ""
    notes = say(
        "terminal#notes", nees="NEES" in named, placed=any(r.dof == 2 for r in rows), nis=nis, wrong="wrong" in named,
        verdict="verdict" in named, related=any(map(_related, rows)), phases=any(r.phase == "final" for r in rows),
    )  # fmt: skip
    return [*text[1:], *notes.splitlines()]


def trust_line(j: Judgement) -> str:
    """Whom to trust on a log and task, in a sentence."""
    return paragraph("terminal#trust", j=j, mark=trust_mark(j))


def _cells(row: RunJudgement, differ: bool) -> Line:
    related, phased = _related(row), row.phase and not row.estimator.startswith("dead-reckoning")
    return (
        f"{row.estimator}, {row.phase}" if phased else row.estimator, row.association,
        _number(row.related if related else row.rmse) + (" rel" if related else ""), _number(row.nees),
        _number(row.nis) + (f" ({row.nis_expected:.2f})" if differ and math.isfinite(row.nis) else ""), row.verdict,
        "" if row.counts is None else f"{row.counts.fp} of {row.counts.pairings}",
    )  # fmt: skip


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Columns side by side, numbers to the right; a column is left out before a line is too long."""
    kept = list(range(len(rows[0])))
    for head in ("", *DISPENSABLE):
        kept = [c for c in kept if rows[0][c] != head]
        width = {c: max(len(row[c]) for row in rows) for c in kept}
        if sum(width.values()) + 2 * len(kept) <= WIDTH:
            break

    def cell(row: Sequence[str], c: int) -> str:
        return row[c].ljust(width[c]) if rows[0][c] in LEFT else row[c].rjust(width[c])

    return ["  " + "  ".join(cell(row, c) for c in kept).rstrip() for row in rows]


@dataclass(frozen=True)
class Results:
    """What came out, and what the referee found."""

    outcome: Outcome
    scores: Scores
    judged: list[Judged]  # verdicts of studies
    judgements: list[tuple[Trial, Judgement]]  # of each log and task
    notices: list[Notice]  # all but those about what is missing for lack of memory


def flaws_of(trials: Sequence[Trial]) -> dict[tuple[str, str, str, str], Failure]:
    """Why runs stopped or are implausible, by log, task, estimator and association."""
    runs = ((t, r) for t in trials for r in t.runs)
    return {(t.log.name, t.task, r.estimator, r.association): r.flaw for t, r in runs if r.flaw is not None}


def study_lines(study: Study) -> list[str]:
    """Terminal lines: each diverged run, and for each estimator the number of implausible ones, with the first."""
    lost = [{"task": k[0], "estimator": k[1], "association": k[2], "seed": seed, "why": why, "implausible": implausible}
            for k, seed, why, implausible in study.failures()]  # fmt: skip
    return say("studies#failures", name=study.scenario.name, lost=lost, runs=len(study.seeds)).splitlines()


def declared_lines(judged: Sequence[Judged]) -> list[str]:
    """Terminal lines on the verdicts that scenarios declare consistent: each rejected one, or how many hold."""
    declared = [j for j in judged if j.declared and j.verdict.runs >= MIN_RUNS]
    agreed, failed = sum(j.verdict.word == CONSISTENT for j in declared), failed_declarations(judged)
    about = {"agreed": agreed, "declared": len(declared), "failed": failed, "level": LEVEL, "family": FAMILY_LEVEL}
    return say("studies#verdicts", **about).splitlines()
