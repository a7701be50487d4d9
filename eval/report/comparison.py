"""The tables of the report, made from the rows of metrics.csv, association.csv and consistency.csv, for reading.

Which is better on this log: paired differences between filters and smoothers, as a table and as a sentence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pandas as pd

from eval.referee.metrics import OF_DECISIONS, RUN, heads, is_share, metric
from eval.report.page.document import FinePrint
from eval.report.page.tables import drop_blank_columns, is_blank, number
from eval.report.rows import Row, rows_of, value_of

COMPARISON: dict[str, str] = {
    **heads((*RUN, "status")),
    **heads((
        "rmse_position_m", "rmse_aligned_m", "rmse_time_m", "rmse_heading_deg", "max_position_m", "rmse_landmark_m",
        "rms_from_batch_m", "nees_pose", "nis",
    )),
    "rmse_aligned_m": "aligned position RMSE [m]",
    "bounds": "95 % bounds of NIS",
    **heads(("innovation_lag1", "inside_3sigma", "accepted", "rejected", "matched", "unmatched")),
}  # fmt: skip
"""Column of metrics.csv (or made here) and its head in the comparison table, in order."""

ASSOCIATION: Mapping[str, str] = {
    **heads(("log", "task", "association", "estimator", "phase")),
    **heads([m.column for m in OF_DECISIONS if m.column not in ("share_within", "within_m", "majority_agreement")]),
}

CONSISTENCY: Mapping[str, str] = {
    "scenario": "scenario",
    "task": "task",
    "estimator": "estimator",
    "association": "association",
    "phase": "phase",
    "quantity": "quantity",
    "dof": "expected",
    "mean": "mean",
    "interval": "95 % interval of the mean",
    "verdict": "verdict",
    "runs": "runs",
    "power_percent": "power against 0.8 P [%]",
    "diverged": "diverged",
}

PUBLISHED: Mapping[str, str] = {
    "scenario": "scenario",
    "estimator": "estimator",
    "quantity": "quantity",
    "ours": "ours",
    "se_ours": "± SE",
    "published": "published",
    "se_published": "± SE of it",
    "difference_in_se": "difference [SE]",
}

OUTLIERS: Mapping[str, str] = {
    "task": "task",
    "percent": "wrong labels [%]",
    "estimator": "estimator",
    **heads(("rmse_position_m",)),
    "rmse": "95 % interval of the RMSE",
    **heads(("nees_pose",)),
    "nees": "95 % interval of the NEES",
    "diverged": "diverged",
}

COMPARISON_CAPTION = (
    "Errors in the world frame, no alignment, all with the same prior and inputs. Online: each pose given the data up"
    " to its frame; final: given all data."
)
COMPARISON_FINE = FinePrint(
    "Errors and consistency of one log",
    "Phase online: each pose given the data up to its frame; final: every pose given all data, so a final row is"
    " expected to be the more accurate one. The aligned RMSE is after the rigid motion that fits the true path best:"
    " SLAM fixes its frame at the first pose, so what the heading errs in the first seconds turns the whole map and"
    " path, and that part of the error is the gauge's, not the estimator's. NEES of one run describes and proves"
    " nothing; NIS per dof against its 95 % bounds (behind a gate less than 1 is expected, and the bounds are lower),"
    " and the correlation of a landmark's innovations in successive frames against 0, are tests, conditional on the"
    " association. Blank: unknown or not applicable. A status is shown where some run did not get to the end or is"
    " implausible, a time-weighted RMSE where it differs from the plain one by more than 5 %.",
)
ASSOCIATION_FINE = FinePrint(
    "Decisions",
    "Outcomes of every observation's decision H against the truth GT. TP: H is a landmark and right; TN: both none;"
    " FP: H is a wrong landmark (GT another: wrong; GT none: spurious); FN: H none though GT is in the map (a second"
    " landmark initialized: duplicate; discarded: missed or deferred). Estimators with the same outcomes share a row; a"
    " row for the final phase stands only where revised decisions turned out differently.",
)
CONSISTENCY_CAPTION = (
    "Mean NEES (NIS per dof for the quantity nis) over independent simulated runs, with Student's t 95 % interval."
)
CONSISTENCY_FINE = FinePrint(
    "Consistency over simulated runs",
    "Mean over independent simulated runs of each run's mean NEES (NIS per dof for the quantity nis), with Student's t"
    " 95 % interval of that mean. Consistent: the interval holds the expected value;"
    " overconfident: wholly above; conservative: wholly below. Power: probability that this test, with as many runs and"
    " this spread, rejects a covariance claimed at 0.8 of the true one. Whiteness: correlation of a landmark's"
    " innovations in successive frames, expected 0; a covariance scaled as a whole leaves it 0, so it has no power"
    " against that. NIS and whiteness of an estimator that decides for itself are conditional on its decisions.",
)
COVERAGE_CAPTION = "Share of the runs [%] whose last position lies inside the estimator's own ellipse of each level."
COVERAGE_FINE = FinePrint(
    "Coverage",
    "Share of the runs [%] whose last position lies inside the estimator's own ellipse of each level, with"
    " Clopper–Pearson 95 % bounds; marked where the level lies outside them (o: too few inside, overconfident;"
    " c: too many, conservative).",
)
PUBLISHED_CAPTION = (
    "Our numbers beside published ones, with standard errors of the Monte Carlo means (of the difference: root of the"
    " sum of their squares). A difference within ±3 is chance. For a replay of a stored run it is the largest relative"
    " difference of any step over the tolerance, so below 1 is agreement."
)


TableRow = dict[str, object]
SAME = 0.05
"""Relative difference below which two columns say the same."""


def _selected(frame: pd.DataFrame, heads: Mapping[str, str]) -> pd.DataFrame:
    """Columns by their human heads, shares in percent; `log` and `task` only where they differ, blank ones dropped."""
    frame = frame.assign(**{c: _percent(frame[c]) for c in frame.columns if is_share(c)})
    keep = [c for c in heads if c in frame.columns]
    for same in ("log", "task", "scenario"):
        if same in keep and frame[same].nunique(dropna=False) <= 1:
            keep.remove(same)
    return drop_blank_columns(frame[keep]).rename(columns=dict(heads)).reset_index(drop=True)


def _percent(column: pd.Series) -> pd.Series:
    shares = [None if is_blank(v) else 100.0 * float(v) for v in column.tolist()]
    return pd.Series(shares, index=column.index, dtype=object)


def _interval(lower: pd.Series, upper: pd.Series) -> pd.Series:
    texts: list[str | None] = []
    for low, high in zip(lower.tolist(), upper.tolist(), strict=True):
        if is_blank(low) or is_blank(high):
            texts.append(None)
        else:
            digits = 3 if high - low < 0.1 else 2
            texts.append(f"{low:.{digits}f}–{high:.{digits}f}")
    return pd.Series(texts, index=lower.index, dtype=object)


def _spread(values: pd.Series, errors: pd.Series) -> pd.Series:
    form = metric(str(values.name)).form
    texts = [
        None if is_blank(v) or is_blank(e) else f"{float(v):{form}} ± {float(e):{form}}"
        for v, e in zip(values.tolist(), errors.tolist(), strict=True)
    ]
    return pd.Series(texts, index=values.index, dtype=object)


def comparison_table(metrics: pd.DataFrame, more: Sequence[str] = (), *, aligned: bool = False) -> pd.DataFrame:
    """Rows of metrics.csv as a table to read: heads with units, shares in percent, columns without anything dropped.

    `more`: columns of metrics.csv that are shown as well, whatever they hold. Without news are also a status that is
    `ok` everywhere and a time-weighted RMSE that is the plain one in every row. `aligned`: in SLAM, where the frame is
    the first pose's, the aligned RMSE stands beside the plain one.
    """
    made = metrics.astype(object).assign(
        bounds=_interval(metrics["nis_lower"], metrics["nis_upper"]),
        innovation_lag1=_spread(metrics["innovation_lag1"], metrics["innovation_lag1_se"]),
    )
    shown = [c for c in COMPARISON if c in made.columns]
    if (made["status"] == "ok").all():
        shown.remove("status")
    if not aligned or not (made["task"] == "slam").any():
        shown.remove("rmse_aligned_m")
    if _same(made["rmse_time_m"], made["rmse_position_m"]):
        shown.remove("rmse_time_m")
    also = [c for c in more if c in metrics.columns and c not in shown]
    return _selected(made[[*shown, *also]], COMPARISON | heads(also))


def _same(values: pd.Series, others: pd.Series) -> bool:
    """Whether two columns say the same in every row."""
    pairs = zip(values.tolist(), others.tolist(), strict=True)
    return all(
        is_blank(a) == is_blank(b) and (is_blank(a) or abs(float(a) - float(b)) <= SAME * abs(float(b)))
        for a, b in pairs
    )


def association_table(association: pd.DataFrame) -> pd.DataFrame:
    """Rows of association.csv as a table to read; estimators with the same outcomes share a row.

    The final phase has rows only where something was revised, and the phase is named only then.
    """
    rows = [{str(k): v for k, v in r.items()} for r in association.astype(object).to_dict("records")]
    outcomes = [c for c in association.columns if c not in ("log", "task", "estimator", "association", "phase")]

    def counted(row: TableRow) -> tuple[object, ...]:
        return tuple(None if is_blank(row[c]) else row[c] for c in outcomes)

    runs: dict[tuple[object, ...], list[TableRow]] = {}
    for row in rows:
        runs.setdefault((row["log"], row["task"], row["association"], row["estimator"]), []).append(row)
    shared: dict[tuple[object, ...], list[list[TableRow]]] = {}
    for key, phases in runs.items():
        shared.setdefault((*key[:3], *(counted(r) for r in phases)), []).append(phases)
    kept: list[TableRow] = []
    for group in shared.values():
        estimators = ", ".join(str(phases[0]["estimator"]) for phases in group)
        online, *later = group[0]
        for row in [online, *(r for r in later if counted(r) != counted(online))]:
            kept.append(row | {"estimator": estimators})
    made = pd.DataFrame(kept, columns=list(association.columns), dtype=object)
    if made["phase"].nunique() <= 1:
        made = made.drop(columns="phase")
    if all(is_blank(v) or v == 0 for v in made["deferred"].tolist()):
        made = made.drop(columns="deferred")
    return _selected(made, ASSOCIATION)


def consistency_table(consistency: pd.DataFrame) -> pd.DataFrame:
    """Rows of consistency.csv as a table to read."""
    made = consistency.astype(object).assign(
        interval=_interval(consistency["lower"], consistency["upper"]), power_percent=_percent(consistency["power"])
    )
    return _selected(made, CONSISTENCY)


def coverage_table(coverage: pd.DataFrame) -> pd.DataFrame:
    """The coverage rows of consistency.csv, a row for each estimator and a column for each level."""
    marks = {"overconfident": " (o)", "conservative": " (c)"}
    names = ("task", "estimator", "association", "phase")
    rows: dict[tuple[str, ...], TableRow] = {}
    for r in coverage.astype(object).to_dict("records"):
        key = tuple(str(r[c]) for c in names)
        row = rows.setdefault(key, dict(zip(names, key, strict=True)))
        share, low, high = (math.nan if is_blank(r[c]) else 100.0 * float(r[c]) for c in ("mean", "lower", "upper"))
        head = f"{str(r['quantity']).removeprefix('coverage_')} %"
        row[head] = f"{share:.0f} [{low:.0f}, {high:.0f}]{marks.get(str(r['verdict']), '')}"
    made = pd.DataFrame(list(rows.values()), dtype=object)
    return made[[c for c in made.columns if c not in ("task", "association") or made[c].nunique() > 1]]


def published_table(published: pd.DataFrame) -> pd.DataFrame:
    """published.csv as a table to read."""
    return _selected(published.astype(object), PUBLISHED)


def outliers_table(outliers: pd.DataFrame) -> pd.DataFrame:
    """The outlier study as a table to read."""
    made = outliers.astype(object).assign(
        percent=_percent(outliers["rate"]),
        rmse=_interval(outliers["rmse_lower"], outliers["rmse_upper"]),
        nees=_interval(outliers["nees_lower"], outliers["nees_upper"]),
    )
    if not outliers["diverged"].any():
        made = made.drop(columns="diverged")
    return _selected(made, OUTLIERS)


CHANCE = 0.05
"""A larger p is called chance, and so is a difference whose interval holds zero: near the edge the two may differ."""
CAPTION = "Which is better on this log: filter (online) minus smoother (final), on the same frames."
FINE = FinePrint(
    "Filters against smoothers",
    "RMSE difference positive: the smoother is closer to the truth. Intervals and p of no difference: stationary"
    " bootstrap with blocks of the mean length given. They are about stretches of this log and not about other logs: in"
    " SLAM what the whole map errs is not in them. The fewer blocks, the more they are too narrow (coverage:"
    " docs/verdicts.md). Blank: the log is worth too few independent frames.",
)


def differences_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of `Scores.differences` for one log and task as a table to read; association only where several are."""
    made = []
    for row in rows_of(rows):
        none = is_blank(row["rmse_position_p"]) and is_blank(row["nees_pose_p"])
        made.append({
            "association": row["association"],
            "filter": row["a"],
            "smoother": row["b"],
            "RMSE difference [m]": row["rmse_position_m"],
            "its 95 % interval": _row_interval(row, "rmse_position"),
            "p": _p(row, "rmse_position"),
            "NEES difference": row["nees_pose"],
            "95 % interval of NEES": _row_interval(row, "nees_pose"),
            "p of NEES": _p(row, "nees_pose"),
            "mean block [frames]": None if none else row["block_frames"],
        })  # fmt: skip
    table = pd.DataFrame(made, dtype=object)
    if table["association"].nunique() <= 1:
        table = table.drop(columns="association")
    return drop_blank_columns(table)


