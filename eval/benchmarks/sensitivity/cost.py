"""What a study costs: the runs that are needed, constants that a log does not read left out, and their time."""

from __future__ import annotations

from collections.abc import Sequence

from eval.benchmarks.sensitivity.measure import jobs_of
from eval.benchmarks.sensitivity.reading import counts_in, reads
from eval.benchmarks.sensitivity.rows import Row
from eval.benchmarks.sensitivity.varying import DIRECTIONS, Constant, varied


def cost_lines(base: Sequence[Row], constants: Sequence[Constant]) -> list[str]:
    """Baselines as lines of a Markdown table, fastest first: their time, and that of all runs beside them."""
    lines = [
        "| log | task | readings | seconds | status | constants read | runs | time of these [min] | summed |",
        "|---|---|---:|---:|---|---:|---:|---:|---:|",
    ]
    total, runs = 0.0, 0
    for row in sorted(base, key=lambda r: r.seconds):
        count = len(jobs_of(row, constants))
        read = sum(reads(c, row.task, row.reads) for c in constants)
        minutes = count * row.seconds / 60.0
        total, runs = total + minutes, runs + count
        lines.append(
            f"| {row.log} | {row.task} | {row.readings} | {row.seconds:.2f} | {row.status} | {read} | {count} |"
            f" {minutes:.1f} | {total:.1f} |"
        )
    every = sum(varied(c, d) is not None for c in constants for d in DIRECTIONS) * len(base)
    return [*lines, "", f"{runs} runs instead of {every}, {total:.0f} minutes of one core if all take as long"]


def read_lines(base: Sequence[Row], constants: Sequence[Constant]) -> list[str]:
    """How often each constant is read, as lines of a Markdown table: by task on how many logs, and looks in all."""
    tasks = list(dict.fromkeys(r.task for r in base))
    lines = [
        "| constant | value | " + " | ".join(f"{t}, logs | looks" for t in tasks) + " |",
        "|---|---:|" + "---:|---:|" * len(tasks),
    ]
    for c in constants:
        cells = []
        for task in tasks:
            of = [r for r in base if r.task == task]
            looks = sum(counts_in(r.reads).get(c.name, 0) for r in of)
            on = sum(reads(c, task, r.reads) for r in of)
            cells.append(f"{on} of {len(of)} | {'every run' if c.task == task else looks}")
        lines.append(f"| `{c.name}` | {c.value} | " + " | ".join(cells) + " |")
    return lines
