"""What both studies of foreign worlds share: rows in a CSV that an interrupted run goes on with, and shares."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from eval.plan.flags.table import Execution
from eval.plan.work import Job, work
from tests.research.rows import Kept, append, read

SECONDS = 10.0  # Of a case, roughly: enough for processes of their own
LINE_EACH = 20  # Cases per line of progress


class Case(NamedTuple):
    """A log by the arguments of `make`, and how it is run; `fault` is empty for a sound log."""

    shape: str
    seed: int
    fault: str
    task: str
    association: str
    strength: float = 1.0


def done_all(
    cases: Sequence[Case], one: Callable[..., Kept], kind: type[Kept], file: Path, jobs: int,
    arguments: tuple[object, ...] = (),
) -> list[Kept]:  # fmt: skip
    """`one(case, *arguments)` of each case that is not in the file yet, added to it; the rows of all cases."""
    kept = {Case(*row[: len(Case._fields)]): row for row in read(kind, file)}
    missing = [case for case in cases if case not in kept]
    if missing:
        print(f"{len(cases) - len(missing)} of {len(cases)} are in {file}", flush=True)
    found = work([Job(c, one, (c, *arguments), SECONDS) for c in missing], Execution(jobs=jobs))
    begin = time.perf_counter()
    for count, (case, row) in enumerate(found, start=1):
        kept[case] = row
        append(row, file)
        if count % LINE_EACH == 0 or count == len(missing):
            each = (time.perf_counter() - begin) / count
            print(
                f"{count} of {len(missing)}, {each:.1f} s each, {each * (len(missing) - count):.0f} s left", flush=True
            )
    return [kept[case] for case in cases]


def wilson(count: int, of: int, z: float = 1.96) -> tuple[float, float]:
    """95 % bounds of a share (Wilson 1927); 0 and 1 where nothing was counted."""
    if not of:
        return 0.0, 1.0
    share, width = count / of, z * z / of
    middle = (share + 0.5 * width) / (1.0 + width)
    half = z * math.sqrt(share * (1.0 - share) / of + 0.25 * width / of) / (1.0 + width)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def share(count: int, of: int) -> str:
    """A share with its bounds, in %."""
    low, high = wilson(count, of)
    return f"{count}/{of} = {100.0 * count / of if of else math.nan:.1f} % [{100.0 * low:.1f}, {100.0 * high:.1f}]"


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def counted(rows: Iterable[str]) -> str:
    return ", ".join(f"{word} {n}" for word, n in Counter(rows).most_common())
