"""Filter or smoother: a few sentences on one log and task, from its rows of metrics.csv and association.csv."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from eval.page.numbers import number
from eval.page.tables import is_blank
from eval.referee.consistency import CONSISTENT, OVERCONFIDENT
from eval.replay.names import BATCH, FILTERS, INCREMENTAL, STEPPING
from eval.report.statements import nis_statement, nis_verdict

SAME = 0.02
"""Relative difference of two RMSE values below which they are called equal."""
SMOOTHERS = (*BATCH, *INCREMENTAL)
LINEARIZATION = 2.0
"""So many times the RMSE of a smoother with the same data at the same instants: linearization, not luck."""
LOST_ADVICE = (
    "{} to be trusted from there on: look at the frame of map and prior, at units and signs of the readings, and for a"
    " jump of the robot."
)

Row = dict[str, object]


def _value(row: Row, column: str) -> float:
    value = row.get(column)
    return math.nan if is_blank(value) else float(value)  # type: ignore[arg-type]


def _pick(rows: Sequence[Row], names: Sequence[str], phase: str) -> Row | None:
    """The first of the named estimators, in their order, that has a row in the phase; one that got to the end first."""
    found = [r for name in names for r in rows if r["estimator"] == name and r["phase"] == phase]
    return min(found, key=lambda r: r["status"] != "ok", default=None)


def chosen_association(rows: Sequence[Row]) -> str | None:
    """The association to compare under: known, or else the first that a filter and a smoother share, or else any."""
    given = [str(r["association"]) for r in rows if r["association"] != "none"]
    filters = {r["association"] for r in rows if r["estimator"] in FILTERS}
    smoothers = {r["association"] for r in rows if r["estimator"] in SMOOTHERS}
    order = sorted(dict.fromkeys(given), key=lambda a: (a != "known", a not in filters or a not in smoothers))
    return order[0] if order else None


def answer(metrics: pd.DataFrame, association: pd.DataFrame | None = None, labelled: int | None = None) -> str:
    """A few sentences on one log and task: filter and smoother on identical inputs, and which to trust when.

    `metrics` and `association` are the rows of metrics.csv and association.csv for one log and task; `labelled` is the
    number of landmarks that the log's ids tell apart. Filter and smoother are compared under known association if there
    is one; how well the others decided is said in a sentence of its own.
    """
    rows = _rows(metrics)
    chosen = chosen_association(rows)
    several = len({r["association"] for r in rows if r["association"] != "none"}) > 1
    notes = [_compared([r for r in rows if r["association"] == chosen])]
    if several:
        notes.insert(0, f"Filter and smoother are compared under association {chosen}.")
    if association is not None:
        notes.append(_decided(rows, _rows(association), labelled))
    return " ".join(n for n in notes if n)


def _rows(frame: pd.DataFrame) -> list[Row]:
    return [{str(k): v for k, v in r.items()} for r in frame.to_dict("records")]


def _compared(rows: Sequence[Row]) -> str:
    """Filter and smoother under one association."""
    filtered, smoothed = _pick(rows, FILTERS, "online"), _pick(rows, SMOOTHERS, "final")
    failed = [r for r in (filtered, smoothed) if r is not None and r["status"] != "ok"]
    if failed:
        names = " and ".join(f"{r['estimator']} ({r['status']})" for r in failed)
        return f"There is no comparison: {names} did not get to the end, so there are no numbers to compare."
    if filtered is None or smoothed is None:
        only = filtered or smoothed
        if only is None:
            return "Neither a filter nor a smoother ran, so there is nothing to compare."
        missing = "smoother" if smoothed is None else "filter"
        return f"Only {only['estimator']} ran: without a {missing} there is nothing to compare it with."
    gone = [r for r in (filtered, smoothed) if not is_blank(r.get("lost_why"))]
    if gone:
        which = "Neither path is" if len(gone) == 2 else "Its path is not"
        return " ".join([*(_lost(r) for r in gone), LOST_ADVICE.format(which), *_errors_of(filtered, smoothed)])
    newest = _pick(rows, INCREMENTAL, "online")
    known = _errors_of(filtered, smoothed)
    return " ".join(_with_truth(filtered, smoothed, newest) if known else _without_truth(filtered, smoothed))


def _lost(row: Row) -> str:
    kind = "filter" if row["estimator"] in FILTERS else "smoother"
    frame = int(_value(row, "lost_frame"))
    return f"Lost: the {kind} ({row['estimator']}) does not know where it is from frame {frame} on ({row['lost_why']})."


def _errors_of(filtered: Row, smoothed: Row) -> list[str]:
    """The errors of both in a sentence, if the truth is known."""
    a, b = _value(filtered, "rmse_position_m"), _value(smoothed, "rmse_position_m")
    if not (math.isfinite(a) and math.isfinite(b)):
        return []
    return [
        f"Position RMSE is {number(a)} m for the filter ({filtered['estimator']}) and {number(b)} m for the smoother"
        f" ({smoothed['estimator']})."
    ]


def f1(row: Row) -> float:
    """Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN); NaN where nothing was or should be paired."""
    tp, wrong = _value(row, "tp"), _value(row, "fp") + _value(row, "fn")
    return 2.0 * tp / (2.0 * tp + wrong) if tp + wrong > 0 else math.nan


def _decided(rows: Sequence[Row], outcomes: Sequence[Row], labelled: int | None) -> str:
    """How the methods that decide for themselves did: the best and the worst, or against labels in a log without path.

    Only runs that got to the end count: the others' decisions end with them.
    """
    ended = {(r["estimator"], r["association"]) for r in rows if r["status"] == "ok"}
    deciding = [
        r
        for r in outcomes
        if r["association"] not in ("known", "none")
        and (r["estimator"], r["association"]) in ended
        and r["phase"] == ("online" if r["estimator"] in FILTERS else "final")
    ]
    # batch smoothers take the decisions of another run, which speaks for itself where it is there
    own = [r for r in deciding if r["estimator"] in STEPPING] or deciding
    own = [r for r in own if math.isfinite(f1(r))]
    if not own:
        return ""
    path = any(math.isfinite(_value(r, "rmse_position_m")) for r in rows)

    def quality(row: Row) -> tuple[float, float]:
        return f1(row), -_value(row, "fp") - _value(row, "fn")

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


def _rmse(row: Row, rows: Sequence[Row]) -> float:
    """Position RMSE of the run and phase that a row of decisions is about."""
    same = [r for r in rows if all(r[c] == row[c] for c in ("estimator", "association"))]
    return min((_value(r, "rmse_position_m") for r in same if r["phase"] == row["phase"]), default=math.nan)


def _path(row: Row, rows: Sequence[Row]) -> str:
    """Its error, beside that of dead reckoning where that ran."""
    own = _rmse(row, rows)
    reckoned = [_value(r, "rmse_position_m") for r in rows if r["estimator"] == "dead-reckoning"]
    beside = f" where dead reckoning has {number(reckoned[0])} m" if reckoned and math.isfinite(reckoned[0]) else ""
    return f" (path {number(own)} m{beside})" if math.isfinite(own) else ""


def _usable(row: Row, rows: Sequence[Row]) -> bool:
    """Whether deciding so is better than not looking: not lost, and nearer to the truth than dead reckoning."""
    same = [r for r in rows if all(r[c] == row[c] for c in ("estimator", "association", "phase"))]
    if any(not is_blank(r.get("lost_why")) for r in same):
        return False
    reckoned = [_value(r, "rmse_position_m") for r in rows if r["estimator"] == "dead-reckoning"]
    return not (reckoned and _rmse(row, rows) >= reckoned[0])


def _outcome(row: Row) -> str:
    counts = {c: int(_value(row, c)) for c in ("tp", "tn", "fp", "fn")}
    numbers = f"{counts['fp']} FP and {counts['fn']} FN in {sum(counts.values())} decisions, F1 {f1(row):.2f}"
    return f"{row['association']} ({row['estimator']}: {numbers})"


def _agreement(row: Row, rows: Sequence[Row], labelled: int | None) -> str:
    """Decisions against a log's own labels, which may be wrong themselves, and the size of the map."""
    right, total = (int(sum(_value(row, c) for c in columns)) for columns in (("tp", "tn"), ("tp", "tn", "fp", "fn")))
    text = (
        f"Deciding itself with {row['association']}, {row['estimator']} agrees with the log's labels in {right} of"
        f" {total} decisions ({100.0 * right / total:.0f} %)"
    )
    same = [r for r in rows if (r["estimator"], r["association"]) == (row["estimator"], row["association"])]
    size = _value(same[-1], "landmarks") if same else math.nan
    if math.isfinite(size) and labelled is not None:
        text += f"; its map has {int(size)} landmarks where the labels tell {labelled} apart"
    return text + "."


