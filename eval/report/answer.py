"""Filter or smoother: a few sentences on one log and task, from its rows of metrics.csv and association.csv.

Sentences that turn the referee's numbers into statements: what may be said, and no more.

The rules are those of the consistency tests: innovations of one run can be tested, the NEES of one run only describes,
a verdict on NEES needs many independent runs, and being inside bounds is no proof.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from data.terminal import counted
from eval.referee.consistency import CONSERVATIVE, CONSISTENT, INSIDE_3SIGMA, OVERCONFIDENT, TOO_FEW
from eval.referee.plausibility import IMPLAUSIBLE
from eval.replay.settings import INCREMENTAL, Setup
from eval.report.comparison import difference_sentence
from eval.report.deciding import SAME, best_and_worst
from eval.report.page.tables import is_blank, number
from eval.report.rows import Row, filters_in, rows_of, smoothers_in, value_of


def nis_verdict(nis: float, lower: float, upper: float) -> str:
    """`overconfident`, `conservative` or `consistent` of a NIS per dof against its bounds."""
    return OVERCONFIDENT if nis > upper else CONSERVATIVE if nis < lower else CONSISTENT


def nis_statement(
    nis: float, lower: float, upper: float, *, expected: float = 1.0, rejected: int = 0, known: bool = True
) -> str:
    """What NIS per dof says about a filter, with everything that weakens the test; empty if no innovations were formed.

    `expected` behind the gates; `rejected` observations were gated out or discarded; `known`: the association was
    given, not decided.
    """
    if not all(math.isfinite(v) for v in (nis, lower, upper)):
        return ""
    behind = f"{expected:.3g} behind the gates" if expected < 0.9995 else "1"
    numbers = f"(NIS per dof {number(nis)}, expected {behind}, 95 % bounds {lower:.2f}–{upper:.2f})"
    verdict = nis_verdict(nis, lower, upper)
    text = {
        OVERCONFIDENT: f"innovations larger than claimed {numbers}: {OVERCONFIDENT}",
        CONSERVATIVE: f"innovations smaller than claimed {numbers}: {CONSERVATIVE}",
        CONSISTENT: f"innovations as large as claimed {numbers}: nothing against the filter in this test",
    }[verdict]
    if rejected > 0:
        text += f"; {counted(rejected, 'observation was', 'observations were')} left out"
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
        return f"{verdict} ({counted(runs, 'run')}, dof {dof})"
    interval = f"95 % interval {number(lower)}–{number(upper)}"
    text = f"{verdict}: mean {number(mean)} where {dof} is expected, {interval}, {counted(runs, 'run')}"
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
    share = 100 * (tp + tn) / total
    right = f"of {counted(total, 'observation')} {counted(tp + tn, 'was', 'were')} decided rightly ({share:.1f} %)"
    return f"{right}, {fp} were paired with a wrong landmark, {fn} were not paired though their landmark was in the map"


def gate_sentence(setup: Setup, *, sensed: bool) -> str:
    """Which gate the readings paired by label had to pass; `sensed`: a sensor read the labels of this log."""
    gate = setup.settled(sensed).label_gate
    whose = "a sensor read the labels" if sensed else "no sensor read the labels"
    because = f" (the default where {whose}; `--gate-known` changes it)" if setup.gate_known == "auto" else ""
    if gate is None:
        return f"Readings paired by label pass no gate{because}."
    left = "" if setup.gate_smoothers else " for the filters; the smoothers keep them"
    return f"Readings paired by label are left out beyond the {gate:g} quantile of their innovation{left}{because}."


def failure_statement(log: str, task: str, estimator: str, association: str, status: str, frame: int, why: str) -> str:
    """Where and why an estimator stopped, or from where on it is not to be believed."""
    where = "from" if status == IMPLAUSIBLE else "stopped at"
    return f"{log}, {task}: {estimator} with association {association} is {status}, {where} frame {frame}: {why}"


LINEARIZATION = 2.0
"""So many times the RMSE of a smoother with the same data at the same instants: linearization, not luck."""
FAR = 20.0
"""A filter's NIS so many times the smoother's is linearization: a wrong map or prior, or a jump, gives up to 10."""
LOST_ADVICE = (
    "{} to be trusted from there on: look at the frame of map and prior, at units and signs of the readings, and for a"
    " jump of the robot."
)
LINEARIZED = (
    "The same readings, prior and noise fit together far better in {}, so it is the filter's linearization: it keeps"
    " what it linearized once. ekf-iterated relinearizes each update."
)


def pick(rows: Sequence[Row], names: Sequence[str], phase: str) -> Row | None:
    """The first of the named estimators, in their order, that has a row in the phase; one that got to the end first."""
    found = [r for name in names for r in rows if r["estimator"] == name and r["phase"] == phase]
    return min(found, key=lambda r: r["status"] != "ok", default=None)


def chosen_association(rows: Sequence[Row]) -> str | None:
    """The association to compare under: known, or else the first that a filter and a smoother share, or else any."""
    given = [str(r["association"]) for r in rows if r["association"] != "none"]
    filters = {r["association"] for r in rows if r["estimator"] in filters_in(rows)}
    smoothers = {r["association"] for r in rows if r["estimator"] in smoothers_in(rows)}
    order = sorted(dict.fromkeys(given), key=lambda a: (a != "known", a not in filters or a not in smoothers))
    return order[0] if order else None


def answer(
    metrics: pd.DataFrame,
    association: pd.DataFrame | None = None,
    labelled: int | None = None,
    differences: pd.DataFrame | None = None,
    trust: str = "",
) -> str:
    """A few sentences on one log and task: filter and smoother on identical inputs, and which to trust when.

    `metrics` and `association` are the rows of metrics.csv and association.csv for one log and task; `labelled` is the
    number of landmarks that the log's ids tell apart; `differences` the rows of `Scores.differences`. `trust` is
    what the log says of itself, which comes first where there is no truth. Filter and smoother are compared under known
    association if there is one; how well the others decided is said in a sentence of its own.
    """
    rows = rows_of(metrics)
    chosen = chosen_association(rows)
    several = len({r["association"] for r in rows if r["association"] != "none"}) > 1
    apart = [] if differences is None else rows_of(differences)
    compared, untrue = _compared([r for r in rows if r["association"] == chosen], apart, bool(trust))
    notes = [trust, compared] if untrue else [compared, trust]
    if several:
        notes.insert(0, f"Filter and smoother are compared under association {chosen}.")
    if association is not None:
        notes.append(best_and_worst(rows, rows_of(association), labelled))
    return " ".join(n for n in notes if n)


def _compared(rows: Sequence[Row], differences: Sequence[Row], trusted: bool) -> tuple[str, bool]:
    """Filter and smoother under one association; and whether both got there, but nobody knows the true path.

    `trusted`: what the log says of itself stands beside it, distance from the smoother and innovations included.
    """
    filtered, smoothed = pick(rows, filters_in(rows), "online"), pick(rows, smoothers_in(rows), "final")
    failed = [r for r in (filtered, smoothed) if r is not None and r["status"] not in ("ok", IMPLAUSIBLE)]
    if failed:
        names = " and ".join(f"{r['estimator']} ({r['status']})" for r in failed)
        return f"There is no comparison: {names} did not get to the end, so there are no numbers to compare.", False
    doubtful = [r for r in (filtered, smoothed) if r is not None and r["status"] == IMPLAUSIBLE]
    if doubtful:
        return " ".join([*_doubted(doubtful), *_gone(filtered, smoothed)]), False
    if filtered is None or smoothed is None:
        only = filtered or smoothed
        if only is None:
            return "Neither a filter nor a smoother ran, so there is nothing to compare.", False
        missing = "smoother" if smoothed is None else "filter"
        return f"Only {only['estimator']} ran: without a {missing} there is nothing to compare it with.", False
    gone = _gone(filtered, smoothed)
    if gone:
        return " ".join([*gone, *_errors_of(filtered, smoothed)]), False
    newest = pick([r for r in rows if r["status"] == "ok"], INCREMENTAL, "online")
    if not _errors_of(filtered, smoothed):
        return " ".join(_without_truth(filtered, smoothed, trusted)), True
    return " ".join(
        _with_truth(filtered, smoothed, newest, difference_sentence(differences, filtered, smoothed))
    ), False


def _doubted(rows: Sequence[Row]) -> list[str]:
    """That some rows are implausible, in sentences."""
    names = " and ".join(str(r["estimator"]) for r in rows)
    end = " is implausible" if len(rows) == 1 else " are implausible"
    return [
        f"There is no comparison: {names}{end}, with a number that no honest run gives. All numbers are in the"
        " table, but count for nothing; what probably happened is said under Failures."
    ]


def _gone(filtered: Row | None, smoothed: Row | None) -> list[str]:
    """Who is lost, and what to look for; nothing where nobody is."""
    gone = [r for r in (filtered, smoothed) if r is not None and not is_blank(r.get("lost_why"))]
    if not gone:
        return []
    advice = LOST_ADVICE.format("Neither path is" if len(gone) == 2 else "Its path is not")
    if gone == [filtered] and filtered is not None and smoothed is not None and fits(smoothed, filtered):
        advice = LINEARIZED.format(f"the smoother ({smoothed['estimator']})")
    return [*(_lost(r) for r in gone), advice]


def _lost(row: Row) -> str:
    kind = "filter" if row["phase"] == "online" else "smoother"
    frame = int(value_of(row, "lost_frame"))
    return f"Lost: the {kind} ({row['estimator']}) does not know where it is from frame {frame} on ({row['lost_why']})."


def fits(smoothed: Row, filtered: Row) -> bool:
    """Whether prior, map and readings agree in a smoother's solution, or at least incomparably better than here."""
    nis = value_of(smoothed, "nis")
    return nis <= value_of(smoothed, "nis_upper") or FAR * nis < value_of(filtered, "nis")


