"""The result folder: tables, figures, the report and its facts, provenance; and the steps of `slamref run` that lead to
it once the flags are read: plan, estimate, judge, tell, write.

This module loads all that a table needs; the command imports it once there is something to do.
"""

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AnySet
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from data.command import without_places
from data.errors import UsageError
from data.notice import Code, Notice, Severity, ordered
from data.terminal import WRONG, counted
from data.wing import of_all
from data.words import sentence, title
from eval.figures.figure_style import figure_style
from eval.judgement.judgement import Verdict, conclusion
from eval.judgement.judgement import judge as judge_trial
from eval.plan.console import Console, progress
from eval.plan.execute import Outcome, execute
from eval.plan.experiment import Unfinished
from eval.plan.experiments import make_plan
from eval.plan.flags.options import figure_style_of, require_latex
from eval.plan.flags.table import Options
from eval.plan.provenance import command_of, provenance, words_of
from eval.plan.warming import compile_if_needed
from eval.referee import result_files
from eval.referee.consistency import CONSISTENT, MIN_RUNS
from eval.referee.diagnostics import notices, notices_table, of_logs
from eval.referee.given.runs import GivenRun
from eval.referee.score import Trial, score
from eval.replay.external.spec import is_foreign, shown
from eval.replay.settings import Setup
from eval.report.log_sections import association_sections, gate_sentence, trial_sections
from eval.report.overview import attribution_sections, introduction, overview
from eval.report.page.blocks import READING, Block, Folded, Report, Section, Table
from eval.report.page.files import check_columns
from eval.report.publish import publish, write_truths
from eval.report.render import write_report
from eval.report.results import space_rows
from eval.report.studies import study_sections
from eval.report.terminal import Results, declared_lines, flaws_of, groups_of, lines, study_lines, trust_line
from eval.report.words import LOST, asked, described, paragraph, say, status_of, together, whose
from eval.studies import reproduced, store
from eval.studies.diagnosis import trust_table
from eval.studies.montecarlo import Judged, consistency_table, failed_declarations, judge, traces

FINE, REJECTED = 0, 1
COLOURS = {"good": "32", "fair": "33", "bad": "31"}  # ANSI colours of the trust line, by tone


def run(options: Options, console: Console, folder: Path, command: Sequence[str], check: Callable[[], None]) -> int:
    """Fill the result folder, and return the exit status."""
    check_columns(options.output.columns)
    require_latex(options.drawing)
    style, about_style = figure_style_of(options.drawing, options.output)
    if about_style:
        console.say(about_style)
    compile_if_needed(console.quiet)
    plan, begin = make_plan(options, console.say), time.time()
    console.kept = lambda: store.kept_since(options.output.kept, begin)
    for e in plan.experiments:
        console.detail(f"{e.log.name}: {e.task}, {counted(len(e.log.recorded), 'frame')}")
        for note in e.log.notes:
            console.detail(f"{e.log.name}: {note}")
    in_lab = options.selection.lab is not None  # which prints its answers; its report has the warnings
    warn = console.detail if in_lab else console.say
    early = ordered(of_logs(e.log for e in plan.experiments if e.variant_of is None))
    for n in early:
        if n.code is Code.TIME_UNIT and n.named["blind"] is not None:  # gaps are filled with frames
            raise UsageError(f"{n.log}: {sentence(n)}")
    tell(early, (), warn)
    with progress("estimating", console.quiet, check) as update:
        outcome = execute(plan, options, update)
    judged = [j for study in outcome.studies for j in judge(study)]
    scores = score(outcome.trials)
    judgements = [(t, judge_trial(t, scores, outcome.trust)) for t in outcome.trials]
    of_trust = (n.about(log=t.log, task=t.task, association=t.association) for t in outcome.trust for n in t.notices)
    found = Results(outcome, scores, judged, judgements, notices(outcome.trials, scores, [*early, *of_trust]))
    tell([n for n in found.notices if n not in early], outcome.trials, warn)
    _say(found, console, headlines=not in_lab)
    from eval.report import writing  # with matplotlib, which the table does not wait for

    with progress("writing", console.quiet, check, "part") as update, figure_style(style):
        missing, answers = writing.write_results(folder, options, found, command, update)
    for text in [*declared_lines(judged), *answers]:
        console.say(text)
    for why in missing:
        console.complain(described(why))
    own = [shown(text) for text in (*options.selection.estimator, *options.selection.association) if is_foreign(text)]
    if own and not in_lab:
        console.say(f"is your code right? `slamref check {' '.join(own)}` tests it on worlds with known results")
    console.say(f"report: {options.output.out / 'report.html'}  (slamref report {options.output.out})")
    text = without_places("\n".join(console.lines), [*command, *words_of(options)])
    (folder / "run.log").write_text(text + "\n", encoding="utf-8")
    return WRONG if missing else REJECTED if failed_declarations(judged) else FINE


def tell(found: Iterable[Notice], trials: Sequence[Trial], say: Callable[[str], None]) -> None:
    """Say each error and warning once, estimators that have it together; of a run its status and frame."""
    flaws = flaws_of(trials)
    by_status: dict[str, list[Notice]] = {}
    for n in found:
        if n.severity is not Severity.INFO:
            by_status.setdefault(status_of(n, flaws), []).append(n)
    for status, group in by_status.items():
        for n in together(group):
            say(asked(n, status))


def _say(found: Results, console: Console, *, headlines: bool) -> None:
    """Tracebacks of foreign code, lines on studies and published numbers, the main numbers and whom to trust."""
    outcome = found.outcome
    for flaw in flaws_of(outcome.trials).values():
        if flaw.trace:
            console.detail(flaw.trace.rstrip())
    for study in outcome.studies:
        for text in study_lines(study):
            console.say(text)
        for trace in traces(study):
            console.detail(trace)
    table = lines(groups_of(found.judgements, found.scores, outcome.studies, found.judged)) if headlines else []
    for text in [*reproduced.lines(outcome.published), *outcome.skipped, *table]:
        console.say(text)
    for trial, judgement in found.judgements if headlines else []:
        # none of variants, nor where there are results of other programs alone
        if trial.variant_of is None and judgement.verdict is not Verdict.NOTHING:
            console.say(trust_line(judgement), COLOURS.get(judgement.tone.value, ""))


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
        result_files.METRICS: scores.metrics,
        result_files.DECISION_COUNTS: scores.association,
        result_files.TIMING: scores.timing,
        result_files.CONSISTENCY: consistency_table(judged),
        result_files.TRUST: trust_table(outcome.trust),
        result_files.RELATIONS: scores.relations if len(scores.relations) else None,
        result_files.SOURCES: scores.sources if len(scores.sources) else None,
        result_files.SPACE: result_files.SPACE.table(rows) if (rows := space_rows(trials)) else None,
        result_files.PUBLISHED: result_files.PUBLISHED.table(outcome.published) if outcome.published else None,
    }
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
    text = provenance(options, logs, command, used, results, kept)
    (folder / "provenance.json").write_text(text, encoding="utf-8")


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
