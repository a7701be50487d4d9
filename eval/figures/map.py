"""The map figure: true, dead-reckoned and estimated paths, landmarks, and 3 sigma ellipses, seen from above."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from data.inputs import IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array, dead_reckoned
from eval.figures.paper import page_width, points
from eval.figures.plane import (
    View,
    along_path,
    draw_ellipses,
    draw_walls,
    ellipses,
    enlargement,
    longest_axis,
    true_landmarks,
    view_of,
)
from eval.figures.style import DOTTED, STYLES, TRUTH_COLOUR, Series, drawing, series, settle
from eval.referee.ambiguity import ambiguous
from eval.referee.given_runs import is_truth_alone

MOST_IDS = 30
LONG_LABEL = 24
GREY = "#606060"
"""What the legend shows of every estimator."""
Surveyed = Callable[[Axes], Sequence[Line2D]]
"""Draws what was surveyed on a map, and returns what the legend shows of it."""


def _with_ellipses(shown: Sequence[Series]) -> list[Series]:
    """All estimators with a plausible end while they are few; otherwise the first filter and the first smoother."""
    estimates = [s for s in shown if s.run.estimator != "dead-reckoning" and s.run.flaw is None]
    if len(estimates) <= 3:
        return estimates
    ranked = sorted(estimates, key=lambda s: s.run.estimator not in ("ekf", "batch"))
    firsts = {s.phase: s for s in reversed(ranked)}
    return [firsts[p] for p in ("online", "final") if p in firsts]


def _label(s: Series) -> str:
    flaw = s.run.flaw
    return s.label if flaw is None else f"{s.label}:\n{flaw.status} at frame {flaw.frame}"


def map_figure(
    log: Log,
    runs: Sequence[Run],
    *,
    width: float | None = None,
    surveyed: Surveyed | None = None,
    factor: int | None = None,
) -> Figure:
    """Paths, landmarks and 3 sigma ellipses of every run on one log; metres, equal aspect, `width` in inches.

    Ellipses too small to see are enlarged, all by one factor that the legend states. A path that runs away does not
    squash the picture: it is cut, and the title names it. `surveyed` draws in place of the true landmarks; `factor` is
    by how much ellipses are enlarged (None: as is needed).
    """
    with drawing():
        return _map_figure(log, runs, width or page_width(), surveyed, factor)


def _map_figure(log: Log, runs: Sequence[Run], width: float, surveyed: Surveyed | None, factor: int | None) -> Figure:
    shown = series(runs)
    paths = {s.label: s.trajectory.pose[:, :2] for s in shown}
    if not (is_truth_alone(log) or any(r.estimator == "dead-reckoning" for r in runs)):
        reckoned = dead_reckoned(log.recorded.prior.mean, log.recorded.increments.mean)
        paths = {STYLES["dead-reckoning"].label: reckoned[:, :2], **paths}
    estimates = _with_ellipses(shown)
    maps = [(s, s.run.map) for s in estimates if s.run.map is not None and len(s.run.map)]
    points_seen = log.recorded.sensor.sees_points
    outlines = {f"map of {s.label}": ellipses(m.xy, m.covariance) for s, m in maps if points_seen}
    view = view_of(log, shown, paths, outlines)
    poses = [(s, *along_path(s)) for s in estimates]
    sizes = [longest_axis(P) for _, _, P in poses] + [longest_axis(m.covariance) for _, m in maps if points_seen]
    if factor is None:
        factor = enlargement(view, np.concatenate(sizes) if sizes else np.empty(0))

    fig = Figure()
    ax = fig.add_subplot()
    ax.set(xlim=(view.low[0], view.high[0]), ylim=(view.low[1], view.high[1]), xlabel="x [m]", ylabel="y [m]")
    handles: list[Line2D | Patch] = []

    if log.truth.known_poses and log.truth.pose is not None:
        handles += ax.plot(*log.truth.pose[:, :2].T, color=TRUTH_COLOUR, linewidth=1.8, label="true path", zorder=2)
    own = {s.label: s for s in shown}
    for label, path in paths.items():
        s = own.get(label)
        colour, line = (STYLES["dead-reckoning"].colour, DOTTED) if s is None else (s.colour, s.line)
        name = label if s is None else _label(s)
        handles += ax.plot(*path.T, color=colour, linestyle=line, linewidth=1.0, label=name, zorder=3)

    known = true_landmarks(log)
    name = "true landmarks" if log.truth.landmarks is not None else "landmarks (given map)"
    if surveyed is not None:
        handles += surveyed(ax)
    elif known is not None and len(known.id) and not points_seen:
        handles += _walls(ax, known.id, known.xy, view, "black", name, MOST_IDS)
    elif known is not None and len(known.id):
        handles += ax.plot(*known.xy.T, "k+", markersize=6.0, markeredgewidth=1.0, label=name, zorder=4)
        if len(known.id) <= MOST_IDS:
            _landmark_ids(ax, known.id, known.xy, view)
    doubtful = False
    for s, m in maps:
        numbered = known is None and len(m) <= MOST_IDS and s is maps[0][0]
        if not points_seen:
            _walls(ax, m.number, m.xy, view, s.colour, "", MOST_IDS if numbered else 0)
            continue
        ax.plot(*m.xy.T, "o", color=s.colour, markersize=2.0, zorder=4)
        draw_ellipses(ax, m.xy, m.covariance, s.colour, factor, 3.5)
        unclear = m.xy[ambiguous(s.run, log.recorded) >= 0]
        if len(unclear):
            ax.plot(*unclear.T, "D", color="black", fillstyle="none", markersize=9.0, markeredgewidth=0.8, zorder=5.2)
            doubtful = True
        if numbered:
            _landmark_ids(ax, m.number, m.xy, view)
    for s, mean, covariance in poses:
        draw_ellipses(ax, mean, covariance, s.colour, factor, 5.0)
    others = [s for s in shown if s.run.estimator != "dead-reckoning" and s.run.flaw is None]
    drawn = bool(maps) and points_seen, any(len(m) for _, m, _ in poses)
    handles += _ellipse_handles(*drawn, factor, len(estimates) < len(others))
    if doubtful:
        handles.append(
            Line2D([], [], color="black", marker="D", fillstyle="none", linestyle="none", label="ambiguous landmarks")
        )
    if maps and not points_seen:
        handles.append(Line2D([], [], color=GREY, linewidth=0.7, label="estimated landmarks"))

    start = log.recorded.prior.mean
    marker = (3, 0, float(np.degrees(start[2])) - 90.0)
    handles += ax.plot(
        start[0], start[1], marker=marker, markersize=8, color="white", markeredgecolor="black", linestyle="none",
        label="start", zorder=6,
    )  # fmt: skip

    ax.set_aspect("equal")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10]))

    # the page is cut to the scene, so that equal aspect leaves no blank paper
    w, h = view.size
    at_side = width > 5.0 and w / h < 1.7
    # labels that name the association as well are too long for two columns of a narrow picture
    narrow = 1 if any(len(s.label) > LONG_LABEL for s in shown) else 2
    columns = 1 if at_side else (3 if width > 5.0 else narrow)
    across = width - (2.7 if at_side else 0.65)
    scene = across * float(h / w)
    title = _title(log, runs, view, round(15.0 * across))
    ax.set_title(title, loc="left")
    lines = sum(str(handle.get_label()).count("\n") + 1 for handle in handles)
    legend_rows = 0 if at_side else -(-lines // columns)
    fig.set_size_inches(width, float(np.clip(scene, 1.5, 6.5)) + 0.6 + 0.14 * title.count("\n") + 0.155 * legend_rows)
    fig.legend(handles=handles, loc="outside right upper" if at_side else "outside lower left", ncols=columns)
    settle(fig)
    return fig


def _title(log: Log, runs: Sequence[Run], view: View, characters: int) -> str:
    tasks = sorted({"SLAM" if r.task == "slam" else r.task for r in runs})
    title = f"{log.name}: {' and '.join(tasks)}" if tasks else log.name
    if view.leaving:
        title += f"\nnot shown in full: {', '.join(view.leaving)}"
    return "\n".join(fill(line, characters) for line in title.split("\n"))


def _walls(ax: Axes, number: IntArray, walls: Array, view: View, colour: str, name: str, most_ids: int) -> list[Line2D]:
    """Walls (n, 2) of rho, alpha, numbered in the middle if they are few; what the legend shows of them."""
    rows, ends = draw_walls(ax, walls, colour)
    if 0 < len(number) <= most_ids:
        _landmark_ids(ax, number[rows], ends.mean(axis=1), view)
    return [Line2D([], [], color=colour, linewidth=0.7, label=name)] if name and len(rows) else []


def _landmark_ids(ax: Axes, number: IntArray, xy: Array, view: View) -> None:
    inside = np.all((xy >= view.low) & (xy <= view.high), axis=1)
    halo = [withStroke(linewidth=1.5, foreground="white")]
    for n, (x, y) in zip(number[inside].tolist(), xy[inside].tolist(), strict=True):
        ax.annotate(
            str(n), (x, y), xytext=(3.0, 3.0), textcoords="offset points", fontsize=points(6), color="#404040",
            path_effects=halo, zorder=5.5,
        )  # fmt: skip


def _ellipse_handles(maps: bool, poses: bool, factor: int, only_some: bool) -> list[Line2D | Patch]:
    larger = "" if factor == 1 else f", drawn {factor} times larger"
    which = "\n(first filter and smoother)" if only_some else ""
    found: list[Line2D | Patch] = []
    if maps:
        dot = Line2D([], [], color=GREY, marker="o", markersize=2.5, linestyle="none", label="estimated landmarks")
        found.append(dot)
    if maps or poses:
        found.append(Patch(facecolor="#D8D8D8", edgecolor=GREY, linewidth=0.6, label=f"3σ ellipses{larger}{which}"))
    return found