def _errors_of(filtered: Row, smoothed: Row) -> list[str]:
    """The errors of both in a sentence, if the truth is known."""
    a, b = value_of(filtered, "rmse_position_m"), value_of(smoothed, "rmse_position_m")
    if not (math.isfinite(a) and math.isfinite(b)):
        return []
    return [
        f"Position RMSE is {number(a)} m for the filter ({filtered['estimator']}) and {number(b)} m for the smoother"
        f" ({smoothed['estimator']})."
    ]


def _with_truth(filtered: Row, smoothed: Row, newest: Row | None, difference: str) -> list[str]:
    a, b = value_of(filtered, "rmse_position_m"), value_of(smoothed, "rmse_position_m")
    first = (
        f"On identical inputs the filter ({filtered['estimator']}, each pose from the data up to it) has a position"
        f" RMSE of {number(a)} m and the smoother ({smoothed['estimator']}, every pose from all data) one of"
        f" {number(b)} m"
    )
    if b > 0.0 and a > 0.0:
        first += f": the filter's is {number(a / b)} times the smoother's"
    notes = [first + _same_instant(a, b, newest) + ".", *([difference] if difference else [])]
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
    mean, median, out = (value_of(row, c) for c in ("nees_pose", "nees_pose_median", "nees_left_out"))
    if not math.isfinite(mean):
        return ""
    frames = "1 frame" if out == 1 else f"{out:.0f} frames"
    left = f", {frames} of nearly singular covariance left out" if out > 0 else ""
    return f"{number(mean)} (median {number(median)}{left})"


