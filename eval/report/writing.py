"""The result folder: tables, figures, provenance, the report with its sections on each log, and the facts of all."""

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence, Set as AnySet
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from data.notice import Code, Notice, Severity
from data.origin import assumed
from data.wing import of_all
from data.words import sentence, title
from eval.figures.kinds import DETAILS, FRONT, aligned_statement
from eval.judgement.judgement import Comparison, Judgement, conclusion
from eval.plan.execute import Outcome
from eval.plan.experiment import Unfinished
from eval.plan.flags.table import Options, Output
from eval.plan.provenance import command_of, provenance
from eval.referee import result_files
from eval.referee.consistency import CONSISTENT, MIN_RUNS
from eval.referee.diagnostics import notices_table
from eval.referee.given.runs import GivenRun, is_truth_alone
from eval.referee.plausibility import IMPLAUSIBLE
from eval.referee.result_files import heads, rows_of
from eval.referee.score import Scores, Trial
from eval.replay.settings import Setup
from eval.report import comparison
from eval.report.diagnosis import first_page_words, source_section, systematic_section, trust_section
from eval.report.overview import attribution_sections, gauge_statement, in_short, introduction, overview
from eval.report.page.blocks import READING, Block, Folded, Picture, Report, Section, Table
from eval.report.page.files import stem, variants, written_table
from eval.report.publish import films_of, publish, write_truths
from eval.report.render import write_report
from eval.report.results import space_rows, space_tables
from eval.report.studies import study_sections
from eval.report.terminal import Results, flaws_of
from eval.report.words import LOST, described, fine_print, of_runs, one_line, paragraph, say, status_of, together, whose
from eval.studies.diagnosis import Trust, trust_table
from eval.studies.montecarlo import Judged, consistency_table

FEW = 3  # warnings in front of the folded ones
TITLE = "Filter or smoother: which estimate can be trusted?"


def write_results(
    folder: Path, options: Options, found: Results, command: Sequence[str], progress: Callable[[int, int], None]
) -> tuple[list[Notice], list[str]]:
    """Fill the result folder; what is missing from it for lack of memory, and a lab's answers in a line each."""
    outcome, scores, judged = found.outcome, found.scores, found.judged
    trials, output = outcome.trials, options.output
    lost = Unfinished(options.execution.jobs, messages=list(outcome.missing))
    tables = {
        result_files.METRICS: scores.metrics, result_files.DECISION_COUNTS: scores.association,
        result_files.TIMING: scores.timing, result_files.CONSISTENCY: consistency_table(judged),
        result_files.TRUST: trust_table(outcome.trust),
        result_files.RELATIONS: scores.relations if len(scores.relations) else None,
        result_files.SOURCES: scores.sources if len(scores.sources) else None,
        result_files.SPACE: result_files.SPACE.table(rows) if (rows := space_rows(trials)) else None,
        result_files.PUBLISHED: result_files.PUBLISHED.table(outcome.published) if outcome.published else None,
    }  # fmt: skip
    for file, table in tables.items():
        if table is not None:
            file.write(table, folder)
    (folder / "runs").mkdir()
    write_truths(folder, trials)
    published = publish(folder, output, options.setup, trials, lost, options.execution, progress)
    main = [(t, j) for t, j in found.judgements if t.variant_of is None]
    facts = [j for _, j in main]
    answers = [s for hand_in in of_all("hand_in") for s in hand_in(folder, options, trials, scores, lost)]
    first = [*answers, *attribution_sections(main, outcome.trust)]
    sections = warnings_section(found.notices)
    in_lab, factor = options.selection.lab is not None, output.ellipse_factor
    sections += trial_sections(folder, output, trials, facts, scores, published, found.notices, outcome.trust)
    for of_wing in of_all("sections"):
        sections += of_wing(folder, output, trials, published, in_lab, factor)
    sections += study_sections(folder, options, outcome, judged)
    if trials:
        sections += association_sections(folder, output, trials, scores)
    sections += _failure_section(trials, found.notices, lost.messages)
    sections += [_source_section(trials, options.setup), Section(READING, (say("reading#basics"),))]
    declared = _declared(judged)
    blocks: list[Block] = [introduction(facts)]
    if main:
        blocks.append(overview(main, folder, drawn=not output.no_plots))
    if declared is not None:
        which = paragraph("settings#declared_off", d=declared)
        blocks += [paragraph("settings#declared", d=declared), Folded("Tests and exit status", (which,))]
    if output.write_up:
        for write_up in of_all("write_up"):
            write_up(folder, trials, scores, answers, sections)
    title = TITLE
    if options.selection.lab is not None:  # its answers come first
        camera = any(t.log.evidence is not None for t in trials)
        title = f"{'Visual' if camera else 'Corridor'} lab: {Path(options.selection.lab).resolve().name}"
        first.insert(len(answers), Section("Filter or smoother", tuple(blocks)))
        blocks = []
    write_report(folder, Report(title, command_of(options), tuple(blocks), tuple(sections), tuple(first)))
    first_screen = {"conclusion": conclusion(facts), "logs": facts, "declared": declared, "missing": lost.messages}
    write_facts(folder, first_screen, [*first, *sections])
    _write_provenance(folder, options, outcome, command)
    result_files.NOTICES.write(notices_table([*found.notices, *lost.messages]), folder)
    return lost.messages, [s.answer for s in answers if s.answer]


