"""The steps of `slamref run` once the flags are read, and all that they import: plan, estimate, judge, tell, write."""

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from data.command import without_places
from data.errors import UsageError
from data.logs import require_log
from data.notice import Code, Notice, Severity, ordered
from data.terminal import WRONG, counted
from data.words import sentence
from eval.figures.figure_style import figure_style
from eval.judgement.judgement import Verdict, judge as judge_trial
from eval.plan.console import Console, progress
from eval.plan.execute import execute
from eval.plan.experiments import make_plan
from eval.plan.flags.options import figure_style_of, require_latex
from eval.plan.flags.table import Options
from eval.plan.provenance import words_of
from eval.plan.warming import compile_if_needed
from eval.referee.diagnostics import notices, of_logs
from eval.referee.score import Trial, score
from eval.replay.external.spec import is_foreign, shown
from eval.report.page.files import check_columns
from eval.report.terminal import Results, declared_lines, flaws_of, groups_of, lines, study_lines, trust_line
from eval.report.words import asked, described, status_of, together
from eval.studies import montecarlo, store
from eval.studies.montecarlo import failed_declarations, judge, traces

FINE, REJECTED = 0, 1
COLOURS = {"good": "32", "fair": "33", "bad": "31"}  # ANSI colours of the trust line, by tone


def run(options: Options, console: Console, folder: Path, command: Sequence[str], check: Callable[[], None]) -> int:
    """Fill the result folder, and return the exit status."""
    check_columns(options.output.columns)
    require_latex(options.drawing)
    style, about_style = figure_style_of(options.drawing, options.output)
    if about_style:
        console.say(about_style)
    for name in options.selection.log or ():
        require_log(name)  # what is no log need not wait
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
    for text in [*montecarlo.lines(outcome.published), *outcome.skipped, *table]:
        console.say(text)
    for trial, judgement in found.judgements if headlines else []:
        # none of variants, nor where there are results of other programs alone
        if trial.variant_of is None and judgement.verdict is not Verdict.NOTHING:
            console.say(trust_line(judgement), COLOURS.get(judgement.tone.value, ""))
