"""What stands in the result folder: run files, CSVs, tables, figures, the report, and where it all came from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data.notice import Notice
from data.terminal import counted
from data.words import sentence
from eval.plan.execute import Outcome
from eval.plan.flags.options import Options
from eval.plan.provenance import command_of, provenance
from eval.plan.tutorials import is_tutorial
from eval.plan.unfinished import NOBODY, Unfinished
from eval.plan.work import Job, work
from eval.player.document import played, write_player
from eval.referee import result_files
from eval.referee.consistency import MIN_RUNS
from eval.referee.diagnostics import notices, notices_table, origin, unused
from eval.referee.given_runs import GivenRun, is_truth_alone
from eval.referee.score import Scores, Trial, score
from eval.report.answer import answer, failure_statement, gate_sentence
from eval.report.deciding import revision_section
from eval.report.diagnostics import of_runs, questions_section, said
from eval.report.headline import Headlines, headlines
from eval.report.labs.sections import hand_in, lab_sections
from eval.report.labs.write_up import write_up
from eval.report.laser import against_relations, laser_sections
from eval.report.log_sections import association_sections, beside, rows_of, trial_sections
from eval.report.overview import attribution_sections, compared, concluded, gauge_statement, in_short, overview
from eval.report.overview_facts import Facts, facts_of
from eval.report.page.document import READING, Block, Folded, Picture, Report, Section, write_report
from eval.report.pictures import draw, kinds, publish_runs
from eval.report.results import results_statement
from eval.report.rows import rows_of as report_rows
from eval.report.run_files import write_truths
from eval.report.studies import study_sections
from eval.report.trust import first_said
from eval.report.tutorials import tutorial_sections
from eval.report.visual import visual_sections
from eval.studies.montecarlo import Judged, consistency_table
from eval.studies.reproduced import published_frame
from eval.studies.trusted import trust_table

BASICS = """\
* **Identical inputs.** Filter and smoother get the same preintegrated increments, readings, covariances, prior and
  gauge; nothing is aligned to the truth, unless a column says so.
* **Error** is estimate minus truth in the world frame, heading wrapped. **NEES** is its squared Mahalanobis distance
  under the estimator's own covariance; a consistent estimator has on average 3 for the pose, 2 for the position, 1 for
  the heading. Along one run errors are strongly correlated, so the mean over one run describes and proves nothing.
* **NIS per dof** compares the innovations with the covariance claimed for them; 1 is expected. For a smoother it is
  its least cost over the same degrees of freedom: for linear models that *is* the sum of the filter's NIS.
