"""Which is better on this log: paired differences between filters and smoothers, as a table and as a sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from eval.page.document import FinePrint
from eval.page.numbers import number
from eval.page.tables import drop_blank_columns, is_blank
from eval.report.rows import Row, rows_of, value_of

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
            "its 95 % interval": _interval(row, "rmse_position"),
            "p": _p(row, "rmse_position"),
            "NEES difference": row["nees_pose"],
            "95 % interval of NEES": _interval(row, "nees_pose"),
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


def _interval(row: Row, name: str) -> str | None:
    lower, upper = value_of(row, f"{name}_lower"), value_of(row, f"{name}_upper")
    return _range(lower, upper) if math.isfinite(lower) else None


def _range(lower: float, upper: float) -> str:
    """Both ends with as many decimals as the larger one needs for three digits."""
    size = max(abs(lower), abs(upper))
    places = min(max(2 - math.floor(math.log10(size)), 0), 6) if size > 0.0 else 0
    return f"{lower:.{places}f} to {upper:.{places}f}".replace("-", "−")
