"""The statistics of a log that matter, as a table: value, what is expected, what its twins show, p values."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from data.se2 import Array
from eval.page.numbers import number
from eval.page.tables import drop_blank_columns
from eval.referee import battery
from eval.report.trust.phrases import Terms, component, phrase
from eval.report.trust.said import STANDS_OUT
from eval.studies.trusted import Row, Trust

MOST = 18
"""Rows of a table; trust.csv has all."""
D = "dᵀ(P_f − P_s)⁻¹d"
NAMES: Mapping[str, str] = {
    "nis": "NIS per degree of freedom",
    "innovation_lag1": "correlation of innovations at lag 1",
    "filter_smoother_median": f"median of {D}",
    "filter_smoother_semidefinite": "P_f − P_s semidefinite [% of frames]",
    "filter_smoother_rms_x": "RMS of d in x [σ]",
    "filter_smoother_rms_y": "RMS of d in y [σ]",
    "filter_smoother_rms_theta": "RMS of d in heading [σ]",
    "filter_smoother_largest": "largest d of all [σ]",
    "filter_smoother_mean": f"mean of {D}",
    "filter_smoother_inside_x": "d inside ±3σ in x [% of frames]",
    "filter_smoother_inside_y": "d inside ±3σ in y [% of frames]",
    "filter_smoother_inside_theta": "d inside ±3σ in heading [% of frames]",
}
HEADLINE = 8
"""So many of `NAMES` are shown whatever they say."""
OWN = "own_smoother"
SUMMARIES = {"mean": "mean [σ]", "spread": "spread [σ]", "lag1": "correlation at lag 1", "largest": "largest [σ]"}


def statistic_words(name: str, terms: Terms) -> tuple[str, float]:
    """A statistic of trust.csv as a person reads it, with its unit, and the factor from what trust.csv has."""
    own = name.startswith(OWN)
    shared = name.replace(OWN, "filter_smoother", 1)
    if shared in NAMES:
        text = NAMES[shared]
        return (f"{text}, own final path" if own else text), (100.0 if "%" in text else 1.0)
    kind, _, rest = name.partition("_")
    if kind == "slope":
        said = phrase(rest, terms)
        return f"{said.noun} [{said.unit[0]}]", said.unit[1]
    which, _, summary = rest.rpartition("_")
    return f"residual of the {component(which, terms)}, {SUMMARIES[summary]}", 1.0


def shown(trust: Trust) -> list[Row]:
    """The rows that matter: those objected to, furthest from their twins first, then the rest of the headline ones."""
    objected = () if trust.blame is None else trust.blame.objected
    order = {key: i for i, key in enumerate(_by_distance(trust))}
    outside = sorted((r for r in trust.rows if _key(r) in objected), key=lambda r: order[_key(r)])
    rest = [r for r in trust.rows if _key(r) not in objected and (r.twins or not trust.twins)]
    always = list(NAMES)[:HEADLINE]
    if not any(r.statistic.startswith("filter_smoother") for r in trust.rows):
        always += [name.replace("filter_smoother", OWN) for name in always]
    headline = [r for r in rest if r.statistic in always]
    room = MOST - len(headline) - sum(r.statistic in always for r in outside)
    more = [r for r in outside if r.statistic not in always][: max(room, 0)]
    telling = [] if trust.twins else [r for r in rest if r not in headline and _stands_out(r)]
    kept = [r for r in outside if r.statistic in always or r in more]
    return [*kept, *headline, *telling][:MOST]


def _key(row: Row) -> tuple[str, str]:
    return row.estimator, row.statistic


def _stands_out(row: Row) -> bool:
    """Without twins: means of residuals, and slopes beyond their standard error."""
    m = row.measured
    if row.statistic.startswith("slope_"):
        return bool(m.se > 0.0 and abs(m.value) > STANDS_OUT * m.se)
    return row.statistic.startswith("residual_") and row.statistic.endswith("_mean")


def _drawn(trust: Trust, row: Row) -> Array:
    """The statistic in the twins (N,), those that have it."""
    values = [s.measured[_key(row)].value for s in trust.twins if _key(row) in s.measured]
    found = np.array([v for v in values if math.isfinite(v)], float)
    return found


def _by_distance(trust: Trust) -> list[tuple[str, str]]:
    """All statistics, furthest from their twins' median (in their spread on that side) first."""
    far = {}
    for row in trust.rows:
        drawn = _drawn(trust, row)
        own = battery.standardized(np.array([row.measured.value]), drawn[:, None])[0] if len(drawn) else np.zeros(1)
        far[_key(row)] = abs(float(own[0]))
    return sorted(far, key=lambda key: -far[key])


def trust_frame(trust: Trust, *, terms: Terms) -> pd.DataFrame:
    """The rows of `shown` to read; numbers to three digits each, as their units differ."""
    made = []
    for row in shown(trust):
        text, factor = statistic_words(row.statistic, terms)
        drawn = factor * _drawn(trust, row)
        low, middle, high = np.quantile(drawn, [0.05, 0.5, 0.95]).tolist() if len(drawn) else (math.nan,) * 3
        made.append({
            "estimator": row.estimator,
            "statistic": text,
            "value": _value(factor * row.measured.value, factor * row.measured.se),
            "expected": _text(factor * row.measured.expected),
            "twins' median": _text(middle),
            "twins, 5 to 95 %": f"{_text(low)} to {_text(high)}" if len(drawn) else None,
            "p": _text(row.p, 2),
            "family-wise p": _text(row.p_family, 2),
        })  # fmt: skip
    return drop_blank_columns(pd.DataFrame(made, dtype=object))


def _value(value: float, error: float) -> str | None:
    """A number, with its standard error to two digits and the same decimals where it has one."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0.0):
        return _text(value)
    places = max(1 - math.floor(math.log10(error)), 0)
    return f"{value:.{places}f} ± {error:.{places}f}".replace("-", "−")


def _text(value: float, digits: int = 3) -> str | None:
    return number(value, digits).replace("-", "−") if math.isfinite(value) else None
