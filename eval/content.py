"""What stands in the result folder: run files, CSVs, tables, figures, the report, and where it all came from."""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import pandas as pd
from joblib import Parallel, delayed
from matplotlib.figure import Figure

from data.log import Log
from eval import comparison, figures, words
from eval.consistency import MIN_RUNS
from eval.montecarlo import DOF, Judged, Study, consistency_table
from eval.options import Options, Variant
from eval.report import Block, Picture, ReportContent, Section, Table, write_report
from eval.run_files import folder_name, write_run
from eval.score import Scores, Trial, score
from eval.style import save
from eval.suite import Outcome
from eval.tables import write_table

PACKAGES = ("gtsam", "numpy", "scipy", "numba", "pandas", "matplotlib", "opencv-python-headless")
READING = """\
* **Identical inputs.** Filter and smoother get the same preintegrated increments, readings, covariances, prior and
  gauge; nothing is aligned to the truth, unless a column says so.
* **Error** is estimate minus truth in the world frame, heading wrapped. **NEES** is its squared Mahalanobis distance
  under the estimator's own covariance; a consistent estimator has on average 3 for the pose, 2 for the position, 1 for
  the heading. Along one run errors are strongly correlated, so the mean over one run describes and proves nothing.
* **NIS per dof** compares the innovations with the covariance claimed for them; 1 is expected. For a smoother it is
  the minimum of its cost over the same degrees of freedom: for linear models that minimum *is* the sum of the filter's NIS.
* **online**: each pose from the data up to its frame. **final**: every pose from all data (a filter does not revise
  its past, so it has no final row)."""


@dataclass(frozen=True)
class _Published:
    """Where a trial's pictures went."""

    pictures: tuple[Picture, ...]


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
    consistency = consistency_table(outcome.study.scenario if outcome.study else "", judged)
    for name, table in (
        ("metrics", scores.metrics), ("association", scores.association), ("consistency", consistency), ("timing", scores.timing),
    ):  # fmt: skip
        table.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
    (folder / "runs").mkdir()
    published = _publish_trials(folder, options, outcome.trials, progress)
    sections = [*_trial_sections(folder, options, outcome.trials, scores, published)]
    if outcome.study is not None:
        sections.append(_study_section(folder, options, outcome.study, judged, consistency))
    sections += [_association_section(folder, options, scores), _failure_section(outcome.trials)]
    sections += [Section("How to read the numbers", (READING,)), _source_section(outcome.trials, options)]
    introduction = _introduction(outcome.trials, scores, judged)
    write_report(folder, ReportContent("Filter or smoother: which estimate can be trusted?", command_of(options), introduction, tuple(sections)))
    (folder / "provenance.json").write_text(_provenance(options, outcome, arguments), encoding="utf-8")


def command_of(options: Options) -> str:
    """The command that makes the same numbers again (output folder and number of processes do not matter to them)."""
    parts = ["python -m eval.run_all"]
    default = Options()
    for name in ("log", "data"):
        parts += [f"--{name} {v}" for v in getattr(options, name)]
    for name in ("task", "estimator", "association"):
        if getattr(options, name) != getattr(default, name) and getattr(options, name):
            parts.append(f"--{name} {','.join(getattr(options, name))}")
    parts += [f"--config {v.name}" for v in options.variants]
    for name in ("gate", "gate_known"):
        if getattr(options, name) != getattr(default, name):
            value = getattr(options, name)
            parts.append(f"--{name.replace('_', '-')} {'none' if value is None else format(value, 'g')}")
    if options.runs is not None:
        parts.append(f"--runs {options.runs}")
    if options.seed:
        parts.append(f"--seed {options.seed}")
    parts += ["--quick"] * options.quick
    return " ".join(parts)


def _variant(trial: Trial, options: Options) -> Variant | None:
    return next((v for v in options.variants if trial.log.name.endswith(f":{v.name}")), None)


def _stem(trial: Trial, what: str) -> str:
    return f"{folder_name(trial.log.name)}-{trial.task}-{what}"


def _publish_trials(
    folder: Path, options: Options, trials: Sequence[Trial], progress: Callable[[int, int], None]
) -> list[_Published]:
    jobs = [delayed(_publish)(folder, options, trial) for trial in trials]
    pool = Parallel(n_jobs=min(options.jobs, max(len(jobs), 1)), return_as="generator")
    result = []
    for done, published in enumerate(pool(jobs), start=1):
        result.append(published)
        progress(done, len(jobs))
    return result


def _publish(folder: Path, options: Options, trial: Trial) -> _Published:
    """Run files and pictures of one trial."""
    for run in trial.runs:
        write_run(folder, trial, run)
        if options.animate and run.failure is None:
            from eval.animate import animate

            animate(trial.log, run, folder / "figures" / f"{_stem(trial, run.estimator)}.mp4")
    if options.no_plots:
        return _Published(())
    return _Published(tuple(_pictures(folder / "figures", trial)))


