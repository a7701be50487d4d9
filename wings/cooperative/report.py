"""The report's section on a team: every robot alone and together, who was taken for whom, one map with all paths."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.inputs import IntArray, LandmarkMap
from data.log import Log, folder_name
from data.result import Run
from data.se2 import Array
from eval.figures.style import TRUTH_COLOUR, drawing, page_width, save_for_page, settle
from eval.plan.flags.table import Output
from eval.player.pack import Pack
from eval.player.scene import add_path
from eval.player.watch import spread
from eval.referee.confusion import OUTCOMES, Confusion, confuse
from eval.referee.consistency import mean_or_nan
from eval.referee.errors import along, rms
from eval.referee.result_files import TEAM
from eval.referee.score import Trial
from eval.report.page.blocks import Block, Picture, Section
from eval.report.page.files import written_table
from eval.report.words import say
from wings.cooperative.runs import TeamRun
from wings.cooperative.team import Team, TeamInputs

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Of robots, by Okabe and Ito, which colour-blind readers can tell apart; then again from the first."""


def team_sections(
    folder: Path, wanted: Output, trials: Sequence[Trial], published: object, in_lab: bool = False,
    factor: int | None = 1,
) -> list[Section]:  # fmt: skip
    """A section for each team and task; `tables/team-NAME.csv` has its table."""
    found = dict[tuple[int, str], list[Trial]]()
    for t in trials:
        given = t.log.recorded
        if isinstance(given, TeamInputs) and (team := given.team) is not None:
            found.setdefault((id(team), t.task), []).append(t)
    sections = []
    for (_, task), own in found.items():
        name = own[0].log.name.rpartition("-robot")[0]
        rows = [row for t in own for run in t.runs for row in rows_of(t.log, run)]
        stem = f"team-{folder_name(name)}-{task}"
        blocks: list[Block] = [written_table(TEAM.table(rows), folder, stem, say("cooperative#table"), wanted)]
        together = [t for t in own if t.variant_of is None]
        if not wanted.no_plots:
            save_for_page(partial(team_map, together), folder / "figures", stem)
            blocks.append(
                Picture(stem, say("cooperative#map", task=task), say("cooperative#map_alt", robots=len(together)))
            )
        sections.append(Section(f"Team: {name}, {task}", tuple(blocks), facts=rows))
    return sections


def rows_of(log: Log, run: Run) -> list[dict[str, object]]:
    """A row for each phase of a run: errors by the referee, and outcomes of its decisions about robots."""
    given = log.recorded
    assert isinstance(given, TeamInputs)
    assert given.team is not None
    exchange = "none" if run.estimator == "dead-reckoning" else given.exchange
    names = {"robot": given.team.number[given.robot], "exchange": exchange, "estimator": run.estimator}
    made = []
    for phase in run.phases:
        row: dict[str, object] = {**names, "association": run.association, "phase": phase, "status": run.status}
        if (path := along(run, phase, log)) is not None:
            row |= {"rmse_position_m": rms(path.distance), "nees_pose": mean_or_nan(path.nees["pose"])}
        sighted = run.sighted if isinstance(run, TeamRun) and run.failure is None else None
        if sighted is not None and (counts := judged(given.team, given.robot, sighted)) is not None:
            row |= {f"robots_{name}": getattr(counts, name) for name in OUTCOMES}
        made.append(row)
    return made


def judged(team: Team, row: int, sighted: IntArray) -> Confusion | None:
    """Outcomes of a robot's decisions (s,) about other robots, as of landmarks, by the identities that were read."""
    seen = team.of(row)
    others = np.array([n for n in team.number if n != team.number[row]], np.int64)
    places = LandmarkMap(others, np.zeros((len(others), 2)))
    label, none = team.encounters.label[seen], np.full(len(seen), -1, np.int64)
    return confuse(team.encounters.instant[seen], label, sighted, none, places)


@drawing()
def team_map(trials: Sequence[Trial]) -> Figure:
    """True paths, and the last paths of the last estimator that has one, of all robots; metres, equal aspect."""
    fig = Figure(figsize=(page_width(), page_width()))
    ax = fig.add_subplot()
    ax.set_aspect("equal")
    for i, t in enumerate(trials):
        pose, given = t.log.truth.pose, t.log.recorded
        if pose is not None:
            ax.plot(*pose[:, :2].T, color=TRUTH_COLOUR, linewidth=1.0, zorder=2)
        runs = [r for r in t.runs if r.flaw is None and r.estimator != "dead-reckoning"]
        if runs and isinstance(given, TeamInputs) and given.team is not None:
            path, label = runs[-1].trajectory(runs[-1].phases[-1]).pose, f"robot {given.team.number[given.robot]}"
            ax.plot(*path[:, :2].T, color=COLOURS[i % len(COLOURS)], linewidth=0.9, label=label, zorder=3)
    known = trials[0].log.truth.landmarks
    if known is not None:
        ax.plot(*known.xy.T, "k+", markersize=6.0, label="true landmarks", zorder=4)
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    ax.set_title(trials[0].log.name.rpartition("-robot")[0], loc="left")
    fig.legend(loc="outside lower left", ncols=3)
    settle(fig)
    return fig


def company(group: Sequence[Trial], trials: Sequence[Trial]) -> "Company | None":
    """The team of a player's robot with all runs of its robots; None: it has no team."""
    given = group[0].log.recorded
    if not isinstance(given, TeamInputs) or given.team is None:
        return None
    own = [(g, t) for t in trials if isinstance(g := t.log.recorded, TeamInputs) and g.team is given.team]
    truth = {g.robot: t.log.truth.pose for g, t in own}
    return Company(given.team, given.robot, truth, {(g.robot, *_key(t, r)): r for g, t in own for r in t.runs})


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
