"""`slamref audit GRAPH`: any factor graph examined: which factor is wrong, which noise, what is unchecked."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from data.command import Command, count
from data.terminal import ending
from eval.plan.flags import texts_of
from eval.plan.flags.table import HELP

PROG = "slamref audit"
NOISES = ("information", "covariance", "root", "half-angle", "rotation-first")


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    parser = Command(prog, PROG, *texts_of("audit"))
    parser.add_argument("graph", metavar="GRAPH", help="a .g2o, .graph or .txt file, or FILE.py:FUNCTION")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--optimize", action="store_true", help="optimize first (default for a file)")
    how.add_argument("--as-given", action="store_true", help="take the values as they are (default for a function)")
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for tables and report.html")
    parser.add_argument("--noise", choices=NOISES, help=HELP["audit_noise"])
    parser.add_argument("--rescale", metavar="FILE", type=Path, help=HELP["audit_rescale"])
    parser.add_argument("--rejected", choices=("leave-out", "robust"), default="leave-out", help=HELP["audit_rejected"])
    parser.add_argument("--steps", metavar="N", type=count, default=30, help=HELP["audit_steps"])
    parser.add_argument("--draws", metavar="N", type=count, default=200, help="draws of the graph (default: 200)")
    parser.add_argument("--seed", metavar="S", type=count, default=0, help="random seed (default: 0)")
    return _audit(parser.read(argv), prog)


SOON = 5.0  # s, until which no stage is told


def _audit(options: argparse.Namespace, prog: str) -> int:
    from eval.report.words import say
    from wings.audit.examined import shown, shown_tables, write_audit
    from wings.audit.page import cured, opened

    optimize = options.optimize if options.optimize or options.as_given else None
    began = time.monotonic()

    def told(stage: str, **numbers: float) -> None:  # of a graph that takes long
        if (passed := time.monotonic() - began) > SOON:
            sys.stderr.write(f"{passed:5.0f} s: {say(f'audit#{stage}', **numbers)}\n")
            sys.stderr.flush()

    found = opened(
        options.graph, optimize, options.draws, options.seed, resolve=20, noise=options.noise, steps=options.steps,
        told=told,
    )  # fmt: skip
    report = found.report
    parts = [report.words(), *(table.to_string(index=False) for table in shown_tables(report).values())]
    if found.file is not None and found.file.noise:
        parts.append(f"The noise of text is taken as {found.file.noise} (--noise).")
    sys.stdout.write("\n\n".join(parts) + "\n")
    if options.out is not None:
        name = Path(options.graph).name  # where a file lies is nobody else's business
        write_audit(report, options.out, f"Audit of {name}", f"{prog} {name}")
        sys.stdout.write(f"\nwritten: {options.out.absolute()}\n")
    if options.rescale is not None:
        table = cured(found, options.rescale, options.draws, options.seed, robust=options.rejected == "robust")
        sys.stdout.write(f"\n{shown(table).to_string(index=False)}\nwritten: {options.rescale.absolute()}\n")
    return int(report.rejected)
