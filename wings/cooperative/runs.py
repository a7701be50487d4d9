"""Runs of a team: each estimator once for all robots, one run for each of them (`data.wing.Wing.replays`)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from association.expectation import gate_threshold
from association.names import METHODS
from association.truncated import truncated_square
from data.inputs import Inputs, IntArray, LabelledObservations
from data.notice import Code, Notice, notice, stopped
from data.result import DISCARD, Failure, Innovations, Run, Trajectory, map_estimate
from eval.replay.estimators import dead_reckoning
from eval.replay.recorder import missing_run
from eval.replay.run import crashed
from eval.replay.settings import Setup
from wings.cooperative.filters import Gates, TeamFilter, own_map
from wings.cooperative.team import Team, TeamInputs

FILTER, SMOOTHER = "ekf", "batch"
ESTIMATORS = {"joint": (FILTER, SMOOTHER), "naive": (FILTER,), "intersection": (FILTER,)}
"""Of each exchange; dead reckoning, too, which needs none."""


@dataclass(frozen=True, eq=False)
class TeamRun(Run):
    """The run of one robot of a team."""

    # (s,) number of the robot that each of its encounters was paired with, or `DISCARD`
    sighted: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    exchange: str = "joint"  # of the team


def lack(name: str, task: str, association: str, exchange: str) -> str:
    """Why an estimator cannot work on a team; empty: it can."""
    if name == "dead-reckoning":
        return ""
    if name not in ESTIMATORS[exchange]:
        return f"robots that exchange {exchange} have {' and '.join(ESTIMATORS[exchange])}, and {name} only alone"
    if association != "known" and association not in METHODS:
        return f"association {association}: of a team, known, {', '.join(METHODS)}"
    if task == "slam" and (association != "known" or exchange != "joint"):
        return "SLAM of a team needs labels and the joint exchange"
    return ""


def team_runs(
    inputs: Inputs, task: str, estimators: Sequence[str], association: str, setup: Setup,
    judge: Callable[[Sequence[Run], Inputs], list[Run]],
) -> list[Run] | None:  # fmt: skip
    """The runs of one robot; None of inputs without a team, or of a robot that is alone."""
    if not isinstance(inputs, TeamInputs) or inputs.team is None or inputs.exchange == "alone":
        return None
    if association == "known" and not isinstance(inputs.observations, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")
    team = inputs.team
    gates = Gates(association, setup.gate, gate_threshold(setup.settled(team.sensed).label_gate))
    runs = list[Run]()
    for name in estimators:
        why = lack(name, task, association, inputs.exchange)
        if why:
            runs.append(missing_run(name, association, task, inputs, Failure("incomplete", 0, stopped(why))))
        elif name == "dead-reckoning":
            runs.append(dead_reckoning(inputs, task))
        else:
            found = _all(team, name, task, inputs.exchange, gates)
            if isinstance(found, Failure):
                runs.append(missing_run(name, association, task, inputs, found))
            else:
                runs.append(_part(found[inputs.robot], len(inputs), len(inputs.observations.frame)))
    return judge(runs, inputs)


@lru_cache(maxsize=8)
def _filtered(team: Team, task: str, exchange: str, gates: Gates) -> tuple[TeamFilter, float]:
    """A filter that ran, and its seconds; the smoother begins there."""
    begin, known = time.perf_counter(), team.members[0].map
    filter_ = TeamFilter(team, None if task == "slam" or known is None else known.exact, exchange, gates)
    filter_.run()
    return filter_, time.perf_counter() - begin


@lru_cache(maxsize=8)
def _all(team: Team, name: str, task: str, exchange: str, gates: Gates) -> tuple[TeamRun, ...] | Failure:
    """The runs of all robots, or why there are none."""
    try:
        return _runs(team, name, task, exchange, gates)
    except Exception as fault:  # noqa: BLE001 - `crashed` raises again what concerns the log
        return crashed(fault, 0)


def _runs(team: Team, name: str, task: str, exchange: str, gates: Gates) -> tuple[TeamRun, ...]:
    filter_, seconds = _filtered(team, task, exchange, gates)
    tracks, finals, states, total, steps = filter_.tracks, None, [t.map for t in filter_.tracks], None, None
    if name == SMOOTHER:
        from wings.cooperative.smoother import smooth_team  # gtsam

        begin = time.perf_counter()
        names = team.labels if task == "slam" else [t.decisions for t in tracks]
        landmark = [np.where(t.decisions != DISCARD, n, DISCARD) for t, n in zip(tracks, names, strict=True)]
        places = {label: filter_.mean[at : at + 2] for label, at in filter_.slot.items()}
        known, sighted = filter_.known, [t.sighted for t in tracks]
        found = smooth_team(team, known, landmark, sighted, [t.pose for t in tracks], places)
        finals, total, steps = found.paths, (found.cost, found.dof), (found.iterations, found.last_step)
        if found.map is not None:
            states = [own_map(team, row, t, found.map) for row, t in enumerate(tracks)]
        seconds = time.perf_counter() - begin
    mean, variance = truncated_square(gates.threshold if gates.method == "known" else gate_threshold(gates.gate))
    notes: tuple[Notice, ...] = ()
    if name == FILTER and (known := team.members[0].map) is not None and known.sigma is not None and task != "slam":
        effect = sum(m.map_effect for m in team.members)
        notes = (notice(Code.MAP_AS_EXACT, sigma=float(known.sigma.max()), effect=effect),)
    runs = []
    for row, t in enumerate(tracks):
        frame, state = team.members[row].observations.frame, states[row]
        runs.append(
            TeamRun(
                name, gates.method, task,
                None if finals else Trajectory(t.pose, t.covariance), finals[row] if finals else None,
                None if state is None else map_estimate(state, frame, t.decisions, t.created),
                t.decisions, t.decisions, t.created,
                None if finals else Innovations(t.stats[:, 0], t.stats[:, 1].astype(np.int64), t.stats[:, 2], t.white),
                total or (float(t.stats[:, 0].sum()), int(t.stats[:, 1].sum())),
                None if finals else t.size, seconds / len(tracks), notes=notes, gated=(mean / 2, variance / 2),
                iterations=steps[0] if steps else None, last_step_sigma=steps[1] if steps else None,
                sighted=t.sighted, exchange=exchange,
            )
        )  # fmt: skip
    return tuple(runs)


def _part(run: TeamRun, frames: int, observations: int) -> TeamRun:
    """The run of the first frames, of a log that was cut."""
    if len(run.trajectory(run.phases[0]).pose) == frames:
        return run
    o, first = run.innovations, slice(frames)
    if o is not None:
        o = Innovations(o.nis[:frames], o.dof[:frames], o.log_likelihood[:frames], o.white[:observations])
    return replace(
        run, online=run.online and run.online.only(first), final=run.final and run.final.only(first), innovations=o,
        state_size=None if run.state_size is None else run.state_size[:frames],
        decisions=run.decisions[:observations], final_decisions=run.final_decisions[:observations],
        created=run.created[:observations],
    )  # fmt: skip
