"""The report's sections "Systematic errors", one for each log and task that was run with `--calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from data.result import Run
from data.terminal.words import counted
from eval.page.document import Block, FinePrint, Picture, Section, written_table
from eval.plan.calibrate.calibration import ALL, ASKED, NAMED, Calibration
from eval.plan.flags.options import Options
from eval.referee.attribution import ESTIMATOR
from eval.referee.score import Trial
from eval.replay.foreign.spec import name_of
from eval.report.names import SYSTEMATIC, stem
from eval.report.systematic.table import best, errors_table, told
from eval.report.trust.findings import sentences
from eval.report.trust.phrases import Terms, terms_of
from eval.studies.trusted import Trust

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
