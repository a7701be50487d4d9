"""The main numbers on the terminal: a table for each log and task that fits 80 columns, and whom to trust."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from eval.referee.score import Scores, Trial
from eval.report.overview_facts import LogFacts
from eval.report.page.blocks import Mark
from eval.report.page.tables import is_blank
from eval.report.rows import Row, scored_rows, value_of
from eval.report.rows import rows_of as records
from eval.report.sources import source_facts, source_lines
from eval.report.words import paragraph, say
from eval.studies.montecarlo import Judged, Study
from eval.studies.trusted import Trust

ROWS = 10  # rows of a log that is alone; of several logs the best and the worst row of each are shown
WIDTH = 80  # characters of a line
HEADS = ("estimator", "association", "RMSE [m]", "NEES", "NIS", "verdict", "wrong")
LEFT = ("estimator", "association", "verdict")
DISPENSABLE = ("NIS", "NEES")  # columns that are left out where a line would not fit, in this order
GATED = 0.005  # difference of expected NIS from which each row has its own
TASKS = {"slam": "SLAM", "localization": "localization"}
Line = tuple[str, ...]


@dataclass(frozen=True)
class MainNumbers:
    """A run, or an estimator of a study; NaN, blank and None: not known."""

    rank: int  # how soon it is wanted (0: first)
    log: str
    task: str
    estimator: str
    association: str
    rmse: float  # of the position [m]
    nees: float  # nees, nis: means; of the pose, and per degree of freedom
    nis: float
    verdict: str  # on NIS, over the runs of a study on NEES; or the status of a run that is not `ok`
    wrong: tuple[int, int] | None = None  # wrong pairings, and all
    by_relations: bool = False  # mean error of the translation against reference relations
    expected: float = 1.0  # NIS per degree of freedom of right noise, below 1 behind a gate; NaN: unknown


class Group(NamedTuple):
    """The rows of a log and task, or of a study, that are shown, and how many more there are."""

    log: str
    task: str
    rows: tuple[MainNumbers, ...]
    more: int
    sources: tuple[str, ...] = ()  # a line for each source of fixes or closures


def headlines(
    scores: Scores,
    trials: Sequence[Trial],
    studies: Sequence[Study],
    judged: Sequence[Judged],
    diagnoses: Sequence[Trust] = (),
) -> list[Group]:
    """The rows of every log and study; none where nothing was estimated."""
    groups: dict[tuple[str, str], list[MainNumbers]] = {}
    for row in [*_of_logs(scores, trials, diagnoses), *_of_studies(studies, judged)]:
        groups.setdefault((row.log, row.task), []).append(row)
    shown = [_shown(log, task, rows, alone=len(groups) == 1) for (log, task), rows in groups.items()]
    return [g._replace(sources=tuple(source_lines(source_facts(scores, g.log, g.task)))) for g in shown]


def _shown(log: str, task: str, rows: list[MainNumbers], alone: bool) -> Group:
    """All rows of a log that is alone, up to `ROWS`, those wanted first; else the best and the worst by RMSE."""
    if alone:
        order = sorted(range(len(rows)), key=lambda i: (rows[i].rank, i))[:ROWS]
    else:
        usual = [i for i, row in enumerate(rows) if row.rank < 3] or list(range(len(rows)))
        known = sorted((i for i in usual if math.isfinite(rows[i].rmse)), key=lambda i: rows[i].rmse) or usual
        order = list(dict.fromkeys((known[0], known[-1])))
    return Group(log, task, tuple(rows[i] for i in (sorted(order) if alone else order)), len(rows) - len(order))


def _of_logs(scores: Scores, trials: Sequence[Trial], diagnoses: Sequence[Trust]) -> Iterable[MainNumbers]:
    """A row for each run, with what is known in the end; filter and last smoother of each log are wanted first."""
    variants = {t.log.name for t in trials if t.variant_of is not None}
    decided = {_key(r): r for r in records(scores.association)}
    errors = {
        (r["log"], r["estimator"], r["association"], r["phase"]): value_of(r, "trans_mean_m")
        for r in records(scores.relations)
        if (r["tie"], r["subset"]) == ("row", "all")
    }
    rows = records(scores.metrics)
    typed = {_key(r): s for r, s in zip(rows, scored_rows(rows, diagnoses), strict=True)}
    last = {_key(r)[:4]: r for r in rows}  # the final phase, where there is one, comes last
    counted_so_far: dict[object, int] = {}
    for key, r in last.items():
        place = counted_so_far.get(key[:2], 0)
        counted_so_far[key[:2]] = place + (r["estimator"] != "dead-reckoning")
        rank = 3 if r["estimator"] == "dead-reckoning" else 2 if key[0] in variants else min(place, 1)
        if rank == 1 and r["estimator"] == "batch":
            rank = 0
        rmse = value_of(r, "rmse_position_m")
        related = errors.get((r["log"], r["estimator"], r["association"], r["phase"]), math.nan)
        by_relations = not math.isfinite(rmse) and math.isfinite(related)
        log, task, estimator, association = (str(r[c]) for c in ("log", "task", "estimator", "association"))
        numbers = (related if by_relations else rmse, value_of(r, "nees_pose"), value_of(r, "nis"))
        wrong = _wrong(decided.get(_key(r)))
        s = typed[_key(r)]
        yield MainNumbers(
            rank, log, task, estimator, association, *numbers, s.verdict, wrong, by_relations, s.nis_expected
        )


def _of_studies(studies: Sequence[Study], judged: Sequence[Judged]) -> Iterable[MainNumbers]:
    for study in studies:
        phases = {key[:3]: key for key in study.samples}
        for key in phases.values():
            squares = [s.squares["position"] for s in study.good(key)]
            words = {j.quantity: j.verdict for j in judged if j.scenario == study.scenario.name and j.key == key}
            nees, nis = words.get("pose"), words.get("nis")
            task, estimator, association, _ = key
            rmse = math.sqrt(sum(squares) / len(squares)) if squares else math.nan
            mean = {name: math.nan if v is None else v.mean for name, v in (("nees", nees), ("nis", nis))}
            rank, name = 3 if estimator == "dead-reckoning" else 0, f"{study.scenario.name} x{len(study.seeds)}"
            verdict = "" if nees is None else nees.word
            yield MainNumbers(rank, name, task, estimator, association, rmse, mean["nees"], mean["nis"], verdict)


def _key(row: Row) -> tuple[object, ...]:
    return tuple(row[c] for c in ("log", "task", "estimator", "association", "phase"))


def _number(value: float) -> str:
    """Three digits that matter, blank where there is none."""
    if not math.isfinite(value):
        return ""
    if value and not 1e-4 <= abs(value) < 1e4:
        return f"{value:.1e}"
    places = 2 - math.floor(math.log10(abs(value))) if value else 2
    return f"{value:.{min(max(places, 0), 4)}f}"


def _wrong(row: Row | None) -> tuple[int, int] | None:
    if row is None or is_blank(row["fp"]):
        return None
    return int(value_of(row, "fp")), int(value_of(row, "tp") + value_of(row, "fp"))


def lines(groups: Sequence[Group]) -> list[str]:
    """The lines of the terminal; none where nothing was estimated."""
    if not groups:
        return []
    of_nis = sorted(r.expected for g in groups for r in g.rows if math.isfinite(r.nis) and math.isfinite(r.expected))
    differ = bool(of_nis) and of_nis[-1] - of_nis[0] >= GATED
    cells = [_cells(row, differ) for g in groups for row in g.rows]
    shown = [c for c in range(len(HEADS)) if any(row[c] for row in cells)]
    table = _table([[row[c] for c in shown] for row in (HEADS, *cells)])
    named = set(table[0].split())
    nis = ("differ" if differ else f"{of_nis[0]:.3g}") if of_nis and "NIS" in named else ""
    text, place = list[str](), 1
    for g in groups:
        more = f" ({say('headline#more', rows=g.more)})" if g.more else ""
        text += ["", f"{g.log}, {TASKS[g.task]}{more}", table[0], *table[place : place + len(g.rows)]]
        text += [f"  {line}" for line in g.sources]
        place += len(g.rows)
    notes = [say("headline#numbers", nees="NEES" in named, nis=nis, wrong="wrong" in named)]
    notes += [say("headline#verdict")] if "verdict" in named else []
    notes += [say("headline#related")] if any(row.by_relations for g in groups for row in g.rows) else []
    return [*text[1:], *(f"({note})" for note in notes if note)]


def trust_line(facts: LogFacts, mark: Mark) -> str:
    """Whom to trust on a log and task, in a sentence."""
    return paragraph("headline#trust", f=facts, mark=mark)


def _cells(row: MainNumbers, expected: bool) -> Line:
    return (
        row.estimator,
        row.association,
        _number(row.rmse) + (" rel" if row.by_relations else ""),
        _number(row.nees),
        _number(row.nis) + (f" ({row.expected:.2f})" if expected and math.isfinite(row.nis) else ""),
        row.verdict,
        "" if row.wrong is None else f"{row.wrong[0]} of {row.wrong[1]}",
    )


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
