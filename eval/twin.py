"""`python -m eval.twin LOG OUT --seed S`: a log drawn again as it says of itself, as an open log folder with a truth.

Only the parser is imported at once, so that `--help` does not wait for the numerical libraries.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from data.command import Command
from data.errors import UsageError
from data.terminal import counted, ended
from eval.replay.settings import ASSOCIATIONS, TASKS

PROG = "python -m eval.twin"
HELP = """\
Draw a log again as it says of itself: the path and map of the batch smoother stand for the truth; prior, increments and
readings are drawn with the covariances that LOG states, at the same frames, of the same landmarks. What the smoother
did not use is copied as it was read, and is clutter of the twin. OUT has what LOG may lack: a true path, and for every
reading the landmark it is of. Twins show what an estimator does on this very geometry where everything is as stated;
`python -m eval.run_all --log LOG --twins N` compares LOG with N of them."""
EXAMPLES = """\
examples:
  python -m eval.twin victoria-park park-twin --seed 1
  python -m eval.run_all --log park-twin --estimator ekf,batch
  python -m eval.twin my_log my_twin --seed 3 --association jcbb

exit status: 0 fine, 2 wrong usage or bad data"""


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The whole command, called `prog`; returns the exit status."""
    return ended(lambda: _twin_as_asked(argv, prog), "interrupted; nothing was written")


def _twin_as_asked(argv: Sequence[str] | None, prog: str) -> None:
    parser = Command(prog, PROG, HELP, EXAMPLES)
    parser.add_argument("log", metavar="LOG", help="an open log folder, or a name: victoria-park, arena:SEED, ...")
    parser.add_argument("out", metavar="OUT", type=Path, help="folder of the twin; an earlier log there is replaced")
    parser.add_argument("--seed", type=_seed, default=0, metavar="S", help="of everything that is drawn (default: 0)")
    parser.add_argument(
        "--task", choices=TASKS, help="whose path is the truth (default: localization where LOG has a map, else slam)"
    )
    parser.add_argument(
        "--association",
        metavar="NAME",
        help=f"who pairs the readings: of {', '.join(ASSOCIATIONS)}, or your own (default: known where LOG has labels, "
        "else jcbb-hindsight, of walls jcbb)",
    )
    options = parser.read(argv)
    from eval.plan.warming import compile_if_needed

    compile_if_needed()
    sys.stdout.write(_run(options))


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r}: a whole number, not negative, is needed")
    return int(text)


def _run(options: argparse.Namespace) -> str:
    """Estimate, draw, write; gives the report."""
    from dataclasses import replace

    from data.formats.open_log.writer import write_folder
    from data.logs import open_log
    from eval.compare import compare
    from eval.plan.foreign import load_all
    from eval.replay.estimators import FOR_WALLS
    from eval.replay.external.spec import one_settled
    from eval.replay.settings import HINDSIGHT, Setup
    from eval.studies.sampled import smoother_of
    from eval.studies.twins import inputs_of, source_of, twin

    log = open_log(options.log)
    task = options.task or ("slam" if log.recorded.map is None else "localization")
    if task == "localization" and log.recorded.map is None:
        raise UsageError(f"--task localization: log {log.name!r} has no map; only slam makes sense")
    association = "known" if log.has_labels else HINDSIGHT if log.recorded.sensor.sees_points else FOR_WALLS
    if options.association is not None:
        association = one_settled("--association", options.association, "association")
        load_all((), (association,))
    if association == "known" and not log.has_labels:
        raise UsageError(f"--association known: log {log.name!r} has no labels")
    inputs, setup = inputs_of(log, task, association), Setup()
    smoother = smoother_of(compare(inputs, task, ("ekf", "batch"), association, setup), inputs)
    if smoother is None:
        raise UsageError(f"no twin of {log.name}: the filter that the smoother starts from does not get to the end")
    made = twin(source_of(log, smoother, ("ekf",), setup, association), options.seed)
    if log.recorded.map is None:
        # landmarks.csv would be a map to localize in, which the log does not have
        made = replace(made, truth=replace(made.truth, landmarks=None))
    write_folder(made, options.out)
    seen = int((made.truth.landmark_of >= 0).sum()) if made.truth.landmark_of is not None else 0
    lines = [
        f"{made.name}: {counted(len(inputs), 'frame')}, {counted(len(inputs.observations.frame), 'reading')},"
        f" {seen} of them drawn anew",
        *(f"- {note}" for note in made.notes),
        f"written: {options.out.absolute()}",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
