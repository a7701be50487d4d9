"""The pictures of the corridor lab's answers: maps, estimated paths, errors, one frame in detail."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from data.inputs import CLUTTER, IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array
from data.words import number
from eval.figures.error import error_figure, ticks, time_label
from eval.figures.plane import true_landmarks
from eval.figures.style import DASHED, NARROW, SOLID, Line, across, colour_of_method, drawing, page_width, save_for_page
from eval.referee.errors import landmark_true_ids, named, position_distance, rms
from eval.referee.score import Trial
from eval.replay.settings import Setup
from eval.report.page.blocks import Picture
from wings.labs.corridor import (
    BLIND,
    BLIND_PEOPLE,
    JCBB,
    NAMES,
    ODOMETRY,
    PEOPLE,
    Lab,
    Shown,
    look,
    maintained_pair,
    reach,
)
from wings.labs.stepping.pictures import BAD, FAINT, enlarged_figure, wrong_of
from wings.labs.stepping.problem import Matching, problems_of

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
            _axes_over_time(below, s.log, "position error [m]" if k == 0 or page_width() < NARROW else "", 4)
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
        _axes_over_time(below, plain.log, "length of the state", 4)
        below.legend(**ABOVE)
        return fig


def _line(
    ax: Axes, log: Log, values: Array | IntArray, method: str, line: Line, label: str, style: str = "steps-post"
) -> None:
    """Values (N,) of the frames over time, in the colour of an association method."""
    (drawn,) = ax.plot(log.recorded.time, values, linestyle=line, linewidth=1.1, drawstyle=style, label=label)
    drawn.set_color(colour_of_method(method))


def _axes_over_time(ax: Axes, log: Log, what: str, most: int) -> None:
    """Time below, and what is shown over it from zero on with few ticks."""
    ax.set(xlabel=time_label(log.recorded), ylabel=what, ylim=(0.0, None))
    ax.yaxis.set_major_locator(ticks(most))


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
    at = removed_places(s)
    ax.plot(*at.T, "x", color="#808080", markersize=1.2 * size, markeredgewidth=0.7, zorder=3.5)
    scene = [p for p in (None if known is None else known.xy, None if truth is None else truth[:, :2]) if p is not None]
    points = np.concatenate(scene)
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    middle, half = 0.5 * (low + high), 0.6 * float((high - low).max())
    ax.set(
        xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half], xlabel="x [m]", ylabel="y [m]" if left else ""
    )
    ax.set_aspect("equal")


def _mark_end(ax: Axes, path: Array, colour: str) -> None:
    """A diamond where a path (N, 2) ends."""
    ax.plot(*path[-1:].T, "D", color=colour, markersize=4.0, markeredgecolor="white", markeredgewidth=0.6, zorder=6)


def removed_places(s: Shown) -> Array:
    """Places where removed landmarks had been initialized (r, 2), from the pose of that frame."""
    run, o = s.run, s.log.recorded.observations
    if run.removed is None or not np.any(run.removed >= 0):
        return np.empty((0, 2))
    removed: IntArray = np.flatnonzero(run.removed >= 0)
    rows = np.flatnonzero(np.isin(run.created, removed))
    pose = run.trajectory("online").pose[o.frame[rows]]
    return np.asarray(s.log.recorded.sensor.inverse(pose, o.z[rows])[0])


def _map_handles(shown: Sequence[Shown]) -> list[Line2D]:
    """What is drawn on maps; crosses only where landmarks were removed."""
    grey = "#404040"

    def mark(marker: str, colour: str, label: str, **look: Any) -> Line2D:
        return Line2D([], [], marker=marker, color=colour, linestyle="none", label=label, **look)

    removed = any(len(removed_places(s)) for s in shown)
    return [
        Line2D([], [], color=TRUE_PATH, linewidth=1.0, label="true path"),
        Line2D([], [], color=grey, linewidth=1.2, label="estimated path (colour of the method)"),
        mark("D", grey, "end of the path", markersize=4.0),
        mark("+", FAINT, "true point"),
        mark(".", grey, "landmark"),
        mark("s", BAD, "initialized on a person", markerfacecolor="none"),
        *([mark("x", "#808080", "removed")] if removed else []),
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
    first = look(s.run, s.log).first_wrong
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


def _people(lab: Lab, setup: Setup) -> Drawn | None:
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
    still = [s.run.association for s in quiet if reach(s.run.trajectory("online").pose) < STILL]
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


def _maintenance(lab: Lab, setup: Setup) -> Drawn | None:
    both = maintained_pair(lab)
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
    "first-wrong": _first_wrong,
    "errors": _errors,
    "people": _people,
    "methods": _methods,
    "paths": _paths,
    "maintenance": _maintenance,
}
