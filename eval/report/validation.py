"""The report's section on a study of the battery: how often it objects to what is right, what it finds and names."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd

from eval.figures import Seen, power_figure
from eval.figures.style import save
from eval.page.document import Block, Picture, Section, Table
from eval.referee import battery
from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, NOISE
from eval.referee.bounds import share_interval
from eval.studies.broken import BROKEN
from eval.studies.faults import FAULTS
from eval.studies.validation import SOUND, Examined, Validation

Writer = Callable[[pd.DataFrame, str, str], Table]
SIZE = ("world", "task", "logs", "objected [%]", "95 % interval", "NIS alone [%]", "noise [%]", "associations [%]",
        "estimator [%]", "failed")  # fmt: skip
POWER = ("fault", "size", "logs", "detected [%]", "±", "NIS alone [%]", "right cause [%]", "taken for", "failed")
TESTS = ("battery", "NIS alone")
SURE = 0.9
"""Detected in at least this share of the logs, a fault should be put down to the right cause in `GOAL` of them."""
GOAL = 0.8


def validation_section(
    study: Validation, found: Sequence[Examined], table: Writer, figures: Path | None = None
) -> Section:
    """Both tables, with what they say in a line each; a figure of the power where `figures` is a folder."""
    size, power = size_table(study, found), power_table(study, found)
    sound = [e for e in found if e.fault == SOUND and not e.failure]
    objected = sum(e.objected for e in sound)
    blocks: list[Block] = [
        f"{study.about} {study.runs} logs of each world, {study.twins} twins of each log, family-wise level"
        f" {100 * battery.LEVEL:g} %.",
        f"Of {len(sound)} logs that are right, {objected} are objected to ({_percent(objected, len(sound)):.1f} %).",
        table(size, f"{study.name}_size", SIZE_CAPTION),
    ]
    if len(power) > 1:
        blocks += [_goal(study, found), table(power, f"{study.name}_power", POWER_CAPTION)]
        if figures is not None:
            blocks.append(_picture(figures, study, power))
    return Section(f"Scenario {study.name}: what a log says about itself, tested", tuple(blocks), level=2)


def _picture(folder: Path, study: Validation, power: pd.DataFrame) -> Picture:
    stem = f"{study.name}_power"
    faults = []
    for name, own in power[power["size"] != ""].groupby("fault", sort=False):
        shares = (tuple(own[column]) for column in ("detected [%]", "±", "NIS alone [%]"))
        unit = FAULTS[str(name)].unit if name in FAULTS else ""
        called = f"{name} [{unit}]" if unit else str(name)
        faults.append(Seen(called, tuple(size.split()[0] for size in own["size"]), *shares))
    title = f"{study.name}: {study.power_runs} logs of {study.power} for each fault and size"
    save(power_figure(faults, TESTS, 100.0 * battery.LEVEL, title), folder, stem)
    caption = "share of the logs in which a fault is seen, against its size; dashed: logs without a fault, by design."
    return Picture(stem, f"{title}: {caption}", "Power of the battery and of NIS against the size of each fault")


SIZE_CAPTION = (
    "Logs that are right: share that the battery objects to, with its exact (Clopper-Pearson) interval; share whose"
    " NIS, of filter or smoother, is outside its 95 % bounds; causes named. An estimator is named where its NEES or NIS"
    " on twins is off, which is right where linearization makes it so."
)
POWER_CAPTION = (
    "Faults: share of the logs in which the battery objects (a broken filter also where its NEES or NIS on twins is"
    " off) with its binomial standard error, and share in which NIS alone would; of the detected, the share put down to"
    " the right cause, and the cause most often named instead."
)


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
    causes = [_percent(sum(e.cause == c for e in good), n) for c in (NOISE, ASSOCIATIONS, ESTIMATOR)]
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
    """Whether a fault shows: the battery objects, or the NEES on twins is off where the filter is what is broken."""
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


def _goal(study: Validation, found: Sequence[Examined]) -> str:
    """How many of the faults that are surely detected are put down to the right cause often enough."""
    sure, met = 0, 0
    for (fault, _), own in _groups(found).items():
        good = [e for e in own if not e.failure]
        seen = [e for e in good if detected(e)]
        if seen and len(seen) >= SURE * len(good):
            sure += 1
            met += sum(e.cause == right_cause(fault) for e in seen) >= GOAL * len(seen)
    return (
        f"In `{study.power}`, {sure} faults are detected in {100 * SURE:g} % of the logs or more; {met} of them are put"
        f" down to the right cause in {100 * GOAL:g} % of those or more."
    )


def _percent(hits: int, n: int) -> float:
    return 100.0 * hits / n if n else math.nan
