"""Sentences that turn the referee's numbers into statements: what may be said, and no more.

The rules are those of the consistency tests: innovations of one run can be tested, the NEES of one run only describes,
a verdict on NEES needs many independent runs, and being inside bounds is no proof.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from eval.page.numbers import number
from eval.page.tables import is_blank
from eval.referee.consistency import CONSERVATIVE, CONSISTENT, INSIDE_3SIGMA, OVERCONFIDENT, TOO_FEW
from eval.replay.names import FILTERS

SAME = 0.02
"""Relative difference of two RMSE values below which they are called equal."""
SMOOTHERS = ("batch", "batch-huber", "batch-cauchy", "gnc", "isam2", "fixed-lag")

Row = dict[str, object]


def nis_verdict(nis: float, lower: float, upper: float) -> str:
    """`overconfident`, `conservative` or `consistent` of a NIS per dof against its chi-square bounds."""
    return OVERCONFIDENT if nis > upper else CONSERVATIVE if nis < lower else CONSISTENT


def nis_statement(nis: float, lower: float, upper: float, *, rejected: int = 0, known: bool = True) -> str:
    """What NIS per dof says about a filter, with everything that weakens the test; empty if no innovations were formed.

    `rejected` observations were gated out or discarded; `known`: the association was given, not decided.
    """
    if not all(math.isfinite(v) for v in (nis, lower, upper)):
        return ""
    numbers = f"(NIS per dof {number(nis)}, expected 1, 95 % bounds {lower:.2f}–{upper:.2f})"
    verdict = nis_verdict(nis, lower, upper)
    text = {
        OVERCONFIDENT: f"innovations larger than claimed {numbers}: {OVERCONFIDENT}",
        CONSERVATIVE: f"innovations smaller than claimed {numbers}: {CONSERVATIVE}",
        CONSISTENT: f"innovations as large as claimed {numbers}: nothing against the filter in this test",
    }[verdict]
    if rejected > 0:
        text += f"; {rejected} observations were left out, so the bounds are only a guide"
    if not known:
        text += "; conditional on the association decisions"
    return text


def nees_statement(nees: float, dof: int = 3) -> str:
    """What the mean NEES of one run describes; never a verdict. Empty if it is not known."""
    if not math.isfinite(nees):
        return ""
    text = f"mean NEES {number(nees)} over the run (dof {dof}, so {dof} is expected)"
    scale = math.sqrt(max(nees, 0.0) / dof)
    if nees > 2.0 * dof:
        text += f": errors about {number(scale, 2)} times as large as the covariance claims"
    elif nees < 0.5 * dof:
        text += f": errors about {number(scale, 2)} of what the covariance claims"
    return text + "; a description without verdict, because errors along one run are strongly correlated"


def inside_statement(share: float) -> str:
    """Share of frames inside the 3 sigma ellipse against what a Gaussian gives in the plane; empty if not known."""
    if not math.isfinite(share):
        return ""
    expected = f"a Gaussian in the plane: {100 * INSIDE_3SIGMA:.1f} %"
    return f"{100 * share:.1f} % of positions inside their 3σ ellipse ({expected})"


def verdict_statement(
    mean: float, lower: float, upper: float, dof: int, runs: int, verdict: str, power: float = math.nan
) -> str:
    """A Monte Carlo verdict with its numbers, and how much the test could have seen."""
    if not math.isfinite(lower):
        return f"{verdict} ({runs} runs, dof {dof})"
    interval = f"95 % interval {number(lower)}–{number(upper)}"
    text = f"{verdict}: mean {number(mean)} where {dof} is expected, {interval}, {runs} runs"
    if verdict == TOO_FEW:
        return text + "; too few runs to tell a right covariance from a wrong one"
    if verdict == CONSISTENT and math.isfinite(power):
        text += f"; a covariance claimed at 0.8 of the true one would be noticed with probability {power:.2f}"
    return text


def association_statement(tp: int, tn: int, fp: int, fn: int) -> str:
    """The association outcomes in words."""
    total = tp + tn + fp + fn
    if total == 0:
        return "no observations to decide about"
    right = f"of {total} observations {tp + tn} were decided rightly ({100 * (tp + tn) / total:.1f} %)"
    return f"{right}, {fp} were paired with a wrong landmark, {fn} were not paired though their landmark was in the map"


def failure_statement(log: str, task: str, estimator: str, association: str, status: str, frame: int, why: str) -> str:
    """Where and why an estimator stopped."""
    return f"{log}, {task}: {estimator} with association {association} is {status}, stopped at frame {frame}: {why}"


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
    told = [_compared([r for r in rows if r["association"] == chosen])]
    if several:
        told.insert(0, f"Filter and smoother are compared under association {chosen}.")
    if association is not None:
        told.append(_decided(rows, _rows(association), labelled))
    return " ".join(t for t in told if t)


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
    has_truth = math.isfinite(_value(filtered, "rmse_position_m")) and math.isfinite(
        _value(smoothed, "rmse_position_m")
    )
    newest = _pick(rows, ("isam2", "fixed-lag"), "online")
    told = _told_with_truth(filtered, smoothed, newest) if has_truth else _told_without_truth(filtered, smoothed)
    return " ".join(told)


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
    own = [r for r in deciding if r["estimator"] in (*FILTERS, "isam2", "fixed-lag")] or deciding
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
    told = f"Without labels, {_outcome(best)} decides best and {_outcome(worst)} worst, by F1"
    return f"{told}; even the best is mostly wrong." if f1(best) < 0.5 else f"{told}."


def _outcome(row: Row) -> str:
    counts = {c: int(_value(row, c)) for c in ("tp", "tn", "fp", "fn")}
    numbers = f"{counts['fp']} FP and {counts['fn']} FN in {sum(counts.values())} decisions, F1 {f1(row):.2f}"
    return f"{row['association']} ({row['estimator']}: {numbers})"


def _agreement(row: Row, rows: Sequence[Row], labelled: int | None) -> str:
    """Decisions against a log's own labels, which may be wrong themselves, and the size of the map."""
    right, total = (int(sum(_value(row, c) for c in columns)) for columns in (("tp", "tn"), ("tp", "tn", "fp", "fn")))
    told = (
        f"Deciding itself with {row['association']}, {row['estimator']} agrees with the log's labels in {right} of"
        f" {total} decisions ({100.0 * right / total:.0f} %)"
    )
    same = [r for r in rows if (r["estimator"], r["association"]) == (row["estimator"], row["association"])]
    size = _value(same[-1], "landmarks") if same else math.nan
    if math.isfinite(size) and labelled is not None:
        told += f"; its map has {int(size)} landmarks where the labels tell {labelled} apart"
    return told + "."


