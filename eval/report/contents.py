"""What stands in the result folder: run files, CSVs, tables, figures, the report, and where it all came from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from data.log import folder_name
from eval.page.document import Block, Picture, ReportContent, Section, Table, write_report
from eval.page.numbers import number
from eval.page.tables import write_table
from eval.plan.execute import Outcome
from eval.plan.options import Options
from eval.plan.provenance import command_of, provenance
from eval.plan.tutorial import is_tutorial
from eval.referee.consistency import MIN_RUNS
from eval.referee.score import Scores, Trial, score
from eval.report import comparison
from eval.report import statements as words
from eval.report.corridor.questions import lab_sections
from eval.report.pictures import draw, kinds, publish_runs, stem
from eval.report.revisions import revision_section
from eval.report.studies import study_sections
from eval.report.tutorial_table import CAPTION, knowledge_table, logs_with_tutorials
from eval.report.visual.sections import visual_sections
from eval.studies.montecarlo import Judged, consistency_table
from eval.studies.reproduced import published_frame

READING = """\
* **Identical inputs.** Filter and smoother get the same preintegrated increments, readings, covariances, prior and
  gauge; nothing is aligned to the truth, unless a column says so.
* **Error** is estimate minus truth in the world frame, heading wrapped. **NEES** is its squared Mahalanobis distance
  under the estimator's own covariance; a consistent estimator has on average 3 for the pose, 2 for the position, 1 for
  the heading. Along one run errors are strongly correlated, so the mean over one run describes and proves nothing.
* **NIS per dof** compares the innovations with the covariance claimed for them; 1 is expected. For a smoother it is
  its least cost over the same degrees of freedom: for linear models that *is* the sum of the filter's NIS.
