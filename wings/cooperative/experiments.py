"""The experiments of `slamref run NAME --cooperative`: each robot of a team with each exchange."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from data.errors import UsageError
from data.formats.mrclam import is_mrclam
from data.log import Log
from data.logs import Reading, as_scored
from data.worlds import registry
from eval.plan.experiment import Experiment, Work, default_task
from eval.plan.flags.table import Selection
from eval.replay.settings import Setup
from wings.cooperative.runs import ESTIMATORS, lack
from wings.cooperative.team import EXCHANGES, TeamInputs
from wings.cooperative.utias import team_logs
from wings.cooperative.world import simulate_all

ABOUT = {
    "alone": "the robot alone: no observation of robots is used",
    "naive": "each robot has its own filter, and takes the estimate of another one as independent",
    "intersection": "each robot has its own filter, and fuses the estimate of another one by covariance intersection",
}


def experiments(
    name: str, asked: Selection, setup: Setup, reading: Reading, say: Callable[[str], None]
) -> list[Experiment]:
    """All robots of a team, jointly, and as variants alone and with each exchange.

    Raises:
        UsageError: a name of no team, or nothing that a team can do.
        DataError: invalid files.
    """
    logs = [as_scored(log, reading) for log in named_team(name)]
    methods = asked.association or ("known",)
    if "slam" in asked.task:
        say("--task slam: jointly and each robot alone; naive exchange and covariance intersection need the known map")
    made = []
    for log in logs:
        given = log.recorded
        assert isinstance(given, TeamInputs)
        for exchange in EXCHANGES:
            inputs = replace(given, exchange=exchange)
            own = log.name if exchange == "joint" else f"{log.name}:{exchange}"
            variant = {} if exchange == "joint" else {"variant_of": log.name, "about": ABOUT[exchange]}
            for task in asked.task or (default_task(log),):
                works = [Work(m, _able(asked.estimator, task, m, exchange)) for m in methods]
                work = tuple(w for w in works if w.estimators)
                if exchange == "joint" and not any(set(w.estimators) & {*ESTIMATORS["joint"]} for w in works):
                    raise UsageError(f"--cooperative: {_why(asked.estimator, task, methods)}")
                if work:
                    here = replace(log, name=own, recorded=inputs)
                    made.append(Experiment(here, task, work, setup.settled(log.labels_are_sensed), **variant))
    return made


def _able(estimators: tuple[str, ...], task: str, method: str, exchange: str) -> tuple[str, ...]:
    """Those that can do it; dead reckoning once, with the joint exchange."""
    able = (e for e in estimators if exchange == "alone" or not lack(e, task, method, exchange))
    return tuple(e for e in able if e != "dead-reckoning" or exchange == "joint")


def _why(estimators: tuple[str, ...], task: str, methods: tuple[str, ...]) -> str:
    lacks = (lack(e, task, m, "joint") for e in estimators for m in methods)
    return next(filter(None, lacks), "an estimator is needed, ekf or batch")


def named_team(name: str) -> list[Log]:
    """The logs of all robots of a team, `NAME-robotN`: of a UTIAS dataset by its path, or of a simulated team.

    `arena:SEED:robots=N+KEY=VALUE` is the same as `team:SEED:...`. Raises UsageError for a name of no team.
    """
    world, _, rest = name.partition(":")
    if world == "team" or (world == "arena" and "robots=" in rest):
        parsed: Any = registry.parse(f"team:{rest}")
        logs = simulate_all(parsed.parameters, parsed.seed, name)
        if len(logs) < 2:
            raise UsageError(f"--cooperative {name}: a team needs two robots")
        return [replace(log, name=f"{name}-robot{k}") for k, log in enumerate(logs, 1)]
    path = Path(name)
    if path.exists() and is_mrclam(path):
        return team_logs(path)
    right = "name a UTIAS MRCLAM dataset (its folder or zip), or arena:SEED:robots=5"
    raise UsageError(f"--cooperative {name}: no team of robots; {right}")