def missing_intervals(rows: pd.DataFrame) -> str:
    """Why intervals are missing from the table, a sentence for each reason; empty if none is."""
    whys: dict[tuple[str, str], list[str]] = {}
    several = rows["association"].nunique() > 1
    for row in rows_of(rows):
        pair = f"{row['a']} and {row['b']}" + (f" ({row['association']})" if several else "")
        for name, what in (("rmse_position", "RMSE"), ("nees_pose", "NEES")):
            if not is_blank(row[f"{name}_why"]):
                whys.setdefault((what, str(row[f"{name}_why"])), []).append(pair)
    return "\n".join(f"* {what} of {', '.join(pairs)}: no interval; {why}." for (what, why), pairs in whys.items())


def difference_sentence(differences: Sequence[Row], filtered: Row, smoothed: Row) -> str:
    """Filter and smoother of two rows of metrics.csv in one sentence; empty if their difference was not taken."""
    for row in differences:
        if (row["a"], row["b"], row["association"]) == (
            filtered["estimator"],
            smoothed["estimator"],
            filtered["association"],
        ):
            return _sentence(row)
    return ""


def _sentence(row: Row) -> str:
    difference, lower, upper, p = (
        value_of(row, c) for c in ("rmse_position_m", "rmse_position_lower", "rmse_position_upper", "rmse_position_p")
    )
    if not math.isfinite(p):
        return f"Whether the difference is chance this log cannot tell: {row['rmse_position_why']}."
    word = "lower" if difference >= 0.0 else "higher"
    if difference < 0.0:
        difference, lower, upper = -difference, -upper, -lower
    chance = ", so it may be chance" if p > CHANCE or lower <= 0.0 <= upper else ""
    whole = ", and another log's map would err otherwise" if row["task"] == "slam" else ""
    return (
        f"The smoother's RMSE is {word} by {number(difference)} m, 95 % interval {_range(lower, upper)} m, p = {p:.3f};"
        f" one log, errors correlated over about {value_of(row, 'block_frames'):.0f} frames{whole}{chance}."
    )


def _p(row: Row, name: str) -> str | None:
    p = value_of(row, f"{name}_p")
    return f"{p:.3f}" if math.isfinite(p) else None


def _row_interval(row: Row, name: str) -> str | None:
    lower, upper = value_of(row, f"{name}_lower"), value_of(row, f"{name}_upper")
    return _range(lower, upper) if math.isfinite(lower) else None


def _range(lower: float, upper: float) -> str:
    """Both ends with as many decimals as the larger one needs for three digits."""
    size = max(abs(lower), abs(upper))
    places = min(max(2 - math.floor(math.log10(size)), 0), 6) if size > 0.0 else 0
    return f"{lower:.{places}f} to {upper:.{places}f}".replace("-", "−")
