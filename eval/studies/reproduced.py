"""Our numbers against published ones: the rows of published.csv."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data.terminal import in_columns
from eval.referee.result_files import PUBLISHED
from eval.studies.montecarlo import Study

SQUARES = {"rmse_position_m": ("position", 1.0), "rmse_heading_deg": ("heading", 180.0 / np.pi)}


@dataclass(frozen=True)
class Estimate:
    """Our number with its standard error, from `runs` independent runs."""

    value: float
    se: float
    runs: int


def mean_of(values: Sequence[float]) -> Estimate:
    """Mean and its standard error."""
    x = np.asarray(values, float)
    return Estimate(float(x.mean()), float(x.std(ddof=1) / math.sqrt(len(x))) if len(x) > 1 else math.nan, len(x))


def rms_of(squares: Sequence[float], scale: float = 1.0) -> Estimate:
    """Pooled root mean square of each run's mean squared error; standard error to first order."""
    m = mean_of(squares)
    root = math.sqrt(m.value)
    return Estimate(scale * root, scale * m.se / (2.0 * root) if root > 0 else math.nan, m.runs)


def difference(ours: Estimate, published: float, se_published: float) -> float:
    """Difference in standard errors of the difference."""
    spread = math.hypot(ours.se, se_published)
    return (ours.value - published) / spread if spread > 0 else math.nan


def published_rows(study: Study) -> list[Mapping[str, object]]:
    """Rows of published.csv for every published number of a study's scenario whose estimator ran."""
    p, rows = study.scenario.published, list[Mapping[str, object]]()
    for row in () if p is None else p.rows:
        if (ours := ours_of(study, row.estimator, row.quantity)) is not None:
            who, off = (study.scenario.name, row.estimator, row.quantity), difference(ours, row.value, row.se)
            values = *who, ours.value, ours.se, row.value, row.se or math.nan, off
            rows.append(dict(zip(PUBLISHED.names, values, strict=True)))
    return rows


def ours_of(study: Study, estimator: str, quantity: str) -> Estimate | None:
    """Our value (filters online) and standard error; None: the estimator has no complete run."""
    found = [k for k in study.samples if k[1] == estimator]
    key = next((k for k in found if k[3] == "online"), found[0] if found else None)
    good = [] if key is None else study.good(key)
    if not good:
        return None
    if quantity in SQUARES:
        name, scale = SQUARES[quantity]
        return rms_of([s.squares[name] for s in good], scale)
    return mean_of([s.published[quantity.removeprefix("nees_")] for s in good])


def lines(rows: Sequence[Mapping[str, object]]) -> list[str]:
    """The rows as terminal text: ours, published, difference in standard errors."""
    if not rows:
        return []
    table = [("scenario", "estimator", "quantity", "ours", "published", "difference [SE]")]
    for r in rows:
        who = str(r["scenario"]), str(r["estimator"]), str(r["quantity"])
        both = _pair(r["ours"], r["se_ours"]), _pair(r["published"], r["se_published"])
        table.append((*who, *both, f"{float(str(r['difference_in_se'])):+.2f}"))
    return in_columns(table)


def _pair(value: object, se: object) -> str:
    v, s = float(str(value)), float(str(se))
    return f"{v:.4g} ± {s:.2g}" if np.isfinite(s) else f"{v:.6g}"
