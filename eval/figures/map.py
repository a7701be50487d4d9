"""The map figure: true, dead-reckoned and estimated paths, landmarks, and 3 sigma ellipses, seen from above."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from data.inputs import CLUTTER, IntArray
from data.log import Log
from data.pose_measurements import FixKind
from data.result import MapEstimate, Run
from data.se2 import Array, dead_reckoned
from data.terminal import counted
from eval.figures import kinds, plane, style as house
from eval.referee.ambiguity import ambiguous
from eval.referee.given.runs import is_truth_alone
from eval.referee.score import Trial

MOST_IDS = 30
LONG_LABEL = 24
FAINT = "#b0b0b0"  # Of fixes and closures
GREY = "#606060"  # What the legend shows of every estimator
AMBIGUOUS: dict[str, Any] = {"color": "black", "marker": "D", "fillstyle": "none", "linestyle": "none"}
"""Around landmarks that another place would suit as well."""
Surveyed = Callable[[Axes], Sequence[Line2D]]  # Draws what was surveyed on a map, and returns what the legend shows


def _with_ellipses(shown: Sequence[house.Series]) -> list[house.Series]:
    """All estimators with a plausible end while they are few; otherwise the first filter and the first smoother."""
    estimates = [s for s in shown if s.run.estimator != "dead-reckoning" and s.run.flaw is None]
    if len(estimates) <= 3:
        return estimates
    ranked = sorted(estimates, key=lambda s: s.run.estimator not in ("ekf", "batch"))
    firsts = {s.phase: s for s in reversed(ranked)}
    return [firsts[p] for p in ("online", "final") if p in firsts]


@dataclass(frozen=True, eq=False)
class _Map:
    """What is drawn on a map."""

    log: Log
    shown: list[house.Series]  # all series
    estimates: list[house.Series]  # those with ellipses
    maps: list[tuple[house.Series, MapEstimate]]  # of these, with the maps they end with
    points: bool  # whether landmarks are points, not walls
    paths: dict[str, Array]  # (N, 2) by label, dead reckoning too
    poses: list[tuple[house.Series, Array, Array]]  # means and covariances along the estimates' paths
    view: plane.View  # what part of the plane
    factor: int  # by how much ellipses are enlarged


def _gathered(log: Log, runs: Sequence[Run], factor: int | None) -> _Map:
    shown = house.series(runs)
    paths = {s.label: s.trajectory.pose[:, :2] for s in shown}
    if not (is_truth_alone(log) or any(r.estimator == "dead-reckoning" for r in runs)):
        reckoned = dead_reckoned(log.recorded.prior.mean, log.recorded.increments.mean)
        paths = {house.STYLES["dead-reckoning"].label: reckoned[:, :2], **paths}
    estimates = _with_ellipses(shown)
    maps = [(s, s.run.map) for s in estimates if s.run.map is not None and len(s.run.map)]
    points = log.recorded.sensor.sees_points
    of_points = maps if points else []
    outlines = {f"map of {s.label}": plane.ellipses(m.xy, m.covariance) for s, m in of_points}
    view = plane.view_of(log, shown, paths, outlines)
    poses = [(s, *plane.along_path(s)) for s in estimates]
    if factor is None:
        sizes = [plane.longest_axis(P) for _, _, P in poses] + [plane.longest_axis(m.covariance) for _, m in of_points]
        factor = plane.enlargement(view, np.concatenate(sizes) if sizes else np.empty(0))
    return _Map(log, shown, estimates, maps, points, paths, poses, view, factor)


def enlarged(log: Log, runs: Sequence[Run], factor: int | None) -> int:
    """By how much `map_figure` enlarges the ellipses for a factor, None: as is needed to see them."""
    return _gathered(log, runs, None).factor if factor is None else factor


@house.drawing()
def map_figure(
    log: Log, runs: Sequence[Run], *, width: float | None = None, surveyed: Surveyed | None = None,
    factor: int | None = None,
) -> Figure:  # fmt: skip
    """Paths, landmarks and 3σ ellipses of every run on one log; metres, equal aspect, `width` in inches.

    A path that runs away is cut, and the title names it. `surveyed` draws in place of the true landmarks; `factor`
    enlarges ellipses (None: as is needed to see them; the legend states it).
    """
    made = _gathered(log, runs, factor)
    fig = Figure()
    ax = fig.add_subplot()
    plane.plan_axes(ax, made.view.low, made.view.high)
    handles: list[Line2D | Patch] = _draw_paths(ax, made)
    handles += _draw_true_landmarks(ax, made) if surveyed is None else surveyed(ax)
    handles += _draw_estimates(ax, made)
    handles += _draw_sources(ax, made)
    handles += plane.draw_start(ax, log.recorded.prior.mean)
    _fit(fig, ax, made, runs, width or house.page_width(), handles)
    return fig


DASH = 5.0  # Length [line widths] of a dash of the second solid path; gaps of each further one are longer by as much


def _draw_paths(ax: Axes, m: _Map) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = []
    truth = m.log.truth
    if truth.known_poses and truth.pose is not None:
        handles += ax.plot(*truth.pose[:, :2].T, color=house.TRUTH_COLOUR, linewidth=1.8, label="true path", zorder=2)
    own = {s.label: s for s in m.shown}
    before = 0
    for label, path in m.paths.items():
        s = own.get(label)
        colour, line = (house.STYLES["dead-reckoning"].colour, house.DOTTED) if s is None else (s.colour, s.line)
        if line == house.SOLID:  # paths that coincide show through the gaps of those above
            line, before = (0, (DASH, DASH * before)) if before else house.SOLID, before + 1
        flaw = None if s is None else s.run.flaw
        name = label if flaw is None else f"{label}:\n{flaw.status} at frame {flaw.frame}"
        handles += ax.plot(*path.T, color=colour, linestyle=line, linewidth=1.0, label=name, zorder=3)
    return handles


def _draw_sources(ax: Axes, m: _Map) -> list[Line2D]:
    """Faintly, places that fixes state, and closures between the poses of the last path."""
    handles: list[Line2D] = []
    fixes, closures = m.log.recorded.fixes, m.log.recorded.closures
    if fixes is not None and len(places := fixes.z[fixes.kind != FixKind.HEADING, :2]):
        handles += ax.plot(*places.T, "x", color=FAINT, markersize=3.0, markeredgewidth=0.6, label="fixes", zorder=1.5)
    if closures is not None and len(closures) and m.paths:
        path = list(m.paths.values())[-1]
        ends = np.stack([path[closures.frame1], path[closures.frame2]], axis=1)
        ax.add_collection(LineCollection(list(ends), colors=FAINT, linewidths=0.6, zorder=1.5), autolim=False)
        handles.append(house.key("closures", color=FAINT, linewidth=0.9))
    return handles


def _draw_true_landmarks(ax: Axes, m: _Map) -> list[Line2D]:
    known = plane.true_landmarks(m.log)
    if known is None or not len(known.id):
        return []
    name = "true landmarks" if m.log.truth.landmarks is not None else "landmarks (given map)"
    if not m.points:
        return _walls(ax, known.id, known.xy, m.view, "black", name, MOST_IDS)
    if len(known.id) <= MOST_IDS:
        _landmark_ids(ax, known.id, known.xy, m.view)
    return ax.plot(*known.xy.T, "k+", markersize=6.0, markeredgewidth=1.0, label=name, zorder=4)


def _draw_estimates(ax: Axes, m: _Map) -> list[Line2D | Patch]:
    """Maps and ellipses along the paths; landmarks whose place is ambiguous are marked."""
    any_unclear = False
    for i, (s, map_) in enumerate(m.maps):
        numbered = i == 0 and plane.true_landmarks(m.log) is None and len(map_) <= MOST_IDS
        if not m.points:
            _walls(ax, map_.number, map_.xy, m.view, s.colour, "", MOST_IDS if numbered else 0)
            continue
        ax.plot(*map_.xy.T, "o", color=s.colour, markersize=2.0, zorder=4)
        plane.draw_ellipses(ax, map_.xy, map_.covariance, s.colour, m.factor, 3.5)
        unclear = map_.xy[ambiguous(s.run, m.log.recorded) >= 0]
        if len(unclear):
            ax.plot(*unclear.T, **AMBIGUOUS, markersize=9.0, markeredgewidth=0.8, zorder=5.2)
            any_unclear = True
        if numbered:
            _landmark_ids(ax, map_.number, map_.xy, m.view)
    for s, mean, covariance in m.poses:
        plane.draw_ellipses(ax, mean, covariance, s.colour, m.factor, 5.0)
    handles = _ellipse_handles(m)
    if any_unclear:
        handles.append(house.key("ambiguous landmarks", **AMBIGUOUS))
    if m.maps and not m.points:
        handles.append(house.key("estimated landmarks", color=GREY, linewidth=0.7))
    return handles


def _fit(fig: Figure, ax: Axes, m: _Map, runs: Sequence[Run], width: float, handles: list[Line2D | Patch]) -> None:
    """Title and legend, and the page cut to the scene, so that equal aspect leaves no blank paper."""
    w, h = m.view.size
    at_side = width > 5.0 and w / h < 1.7
    # labels that name the association as well are too long for two columns of a narrow picture
    narrow = 1 if any(len(s.label) > LONG_LABEL for s in m.shown) else 2
    columns = 1 if at_side else (3 if width > 5.0 else narrow)
    across = width - (2.7 if at_side else 0.65)
    tasks = sorted({"SLAM" if r.task == "slam" else r.task for r in runs})
    titles = [f"{m.log.name}: {' and '.join(tasks)}" if tasks else m.log.name]
    titles += [f"not shown in full: {', '.join(m.view.leaving)}"] if m.view.leaving else []
    title = "\n".join(fill(line, round(15.0 * across)) for line in titles)
    ax.set_title(title, loc="left")
    lines = sum(str(handle.get_label()).count("\n") + 1 for handle in handles)
    legend_rows = 0 if at_side else -(-lines // columns)
    scene = float(np.clip(across * float(h / w), 1.5, 6.5))
    fig.set_size_inches(width, scene + 0.6 + 0.14 * title.count("\n") + 0.155 * legend_rows)
    fig.legend(handles=handles, loc="outside right upper" if at_side else "outside lower left", ncols=columns)
    house.settle(fig)


def _walls(ax: Axes, ids: IntArray, walls: Array, view: plane.View, colour: str, name: str, most: int) -> list[Line2D]:
    """Walls (n, 2) of rho, alpha, numbered in the middle if they are few; what the legend shows of them."""
    rows, ends = plane.draw_walls(ax, walls, colour)
    if 0 < len(ids) <= most:
        _landmark_ids(ax, ids[rows], ends.mean(axis=1), view)
    return [house.key(name, color=colour, linewidth=0.7)] if name and len(rows) else []


def _landmark_ids(ax: Axes, number: IntArray, xy: Array, view: plane.View) -> None:
    inside = np.all((xy >= view.low) & (xy <= view.high), axis=1)
    small: dict[str, Any] = {"textcoords": "offset points", "fontsize": house.points(6), "color": "#404040"}
    halo = [withStroke(linewidth=1.5, foreground="white")]
    for n, (x, y) in zip(number[inside].tolist(), xy[inside].tolist(), strict=True):
        ax.annotate(str(n), (x, y), xytext=(3.0, 3.0), path_effects=halo, zorder=5.5, **small)


def _ellipse_handles(m: _Map) -> list[Line2D | Patch]:
    others = [s for s in m.shown if s.run.estimator != "dead-reckoning" and s.run.flaw is None]
    of_maps = bool(m.maps) and m.points
    larger = "" if m.factor == 1 else f", drawn {m.factor} times larger"
    names = " and ".join(dict.fromkeys(s.run.estimator for s in m.estimates))
    which = f"\n(of {names})" if len(m.estimates) < len(others) else ""
    found: list[Line2D | Patch] = []
    if of_maps:
        found.append(house.key("estimated landmarks", color=GREY, marker="o", markersize=2.5, linestyle="none"))
    if of_maps or any(len(mean) for _, mean, _ in m.poses):
        found.append(Patch(facecolor="#D8D8D8", edgecolor=GREY, linewidth=0.6, label=f"3σ ellipses{larger}{which}"))
    return found


SEEN_COLOUR = "#56B4E9"
CLUTTER_COLOUR = "#D55E00"


def log_figure(log: Log) -> Figure:
    """The map of a log without runs; observations are placed from true poses, or else dead reckoning."""
    return map_figure(log, (), surveyed=lambda ax: _observed(ax, log))


def _observed(ax: Axes, log: Log) -> list[Line2D]:
    inputs, truth, handles = log.recorded, log.truth, list[Line2D]()
    pose, origin = dead_reckoned(inputs.prior.mean, inputs.increments.mean), "dead reckoning"
    if truth.pose is not None and truth.known_poses:
        pose, origin = truth.pose, "the true path"
    frame = inputs.observations.frame
    placed = np.flatnonzero(np.isfinite(pose[frame]).all(axis=1))
    if len(placed):
        xy, label = plane.feet(log, pose)[placed], log.granted
        clutter = np.zeros(len(placed), bool) if label is None else label[placed] == CLUTTER
        name = f"{len(placed)} of {counted(len(frame), 'observation')},\nfrom {origin}"
        dots = dict[str, Any](marker=".", linestyle="none", markersize=3.0, markeredgewidth=0.0, rasterized=True)
        handles += ax.plot(*xy[~clutter].T, color=SEEN_COLOUR, alpha=0.6, label=name, zorder=2, **dots)
        if clutter.any():
            name = f"{clutter.sum()} of them clutter"
            handles += ax.plot(*xy[clutter].T, color=CLUTTER_COLOUR, label=name, zorder=2, **dots)
    landmarks = inputs.map if inputs.map is not None else truth.landmarks
    if landmarks is not None and len(landmarks.id):
        name = counted(len(landmarks.id), "landmark")
        points, walls = inputs.sensor.split(landmarks.xy)
        if len(points):
            handles += ax.plot(*points.T, "k+", markersize=5.0, markeredgewidth=0.7, label=name, zorder=5)
        elif len(walls):
            handles.append(house.key(name, color="black", linewidth=0.7))
        plane.draw_walls(ax, walls, "black", zorder=1)
    return handles


@kinds.figure("map", lambda trial, _: True, kinds.FRONT, quick=True)
def _map(trial: Trial, _: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    drawn, astray = kinds.for_map(trial), kinds.worst(trial)
    shown = astray is not None and len(drawn) < len(trial.runs) and any(kinds.same(r, astray) for r in drawn)
    facts = {"runs": drawn, "astray": astray if shown else None, "aligned": kinds.aligned_statement(trial)}
    return map_figure(trial.log, drawn), {**facts, "others": kinds.left_out(trial, drawn)}