def _same_instant(filter_rmse: float, smoother_rmse: float, newest: Row | None) -> str:
    """The fair comparison: an online smoother, which has seen exactly what the filter has."""
    online = math.nan if newest is None else value_of(newest, "rmse_position_m")
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


def _without_truth(filtered: Row, smoothed: Row, trusted: bool) -> list[str]:
    names = f"the filter ({filtered['estimator']}) and the smoother ({smoothed['estimator']})"
    difference = value_of(filtered, "rms_from_batch_m")
    notes = [f"The log has no true path, so the errors of {names} are not known."]
    if trusted:
        return notes
    if math.isfinite(difference):
        notes[0] += (
            f" The filter's path is {number(difference)} m RMS from the batch solution: that is how much later data"
            " changed it, not an error."
        )
    notes.extend(_innovations(filtered))
    return notes


def _innovations(filtered: Row) -> list[str]:
    rejected, expected = value_of(filtered, "rejected"), value_of(filtered, "nis_expected")
    statement = nis_statement(
        value_of(filtered, "nis"),
        value_of(filtered, "nis_lower"),
        value_of(filtered, "nis_upper"),
        expected=expected if math.isfinite(expected) else 1.0,
        rejected=int(rejected) if math.isfinite(rejected) else 0,
        known=filtered["association"] == "known",
    )
    if not statement:
        return []
    text = f"The filter's innovations are {statement.removeprefix('innovations ')}"
    verdict = nis_verdict(*(value_of(filtered, c) for c in ("nis", "nis_lower", "nis_upper")))
    if verdict != CONSISTENT:
        claim = "too little" if verdict == OVERCONFIDENT else "more than needed"
        text += f". Filter and smoother share the noise model, which allows for {claim} here: mind their covariances"
    return [f"{text}."]
