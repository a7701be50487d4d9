"""The tables of the report, made from the rows of metrics.csv, association.csv and consistency.csv."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from eval.referee.consistency import MARKS
from eval.referee.result_files import OF_DECISIONS, RUN, Row, heads, is_blank, is_share, metric, rows_of, value_of
from eval.report.page.blocks import Table
from eval.report.page.files import HEADS, drop_blank_columns, interval, number
from eval.report.words import paragraph

NAMES = (*RUN, "status")
ERRORS = (
    "rmse_position_m", "rmse_aligned_m", "rmse_time_m", "rmse_heading_deg", "max_position_m", "rmse_landmark_m",
    "rms_from_batch_m",
)  # fmt: skip
COMPARISON: dict[str, str] = {
    **heads((*NAMES, *ERRORS, "nees_pose", "nis", "nis_expected")),
    "bounds": "95 % bounds of NIS",
    **heads(("innovation_lag1", "inside_3sigma", "accepted", "rejected", "matched", "unmatched")),
}  # fmt: skip
"""Column of metrics.csv (or made here) and its head in the comparison table, in order."""

SUMMARY = (
    "rmse_position_m", "rmse_aligned_m", "rmse_heading_deg", "rms_from_batch_m", "nees_pose", "nis", "nis_expected",
    "fp", "fn",
)  # fmt: skip
"""Columns of metrics.csv and association.csv in the report's own table of a log."""

ASSOCIATION: Mapping[str, str] = {
    **heads(("log", "task", "association", "estimator", "phase")),
    **heads([m.column for m in OF_DECISIONS if m.column not in ("share_within", "within_m", "majority_agreement")]),
}

CONSISTENCY: Mapping[str, str] = HEADS["consistency"]

PUBLISHED: Mapping[str, str] = HEADS["published"]

OUTLIERS: Mapping[str, str] = {
    "task": "task", "percent": "wrong labels [%]", "estimator": "estimator", **heads(("rmse_position_m",)),
    "rmse": "95 % interval of the RMSE", **heads(("nees_pose",)), "nees": "95 % interval of the NEES",
    "diverged": "diverged",
}  # fmt: skip

TableRow = dict[str, object]
UNGATED = 0.995  # least expected NIS that is shown as 1
CLOSE = 0.1  # a mean that is closer to zero is a correlation, written with four decimals
SAME = 0.05  # relative difference below which two columns say the same


def selected(frame: pd.DataFrame, heads: Mapping[str, str]) -> pd.DataFrame:
    """Columns by their human heads, shares in percent; `log` and `task` only where they differ, blank ones dropped."""
    frame = frame.assign(**{c: _percent(frame[c]) for c in frame.columns if is_share(c)})
    keep = [c for c in heads if c in frame.columns]
    for same in ("log", "task", "scenario"):
        if same in keep and frame[same].nunique(dropna=False) <= 1:
            keep.remove(same)
    return drop_blank_columns(frame[keep]).rename(columns=dict(heads)).reset_index(drop=True)


def _cells(cell: Callable[..., object], *columns: pd.Series) -> pd.Series:
    """A column of cells, each made of a row of some columns; blank where one of these is blank."""
    rows = zip(*(c.tolist() for c in columns), strict=True)
    cells = [None if any(map(is_blank, row)) else cell(*row) for row in rows]
    return pd.Series(cells, index=columns[0].index, dtype=object)


def _percent(column: pd.Series) -> pd.Series:
    return _cells(lambda share: 100.0 * float(share), column)


def _interval(lower: pd.Series, upper: pd.Series) -> pd.Series:
    def text(low: float, high: float) -> str:
        digits = 3 if high - low < 0.1 else 2
        return f"{low:.{digits}f}–{high:.{digits}f}"

    return _cells(text, lower, upper)


