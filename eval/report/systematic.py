"""The report's sections "Systematic errors", one for each log and task that was run with `--calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from data.inputs import ERRORS, Systematic
from data.result import Run, Systematics
from data.truth import Truth
from eval.judgement.causes import terms_of
from eval.plan.calibrate import Calibration
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.replay.external.spec import name_of
from eval.replay.settings import BATCH
from eval.report.diagnosis import TrustFacts, facts_of
from eval.report.page.blocks import Block, FinePrint, Picture, Section
from eval.report.page.files import written_table
from eval.report.page.tables import number
from eval.report.rows import SYSTEMATIC, stem
from eval.report.words import plus_minus, say

UNTOLD = 0.9
"""Share of the prior's sigma that is left of an error that the log cannot tell: data then have less to say of it than a
quarter of what was known before (1/0.9² - 1)."""


def determined(systematic: Systematic, errors: Systematics) -> tuple[bool, ...]:
    """Of each error (p,), whether data say more of it than was known before; of the drift in the middle of the run."""
    left = np.median(errors.sigma, axis=0) / systematic.sigma
    return tuple((left <= UNTOLD).tolist())


def best(runs: Sequence[Run]) -> Run | None:
    """The run whose estimate of the errors counts: batch's, else that of another smoother, else the first filter's."""
    there = [r for r in runs if r.errors is not None]
    there.sort(key=lambda r: (r.estimator != "batch", r.errors_final is None, r.estimator not in BATCH))
    return there[0] if there else None


def errors_table(systematic: Systematic, runs: Sequence[Run], truth: Truth) -> pd.DataFrame:
    """A row for each error at the last frame: prior and estimates ± sigma, true value, whether data determine it."""
    judge = best(runs)
    estimates = None if judge is None else judge.errors
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
                head = f"{run.estimator} ({'final' if run.errors_final is not None else 'online'})"
                row[head] = plus_minus(float(errors.mean[-1, i]), float(errors.sigma[-1, i]))
        if truth.errors is not None:
            true = float(truth.errors.mean[-1, truth.errors.names.index(name)]) if name in truth.errors.names else 0.0
            row["true"] = number(true).replace("-", "−")
        if estimates is not None:
            row["told"] = "yes" if determined(systematic, estimates)[i] else "the log cannot tell it"
        rows.append(row)
    return pd.DataFrame(rows)


HEADING = "Systematic errors"
CAPTION = "Systematic errors as estimated along by filter and smoother: estimate ± σ at the last frame."
FINE = FinePrint(
    "Systematic errors",
    "Errors of what is measured: the robot goes (1 + scale) times what it reads, turns (1 + left) or (1 + right) times"
    " what it reads, and curvature + drift more to the left with every metre; ranges are (1 + range) times the true"
    " ones, bearings the true ones + bearing. All are zero where nothing is wrong. The drift comes and goes over 50 m;"
    " told: its σ in the middle of the run. An error of which more than 90 % of the prior's σ is left is not told.",
)


@dataclass(frozen=True)
class Estimated:
    """The errors of a log and task."""

    names: tuple[str, ...]
    why: str  # of a `Calibration`
    judged: bool  # whether a run reached its end
    untold: tuple[str, ...]  # errors of which the log says nothing
    # before, after: the battery with plain estimators and with these (None: not enough memory)
    before: TrustFacts | None
    after: TrustFacts | None


def shown(trial: Trial, calibration: Calibration) -> list[Run]:
    """Runs of a trial that estimated errors along, under the association that the battery is about."""
    own = name_of(calibration.association)
    return [r for r in trial.runs if r.errors is not None and r.flaw is None and r.association == own]


def of_trial(trial: Trial, calibrations: Sequence[Calibration]) -> Calibration | None:
    """The calibration of a trial, if there is one."""
    if trial.variant_of is not None:
        return None
    return next((c for c in calibrations if (c.log, c.task) == (trial.log.name, trial.task)), None)


def systematic_section(
    folder: Path, wanted: Output, trial: Trial, pictures: Sequence[Picture], calibrations: Sequence[Calibration]
) -> list[Section]:
    """Words, table and figure of a log and task; none where no errors were estimated."""
    c = of_trial(trial, calibrations)
    if c is None:
        return []
    runs = shown(trial, c)
    facts = estimated(trial, c, runs)
    blocks: list[Block] = [say("systematic", facts)]
    if runs:
        caption = f"{trial.log.name}, {trial.task}, association {name_of(c.association)}. {CAPTION}"
        table = errors_table(c.systematic, runs, trial.log.truth)
        blocks.append(written_table(table, folder, stem(trial, SYSTEMATIC), caption, wanted, fine=FINE))
    blocks += [p for p in pictures if p.stem == stem(trial, SYSTEMATIC)]
    return [Section(f"{HEADING}: {trial.log.name}, {trial.task}", tuple(blocks), 3, facts)]


def estimated(trial: Trial, c: Calibration, runs: Sequence[Run]) -> Estimated:
    """The facts of a log and task."""
    judge = best(runs)
    which = (True,) * len(c.systematic.names)
    if judge is not None and judge.errors is not None:
        which = determined(c.systematic, judge.errors)
    terms = terms_of(trial.log.recorded)
    before, after = (None if t is None else facts_of(t, terms) for t in (c.before, c.after))
    untold = tuple(n for n, known in zip(c.systematic.names, which, strict=True) if not known)
    return Estimated(c.systematic.names, c.why, judge is not None, untold, before, after)
