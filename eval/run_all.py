"""`slamref run`: run filters and smoothers on identical inputs, score them, write the report.

The result folder is built beside its final name and moved into place at the end: an interrupted run leaves the previous
report complete.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

from data.command import without_places
from data.errors import UsageError
from data.notice import Severity
from data.terminal import INTERRUPTED, WRONG, counted, ended, message_of, unread
from data.whole import whole_folder
from data.words import sentence
from eval.open_report import show
from eval.plan import first_use
from eval.plan.flags.help import PROG
from eval.plan.flags.options import read_options
from eval.plan.flags.table import Options
from eval.plan.stale_kernels import forget_in_checkout

FINE, REJECTED = 0, 1
MARK = "provenance.json"
COLOURS = {"good": "32", "fair": "33", "bad": "31"}  # ANSI colours of the trust line, by tone


class Console:
    """Messages to the user, kept for run.log."""

    def __init__(self, options: Options) -> None:
        """Follow -q and -v; run.log gets everything."""
        self.quiet, self.verbose = options.execution.quiet, options.execution.verbose
        self.lines: list[str] = []
        self.coloured = sys.stdout.isatty() and "NO_COLOR" not in os.environ
        self.kept: Callable[[], str] = lambda: "nothing was changed"

    def say(self, text: str, colour: str = "") -> None:
        """Print a message, unless quiet; on a terminal in an ANSI colour."""
        self.lines.append(text)
        if not self.quiet:
            _print(f"\033[{colour}m{text}\033[0m" if colour and self.coloured else text)

    def complain(self, text: str) -> None:
        """Print an error that does not end the command, even if quiet."""
        self.lines.append(f"slamref: {text}")
        print(f"slamref: {text}", file=sys.stderr, flush=True)

    def detail(self, text: str) -> None:
        """Print a message for -v."""
        self.lines.append(text)
        if self.verbose:
            _print(text)


def _print(text: str) -> None:
    """Print a line; a closed pipe (`... | head -1`) does not end the run."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        if not unread():
            raise


