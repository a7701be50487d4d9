"""The report's sections "Trust without ground truth": words, table of statistics and figure of a log and task."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from data.notice import Code
from data.se2 import Array
from eval.plan.flags.table import Output
from eval.referee import battery
from eval.referee.score import Trial
from eval.report.page.blocks import Block, FinePrint, Picture, Section, folded
from eval.report.page.files import written_table
from eval.report.page.tables import drop_blank_columns, number
from eval.report.pictures import FILTER_SMOOTHER
from eval.report.rows import stem
from eval.report.shown_runs import associations
from eval.report.trust_facts import STANDS_OUT, Terms, facts_of, online, terms_of
from eval.report.words import plus_minus, say
from eval.studies.trusted import Row, Trust

MOST = 18  # rows of a table; trust.csv has all
HEADLINE = (
    "nis",
    "innovation_lag1",
    *(f"filter_smoother_{what}" for what in ("median", "semidefinite", "rms_x", "rms_y", "rms_theta", "largest")),
)  # statistics that are shown whatever they say
SHARES = ("semidefinite", "inside_x", "inside_y", "inside_theta")
"""How statistics end that are shares of the frames, shown in percent."""
OWN = "own_smoother"
HEADING = "Trust without ground truth"
FINE = FinePrint(
    "Consistency without ground truth",
    "P_f and P_s are the covariances of the online and of the smoothed pose, d is their difference. All statistics:"
    " trust.csv; definitions: docs/verdicts.md.",
)
MORE = "More of the diagnosis"


def first_words(trust: Trust, *, terms: Terms, measured: bool = False) -> str:
    """Two to four sentences, two if errors against the truth are known (`measured`); empty without a diagnosis."""
    return say("trust#first", trust=facts_of(trust, terms), measured=measured)


def statistic_words(name: str, terms: Terms) -> tuple[str, float]:
    """A statistic of trust.csv as a person reads it, with its unit, and the factor from what trust.csv has."""
    unit, factor = terms.unit(name.removeprefix("slope_")) if name.startswith("slope_") else ("", 1.0)
    return say("effects#statistic", name=name, unit=unit, terms=terms), 100.0 if name.endswith(SHARES) else factor


def shown(trust: Trust) -> list[Row]:
    """The rows of the table: rejected statistics, the furthest first, then the other headline ones."""
    objected = () if trust.blame is None else trust.blame.objected
    outside = sorted((r for r in trust.rows if _key(r) in objected), key=lambda r: -_distance(trust, r))
    rest = [r for r in trust.rows if _key(r) not in objected and (r.twins or not trust.twins)]
    always = list(HEADLINE)
    if not any(r.statistic.startswith("filter_smoother") for r in trust.rows):
        always += [name.replace("filter_smoother", OWN) for name in HEADLINE]
    headline = [r for r in rest if r.statistic in always]
    room = MOST - len(headline) - sum(r.statistic in always for r in outside)
    more = [r for r in outside if r.statistic not in always][: max(room, 0)]
    telling = [] if trust.twins else [r for r in rest if r not in headline and _stands_out(r)]
    kept = [r for r in outside if r.statistic in always or r in more]
    return [*kept, *headline, *telling][:MOST]


def _key(row: Row) -> tuple[str, str]:
    return row.estimator, row.statistic


def _stands_out(row: Row) -> bool:
    """Without replicates: means of residuals, and slopes beyond their standard error."""
    m = row.measured
    if row.statistic.startswith("slope_"):
        return bool(m.se > 0.0 and abs(m.value) > STANDS_OUT * m.se)
    return row.statistic.startswith("residual_") and row.statistic.endswith("_mean")


def _drawn(trust: Trust, row: Row) -> Array:
    """The statistic in the bootstrap replicates that have it (N,)."""
    values = [s.measured[_key(row)].value for s in trust.twins if _key(row) in s.measured]
    return np.array([v for v in values if math.isfinite(v)], float)


def _distance(trust: Trust, row: Row) -> float:
    """Distance of a statistic from the replicates' median, in their spread on that side."""
    drawn = _drawn(trust, row)
    if not len(drawn):
        return 0.0
    own, _ = battery.standardized(np.array([row.measured.value]), drawn[:, None])
    return abs(float(own[0]))


def trust_frame(trust: Trust, *, terms: Terms) -> pd.DataFrame:
    """The rows of `shown` to read; numbers to three digits each, as their units differ."""
    made = []
    for row in shown(trust):
        text, factor = statistic_words(row.statistic, terms)
        drawn = factor * _drawn(trust, row)
        low, middle, high = np.quantile(drawn, [0.05, 0.5, 0.95]).tolist() if len(drawn) else (math.nan,) * 3
        value = factor * row.measured.value
        cells = {
            "estimator": row.estimator,
            "statistic": text,
            "value": plus_minus(value, factor * row.measured.se) if math.isfinite(value) else None,
            "expected": _text(factor * row.measured.expected),
            "twins' median": _text(middle),
            "twins, 5 to 95 %": f"{_text(low)} to {_text(high)}" if len(drawn) else None,
            "p": _text(row.p, 2),
            "family-wise p": _text(row.p_family, 2),
        }
        made.append(cells)
    return drop_blank_columns(pd.DataFrame(made, dtype=object))


def _text(value: float, digits: int = 3) -> str | None:
    return number(value, digits).replace("-", "−") if math.isfinite(value) else None


def of_trial(trial: Trial, diagnoses: Sequence[Trust]) -> list[Trust]:
    """The diagnoses of a log and task: all association methods with replicates, else the first one."""
    own = [t for t in diagnoses if (t.log, t.task) == (trial.log.name, trial.task) and trial.variant_of is None]
    order = associations(trial.runs)
    own.sort(key=lambda t: order.index(t.association) if t.association in order else len(order))
    asked = [t for t in own if t.twins or any(n.code == Code.NO_TWINS for n in t.notices)]
    return asked or [t for t in own if online(t)][:1]


def first_page_words(trial: Trial, diagnoses: Sequence[Trust]) -> str:
    """For the first page: the first association method; with truth only what replicates show."""
    for trust in of_trial(trial, diagnoses)[:1]:
        measured = trial.log.truth.known_poses > 0
        if trust.blame is not None or not measured:
            return first_words(trust, terms=terms_of(trial.log.recorded), measured=measured)
    return ""


def trust_section(
    folder: Path, wanted: Output, trial: Trial, pictures: Sequence[Picture], diagnoses: Sequence[Trust]
) -> list[Section]:
    """The words, the table and the figure of a log and task; none where nothing is known."""
    trusts = of_trial(trial, diagnoses)
    terms, labels = terms_of(trial.log.recorded), trial.log.has_labels
    blocks: list[Block] = []
    facts = [facts_of(trust, terms, labels=labels) for trust in trusts]
    for trust, own in zip(trusts, facts, strict=True):
        if len(trusts) > 1 or len(associations(trial.runs)) > 1:
            blocks.append(f"With association `{trust.association}`:")
        front, *more = folded(say("trust#paragraphs", trust=own), MORE) or ("",)
        blocks += [front] if front else []
        if shown(trust):
            caption, name = say("trust#caption", trust=trust), stem(trial, f"trust-{trust.association}")
            blocks.append(written_table(trust_frame(trust, terms=terms), folder, name, caption, wanted, fine=FINE))
        blocks += more
    blocks += [p for p in pictures if p.stem == stem(trial, FILTER_SMOOTHER)]
    heading = f"{HEADING}: {trial.log.name}, {trial.task}"
    return [Section(heading, tuple(blocks), 3, tuple(facts), page=stem(trial))] if blocks else []