def warnings_section(found: Sequence[Notice]) -> list[Section]:
    """A section with all warnings, a few of them in front; none where there are none."""
    asking = [(title(n), whose(n), sentence(n)) for n in together(found) if n.severity is Severity.WARNING]
    if not asking:
        return []
    shown, more = (say("questions#asked", asking=part) for part in (asking[:FEW], asking[FEW:]))
    folded = (Folded(f"{len(asking) - FEW} more", (more,)),) if more else ()
    return [Section("Warnings", (say("questions#about"), shown, *folded))]


def _failure_section(trials: Sequence[Trial], found: Sequence[Notice], missing: Sequence[Notice]) -> list[Section]:
    """All errors: runs that stopped, are implausible or lost, and what is missing; nothing where there are none."""
    origins, flaws = {n.run: n for n in found if n.code is Code.ORIGIN}, flaws_of(trials)
    failed: list[dict[str, object]] = [
        dict(zip(("log", "task", "estimator", "association"), run, strict=True))
        | {"status": flaw.status, "frame": flaw.frame, "why": flaw.notice, "origin": origins.get(run)}
        for run, flaw in flaws.items()
    ]
    of_lost = [n for n in found if status_of(n, flaws) == LOST]
    lost = len({n.run for n in found if n in of_lost or n.code is Code.UNUSED} - flaws.keys())
    if not (failed or of_lost or lost or missing):
        return []
    of = sum(len(t.runs) for t in trials)
    blocks: list[Block] = [paragraph("failures#count", runs=failed, lost=lost, of=of)] if failed or lost else []
    which = [say("failures#stopped", runs=failed)] if failed else []
    which += [say("failures#lost", texts=[described(n) for n in together(of_lost)])] if of_lost else []
    blocks += [Folded("Which, and why", tuple(which))] if which else []
    blocks += [say("failures#missing", texts=[described(n) for n in missing])] if missing else []
    return [Section("Failures", tuple(blocks), facts=failed)]


def _declared(judged: Sequence[Judged]) -> dict[str, object] | None:
    """How the verdicts that scenarios declare consistent came out: their number, and those that are not."""
    declared = [j for j in judged if j.declared and j.verdict.runs >= MIN_RUNS]
    names = ("scenario", "task", "estimator", "association", "phase", "quantity", "verdict")
    off = (j for j in declared if j.verdict.word != CONSISTENT or j.diverged)
    failed = [dict(zip(names, (j.scenario, *j.key, j.quantity, j.verdict.word), strict=True)) for j in off]
    return {"verdicts": len(declared), "off": failed} if declared else None


SIZES = {name: name for name in ("name", "kind", "frames", "known_poses", "observations", "sensor", "floored")}
SIZES |= {"name": "log", "known_poses": "with truth", "floored": "raised to the minimum"}  # heads of the table of logs