def lab(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """`slamref lab`: positional words are values of `--lab`."""
    return main(argv, prog, "lab")


def study(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """`slamref study`: positional words are values of `--scenario`."""
    return main(argv, prog, "scenario")


def main(argv: Sequence[str] | None = None, prog: str = PROG, positional: str = "log") -> int:
    """The command `prog`, whose positional words are values of flag `positional`; returns its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    consoles: list[Console] = []

    def body() -> int:
        with heeding_interruption() as check, first_use.stopping():
            options = read_options(arguments, prog, positional)
            consoles.append(Console(options))
            forget_in_checkout()
            if line := first_use.start(options):
                consoles[0].say(line)
            check()
            with staged(options.output.out) as folder:
                status = _run(options, consoles[0], folder, [*prog.split(), *arguments], check)
                check()
        if options.output.open:
            show(options.output.out)
        return status

    return ended(body, lambda: f"interrupted; {consoles[0].kept() if consoles else 'nothing was changed'}")


@contextmanager
def heeding_interruption() -> Iterator[Callable[[], None]]:
    """A function that raises KeyboardInterrupt after Ctrl-C, even if a library lost the exception.

    Exceptions in callbacks from compiled code vanish, or become others; after Ctrl-C these count as interruptions, too.
    """
    pressed: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        pressed.append(number)
        raise KeyboardInterrupt

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only that one may set handlers
        yield check
        return
    before = signal.signal(signal.SIGINT, handle)
    try:
        yield check
    except Exception:
        check()
        raise
    finally:
        signal.signal(signal.SIGINT, before)


def leave(status: int) -> NoReturn:
    """End the process with a status; after an interruption at once, since Python would report a signal instead."""
    if status == INTERRUPTED:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


@contextmanager
def staged(out: Path) -> Iterator[Path]:
    """A folder beside `out` that replaces it if the block succeeds, and is deleted otherwise."""
    out = out.absolute()
    if out.exists() and any(out.iterdir()) and not (out / MARK).exists():
        raise UsageError(f"--out {out.name}: the folder contains other files than a report; name another one")
    with ExitStack() as stack:
        try:
            partial = stack.enter_context(whole_folder(out))
        except OSError as fault:
            raise UsageError(f"--out {out}: {message_of(fault)}") from fault
        yield partial


def _run(options: Options, console: Console, folder: Path, command: Sequence[str], check: Callable[[], None]) -> int:
    from data.questions.asked import ask
    from eval.figures.figure_style import figure_style
    from eval.judgement.judgement import Verdict
    from eval.judgement.judgement import judge as judge_trial
    from eval.plan.appearance import figure_style_of, require_latex
    from eval.plan.execute import execute
    from eval.plan.experiments import make_plan
    from eval.plan.progress import progress
    from eval.plan.provenance import words_of
    from eval.plan.warming import compile_if_needed
    from eval.referee.diagnostics import disputed, questions_of_run
    from eval.referee.score import score
    from eval.referee.sources.scored import source_notices
    from eval.report.contents import write_results
    from eval.report.page.latex import check_columns
    from eval.report.sources import together_by_source
    from eval.report.studies import declared_lines, study_lines
    from eval.report.terminal import groups_of, lines, trust_line
    from eval.report.words import asked, described, together
    from eval.studies import reproduced, store
    from eval.studies.montecarlo import failed_declarations, judge, traces

    check_columns(options.output.columns)
    require_latex(options.drawing)
    style, about_style = figure_style_of(options.drawing, options.output)
    if about_style:
        console.say(about_style)
    compile_if_needed(console.quiet)
    plan = make_plan(options, console.say)
    begin = time.time()
    console.kept = lambda: store.kept_since(options.output.kept, begin)
    in_lab = options.selection.lab is not None  # which prints its answers; its report has the warnings
    warn = console.detail if in_lab else console.say
    for e in plan.experiments:
        console.detail(f"{e.log.name}: {e.task}, {counted(len(e.log.recorded), 'frame')}")
        for note in e.log.notes:
            console.detail(f"{e.log.name}: {note}")
    for log in {e.log.name: e.log for e in plan.experiments if e.variant_of is None}.values():
        for question in ask(log):
            warn(asked(question))
    with progress("estimating", console.quiet, check) as update:
        outcome = execute(plan, options, update)
    judged = [j for study in outcome.studies for j in judge(study)]
    for trial in outcome.trials:
        for run in trial.runs:
            if run.flaw is not None:
                f = run.flaw
                where = f"{trial.log.name}, {run.task}: {run.estimator}"
                where += f" ({run.association})" if run.implausible is not None else ""
                warn(f"{where} {f.status} {'at' if run.implausible is None else 'from'} frame {f.frame}: {f.why}")
                if f.trace:
                    console.detail(f.trace.rstrip())
            for found in run.notes:
                if found.severity is not Severity.INFO or run.handed_in:
                    warn(f"{trial.log.name}, {run.task}: {run.estimator}: {sentence(found)}")
    for trial in outcome.trials:
        found_in_runs = (n for run in trial.runs for n in questions_of_run(run, trial.log.recorded))
        for question in together(n.about(log=trial.log.name, task=trial.task) for n in found_in_runs):
            warn(asked(question))
        of_sources = (n for run in trial.runs for n in source_notices(run, trial.log.recorded))
        for found in together_by_source(n.about(log=trial.log.name, task=trial.task) for n in of_sources):
            warn(f"{trial.log.name}, {trial.task}: {found.estimator}: {sentence(found)}")
        for found in disputed(trial):
            warn(f"{trial.log.name}, {trial.task}: {found.estimator}: {sentence(found)}")
    for study in outcome.studies:
        for text in study_lines(study):
            console.say(text)
        for trace in traces(study):
            console.detail(trace)
    for text in [*reproduced.lines(outcome.published), *outcome.skipped]:
        console.say(text)
    scores = score(outcome.trials)
    judgements = [(t, judge_trial(t, scores, outcome.trust)) for t in outcome.trials]
    for text in [] if in_lab else lines(groups_of(judgements, scores, outcome.studies, judged)):
        console.say(text)
    for trial, judgement in judgements:
        # none of variants, nor where there are results of other programs alone
        if trial.variant_of is None and not in_lab and judgement.verdict is not Verdict.NOTHING:
            console.say(trust_line(judgement), COLOURS.get(judgement.tone.value, ""))
    with progress("writing", console.quiet, check, "part") as update, figure_style(style):
        missing, answers = write_results(folder, options, outcome, scores, judged, judgements, command, update)
    failed = failed_declarations(judged)
    for text in declared_lines(judged):
        console.say(text)
    for text in answers:
        console.say(text)
    for why in missing:
        console.complain(described(why))
    console.say(f"report: {options.output.out / 'report.html'}  (slamref report {options.output.out})")
    text = without_places("\n".join(console.lines), [*command, *words_of(options)])
    (folder / "run.log").write_text(text + "\n", encoding="utf-8")
    return WRONG if missing else REJECTED if failed else FINE


if __name__ == "__main__":
    leave(main())