def _with_truth(filtered: Row, smoothed: Row, newest: Row | None) -> list[str]:
    a, b = _value(filtered, "rmse_position_m"), _value(smoothed, "rmse_position_m")
    first = (
        f"On identical inputs the filter ({filtered['estimator']}, each pose from the data up to it) has a position"
        f" RMSE of {number(a)} m and the smoother ({smoothed['estimator']}, every pose from all data) one of"
        f" {number(b)} m"
    )
    if b > 0.0 and a > 0.0:
        first += f": the filter's is {number(a / b)} times the smoother's"
    notes = [first + _same_instant(a, b, newest) + "."]
    described = [_nees(r) for r in (filtered, smoothed)]
    if all(described):
        notes.append(
            f"Mean pose NEES is {described[0]} for the filter and {described[1]} for the smoother where 3 is expected"
            " (median 2.37): a description of one run without verdict, because errors along a run are strongly"
            " correlated."
        )
    notes.extend(_innovations(filtered))
    if b < a * (1.0 - SAME):
        notes.append(
            "For the path after the fact trust the smoother; while the robot moves only an online estimate exists."
        )
    elif b <= a * (1.0 + SAME):
        notes.append("In accuracy the two are equal here; the smoother's path is no better for having seen all data.")
    else:
        notes.append(
            "The filter is closer to the truth here although it has seen less: chance, outliers or a noise model that"
            " does not fit, and no reason to trust the filter in general."
        )
    return notes