def _source_section(trials: Sequence[Trial], setup: Setup) -> Section:
    """Size, sensor and labels of each log, and the gate of observations paired by label."""
    sources: list[dict[str, Any]] = []
    gates: dict[str, list[str]] = {}
    for log in {t.log.name: t.log for t in trials}.values():
        r = log.recorded
        gate = gate_sentence(setup, sensed=log.labels_are_sensed) if log.has_labels else ""
        if gate:
            gates.setdefault(gate, []).append(log.name)
        sources.append({
            "name": log.name, "kind": str(log.source.get("kind", "open log folder")), "frames": len(r),
            "observations": len(r.observations.frame), "sensor": r.sensor.name, "known_poses": log.truth.known_poses,
            "floored": r.floored, "labels_are_sensed": log.labels_are_sensed, "gate": gate,
        })  # fmt: skip
    frame = pd.DataFrame(sources, columns=list(SIZES), dtype=object).rename(columns=SIZES)
    words = say("settings#logs", gates=gates, sensed=[s["name"] for s in sources if s["labels_are_sensed"]])
    blocks = (Table(frame, say("settings#sizes")), words)
    return Section("Logs and settings", (Folded("Sizes, sensors and gates", blocks),), facts=sources)


def _write_provenance(folder: Path, options: Options, outcome: Outcome, command: Sequence[str]) -> None:
    """Inputs with their digests, and estimators and association methods by flag and scenario file."""
    results: dict[str, dict[str, str]] = {}
    for run in (r for t in outcome.trials for r in t.runs if isinstance(r, GivenRun)):
        results.setdefault(run.estimator, {}).update(run.source)
    studied = [s.scenario for s in outcome.studies]
    used = [*options.selection.estimator, *options.selection.association]
    used += [*(m.name for s in studied for m in s.members), *(a for s in studied for a in s.association)]
    logs = {t.log.name: t.log for t in outcome.trials}.values()
    kept = {log: own for found in of_all("settings") for log, own in found(options, outcome.trials).items()}
    (folder / "provenance.json").write_text(provenance(options, logs, command, used, results, kept), encoding="utf-8")


def as_json(facts: object) -> Any:
    """Facts as JSON holds them; not finite numbers are null. Raises TypeError for anything that is no fact."""
    if facts is None or facts is pd.NA:
        return None
    if isinstance(facts, Enum):
        return as_json(facts.value)
    if isinstance(facts, str | bool | int):
        return facts
    if isinstance(facts, float):
        return facts if math.isfinite(facts) else None
    if isinstance(facts, Path):
        return facts.as_posix()
    if isinstance(facts, np.generic | np.ndarray):
        return as_json(facts.tolist())
    if is_dataclass(facts) and not isinstance(facts, type):
        return {f.name: as_json(getattr(facts, f.name)) for f in fields(facts)}
    if isinstance(facts, pd.DataFrame):
        return as_json(facts.to_dict("records"))
    if isinstance(facts, Mapping):
        names = (" ".join(map(str, key)) if isinstance(key, tuple) else str(as_json(key)) for key in facts)
        return dict(zip(names, map(as_json, facts.values()), strict=True))
    if isinstance(facts, AnySet):
        return sorted((as_json(f) for f in facts), key=repr)
    if isinstance(facts, Sequence):
        return [as_json(f) for f in facts]
    raise TypeError(f"{type(facts).__name__} is no fact: report.json cannot hold it")


def write_facts(folder: Path, first: Mapping[str, object], sections: Iterable[Section]) -> None:
    """Write `report.json`: what stands before the sections, by name, and the facts of each section that has some."""
    named = [{"heading": s.heading, "facts": as_json(s.facts)} for s in sections if s.facts is not None]
    text = json.dumps(as_json(first) | {"sections": named}, indent=1, sort_keys=True, ensure_ascii=False)
    (folder / "report.json").write_text(text + "\n", encoding="utf-8", newline="\n")


