"""`python -m tests.research.sources`: size and power of the diagnosis on logs with fixes and closures.

Logs of the world `mixed`, sound or with one fault in a source; printed: how often something is objected to, and how
often the first cause names the source.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from data.command import Parser
from data.log import Log
from data.logs import open_log
from eval.judgement.causes import cause_word
from eval.report.calls import twins


def biased(log: Log) -> Log:
    """GPS is half a metre off."""
    fixes = log.recorded.fixes
    z = fixes.z + np.array([0.5, 0.0, 0.0]) * (fixes.source == 0)[:, None]
    return replace(log, recorded=replace(log.recorded, fixes=replace(fixes, z=z)))


def too_sure(log: Log) -> Log:
    """The sigma of GPS is stated three times too small."""
    fixes = log.recorded.fixes
    factor = np.where(fixes.source == 0, 1.0 / 9.0, 1.0)[:, None, None]
    return replace(log, recorded=replace(log.recorded, fixes=replace(fixes, covariance=factor * fixes.covariance)))


def late(log: Log) -> Log:
    """GPS is half a second older than stamped."""
    fixes, truth = log.recorded.fixes, log.truth.pose
    before = np.maximum(fixes.frame - 1, 0)
    off = np.where((fixes.source == 0)[:, None], truth[before, :2] - truth[fixes.frame, :2], 0.0)
    z = fixes.z.copy()
    z[:, :2] += off
    return replace(log, recorded=replace(log.recorded, fixes=replace(fixes, z=z)))


def unsure(log: Log) -> Log:
    """The sigma of closures is stated three times too small."""
    closures = log.recorded.closures
    return replace(
        log, recorded=replace(log.recorded, closures=replace(closures, covariance=closures.covariance / 9.0))
    )


CASES: dict[str, tuple[str, Callable[[Log], Log], str]] = {
    "sound": ("", lambda log: log, "nothing"),
    "bias": ("", biased, "gps"),
    "sigma": ("", too_sure, "gps"),
    "late": ("", late, "gps"),
    "jumps": ("jumps", lambda log: log, "gps"),
    "false": ("false-closures", lambda log: log, "loops"),
    "closure-sigma": ("", unsure, "loops"),
}
"""Options of the world, a fault, and what is to blame."""


def main() -> None:
    """Diagnose logs of the cases asked for."""
    parser = Parser(prog="python -m tests.research.sources", description="Size and power of the diagnosis of sources.")
    parser.add_argument("case", nargs="+", choices=CASES)
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--twins", type=int, default=39)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--task", default="localization")
    options = parser.parse_args()
    for case in options.case:
        more, fault, to_blame = CASES[case]
        found: list[str] = []
        rejected = 0
        for seed in range(options.seed, options.seed + options.logs):
            name = f"mixed:{seed}:frames={options.frames}" + (f"+{more}" if more else "")
            diagnosis = twins(fault(open_log(name)), task=options.task, count=options.twins)
            blame = diagnosis.trust.blame
            rejected += bool(blame is not None and blame.objected)
            found.append(cause_word(diagnosis.trust))
            first = blame.findings[:1] if blame is not None else ()
            print(
                f"{case} {seed}: {found[-1]}, p {diagnosis.p:.3g} {[(f.kind, f.name, f.size) for f in first]}",
                flush=True,
            )
        right = sum(c == to_blame for c in found)
        print(
            f"{case}: {rejected} of {options.logs} objected to, {right} named {to_blame}: {dict(Counter(found))}",
            flush=True,
        )


if __name__ == "__main__":
    main()
