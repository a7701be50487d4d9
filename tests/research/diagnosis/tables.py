"""Tables of the study of the diagnosis: how often sound logs are rejected (size), and faults detected (power).

Size: logs without a fault; share rejected by the battery with its exact (Clopper-Pearson) interval, share whose NIS of
filter or smoother is outside its 95 % bounds, causes named. The estimator is named where its NEES or NIS on the
replicates is off; where linearization is the reason, this is correct.

Power: share of logs with a fault that the battery rejects (a broken filter also by its NEES or NIS on the replicates)
with its binomial standard error, and share that NIS alone rejects; of the detected, the share put down to the right
cause, and the cause most often named instead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, NOISE
from eval.referee.consistency import share_interval
from tests.research.diagnosis.broken import BROKEN
from tests.research.diagnosis.faults import FAULTS
from tests.research.diagnosis.study import SOUND, Examined, Validation

CAUSES = (NOISE, ASSOCIATIONS, ESTIMATOR)
SHARES = ("objected [%]", "95 % interval", "NIS alone [%]", *(f"{cause} [%]" for cause in CAUSES))
SIZE = ("world", "task", "logs", *SHARES, "failed")
POWER = ("fault", "size", "logs", "detected [%]", "±", "NIS alone [%]", "right cause [%]", "taken for", "failed")
SURE = 0.9
"""Detected in at least this share of the logs, a fault should be put down to the right cause in `GOAL` of them."""
GOAL = 0.8


def size_table(study: Validation, found: Sequence[Examined]) -> pd.DataFrame:
    """A row for each world, and one for all."""
    rows: list[list[object]] = []
    sound = [e for e in found if e.fault == SOUND]
    for world in study.worlds:
        rows.append([world.name, world.task, *_size([e for e in sound if e.world == world.name])])
    if len(study.worlds) > 1:
        rows.append(["all", "", *_size(sound)])
    return pd.DataFrame(rows, columns=list(SIZE))


def _size(found: Sequence[Examined]) -> list[object]:
    good = [e for e in found if not e.failure]
    n, objected = len(good), sum(e.objected for e in good)
    lower, upper = share_interval(objected, n)
    causes = [_percent(sum(e.cause == c for e in good), n) for c in CAUSES]
    interval = f"{100 * lower:.1f}…{100 * upper:.1f}" if n else ""
    nis = _percent(sum(e.nis for e in good), n)
    return [n, _percent(objected, n), interval, nis, *causes, len(found) - n]


def power_table(study: Validation, found: Sequence[Examined]) -> pd.DataFrame:
    """A row for each fault and size, first for logs without any; broken filters last."""
    rows = [_power("none", "", [e for e in found if e.fault == SOUND and e.world == study.power])]
    for (fault, size), own in _groups(found).items():
        unit = FAULTS[fault].unit if fault in FAULTS else ""
        called = fault if fault in FAULTS else f"filter: {fault}"
        rows.append(_power(called, f"{size:g} {unit}".rstrip(), own))
    return pd.DataFrame(rows, columns=list(POWER))


def _groups(found: Sequence[Examined]) -> dict[tuple[str, float], list[Examined]]:
    """Logs by fault and size, in the order of the lists of faults."""
    every = [(name, size) for faults in (FAULTS, BROKEN) for name, f in faults.items() for size in f.sizes]
    groups = {key: [e for e in found if (e.fault, e.size) == key] for key in every}
    return {key: own for key, own in groups.items() if own}


def detected(e: Examined) -> bool:
    """Whether a fault shows: the battery rejects, or the NEES on replicates is off for a broken filter."""
    return e.objected or (e.convicted and e.fault in BROKEN)


def right_cause(fault: str) -> str:
    """What a fault must be put down to."""
    return FAULTS[fault].cause if fault in FAULTS else ESTIMATOR


def _power(called: str, size: str, found: Sequence[Examined]) -> list[object]:
    good = [e for e in found if not e.failure]
    seen = [e for e in good if detected(e)]
    n = len(good)
    share = len(seen) / n if n else math.nan
    error = math.sqrt(share * (1.0 - share) / n) if n else math.nan
    nis = _percent(sum(e.nis for e in good), n)
    right, other = math.nan, ""
    if seen and seen[0].fault != SOUND:
        cause = right_cause(seen[0].fault)
        wrong = [e.cause for e in seen if e.cause != cause]
        right = _percent(len(seen) - len(wrong), len(seen))
        other = max(sorted(set(wrong)), key=wrong.count) if wrong else ""
    return [called, size, n, 100.0 * share, 100.0 * error, nis, right, other, len(found) - n]


def goal(found: Sequence[Examined]) -> tuple[int, int]:
    """Faults that are surely detected, and how many of them are put down to the right cause often enough."""
    sure, met = 0, 0
    for (fault, _), own in _groups(found).items():
        good = [e for e in own if not e.failure]
        seen = [e for e in good if detected(e)]
        if seen and len(seen) >= SURE * len(good):
            sure += 1
            met += sum(e.cause == right_cause(fault) for e in seen) >= GOAL * len(seen)
    return sure, met


def _percent(hits: int, n: int) -> float:
    return 100.0 * hits / n if n else math.nan