* **online**: each pose from the data up to its frame. **final**: every pose from all data (a filter does not revise
  its past, so it has no final row)."""


def write_results(
    folder: Path,
    options: Options,
    outcome: Outcome,
    judged: Sequence[Judged],
    arguments: Sequence[str],
    progress: Callable[[int, int], None],
) -> None:
    """Fill the result folder."""
    scores = score(outcome.trials)
    consistency = consistency_table(judged)
    tables = {"metrics": scores.metrics, "association": scores.association, "timing": scores.timing}
    for name, table in {**tables, "consistency": consistency}.items():
        table.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
    if outcome.published:
        published_frame(outcome.published).to_csv(folder / "published.csv", index=False, lineterminator="\n")
    (folder / "runs").mkdir()
    published = _publish_trials(folder, options, outcome.trials, progress)
    sections = [*_trial_sections(folder, options, outcome.trials, scores, published)]
    sections += visual_sections(folder, options, outcome.trials)
    sections += _knowledge_sections(folder, options, outcome.trials, scores)
    sections += study_sections(folder, options, outcome, judged)
    if outcome.trials:
        sections += _association_sections(folder, options, outcome.trials, scores, published)
        sections += revision_section(folder, options, outcome.trials)
        sections += [*lab_sections(outcome.trials, scores), _failure_section(outcome.trials)]
    sections += [Section("How to read the numbers", (READING,)), _source_section(outcome.trials, options)]
    introduction = _introduction(outcome.trials, scores, judged)
    write_report(
        folder,
        ReportContent(
            "Filter or smoother: which estimate can be trusted?", command_of(options), introduction, tuple(sections)
        ),
    )
    (folder / "provenance.json").write_text(
        provenance(options, {t.log.name: t.log for t in outcome.trials}.values(), arguments), encoding="utf-8"
    )


def _knowledge_sections(folder: Path, options: Options, trials: Sequence[Trial], scores: Scores) -> list[Section]:
    """For each log with several tutorials beside it: one table over all its tasks."""
    content: list[Block] = []
    for log in logs_with_tutorials(trials):
        table = knowledge_table(log, trials, scores)
        content.append(_table(folder, options, table, f"{folder_name(log)}-knowledge", CAPTION.format(log=log)))
    return [Section("From labels and map to nothing", tuple(content))] if content else []


def _table(folder: Path, options: Options, frame: pd.DataFrame, name: str, caption: str) -> Table:
    """Write a table in the formats asked for and hand it to the report."""
    write_table(frame, folder / "tables", name, caption, options.formats)
    return Table(frame, caption, name if "csv" in options.formats else None)


def _publish_trials(
    folder: Path, options: Options, trials: Sequence[Trial], progress: Callable[[int, int], None]
) -> list[list[Picture]]:
    """Write run files and pictures, each as a job of its own; returns the pictures of each trial."""
    jobs: list[Any] = []
    owner: list[int | None] = []
    for i, trial in enumerate(trials):
        others = beside(trial, trials)
        for kind in () if options.no_plots or _retold(trial, trials) else kinds(trial, others, quick=options.quick):
            jobs.append(delayed(draw)(folder, trial, kind, others, quick=options.quick))
            owner.append(i)
    for trial in trials:
        jobs.append(delayed(publish_runs)(folder, options, trial))
        owner.append(None)
    pictures: list[list[Picture]] = [[] for _ in trials]
    pool: Iterable[Any] = Parallel(n_jobs=min(options.jobs, max(len(jobs), 1)), return_as="generator")(jobs)
    for done, (whose, made) in enumerate(zip(owner, pool, strict=True), start=1):
        if whose is not None:
            pictures[whose].append(made)
        progress(done, len(jobs))
    return pictures


def beside(trial: Trial, trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """The trials that stand beside one."""
    if trial.beside is not None:
        return ()
    return tuple(t for t in trials if t.beside == trial.log.name and t.task == trial.task)


def _retold(trial: Trial, trials: Sequence[Trial]) -> bool:
    """Whether a trial is on the very recording of the one it stands beside, whose pictures show it."""
    return any(
        trial in beside(t, trials) and (t.log.recorded is trial.log.recorded or _seen_again(t, trial)) for t in trials
    )


def _seen_again(trial: Trial, other: Trial) -> bool:
    """Whether the other trial is on the same images, with other covariances."""
    return other.log.evidence is not None and other.log.evidence is trial.log.evidence


def _rows(frame: pd.DataFrame, trial: Trial) -> pd.DataFrame:
    return frame[(frame["log"] == trial.log.name) & (frame["task"] == trial.task)]


def _trial_sections(
    folder: Path, options: Options, trials: Sequence[Trial], scores: Scores, published: Sequence[Sequence[Picture]]
) -> list[Section]:
    """A section per log and task; a tutorial's row stands in the table of the log it belongs to."""
    sections = []
    for trial, pictures in zip(trials, published, strict=True):
        if trial.beside is not None:
            continue
        rows = _rows(scores.metrics, trial)
        content: list[Block] = []
        others = beside(trial, trials)
        table = comparison.comparison_table(pd.concat([rows, *(_rows(scores.metrics, t) for t in others)]))
        caption = f"{trial.log.name}, {trial.task}. {comparison.COMPARISON_CAPTION}"
        content.append(_table(folder, options, table, stem(trial, "comparison"), caption))
        content += [_beside_note(t, _rows(scores.metrics, t)) for t in others]
        content += [p for p in pictures if p.stem != stem(trial, "association")]
        notes = [*trial.log.notes, *(f"{r.estimator}: {n}." for r in trial.runs for n in r.notes)]
        if notes:
            content.append("\n".join(f"* {n}" for n in dict.fromkeys(notes)))
        sections.append(Section(f"{trial.log.name}, {trial.task}", tuple(content)))
    return sections


def _beside_note(trial: Trial, rows: pd.DataFrame) -> str:
    """What the rows of a trial beside are; for a tutorial the sums of squares it prints, and what is not reproduced."""
    told = [f"`{trial.log.name}` is {trial.about}."]
    if not is_tutorial(trial):
        return told[0]
    for row in rows.to_dict("records"):
        for column, what in (("sse_position_m2", "positions"), ("sse_landmark_m2", "landmarks")):
            if row[column] is not None:
                told.append(f"Sum of squared errors of {what}: {number(float(row[column]))} m².")
    return " ".join([*told, *trial.runs[0].notes])


