"""The map figure: true, dead-reckoned and estimated paths, landmarks, and 3 sigma ellipses, seen from above."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from data.inputs import IntArray, LandmarkMap
from data.log import Log
from data.result import Run
from data.se2 import Array, dead_reckoned
from eval.figures.style import DOTTED, DOUBLE, STYLES, TRUTH_COLOUR, Series, drawing, series, settle

SIGMAS = 3.0
"""Size of every ellipse; in the plane a 3 sigma ellipse holds 1 - exp(-9/2) = 98.89 % of a Gaussian."""
ELLIPSES_ALONG_PATH = 11
"""A number that shares no factor with a few laps, so that the ellipses of two laps do not fall on each other."""
MOST_IDS = 30
MARGIN = 0.05
"""Free space around the picture, as a share of its larger side."""
STRETCH = 0.25
"""A path that goes further beyond truth and landmarks than this share of their larger side is cut."""
LONG_LABEL = 24
Surveyed = Callable[[Axes], Sequence[Line2D]]
"""Draws what was surveyed on a map, and returns what the legend shows of it."""
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


def ellipses(mean: Array, covariance: Array, sigmas: float = SIGMAS, count: int = 48) -> Array:
    """Outlines (K, count, 2) of the ellipses (p - mean)' P^-1 (p - mean) = sigmas^2 for mean (K, 2), P (K, 2, 2).

    Negative eigenvalues (rounding) count as zero.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    axes = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    outline: Array = mean[:, None, :] + sigmas * circle @ np.swapaxes(axes, -1, -2)
    return outline


@dataclass(frozen=True)
class View:
    """The rectangle shown, m; `leaving` names what goes beyond it."""

    low: Array
    high: Array
    leaving: tuple[str, ...] = ()

    @property
    def size(self) -> Array:
        """(width, height) m."""
        return self.high - self.low


def _box(points: Array) -> tuple[Array, Array] | None:
    finite = points[np.isfinite(points).all(axis=1)]
    return (finite.min(axis=0), finite.max(axis=0)) if len(finite) else None


