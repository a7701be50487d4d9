"""The report's sections on studies: verdicts, figures, diverged runs, published numbers, wrong associations."""

import math
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from data.log import folder_name
from data.terminal import counted
from eval.figures.claims import anees_figure, outlier_figure
from eval.figures.style import save_for_page
from eval.plan.execute import Outcome
from eval.plan.flags.table import Options
from eval.plan.work import Job, work
from eval.referee.consistency import MIN_RUNS
from eval.referee.result_files import PUBLISHED
from eval.replay.external.spec import name_of, names_of
from eval.report import comparison
from eval.report.page.blocks import Block, Picture, Section, Table
from eval.report.page.files import written_table
from eval.report.words import fine_print, paragraph, say
from eval.studies.montecarlo import DOF, Judged, Study, consistency_table, judge_estimators, mean_of, rms_of

TableWriter = Callable[[pd.DataFrame, str, str], Table]
"""(frame, name, caption): writes a table in the formats asked for and hands it to the report."""
INTERVALS = ("rmse_position_m", "rmse_lower", "rmse_upper", "nees_pose", "nees_lower", "nees_upper")
OUTLIERS = ("task", "estimator", "rate", *INTERVALS, "runs", "diverged")
FINE_PRINT = {"-consistency": "Consistency over simulated runs", "-coverage": "Coverage"}
"""Of tables by how their names end: what the report says once for all of them."""


@dataclass(frozen=True)
class Diverged:
    """A run that did not get to the end, or is implausible, why, and the command that replays it."""

    task: str
    estimator: str
    association: str
    seed: int
    why: str
    implausible: bool
    command: str


def facts_of(study: Study) -> dict[str, Any]:
    """What a study is about, its seeds, what is declared consistent (name, quantities), and what diverged."""
    s, lost = study.scenario, []
    for (task, estimator, association, _), seed, why, implausible in study.failures():
        one = ["--scenario", s.source, "--estimator", estimator, "--seed", str(seed), "--runs", "1"]
        command = f"python -m eval.run_all {shlex.join(one)}"
        lost.append(Diverged(task, estimator, association, seed, why, implausible, command))
    declared = tuple((name_of(m.name), m.must_be_consistent) for m in s.members if m.must_be_consistent)
    return {"about": s.about, "seeds": study.seeds, "declared": declared, "diverged": tuple(lost)}


def study_sections(folder: Path, options: Options, outcome: Outcome, judged: Sequence[Judged]) -> list[Section]:
    """The sections on the studies of a report; nothing where there is none."""

    def table(frame: pd.DataFrame, name: str, caption: str) -> Table:
        title = next((t for ending, t in FINE_PRINT.items() if name.endswith(ending)), None)
        fine = None if title is None else fine_print(title)
        return written_table(frame, folder, name, caption, options.output, fine=fine)

    plots = None if options.output.no_plots or options.output.quick else folder / "figures"
    sections = _published(outcome, table)
    if outcome.studies:
        few = any(len(s.seeds) < MIN_RUNS for s in outcome.studies)
        texts = (say("studies#reading"), *([say("studies#few", least=MIN_RUNS)] if few else []))
        sections.append(Section("Consistency over many simulated runs", texts))
    plain = [s for s in outcome.studies if not s.scenario.part]
    for study, pictures in zip(plain, _draw(plots, options, plain), strict=True):
        sections += _study(study, [j for j in judged if j.scenario == study.scenario.name], pictures, table)
    rates = [s for s in outcome.studies if s.scenario.part]  # each one rate of an outlier study
    sources = dict.fromkeys(s.scenario.source for s in rates)
    return sections + [_outliers(plots, [s for s in rates if s.scenario.source == source], table) for source in sources]


def _study(study: Study, judged: Sequence[Judged], pictures: Sequence[Picture], table: TableWriter) -> list[Section]:
    """The means of a study with the average NEES over time, and its page in `details/`."""
    s, facts = study.scenario, facts_of(study)
    heading, name = f"Scenario {s.name}", folder_name(s.name)
    blocks: list[Block] = [say("studies#about", s=facts), say("studies#declared", s=facts)]
    blocks += [f"Source: {s.cite}."] if s.cite else []
    details: list[Block] = []
    tests = [j for j in judged if not j.quantity.startswith("coverage")]
    shares = [j for j in judged if j.quantity.startswith("coverage")]
    if tests:
        found = consistency_table(tests)
        fine = fine_print(FINE_PRINT["-consistency"])
        blocks.append(Table(comparison.verdicts_table(found), say("studies#means", name=s.name), fine=fine))
        blocks.append(say("studies#words", found=judge_estimators(study, judged)))
        details.append(table(comparison.consistency_table(found), f"{name}-consistency", f"{heading}: verdicts."))
    if shares:
        caption = f"{heading}: coverage of the last position's ellipses."
        details.append(table(comparison.coverage_table(consistency_table(shares)), f"{name}-coverage", caption))
    page = f"scenario-{name}"
    blocks += [*pictures, say("studies#diverged", lost=facts["diverged"])]
    blocks += [say("studies#details", page=page)] if details else []
    sections = [Section(heading, tuple(blocks), 3, facts)]
    return [*sections, Section(f"{heading}: details", tuple(details), page=page)] if details else sections


