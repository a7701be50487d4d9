"""`slamref play LOG`: a page that replays a log with all estimates, decisions and ellipses."""

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from data.command import Command
from data.errors import UsageError
from data.terminal import ending, message_of
from eval.plan.flags import command_of
from eval.plan.flags.options import options_of
from eval.plan.flags.table import FIRST_FRAMES, HELP, Options, add_flags
from eval.replay.flag import rows

PROG = "python -m eval.play"
TABLE = rows(Options)
HOW = ("estimator", "association", "gate", "new_gate", "gate_known", "in_view")
LONG_LOGS = ("maintain", "forget_after", "deactivate_after", "lag", "keyframe_distance")
TRUTH = ("exclude_truth", "keep_truth")
PLAYED = replace(TABLE["task"], help=HELP["play_task"])
SHARED = (PLAYED, *(TABLE[name] for name in ("cooperative", *HOW, *LONG_LOGS, *TRUTH)))
"""Flags shared with `slamref run`."""


def parser(prog: str = PROG) -> Command:
    """The flags."""
    p = command_of(prog, PROG, "play")
    add_flags(p, SHARED)
    return p


def read(argv: Sequence[str] | None, prog: str = PROG) -> Namespace:
    """Checked flags: `options`, those that are `stated`, and the rest by name; UsageError for invalid ones."""
    given = vars(parser(prog).read(argv))
    out = given["out"]
    if out is not None and out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: a file name that ends in .html is needed")
    stated: dict[str, object] = {"log": [given["log"]]}
    stated |= {row.name: given[row.name] for row in SHARED if row.name in given}
    frames = None if given["frames"] is None else FIRST_FRAMES("--frames", given["frames"])
    return Namespace(**given | {"frames": frames}, options=options_of(stated), stated=stated)


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    wish = read(argv, prog)
    from data.log import folder_name, shortened
    from data.logs import open_scored
    from data.questions.asked import truth_windows
    from eval.plan.experiment import estimate, wanted
    from eval.plan.experiments import make_plan, reading_of
    from eval.plan.provenance import settings_line, settings_of_lab
    from eval.plan.warming import compile_if_needed
    from eval.player.document import company_of, played, write_page
    from eval.referee.score import Trial
    from eval.report.words import asked

    compile_if_needed()
    reading = reading_of(wish.options)
    taken = settings_of_lab(lambda: open_scored(wish.options.selection.log[0], reading), wish.report)
    options = options_of({**taken, **wish.stated})
    if line := settings_line(wish.options, options, wish.report):
        print(line)
    trials = []
    for e in make_plan(options, print).experiments:
        if e.variant_of is not None and not options.selection.cooperative:
            continue
        e = e if wish.frames is None else replace(e, log=shortened(e.log, wish.frames))
        runs = {(r.association, r.estimator): r for w in e.work for r in estimate(e, w, watched=True)}
        for run in runs.values():
            if run.flaw is not None:
                print(f"{run.estimator} ({run.association}) {run.status}: {run.flaw.text}")
        trials.append(Trial(e.log, e.task, tuple(runs[key] for key in wanted(e.work)), e.variant_of))
    for question in truth_windows(trials[0].log):
        print(asked(question))
    path = wish.out or Path(f"{folder_name(trials[0].log.name)}.html")
    try:
        group = played(trials)[0]
        write_page(path, group, options.setup, company_of(group, trials))
    except OSError as fault:
        raise UsageError(f"--out {path}: {message_of(fault)}") from fault
    print(f"player: {path} ({path.stat().st_size / 1e6:.2f} MB)")


if __name__ == "__main__":
    sys.exit(main())
