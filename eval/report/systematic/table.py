"""Systematic errors as a table: what was known before, what filter and smoothers make of each, and which are told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from data.inputs import ERRORS, Systematic
from data.result import Run, Systematics
from data.truth import Truth
from eval.page.numbers import number
from eval.replay.names import BATCH

UNTOLD = 0.9
"""Share of the prior's sigma that is left of an error that the log cannot tell: data then have less to say of it than a
quarter of what was known before (1/0.9² - 1)."""


def told(systematic: Systematic, errors: Systematics) -> tuple[bool, ...]:
    """Of each error (p,), whether data say more of it than was known before; of the drift in the middle of the run."""
    left = np.median(errors.sigma, axis=0) / systematic.sigma
    return tuple((left <= UNTOLD).tolist())


def best(runs: Sequence[Run]) -> Run | None:
    """The run whose word on the errors counts: batch's, else that of another smoother, else the first filter's."""
    there = [r for r in runs if r.errors is not None]
    there.sort(key=lambda r: (r.estimator != "batch", r.errors_final is None, r.estimator not in BATCH))
    return there[0] if there else None


def errors_table(systematic: Systematic, runs: Sequence[Run], truth: Truth) -> pd.DataFrame:
    """A row for each error: unit, sigma before, each run's last estimate ± sigma, the true value, told or not.

    The drift's are those at the last frame.
    """
    judge = best(runs)
    said = None if judge is None else judge.errors
    rows = []
    for i, name in enumerate(systematic.names):
        row: dict[str, object] = {
            "error": name,
            "unit": "" if ERRORS[name] == "1" else ERRORS[name],
            "known before": f"0 ± {number(float(systematic.sigma[i]), 2)}",
        }
        for run in runs:
            errors = run.errors
            if errors is not None:
                row[_head(run)] = with_sigma(float(errors.mean[-1, i]), float(errors.sigma[-1, i]))
        if truth.errors is not None:
            row["true"] = _true(name, truth.errors)
        if said is not None:
            row["told"] = "yes" if told(systematic, said)[i] else "the log cannot tell it"
        rows.append(row)
    return pd.DataFrame(rows)


def _true(name: str, errors: Systematics) -> str:
    """The true error at the last frame; zero where the world has none."""
    value = float(errors.mean[-1, errors.names.index(name)]) if name in errors.names else 0.0
    return number(value).replace("-", "−")


def _head(run: Run) -> str:
    return f"{run.estimator} ({'final' if run.errors_final is not None else 'online'})"


def with_sigma(value: float, sigma: float) -> str:
    """An estimate with its standard deviation to two digits, both to the same decimals."""
    if not (np.isfinite(sigma) and sigma > 0.0):
        return number(value, 3)
    places = max(1 - int(np.floor(np.log10(sigma))), 0)
    return f"{value:.{places}f} ± {sigma:.{places}f}".replace("-", "−")
