"""The player of a robot of a team: all its robots at the frames of this one, and who observed whom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from data.inputs import IntArray
from data.result import Run
from data.se2 import Array, wrap_angle
from eval.player.pack import ANGLE, Pack
from eval.player.scene import add_path
from eval.player.watch import spread
from eval.referee.score import Trial
from wings.cooperative.report import COLOURS, judged
from wings.cooperative.runs import TeamRun
from wings.cooperative.team import Team, TeamInputs


def company(group: Sequence[Trial], trials: Sequence[Trial]) -> Company | None:
    """The trials of all robots of the team of a player's robot; None: it has no team."""
    given = group[0].log.recorded
    if not isinstance(given, TeamInputs) or given.team is None:
        return None
    own = [t for t in trials if isinstance(t.log.recorded, TeamInputs) and t.log.recorded.team is given.team]
    return Company(given.team, given.robot, tuple(own))


@dataclass(frozen=True)
class Company:
    """A team around one of its robots, `robot` being its row."""

    team: Team
    robot: int
    trials: tuple[Trial, ...]

    def add(self, pack: Pack, shown: Sequence[tuple[str, Trial, Run]], step: float) -> dict[str, Any]:
        """Add paths and encounters of the other robots, for each run shown under its key; gives the header."""
        team, n = self.team, len(shown[0][1].log.recorded)
        instant = team.instant[self.robot][:n]
        robots = []
        for row, own in enumerate(team.instant):
            key = "" if row == self.robot else f"mate{row}."
            robots.append({"key": key, "name": f"robot {team.number[row]}", "colour": COLOURS[row % len(COLOURS)]})
            # its newest frame at each frame of the player, -1 before its first and after its last
            at = np.where(instant <= own[-1], np.searchsorted(own, instant, side="right") - 1, -1)
            truth = next((t.log.truth.pose for t in self.trials if _row(t) == row), None)
            if key and truth is not None:
                pose = _sampled(truth, at)
                pack.add(f"{key}truth", pose[:, :2], step)
                pack.add(f"{key}truth_theta", wrap_angle(pose[:, 2]), ANGLE)
            beside = [(name, self._beside(trial, run, row)) for name, trial, run in shown if key]
            for name, other in ((name, other) for name, other in beside if other is not None):
                for phase in other.phases:
                    path = other.trajectory(phase)
                    P = _sampled(path.covariance, at)
                    sigma = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
                    add_path(pack, f"{name}{key}{phase}", _sampled(path.pose, at), sigma, spread(P)[:, 2], step)
        frame = team.frame[self.robot, team.encounters.instant]
        here = (frame >= 0) & (frame < n)
        points, _ = team.members[0].sensor.body_points(team.encounters.z[here], team.encounters.R[here])
        pack.add("met_frame", frame[here])
        pack.add("met_by", team.encounters.observer[here])
        pack.add("met_point", points, step)
        for name, trial, run in shown:
            self._add_met(pack, name, trial, run, here)
        return {"robots": robots}

    def _add_met(self, pack: Pack, name: str, trial: Trial, run: Run, here: Any) -> None:
        """Row of the robot that each encounter was paired with (-1: none), and its outcome; none of a robot alone."""
        paired, outcome = np.full((2, len(here)), -1, np.int64)
        for row in range(len(self.team)):
            if not isinstance(other := self._beside(trial, run, row), TeamRun) or other.failure is not None:
                return
            of = self.team.of(row)
            found = judged(self.team, row, other.sighted)
            paired[of] = [self.team.row(number) for number in other.sighted.tolist()]
            outcome[of] = -1 if found is None else found.outcome
        pack.add(f"{name}met", paired[here])
        pack.add(f"{name}met_outcome", outcome[here])

    def _beside(self, trial: Trial, run: Run, row: int) -> Run | None:
        """The run of another robot by the same estimator, association, task and exchange."""
        same = [t for t in self.trials if _row(t) == row and t.task == trial.task and _exchange(t) == _exchange(trial)]
        names = run.estimator, run.association
        return next((r for t in same for r in t.runs if (r.estimator, r.association) == names), None)


def _row(trial: Trial) -> int:
    return trial.log.recorded.robot if isinstance(trial.log.recorded, TeamInputs) else -1


def _exchange(trial: Trial) -> str:
    return trial.log.recorded.exchange if isinstance(trial.log.recorded, TeamInputs) else ""


def _sampled(values: Array, frame: IntArray) -> Array:
    """Values (N, ...) at frames, NaN at -1 and behind the last."""
    inside = (frame >= 0) & (frame < len(values))
    chosen = values[np.where(inside, frame, 0)]
    chosen[~inside] = np.nan
    return chosen
