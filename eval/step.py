"""`slamref step`: walk through a log, one frame at each press of Enter, in the order of the data association lab."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from data.command import Command
from data.errors import UsageError
from data.terminal import ended
from eval.plan.flags.options import options_of
from eval.plan.flags.table import FIRST_FRAMES, Options, add_flags
from eval.replay.flag import rows
from eval.replay.settings import ASSOCIATIONS, STEPPING, steps

if TYPE_CHECKING:
    from data.log import Log

PROG = "python -m eval.step"
TABLE = rows(Options)
TASKS = "localization or slam (default: localization where there is a map, but slam in a corridor)"
SHARED = (
    replace(TABLE["log"], help="open log folder, victoria-park, arena:SEED or corridor:SEED[:KEYS]"),
    replace(TABLE["association"], metavar="NAME", help=f"of {', '.join(ASSOCIATIONS)}, or your own (default: jcbb)"),
    replace(TABLE["estimator"], metavar="NAME", help=f"of {', '.join(STEPPING)}, or your own (default: ekf)"),
    replace(TABLE["task"], metavar="NAME", help=TASKS),
    *(TABLE[name] for name in ("gate", "new_gate", "gate_known", "in_view", "maintain")),
)
"""Flags shared with `slamref run`."""
DEFAULTS = {"association": "jcbb", "estimator": "ekf"}
EXAMPLES = """\
examples:
  python -m eval.step corridor:0 --association jcbb               the lab, one frame at each Enter
  python -m eval.step corridor:0:people --association nn          with people, nearest neighbour
  python -m eval.step corridor:0 --estimator isam2 --save steps   a smoother; figures of all stages in steps/
  python -m eval.step corridor:0 --association known --run-through
  python -m eval.step corridor:0:people --gate 0.95 --new-gate 0.99 --maintain --run-through
  python -m eval.step arena:0 --task localization --frames 20     a known map; the first 20 frames
  python -m eval.step path/to/my_log --association gnn --in-view
  python -m eval.step corridor:0 --association nn --new-gate 0.99 --run-through --lab-text

At a pause: Enter continues, r and Enter runs to the end, q and Enter (or end of file, or Ctrl-C) stops.
Figures are shown in windows if matplotlib can open them (MPLBACKEND=Agg: never), and saved as PNG with --save.

exit status: 0 fine, 2 wrong usage or bad data, 130 interrupted"""


@dataclass(frozen=True)
class Wish:
    """The values of all flags."""

    options: Options
    save: Path | None
    run_through: bool
    frames: int | None
    lab_text: bool


def parser(prog: str = PROG) -> Command:
    """The flags."""
    p = Command(prog, PROG, "Walk through a log: move, observe, compatibility, matching, update.", EXAMPLES)
    p.add_argument("words", nargs="*", metavar="LOG", help="the same as --log")
    add_flags(p, SHARED)
    add = p.add_argument
    add("--save", metavar="DIR", type=Path, help="write figures and text of all steps to DIR")
    add("--run-through", action="store_true", help="do not pause (never without a terminal)")
    add("--frames", metavar="N", help="only the first N frames")
    add("--lab-text", action="store_true", help="print the steps in the format of the lab's program, numbers from 1")
    return p


def read(argv: Sequence[str] | None, prog: str = PROG) -> Wish:
    """Checked flags; UsageError for invalid ones."""
    given = vars(parser(prog).read(argv))
    given["log"] = logs = [*given.pop("words"), *given.get("log", [])]
    if len(logs) != 1:
        raise UsageError(f"{' '.join(logs) or 'no log'}: one log is needed, as in `{prog} corridor:0`")
    options = options_of(DEFAULTS | {row.name: given[row.name] for row in SHARED if row.name in given})
    for name in ("association", "estimator", "task"):
        names = TABLE[name].of(options)
        if len(names) > 1 or not (names or name == "task"):
            raise UsageError(f"--{name} {','.join(names)}: one name is needed")
    estimator = options.selection.estimator[0]
    if not steps(estimator):
        raise UsageError(f"--estimator {estimator}: does not work step by step; {', '.join(STEPPING)} do")
    frames = None if given["frames"] is None else FIRST_FRAMES("--frames", given["frames"])
    return Wish(options, given["save"], given["run_through"], frames, given["lab_text"])


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    return ended(lambda: _step(read(argv, prog)), "interrupted; files written so far are complete")


def _step(wish: Wish) -> None:
    from data.log import shortened
    from data.logs import open_log
    from eval.plan.warming import compile_if_needed

    compile_if_needed()
    from eval.plan.experiment import check_possible_on
    from eval.plan.foreign import load_all

    asked, setup = wish.options.selection, wish.options.setup
    (estimator,), (association,) = asked.estimator, asked.association
    load_all(asked.estimator, asked.association)
    log = open_log(asked.log[0])
    task = task_of(log, asked.task)
    check_possible_on(log, (task,), (association,))
    if wish.frames is not None:
        log = shortened(log, wish.frames)
    from eval.referee.plausibility import with_plausibility
    from eval.replay.estimators import lack_with_walls
    from eval.replay.external.make import lack
    from eval.replay.external.spec import is_foreign, name_of
    from eval.replay.run import step_by_step
    from eval.report.answer import gate_sentence
    from eval.stepping.pictures import ImageWriter, open_windows
    from eval.stepping.stepper import StoppedError, Walk, end
    from eval.stepping.text import lab_block, step_block

    if is_foreign(estimator) and (why := lack(estimator, task, association, setup)):
        raise UsageError(f"--estimator {name_of(estimator)}: {why}")
    if not is_foreign(estimator) and (why := lack_with_walls(estimator, task, association, log.recorded)):
        raise UsageError(f"log {log.name!r} has walls: {why}")
    images = ImageWriter(wish.save, open_windows())
    inputs = log.inputs(labels=association == "known")
    if task == "slam":
        inputs = inputs.without_map()
    if inputs.labels_are_sensed:
        print(gate_sentence(setup, sensed=True))
    pausing, block = not wish.run_through and sys.stdin.isatty(), lab_block if wish.lab_text else step_block
    walk = Walk(log, task, name_of(estimator), images, pausing=pausing, block=block)
    if log.evidence is not None and images.wanted:
        from data.visual.opening import Camera, open_recording
        from data.visual.outlined import frame_pictures

        walk.camera = frame_pictures(open_recording(asked.log[0], Camera()), log.evidence.found)
    try:
        run = step_by_step(estimator, inputs, task, association, setup, observer=walk)
        end(log, with_plausibility(run, inputs), images, walk)
    except StoppedError:
        print("stopped; files written so far are complete")


def task_of(log: Log, asked: Sequence[str]) -> str:
    """The first of the given tasks; by default localization in a known map, but SLAM in a corridor."""
    known_map = log.recorded.map is not None and not log.name.startswith("corridor")
    return asked[0] if asked else "localization" if known_map else "slam"


if __name__ == "__main__":
    sys.exit(main())
