"""The report's sections on studies: verdicts, figures, diverged runs, published numbers, and wrong associations.

The report's section on a study of the battery: how often it objects to what is right, what it finds and names.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import special

from data.log import folder_name
from data.terminal import counted
from eval import figures
from eval.figures import Seen, power_figure
from eval.figures.style import save
from eval.plan.execute import Outcome
from eval.plan.flags.options import Options
from eval.plan.work import Job, work
from eval.referee import battery
from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, NOISE
from eval.referee.consistency import MIN_RUNS, share_interval
from eval.replay.external.spec import name_of, names_of
from eval.report import comparison
from eval.report.page.document import Block, Picture, Section, Table, written_table
from eval.studies.broken import BROKEN
from eval.studies.faults import FAULTS
from eval.studies.montecarlo import DOF, Judged, Study, consistency_table
from eval.studies.published import Estimate, mean_of, rms_of
from eval.studies.reproduced import orderings, published_frame
from eval.studies.validation import SOUND, Examined, Validation

TableWriter = Callable[[pd.DataFrame, str, str], Table]
SIZE = ("world", "task", "logs", "objected [%]", "95 % interval", "NIS alone [%]", "noise [%]", "associations [%]",
        "estimator [%]", "failed")  # fmt: skip
POWER = ("fault", "size", "logs", "detected [%]", "±", "NIS alone [%]", "right cause [%]", "taken for", "failed")
TESTS = ("battery", "NIS alone")
SURE = 0.9
"""Detected in at least this share of the logs, a fault should be put down to the right cause in `GOAL` of them."""
GOAL = 0.8


def validation_section(
    study: Validation, found: Sequence[Examined], table: TableWriter, figures: Path | None = None
) -> Section:
    """Both tables, with what they say in a line each; a figure of the power where `figures` is a folder."""
    size, power = size_table(study, found), power_table(study, found)
    sound = [e for e in found if e.fault == SOUND and not e.failure]
    objected = sum(e.objected for e in sound)
    blocks: list[Block] = [
        f"{study.about} {study.runs} logs of each world, {study.twins} twins of each log, family-wise level"
        f" {100 * battery.LEVEL:g} %.",
        f"Of {len(sound)} logs that are right, {objected} are objected to ({_percent(objected, len(sound)):.1f} %).",
        table(size, f"{study.name}_size", SIZE_CAPTION),
    ]
    if len(power) > 1:
        blocks += [_goal(study, found), table(power, f"{study.name}_power", POWER_CAPTION)]
        if figures is not None:
            blocks.append(_validation_picture(figures, study, power))
    return Section(f"Scenario {study.name}: what a log says about itself, tested", tuple(blocks), level=2)


def _validation_picture(folder: Path, study: Validation, power: pd.DataFrame) -> Picture:
    stem = f"{study.name}_power"
    faults = []
    for name, own in power[power["size"] != ""].groupby("fault", sort=False):
        shares = (tuple(own[column]) for column in ("detected [%]", "±", "NIS alone [%]"))
        unit = FAULTS[str(name)].unit if name in FAULTS else ""
        called = f"{name} [{unit}]" if unit else str(name)
        faults.append(Seen(called, tuple(size.split()[0] for size in own["size"]), *shares))
    title = f"{study.name}: {study.power_runs} logs of {study.power} for each fault and size"
    save(power_figure(faults, TESTS, 100.0 * battery.LEVEL, title), folder, stem)
    caption = "share of the logs in which a fault is seen, against its size; dashed: logs without a fault, by design."
    return Picture(stem, f"{title}: {caption}", "Power of the battery and of NIS against the size of each fault")


SIZE_CAPTION = (
    "Logs that are right: share that the battery objects to, with its exact (Clopper-Pearson) interval; share whose"
    " NIS, of filter or smoother, is outside its 95 % bounds; causes named. An estimator is named where its NEES or NIS"
    " on twins is off, which is right where linearization makes it so."
)
POWER_CAPTION = (
    "Faults: share of the logs in which the battery objects (a broken filter also where its NEES or NIS on twins is"
    " off) with its binomial standard error, and share in which NIS alone would; of the detected, the share put down to"
    " the right cause, and the cause most often named instead."
)


def size_table(study: Validation, found: Sequence[Examined]) -> pd.DataFrame:
    """A row for each world, and one for all."""
    rows: list[list[object]] = []
    sound = [e for e in found if e.fault == SOUND]
    for world in study.worlds:
        rows.append([world.name, world.task, *_size([e for e in sound if e.world == world.name])])
    if len(study.worlds) > 1:
        rows.append(["all", "", *_size(sound)])
    return pd.DataFrame(rows, columns=list(SIZE))


def _size(found: Sequence[Examined]) -> list[object]:
    good = [e for e in found if not e.failure]
    n, objected = len(good), sum(e.objected for e in good)
    lower, upper = share_interval(objected, n)
    causes = [_percent(sum(e.cause == c for e in good), n) for c in (NOISE, ASSOCIATIONS, ESTIMATOR)]
    interval = f"{100 * lower:.1f}…{100 * upper:.1f}" if n else ""
    nis = _percent(sum(e.nis for e in good), n)
    return [n, _percent(objected, n), interval, nis, *causes, len(found) - n]


def power_table(study: Validation, found: Sequence[Examined]) -> pd.DataFrame:
    """A row for each fault and size, first for logs without any; broken filters last."""
    rows = [_power("none", "", [e for e in found if e.fault == SOUND and e.world == study.power])]
    for (fault, size), own in _groups(found).items():
        unit = FAULTS[fault].unit if fault in FAULTS else ""
        called = fault if fault in FAULTS else f"filter: {fault}"
        rows.append(_power(called, f"{size:g} {unit}".rstrip(), own))
    return pd.DataFrame(rows, columns=list(POWER))


def _groups(found: Sequence[Examined]) -> dict[tuple[str, float], list[Examined]]:
    """Logs by fault and size, in the order of the lists of faults."""
    every = [(name, size) for faults in (FAULTS, BROKEN) for name, f in faults.items() for size in f.sizes]
    groups = {key: [e for e in found if (e.fault, e.size) == key] for key in every}
    return {key: own for key, own in groups.items() if own}


def detected(e: Examined) -> bool:
    """Whether a fault shows: the battery objects, or the NEES on twins is off where the filter is what is broken."""
    return e.objected or (e.convicted and e.fault in BROKEN)


def right_cause(fault: str) -> str:
    """What a fault must be put down to."""
    return FAULTS[fault].cause if fault in FAULTS else ESTIMATOR


def _power(called: str, size: str, found: Sequence[Examined]) -> list[object]:
    good = [e for e in found if not e.failure]
    seen = [e for e in good if detected(e)]
    n = len(good)
    share = len(seen) / n if n else math.nan
    error = math.sqrt(share * (1.0 - share) / n) if n else math.nan
    nis = _percent(sum(e.nis for e in good), n)
    right, other = math.nan, ""
    if seen and seen[0].fault != SOUND:
        cause = right_cause(seen[0].fault)
        wrong = [e.cause for e in seen if e.cause != cause]
        right = _percent(len(seen) - len(wrong), len(seen))
        other = max(sorted(set(wrong)), key=wrong.count) if wrong else ""
    return [called, size, n, 100.0 * share, 100.0 * error, nis, right, other, len(found) - n]


def _goal(study: Validation, found: Sequence[Examined]) -> str:
    """How many of the faults that are surely detected are put down to the right cause often enough."""
    sure, met = 0, 0
    for (fault, _), own in _groups(found).items():
        good = [e for e in own if not e.failure]
        seen = [e for e in good if detected(e)]
        if seen and len(seen) >= SURE * len(good):
            sure += 1
            met += sum(e.cause == right_cause(fault) for e in seen) >= GOAL * len(seen)
    return (
        f"In `{study.power}`, {sure} faults are detected in {100 * SURE:g} % of the logs or more; {met} of them are put"
        f" down to the right cause in {100 * GOAL:g} % of those or more."
    )


def _percent(hits: int, n: int) -> float:
    return 100.0 * hits / n if n else math.nan


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
    jobs: list[Job[tuple[int, int]]] = []
    for i, study in enumerate(studies):
        for task in study.scenario.task:
            for association in names_of(study.scenario.association):
                for kind in ("anees", "ends", "coverage"):
                    jobs.append(Job((i, len(jobs)), _picture, (folder, study, task, association, kind)))
    made = dict(work(jobs, options.execution))
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