* **online**: each pose from the data up to its frame. **final**: every pose from all data (a filter does not revise
  its past, so it has no final row)."""

IMPLAUSIBLE_RUNS = (
    "An implausible run got to its end, but with a number that no honest run gives: innovations ten times as large as"
    " claimed, a path longer than was driven, landmarks where the sensor cannot have seen them, or a claimed doubt"
    " larger than the world. No truth is used. Its numbers are in the tables, and in no average and no comparison."
)


class Written(NamedTuple):
    """What is missing from a result folder for want of memory, and the lines of its main numbers."""

    missing: tuple[Notice, ...]
    headlines: Headlines


def write_results(
    folder: Path,
    options: Options,
    outcome: Outcome,
    judged: Sequence[Judged],
    arguments: Sequence[str],
    progress: Callable[[int, int], None],
) -> Written:
    """Fill the result folder."""
    lost = Unfinished(options.execution.jobs, said=list(outcome.missing))
    scores = score(outcome.trials)
    found = notices(outcome.trials, scores)
    consistency = consistency_table(judged)
    for file, table in (
        (result_files.METRICS, scores.metrics),
        (result_files.DECISION_COUNTS, scores.association),
        (result_files.TIMING, scores.timing),
        (result_files.CONSISTENCY, consistency), (result_files.TRUST, trust_table(outcome.trust)),
    ):  # fmt: skip
        file.write(table, folder)
    found += [n.about(log=t.log, task=t.task, association=t.association) for t in outcome.trust for n in t.notices]
    if len(scores.relations):
        result_files.RELATIONS.write(scores.relations, folder)
    if outcome.published:
        result_files.PUBLISHED.write(published_frame(outcome.published), folder)
    (folder / "runs").mkdir()
    write_truths(folder, outcome.trials)
    published = _publish_trials(folder, options, outcome.trials, lost, progress)
    main = [t for t in outcome.trials if t.beside is None]
    facts = [facts_of(t, scores, outcome.trust) for t in main]
    told = {(f.trial.log.name, f.trial.task): _told(f, outcome, scores) for f in facts}
    answers = hand_in(folder, options, outcome.trials, scores, lost)
    first = [*answers, *attribution_sections(facts)]
    sections = questions_section(found)
    sections += trial_sections(
        folder, options, outcome.trials, scores, published, outcome.trust, told, outcome.calibrations
    )
    sections += laser_sections(folder, options, outcome.trials, published)
    sections += visual_sections(
        folder, options, outcome.trials, in_lab=options.lab is not None, factor=options.ellipse_factor
    )
    sections += tutorial_sections(folder, options, outcome.trials, scores)
    sections += study_sections(folder, options, outcome, judged)
    if outcome.trials:
        sections += association_sections(folder, options, outcome.trials, scores, published)
        sections += revision_section(folder, options, outcome.trials)
        sections += lab_sections(outcome.trials, scores, answered_above=bool(answers))
    if outcome.trials or lost.said:
        sections.append(_failure_section(outcome.trials, lost.said))
    sections += [Section(READING, (BASICS,)), _source_section(outcome.trials, options)]
    shown = (overview(facts, folder, drawn=not options.no_plots),) if facts else ()
    introduction: tuple[Block, ...] = (f"{compared(facts)} {concluded(facts)}".strip(), *shown, *_declared(judged))
    if options.write_up:
        write_up(folder, outcome.trials, scores, answers, sections)
    write_report(
        folder,
        Report(
            "Filter or smoother: which estimate can be trusted?",
            command_of(options),
            introduction,
            tuple(sections),
            tuple(first),
        ),
    )
    (folder / "provenance.json").write_text(
        provenance(
            options,
            {t.log.name: t.log for t in outcome.trials}.values(),
            arguments,
            _foreign(options, outcome),
            _results(outcome.trials),
        ),
        encoding="utf-8",
    )
    result_files.NOTICES.write(notices_table([*found, *lost.said]), folder)
    return Written(tuple(lost.said), headlines(scores, outcome.trials, outcome.studies, judged))


def _results(trials: Sequence[Trial]) -> dict[str, dict[str, str]]:
    """The files of each result that was handed in, with their digests."""
    found: dict[str, dict[str, str]] = {}
    for run in (r for t in trials for r in t.runs if isinstance(r, GivenRun)):
        found.setdefault(run.estimator, {}).update(run.source)
    return found


def _foreign(options: Options, outcome: Outcome) -> list[str]:
    """Estimators and ways of association that were used, by flag and scenario file."""
    studied = [s.scenario for s in outcome.studies]
    return [
        *options.estimator,
        *options.association,
        *(m.name for s in studied for m in s.members),
        *(a for s in studied for a in s.association),
    ]


def _publish_trials(
    folder: Path, options: Options, trials: Sequence[Trial], lost: Unfinished, progress: Callable[[int, int], None]
) -> list[list[Picture]]:
    """Write run files and pictures, each as a job of its own; returns the pictures of each trial."""
    jobs: list[Job[tuple[int, int]]] = []
    for i, trial in enumerate(trials):
        others = beside(trial, trials)
        drawn = not (options.no_plots or _shown_elsewhere(trial, trials))
        for place, kind in enumerate(kinds(trial, others, quick=options.quick) if drawn else ()):
            jobs.append(Job((i, place), partial(draw, quick=options.quick), (folder, trial, kind, others)))
    for i, trial in enumerate(trials):
        jobs.append(Job((i, -1), publish_runs, (folder, options, trial)))
    for group in () if options.no_plots else played(trials):
        jobs.append(Job((trials.index(group[0]), -2), write_player, (folder, group, options.setup)))
    made: dict[tuple[int, int], Picture] = {}

    def missing(owner: tuple[int, int], why: Notice) -> None:
        what = {-1: "files", -2: "player"}.get(owner[1], "picture")
        lost.say(what, why, NOBODY.about(log=trials[owner[0]].log.name, task=trials[owner[0]].task))

    for done, (owner, picture) in enumerate(work(jobs, options.execution, lost=missing), start=1):
        if owner[1] >= 0:
            made[owner] = picture
        progress(done, len(jobs))
    return [[made[owner] for owner in sorted(made) if owner[0] == i] for i in range(len(trials))]


def _shown_elsewhere(trial: Trial, trials: Sequence[Trial]) -> bool:
    """Whether a trial is on the very recording of the one it stands beside, whose pictures show it."""
    return any(
        trial in beside(t, trials) and (t.log.recorded is trial.log.recorded or _seen_again(t, trial)) for t in trials
    )


def _seen_again(trial: Trial, other: Trial) -> bool:
    """Whether the other trial is on the same images, with other covariances."""
    return other.log.evidence is not None and other.log.evidence is trial.log.evidence


def _failure_section(trials: Sequence[Trial], missing: Sequence[Notice]) -> Section:
    notes = []
    for t, r in [(trial, run) for trial in trials for run in trial.runs]:
        if r.flaw is not None:
            stop = failure_statement(t.log.name, t.task, r.estimator, r.association, r.status, r.flaw.frame, r.flaw.why)
            where = origin(r, t)
            began = "" if where is None else sentence(where)
            notes.append("; ".join(part for part in (stop, began) if part))
    blocks = ["\n".join(f"* {line}" for line in notes)] if notes else ["Every estimator got to the end of every log."]
    if any(r.doubt is not None for t in trials for r in t.runs):
        blocks.append(IMPLAUSIBLE_RUNS)
    if missing:
        blocks.append("Missing for want of memory:\n\n" + "\n".join(f"* {said(n)}" for n in missing))
    return Section("Failures", tuple(blocks))


def _told(f: Facts, outcome: Outcome, scores: Scores) -> tuple[Block, ...]:
    """Filter and smoother on one log and task: at most three lines in front, in full below."""
    trial = f.trial
    metrics, decided, differences = (
        rows_of(table, trial) for table in (scores.metrics, scores.association, scores.differences)
    )
    said = answer(metrics, decided, _labelled(trial), differences, first_said(trial, outcome.trust))
    theirs = results_statement(trial, report_rows(metrics))
    said = "" if theirs and is_truth_alone(trial.log) else said
    text = " ".join(s for s in (against_relations(trial), said, theirs) if s)
    nothing = " ".join(of_runs(map(unused, trial.runs)))
    front = " ".join(s for s in (in_short(f), nothing or gauge_statement(f)) if s)
    return (front, Folded("Filter and smoother in full", (text,))) if text else (front,)


def _declared(judged: Sequence[Judged]) -> tuple[Block, ...]:
    """How the verdicts that scenarios declare came out."""
    declared = [j for j in judged if j.declared and j.verdict.runs >= MIN_RUNS]
    if not declared:
        return ()
    off = [j for j in declared if j.verdict.word != "consistent" or j.diverged]
    which = [f"{j.key[1]} {j.quantity} ({j.key[0]}, {j.key[3]}: {j.verdict.word})" for j in off]
    said = f"**Simulated runs.** Of {len(declared)} verdicts declared to be consistent, {len(declared) - len(off)} are."
    more = [f"Not: {', '.join(which)}."] if which else []
    more.append(
        "Each is a 95 % test, so one in twenty fails by chance; the exit status uses a family-wise test at 0.1 %."
    )
    return (said, Folded("Which, and what that means", (" ".join(more),)))


def _labelled(trial: Trial) -> int | None:
    """Number of landmarks that the log's ids tell apart."""
    true_id = trial.log.truth.landmark_of
    return None if true_id is None else len(np.unique(true_id[true_id >= 0]))


def _source_section(trials: Sequence[Trial], options: Options) -> Section:
    notes, tutorials = [], {t.log.name for t in trials if is_tutorial(t)}
    for log in {t.log.name: t.log for t in trials}.values():
        kind = log.source.get("kind", "open log folder")
        r = log.recorded
        labels = " Labels are sensed." if log.labels_are_sensed else ""
        if log.has_labels and log.name not in tutorials:  # those gate nothing
            labels += f" {gate_sentence(options.setup, sensed=log.labels_are_sensed)}"
        notes.append(
            f"* `{log.name}` ({kind}): {counted(len(r), 'frame')}, {counted(len(r.observations.frame), 'observation')},"
            f" sensor `{r.sensor.name}`, {counted(log.truth.known_poses, 'frame')} with truth,"
            f" {counted(r.floored, 'increment')} raised to"
            f" the covariance floor.{labels}"
        )
    notes.append("* Versions, command and checksums of the inputs: `provenance.json`.")
    return Section("Logs and settings", ("\n".join(notes),))
