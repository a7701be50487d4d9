"""Experiments of a lab: the corridor in four conditions with every method, or a camera log in a known map.

The corridor lab asks for NN, SINGLES and JCBB (`jcbb-first` breaks ties as the lab's program does). `known`, `jcbb`
(the least joint distance breaks ties) and `jcbb-hindsight` are added.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from data.errors import UsageError, nearest
from data.inputs import CLUTTER
from data.log import Log
from data.logs import Reading, as_scored, find_logs, open_scored
from eval.plan.experiment import Experiment, Work
from eval.plan.experiments import VISUAL, maintained
from eval.plan.flags.table import DEFAULT_ESTIMATORS, Options
from eval.referee.score import Trial
from eval.replay.flag import rows
from eval.replay.settings import HINDSIGHT, Setup

CONDITIONS = {
    (False, True): "", (True, True): "people", (False, False): "no-odometry", (True, False): "people+no-odometry",
}  # fmt: skip
"""(people, odometry) of the lab's four logs, and the keys in the name of a simulated one."""
WITH_PEOPLE = ("crowd", "sv_people", "sa_people")
METHODS = ("nn", "singles", "jcbb-first", "jcbb")  # run without and with map maintenance


def lab_experiments(
    lab: str, estimators: tuple[str, ...], setup: Setup, reading: Reading, say: Callable[[str], None]
) -> list[Experiment]:
    """All experiments of a lab; UsageError for an unknown name, or a folder that lacks a condition."""
    if lab.startswith("corridor:"):
        logs: Sequence[Log] = [open_scored(name, reading, say) for name in corridor_names(lab)]
        return _corridor(estimators, setup, logs)
    if lab.startswith("visual:"):
        return _visual(estimators, setup, open_scored(_with_colon(lab), reading, say))
    folder = Path(lab)
    if not folder.is_dir():
        near = nearest(lab.partition(":")[0], ("corridor", "visual"))
        hint = f" (did you mean {near}:{lab.partition(':')[2] or 0}?)" if near else ""
        right = "a folder, corridor:SEED:KEY=VALUE or visual:SEED"
        raise UsageError(f"--lab {lab}: no such folder{hint}; {right} is needed")
    from wings.camera.lab.folder import is_lab

    if is_lab(folder) and not (folder / "log.toml").exists():
        return _visual(estimators, setup, open_scored(lab, reading, say))
    return _corridor(estimators, setup, [as_scored(log, reading) for log in _recorded(folder, say).values()])


def _with_colon(name: str) -> str:
    """`world:3+key=value` as the name of a log, `world:3:key=value`."""
    world, _, rest = name.partition(":")
    seed, plus, keys = rest.partition("+")
    return f"{world}:{seed}:{keys}" if plus and ":" not in seed else name


def corridor_names(lab: str) -> list[str]:
    """Names of the four logs of `corridor:SEED[+KEY=VALUE...]`, each with the constants that affect it."""
    _, _, rest = _with_colon(lab).partition(":")
    seed, _, keys = rest.partition(":")
    parts = [part for part in keys.split("+") if part.strip()]
    for part in parts:
        if "=" not in part:
            raise UsageError(f"--lab {lab}: {part} is a condition; the lab has all four, so leave it out")
    names = []
    for (people, odometry), switches in CONDITIONS.items():
        kept = [p for p in parts if _matters(p.partition("=")[0].strip().replace("-", "_"), people, odometry)]
        keyed = "+".join([*([switches] if switches else []), *kept])
        names.append(f"corridor:{seed}" + (f":{keyed}" if keyed else ""))
    return names


def _matters(key: str, people: bool, odometry: bool) -> bool:
    """Whether a constant affects a condition; unknown ones do, and are refused later."""
    if key in WITH_PEOPLE:
        return people
    return not odometry if key.endswith("_blind") else odometry if key.endswith(("_move", "_turn")) else True


def switched_on(log: Log) -> tuple[bool, bool]:
    """Whether people were observed, and whether there is odometry (else all increments are equal)."""
    people = log.truth.landmark_of is not None and bool(np.any(log.truth.landmark_of == CLUTTER))
    made, mean = log.source.get("corridor"), log.recorded.increments.mean[1:]
    if isinstance(made, Mapping) and "odometry" in made:
        return bool(made.get("people", people)), bool(made["odometry"])
    return people, bool(np.any(mean != mean[:1]))