def comparison_table(metrics: pd.DataFrame, more: Sequence[str] = (), *, aligned: bool = False) -> pd.DataFrame:
    """Rows of metrics.csv as a table to read, without columns that say nothing. `more`: columns that are shown as well.
    `aligned`: in SLAM with the aligned RMSE. Runs whose numbers are in no comparison come last.
    """
    metrics = _ok_first(metrics)
    form = metric("innovation_lag1").form
    correlation = (metrics[c] for c in ("innovation_lag1", "innovation_lag1_se"))
    lag1 = _cells(lambda v, e: f"{float(v):{form}} ± {float(e):{form}}", *correlation)
    bounds = _interval(metrics["nis_lower"], metrics["nis_upper"])
    made = metrics.astype(object).assign(bounds=bounds, innovation_lag1=lag1)
    shown = [c for c in COMPARISON if c in made.columns]
    if (made["status"] == "ok").all():
        shown.remove("status")
    if not aligned or not (made["task"] == "slam").any():
        shown.remove("rmse_aligned_m")
    of_time, of_frames = (pd.to_numeric(made[c]) for c in ("rmse_time_m", "rmse_position_m"))
    if np.allclose(of_time, of_frames, rtol=SAME, atol=0.0, equal_nan=True):
        shown.remove("rmse_time_m")
    also = [c for c in more if c in metrics.columns and c not in shown]
    return selected(*_expecting(made[[*shown, *also]], COMPARISON | heads(also)))


def _ok_first(metrics: pd.DataFrame) -> pd.DataFrame:
    return metrics.sort_values("status", key=lambda status: status != "ok", kind="stable")