def _draw(folder: Path | None, options: Options, studies: Sequence[Study]) -> list[list[Picture]]:
    """The figures of every study, drawn in parallel; none without a folder for them."""
    pictures: list[list[Picture]] = [[] for _ in studies]
    if folder is None:
        return pictures
    each = [
        (i, (folder, study, task, association)) for i, study in enumerate(studies)
        for task in study.scenario.task for association in names_of(study.scenario.association)
    ]  # fmt: skip
    made = dict(work([Job((i, n), _picture, what) for n, (i, what) in enumerate(each)], options.execution))
    for i, place in sorted(made):
        if made[i, place] is not None:
            pictures[i].append(made[i, place])
    return pictures


def _picture(folder: Path, study: Study, task: str, association: str) -> Picture | None:
    shown = study.shown(task, association)
    if not shown:
        return None
    s, runs, dof = study.scenario, min(map(len, shown.values())), DOF["pose"]
    what = f"{s.name}, {task}" + (f", {association}" if len(s.association) > 1 else "")
    stem = folder_name(f"{s.name}-{task}-{association}-anees" if len(s.association) > 1 else f"{s.name}-{task}-anees")
    average = {n: np.mean([x.nees_pose for x in good], axis=0) for n, good in shown.items()}
    draw = partial(anees_figure, study.time, average, dof, runs, title=what, time_is_index=study.time_is_index)
    save_for_page(draw, folder, stem)
    return Picture(stem, say("studies#picture", what=what, runs=runs), f"Average NEES of {what}")


def _published(outcome: Outcome, table: TableWriter) -> list[Section]:
    """One table of all published numbers with ours, and what is to be known of each scenario's."""
    notes = []
    for study in outcome.studies:
        p = study.scenario.published
        if p is not None and p.note:
            notes.append(f"* `{study.scenario.name}`: {p.note} Source: {study.scenario.cite}.")
    notes += [f"* {text}." for text in outcome.skipped]
    blocks: list[Block] = []
    if outcome.published:
        made = comparison.selected(PUBLISHED.table(outcome.published).astype(object), comparison.PUBLISHED)
        blocks.append(table(made, "published", paragraph("comparison#published")))
    if notes:
        blocks.append("\n".join(notes))
    return [Section("Published numbers reproduced", tuple(blocks))] if blocks else []


def outlier_table(studies: Sequence[Study]) -> pd.DataFrame:
    """RMSE and pose NEES with 95 % intervals (Student's t) against the rate, a row per task, estimator and rate."""
    rows: list[list[object]] = []
    for study in studies:
        for key, samples in study.samples.items():
            good = study.good(key)
            task, estimator = key[:2]
            values: list[object] = [None] * 6
            if good:
                rmse = rms_of([s.squares["position"] for s in good])
                nees = mean_of([s.means["pose"] for s in good])
                values = []
                for e in (rmse, nees):
                    half = float(special.stdtrit(e.runs - 1, 0.975)) * e.se if e.runs > 1 else math.nan
                    values += [e.value, e.value - half, e.value + half]
            rows.append([task, estimator, study.scenario.wrong, *values, len(good), len(samples) - len(good)])
    return pd.DataFrame(rows, columns=list(OUTLIERS)).sort_values(["task", "rate"], kind="stable", ignore_index=True)


def _outliers(plots: Path | None, studies: Sequence[Study], table: TableWriter) -> Section:
    s, runs = studies[0].scenario, len(studies[0].seeds)
    name = folder_name(s.source if "/" not in s.source else Path(s.source).stem)
    data, lost = outlier_table(studies), [facts_of(study) for study in studies]
    caption = say("studies#outliers", name=name, runs=runs, dof=DOF["pose"], lost=any(f["diverged"] for f in lost))
    blocks: list[Block] = [f"{s.about} {counted(runs, 'run')} at each rate."]
    blocks.append(table(comparison.outliers_table(data), name, caption))
    if plots is not None:
        save_for_page(partial(outlier_figure, data, name), plots, name)
        blocks.append(Picture(name, caption, "RMSE and NEES against the share of wrong associations"))
    for study, f in zip(studies, lost, strict=True):
        if f["diverged"]:
            blocks.append(f"At {100 * study.scenario.wrong:g} %: {say('studies#diverged', lost=f['diverged'])}")
    return Section(f"Wrong associations: {name}", tuple(blocks), 3, tuple(lost))