def _recorded(folder: Path, say: Callable[[str], None]) -> dict[tuple[bool, bool], Log]:
    """The recorded logs of a folder by condition, in the order of `CONDITIONS`."""
    if (folder / "log.toml").exists():
        right = f"one log; the lab's folder holds one for each condition (`slamref run {folder}`)"
        raise UsageError(f"--lab {folder}: {right}")
    found: dict[tuple[bool, bool], Log] = {}
    for load in find_logs(folder, say):
        log = load()
        truth = log.truth
        if truth.landmark_of is None or truth.known_poses < len(log.recorded):
            say(f"skipped {log.name}: no true poses or true ids, which the lab needs")
            continue
        condition = switched_on(log)
        if condition in found:
            say(f"skipped {log.name}: {found[condition].name} has the same condition")
        else:
            found[condition] = log
    lacking = [(people, odometry) for people, odometry in CONDITIONS if (people, odometry) not in found]
    has = ("without", "with")
    missing = [f"{has[people]} people and {has[odometry]} odometry" for people, odometry in lacking]
    if missing:
        raise UsageError(f"--lab {folder}: no log {', none '.join(missing)}; the lab needs all four")
    return {c: found[c] for c in CONDITIONS}


def _corridor(asked: tuple[str, ...], setup: Setup, logs: Sequence[Log]) -> list[Experiment]:
    own = asked != DEFAULT_ESTIMATORS
    if own and not {"ekf", "isam2"} & set(asked):
        raise UsageError(f"--estimator {','.join(asked)}: the lab is answered from ekf, or else isam2; add one")
    known = asked if own else ("ekf", "batch")
    estimators = asked if own else ("ekf",)
    plain = replace(setup, maintain=False)
    experiments = []
    for log in logs:
        work = (Work("known", known), *(Work(m, estimators) for m in (*METHODS, HINDSIGHT)))
        first = Experiment(log, "slam", work, plain.settled(log.labels_are_sensed))
        experiments += [first, maintained(first, tuple(w for w in work if w.association in METHODS))]
    return experiments


def _visual(asked: tuple[str, ...], setup: Setup, log: Log) -> list[Experiment]:
    work = (Work("known", asked if asked != DEFAULT_ESTIMATORS else VISUAL),)
    return [Experiment(log, task, work, setup.settled(log.labels_are_sensed)) for task in ("localization", "slam")]


TABLE = rows(Options)
# what a lab does not state for its logs: it runs all of them with and without maintenance
SETTINGS = tuple(name for name in rows(Setup) if name not in ("maintain", "calibrate"))


def settings_by_log(options: Options, trials: Sequence[Trial]) -> dict[str, dict[str, object]]:
    """The settings of a lab by log, as values of flags: those that are not the default, tasks and methods always."""
    if options.selection.lab is None:
        return {}
    stated = {name: TABLE[name].of(options) for name in SETTINGS}
    changed = {name: value for name, value in stated.items() if value != TABLE[name].default}
    shared = {n: "none" if v is None else list(v) if isinstance(v, tuple) else v for n, v in changed.items()}
    found: dict[str, dict[str, object]] = {}
    tasks: dict[str, list[str]] = {}
    for trial in (t for t in trials if t.variant_of is None):
        own = found.setdefault(trial.log.name, {"task": None, **_methods(trial, options), **shared})
        tasks.setdefault(trial.log.name, []).append(trial.task)
        own["task"] = tasks[trial.log.name]
    return found


def _methods(trial: Trial, options: Options) -> dict[str, object]:
    """Association methods, and the estimators that ran with each of them."""
    ran: dict[str, list[str]] = {}
    for run in trial.runs:
        if run.association != "none":
            ran.setdefault(run.association, []).append(run.estimator)
    groups, stated = list(ran.values()), options.selection.estimator
    shared = [e for e in groups[0] if all(e in g for g in groups)]
    return {"association": list(ran), "estimator": shared if stated == DEFAULT_ESTIMATORS else list(stated)}
