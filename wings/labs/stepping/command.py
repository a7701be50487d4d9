"""`slamref step`: walk through a log, one frame at each press of Enter, in the order of the data association lab."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from data.errors import UsageError
from data.terminal import ending
from eval.plan.flags import command_of
from eval.plan.flags.options import options_of
from eval.plan.flags.table import FIRST_FRAMES, HELP, Options, add_flags
from eval.replay.flag import rows
from eval.replay.settings import ASSOCIATIONS, STEPPING, steps

if TYPE_CHECKING:
    from data.log import Log

PROG = "python -m eval.step"
TABLE = rows(Options)
SHARED = (
    replace(TABLE["log"], help="open log folder, victoria-park, arena:SEED or corridor:SEED[:KEYS]"),
    replace(TABLE["association"], metavar="NAME", help=f"of {', '.join(ASSOCIATIONS)}, or your own (default: jcbb)"),
    replace(TABLE["estimator"], metavar="NAME", help=f"of {', '.join(STEPPING)}, or your own (default: ekf)"),
    replace(TABLE["task"], metavar="NAME", help=HELP["step_task"]),
    *(TABLE[name] for name in ("gate", "new_gate", "gate_known", "gate_poses", "in_view", "maintain")),
    *(TABLE[name] for name in ("exclude_truth", "keep_truth")),
)  # Flags shared with `slamref run`
DEFAULTS = {"association": "jcbb", "estimator": "ekf"}


def read(argv: Sequence[str] | None, prog: str = PROG) -> Namespace:
    """Checked flags: `options`, those that are `stated`, and the rest by name; UsageError for invalid ones."""
    parser = command_of(prog, PROG, "step")
    add_flags(parser, SHARED)
    given = vars(parser.read(argv))
    given["log"] = logs = [*given.pop("words"), *given.get("log", [])]
    if len(logs) != 1:
        raise UsageError(f"{' '.join(logs) or 'no log'}: one log is needed, as in `{prog} corridor:0`")
    stated = {row.name: given[row.name] for row in SHARED if row.name in given}
    options = options_of(DEFAULTS | stated)
    for name in ("association", "estimator", "task"):
        names = TABLE[name].of(options)
        if len(names) > 1 or not (names or name == "task"):
            raise UsageError(f"--{name} {','.join(names)}: one name is needed")
    estimator = options.selection.estimator[0]
    if not steps(estimator):
        raise UsageError(f"--estimator {estimator}: does not work step by step; {', '.join(STEPPING)} do")
    frames = None if given["frames"] is None else FIRST_FRAMES("--frames", given["frames"])
    return Namespace(**given | {"frames": frames}, options=options, stated=stated)


@ending("interrupted; files written so far are complete")
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    wish = read(argv, prog)
    from data.log import shortened
    from data.logs import open_scored
    from data.questions.asked import truth_windows
    from eval.plan.warming import compile_if_needed

    compile_if_needed()
    from eval.plan.experiment import check_maintained, check_possible_on, default_task, default_task_line, load_all
    from eval.plan.experiments import reading_of
    from eval.plan.provenance import settings_line

    load_all(wish.options.selection.estimator, wish.options.selection.association)
    log = open_scored(wish.options.selection.log[0], replace(reading_of(wish.options), cache=None))
    options = options_of({**DEFAULTS, **of_lab(log, wish.report), **wish.stated})
    asked, setup = options.selection, options.setup
    (estimator,), (association,) = asked.estimator, asked.association
    task = asked.task[0] if asked.task else default_task(log)
    for line in (settings_line(wish.options, options, wish.report), "" if asked.task else default_task_line([log])):
        if line:
            print(line)
    check_possible_on(log, (task,), (association,))
    check_maintained(setup, (task,))
    if wish.frames is not None:
        log = shortened(log, wish.frames)
    from eval.referee.plausibility import with_plausibility
    from eval.replay.estimators import lack_with_sensor
    from eval.replay.external.adapter import lack
    from eval.replay.external.spec import is_foreign, name_of
    from eval.replay.run import step_by_step
    from eval.report.words import asked as question_line
    from eval.report.writing import gate_sentence
    from wings.labs.stepping.pictures import ImageWriter, open_windows
    from wings.labs.stepping.stepper import StoppedError, Walk, end
    from wings.labs.stepping.text import lab_block, step_block

    if is_foreign(estimator) and (why := lack(estimator, task, association, setup)):
        raise UsageError(f"--estimator {name_of(estimator)}: {why}")
    if not is_foreign(estimator) and (why := lack_with_sensor(estimator, task, association, log.recorded)):
        raise UsageError(f"log {log.name!r} has walls: {why}")
    images = ImageWriter(wish.save, open_windows())
    inputs = log.inputs(labels=association == "known")
    if task == "slam":
        inputs = inputs.without_map()
    for question in truth_windows(log):
        print(question_line(question))
    if inputs.labels_are_sensed:
        print(gate_sentence(setup, sensed=True))
    pausing = not wish.run_through and sys.stdin.isatty()
    block, first = (lab_block, 1) if wish.lab_text else (step_block, 0)
    walk = Walk(log, task, name_of(estimator), images, pausing=pausing, block=block, first=first)
    if log.evidence is not None and images.wanted:
        from data.wing import of_all

        walk.camera = (image for of_wing in of_all("images") for image in of_wing(asked.log[0], log))
    try:
        run = step_by_step(estimator, inputs, task, association, setup, observer=walk)
        end(log, with_plausibility(run, inputs), images, walk)
    except StoppedError:
        print("stopped; files written so far are complete")


def of_lab(log: Log, report: Path | None) -> dict[str, object]:
    """The settings of the lab that ran on a log, one of each; of methods the default if the lab ran it."""
    from eval.plan.provenance import settings_of_lab

    found = settings_of_lab(lambda: log, report)
    for name in {"task", "association", "estimator"} & found.keys():
        several = TABLE[name].read(TABLE[name].option, found.pop(name))
        able = [value for value in several if name != "estimator" or steps(value)]
        if able:
            found[name] = DEFAULTS[name] if DEFAULTS.get(name) in able else able[0]
    return found
