"""The corridor lab in the report: the answers of a lab that is handed in, and their pictures.

Facts of its six questions (words: `templates/labs/corridor`), measured times of updates and of map maintenance, and the
answers over many seeds: means, intervals of the differences, and how often an answer reverses. Pictures: maps,
estimated paths, errors, one frame in detail.
"""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from data.inputs import CLUTTER, IntArray
from data.log import Log
from data.logs import open_scored
from data.result import Run
from data.se2 import Array
from data.words import number
from eval.figures.error import error_figure, ticks, time_label
from eval.figures.plane import true_landmarks
from eval.figures.style import DASHED, NARROW, SOLID, Line, across, colour_of_method, drawing, page_width, save_for_page
from eval.plan.experiment import Unfinished
from eval.plan.flags.table import Options
from eval.plan.work import Job, work
from eval.referee.confusion import OUTCOMES
from eval.referee.consistency import ASTRAY_NEES
from eval.referee.errors import aligned_rmse, landmark_true_ids, named, position_distance, rms
from eval.referee.score import Scores, Trial, confusion_of
from eval.replay.run import front_end, step_by_step
from eval.replay.settings import Setup
from eval.report.page.blocks import Block, Folded, Picture, Section
from eval.report.page.files import write_table, written_table
from eval.report.words import paragraph, plus_minus
from wings.labs import corridor
from wings.labs.corridor import BLIND, BLIND_PEOPLE, JCBB, METHODS, NAMES, ODOMETRY, PEOPLE, Judged, Lab, Shown
from wings.labs.plan import CONDITIONS, corridor_names
from wings.labs.stepping.pictures import BAD, FAINT, enlarged_figure, wrong_of
from wings.labs.stepping.problem import Matching, problems_of
from wings.labs.visual import visual_hand_in

TRUE_PATH = "#A0A0A0"
ABOVE: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)}  # of a legend that hides no curve
STILL = 1.0  # m from its start that a path reaches at most if it is called still


def called(run: Run) -> str:
    """The association method as the lab calls it; where that is ambiguous, as on the command line."""
    return "by labels" if run.association == "known" else NAMES.get(run.association, run.association)


def people_figure(quiet: Sequence[Shown], busy: Sequence[Shown]) -> Figure:
    """Maps of some methods with people, and their position error with people and without."""
    with drawing():
        fig, lower = _maps([(s, f"{called(s.run)} with people: the map at the end") for s in busy], len(busy))
        for k, (below, without, s) in enumerate(zip(lower, quiet, busy, strict=True)):
            for shown, line, label in ((without, DASHED, "without people"), (s, SOLID, "with people")):
                error = _error(shown)
                label = f"{label}: at most {number(float(np.nanmax(error)))} m"
                _line(below, shown.log, error, shown.run.association, line, label, style="default")
            _axes_over_time(below, s.log, "position error [m]" if k == 0 or page_width() < NARROW else "")
            below.legend(**ABOVE)
        return fig


