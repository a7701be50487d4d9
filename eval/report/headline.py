"""The main numbers on the terminal at the end of a run: at most twelve lines that fit a screen of 80 columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from data.terminal import counted
from eval.referee.score import Scores, Trial
from eval.report.answer import nis_verdict
from eval.report.page.tables import is_blank
from eval.report.rows import Row, value_of
from eval.report.rows import rows_of as records
from eval.studies.montecarlo import Judged, Study

LINES = 12
WIDTH = 80
"""Characters of a line."""
SHORTEST = 9
"""Characters that are left of a name, at least."""
HEADS = ("log", "task", "estimator", "assoc.", "RMSE [m]", "NEES", "NIS", "verdict", "wrong")
NAMES = 4
"""Columns that are names."""
TASKS = {"slam": "SLAM", "localization": "loc."}
Line = tuple[str, ...]


@dataclass(frozen=True)
class Headline:
    """A row: what it is about, how soon it is wanted (0: first), and its cells."""

    rank: int
    cells: Line


def headlines(scores: Scores, trials: Sequence[Trial], studies: Sequence[Study], judged: Sequence[Judged]) -> list[str]:
    """The lines; none where nothing was estimated."""
    found = [*_of_logs(scores, trials), *_of_studies(studies, judged)]
    if not found:
        return []
    one = len({h.cells[:2] for h in found}) == 1
    room = LINES - 2 - one
    room -= len(found) > room
    order = sorted(range(len(found)), key=lambda i: (found[i].rank, i))
    shown = [found[i].cells for i in sorted(order[:room])]
    if one:
        lines = [", ".join(found[0].cells[:2]), *_table([row[2:] for row in (HEADS, *shown)])]
    else:
        lines = _table([HEADS, *((log, TASKS[task], *rest) for log, task, *rest in shown)])
    if len(found) > len(shown):
        lines.append(f"and {counted(len(found) - len(shown), 'more row')}, in metrics.csv and consistency.csv")
    return [*lines, _remark(lines)]


def _of_logs(scores: Scores, trials: Sequence[Trial]) -> Iterable[Headline]:
    """A row for each run, with what is known in the end; filter and last smoother of each log are wanted first."""
    beside = {t.log.name for t in trials if t.beside is not None}
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
        rank = 3 if r["estimator"] == "dead-reckoning" else 2 if key[0] in beside else min(place, 1)
        if rank == 1 and r["estimator"] == "batch":
            rank = 0
        rmse = _number(value_of(r, "rmse_position_m"))
        related = errors.get((r["log"], r["estimator"], r["association"], r["phase"]), math.nan)
        if not rmse and math.isfinite(related):
            rmse = f"{_number(related)} rel"
        yield Headline(rank, (
            str(r["log"]), str(r["task"]), str(r["estimator"]), str(r["association"]), rmse,
            _number(value_of(r, "nees_pose")), _number(value_of(r, "nis")), _verdict(r), _wrong(decided.get(_key(r))),
        ))  # fmt: skip


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
            yield Headline(3 if estimator == "dead-reckoning" else 0, (
                f"{study.scenario.name} x{len(study.seeds)}", task, estimator, association,
                _number(rmse), "" if nees is None else _number(nees.mean), "" if nis is None else _number(nis.mean),
                "" if nees is None else nees.word, "",
            ))  # fmt: skip


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


def _wrong(row: Row | None) -> str:
    """Wrong pairings of all."""
    if row is None or is_blank(row["fp"]):
        return ""
    return f"{value_of(row, 'fp'):.0f} of {value_of(row, 'tp') + value_of(row, 'fp'):.0f}"


def _table(rows: Sequence[Line]) -> list[str]:
    """Columns side by side, numbers to the right; the longest name is shortened until the lines fit."""
    keep = [c for c in range(len(rows[0])) if any(row[c] for row in rows[1:])]
    cells = [[row[c] for c in keep] for row in rows]
    names = [i for i, head in enumerate(cells[0]) if head in HEADS[:NAMES]]
    width = [max(len(row[i]) for row in cells) for i in range(len(keep))]
    while sum(width) + 2 * (len(width) - 1) > WIDTH:
        longest = max(names, key=lambda i: width[i])
        if width[longest] <= SHORTEST:
            break
        width[longest] -= 1
    left = [head in (*HEADS[:NAMES], "verdict") for head in cells[0]]
    return [
        "  ".join(_fit(t, w, to_left) for t, w, to_left in zip(row, width, left, strict=True)).rstrip() for row in cells
    ]


def _fit(text: str, width: int, to_left: bool) -> str:
    """The text in so many characters; of a name that is too long the middle is left out, its end tells more."""
    if len(text) > width:
        end = (width - 1) // 2
        text = f"{text[: width - 1 - end]}…{text[-end:]}"
    return text.ljust(width) if to_left else text.rjust(width)


def _remark(lines: Sequence[str]) -> str:
    """What the columns that are shown mean, in one line."""
    said = {
        "NEES": "expected: NEES 3, NIS 1",
        " rel ": "rel: of relations",
        "verdict": "verdict on NIS, over runs on NEES",
        "wrong": "wrong: of pairings",
    }
    shown = " ".join(lines)
    texts = [text for name, text in said.items() if name in shown]
    while len("; ".join(texts)) > WIDTH - 2:
        texts.pop()
    return f"({'; '.join(texts)})"