def _credible(shown: Sequence[Series]) -> Series | None:
    """The series that stands in for a missing truth: batch, or else the middle one by extent of those that finished."""
    good = [s for s in shown if s.run.failure is None and s.run.estimator != "dead-reckoning"]
    good.sort(key=lambda s: float(np.ptp(s.trajectory.pose[:, :2], axis=0).max()))
    batch = [s for s in good if s.run.estimator == "batch"]
    return next(iter([*batch, *good[(len(good) - 1) // 2 :], *shown]), None)


def _anchor(log: Log, shown: Sequence[Series]) -> Array:
    """Points that must be in the picture: true path and landmarks, or their estimate where the truth is missing."""
    points = [np.atleast_2d(log.recorded.prior.mean[:2])]
    known, truth, stand_in = true_landmarks(log), log.truth.pose, _credible(shown)
    if truth is not None:
        points.append(truth[:, :2])
    if stand_in is not None and log.truth.known_poses < 0.5 * len(log.recorded):
        points.append(stand_in.trajectory.pose[:, :2])
    path = _box(np.concatenate(points))
    if known is not None:
        points.append(known.xy)
    elif stand_in is not None and stand_in.run.map is not None and path is not None:
        # landmarks further from the path than it is long are mistakes, not the scene
        xy, reach = stand_in.run.map.xy, max(float((path[1] - path[0]).max()), 1.0)
        points.append(xy[np.all((xy > path[0] - reach) & (xy < path[1] + reach), axis=1)])
    return np.concatenate(points)


def view_of(log: Log, shown: Sequence[Series], paths: Mapping[str, Array], maps: Mapping[str, Array]) -> View:
    """What to show: truth and landmarks whole, and by label paths (n, 2) and ellipses (K, c, 2) that do not squash it.

    A path that goes too far is left out of the reckoning as a whole, of a map only the landmarks that do.
    """
    box = _box(_anchor(log, shown))
    low, high = box if box is not None else (np.zeros(2), np.ones(2))
    side = max(float((high - low).max()), 1.0)
    floor, ceiling = low - STRETCH * side, high + STRETCH * side
    leaving = []
    pieces = [(label, path) for label, path in paths.items()]
    pieces += [(label, outline) for label, outlines in maps.items() for outline in outlines]
    for label, piece in pieces:
        reach = _box(piece)
        if reach is None:
            continue
        if np.all(reach[0] >= floor) and np.all(reach[1] <= ceiling):
            low, high = np.minimum(low, reach[0]), np.maximum(high, reach[1])
        elif label not in leaving:
            leaving.append(label)
    margin = MARGIN * max(float((high - low).max()), 1.0)
    return View(low - margin, high + margin, tuple(leaving))


def true_landmarks(log: Log) -> LandmarkMap | None:
    """The true landmarks, or else the map that localization is given."""
    return log.truth.landmarks if log.truth.landmarks is not None else log.recorded.map


def enlargement(view: View, semi_axes: Array, share: float = 0.012) -> int:
    """Smallest factor that makes the middle one of the ellipses' semi-axes [m] this share of the picture's side."""
    if len(semi_axes) == 0 or not np.median(semi_axes) > 0.0:
        return 1
    wanted = share * float(view.size.max())
    middle = float(np.median(semi_axes))
    if middle >= 0.5 * wanted:
        return 1
    return next((f for f in FACTORS if f * middle >= wanted), FACTORS[-1])


def longest_axis(covariance: Array) -> Array:
    """3 sigma semi-major axis [m] of covariances (K, 2, 2)."""
    largest = np.linalg.eigvalsh(covariance)[:, -1] if len(covariance) else np.empty(0)
    return np.asarray(SIGMAS * np.sqrt(np.maximum(largest, 0.0)))


def along_path(s: Series) -> tuple[Array, Array]:
    """Position (K, 2) and its covariance (K, 2, 2) at about ten places along the path."""
    t = s.trajectory
    usable = np.flatnonzero(np.isfinite(t.pose).all(axis=1) & np.isfinite(t.covariance).all(axis=(1, 2)))
    if len(usable) == 0:
        return np.empty((0, 2)), np.empty((0, 2, 2))
    steps = np.linspace(0, len(usable) - 1, ELLIPSES_ALONG_PATH + 1)[1:]
    places = usable[np.unique(np.round(steps).astype(int))]
    return t.pose[places, :2], t.covariance[places, :2, :2]


def _with_ellipses(shown: Sequence[Series]) -> list[Series]:
    """All estimators that got to the end while they are few; otherwise the first filter and the first smoother."""
    estimates = [s for s in shown if s.run.estimator != "dead-reckoning" and s.run.failure is None]
    if len(estimates) <= 3:
        return estimates
    ranked = sorted(estimates, key=lambda s: s.run.estimator not in ("ekf", "batch"))
    firsts = {s.phase: s for s in reversed(ranked)}
    return [firsts[p] for p in ("online", "final") if p in firsts]


def _draw_ellipses(ax: Axes, mean: Array, covariance: Array, colour: str, factor: float, order: float) -> None:
    if len(mean) == 0:
        return
    outline = ellipses(mean, covariance, SIGMAS * factor)
    ax.add_collection(PolyCollection(list(outline), facecolor=colour, edgecolor="none", alpha=0.16, zorder=order))
    ax.add_collection(PolyCollection(list(outline), facecolor="none", edgecolor=colour, linewidth=0.6, zorder=order))


def _landmark_ids(ax: Axes, number: IntArray, xy: Array, view: View) -> None:
    inside = np.all((xy >= view.low) & (xy <= view.high), axis=1)
    halo = [withStroke(linewidth=1.5, foreground="white")]
    for n, (x, y) in zip(number[inside].tolist(), xy[inside].tolist(), strict=True):
        ax.annotate(
            str(n), (x, y), xytext=(3.0, 3.0), textcoords="offset points", fontsize=6, color="#404040",
            path_effects=halo, zorder=5.5,
        )  # fmt: skip


def _label(s: Series) -> str:
    failure = s.run.failure
    return s.label if failure is None else f"{s.label}:\n{failure.status} at frame {failure.frame}"


def map_figure(log: Log, runs: Sequence[Run], *, width: float = DOUBLE, surveyed: Surveyed | None = None) -> Figure:
    """Paths, landmarks and 3 sigma ellipses of every run on one log; metres, equal aspect, `width` in inches.

    Ellipses too small to see are enlarged, all by one factor that the legend states. A path that runs away does not
    squash the picture: it is cut, and the title names it. `surveyed` draws in place of the true landmarks.
    """
    with drawing():
        return _map_figure(log, runs, width, surveyed)


def _map_figure(log: Log, runs: Sequence[Run], width: float, surveyed: Surveyed | None) -> Figure:
    shown = series(runs)
    paths = {s.label: s.trajectory.pose[:, :2] for s in shown}
    if not any(r.estimator == "dead-reckoning" for r in runs):
        reckoned = dead_reckoned(log.recorded.prior.mean, log.recorded.increments.mean)
        paths = {STYLES["dead-reckoning"].label: reckoned[:, :2], **paths}
    estimates = _with_ellipses(shown)
    maps = [(s, s.run.map) for s in estimates if s.run.map is not None and len(s.run.map)]
    outlines = {f"map of {s.label}": ellipses(m.xy, m.covariance) for s, m in maps}
    view = view_of(log, shown, paths, outlines)
    poses = [(s, *along_path(s)) for s in estimates]
    sizes = [longest_axis(P) for _, _, P in poses] + [longest_axis(m.covariance) for _, m in maps]
    factor = enlargement(view, np.concatenate(sizes) if sizes else np.empty(0))

    fig = Figure()
    ax = fig.add_subplot()
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
    if surveyed is not None:
        handles += surveyed(ax)
    elif known is not None and len(known.id):
        name = "true landmarks" if log.truth.landmarks is not None else "landmarks (given map)"
        handles += ax.plot(*known.xy.T, "k+", markersize=6.0, markeredgewidth=1.0, label=name, zorder=4)
        if len(known.id) <= MOST_IDS:
            _landmark_ids(ax, known.id, known.xy, view)
    for s, m in maps:
        ax.plot(*m.xy.T, "o", color=s.colour, markersize=2.0, zorder=4)
        _draw_ellipses(ax, m.xy, m.covariance, s.colour, factor, 3.5)
        if known is None and len(m) <= MOST_IDS and s is maps[0][0]:
            _landmark_ids(ax, m.number, m.xy, view)
    for s, mean, covariance in poses:
        _draw_ellipses(ax, mean, covariance, s.colour, factor, 5.0)
    others = [s for s in shown if s.run.estimator != "dead-reckoning" and s.run.failure is None]
    handles += _ellipse_handles(bool(maps), any(len(m) for _, m, _ in poses), factor, len(estimates) < len(others))

    start = log.recorded.prior.mean
    marker = (3, 0, float(np.degrees(start[2])) - 90.0)
    handles += ax.plot(
        start[0], start[1], marker=marker, markersize=8, color="white", markeredgecolor="black", linestyle="none",
        label="start", zorder=6,
    )  # fmt: skip

    ax.set(xlim=(view.low[0], view.high[0]), ylim=(view.low[1], view.high[1]), xlabel="x [m]", ylabel="y [m]")
    ax.set_aspect("equal")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10]))

    # the page is cut to the scene, so that equal aspect leaves no blank paper
    w, h = view.size
    beside = width > 5.0 and w / h < 1.7
    # labels that name the association as well are too long for two columns of a narrow picture
    narrow = 1 if any(len(s.label) > LONG_LABEL for s in shown) else 2
    columns = 1 if beside else (3 if width > 5.0 else narrow)
    across = width - (2.7 if beside else 0.65)
    scene = across * float(h / w)
    title = _title(log, runs, view, round(15.0 * across))
    ax.set_title(title, loc="left")
    lines = sum(str(handle.get_label()).count("\n") + 1 for handle in handles)
    legend_rows = 0 if beside else -(-lines // columns)
    fig.set_size_inches(width, float(np.clip(scene, 1.5, 6.5)) + 0.6 + 0.14 * title.count("\n") + 0.155 * legend_rows)
    fig.legend(handles=handles, loc="outside right upper" if beside else "outside lower left", ncols=columns)
    settle(fig)
    return fig


def _ellipse_handles(maps: bool, poses: bool, factor: int, only_some: bool) -> list[Line2D | Patch]:
    larger = "" if factor == 1 else f", drawn {factor} times larger"
    which = "\n(first filter and smoother)" if only_some else ""
    grey = "#606060"
    found: list[Line2D | Patch] = []
    if maps:
        dot = Line2D([], [], color=grey, marker="o", markersize=2.5, linestyle="none", label="estimated landmarks")
        found.append(dot)
    if maps or poses:
        found.append(Patch(facecolor="#D8D8D8", edgecolor=grey, linewidth=0.6, label=f"3σ ellipses{larger}{which}"))
    return found


def _title(log: Log, runs: Sequence[Run], view: View, characters: int) -> str:
    tasks = sorted({"SLAM" if r.task == "slam" else r.task for r in runs})
    title = f"{log.name}: {' and '.join(tasks)}" if tasks else log.name
    if view.leaving:
        title += f"\nnot shown in full: {', '.join(view.leaving)}"
    return "\n".join(fill(line, characters) for line in title.split("\n"))