def _told_with_truth(filtered: Row, smoothed: Row, newest: Row | None) -> list[str]:
    a, b = _value(filtered, "rmse_position_m"), _value(smoothed, "rmse_position_m")
    first = (
        f"On identical inputs the filter ({filtered['estimator']}, each pose from the data up to it) has a position"
        f" RMSE of {number(a)} m and the smoother ({smoothed['estimator']}, every pose from all data) one of"
        f" {number(b)} m"
    )
    if b > 0.0 and a > 0.0:
        first += f": the filter's is {number(a / b)} times the smoother's"
    told = [first + _same_instant(a, b, newest) + "."]
    described = [_value(r, "nees_pose") for r in (filtered, smoothed)]
    if all(math.isfinite(v) for v in described):
        told.append(
            f"Mean pose NEES is {number(described[0])} (filter) and {number(described[1])} (smoother) where 3 is"
            " expected: a description of one run without verdict, because errors along a run are strongly correlated."
        )
    told.extend(_innovations(filtered))
    if b < a * (1.0 - SAME):
        told.append(
            "For the path after the fact trust the smoother; while the robot moves only an online estimate exists."
        )
    elif b <= a * (1.0 + SAME):
        told.append("In accuracy the two are equal here; the smoother's path is no better for having seen all data.")
    else:
        told.append(
            "The filter is closer to the truth here although it has seen less: chance, outliers or a noise model that"
            " does not fit, and no reason to trust the filter in general."
        )
    return told


def _same_instant(filter_rmse: float, smoother_rmse: float, newest: Row | None) -> str:
    """The fair comparison: an online smoother, which has seen exactly what the filter has."""
    online = math.nan if newest is None else _value(newest, "rmse_position_m")
    if newest is None or not math.isfinite(online):
        return ""
    text = f"; at the same instants, with the same data, {newest['estimator']} has {number(online)} m"
    if abs(online - filter_rmse) <= SAME * filter_rmse and smoother_rmse < filter_rmse * (1.0 - SAME):
        text += ", so the difference comes from later data, not from the kind of estimator"
    return text


def _told_without_truth(filtered: Row, smoothed: Row) -> list[str]:
    names = f"the filter ({filtered['estimator']}) and the smoother ({smoothed['estimator']})"
    difference = _value(filtered, "rms_from_batch_m")
    told = [f"The log has no true path, so the errors of {names} are not known."]
    if math.isfinite(difference):
        told[0] += (
            f" The filter's path is {number(difference)} m RMS from the batch solution: that is how much later data"
            " changed it, not an error."
        )
    told.extend(_innovations(filtered))
    told.append("Without truth the innovations are all that can be tested; which path is right this log cannot tell.")
    return told


def _innovations(filtered: Row) -> list[str]:
    rejected = _value(filtered, "rejected")
    statement = nis_statement(
        _value(filtered, "nis"), _value(filtered, "nis_lower"), _value(filtered, "nis_upper"),
        rejected=int(rejected) if math.isfinite(rejected) else 0, known=filtered["association"] == "known",
    )  # fmt: skip
    if not statement:
        return []
    told = f"What a single run can test are the filter's innovations; they are {statement.removeprefix('innovations ')}"
    verdict = nis_verdict(*(_value(filtered, c) for c in ("nis", "nis_lower", "nis_upper")))
    if verdict != CONSISTENT:
        claim = "too little" if verdict == OVERCONFIDENT else "more than needed"
        told += f". Filter and smoother share the noise model, which allows for {claim} here: mind their covariances"
    return [f"{told}."]
