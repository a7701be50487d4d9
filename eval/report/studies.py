"""The report's sections on studies: verdicts, figures, diverged runs, published numbers, and wrong associations."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import special

from data.log import folder_name
from data.terminal.words import counted
from eval import figures
from eval.figures.style import save
from eval.page.document import Block, Picture, Section, Table, written_table
from eval.plan.cluster import Call
from eval.plan.execute import Outcome
from eval.plan.flags.options import Options
from eval.plan.work import work
from eval.referee.consistency import MIN_RUNS
from eval.replay.foreign.spec import name_of, names_of
from eval.report import comparison
from eval.report.validation import validation_section
from eval.studies.montecarlo import DOF, Judged, Study, consistency_table
from eval.studies.published import Estimate, mean_of, rms_of
from eval.studies.reproduced import orderings, published_frame

OUTLIERS = ("task", "estimator", "rate", "rmse_position_m", "rmse_lower", "rmse_upper", "nees_pose", "nees_lower",
            "nees_upper", "runs", "diverged")  # fmt: skip

FINE_PRINT = {"-consistency": comparison.CONSISTENCY_FINE, "-coverage": comparison.COVERAGE_FINE}
"""Of tables by how their names end: what the report says once for all of them."""
MOST_LISTED = 20
"""Runs of a study that are listed one by one with what replays them."""
Writer = Callable[[pd.DataFrame, str, str], Table]
"""(frame, name, caption): writes a table in the formats asked for and hands it to the report."""


def study_sections(folder: Path, options: Options, outcome: Outcome, judged: Sequence[Judged]) -> list[Section]:
    """All that is said about the studies of a report; nothing where there is none."""

    def table(frame: pd.DataFrame, name: str, caption: str) -> Table:
        fine = next((text for ending, text in FINE_PRINT.items() if name.endswith(ending)), None)
        return written_table(frame, folder, name, caption, options, fine=fine)

    plots = None if options.no_plots or options.quick else folder / "figures"
    sections = [validation_section(study, found, table, plots) for study, found in outcome.validations]
    sections += _published(outcome, table)
    if outcome.studies:
        sections.append(Section("Consistency over many simulated runs", tuple(_reading(outcome.studies))))
    plain = [s for s in outcome.studies if not _of_rates(s)]
    drawn = _draw(folder, options, plain)
    for study, pictures in zip(plain, drawn, strict=True):
        own = [j for j in judged if j.scenario == study.scenario.name]
        sections.append(_study(study, own, pictures, table))
    for source in dict.fromkeys(s.scenario.source for s in outcome.studies if _of_rates(s)):
        group = [s for s in outcome.studies if s.scenario.source == source and _of_rates(s)]
        sections.append(_outliers(folder, options, group, table))
    return sections


def _of_rates(study: Study) -> bool:
    """Whether a study is one rate of an outlier study."""
    return study.scenario.part


def _reading(studies: Sequence[Study]) -> Iterator[Block]:
    yield (
        "Every run is an independent simulated log of its seed; all estimators of a scenario get the same ones, and the"
        " prior's mean is drawn from the prior. Only what a scenario declares to be consistent decides the exit status,"
        " in pose, position and heading, by Holm's procedure over all declared verdicts at 0.1 %."
    )
    few = [s.scenario.name for s in studies if len(s.seeds) < MIN_RUNS]
    if few:
        yield f"With fewer than {MIN_RUNS} runs there is no verdict: a wrong covariance would pass too often."


def _study(study: Study, judged: Sequence[Judged], pictures: Sequence[Picture], table: Writer) -> Section:
    s = study.scenario
    declared = [f"`{name_of(m.name)}` ({', '.join(m.must_be_consistent)})" for m in s.members if m.must_be_consistent]
    blocks: list[Block] = [
        f"{s.about} {counted(len(study.seeds), 'run')} (seeds {study.seeds[0]} to {study.seeds[-1]}).",
        f"Declared to be consistent: {', '.join(declared)}." if declared else "Nothing is declared to be consistent.",
    ]
    if s.cite:
        blocks.append(f"Source: {s.cite}.")
    name = folder_name(s.name)
    tests = [j for j in judged if not j.quantity.startswith("coverage")]
    shares = [j for j in judged if j.quantity.startswith("coverage")]
    if tests:
        made = comparison.consistency_table(consistency_table(tests))
        blocks.append(table(made, f"{name}-consistency", f"Scenario {s.name}: verdicts."))
    if shares:
        made = comparison.coverage_table(consistency_table(shares))
        blocks.append(table(made, f"{name}-coverage", f"Scenario {s.name}: coverage of the last position's ellipses."))
    blocks += pictures
    blocks.append(_diverged(study))
    return Section(f"Scenario {s.name}", tuple(blocks), level=3)


def _diverged(study: Study) -> str:
    """Runs that did not get to the end, each with its seed and the command that replays it."""
    lost = study.failures()
    if not lost:
        return "Every run of every estimator got to its end."
    notes = []
    for (task, estimator, association, _), seed, why in lost:
        asked = shlex.join(
            ["--scenario", study.scenario.source, "--estimator", estimator, "--seed", str(seed), "--runs", "1"]
        )
        notes.append(f"* seed {seed}: `{estimator}` ({task}, {association}), {why}: `python -m eval.run_all {asked}`")
    what = "diverged or are implausible" if any(": implausible, " in why for _, _, why in lost) else "diverged"
    shown = list(dict.fromkeys(notes))
    shown[MOST_LISTED:] = [f"* … and {len(shown) - MOST_LISTED} more"] if len(shown) > MOST_LISTED else []
    return (
        f"{counted(len(lost), 'run')} {what}; {'it is' if len(lost) == 1 else 'they are'} in no average:\n\n"
        + "\n".join(shown)
    )


def _draw(folder: Path, options: Options, studies: Sequence[Study]) -> list[list[Picture]]:
    """The figures of every study, drawn in parallel."""
    pictures: list[list[Picture]] = [[] for _ in studies]
    if options.no_plots or options.quick:
        return pictures
    jobs: list[tuple[tuple[int, int], Call]] = []
    for i, study in enumerate(studies):
        for task in study.scenario.task:
            for association in names_of(study.scenario.association):
                for kind in ("anees", "ends", "coverage"):
                    jobs.append(((i, len(jobs)), (_picture, (folder, study, task, association, kind))))
    made = dict(work(jobs, options))
    for i, place in sorted(made):
        if made[i, place] is not None:
            pictures[i].append(made[i, place])
    return pictures


def _picture(folder: Path, study: Study, task: str, association: str, kind: str) -> Picture | None:
    """One figure of a study: filters and incremental smoothers online, batch smoothers final."""
    keys = {k[1]: k for k in study.samples if k[0] == task and k[2] in (association, "none") and k[3] == "final"}
    keys |= {k[1]: k for k in study.samples if k[0] == task and k[2] in (association, "none") and k[3] == "online"}
    keys = {name: keys[name] for name in study.scenario.estimators if name in keys and study.good(keys[name])}
    if not keys:
        return None
    s, runs = study.scenario, len(study.seeds)
    what = f"{s.name}, {task}" + (f", {association}" if len(s.association) > 1 else "")
    stem = folder_name(f"{s.name}-{task}-{association}-{kind}" if len(s.association) > 1 else f"{s.name}-{task}-{kind}")
    if kind == "anees":
        average = {n: np.mean([x.nees_pose for x in study.good(k)], axis=0) for n, k in keys.items()}
        fig = figures.anees_figure(
            study.time, average, DOF["pose"], runs, title=what, time_is_index=study.time_is_index
        )
        caption = "pose NEES averaged over the runs at each instant (of a consistent estimator 5 % lie outside)."
    elif kind == "ends":
        ends = {n: np.array([x.ends["pose"] for x in study.good(k)]) for n, k in keys.items()}
        fig = figures.run_end_figure(ends, DOF["pose"], what)
        caption = "pose NEES at the end of each run against the χ² density of a consistent estimator."
    else:
        ends = {n: np.array([x.ends["position"] for x in study.good(k)]) for n, k in keys.items()}
        fig = figures.coverage_figure(ends, DOF["position"], what)
        caption = "share of the runs whose last position lies inside the ellipse of each level, with 95 % bounds."
    save(fig, folder / "figures", stem)
    return Picture(stem, f"{what}, {counted(runs, 'run')}: {caption}", f"{kind} of {what}")


def _published(outcome: Outcome, table: Writer) -> list[Section]:
    """One table of all published numbers with ours, and what is to be known of each scenario's."""
    notes = []
    for study in outcome.studies:
        p = study.scenario.published
        if p is not None:
            notes += [f"* `{study.scenario.name}`: {p.note} Source: {study.scenario.cite}."] if p.note else []
            notes += [f"* `{study.scenario.name}`: {text}" for text in orderings(study)]
    notes += [f"* {text}." for text in outcome.skipped]
    blocks: list[Block] = []
    if outcome.published:
        made = comparison.published_table(published_frame(outcome.published))
        blocks.append(table(made, "published", comparison.PUBLISHED_CAPTION))
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
                values = [*_interval(rmse), *_interval(nees)]
            rows.append([task, estimator, study.scenario.wrong, *values, len(good), len(samples) - len(good)])
    return pd.DataFrame(rows, columns=list(OUTLIERS)).sort_values(["task", "rate"], kind="stable", ignore_index=True)