def _nees(row: Row) -> str:
    """Mean and median pose NEES of one run, and how many frames are in neither; empty if not known."""
    mean, median, out = (_value(row, c) for c in ("nees_pose", "nees_pose_median", "nees_left_out"))
    if not math.isfinite(mean):
        return ""
    frames = "1 frame" if out == 1 else f"{out:.0f} frames"
    left = f", {frames} of nearly singular covariance left out" if out > 0 else ""
    return f"{number(mean)} (median {number(median)}{left})"


def _same_instant(filter_rmse: float, smoother_rmse: float, newest: Row | None) -> str:
    """The fair comparison: an online smoother, which has seen exactly what the filter has."""
    online = math.nan if newest is None else _value(newest, "rmse_position_m")
    if newest is None or not math.isfinite(online):
        return ""
    text = f"; at the same instants, with the same data, {newest['estimator']} has {number(online)} m"
    if abs(online - filter_rmse) <= SAME * filter_rmse and smoother_rmse < filter_rmse * (1.0 - SAME):
        text += ", so the difference comes from later data, not from the kind of estimator"
    elif filter_rmse > LINEARIZATION * online:
        text += (
            ", so the difference is the filter's linearization: it keeps what it linearized once, the smoother does it"
            " again; ekf-iterated relinearizes each update"
        )
    return text


def _without_truth(filtered: Row, smoothed: Row) -> list[str]:
    names = f"the filter ({filtered['estimator']}) and the smoother ({smoothed['estimator']})"
    difference = _value(filtered, "rms_from_batch_m")
    notes = [f"The log has no true path, so the errors of {names} are not known."]
    if math.isfinite(difference):
        notes[0] += (
            f" The filter's path is {number(difference)} m RMS from the batch solution: that is how much later data"
            " changed it, not an error."
        )
    notes.extend(_innovations(filtered))
    notes.append("Without truth the innovations are all that can be tested; which path is right this log cannot tell.")
    return notes


def _innovations(filtered: Row) -> list[str]:
    rejected, expected = _value(filtered, "rejected"), _value(filtered, "nis_expected")
    statement = nis_statement(
        _value(filtered, "nis"),
        _value(filtered, "nis_lower"),
        _value(filtered, "nis_upper"),
        expected=expected if math.isfinite(expected) else 1.0,
        rejected=int(rejected) if math.isfinite(rejected) else 0,
        known=filtered["association"] == "known",
    )
    if not statement:
        return []
    text = f"What a single run can test are the filter's innovations; they are {statement.removeprefix('innovations ')}"
    verdict = nis_verdict(*(_value(filtered, c) for c in ("nis", "nis_lower", "nis_upper")))
    if verdict != CONSISTENT:
        claim = "too little" if verdict == OVERCONFIDENT else "more than needed"
        text += f". Filter and smoother share the noise model, which allows for {claim} here: mind their covariances"
    return [f"{text}."]
