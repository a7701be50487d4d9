"""`slamref twin LOG OUT --seed S`: draw a bootstrap replicate of a log, as an open log folder with a true path."""

import sys
from collections.abc import Sequence

from data.errors import UsageError
from data.terminal import counted, ending
from eval.plan.flags import command_of
from eval.replay.settings import ASSOCIATIONS

PROG = "python -m eval.twin"


@ending("interrupted; nothing was written")
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    parser = command_of(prog, PROG, "twin")
    default = "(default: known where LOG has labels, jcbb for walls, else jcbb-hindsight)"
    parser.add_argument("--association", metavar="NAME", help=f"of {', '.join(ASSOCIATIONS)}, or your own {default}")
    options = parser.read(argv)
    from dataclasses import replace

    from data.formats.open_log import write_folder
    from data.logs import open_log
    from eval.compare import compare
    from eval.plan.experiment import check_possible_on, default_task, load_all
    from eval.plan.warming import compile_if_needed
    from eval.replay.estimators import FOR_WALLS
    from eval.replay.external.spec import one_settled
    from eval.replay.settings import HINDSIGHT, Setup
    from eval.studies.twins import inputs_of, smoother_of, source_of, twin

    compile_if_needed()
    log = open_log(options.log)
    task = options.task or default_task(log)
    association = "known" if log.has_labels else HINDSIGHT if log.recorded.sensor.sees_points else FOR_WALLS
    if options.association is not None:
        association = one_settled("--association", options.association, "association")
        load_all((), (association,))
    check_possible_on(log, (task,), (association,))
    inputs, setup = inputs_of(log, task, association), Setup()
    smoother = smoother_of(compare(inputs, task, ("ekf", "batch"), association, setup), inputs)
    if smoother is None:
        raise UsageError(f"log {log.name!r}: no twin, because the EKF fails before the end; try another --association")
    made = twin(source_of(log, smoother, ("ekf",), setup, association), options.seed)
    if log.recorded.map is None:
        # without landmarks.csv, which would be a map for localization
        made = replace(made, truth=replace(made.truth, landmarks=None))
    write_folder(made, options.out)
    seen = int((made.truth.landmark_of >= 0).sum()) if made.truth.landmark_of is not None else 0
    size = f"{counted(len(inputs), 'frame')}, {counted(len(inputs.observations.frame), 'observation')}"
    notes = "".join(f"- {note}\n" for note in made.notes)
    sys.stdout.write(f"{made.name}: {size}, {seen} of them drawn\n{notes}written: {options.out.absolute()}\n")


if __name__ == "__main__":
    sys.exit(main())
