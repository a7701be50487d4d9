"""The plane seen from above: what part of it a map shows, walls and start in it, and ellipses of covariances."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import AbstractPathEffect
from matplotlib.ticker import MaxNLocator

from data.inputs import IntArray, LandmarkMap
from data.log import Log
from data.se2 import Array, transform_points
from eval.figures.style import Series

MARGIN = 0.05  # free space around the picture, as a share of its larger side
STRETCH = 0.25  # a path that goes further beyond truth and landmarks than this share of their larger side is cut
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)  # by which ellipses may be enlarged


@dataclass(frozen=True)
class View:
    """The rectangle shown, m; `leaving` names paths and maps that leave it."""

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


def _anchor(log: Log, shown: Sequence[Series]) -> Array:
    """Points that must be in the picture: true path and landmarks, or their estimate where the truth is missing."""
    points = [np.atleast_2d(log.recorded.prior.mean[:2])]
    known, truth = true_landmarks(log), log.truth.pose
    # in place of a missing truth: batch, or else the middle one by extent of those that finished
    good = [s for s in shown if s.run.flaw is None and s.run.estimator != "dead-reckoning"]
    good.sort(key=lambda s: float(np.ptp(s.trajectory.pose[:, :2], axis=0).max()))
    of_batch = [s for s in good if s.run.estimator == "batch"]
    stand_in = next(iter([*of_batch, *good[(len(good) - 1) // 2 :], *shown]), None)
    if truth is not None:
        points.append(truth[:, :2])
    if stand_in is not None and log.truth.known_poses < 0.5 * len(log.recorded):
        points.append(stand_in.trajectory.pose[:, :2])
    path = _box(np.concatenate(points))
    if not log.recorded.sensor.sees_points:
        seen_from = truth if truth is not None else None if stand_in is None else stand_in.trajectory.pose
        points.append(np.empty((0, 2)) if seen_from is None else feet(log, seen_from))
    elif known is not None:
        points.append(known.xy)
    elif stand_in is not None and stand_in.run.map is not None and path is not None:
        # landmarks further from the path than it is long are mistakes, not the scene
        xy, reach = stand_in.run.map.xy, max(float((path[1] - path[0]).max()), 1.0)
        points.append(xy[np.all((xy > path[0] - reach) & (xy < path[1] + reach), axis=1)])
    return np.concatenate(points)


def feet(log: Log, path: Array) -> Array:
    """Points observed, or where walls are nearest to the sensor (M, 2), seen from a path (N, 3)."""
    o = log.recorded.observations
    return transform_points(path[o.frame], log.recorded.sensor_of().body_points(o.z, o.R)[0]).reshape(-1, 2)


def chords(walls: Array, low: Array, high: Array) -> tuple[IntArray, Array]:
    """Rows (k,) of the walls (n, 2) of rho, alpha that cross a rectangle, and their ends in it (k, 2, 2) [m]."""
    rows, ends = list[int](), list[Array]()
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    for i, (rho, alpha) in enumerate(walls.tolist()):
        normal = np.array([np.cos(alpha), np.sin(alpha)])
        along, foot = np.array([-normal[1], normal[0]]), (rho - normal @ middle) * normal
        slope = np.where(np.abs(along) < 1e-12, 1e-12, along)
        t = np.sort(np.stack([(-half - foot) / slope, (half - foot) / slope]), axis=0)
        begin, end = float(t[0].max()), float(t[1].min())
        if begin < end:
            rows.append(i)
            ends.append(middle + foot + np.array([[begin], [end]]) * along)
    return np.array(rows, np.int64), np.array(ends).reshape(-1, 2, 2)


def draw_walls(ax: Axes, walls: Array, colour: str, *, label: str = "", zorder: float = 2.5) -> tuple[IntArray, Array]:
    """Walls (n, 2) of rho, alpha as straight lines across the picture as it is; gives what `chords` does."""
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    rows, ends = chords(walls, np.array([left, bottom]), np.array([right, top]))
    for i, chord in enumerate(ends):
        text = "" if i else label
        ax.plot(*chord.T, color=colour, linewidth=0.7, label=text, zorder=zorder, scalex=False, scaley=False)
    return rows, ends


def plan_axes(ax: Axes, low: Array, high: Array) -> None:
    """Axes of a map in metres, from corner to corner, one scale for both."""
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10]))


def draw_start(ax: Axes, pose: Array, colour: str = "white", halo: Sequence[AbstractPathEffect] = ()) -> list[Line2D]:
    """An arrowhead at a pose (3,), along the robot's heading; what the legend shows of it."""
    arrow: dict[str, Any] = {"marker": (3, 0, float(np.degrees(pose[2])) - 90.0), "markersize": 8.0, "color": colour}
    arrow |= {"markeredgecolor": "black", "linestyle": "none", "path_effects": list(halo)}
    return ax.plot(*pose[:2], label="start", zorder=6, **arrow)


def view_of(log: Log, shown: Sequence[Series], paths: Mapping[str, Array], maps: Mapping[str, Array]) -> View:
    """Truth and landmarks whole, and by label the paths (n, 2) and ellipses (K, c, 2) that do not squash them."""
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
    return 1 if middle >= 0.5 * wanted else next((f for f in FACTORS if f * middle >= wanted), FACTORS[-1])


SIGMAS = 3.0  # size of every ellipse; in the plane a 3 sigma ellipse holds 1 - exp(-9/2) = 98.89 % of a Gaussian
ELLIPSES_ALONG_PATH = 11
"""A number that shares no factor with a few laps, so that the ellipses of two laps do not fall on each other."""


def ellipses(mean: Array, covariance: Array, sigmas: float = SIGMAS, count: int = 48) -> Array:
    """Outlines (K, count, 2) of (p - mean)' P^-1 (p - mean) = sigmas^2; negative eigenvalues count as zero."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
    axes = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.asarray(mean[:, None, :] + sigmas * circle @ np.swapaxes(axes, -1, -2))


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
    places = usable[np.unique(np.rint(np.linspace(0, len(usable) - 1, ELLIPSES_ALONG_PATH + 1)[1:]).astype(int))]
    return t.pose[places, :2], t.covariance[places, :2, :2]


def draw_ellipses(ax: Axes, mean: Array, covariance: Array, colour: str, factor: float, order: float) -> None:
    """Ellipses of points (K, 2) with covariances (K, 2, 2), `factor` times as large, filled faintly. Those that would
    cover half of the axes, whose limits are set before, are outlines alone.
    """
    if len(mean) == 0:
        return
    outline = ellipses(mean, covariance, SIGMAS * factor)
    side = max(abs(np.diff(ax.get_xlim())[0]), abs(np.diff(ax.get_ylim())[0]))
    filled = outline[4.0 * factor * longest_axis(covariance) < side]
    ax.add_collection(PolyCollection(list(filled), facecolor=colour, edgecolor="none", alpha=0.16, zorder=order))
    ax.add_collection(PolyCollection(list(outline), facecolor="none", edgecolor=colour, linewidth=0.6, zorder=order))