def _association_sections(
    folder: Path,
    options: Options,
    trials: Sequence[Trial],
    scores: Scores,
    published: Sequence[Sequence[Picture]],
) -> list[Section]:
    """Decisions of every log where some were made without labels, and in one table the logs with labels alone."""
    head = "Data association"
    if not len(scores.association):
        return [Section(head, ("No log states which landmark each observation shows, so decisions cannot be scored.",))]
    content: list[Block] = [comparison.ASSOCIATION_CAPTION]
    sections, granted = [], []
    for trial, pictures in zip(trials, published, strict=True):
        if trial.beside is not None:
            continue
        rows = pd.concat([_rows(scores.association, t) for t in (trial, *beside(trial, trials))])
        if not (rows["association"] != "known").any():
            granted.append(rows)
            continue
        table = comparison.association_table(rows)
        name, what = stem(trial, "association"), f"{trial.log.name}, {trial.task}"
        shown = [p for p in pictures if p.stem == name]
        caption = f"{what}: outcomes of the decisions, as explained above."
        sections.append(Section(f"Decisions: {what}", (_table(folder, options, table, name, caption), *shown), level=3))
    if granted and any(len(rows) for rows in granted):
        content.append(
            "With known association the labels decide: a wrong pairing is a wrong label, a missed one was gated out."
        )
        table = comparison.association_table(pd.concat(granted))
        caption = "Logs on which only known association was run: outcomes of the decisions."
        content.append(_table(folder, options, table, "association", caption))
    return [Section(head, tuple(content)), *sections]


def _failure_section(trials: Sequence[Trial]) -> Section:
    told = [
        words.failure_statement(
            t.log.name, t.task, r.estimator, r.association, r.status, r.failure.frame, r.failure.why
        )
        for t in trials
        for r in t.runs
        if r.failure is not None
    ]
    text = "\n".join(f"* {line}" for line in told) if told else "Every estimator got to the end of every log."
    return Section("Failures", (text,))


def _introduction(trials: Sequence[Trial], scores: Scores, judged: Sequence[Judged]) -> tuple[Block, ...]:
    told = ["The same logs, the same inputs, one referee."]
    for trial in trials:
        if trial.beside is None:
            rows = (_rows(scores.metrics, trial), _rows(scores.association, trial))
            told.append(f"* **{trial.log.name}, {trial.task}.** {words.answer(*rows, _labelled(trial))}")
    declared = [j for j in judged if j.declared and j.verdict.runs >= MIN_RUNS]
    if declared:
        off = [j for j in declared if j.verdict.word != "consistent" or j.diverged]
        which = ", ".join(f"{j.key[1]} {j.quantity} ({j.key[0]}, {j.key[3]}: {j.verdict.word})" for j in off)
        told.append(
            f"* **Consistency.** Of {len(declared)} verdicts declared to be consistent, {len(declared) - len(off)} are"
            f"{f'; not {which}' if off else ''}. Each is a 95 % test, so one in twenty fails by chance; the exit status"
            " uses a family-wise test at 0.1 %."
        )
    return (told[0], "\n".join(told[1:])) if len(told) > 1 else (told[0],)


def _labelled(trial: Trial) -> int | None:
    """Number of landmarks that the log's ids tell apart."""
    true_id = trial.log.truth.landmark_of
    return None if true_id is None else len(np.unique(true_id[true_id >= 0]))


def _source_section(trials: Sequence[Trial], options: Options) -> Section:
    told = []
    for log in {t.log.name: t.log for t in trials}.values():
        kind = log.source.get("kind", "open log folder")
        r = log.recorded
        labels = " Labels are sensed." if log.labels_are_sensed else ""
        told.append(
            f"* `{log.name}` ({kind}): {len(r)} frames, {len(r.observations.frame)} observations, sensor"
            f" `{r.sensor.name}`, {log.truth.known_poses} frames with truth, {r.floored} increments raised to"
            f" the covariance floor.{labels}"
        )
    gate = "none" if options.gate_known is None else f"{options.gate_known:g}"
    told.append(
        f"* Gate for labelled readings: {gate}. Versions, command and checksums of the inputs: `provenance.json`."
    )
    return Section("Logs and settings", ("\n".join(told),))