def _expecting(made: pd.DataFrame, heads: dict[str, str]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Columns and heads; what is expected of NIS has its own column behind a gate, where it is less than 1."""
    if all(is_blank(v) or float(v) > UNGATED for v in made["nis_expected"].tolist()):
        return made.drop(columns="nis_expected"), heads
    return made, heads | {"nis": "NIS per dof", "nis_expected": COMPARISON["nis_expected"]}


def summary_table(metrics: pd.DataFrame, association: pd.DataFrame) -> pd.DataFrame:
    """The columns that matter most, with the wrong decisions of each run and phase."""
    keys = list(RUN)
    made = _ok_first(metrics).astype(object).merge(association.astype(object)[[*keys, "fp", "fn"]], how="left", on=keys)
    shown = [*NAMES, *SUMMARY]
    if (made["status"] == "ok").all():
        shown.remove("status")
    if not (made["task"] == "slam").any():
        shown.remove("rmse_aligned_m")
    if not all(is_blank(v) for v in made["rmse_position_m"].tolist()):
        shown.remove("rms_from_batch_m")
    return selected(*_expecting(made[shown], heads(shown)))


def parts(table: Table) -> list[Table]:
    """A comparison table as two that fit a page: errors, and consistency."""
    names, errors = ([c for c in table.frame.columns if c in heads(of).values()] for of in (NAMES, ERRORS))
    rest = [c for c in table.frame.columns if c not in (*names, *errors)]
    return [
        replace(table, frame=table.frame[[*names, *columns]], caption=caption)
        for columns, caption in ((errors, table.caption), (rest, paragraph("comparison#consistency_of_one_log")))
        if columns
    ]


def association_table(association: pd.DataFrame) -> pd.DataFrame:
    """Rows of association.csv to read; estimators with equal outcomes share a row; phases only where they differ."""
    outcomes = [c for c in association.columns if c not in ("log", "task", "estimator", "association", "phase")]

    def counted(row: Row) -> tuple[object, ...]:
        return tuple(None if is_blank(row[c]) else row[c] for c in outcomes)

    runs: dict[tuple[object, ...], list[Row]] = {}
    for row in rows_of(association.astype(object)):
        runs.setdefault((row["log"], row["task"], row["association"], row["estimator"]), []).append(row)
    shared: dict[tuple[object, ...], list[list[Row]]] = {}
    for key, phases in runs.items():
        shared.setdefault((*key[:3], *map(counted, phases)), []).append(phases)
    kept: list[TableRow] = []
    for group in shared.values():
        estimators = ", ".join(str(phases[0]["estimator"]) for phases in group)
        online, *later = group[0]
        differing = [online, *(r for r in later if counted(r) != counted(online))]
        kept += [{**row, "estimator": estimators} for row in differing]
    made = pd.DataFrame(kept, columns=list(association.columns), dtype=object)
    if made["phase"].nunique() <= 1:
        made = made.drop(columns="phase")
    if all(is_blank(v) or v == 0 for v in made["deferred"].tolist()):
        made = made.drop(columns="deferred")
    return selected(made, ASSOCIATION)


def consistency_table(consistency: pd.DataFrame) -> pd.DataFrame:
    """Rows of consistency.csv as a table to read."""
    made = consistency.astype(object).assign(
        interval=_interval(consistency["lower"], consistency["upper"]), power_percent=_percent(consistency["power"])
    )
    return selected(made, CONSISTENCY)


def _by_run(consistency: pd.DataFrame, cell: Callable[[TableRow], tuple[str, str]]) -> pd.DataFrame:
    """A row for each estimator and phase, a column for each quantity; `cell`: head and text of one of its rows."""
    names = ("task", "estimator", "association", "phase")
    rows: dict[tuple[str, ...], TableRow] = {}
    for r in rows_of(consistency.astype(object)):
        key = tuple(str(r[c]) for c in names)
        (head, text), word = cell(r), str(r["verdict"])
        mark = f" ({MARKS[word]})" if word in MARKS else ""
        rows.setdefault(key, dict(zip(names, key, strict=True)))[head] = text + mark
    made = pd.DataFrame(list(rows.values()), dtype=object)
    return made[[c for c in made.columns if c not in ("task", "association") or made[c].nunique() > 1]]


def coverage_table(coverage: pd.DataFrame) -> pd.DataFrame:
    """The coverage rows of consistency.csv, a row for each estimator and a column for each level."""

    def cell(r: TableRow) -> tuple[str, str]:
        share, low, high = (math.nan if is_blank(r[c]) else 100.0 * float(r[c]) for c in ("mean", "lower", "upper"))  # type: ignore[arg-type]
        return f"{str(r['quantity']).removeprefix('coverage_')} %", f"{share:.0f} [{low:.0f}, {high:.0f}]"

    return _by_run(coverage, cell)


def verdicts_table(consistency: pd.DataFrame) -> pd.DataFrame:
    """The means of consistency.csv, a row for each estimator and a column for each quantity with what is expected."""

    def cell(r: TableRow) -> tuple[str, str]:
        mean = value_of(r, "mean")
        text = number(mean) if abs(mean) > CLOSE else f"{mean:.4f}"
        return f"{r['quantity']} ({value_of(r, 'dof'):g})", text.replace("-", "−")

    return _by_run(consistency, cell)


def outliers_table(outliers: pd.DataFrame) -> pd.DataFrame:
    """The outlier study as a table to read."""
    rmse, nees = (_interval(outliers[f"{of}_lower"], outliers[f"{of}_upper"]) for of in ("rmse", "nees"))
    made = outliers.astype(object).assign(percent=_percent(outliers["rate"]), rmse=rmse, nees=nees)
    if not outliers["diverged"].any():
        made = made.drop(columns="diverged")
    return selected(made, OUTLIERS)


def differences_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of `Scores.differences` for one log and task as a table to read; association only where several are."""
    made = []
    for row in rows_of(rows):
        values = {c: value_of(row, c) for c in ("rmse_position_p", "nees_pose_p")}
        p = {c: f"{v:.3f}" if math.isfinite(v) else None for c, v in values.items()}
        made.append({
            "association": row["association"], "filter": row["a"], "smoother": row["b"],
            ("aligned " if row["task"] == "slam" else "") + "RMSE difference [m]": row["rmse_position_m"],
            "its 95 % interval": _row_interval(row, "rmse_position"),
            "p": p["rmse_position_p"],
            "NEES difference": row["nees_pose"],
            "95 % interval of NEES": _row_interval(row, "nees_pose"),
            "p of NEES": p["nees_pose_p"],
            "mean block [frames]": row["block_frames"] if any(p.values()) else None,
        })  # fmt: skip
    table = pd.DataFrame(made, dtype=object)
    if table["association"].nunique() <= 1:
        table = table.drop(columns="association")
    return drop_blank_columns(table)


def _row_interval(row: Row, name: str) -> str | None:
    """An interval, or why there is none."""
    lower, upper, why = value_of(row, f"{name}_lower"), value_of(row, f"{name}_upper"), row[f"{name}_why"]
    return interval(lower, upper) if math.isfinite(lower) else None if is_blank(why) else f"none: {why}"
