"""What a lab consists of: the corridor in four conditions with every method, or a camera log in a known map.

The corridor lab's own methods are NN, SINGLES and JCBB (`jcbb-first`: its ties as in the lab's program); beside them
stand `known`, `jcbb` (the least joint distance breaks ties) and `jcbb-hindsight`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from data.errors import UsageError
from data.inputs import CLUTTER
from data.log import Log
from data.logs import Reading, find_logs, open_log
from eval.plan.experiment import Experiment, Work
from eval.plan.flags.table import DEFAULT_ESTIMATORS
from eval.plan.variants import maintained
from eval.replay.settings import HINDSIGHT, Setup

CONDITIONS = {
    (False, True): "",
    (True, True): "people",
    (False, False): "no-odometry",
    (True, False): "people+no-odometry",
}
"""(people, odometry) of the lab's four logs, and how the name of a simulated one says so."""
WITH_PEOPLE = ("crowd", "sv_people", "sa_people")
METHODS = ("nn", "singles", "jcbb-first", "jcbb")
"""Without and with map maintenance."""
VISUAL = ("dead-reckoning", "ekf", "ekf-iterated", "isam2", "batch")


def lab_experiments(
    lab: str, estimators: tuple[str, ...], setup: Setup, reading: Reading, say: Callable[[str], None]
) -> list[Experiment]:
    """Every run of a lab. Raises UsageError for a name that is no lab, and for a folder that lacks a condition."""
    if lab.startswith("corridor:"):
        logs: Sequence[Log] = [open_log(name, reading, say) for name in corridor_names(lab)]
        return _corridor(estimators, setup, logs)
    if lab.startswith("visual:"):
        return _visual(estimators, setup, open_log(_with_colon(lab), reading, say))
    folder = Path(lab)
    if not folder.is_dir():
        raise UsageError(f"--lab {lab}: no such folder, and neither corridor:SEED+KEY=VALUE nor visual:SEED")
    from data.formats.lab.folder import is_lab

    if is_lab(folder) and not (folder / "log.toml").exists():
        return _visual(estimators, setup, open_log(lab, reading, say))
    return _corridor(estimators, setup, list(_recorded(folder, say).values()))


def _with_colon(name: str) -> str:
    """`world:3+key=value` as the names of logs have it, `world:3:key=value`."""
    world, _, rest = name.partition(":")
    seed, plus, keys = rest.partition("+")
    return f"{world}:{seed}:{keys}" if plus and ":" not in seed else name


def corridor_names(lab: str) -> list[str]:
    """Names of the four logs of `corridor:SEED[+KEY=VALUE...]`: each has the constants that are of any effect in it."""
    _, _, rest = _with_colon(lab).partition(":")
    seed, _, keys = rest.partition(":")
    parts = [part for part in keys.split("+") if part.strip()]
    for part in parts:
        if "=" not in part:
            raise UsageError(f"--lab {lab}: {part} is a condition; the lab has all four, with people and without them")
    names = []
    for (people, odometry), switches in CONDITIONS.items():
        kept = [p for p in parts if _matters(p.partition("=")[0].strip().replace("-", "_"), people, odometry)]
        said = "+".join([*([switches] if switches else []), *kept])
        names.append(f"corridor:{seed}" + (f":{said}" if said else ""))
    return names


def _matters(key: str, people: bool, odometry: bool) -> bool:
    """Whether a constant has an effect in a condition; one that is not known has, and is refused there."""
    if key in WITH_PEOPLE:
        return people
    if key.endswith("_blind"):
        return not odometry
    return odometry if key.endswith(("_move", "_turn")) else True


def switched_on(log: Log) -> tuple[bool, bool]:
    """Whether people were seen, and whether the wheels were read (no motion, or always the same, is stated if not)."""
    people = log.truth.landmark_of is not None and bool(np.any(log.truth.landmark_of == CLUTTER))
    made, mean = log.source.get("corridor"), log.recorded.increments.mean[1:]
    if isinstance(made, Mapping) and "odometry" in made:
        return bool(made.get("people", people)), bool(made["odometry"])
    return people, bool(np.any(mean != mean[:1]))


def _recorded(folder: Path, say: Callable[[str], None]) -> dict[tuple[bool, bool], Log]:
    """The recorded logs of a folder by condition, in the order of `CONDITIONS`."""
    if (folder / "log.toml").exists():
        raise UsageError(f"--lab {folder}: one log; the lab's folder holds one for each condition (--log takes one)")
    found: dict[tuple[bool, bool], Log] = {}
    for load in find_logs(folder, say):
        log = load()
        truth = log.truth
        if truth.landmark_of is None or truth.known_poses < len(log.recorded):
            say(f"skipped {log.name}: the lab's questions are about true poses and true ids, which it does not have")
            continue
        if switched_on(log) in found:
            say(f"skipped {log.name}: {found[switched_on(log)].name} has the same condition")
            continue
        found[switched_on(log)] = log
    missing = [
        f"{'with' if people else 'without'} people and {'with' if odometry else 'without'} odometry"
        for people, odometry in CONDITIONS
        if (people, odometry) not in found
    ]
    if missing:
        raise UsageError(f"--lab {folder}: no log {', none '.join(missing)}; the lab needs all four")
    return {c: found[c] for c in CONDITIONS}


def _corridor(asked: tuple[str, ...], setup: Setup, logs: Sequence[Log]) -> list[Experiment]:
    own = asked != DEFAULT_ESTIMATORS
    if own and not {"ekf", "isam2"} & set(asked):
        raise UsageError(f"--estimator {','.join(asked)}: the lab is answered from ekf, or else isam2")
    known = asked if own else ("ekf", "batch")
    estimators = asked if own else ("ekf",)
    plain = replace(setup, maintain=False)
    experiments = []
    for log in logs:
        work = (Work("known", known), *(Work(m, estimators) for m in (*METHODS, HINDSIGHT)))
        first = Experiment(log, "slam", work, plain.settled(log.labels_are_sensed))
        kept = tuple(w for w in work if w.association in METHODS)
        experiments += [first, maintained(first, kept)]
    return experiments


def _visual(asked: tuple[str, ...], setup: Setup, log: Log) -> list[Experiment]:
    own = asked != DEFAULT_ESTIMATORS
    work = (Work("known", asked if own else VISUAL),)
    settled = setup.settled(log.labels_are_sensed)
    return [Experiment(log, task, work, settled) for task in ("localization", "slam")]
