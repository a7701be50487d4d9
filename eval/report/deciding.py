"""How the ways of deciding without labels did, in a sentence: the best and the worst, by decisions and by path."""

from __future__ import annotations

import math
from collections.abc import Sequence

from data.terminal.words import counted
from eval.page.numbers import number
from eval.page.tables import is_blank
from eval.replay.names import steps
from eval.report.rows import Row, filters_in, value_of

SAME = 0.02
"""Relative difference of two RMSE values below which they are called equal."""
USABLE = 0.9
"""A way of deciding is usable whose path has less than this share of dead reckoning's error."""


def f1(row: Row) -> float:
    """Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN); NaN where nothing was or should be paired."""
    tp, wrong = value_of(row, "tp"), value_of(row, "fp") + value_of(row, "fn")
    return 2.0 * tp / (2.0 * tp + wrong) if tp + wrong > 0 else math.nan


def deciding_rows(rows: Sequence[Row], outcomes: Sequence[Row]) -> list[Row]:
    """Outcomes of the runs that decided for themselves, got to the end and are plausible, in their last phase."""
    ended = {(r["estimator"], r["association"]) for r in rows if r["status"] == "ok"}
    filters = filters_in(rows)
    deciding = [
        r
        for r in outcomes
        if r["association"] not in ("known", "none")
        and (r["estimator"], r["association"]) in ended
        and r["phase"] == ("online" if r["estimator"] in filters else "final")
    ]
    # batch smoothers take the decisions of another run, which speaks for itself where it is there
    own = [r for r in deciding if steps(str(r["estimator"]))] or deciding
    own = [r for r in own if math.isfinite(f1(r))]
    return own


def extremes(rows: Sequence[Row], outcomes: Sequence[Row]) -> tuple[Row, Row] | None:
    """The best way of deciding, by F1, of those with a usable path (of all, where none has one), and the worst."""
    own = deciding_rows(rows, outcomes)
    if not own:
        return None
    usable = [r for r in own if _usable(r, rows)] or own
    return max(usable, key=quality), min(own, key=quality)


def quality(row: Row) -> tuple[float, float]:
    """By which ways of deciding are ordered."""
    return f1(row), -value_of(row, "fp") - value_of(row, "fn")


def best_and_worst(rows: Sequence[Row], outcomes: Sequence[Row], labelled: int | None) -> str:
    """How the methods that decide for themselves did: the best and the worst, or against labels in a log without path.

    Only runs that got to the end and are plausible count: the others' decisions end with them.
    """
    own = deciding_rows(rows, outcomes)
    if not own:
        return ""
    path = any(math.isfinite(value_of(r, "rmse_position_m")) for r in rows)

    best, worst = max(own, key=quality), min(own, key=quality)
    if not path:
        return " ".join(_agreement(r, rows, labelled) for r in ([best] if best is worst else [best, worst]))
    if best is worst:
        return f"Deciding itself, {_outcome(best)}."
    if f1(best) == 0.0:
        return "Of the ways of deciding without labels none made a single right pairing."
    usable = [r for r in own if _usable(r, rows)]
    if not usable:
        least = f"{_outcome(best)} is least bad by F1{_path(best, rows)}"
        return f"Without labels no way of deciding gives a usable path; {least}."
    best = max(usable, key=quality)
    text = f"Without labels, {_outcome(best)} decides best{_path(best, rows)} and {_outcome(worst)} worst"
    nearest = min(usable, key=lambda r: _rmse(r, rows))
    if _rmse(nearest, rows) < (1.0 - SAME) * _rmse(best, rows):
        text += f"; the path is best with {_outcome(nearest)}{_path(nearest, rows)}"
    return f"{text}; even the best is mostly wrong." if f1(best) < 0.5 else f"{text}."


def _scored(row: Row, rows: Sequence[Row]) -> Row:
    """The row of metrics of the run and phase that a row of decisions is about; empty if there is none."""
    return next((r for r in rows if all(r[c] == row[c] for c in ("estimator", "association", "phase"))), {})


def _rmse(row: Row, rows: Sequence[Row]) -> float:
    return value_of(_scored(row, rows), "rmse_position_m")


def _dead_reckoned(rows: Sequence[Row]) -> float:
    """Position RMSE of dead reckoning, NaN if it did not run."""
    return next((value_of(r, "rmse_position_m") for r in rows if r["estimator"] == "dead-reckoning"), math.nan)


def _path(row: Row, rows: Sequence[Row]) -> str:
    """Its error, with that of dead reckoning where that ran."""
    own, reckoned = _rmse(row, rows), _dead_reckoned(rows)
    compared = f" where dead reckoning has {number(reckoned)} m" if math.isfinite(reckoned) else ""
    return f" (path {number(own)} m{compared})" if math.isfinite(own) else ""


def _usable(row: Row, rows: Sequence[Row]) -> bool:
    """Whether deciding so is better than not looking: not lost, and nearer to the truth than dead reckoning."""
    lost = not is_blank(_scored(row, rows).get("lost_why"))
    return not lost and not _rmse(row, rows) >= USABLE * _dead_reckoned(rows)


def _outcome(row: Row) -> str:
    counts = {c: int(value_of(row, c)) for c in ("tp", "tn", "fp", "fn")}
    numbers = f"{counts['fp']} FP and {counts['fn']} FN in {sum(counts.values())} decisions, F1 {f1(row):.2f}"
    return f"{row['association']} ({row['estimator']}: {numbers})"


def _agreement(row: Row, rows: Sequence[Row], labelled: int | None) -> str:
    """Decisions against a log's own labels, which may be wrong themselves, and the size of the map."""
    right, total = (int(sum(value_of(row, c) for c in columns)) for columns in (("tp", "tn"), ("tp", "tn", "fp", "fn")))
    text = (
        f"Deciding itself with {row['association']}, {row['estimator']} agrees with the log's labels in {right} of"
        f" {total} decisions ({100.0 * right / total:.0f} %)"
    )
    same = [r for r in rows if (r["estimator"], r["association"]) == (row["estimator"], row["association"])]
    size = value_of(same[-1], "landmarks") if same else math.nan
    if math.isfinite(size) and labelled is not None:
        text += f"; its map has {counted(int(size), 'landmark')} where the labels tell {labelled} apart"
    return text + "."
