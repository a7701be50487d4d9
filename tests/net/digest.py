"""What is kept of a result folder: for each column of numbers or names an exact digest, and a summary.

The exact digest is of the column's text, for comparison on one machine. The summary tolerates rounding, and so another
processor: how many rows and blanks, and two weighted sums. It is in the units of the column's scale, the sum of its
absolute values.
"""

import csv
import hashlib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

Columns = dict[str, list[str]]
"""The cells of each column, as they are written."""

CLOSE = 1e-6
"""Two summaries are the same if their sums differ by no more, relative to the scale. On another
processor filters stay within 1e-8; the smoothers' optimizers stop elsewhere, and some covariances are off by 1e-7."""
NOTHING = 1e-12  # A scale below this is of rounding alone
WHOLE = "(numbers)"  # The one column of a file without a header: all its numbers, row by row; a word counts as a blank
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)

TOP = ("metrics.csv", "association.csv", "consistency.csv", "trust.csv", "relations.csv", "published.csv")
RUNS = ".csv .tum .g2o"  # Endings of the files below runs/ that something is kept of
LEFT_OUT_FILES = {
    "timing.csv": "how long it took", "provenance.json": "versions and the command", "run.log": "sentences",
    "report.*": "sentences", "tables/*": "the numbers of the other files once more, with heads for readers",
    "figures/*": "pictures", "players/*": "pictures", "runs/*/map.*": "a picture; the path in it is kept",
    "runs/*/lab.txt": "the decisions once more",
}  # fmt: skip
"""Files, as patterns, that nothing is kept of, and why."""
LEFT_OUT_COLUMNS = {("metrics.csv", "lost_why"): "a sentence"}  # File and column that nothing is kept of, and why
EXACT_ONLY = {
    ("metrics.csv", "iterations"): "rounding decides whether an optimizer takes one more step",
    ("metrics.csv", "last_step_sigma"): "what is left of that step is rounding alone",
    ("trust.csv", "frame"): "of largest values that are equal but for rounding either frame is named",
}
"""File and column whose summaries are not compared, and why."""


@dataclass(frozen=True)
class Digest:
    exact: str  # beginning of the SHA-256 of its text
    rows: int  # rows, blanks: how many cells, and how many of them hold no number
    blanks: int
    scale: float | None  # sum of the absolute values; None of a column of words
    sums: tuple[float, float]  # two weighted sums, in billionths of the scale

    def __str__(self) -> str:
        if self.scale is None:
            return f"{self.exact} {self.rows} {self.blanks} words"
        return f"{self.exact} {self.rows} {self.blanks} {self.scale:.10g} {self.sums[0]:.0f} {self.sums[1]:.0f}"

    @staticmethod
    def parse(text: str) -> "Digest":
        exact, rows, blanks, scale, *sums = text.split()
        if scale == "words":
            return Digest(exact, int(rows), int(blanks), None, (0.0, 0.0))
        return Digest(exact, int(rows), int(blanks), float(scale), (float(sums[0]), float(sums[1])))


def digest_of(cells: list[str]) -> Digest:
    """Of the cells of a column; one that has a word in it is a column of words."""
    exact = hashlib.sha256("".join(c + "\n" for c in cells).encode()).hexdigest()[:8]
    values = numbers(cells)
    if values is None:
        return Digest(exact, len(cells), sum(not c for c in cells), None, (0.0, 0.0))
    known = [(i, v) for i, v in enumerate(values) if math.isfinite(v)]
    scale = math.fsum(abs(v) for _, v in known)
    unit = 1e-9 * scale or 1.0
    sums = (
        math.fsum(v * math.cos(0.7 * i + 0.3) for i, v in known) / unit,
        math.fsum(v * math.cos(1.3 * i + 0.1) for i, v in known) / unit,
    )
    return Digest(exact, len(cells), len(values) - len(known), scale, sums)


def numbers(cells: list[str]) -> list[float] | None:
    """The values of a column, NaN where a cell is blank; None where a cell is a word."""
    try:
        return [float(c) if c else math.nan for c in cells]
    except ValueError:
        return None


def moved(now: Digest, kept: Digest, *, exact: bool, close: float = CLOSE) -> str:
    """What is different, as a person is told; empty: nothing."""
    if now.rows != kept.rows:
        return f"{now.rows} rows were {kept.rows}"
    if now.blanks != kept.blanks:
        return f"{now.blanks} blanks were {kept.blanks}"
    if now.exact == kept.exact:
        return ""
    if exact:
        return "other text" + ("" if _apart(now, kept, close) else ", the same but for rounding")
    return _apart(now, kept, close)


def _apart(now: Digest, kept: Digest, close: float) -> str:
    if now.scale is None or kept.scale is None:
        return "other words"
    if max(now.scale, kept.scale) < NOTHING:
        return ""
    off = abs(now.scale - kept.scale) / max(now.scale, kept.scale)
    off = max(off, *(1e-9 * abs(a - b) for a, b in zip(now.sums, kept.sums, strict=True)))
    return f"sums off by {off:.2g} of the scale {kept.scale:.4g}" if off > close else ""


def columns_of(folder: Path, runs: str = RUNS) -> dict[str, Columns]:
    """Every file of a result folder that something is kept of, with its columns; of `runs/` those that end so."""
    return {name: _columns(folder / name, name) for name in files_of(folder) if watched(name, runs)}


def files_of(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def watched(name: str, runs: str = RUNS) -> bool:
    return name in TOP or (name.startswith("runs/") and name.endswith(tuple(runs.split())))


def left_out(name: str) -> bool:
    """Whether it is known that nothing of this file is kept."""
    return any(fnmatch(name, pattern) for pattern in LEFT_OUT_FILES)


def _columns(path: Path, name: str) -> Columns:
    if not name.endswith(".csv"):
        words = path.read_text("utf-8").split()
        return {WHOLE: [w if NUMBER.fullmatch(w) else "" for w in words]}
    with path.open(newline="", encoding="utf-8") as file:
        head, *rows = list(csv.reader(file))
    base = path.name
    return {c: [r[k] for r in rows] for k, c in enumerate(head) if (base, c) not in LEFT_OUT_COLUMNS}


def digests(columns: Mapping[str, Columns]) -> dict[str, dict[str, str]]:
    return {name: {c: str(digest_of(cells)) for c, cells in held.items()} for name, held in columns.items()}


def compare(
    now: Mapping[str, Mapping[str, str]], kept: Mapping[str, Mapping[str, str]], *, exact: bool, close: float = CLOSE
) -> Iterator[tuple[str, str, str]]:
    for name, columns in kept.items():
        if name not in now:
            yield name, "", "vanished"
            continue
        for column, text in columns.items():
            if column not in now[name]:
                yield name, column, "vanished"
            elif not exact and (name, column) in EXACT_ONLY:
                continue
            elif what := moved(Digest.parse(now[name][column]), Digest.parse(text), exact=exact, close=close):
                yield name, column, what


def appeared(now: Mapping[str, Mapping[str, str]], kept: Mapping[str, Mapping[str, str]]) -> Iterator[tuple[str, str]]:
    """Files and columns that the record does not know, which is no failure."""
    for name, columns in now.items():
        if name not in kept:
            yield name, ""
            continue
        yield from ((name, c) for c in columns if c not in kept[name])