def _pictures(place: Path, trial: Trial) -> list[Picture]:
    log, whole = trial.log, [r for r in trial.runs if r.failure is None]
    shown = [r for r in whole if r.estimator != "dead-reckoning"]
    made = []

    def add(what: str, figure: Figure, caption: str, alt: str) -> None:
        save(figure, place, _stem(trial, what))
        made.append(Picture(_stem(trial, what), caption, alt))

    where = f"`{log.name}`, {trial.task}"
    add(
        "map", figures.map_figure(log, trial.runs),
        f"{where}: paths and landmarks with 3σ ellipses. World frame, no alignment.",
        f"Map of {log.name} with the paths of {', '.join(r.estimator for r in trial.runs)}",
    )  # fmt: skip
    if not shown:
        return made
    reference = trial.find("batch")
    if log.truth.known_poses:
        add(
            "error", figures.error_figure(log, shown),
            f"{where}: error of each coordinate with the estimator's own ±3σ. A consistent error stays inside nearly always.",
            f"Errors over time on {log.name} in x, y and heading, one column per estimator",
        )  # fmt: skip
        add(
            "nees", figures.nees_figure(log, shown),
            f"{where}: NEES of the pose at each frame; 95 % of the values of a consistent estimator lie in the band. One run: a description.",
            f"Pose NEES over time on {log.name}",
        )  # fmt: skip
    elif reference is not None and reference.failure is None and len(shown) > 1:
        others = [r for r in shown if r is not reference]
        add(
            "difference", figures.difference_figure(log, others, reference),
            f"{where}: distance from the batch solution, with each run's own 3σ. The log has no true path: this is no error.",
            f"Distance from the batch solution over time on {log.name}",
        )  # fmt: skip
    return made


def _rows(frame: pd.DataFrame, trial: Trial) -> pd.DataFrame:
    return frame[(frame["log"] == trial.log.name) & (frame["task"] == trial.task)]


def _trial_sections(
    folder: Path, options: Options, trials: Sequence[Trial], scores: Scores, published: Sequence[_Published]
) -> list[Section]:
    sections = []
    merged = [t for t in trials if _variant(t, options) is None]
    for trial, done in zip(trials, published, strict=True):
        if trial not in merged:
            continue
        rows = _rows(scores.metrics, trial)
        content: list[Block] = [words.answer(rows)]
        variants = [t for t in trials if t.log.name.startswith(f"{trial.log.name}:") and t.task == trial.task]
        if variants:
            rows = pd.concat([rows, *(_rows(scores.metrics, t) for t in variants)])
        table = comparison.comparison_table(rows)
        stem = _stem(trial, "comparison")
        caption = f"{trial.log.name}, {trial.task}. {comparison.COMPARISON_CAPTION}"
        write_table(table, folder / "tables", stem, caption, options.formats)
        content.append(Table(table, caption, stem if "csv" in options.formats else None))
        for other in variants:
            content.append(_tutorial_note(other, rows))
        content += list(done.pictures)
        notes = [*trial.log.notes, *(f"{r.estimator}: {n}." for r in trial.runs for n in r.notes if n)]
        if notes:
            content.append("\n".join(f"* {n}" for n in dict.fromkeys(notes)))
        sections.append(Section(f"{trial.log.name}, {trial.task}", tuple(content)))
    return sections


def _tutorial_note(trial: Trial, rows: pd.DataFrame) -> str:
    """The sums of squares that the tutorials print, and what of them is not reproduced."""
    mine = rows[rows["log"] == trial.log.name]
    told = [f"`{trial.log.name}`: the recording with the classic tutorial's numbers."]
    for _, row in mine.iterrows():
        if row["sse_position_m2"] is not None:
            told.append(f"Sum of squared position errors over its {row['frames']} frames: {words.number(float(row['sse_position_m2']))} m².")
        if row["sse_landmark_m2"] is not None:
            told.append(f"Sum of squared landmark errors: {words.number(float(row['sse_landmark_m2']))} m².")
    return " ".join([*told, *trial.runs[0].notes])


def _study_section(
    folder: Path, options: Options, study: Study, judged: Sequence[Judged], consistency: pd.DataFrame
) -> Section:
    runs = len(study.seeds)
    content: list[Block] = [
        f"{runs} simulated logs of the arena (seeds {study.seeds[0]} to {study.seeds[-1]}), the prior's mean drawn from the prior. "
        "Declared to be consistent: localization with `ekf`, `isam2` and `batch`, in pose, position and heading. "
        "EKF-SLAM is inconsistent by nature once the heading is uncertain, so its verdicts are reported, not demanded."
    ]
    if runs < MIN_RUNS:
        content.append(f"With fewer than {MIN_RUNS} runs there is no verdict: a wrong covariance would pass too often.")
    write_table(comparison.consistency_table(consistency), folder / "tables", "consistency", comparison.CONSISTENCY_CAPTION, options.formats)
    content.append(Table(comparison.consistency_table(consistency), comparison.CONSISTENCY_CAPTION, "consistency" if "csv" in options.formats else None))
    if not options.no_plots:
        for task in dict.fromkeys(j.key[0] for j in judged):
            average = study.anees(task, {"ekf": "online", "isam2": "online", "batch": "final"})
            stem = f"arena-{task}-anees"
            save(figures.anees_figure(study.time, average, DOF["pose"], runs, title=f"arena, {task}"), folder / "figures", stem)
            caption = f"Arena, {task}: pose NEES averaged over {runs} runs (ekf and isam2 online, batch final). 5 % of the steps of a consistent estimator lie outside the band."
            content.append(Picture(stem, caption, f"Average pose NEES over time, {task}"))
    return Section("Consistency over many simulated runs", tuple(content))