def _interval(e: Estimate) -> tuple[float, float, float]:
    half = float(special.stdtrit(e.runs - 1, 0.975)) * e.se if e.runs > 1 else float("nan")
    return e.value, e.value - half, e.value + half


def _outliers(folder: Path, options: Options, studies: Sequence[Study], table: Writer) -> Section:
    s = studies[0].scenario
    name = folder_name(s.source if "/" not in s.source else Path(s.source).stem)
    data = outlier_table(studies)
    caption = (
        f"{name}: position RMSE and mean pose NEES (expected {DOF['pose']}) with 95 % intervals over"
        f" {counted(len(studies[0].seeds), 'run')}, against the share of wrong labels."
    )
    if any(study.failures() for study in studies):
        caption += " Runs that diverged or are implausible are left out: of the others alone the mean is too small."
    blocks: list[Block] = [f"{s.about} {counted(len(studies[0].seeds), 'run')} at each rate.", table(
        comparison.outliers_table(data), name, caption)]  # fmt: skip
    if not (options.no_plots or options.quick):
        save(figures.outlier_figure(data, name), folder / "figures", name)
        blocks.append(Picture(name, caption, "RMSE and NEES against the share of wrong associations"))
    blocks += [f"At {100 * study.scenario.wrong:g} %: {_diverged(study)}" for study in studies if study.failures()]
    return Section(f"Wrong associations: {name}", tuple(blocks), level=3)
