"""What of a SLAM error is the frame's: one sentence with the aligned RMSE beside the plain one."""

from __future__ import annotations

import math

from eval.page.numbers import number
from eval.report.overview.facts import Facts
from eval.report.rows import Row, value_of

MOSTLY = 1.5
"""So many times the aligned RMSE, the plain one is half due to the frame in variance (1.5 squared is 2.25)."""

DIFFERENT = 0.1
"""Relative change of the ratio of filter and smoother that is worth a word."""


def gauge_statement(f: Facts) -> str:
    """The sentence; empty in localization, where the map fixes the frame, and where no error is known."""
    if f.trial.task != "slam" or f.filtered is None or f.smoothed is None:
        return ""
    (a, a_fit), (b, b_fit) = _both(f.filtered), _both(f.smoothed)
    if not all(math.isfinite(v) and v > 0.0 for v in (a, a_fit, b, b_fit)):
        return ""
    first, second = f.filtered["estimator"], f.smoothed["estimator"]
    sizes = (
        f"aligned, `{first}` has {number(a_fit)} m instead of {number(a)} m and `{second}` {number(b_fit)} m instead of"
        f" {number(b)} m"
    )
    if a <= MOSTLY * a_fit and b <= MOSTLY * b_fit:
        return f"SLAM fixes its frame at the first pose; here that makes little difference: {sizes}."
    other = abs(a_fit / b_fit / (a / b) - 1.0) > DIFFERENT
    ratio = f" (the ratio is then {number(a_fit / b_fit)}, not {number(a / b)})" if other else ""
    return (
        "SLAM fixes its frame at the first pose, and the heading error of the first seconds turns the whole path:"
        f" {sizes}{ratio}."
    )


def _both(row: Row) -> tuple[float, float]:
    return value_of(row, "rmse_position_m"), value_of(row, "rmse_aligned_m")
