"""The main numbers on the terminal at the end of a run: at most twelve lines that fit a screen of 80 columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from eval.referee.score import Scores, Trial
from eval.report.page.tables import is_blank
from eval.report.rows import Row, nis_verdict, value_of
from eval.report.rows import rows_of as records
from eval.report.words import say
from eval.studies.montecarlo import Judged, Study

LINES = 12
WIDTH = 80
"""Characters of a line."""
SHORTEST = 9
"""Characters that are left of a name, at least."""
HEADS = ("log", "task", "estimator", "assoc.", "RMSE [m]", "NEES", "NIS", "verdict", "wrong")
NAMES, NAMES_OF_LOG = 4, 2
"""Columns that are names; the first of these are about the log."""
TASKS = {"slam": "SLAM", "localization": "loc."}
Line = tuple[str, ...]


@dataclass(frozen=True)
class Headline:
    """A run, or an estimator of a study; NaN, blank and None: not known.

    Attributes:
        rank: how soon it is wanted (0: first).
        rmse: of the position [m]; `by_relations`: mean error of the translation against reference relations.
        nees, nis: means; of the pose, and per degree of freedom.
        verdict: on NIS, over the runs of a study on NEES; or the status of a run that is not `ok`.
        wrong: wrong pairings, and all.
    """

    rank: int
    log: str
    task: str
    estimator: str
    association: str
    rmse: float
    nees: float
    nis: float
    verdict: str
    wrong: tuple[int, int] | None = None
    by_relations: bool = False


class Headlines(NamedTuple):
    """The rows that are shown, how many more there are, and whether all are of one log and task."""

    rows: tuple[Headline, ...]
    more: int
    alone: bool


def headlines(scores: Scores, trials: Sequence[Trial], studies: Sequence[Study], judged: Sequence[Judged]) -> Headlines:
    """The rows that fit, those wanted first; without any where nothing was estimated."""
    found = [*_of_logs(scores, trials), *_of_studies(studies, judged)]
    alone = len({(h.log, h.task) for h in found}) == 1
    room = LINES - 2 - alone
    room -= len(found) > room
    order = sorted(range(len(found)), key=lambda i: (found[i].rank, i))
    rows = tuple(found[i] for i in sorted(order[:room]))
    return Headlines(rows, len(found) - len(rows), alone)


def _of_logs(scores: Scores, trials: Sequence[Trial]) -> Iterable[Headline]:
    """A row for each run, with what is known in the end; filter and last smoother of each log are wanted first."""
    variants = {t.log.name for t in trials if t.variant_of is not None}
    decided = {_key(r): r for r in records(scores.association)}
    errors = {
        (r["log"], r["estimator"], r["association"], r["phase"]): value_of(r, "trans_mean_m")
        for r in records(scores.relations)
        if (r["tie"], r["subset"]) == ("row", "all")
    }
    last = {_key(r)[:4]: r for r in records(scores.metrics)}  # the final phase, where there is one, comes last
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
        yield Headline(
            rank,
            log,
            task,
            estimator,
            association,
            rmse=related if by_relations else rmse,
            nees=value_of(r, "nees_pose"),
            nis=value_of(r, "nis"),
            verdict=_verdict(r),
            wrong=_wrong(decided.get(_key(r))),
            by_relations=by_relations,
        )


def _of_studies(studies: Sequence[Study], judged: Sequence[Judged]) -> Iterable[Headline]:
    """A row for each estimator of a study, at its last phase."""
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
            yield Headline(rank, name, task, estimator, association, rmse, mean["nees"], mean["nis"], verdict)


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


def _verdict(row: Row) -> str:
    if row["status"] != "ok":
        return str(row["status"])
    values = [value_of(row, c) for c in ("nis", "nis_lower", "nis_upper")]
    return nis_verdict(*values) if all(math.isfinite(v) for v in values) else ""


def _wrong(row: Row | None) -> tuple[int, int] | None:
    """Wrong pairings, and all."""
    if row is None or is_blank(row["fp"]):
        return None
    return int(value_of(row, "fp")), int(value_of(row, "tp") + value_of(row, "fp"))


def lines(h: Headlines) -> list[str]:
    """The lines of the terminal; none where nothing was estimated."""
    if not h.rows:
        return []
    rows = [_cells(row) for row in h.rows]
    shown = [c for c in range(h.alone * NAMES_OF_LOG, len(HEADS)) if any(row[c] for row in rows)]
    told = [", ".join((h.rows[0].log, h.rows[0].task))] if h.alone else []
    told += _table([[row[c] for c in shown] for row in (HEADS, *rows)])
    told += [say("headline#more", rows=h.more)] if h.more else []
    wanted = {"NEES", "verdict", "wrong"} & {HEADS[c] for c in shown}
    wanted |= {"related"} if any(row.by_relations for row in h.rows) else set()
    remarks = [say(f"headline#{name}") for name in ("NEES", "related", "verdict", "wrong") if name in wanted]
    while len("; ".join(remarks)) > WIDTH - 2:
        remarks.pop()
    return [*told, f"({'; '.join(remarks)})"]


def _cells(row: Headline) -> Line:
    return (
        row.log,
        TASKS[row.task],
        row.estimator,
        row.association,
        _number(row.rmse) + (" rel" if row.by_relations else ""),
        _number(row.nees),
        _number(row.nis),
        row.verdict,
        "" if row.wrong is None else f"{row.wrong[0]} of {row.wrong[1]}",
    )


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Columns side by side, numbers to the right; the longest name is shortened until the lines fit."""
    names = [i for i, head in enumerate(rows[0]) if head in HEADS[:NAMES]]
    width = [max(map(len, column)) for column in zip(*rows, strict=True)]
    while sum(width) + 2 * (len(width) - 1) > WIDTH:
        longest = max(names, key=lambda i: width[i])
        if width[longest] <= SHORTEST:
            break
        width[longest] -= 1
    left = [head in (*HEADS[:NAMES], "verdict") for head in rows[0]]
    return ["  ".join(map(_fit, row, width, left)).rstrip() for row in rows]


def _fit(text: str, width: int, to_left: bool) -> str:
    """The text in so many characters; of a name that is too long the middle is left out, its end tells more."""
    if len(text) > width:
        end = (width - 1) // 2
        text = f"{text[: width - 1 - end]}…{text[-end:]}"
    return text.ljust(width) if to_left else text.rjust(width)
