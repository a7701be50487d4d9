"""The result of the study: what each constant, halved and doubled, does to decisions, errors and maps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tests.research.sensitivity.cases import DIRECTIONS, DOUBLED, HALVED, Case, Constant, reads, text, varied
from tests.research.sensitivity.measure import BASE, Row, jobs_of

RMSE_LITTLE = 0.1
"""A change of the RMSE by less than this part, up or down, is little; ..."""
COUNTS_LITTLE = 0.02
"""... and one of FP and landmarks together by less than this share of the readings."""
NOT_READ, NO_RESULT, LITTLE, MATTERS = "not read", "no result", "little", "matters"


class Effect(NamedTuple):
    """What one run with a changed constant has beside the baseline.

    rmse: RMSE by that of the baseline; 1 where neither has one, infinite where the run lost its end, 0 where it won
    one; fp: change as a share of the readings; landmarks: change of their number; counts: change of both, as a share of
    the readings.
    """

    row: Row
    rmse: float
    fp: float
    landmarks: int
    counts: float

    @property
    def little(self) -> bool:
        """Whether it is next to nothing."""
        within = 1.0 / (1.0 + RMSE_LITTLE) <= self.rmse <= 1.0 + RMSE_LITTLE
        return within and self.counts <= COUNTS_LITTLE


class Summary(NamedTuple):
    """A constant in the study.

    logs: cases that read it; runs, needed: done, and how many it takes; halved, doubled: cases whose decisions change;
    effects: of all runs; says: the class.
    """

    constant: Constant
    logs: int
    runs: int
    needed: int
    halved: int
    doubled: int
    effects: tuple[Effect, ...]
    says: str


def effect(row: Row, base: Row) -> Effect:
    """A run beside its baseline."""
    n = max(row.readings, 1)
    fp, landmarks = row.fp - base.fp, row.landmarks - base.landmarks
    if row.status != base.status:
        rmse = math.inf if base.status == "ok" else 0.0
    elif math.isnan(row.rmse_m) or math.isnan(base.rmse_m) or row.rmse_m == base.rmse_m:
        rmse = 1.0
    else:
        rmse = row.rmse_m / base.rmse_m if base.rmse_m > 0.0 else math.inf
    return Effect(row, rmse, fp / n, landmarks, (abs(fp) + abs(landmarks)) / n)


def summaries(rows: Sequence[Row], constants: Sequence[Constant]) -> list[Summary]:
    """Every constant over all cases of the rows, in its order."""
    base = {Case(r.log, r.task): r for r in rows if r.direction == BASE}
    found = []
    for c in constants:
        effects = tuple(
            effect(r, base[Case(r.log, r.task)])
            for r in rows
            if r.constant == c.name and r.direction != BASE and Case(r.log, r.task) in base
        )
        logs = sum(reads(c, b.task, b.reads) for b in base.values())
        needed = sum(len(jobs_of(b, [c])) for b in base.values())
        half, twice = (sum(e.row.direction == d and not e.row.same for e in effects) for d in DIRECTIONS)
        found.append(Summary(c, logs, len(effects), needed, half, twice, effects, _class(logs, effects)))
    return found


def _class(logs: int, effects: Sequence[Effect]) -> str:
    if not logs:
        return NOT_READ
    if not all(e.little for e in effects):
        return MATTERS
    return NO_RESULT if all(e.row.same for e in effects) else LITTLE


def table(found: Sequence[Summary]) -> list[str]:
    """The summaries as lines of a Markdown table, and how many constants there are of each class."""
    lines = [
        "| constant | value | halved | doubled | logs | decisions change, halved | doubled | RMSE ratio, median |"
        " least | most | FP, least [% of readings] | most | landmarks, least | most | class |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|",
    ]
    for s in found:
        half, twice = ("–" if (v := varied(s.constant, d)) is None else text(v) for d in (HALVED, DOUBLED))
        says = s.says if s.runs >= s.needed else f"{s.says} ({s.runs} of {s.needed} runs)"
        lines.append(
            f"| `{s.constant.name}` | {text(s.constant.value)} | {half} | {twice} | {s.logs} | {s.halved} |"
            f" {s.doubled} | {_changes(s)} | {says} |"
        )
    number = {says: sum(s.says == says for s in found) for says in (MATTERS, LITTLE, NO_RESULT, NOT_READ)}
    return [*lines, "", ", ".join(f"{says}: {count}" for says, count in number.items())]


def _changes(s: Summary) -> str:
    """Median of the RMSE ratio over runs whose decisions changed, and extremes over all runs."""
    if not s.effects:
        return " | ".join("–" * 7)
    rmse, other = [e.rmse for e in s.effects], [e.rmse for e in s.effects if not e.row.same]
    fp, landmarks = [100.0 * e.fp for e in s.effects], [e.landmarks for e in s.effects]
    return (
        f"{np.median(other) if other else 1.0:.3f} | {min(rmse):.2f} | {max(rmse):.2f} | {min(fp):+.1f} |"
        f" {max(fp):+.1f} | {min(landmarks):+d} | {max(landmarks):+d}"
    )