def outcome(compared: Comparison) -> str:
    """What came of a comparison, by status and errors of the two, as `answer.md.j2` calls it."""
    there = compared.pair
    cases = {
        "failed": any(r.status not in ("ok", IMPLAUSIBLE) for r in there),
        "implausible": any(r.status == IMPLAUSIBLE for r in there), "none ran": not there, "one ran": len(there) == 1,
        "lost": any(r.lost_why for r in there), "no truth": not all(math.isfinite(r.rmse) for r in there),
    }  # fmt: skip
    return next((name for name, applies in cases.items() if applies), "compared")


def answer(j: Judgement, trust: str = "") -> str:
    """The comparison in a few sentences; `trust`, the diagnosis, comes first without ground truth."""
    about = {"outcome": outcome(j.compared), "verdict": j.verdict, "linearized": j.compared.lost_to_linearization}
    words = say("answer", j.compared, **about, methods=j.methods, trust=trust, assumed=assumed(j.origins))
    return "\n".join(map(one_line, re.split(r"\n(?=\* )", words)))


def gate_sentence(setup: Setup, *, sensed: bool) -> str:
    """The gate of observations paired by label; `sensed`: a sensor read the labels of this log."""
    gate, by_default = setup.settled(sensed).label_gate, setup.gate_known == "auto"
    return paragraph("settings#gate", gate=gate, by_default=by_default, smoothers=setup.gate_smoothers, sensed=sensed)


IN_FULL = "The comparison in words"
IN_SUMMARY = {"errors": "rmse_position_m", "nees": "nees_pose", "nis": "nis", "decided": "fp"}
VARIANTS, NOTES = "Additional variants", "Notes on the log and its runs"  # what folded texts are called


def of_trial(frame: pd.DataFrame, trial: Trial) -> pd.DataFrame:
    """Rows of one of the tables of `Scores` that belong to a trial."""
    return frame[(frame["log"] == trial.log.name) & (frame["task"] == trial.task)]


def _rows(frame: pd.DataFrame, trials: Sequence[Trial]) -> pd.DataFrame:
    return pd.concat([of_trial(frame, t) for t in trials])


def _where(trial: Trial) -> str:
    return f"{trial.log.name}, {trial.task}"


def trial_sections(
    folder: Path, output: Output, trials: Sequence[Trial], judgements: Sequence[Judgement], scores: Scores,
    published: Sequence[Sequence[Picture]], found: Sequence[Notice] = (), trust: Sequence[Trust] = (),
) -> list[Section]:  # fmt: skip
    """Of each log and task a section of the report and one of details; `judgements`: of those that are no variants."""
    sections, own = [], iter(judgements)
    for trial, pictures in zip(trials, published, strict=True):
        if trial.variant_of is not None:
            continue
        group = (trial, *variants(trial, trials))
        j = next(own)
        wide = _comparison(folder, output, trial, group, scores)
        about_log = [n for n in found if n.log == trial.log.name and n.task in ("", trial.task)]
        blocks = _front(trial, j, about_log, scores, first_page_words(trial, trust))
        blocks.append(_summary(trial, group, scores, wide))
        blocks += space_tables(folder, output, trial)
        blocks += [p for p in pictures if p.place == FRONT]
        blocks += [film for t in group for film in films_of(folder, t)] if output.animate else []
        blocks.append(paragraph("comparison#details", page=stem(trial)))
        sections.append(Section(_where(trial), tuple(blocks), facts=j))
        sections += source_section(folder, output, trial, scores, about_log)
        sections += systematic_section(folder, output, trial, pictures)
        details: list[Block] = [*comparison.parts(wide)]
        if len(rows := of_trial(scores.differences, trial)):
            frame, fine = comparison.differences_table(rows), fine_print("Filters against smoothers")
            caption, name = paragraph("comparison#differences", where=_where(trial)), stem(trial, "differences")
            details.append(written_table(frame, folder, name, caption, output, fine=fine))
        details += [p for p in pictures if p.place == DETAILS]
        about = tuple(paragraph("comparison#variant", name=t.log.name, about=t.about) for t in group[1:])
        details += [Folded(VARIANTS, about)] if about else []
        notes = of_runs(n for n in about_log if n.severity is Severity.INFO)
        details += [Folded(NOTES, ("\n".join(f"* {n}" for n in notes),))] if notes else []
        sections.append(Section(f"{_where(trial)}: details", tuple(details), page=stem(trial)))
        sections += trust_section(folder, output, trial, trust)
        for of_wing in of_all("log_sections"):
            sections += of_wing(folder, output, trial)
        sections += _decisions(folder, output, group, scores, pictures)
    return sections


