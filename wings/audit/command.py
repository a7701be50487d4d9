"""`slamref audit GRAPH`: any factor graph examined: which factor is wrong, which noise, what is unchecked."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from data.errors import UsageError
from data.terminal import ending
from eval.plan.flags import command_of

PROG = "slamref audit"
SOON = 5.0  # s, until which no stage is told


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    options = command_of(prog, PROG, "audit").read(argv)
    if options.optimize and options.as_given:
        raise UsageError("--optimize and --as-given contradict each other; give one of them")
    from eval.report.words import say
    from wings.audit.examined import shown, shown_tables, write_audit
    from wings.audit.page import cured, opened

    optimize = options.optimize if options.optimize or options.as_given else None
    began = time.monotonic()

    def told(stage: str, **numbers: float) -> None:  # of a graph that takes long
        if (passed := time.monotonic() - began) > SOON:
            sys.stderr.write(f"{passed:5.0f} s: {say(f'audit#{stage}', **numbers)}\n")
            sys.stderr.flush()

    graph, *more = options.graph
    found = opened(
        graph, optimize, options.draws, options.seed, resolve=20, noise=options.noise, steps=options.steps, told=told,
        more=more,
    )  # fmt: skip
    report = found.report
    parts = [report.words(), *(table.to_string(index=False) for table in shown_tables(report).values())]
    if found.file is not None and found.file.noise:
        parts.append(f"The noise of text is taken as {found.file.noise} (--noise).")
    sys.stdout.write("\n\n".join(parts) + "\n")
    if options.out is not None:
        name = " ".join(Path(file).name for file in options.graph)  # where they lie is nobody else's business
        write_audit(report, options.out, f"Audit of {name}", f"{prog} {name}")
        sys.stdout.write(f"\nwritten: {options.out.absolute()}\n")
    if options.rescale is not None:
        table = cured(found, options.rescale, options.draws, options.seed, robust=options.rejected == "robust")
        sys.stdout.write(f"\n{shown(table).to_string(index=False)}\nwritten: {options.rescale.absolute()}\n")
    return int(report.rejected)
