"""The logs of the study: worlds of the variety, and named logs, recorded ones where they are at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from data.errors import DataError, UsageError
from data.log import Log
from data.mrclam.load import corrected_landmarks, load_mrclam
from data.recordings.victoria_park import load_victoria_park
from data.worlds.registry import is_simulated, named_log, parse
from eval.benchmarks.sensitivity.varying import LOCALIZATION, SLAM
from eval.studies.variety.draw import KINDS, draw, indices
from eval.studies.variety.world import log_of

SIMULATED = "corridor:0:people"
VICTORIA_PARK = "victoria-park"
VARIETY, UTIAS = "variety", "utias"
DATASETS = {1: (1, 2, 3, 4, 5), 6: (1, 2, 3, 4, 5), 9: (3,)}
"""UTIAS datasets and the robots of each that the documentation has figures of."""
ROBOT = 3
"""The one that is run if not all are."""


class Case(NamedTuple):
    """A log by its name, and the task."""

    log: str
    task: str


def world_name(index: int) -> str:
    """Of a world of the variety."""
    return f"{VARIETY}-{index:03d}"


def is_world(log: str) -> bool:
    """Whether a log is one of the variety."""
    return log.startswith(f"{VARIETY}-")


def worlds(half: str, count: int | None) -> list[Case]:
    """Those of a half, or some of them: of the three kinds in turn, those with the fewest readings first."""
    every = indices(half, 10**6)
    if count is None or count >= len(every):
        return [Case(world_name(i), SLAM) for i in every]
    size = {i: len(log_of(draw(i)).recorded.observations.frame) for i in every} if count else {}
    return [Case(world_name(i), SLAM) for i in fewest(size, count)]


def fewest(size: Mapping[int, int], count: int) -> list[int]:
    """Indices of `count` worlds, ascending, of the three kinds in turn those of the least size."""
    by_kind = [sorted((i for i in size if draw(i).name.startswith(kind)), key=lambda i: (size[i], i)) for kind in KINDS]
    order = sorted((rank, kind, i) for kind, of in enumerate(by_kind) for rank, i in enumerate(of))
    return sorted(i for _, _, i in order[:count])


def named(data: Path | None, every_robot: bool) -> tuple[list[Case], list[str]]:
    """The named logs, and a line for each that is not at hand; `data`: folder with the zips of UTIAS."""
    cases, missing = [Case(SIMULATED, SLAM)], []
    try:
        load_victoria_park()
        cases.append(Case(VICTORIA_PARK, SLAM))
    except DataError as why:
        missing.append(f"left out: {VICTORIA_PARK} ({why})")
    for number, robots in DATASETS.items():
        if archive(data, number) is None:
            where = "no --data" if data is None else f"not in {data}"
            missing.append(f"left out: UTIAS Dataset {number} ({where})")
            continue
        for robot in robots if every_robot else (ROBOT,):
            cases += [Case(f"{UTIAS}-{number}-{robot}", task) for task in (SLAM, LOCALIZATION)]
    return cases, missing


def simulated(names: Sequence[str]) -> list[Case]:
    """SLAM on simulated logs of these names. Raises UsageError for one that is not understood."""
    for name in names:
        if not is_simulated(name):
            raise UsageError(f"--log {name}: no simulated log; one is {SIMULATED}")
        parse(name)
    return [Case(name, SLAM) for name in dict.fromkeys(names) if name != SIMULATED]


def archive(data: Path | None, number: int) -> Path | None:
    """The zip of a UTIAS dataset in a folder or its `mrclam`, if it is there."""
    places: Sequence[Path] = [] if data is None else [data, data / "mrclam"]
    found = [p / f"MRCLAM_Dataset{number}.zip" for p in places]
    return next((p for p in found if p.is_file()), None)


@lru_cache(maxsize=2)
def load(name: str, data: Path | None) -> Log:
    """The log of a case. A process that runs case by case loads each once."""
    kind, _, rest = name.partition("-")
    if name == VICTORIA_PARK:
        return load_victoria_park()
    if kind == VARIETY:
        return log_of(draw(int(rest)))
    if kind == UTIAS:
        number, robot = (int(part) for part in rest.split("-"))
        source = archive(data, number)
        if source is None:
            raise DataError(f"UTIAS Dataset {number}: not in {data}")
        return load_mrclam(source, robot, landmarks=corrected_landmarks(source))
    return named_log(name)