def _comparison(folder: Path, output: Output, trial: Trial, group: Sequence[Trial], scores: Scores) -> Table:
    """Every run of a trial and of its variants, with every column."""
    rows = _rows(scores.metrics, group)
    caption = paragraph("comparison#errors", where=_where(trial), aligned=aligned_statement(trial))
    wide, for_paper = comparison.comparison_table(rows, aligned=True), comparison.comparison_table(rows, output.columns)
    name, fine = stem(trial, "comparison"), fine_print("Errors and consistency of one log")
    return written_table(wide, folder, name, caption, output, for_paper=for_paper, fine=fine)


def _summary(trial: Trial, group: Sequence[Trial], scores: Scores, wide: Table) -> Table:
    """The same rows with the columns that matter most."""
    frame = comparison.summary_table(*(_rows(t, group) for t in (scores.metrics, scores.association)))
    shown = {what: heads((column,))[column] in frame for what, column in IN_SUMMARY.items()}
    caption = paragraph("comparison#summary", where=_where(trial), **shown)
    return Table(frame, caption + aligned_statement(trial), fine=wide.fine)


def _front(trial: Trial, j: Judgement, found: Sequence[Notice], scores: Scores, trust: str) -> list[Block]:
    """Filter and smoother on one log and task: at most three lines in front, the rest folded."""
    names, rows = {r.estimator for r in trial.runs if r.handed_in}, rows_of(of_trial(scores.metrics, trial))
    theirs = one_line(say("results#statement", phases=[row for row in rows if row["estimator"] in names]))
    whole = "" if theirs and is_truth_alone(trial.log) else answer(j, trust if j.measured else "")
    text = "\n\n".join(s for s in (whole, theirs) if s)
    nothing = " ".join(of_runs(n for n in found if n.code is Code.UNUSED))
    front = " ".join(s for s in (in_short(j), nothing or gauge_statement(j)) if s)
    return [front, Folded(IN_FULL, (text,))] if text else [front]


def _decided(folder: Path, output: Output, rows: pd.DataFrame, name: str, where: str) -> Table:
    caption, fine = paragraph("comparison#decisions", where=where), fine_print("Decisions")
    return written_table(comparison.association_table(rows), folder, name, caption, output, fine=fine)


def _decisions(
    folder: Path, output: Output, group: Sequence[Trial], scores: Scores, pictures: Sequence[Picture]
) -> list[Section]:
    """Decisions on a log, where some were made without labels."""
    trial, rows = group[0], _rows(scores.association, group)
    if not (rows["association"] != "known").any():
        return []
    name = stem(trial, "association")
    blocks: list[Block] = [_decided(folder, output, rows, name, _where(trial))]
    blocks += [p for p in pictures if p.stem == name]
    return [Section(f"Decisions: {_where(trial)}", tuple(blocks), level=3, page=stem(trial))]


def association_sections(folder: Path, output: Output, trials: Sequence[Trial], scores: Scores) -> list[Section]:
    """In one table the decisions on logs with known association alone; a sentence where none can be scored."""
    if not len(scores.association):
        return [Section("Data association", (paragraph("comparison#nothing_decided"),))]
    each = [_rows(scores.association, (t, *variants(t, trials))) for t in trials if t.variant_of is None]
    granted = [rows for rows in each if len(rows) and (rows["association"] == "known").all()]
    if not granted:
        return []
    table = _decided(folder, output, pd.concat(granted), "association", "")
    return [Section("Data association by labels", (paragraph("comparison#granted"), table), page="association")]