def _association_section(folder: Path, options: Options, scores: Scores) -> Section:
    if not len(scores.association):
        return Section("Data association", ("No log states which landmark each observation shows, so decisions cannot be scored.",))
    table = comparison.association_table(scores.association)
    write_table(table, folder / "tables", "association", comparison.ASSOCIATION_CAPTION, options.formats)
    text = "Under known association the labels decide, so wrong pairings are wrong labels, and missed ones were gated out."
    return Section("Data association", (text, Table(table, comparison.ASSOCIATION_CAPTION, "association" if "csv" in options.formats else None)))


def _failure_section(trials: Sequence[Trial]) -> Section:
    told = [
        words.failure_statement(t.log.name, t.task, r.estimator, r.association, r.status, r.failure.frame, r.failure.why)
        for t in trials
        for r in t.runs
        if r.failure is not None
    ]
    text = "\n".join(f"* {line}" for line in told) if told else "Every estimator got to the end of every log."
    return Section("Failures", (text,))


def _introduction(trials: Sequence[Trial], scores: Scores, judged: Sequence[Judged]) -> tuple[Block, ...]:
    told = ["The same logs, the same inputs, one referee."]
    for trial in trials:
        if trial.find("dead-reckoning") or len(trial.runs) > 1:
            told.append(f"* **{trial.log.name}, {trial.task}.** {words.answer(_rows(scores.metrics, trial))}")
    declared = [j for j in judged if j.declared and j.verdict.runs >= MIN_RUNS]
    if declared:
        off = [j for j in declared if j.verdict.word != "consistent" or j.diverged]
        told.append(
            f"* **Consistency.** Of {len(declared)} verdicts declared to be consistent, {len(declared) - len(off)} are"
            + (" at the 95 % level" if not off else f"; not: {', '.join(f'{j.key[1]} {j.quantity} ({j.key[0]}, {j.key[3]}): {j.verdict.word}' for j in off)}")
            + ". Each is a 95 % test, so one in twenty fails by chance; the exit status uses a family-wise test at 0.1 %."
        )
    return (told[0], "\n".join(told[1:])) if len(told) > 1 else (told[0],)


def _source_section(trials: Sequence[Trial], options: Options) -> Section:
    told = []
    for log in {t.log.name: t.log for t in trials}.values():
        kind = log.source.get("kind", "open log folder")
        r = log.recorded
        labels = " Labels are sensed." if log.labels_are_sensed else ""
        told.append(
            f"* `{log.name}` ({kind}): {len(r)} frames, {len(r.observations.frame)} observations, sensor `{r.sensor.name}`, "
            f"{log.truth.known_poses} frames with truth, {r.floored} increments raised to the covariance floor.{labels}"
        )
    gate = "none" if options.gate_known is None else f"{options.gate_known:g}"
    told.append(f"* Gate for labelled readings: {gate}. Versions, command and checksums of the inputs: `provenance.json`.")
    return Section("Logs and settings", ("\n".join(told),))


def _provenance(options: Options, outcome: Outcome, arguments: Sequence[str]) -> str:
    logs = {t.log.name: t.log for t in outcome.trials}
    content = {
        "command": ["python", "-m", "eval.run_all", *arguments],
        "versions": {
            "slamref": version("slamref"), "python": platform.python_version(), **{p: version(p) for p in PACKAGES},
        },
        "platform": f"{sys.platform} {platform.machine()}",
        "seed": options.seed,
        "inputs": {name: {**_plain(log), "sha256": input_digest(log)} for name, log in logs.items()},
    }  # fmt: skip
    return json.dumps(content, indent=2, sort_keys=True) + "\n"


def _plain(log: Log) -> dict[str, object]:
    return {str(k): v if isinstance(v, (str, int, float, bool, list)) or v is None else str(v) for k, v in log.source.items()}


def input_digest(log: Log) -> str:
    """sha256 over everything the estimators and the referee were given, whatever file it came from."""
    digest = hashlib.sha256()
    r, t = log.recorded, log.truth
    arrays = [r.prior.mean, r.prior.covariance, r.time, r.increments.mean, r.increments.covariance]
    arrays += [r.observations.frame, r.observations.z, r.observations.R]
    for extra in (log.label, t.pose, t.landmark_of):
        if extra is not None:
            arrays.append(extra)
    for landmarks in (r.map, t.landmarks):
        if landmarks is not None:
            arrays += [landmarks.id, landmarks.xy]
    for array in arrays:
        digest.update(str(array.shape).encode())
        digest.update(array.tobytes())
    digest.update(repr(r.sensor).encode())
    return digest.hexdigest()
