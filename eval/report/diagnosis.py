"""The report's sections "Diagnosis without ground truth", on systematic errors, and on fixes and closures by source."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from data.inputs import ERRORS, Systematic
from data.notice import Notice
from data.result import Run, Systematics
from data.se2 import Array
from data.truth import Truth
from eval.figures.kinds import calibrated
from eval.judgement import causes
from eval.plan.flags.table import Output
from eval.referee import battery, result_files
from eval.referee.result_files import rows_of, value_of
from eval.referee.score import Scores, Trial
from eval.replay.settings import BATCH, FILTERS, associations
from eval.report.page.blocks import Block, Picture, Section, folded
from eval.report.page.files import HEADS, SYSTEMATIC, drop_blank_columns, interval, number, stem, written_table
from eval.report.words import fine_print, of_runs, paragraph, plus_minus, say
from eval.studies.diagnosis import SHARES, Row, Trust

MOST = 18  # rows of a table; trust.csv has all
HEADLINE = (
    "nis",
    "innovation_lag1",
    *(f"filter_smoother_{what}" for what in ("median", "semidefinite", "rms_x", "rms_y", "rms_theta", "largest")),
)  # statistics that are shown whatever they say
OWN = "own_smoother"
HEADING = "Diagnosis without ground truth"
MORE = "More of the diagnosis"


def first_words(trust: Trust, *, terms: causes.Terms, measured: bool = False) -> str:
    """Two to four sentences, two if errors against the truth are known (`measured`); empty without a diagnosis."""
    return say("diagnosis#first", trust=facts_of(trust, terms), measured=measured)


def statistic_words(name: str, terms: causes.Terms) -> tuple[str, float]:
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
    return [*[r for r in outside if r.statistic in always or r in more], *headline, *telling][:MOST]


def _key(row: Row) -> tuple[str, str]:
    return row.estimator, row.statistic


def _stands_out(row: Row) -> bool:
    """Without replicates: means of residuals, and slopes beyond their standard error."""
    m = row.measured
    if row.statistic.startswith("slope_"):
        return bool(m.se > 0.0 and abs(m.value) > causes.STANDS_OUT * m.se)
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


def trust_frame(trust: Trust, *, terms: causes.Terms) -> pd.DataFrame:
    """The rows of `shown` to read; numbers to three digits each, as their units differ."""
    made = []
    for row in shown(trust):
        text, factor = statistic_words(row.statistic, terms)
        drawn = factor * _drawn(trust, row)
        low, middle, high = np.quantile(drawn, [0.05, 0.5, 0.95]).tolist() if len(drawn) else (math.nan,) * 3
        value = factor * row.measured.value
        cells = {
            "estimator": row.estimator, "statistic": text,
            "value": plus_minus(value, factor * row.measured.se) if math.isfinite(value) else None,
            "expected": _text(factor * row.measured.expected), "twins' median": _text(middle),
            "twins, 5 to 95 %": f"{_text(low)} to {_text(high)}" if len(drawn) else None, "p": _text(row.p, 2),
            "family-wise p": _text(row.p_family, 2),
        }  # fmt: skip
        made.append(cells)
    return drop_blank_columns(pd.DataFrame(made, dtype=object))


def _text(value: float, digits: int = 3) -> str | None:
    return number(value, digits).replace("-", "−") if math.isfinite(value) else None


def first_page_words(trial: Trial, diagnoses: Sequence[Trust]) -> str:
    """For the first page: the first association method; with truth only what replicates show."""
    for trust in causes.of_trial(trial, diagnoses)[:1]:
        measured = trial.log.truth.known_poses > 0
        if trust.blame is not None or not measured:
            return first_words(trust, terms=causes.terms_of(trial.log.recorded), measured=measured)
    return ""


def trust_section(folder: Path, wanted: Output, trial: Trial, diagnoses: Sequence[Trust]) -> list[Section]:
    """The words and the table of a log and task; none where nothing is known."""
    trusts = causes.of_trial(trial, diagnoses)
    terms = causes.terms_of(trial.log.recorded)
    blocks: list[Block] = []
    facts = [facts_of(trust, terms) for trust in trusts]
    for trust, own in zip(trusts, facts, strict=True):
        if len(trusts) > 1 or len(associations(trial.runs)) > 1:
            blocks.append(f"With association `{trust.association}`:")
        front, *more = folded(say("diagnosis#paragraphs", trust=own), MORE) or ("",)
        blocks += [front] if front else []
        if shown(trust):
            caption, name = say("diagnosis#caption", trust=trust), stem(trial, f"trust-{trust.association}")
            frame, fine = trust_frame(trust, terms=terms), fine_print("Consistency without ground truth")
            blocks.append(written_table(frame, folder, name, caption, wanted, fine=fine))
        blocks += more
    heading = f"{HEADING}: {trial.log.name}, {trial.task}"
    return [Section(heading, tuple(blocks), 3, tuple(facts), page=stem(trial))] if blocks else []


def facts_of(trust: Trust, terms: causes.Terms) -> dict[str, Any]:
    """What a log with one association method says about itself."""
    blame = trust.blame
    found = () if blame is None else blame.findings
    return {
        "log": trust.log, "task": trust.task, "association": trust.association, "terms": terms,
        "twins": len(trust.twins),
        "judged": None if blame is None else {  # by the battery; None: too few replicates
            "cause": blame.cause, "contradictions": blame.contradictions, "objected": len(blame.objected),
            "tested": blame.tested, "p": blame.p if math.isfinite(blame.p) else None,  # the smallest one
            "unexplained": bool(blame.objected and not blame.findings),  # nothing rejected has a name
        },
        "apart": tuple(_apart(trust, name) for name in causes.online(trust)),  # online paths against the smoothed one
        "findings": causes.explanations(found, terms),  # the weightiest first; main: those for a first page
        "main": causes.explanations(causes.main_findings(trust), terms),
        "nees": tuple(  # mean of the pose by estimator and phase, over the replicates that have one
            (*key, float(np.mean(known))) for key in dict.fromkeys(k for s in trust.twins for k in s.nees)
            if (known := [v for s in trust.twins if math.isfinite(v := s.nees.get(key, math.nan))])
        ),
        "deciding": _deciding(trust),  # what to expect of the association method
        "notices": trust.notices,
    }  # fmt: skip


def _apart(trust: Trust, name: str) -> dict[str, object]:
    """Distance [m] of an online path from the smoothed one; empty or None: not known."""
    twins = [s.apart[name] for s in trust.twins if math.isfinite(s.apart.get(name, math.nan))]
    median = trust.real.measured.get((name, "filter_smoother_median"))
    share = trust.real.measured.get((name, "filter_smoother_semidefinite"))
    known = median is not None and math.isfinite(median.value) and math.isfinite(median.expected)
    return {
        "estimator": name,
        "filters": name in FILTERS,
        "rms": trust.real.apart[name],
        "twins": (min(twins), max(twins)) if twins else (),  # least and largest on the replicates
        "beside_twins": bool(trust.twins),
        # of the quadratic form of the difference, and what is expected
        "median": (median.value, median.expected) if median is not None and known else (),
        # share of the frames in which P_f - P_s is
        "semidefinite": share.value if share is not None and math.isfinite(share.value) else None,
    }


def _deciding(trust: Trust) -> tuple[dict[str, object], ...]:
    """By estimators that decide alike: means over replicates of wrong, missed, all, and the share of right ones."""
    alike: dict[tuple[float, ...], list[str]] = {}
    for name in dict.fromkeys(n for s in trust.twins for n in s.counts if trust.association != "known"):
        counts = np.array([s.counts[name] for s in trust.twins if name in s.counts], float)
        if counts.sum() > 0.0:
            alike.setdefault(tuple(counts.mean(axis=0).tolist()), []).append(name)
    return tuple(
        {"estimators": tuple(names), "wrong": fp, "missed": fn, "decisions": sum(c), "right": (tp + tn) / sum(c)}
        for c, names in alike.items() for tp, tn, fp, fn in [c]
    )  # fmt: skip


UNTOLD = 0.9
"""Share of the prior's sigma that is left of an error that the log cannot tell: data then have less to say of it than a
quarter of what was known before (1/0.9² - 1)."""


def determined(systematic: Systematic, errors: Systematics) -> tuple[bool, ...]:
    """Of each error (p,), whether data say more of it than was known before; of the drift in the middle of the run."""
    return tuple(((np.median(errors.sigma, axis=0) / systematic.sigma) <= UNTOLD).tolist())


def best(runs: Sequence[Run]) -> Systematics | None:
    """The estimate of the errors that counts: batch's, else that of another smoother, else the first filter's."""
    there = [r for r in runs if r.errors is not None]
    there.sort(key=lambda r: (r.estimator != "batch", r.errors_final is None, r.estimator not in BATCH))
    return there[0].errors if there else None


def errors_table(systematic: Systematic, runs: Sequence[Run], truth: Truth) -> pd.DataFrame:
    """A row for each error at the last frame: prior and estimates ± sigma, true value, whether data determine it."""
    estimates, rows = best(runs), []
    for i, name in enumerate(systematic.names):
        unit, before = "" if ERRORS[name] == "1" else ERRORS[name], number(float(systematic.sigma[i]), 2)
        row: dict[str, object] = {"error": name, "unit": unit, "known before": f"0 ± {before}"}
        for run in runs:
            if run.errors is not None:
                head = f"{run.estimator} ({'final' if run.errors_final is not None else 'online'})"
                row[head] = plus_minus(float(run.errors.mean[-1, i]), float(run.errors.sigma[-1, i]))
        if truth.errors is not None:
            true = float(truth.errors.mean[-1, truth.errors.names.index(name)]) if name in truth.errors.names else 0.0
            row["true"] = number(true).replace("-", "−")
        if estimates is not None:
            row["told"] = "yes" if determined(systematic, estimates)[i] else "the log cannot tell it"
        rows.append(row)
    return pd.DataFrame(rows)


CAPTION = "Systematic errors as estimated along by filter and smoother: estimate ± σ at the last frame."


def systematic_section(folder: Path, wanted: Output, trial: Trial, pictures: Sequence[Picture]) -> list[Section]:
    """Words, table and figure of a log and task; none where no errors were estimated."""
    if trial.log.recorded.systematic is None:
        return []
    where, runs = f"{trial.log.name}, {trial.task}", calibrated(trial)
    facts = estimated(trial, runs)
    blocks: list[Block] = [say("systematic", **facts)]
    if runs:
        caption = f"{where}, association {runs[0].association}. {CAPTION}"
        table = errors_table(trial.log.recorded.systematic, runs, trial.log.truth)
        fine = fine_print("Systematic errors")
        blocks.append(written_table(table, folder, stem(trial, SYSTEMATIC), caption, wanted, fine=fine))
    blocks += [p for p in pictures if p.stem == stem(trial, SYSTEMATIC)]
    return [Section(f"Systematic errors: {where}", tuple(blocks), 3, facts)]


def estimated(trial: Trial, runs: Sequence[Run]) -> dict[str, Any]:
    """The errors of a log and task, who named them, and those of which the log says nothing."""
    systematic, estimates = trial.log.recorded.systematic, best(runs)
    assert systematic is not None  # or there is no such section
    told = [True] * len(systematic.names) if estimates is None else determined(systematic, estimates)
    untold = tuple(n for n, known in zip(systematic.names, told, strict=True) if not known)
    why = trial.log.origins["systematic_errors"]
    return {"names": systematic.names, "why": why, "judged": estimates is not None, "untold": untold}


COLUMNS: dict[str, str] = HEADS["sources"]
"""Columns of sources.csv (or made here) and their heads."""


def source_facts(scores: Scores, log: str, task: str) -> list[result_files.Row]:
    """The rows of sources.csv of a log and task."""
    return [r for r in rows_of(scores.sources) if (r["log"], r["task"]) == (log, task)]


def main_sources(found: Sequence[result_files.Row]) -> list[result_files.Row]:
    """Each source once: as the first filter took it online, else as the first run that used it, else as not used."""
    order = sorted(found, key=lambda s: (s["used"] == 0, s["phase"] != "online", s["estimator"] not in FILTERS))
    first = {(s["source"], s["kind"]): s for s in reversed(order)}
    return [first[key] for key in dict.fromkeys((s["source"], s["kind"]) for s in found)]


def source_lines(found: Sequence[result_files.Row]) -> list[str]:
    """The lines of the terminal, one for each source."""
    return [paragraph("sources#line", s=s) for s in main_sources(found)]


def source_section(folder: Path, output: Output, trial: Trial, scores: Scores, said: Sequence[Notice]) -> list[Section]:
    """Words and table on the sources of a log and task, with the notices about them; none where it has none."""
    facts = source_facts(scores, trial.log.name, trial.task)
    if not facts:
        return []
    where = f"{trial.log.name}, {trial.task}"
    bounds = [(value_of(s, "nis_low"), value_of(s, "nis_high")) for s in facts]
    made = [s | {"bounds": interval(*b) if math.isfinite(b[0]) else None} for s, b in zip(facts, bounds, strict=True)]
    frame = drop_blank_columns(pd.DataFrame(made, dtype=object)[list(COLUMNS)].rename(columns=COLUMNS))
    words = say("sources#about", sources=main_sources(facts), asking=of_runs(n for n in said if "source" in n.named))
    caption = paragraph("sources#caption", where=where, truth=any(s["tp"] is not None for s in facts))
    blocks = (words, written_table(frame, folder, stem(trial, "sources"), caption, output))
    return [Section(f"Fixes and closures: {where}", blocks, 3, tuple(facts))]
