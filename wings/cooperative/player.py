"""The player of a robot of a team: all its robots at the frames of this one, and who observed whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from data.inputs import IntArray
from data.result import Run
from data.se2 import Array
from eval.player.pack import Pack
from eval.player.scene import add_path
from eval.player.watch import spread
from eval.referee.score import Trial
from wings.cooperative.report import COLOURS, judged
from wings.cooperative.runs import TeamRun
from wings.cooperative.team import Team, TeamInputs


def company(group: Sequence[Trial], trials: Sequence[Trial]) -> Company | None:
    """The team of a player's robot with all runs of its robots; None: it has no team."""
    given = group[0].log.recorded
    if not isinstance(given, TeamInputs) or given.team is None:
        return None
    own = [(g, t) for t in trials if isinstance(g := t.log.recorded, TeamInputs) and g.team is given.team]
    truth = {g.robot: t.log.truth.pose for g, t in own}
    runs = {(g.robot, *_key(t, r)): r for g, t in own for r in t.runs}
    return Company(given.team, given.robot, truth, runs)


@dataclass(frozen=True)
class Company:
    """A team around one of its robots, `robot` being its row; true poses, and runs by row and `_key`."""

    team: Team
    robot: int
    truth: Mapping[int, Array | None]
    runs: Mapping[tuple[Any, ...], Run]

    def add(self, pack: Pack, shown: Sequence[tuple[str, Trial, Run]], step: float) -> dict[str, Any]:
        """Add paths and encounters of the other robots, for each run shown under its key; gives the header."""
        team, n, robots = self.team, len(shown[0][1].log.recorded), []
        instant = team.instant[self.robot][:n]
        for row, own in enumerate(team.instant):
            key = "" if row == self.robot else f"mate{row}."
            robots.append({"key": key, "name": f"robot {team.number[row]}", "colour": COLOURS[row % len(COLOURS)]})
            # its newest frame at each frame of the player, -1 before its first and after its last
            at = np.where(instant <= own[-1], np.searchsorted(own, instant, side="right") - 1, -1)
            if key and (truth := self.truth.get(row)) is not None:
                pack.add(f"{key}truth", _sampled(truth, at)[:, :2], step)
            beside = [(name, self.runs.get((row, *_key(trial, run)))) for name, trial, run in shown if key]
            for name, phase, path in ((n, p, r.trajectory(p)) for n, r in beside if r is not None for p in r.phases):
                P = _sampled(path.covariance, at)
                sigma = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
                add_path(pack, f"{name}{key}{phase}", _sampled(path.pose, at), sigma, spread(P)[:, 2], step)
        frame, s = team.frame[self.robot, team.encounters.instant], team.encounters
        here = (frame >= 0) & (frame < n)
        pack.add("met_frame", frame[here])
        pack.add("met_by", s.observer[here])
        pack.add("met_point", team.members[0].sensor.body_points(s.z[here], s.R[here])[0], step)
        for name, trial, run in shown:
            runs = [self.runs.get((row, *_key(trial, run))) for row in range(len(team))]
            if all(isinstance(r, TeamRun) and r.failure is None for r in runs):
                paired, outcome = np.full((2, len(here)), -1, np.int64)
                for row, r in enumerate(runs):
                    assert isinstance(r, TeamRun)
                    found, of = judged(team, row, r.sighted), team.of(row)
                    paired[of] = [team.row(number) for number in r.sighted.tolist()]  # -1: no robot
                    outcome[of] = -1 if found is None else found.outcome
                pack.add(f"{name}met", paired[here])
                pack.add(f"{name}met_outcome", outcome[here])
        return {"robots": robots}


def _key(trial: Trial, run: Run) -> tuple[str, str, str, str]:
    given = trial.log.recorded
    assert isinstance(given, TeamInputs)
    return trial.task, given.exchange, run.estimator, run.association


def _sampled(values: Array, frame: IntArray) -> Array:
    """Values (N, ...) at frames, NaN at -1 and behind the last."""
    inside = (frame >= 0) & (frame < len(values))
    chosen = values[np.where(inside, frame, 0)]
    chosen[~inside] = np.nan
    return chosen
