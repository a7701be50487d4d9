"""The report's section on a team: every robot alone and together, who was taken for whom, one map with all paths."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from data.inputs import IntArray, LandmarkMap
from data.log import Log, folder_name
from data.result import Run
from eval.figures.style import TRUTH_COLOUR, drawing, page_width, save_for_page, settle
from eval.plan.flags.table import Output
from eval.referee.confusion import Confusion, confuse
from eval.referee.consistency import mean_or_nan
from eval.referee.errors import along, rms
from eval.referee.result_files import TEAM
from eval.referee.score import Trial
from eval.report.page.blocks import Block, Picture, Section
from eval.report.page.files import written_table
from eval.report.words import say
from wings.cooperative.runs import TeamRun
from wings.cooperative.team import Team, TeamInputs

COUNTS = ("tp", "tn", "fp", "fn")
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
        if isinstance(run, TeamRun) and run.failure is None:
            row |= {f"robots_{k}": v for k, v in identities(given.team, given.robot, run.sighted).items()}
        made.append(row)
    return made


def judged(team: Team, row: int, sighted: IntArray) -> Confusion | None:
    """Outcomes of a robot's decisions (s,) about other robots, as of landmarks, by the identities that were read."""
    seen = team.of(row)
    others = np.array([n for n in team.number if n != team.number[row]], np.int64)
    places = LandmarkMap(others, np.zeros((len(others), 2)))
    label, none = team.encounters.label[seen], np.full(len(seen), -1, np.int64)
    return confuse(team.encounters.instant[seen], label, sighted, none, places)


def identities(team: Team, row: int, sighted: IntArray) -> dict[str, int]:
    """The counts TP, TN, FP and FN of `judged`."""
    counts = judged(team, row, sighted)
    return {} if counts is None else {name: getattr(counts, name) for name in COUNTS}


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
