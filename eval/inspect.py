"""`slamref inspect LOG`: contents of a log, unusual values, questions to its author, a plot; and `report-problem`."""

import sys
from collections.abc import Sequence
from pathlib import Path

from data.errors import UsageError
from data.terminal import ending
from eval.plan.flags import command_of

PROG = "python -m eval.inspect"
PICTURES = (".png", ".pdf")


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    options = command_of(prog, PROG, "inspect").read(argv)
    plot: Path | None = options.plot
    if plot is not None and plot.suffix not in PICTURES:
        raise UsageError(f"--plot {plot}: a file name that ends in {' or '.join(PICTURES)} is needed")
    from data.logs import open_log
    from data.questions.asked import ask
    from data.questions.summary import summarize
    from data.words import sentence, title

    opened = open_log(options.log)
    lines = summarize(opened)
    lines += [("question", f"{title(question)}: {sentence(question)}") for question in ask(opened)]
    width = max(len(key) for key, _ in lines)
    for key, text in lines:
        print(f"{key:<{width}}  {text}")
    if plot is not None:
        from eval.figures.map import log_figure
        from eval.figures.style import save

        try:
            save(log_figure(opened), plot.parent, plot.stem, (plot.suffix[1:],))
        except OSError as fault:
            raise UsageError(f"--plot {plot}: cannot be written: {fault.strerror}") from fault


@ending("interrupted; nothing was written")
def problem(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `slamref report-problem`; returns its exit status."""
    options = command_of(prog, PROG, "problem").read(argv)
    from eval.report.problem import pack

    if len(options.input) > 2:
        raise UsageError(f"{len(options.input)} files: a log, or an estimate and its truth, are needed")
    print(f"{pack(options.input, options.out)}\nwritten: {options.out.absolute()}")


if __name__ == "__main__":
    sys.exit(main())
