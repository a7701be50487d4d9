"""Columns of a table for a paper: their keys, as `--columns` has them, short heads, and which are left out first."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from data.errors import UsageError
from eval.referee.metrics import OF_DECISIONS, OF_ESTIMATES


@dataclass(frozen=True)
class Known:
    """A column: its key, its head in a paper, and its rank (the larger, the sooner it is left out)."""

    key: str
    short: str
    rank: float


SHORT = {
    "rmse_position_m": "RMSE [m]", "nees_pose": "NEES", "nis": "NIS", "rmse_heading_deg": "heading [deg]",
    "rmse_landmark_m": "landmarks [m]", "rms_from_batch_m": "from batch [m]", "inside_3sigma": "inside 3σ [%]",
    "max_position_m": "largest [m]", "rmse_time_m": "in time [m]", "innovation_lag1": "lag-1",
    "accepted": "used", "rejected": "left out", "tp": "TP", "fp": "FP", "fn": "FN", "tn": "TN",
    "precision": "precision [%]", "recall": "recall [%]", "wrong": "wrong", "spurious": "spurious",
    "duplicate": "duplicate", "missed": "missed", "deferred": "deferred",
}  # fmt: skip
"""Heads in a paper, most wanted first; the fine print says what they mean."""
OTHERS = {
    "95 % bounds of NIS": Known("bounds", "95 % of NIS", 5.5),
    "95 % interval of the mean": Known("interval", "95 % interval", 1.0),
    "power against 0.8 P [%]": Known("power", "power [%]", 5.0),
    "mean": Known("mean", "mean", 0.0),
    "expected": Known("dof", "expected", 2.0),
    "verdict": Known("verdict", "verdict", 1.5),
    "runs": Known("runs", "runs", 3.0),
    "diverged": Known("diverged", "diverged", 6.0),
    "± SE": Known("se_ours", "± SE", 1.0),
    "± SE of it": Known("se_published", "± SE", 3.0),
}
"""By the head of the report's tables."""


def _ranked() -> dict[str, Known]:
    order = {key: float(i) for i, key in enumerate(SHORT)}
    made = {}
    for m in (*OF_ESTIMATES, *OF_DECISIONS):
        unit = f" [{m.unit}]" if m.unit else ""
        made[m.head] = Known(
            m.column, SHORT.get(m.column, f"{m.heading}{unit}"), order.get(m.column, float(len(order)))
        )
    return made | OTHERS


KNOWN: Mapping[str, Known] = _ranked()
"""By the head of the report's tables."""
KEYS = tuple(dict.fromkeys(k.key for k in KNOWN.values()))


def known(head: str, place: int) -> Known:
    """The column with this head; one that nobody ranked keeps its head, later ones are left out first."""
    return KNOWN.get(head, Known(head, head, 3.0 + 0.01 * place))


def check_columns(columns: Sequence[str]) -> None:
    """Raise UsageError for a column that no table has."""
    for name in columns:
        if name not in KEYS:
            near = difflib.get_close_matches(name, KEYS, 3)
            hint = f"; do you mean {' or '.join(near)}?" if near else ""
            raise UsageError(f"--columns {name}: no column of metrics.csv, association.csv or consistency.csv{hint}")
