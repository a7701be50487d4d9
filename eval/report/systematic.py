"""The report's sections "Systematic errors", one for each log and task that was run with `--calibrate`.

Systematic errors as a table: what was known before, what filter and smoothers make of each, and which are told.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from data.inputs import ERRORS, Systematic
from data.result import Run, Systematics
from data.terminal import counted
from data.truth import Truth
from eval.plan.calibrate import ALL, ASKED, NAMED, Calibration
from eval.plan.flags.options import Options
from eval.referee.attribution import ESTIMATOR
from eval.referee.score import Trial
from eval.replay.external.spec import name_of
from eval.replay.settings import BATCH
from eval.report.names import SYSTEMATIC, stem
from eval.report.page.document import Block, FinePrint, Picture, Section, written_table
from eval.report.page.tables import number
from eval.report.trust import sentences
from eval.report.trust_facts import Terms, terms_of
from eval.studies.trusted import Trust

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


HEADING = "Systematic errors"
WHY = {
    ASKED: "These were asked for.",
    NAMED: "These are the ones that a score test of the residuals of plain estimators names.",
    ALL: "A score test of the residuals of plain estimators names none, so all are looked for, with tight priors.",
}
CAPTION = "Systematic errors as estimated along by filter and smoother: estimate ± σ at the last frame."
FINE = FinePrint(
    "Systematic errors",
    "Errors of what is measured: the robot goes (1 + scale) times what it reads, turns (1 + left) or (1 + right) times"
    " what it reads, and curvature + drift more to the left with every metre; ranges are (1 + range) times the true"
    " ones, bearings the true ones + bearing. All are zero where nothing is wrong. The drift comes and goes over 50 m;"
    " told: its σ in the middle of the run. An error of which more than 90 % of the prior's σ is left is not told.",
)


def shown(trial: Trial, calibration: Calibration) -> list[Run]:
    """Runs of a trial that estimated errors along, under the association that the battery is about."""
    own = name_of(calibration.association)
    return [r for r in trial.runs if r.errors is not None and r.flaw is None and r.association == own]


def of_trial(trial: Trial, calibrations: Sequence[Calibration]) -> Calibration | None:
    """The calibration of a trial, if there is one."""
    if trial.beside is not None:
        return None
    return next((c for c in calibrations if (c.log, c.task) == (trial.log.name, trial.task)), None)


def systematic_section(
    folder: Path,
    options: Options,
    trial: Trial,
    pictures: Sequence[Picture],
    calibrations: Sequence[Calibration],
) -> list[Section]:
    """Words, table and figure of a log and task; none where no errors were estimated."""
    c = of_trial(trial, calibrations)
    if c is None:
        return []
    runs = shown(trial, c)
    blocks: list[Block] = ["\n".join(f"* {line}" for line in words(trial, c, runs))]
    if runs:
        name, caption = (
            stem(trial, SYSTEMATIC),
            f"{trial.log.name}, {trial.task}, association {name_of(c.association)}.",
        )
        table = errors_table(c.systematic, runs, trial.log.truth)
        blocks.append(written_table(table, folder, name, f"{caption} {CAPTION}", options, fine=FINE))
    blocks += [p for p in pictures if p.stem == stem(trial, SYSTEMATIC)]
    return [Section(f"{HEADING}: {trial.log.name}, {trial.task}", tuple(blocks), 3)]


def words(trial: Trial, c: Calibration, runs: Sequence[Run]) -> list[str]:
    """Why these errors, which of them the log tells, and what the battery says before and after."""
    listed = ", ".join(f"`{name}`" for name in c.systematic.names)
    lines = [f"Estimated along by filter and smoother alike: {listed}. {WHY[c.why]}"]
    judge = best(runs)
    errors = None if judge is None else judge.errors
    if judge is None or errors is None:
        lines.append("No run got to its end, so nothing is said of them.")
    else:
        which = told(c.systematic, errors)
        untold = [n for n, t in zip(c.systematic.names, which, strict=True) if not t]
        if untold:
            names = ", ".join(f"`{n}`" for n in untold)
            lines.append(f"This log cannot tell {names}: what is known afterwards is what was known before.")
    terms = terms_of(trial.log.recorded)
    lines.append(f"**Battery before** (plain estimators): {said(c.before, terms)}")
    lines.append(f"**Battery after** (errors estimated along): {said(c.after, terms)}")
    return lines


def said(trust: Trust | None, terms: Terms) -> str:
    """How much a battery objects to, and what that is; in words, with a full stop."""
    if trust is None:
        return "not enough memory."
    if trust.blame is None:
        return " ".join(trust.notes) or "too few twins."
    b = trust.blame
    twins = counted(len(trust.twins), "twin")
    if not b.objected:
        return f"none of {b.tested} statistics is outside what {twins} show."
    verb = "is" if len(b.objected) == 1 else "are"
    text = f"{len(b.objected)} of {b.tested} statistics {verb} outside what {twins} show (family-wise p at most 0.05)"
    found = sentences([f for f in b.findings if f.cause != ESTIMATOR], terms)
    return f"{text}: {'; '.join(found)}." if found else f"{text}; none of the errors that have a name explains them."