def _maps(shown: Sequence[tuple[Shown, str]], lower: int) -> tuple[Figure, list[Axes]]:
    """Maps with their titles, side by side if there is room, and `lower` panels below for what changes over time."""
    columns = len(shown) if page_width() >= NARROW else 1
    rows, more = len(shown) // columns, -(-lower // columns)
    fig = Figure(figsize=(page_width(), 4.9 if columns > 1 else 0.4 + 3.3 * rows + 1.6 * more))
    grid = fig.add_gridspec(rows + more, columns, height_ratios=[2.5] * rows + [1.0] * more)
    for k, (s, title) in enumerate(shown):
        ax = fig.add_subplot(grid[k // columns, k % columns])
        _draw_map(ax, s, left=k % columns == 0)
        ax.set_title(title, loc="left")
    fig.legend(handles=_map_handles([s for s, _ in shown]), loc="outside lower center", ncols=4)
    places = [(rows + k // columns, k % columns if lower > 1 else slice(None)) for k in range(lower)]
    return fig, [fig.add_subplot(grid[place]) for place in places]


def paths_figure(quiet: Sequence[Shown], busy: Sequence[Shown]) -> Figure:
    """What every method believes the path to be, a panel each: with its map, and dashed the path with people."""
    with drawing():
        columns = across(3)
        rows = -(-len(quiet) // columns)
        fig = Figure(figsize=(page_width(), 0.5 + (page_width() / columns + 0.42) * rows))
        axes = fig.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for k, s in enumerate(quiet):
            ax = axes.flat[k]
            _draw_map(ax, s, left=k % columns == 0, size=2.5)
            title = f"{s.run.association}\nRMSE {number(rms(_error(s)))} m"
            other = next((b for b in busy if b.run.association == s.run.association), None)
            if other is not None:
                path, colour = other.run.trajectory("online").pose[:, :2], colour_of_method(other.run.association)
                ax.plot(*path.T, color=colour, linestyle=DASHED, linewidth=0.9, zorder=2.8)
                _mark_end(ax, path, colour)
                title += f", with people {number(rms(_error(other)))} m"
            ax.set_title(title, loc="left", fontsize=7.0)
            ax.set_xlabel("x [m]" if k + columns >= len(quiet) else "")
        for ax in axes.flat[len(quiet) :]:
            ax.set_axis_off()
        dashed = Line2D([], [], color="#404040", linestyle=DASHED, linewidth=0.9, label="with people")
        fig.legend(handles=[*_map_handles(quiet), *([dashed] if busy else [])], loc="outside lower center", ncols=4)
        return fig


def maintenance_figure(plain: Shown, kept: Shown) -> Figure:
    """The map at the end without and with maintenance, what was removed, and the length of the state over time."""
    with drawing():
        maps = []
        for s, what in ((plain, "without"), (kept, "with")):
            size = 0 if s.run.map is None else len(s.run.map)
            maps.append((s, f"{called(s.run)} {what} maintenance: {size} landmarks"))
        fig, (below,) = _maps(maps, 1)
        for s, line, what in ((plain, DASHED, "without"), (kept, SOLID, "with maintenance")):
            if s.run.state_size is not None:
                label = f"{what}: {int(s.run.state_size[-1])} at the end"
                _line(below, s.log, s.run.state_size, s.run.association, line, label)
        _axes_over_time(below, plain.log, "length of the state")
        below.legend(**ABOVE)
        return fig


def _line(
    ax: Axes, log: Log, values: Array | IntArray, method: str, line: Line, label: str, style: str = "steps-post"
) -> None:
    (drawn,) = ax.plot(log.recorded.time, values, linestyle=line, linewidth=1.1, drawstyle=style, label=label)
    drawn.set_color(colour_of_method(method))


def _axes_over_time(ax: Axes, log: Log, what: str) -> None:
    """Time below, and what is shown over it from zero on with few ticks."""
    ax.set(xlabel=time_label(log.recorded), ylabel=what, ylim=(0.0, None))
    ax.yaxis.set_major_locator(ticks(4))


def _error(s: Shown) -> Array:
    truth = s.log.truth.pose
    assert truth is not None  # the lab's logs have a true path
    return np.asarray(position_distance(s.run.trajectory("online").pose, truth))


def _draw_map(ax: Axes, s: Shown, *, left: bool, size: float = 3.0) -> None:
    """True points and path, estimated path, landmarks at the end by what initialized them, and removed ones."""
    known, truth, run = true_landmarks(s.log), s.log.truth.pose, s.run
    colour = colour_of_method(run.association)
    if known is not None:
        ax.plot(*known.xy.T, "+", color=FAINT, markersize=1.6 * size, markeredgewidth=0.7, zorder=1)
    if truth is not None:
        ax.plot(*truth[:, :2].T, color=TRUE_PATH, linewidth=1.0, zorder=2)
    path = run.trajectory("online").pose[:, :2]
    ax.plot(*path.T, color=colour, linewidth=1.2, zorder=3)
    _mark_end(ax, path, colour)
    if run.map is not None and len(run.map):
        person = landmark_true_ids(named(run), s.log.truth, run.map.number) == CLUTTER
        ax.plot(*run.map.xy[~person].T, ".", color=colour, markersize=1.3 * size, zorder=4)
        ax.plot(*run.map.xy[person].T, "s", color=BAD, markersize=1.2 * size, markerfacecolor="none", zorder=5)
    ax.plot(*removed_places(s).T, "x", color="#808080", markersize=1.2 * size, markeredgewidth=0.7, zorder=3.5)
    scene = [p for p in (None if known is None else known.xy, None if truth is None else truth[:, :2]) if p is not None]
    points = np.concatenate(scene)
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    mid, half = 0.5 * (low + high), 0.6 * float((high - low).max())
    ax.set(xlim=mid[0] + [-half, half], ylim=mid[1] + [-half, half], xlabel="x [m]", ylabel="y [m]" if left else "")
    ax.set_aspect("equal")


def _mark_end(ax: Axes, path: Array, colour: str) -> None:
    ax.plot(*path[-1:].T, "D", color=colour, markersize=4.0, markeredgecolor="white", markeredgewidth=0.6, zorder=6)


def removed_places(s: Shown) -> Array:
    """Places where removed landmarks had been initialized (r, 2), from the pose of that frame."""
    run, o = s.run, s.log.recorded.observations
    if run.removed is None or not np.any(run.removed >= 0):
        return np.empty((0, 2))
    removed: IntArray = np.flatnonzero(run.removed >= 0)
    rows = np.flatnonzero(np.isin(run.created, removed))
    return np.asarray(s.log.recorded.sensor.inverse(run.trajectory("online").pose[o.frame[rows]], o.z[rows])[0])


def _map_handles(shown: Sequence[Shown]) -> list[Line2D]:
    """What is drawn on maps; crosses only where landmarks were removed."""
    grey = "#404040"

    def mark(marker: str, colour: str, label: str, **look: Any) -> Line2D:
        return Line2D([], [], marker=marker, color=colour, linestyle="none", label=label, **look)

    return [
        Line2D([], [], color=TRUE_PATH, linewidth=1.0, label="true path"),
        Line2D([], [], color=grey, linewidth=1.2, label="estimated path (colour of the method)"),
        mark("D", grey, "end of the path", markersize=4.0),
        mark("+", FAINT, "true point"),
        mark(".", grey, "landmark"),
        mark("s", BAD, "initialized on a person", markerfacecolor="none"),
        *([mark("x", "#808080", "removed")] if any(len(removed_places(s)) for s in shown) else []),
    ]


Drawn = tuple[Figure, str, str]  # figure, caption (Markdown), and what it shows in a sentence


def draw(folder: Path, kind: str, lab: Lab, setup: Setup) -> Picture | None:
    """Draw one picture of `KINDS` below the result folder; None where no run that it needs ended."""
    drawn = KINDS[kind](lab, setup)
    if drawn is None:
        return None
    figure, caption, alt = drawn
    save_for_page(lambda: (KINDS[kind](lab, setup) or drawn)[0], folder / "figures", f"lab-{kind}", figure)
    return Picture(f"lab-{kind}", caption, alt)


def _first_wrong(lab: Lab, setup: Setup) -> Drawn | None:
    s = lab.find(ODOMETRY, "nn")
    if s is None:
        return None
    first = corridor.look(s.run, s.log).first_wrong
    frame = len(s.log.recorded) - 1 if first is None else first
    title = f"{s.log.name}, frame {{frame}}"
    m = problems_of(s.log, "slam", s.run.estimator, s.run.association, setup, [frame], ("nn",), title)[frame]
    what = "the last frame; NN pairs nothing wrongly" if first is None else "the first frame in which NN pairs wrongly"
    paired = s.run.decisions[s.log.recorded.observations.frame == frame]
    number, count = np.unique(paired[paired >= 0], return_counts=True)
    twice = "".join(f" Landmark {n} is given to {c} observations." for n, c in zip(number, count, strict=True) if c > 1)
    return (
        enlarged_figure(m, ["nn"], compatibility=True),
        f"`{s.log.name}`, {what}, zoomed, seen from the robot: what is compatible, with d²; what NN"
        f" makes of it.{twice}",
        f"Compatibility and matching of NN in frame {frame} of {s.log.name}, observations and landmarks numbered",
    )


def _errors(lab: Lab, setup: Setup) -> Drawn | None:
    shown = [s for names in (("nn",), ("singles",), JCBB) if (s := lab.find(ODOMETRY, *names))]
    if not shown:
        return None
    log = shown[0].log
    return (
        error_figure(log, [replace(s.run, final=None) for s in shown]),
        f"`{log.name}`: error of each coordinate with the filter's own ±3σ, by NN, SINGLES and JCBB.",
        f"Errors over time on {log.name} in x, y and heading with 3 sigma: {', '.join(called(s.run) for s in shown)}",
    )


def _people_picture(lab: Lab, setup: Setup) -> Drawn | None:
    both = [(lab.find(ODOMETRY, m), lab.find(PEOPLE, m)) for m in ("nn", "singles")]
    pairs = [(a, b) for a, b in both if a and b]
    if not pairs:
        return None
    quiet, busy = zip(*pairs, strict=True)
    return (
        people_figure(quiet, busy),
        f"`{busy[0].log.name}`: squares are landmarks initialized on people. Below: error with people and without.",
        f"Maps of {' and '.join(called(s.run) for s in busy)} with people, and their position errors",
    )


def _methods(lab: Lab, setup: Setup) -> Drawn | None:
    s = lab.find(PEOPLE, *JCBB) or lab.find(ODOMETRY, *JCBB)
    if s is None:
        return None
    names = ("nn", "singles", s.run.association)
    title = f"{s.log.name}, frame {{frame}}"
    frames = list(range(1, len(s.log.recorded)))
    found = problems_of(s.log, "slam", s.run.estimator, s.run.association, setup, frames, names, title)

    def gained(m: Matching) -> int:
        return len(wrong_of(m.truth.get("nn"))) - len(wrong_of(m.truth.get(s.run.association)))

    frame = max(found, key=lambda k: (gained(found[k]), -k))
    return (
        enlarged_figure(found[frame], names),
        f"`{s.log.name}`, the frame in which JCBB gains most over NN, zoomed: what each makes of the same map.",
        f"Decisions of NN, SINGLES and JCBB in frame {frame} of {s.log.name}, side by side",
    )


def _paths(lab: Lab, setup: Setup) -> Drawn | None:
    if not {BLIND, BLIND_PEOPLE} <= lab.trials.keys() or not _online(lab.trials[BLIND]):
        return None
    quiet, busy = ([Shown(lab.trials[c], r) for r in _online(lab.trials[c])] for c in (BLIND, BLIND_PEOPLE))
    still = [s.run.association for s in quiet if corridor.reach(s.run.trajectory("online").pose) < STILL]
    text = f" The estimate stands still near the start with {', '.join(still)}." if still else ""
    return (
        paths_figure(quiet, busy),
        f"`{quiet[0].log.name}`: true path and online path of each method; the map is the one without people.{text}",
        f"True and estimated paths without odometry of {', '.join(s.run.association for s in quiet)}",
    )


def _online(trial: Trial) -> list[Run]:
    """The filters' runs that reached their end, one for each association method."""
    found: dict[str, Run] = {}
    for run in trial.runs:
        if run.failure is None and run.online is not None and run.association != "none":
            found.setdefault(run.association, run)
    return list(found.values())


def _maintenance_picture(lab: Lab, setup: Setup) -> Drawn | None:
    both = corridor.maintained_pair(lab)
    if both is None:
        return None
    plain, kept = both
    return (
        maintenance_figure(plain, kept),
        f"`{plain.log.name}`, {called(plain.run)}: map and state without and with maintenance; crosses: where removed"
        " landmarks had been initialized.",
        f"Maps and length of the state on {plain.log.name} without and with map maintenance",
    )


KINDS: dict[str, Callable[[Lab, Setup], Drawn | None]] = {
    "first-wrong": _first_wrong, "errors": _errors, "people": _people_picture, "methods": _methods, "paths": _paths,
    "maintenance": _maintenance_picture,
}  # fmt: skip


SEEDS = 20
FIRST = JCBB[0]
COLUMNS = ("FP", "FN", "RMSE [m]", "aligned RMSE [m]")


class Case(NamedTuple):
    """A condition of the lab and an association method of its filter."""

    method: str
    people: bool = False
    odometry: bool = True
    maintained: bool = False

    @property
    def condition(self) -> str:
        """As the lab's tables call it."""
        return corridor.condition(self.people, self.odometry, self.maintained)

    @property
    def name(self) -> str:
        """As a sentence has it."""
        method = "labels" if self.method == "known" else NAMES[self.method]
        return method if self.condition == "no people" else f"{method} ({self.condition})"


COMPARED = ("known", "nn", "singles", FIRST)
CASES = (
    *(Case(m, *ODOMETRY) for m in COMPARED), *(Case(m, *PEOPLE) for m in COMPARED),
    Case(FIRST, *PEOPLE, maintained=True), *(Case(m, *BLIND) for m in ("known", FIRST)),
)  # fmt: skip
CLAIMS = {
    "nn": (("RMSE [m]", Case("nn"), Case("known")),), "singles": (("RMSE [m]", Case("nn"), Case("singles")),),
    "people": (("RMSE [m]", Case("nn", *PEOPLE), Case("nn")), ("RMSE [m]", Case("singles", *PEOPLE), Case("singles"))),
    "jcbb": (("FP", Case("nn", *PEOPLE), Case(FIRST, *PEOPLE)),
    ("RMSE [m]", Case("nn", *PEOPLE), Case(FIRST, *PEOPLE))),
    "blind": (("RMSE [m]", Case(FIRST, *BLIND), Case(FIRST)),),
    "maintenance": tuple((c, Case(FIRST, *PEOPLE), Case(FIRST, *PEOPLE, maintained=True)) for c in ("FP", "RMSE [m]")),
}  # fmt: skip
"""For each question what is expected to be larger than what."""


@dataclass(frozen=True)
class Seed:
    """The lab of one seed, and a row of `COLUMNS` for each of `CASES`, online; None: one of them stopped."""

    lab: str
    outcomes: tuple[tuple[float, ...], ...] | None


@dataclass(frozen=True)
class Compared:
    """Mean of larger - smaller over the seeds with its 95 % interval (Student's t); seeds with the other sign."""

    column: str
    larger: Case
    smaller: Case
    mean: float
    lower: float
    upper: float
    reversed: int
    seeds: int


@dataclass(frozen=True)
class OverSeeds:
    """Outcomes (seeds, cases, columns) of the seeds in which every case reached its end, in their order."""

    labs: tuple[str, ...]
    outcomes: Array

    def of(self, column: str, case: Case) -> Array:
        """Values (seeds,) of a case."""
        return np.asarray(self.outcomes[:, CASES.index(case), COLUMNS.index(column)])

    def compared(self, question: str) -> list[Compared]:
        """What a question claims."""
        return [self._compared(*claim) for claim in CLAIMS[question]]

    def _compared(self, column: str, larger: Case, smaller: Case) -> Compared:
        off = self.of(column, larger) - self.of(column, smaller)
        mean, n = float(off.mean()), len(off)
        half = float(scipy.stats.t.ppf(0.975, n - 1) * off.std(ddof=1) / np.sqrt(n))
        return Compared(column, larger, smaller, mean, mean - half, mean + half, int((off * mean < 0.0).sum()), n)

    def nearer(self, column: str) -> int:
        """In how many seeds with people JCBB's path is nearer to the truth than the one with labels."""
        jcbb, known = (self.of(column, Case(m, *PEOPLE)) for m in (FIRST, "known"))
        return int((jcbb < known).sum())

    @property
    def labels_win(self) -> bool:
        """Whether right pairings give the smaller RMSE on average, with people."""
        jcbb, known = (self.of("RMSE [m]", Case(m, *PEOPLE)) for m in (FIRST, "known"))
        return bool(known.mean() < jcbb.mean())

    def table(self) -> pd.DataFrame:
        """A row for each case: mean ± standard deviation."""
        rows = [
            {"condition": case.condition, "method": case.method}
            | {c: plus_minus(float(self.of(c, case).mean()), float(self.of(c, case).std(ddof=1))) for c in COLUMNS}
            for case in CASES
        ]
        return pd.DataFrame(rows, dtype=object)


def seed_jobs(lab: str, setup: Setup) -> list[Job[str]]:
    """A job for each seed from that of `corridor:SEED+KEY=VALUE` on; none for recorded logs."""
    world, _, rest = lab.partition(":")
    seed, plus, keys = rest.replace(":", "+", 1).partition("+")
    if world != "corridor" or not seed.isdigit():
        return []
    names = [f"corridor:{int(seed) + k}{plus}{keys}" for k in range(SEEDS)]
    return [Job(name, partial(one_seed, name, setup)) for name in names]


def one_seed(lab: str, setup: Setup) -> Seed:
    """The filter in every case of one simulated lab."""
    logs = {switches: open_scored(name) for switches, name in zip(CONDITIONS, corridor_names(lab), strict=True)}
    rows = []
    for case in CASES:
        log, how = logs[case.people, case.odometry], replace(setup, maintain=case.maintained)
        run = step_by_step("ekf", log.inputs(labels=case.method == "known").without_map(), "slam", case.method, how)
        counts, truth = confusion_of(run, log, "online"), log.truth.pose
        if run.failure is not None or run.online is None or counts is None or truth is None:
            return Seed(lab, None)
        path: Array = run.online.pose
        rows.append((counts.fp, counts.fn, rms(position_distance(path, truth)), aligned_rmse(path, truth)))
    return Seed(lab, tuple(rows))


def over_seeds(seeds: Sequence[Seed]) -> OverSeeds | None:
    """All seeds together; None if there are not two."""
    order = sorted((s for s in seeds if s.outcomes is not None), key=lambda s: int(s.lab.split(":")[1].split("+")[0]))
    return OverSeeds(tuple(s.lab for s in order), np.array([s.outcomes for s in order])) if len(order) > 1 else None


REPEATS = 15  # runs measured; of each frame the fastest counts, as whatever else the machine does only adds time
NAME = "lab-update-time"
WHAT = ("without maintenance", "with maintenance")
TIME_HEADS = ("run", "median [ms]", "largest [ms]", "whole run [ms]", "removing landmarks [ms]")


class Times(NamedTuple):
    """Seconds (N,) of each frame: update and new landmarks; map maintenance."""

    update: Array
    maintenance: Array


def update_times(log: Log, estimator: str, method: str, setups: Sequence[Setup], repeats: int = REPEATS) -> list[Times]:
    """Time of each frame's update in SLAM and of map maintenance, for each setup: the least of `repeats`, in turns."""
    inputs = log.inputs(labels=method == "known").without_map()
    measured = np.zeros((repeats, len(setups), 2, len(inputs)))
    for turn in measured:
        for setup, seconds in zip(setups, turn, strict=True):
            front = front_end(estimator, method, inputs, setup)
            for k in range(len(inputs)):  # as `eval.replay.run` drives it
                frame = inputs.frame(k)
                front.move(frame)
                begin = end = time.perf_counter()
                if len(frame.observations.z):
                    pairing = front.associate(frame)
                    begin = time.perf_counter()
                    front.update(frame, pairing)
                    end = time.perf_counter()
                front.tidy()
                seconds[:, k] = end - begin, time.perf_counter() - end
    return [Times(update, maintenance) for update, maintenance in measured.min(axis=0)]


def write_times(folder: Path, lab: Lab, setup: Setup, formats: tuple[str, ...]) -> str | None:
    """Write a table of times without and with maintenance, and return its name; None where no run of both ended."""
    both = corridor.maintained_pair(lab)
    if both is None:
        return None
    run, log = both[0].run, both[0].log
    setups = [replace(setup, maintain=maintain) for maintain in (False, True)]
    times = zip(WHAT, update_times(log, run.estimator, run.association, setups), strict=True)
    most = (np.median, np.max, np.sum)
    rows = [[what, *(1e3 * f(t.update) for f in most), 1e3 * np.sum(t.maintenance)] for what, t in times]
    caption = f"{log.name}: measured time of a frame's update, fastest of {REPEATS}. Differs from run to run."
    write_table(pd.DataFrame(rows, columns=list(TIME_HEADS)), folder / "tables", NAME, caption, formats)
    return f"tables/{NAME}.csv"


WORSE = 1.5  # an error this many times another one is called worse, below it comparable


@dataclass(frozen=True)
class Answers:
    """Every run that was looked at, and the facts of each question by its name.

    Facts are runs by the part they play (None: it did not reach its end), what follows from them, and `lack`, whether
    a run that the question needs is missing; `lost`: names of others that are.
    """

    runs: tuple[Judged, ...]
    of: dict[str, dict[str, Any]]

    def rows(self, which: tuple[bool, bool, bool], methods: Iterable[str]) -> list[Judged]:
        """The runs of a condition (people, odometry, maintained) with some methods, in their order."""
        of = {r.association: r for r in self.runs if (r.people, r.odometry, r.maintained) == which}
        return [of[m] for m in methods if m in of]


def worse(a: Judged | None, b: Judged | None) -> bool:
    """Whether both reached their end, and the path of `a` is clearly the worse one."""
    return a is not None and b is not None and a.rmse > WORSE * b.rmse


def answers(lab: Lab, scores: Scores) -> Answers:
    """All that the lab's questions need."""

    def runs_of(switches: tuple[bool, bool], *, maintained: bool) -> dict[str, Judged]:
        found = [lab.find(switches, method, maintained=maintained) for method in METHODS]
        runs = {s.run.association: s.run for s in found if s is not None}
        return corridor.judged((lab.maintained if maintained else lab.trials)[switches], runs.values(), scores)

    plain = {c: runs_of(c, maintained=False) for c in lab.trials}
    kept = {c: runs_of(c, maintained=True) for c in lab.maintained}

    def of(switches: tuple[bool, bool], method: str) -> Judged | None:
        names, runs = JCBB if method == "jcbb" else (method,), plain.get(switches, {})
        return next((runs[name] for name in names if name in runs), None)

    three = {m: of(ODOMETRY, m) for m in ("nn", "singles", "jcbb")}
    nn, known = three["nn"], of(ODOMETRY, "known")
    busy = next((s for s in (PEOPLE, ODOMETRY) if of(s, "jcbb") is not None), PEOPLE)
    runs = tuple(r for by_method in (*plain.values(), *kept.values()) for r in by_method.values())
    return Answers(
        runs,
        {
            "nn": {
                "nn": nn,
                "known": known,
                "costly": worse(nn, known),
                "lack": None in (nn, known),
                # whether the error of the pose is large enough to make another landmark the nearest one
                "explained": nn is not None and nn.p.off >= 0.5 * nn.p.apart,
            },
            "singles": {**three, "lost": tuple(NAMES[m] for m, r in three.items() if r is None), "lack": False},
            "people": _people({m: (of(ODOMETRY, m), of(PEOPLE, m)) for m in ("nn", "singles")}),
            "jcbb": _joint(*(of(busy, m) for m in ("jcbb", "nn", "singles", "known"))),
            "blind": _blind(lab, of(BLIND, "known"), of(BLIND, "jcbb"), tuple(plain.get(BLIND, {}).values()), scores),
            "maintenance": _maintenance(lab, scores),
        },
    )


def _people(both: dict[str, tuple[Judged | None, Judged | None]]) -> dict[str, Any]:
    """`broken`: names of those whose path is worse with people; of pairings of people those with `ghosts`, `points`."""
    pairs = tuple((a, b) for a, b in both.values() if a is not None and b is not None)
    ghosts = sum(b.p.clutter_again for _, b in pairs)
    return {
        "pairs": pairs, "lost": tuple(NAMES[m] for m, found in both.items() if None in found),
        "broken": tuple(b.name for a, b in pairs if worse(b, a)), "ghosts": ghosts,
        "points": sum(b.p.clutter_paired for _, b in pairs) - ghosts, "lack": not pairs,
    }  # fmt: skip


def _joint(jcbb: Judged | None, nn: Judged | None, singles: Judged | None, known: Judged | None) -> dict[str, Any]:
    """`better`: whether JCBB decides and estimates better than NN; `close`: about as well as with labels."""
    return {
        "jcbb": jcbb, "nn": nn, "singles": singles, "known": known,
        "runs": tuple(r for r in (jcbb, nn, singles, known) if r is not None),
        "better": jcbb is not None and nn is not None and jcbb.p.wrong < nn.p.wrong and jcbb.rmse < nn.rmse,
        "close": None not in (jcbb, known) and not worse(jcbb, known), "lack": jcbb is None or nn is None,
    }  # fmt: skip


def _blind(
    lab: Lab, known: Judged | None, jcbb: Judged | None, runs: tuple[Judged, ...], scores: Scores
) -> dict[str, Any]:
    """`smoother`: batch with labels, if plausible; `suffices`: whether it is usable where the filter is worse."""
    trial = lab.trials.get(BLIND)
    batch = None if trial is None else trial.find("batch")
    smoother = corridor.judged(trial, [batch], scores)["known"] if trial and batch and batch.flaw is None else None
    return {
        "known": known, "jcbb": jcbb, "smoother": smoother,
        "motion": None if trial is None else corridor.true_against_stated(trial.log),
        "reach": math.nan if trial is None or trial.log.truth.pose is None else corridor.reach(trial.log.truth.pose),
        "runs": runs, "usable": tuple(r.association for r in runs if r.usable),
        "best": min(runs, key=lambda r: r.rmse, default=None),
        "others": tuple(r for r in runs if r.association in ("nn", "singles", "jcbb-hindsight")),
        "suffices": smoother is not None and smoother.usable and worse(known, smoother),
        "lack": known is None and jcbb is None,
    }  # fmt: skip


def _maintenance(lab: Lab, scores: Scores) -> dict[str, Any]:
    pair = corridor.maintained_pair(lab) or ()
    plain, kept = (corridor.judged(s.trial, [s.run], scores)[s.run.association] for s in pair) if pair else (None, None)
    return {"plain": plain, "kept": kept, "better": worse(plain, kept), "worse": worse(kept, plain), "lack": not pair}


TEMPLATE = "labs/corridor"
LAB = ("nn", "singles", "jcbb-first")


class Question(NamedTuple):
    """A question of the assignment."""

    name: str  # of its facts in `Answers` and of its macros
    heading: str
    shown: tuple[tuple[bool, bool, bool], ...]  # conditions (people, odometry, maintained) of its table, and methods
    methods: tuple[str, ...]
    pictures: tuple[str, ...]


PLAIN, CROWDED, TIDIED = (*ODOMETRY, False), (*PEOPLE, False), (*PEOPLE, True)
NOT_READ = ((*BLIND, False), (*BLIND_PEOPLE, False))
QUESTIONS = (
    Question("nn", "Why does nearest neighbour (NN) fail?", (PLAIN,), ("known", "nn"), ("first-wrong",)),
    Question("singles", "Does SINGLES do better?", (PLAIN,), LAB, ("errors",)),
    Question("people", "What do people do to NN and SINGLES?", (PLAIN, CROWDED), LAB[:2], ("people",)),
    Question("jcbb", "Why does JCBB cope better?", (CROWDED,), METHODS, ("methods",)),
    Question("blind", "What happens without odometry?", NOT_READ, METHODS, ("paths",)),
    Question("maintenance", "What does map maintenance change?", (CROWDED, TIDIED), LAB, ("maintenance",)),
)


def hand_in(folder: Path, options: Options, trials: Sequence[Trial], scores: Scores, lost: Unfinished) -> list[Section]:
    """The answers to a lab's questions, the first sections of its report; nothing without `--lab`."""
    if options.selection.lab is None:
        return []
    if any(t.log.evidence is not None for t in trials):
        return visual_hand_in(folder, options.output, trials)
    lab = corridor.find_lab(trials)
    return [] if lab is None else _corridor(folder, options, lab, answers(lab, scores), lost)


def _corridor(folder: Path, options: Options, lab: Lab, facts: Answers, lost: Unfinished) -> list[Section]:
    """Six sections, their pictures drawn in parallel."""
    output = options.output
    wanted = [] if output.no_plots else [k for q in QUESTIONS for k in q.pictures]
    setup = options.setup.settled(next(iter(lab.trials.values())).log.labels_are_sensed)
    jobs: list[Job[str]] = [Job(kind, draw, (folder, kind, lab, setup)) for kind in wanted]
    jobs += [] if output.no_plots else [Job("update-time", write_times, (folder, lab, setup, output.formats))]
    if (jcbb := facts.of["jcbb"]["jcbb"]) is not None and jcbb.estimator == "ekf":
        jobs += seed_jobs(options.selection.lab or "", setup)
    done = dict(work(jobs, options.execution, lost=lambda kind, why: lost.say("picture", why, name=f"lab: {kind}")))
    made: dict[str, Picture] = {kind: found for kind, found in done.items() if isinstance(found, Picture)}
    repeated, sections = over_seeds([s for s in done.values() if isinstance(s, Seed)]), []
    for n, question in enumerate(QUESTIONS, start=1):
        q = facts.of[question.name]
        caption = paragraph(f"{TEMPLATE}#columns", n=n, nees=ASTRAY_NEES)
        more: dict[str, object] = {"repeated": repeated} if question.name == "jcbb" else {}
        more |= {"measured": done.get("update-time")} if question.name == "maintenance" else {}
        line = paragraph(f"{TEMPLATE}#{question.name}_line", q=q)
        if repeated is not None:
            line += " " + paragraph(f"{TEMPLATE}#over_seeds", claims=repeated.compared(question.name))
        blocks: list[Block] = [
            f"**{line}**",
            *(made[kind] for kind in question.pictures if kind in made),
            written_table(_numbers(question, facts), folder, f"lab-question-{n}", caption, output),
        ]
        if repeated is not None and question.name == "jcbb":
            about = paragraph(f"{TEMPLATE}#seeds", found=repeated)
            blocks.append(written_table(repeated.table(), folder, "lab-seeds", about, output))
        text = paragraph(f"{TEMPLATE}#{'lost' if q['lack'] else question.name}", q=q, **more)
        blocks.append(text if q["lack"] else Folded("In detail", (text,)))
        answer = f"{n}. {question.heading} {line}"
        sections.append(Section(f"Question {n}: {question.heading}", tuple(blocks), facts=q, answer=answer))
    return sections


def _numbers(question: Question, facts: Answers) -> pd.DataFrame:
    """Outcomes and errors, online, of the runs that a question's table shows."""
    rows = []
    for r in (r for where in question.shown for r in facts.rows(where, question.methods)):
        rows.append(
            {
                "condition": r.condition, "method": r.association, **{c.upper(): getattr(r.p, c) for c in OUTCOMES},
                "RMSE [m]": r.rmse, "in 3σ [%]": 100.0 * r.inside, "landmarks": r.landmarks,
                "state": None if math.isnan(r.state) else round(r.state), "usable": "yes" if r.usable else "no",
            }
        )  # fmt: skip
        if question.name == "jcbb" and r.revised:
            revised = {c.upper(): n for c, n in r.revised.items()}
            rows.append({**dict.fromkeys(rows[-1]), **revised, "condition": rows[-1]["condition"]})
            rows[-1]["method"] = f"{r.association}, final"
    return pd.DataFrame(rows, dtype=object)
