"""Figures of one step: ground truth, map and observations, as in the university lab; and an image writer.

Each function paints on a given figure, so that a window can be repainted and a file painted once.
"""

import io
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from association.expectation import gate_threshold
from data.errors import UsageError
from data.inputs import CLUTTER, IntArray, LandmarkMap
from data.log import Log
from data.result import MapState, PoseEstimate
from data.se2 import Array, BoolArray, transform_points
from data.sensors import RangeBearing, Sensor
from data.terminal import counted
from data.whole import whole_file
from eval.figures.plane import draw_walls, ellipses, true_landmarks
from eval.figures.style import TRUTH_COLOUR, drawing, style_of
from wings.labs.stepping.problem import Matching

ONE, MANY = (7.0, 5.6), (10.5, 6.8)  # in; size of a figure with one picture, and with one per method
GOOD, BAD, DULL, FAINT = "#0064A8", "#D55E00", "#606060", "#B0B0B0"
LANDMARK = "#6A3D9A"  # landmark numbers; those of observations are black, of wrong ones like their marks
TITLES = {name: name.upper() for name in ("nn", "singles", "ml", "jcbb", "gnn")} | {
    "truth": "ground truth",
    "jcbb-first": "JCBB",
    "jcbb-hindsight": "hindsight",
    "known": "by labels",
}
"""The lab's JCBB is `jcbb-first`; next to `jcbb` the titles are the plain names."""
SHOWN_WITHOUT_GATE = 0.99  # gate of drawn pairs, if there is none
DASHES = (0, (3.0, 1.5))
HALO = [withStroke(linewidth=1.5, foreground="white")]


def outlines(ax: Axes, xy: Array, covariance: Array, colour: str, order: float = 2.0, fill: float = 0.15) -> None:
    """Ellipses of points (m, 2) with covariances (m, 2, 2), filled faintly."""
    if len(xy):
        outline = list(ellipses(xy, covariance))
        ax.add_collection(
            PolyCollection(outline, facecolor=colour, edgecolor="none", alpha=fill, zorder=order), autolim=False
        )
        ax.add_collection(
            PolyCollection(outline, facecolor="none", edgecolor=colour, linewidth=0.6, zorder=order), autolim=False
        )


def mark_robot(ax: Axes, pose: Array, colour: str, label: str) -> None:
    """The robot as a triangle in its heading."""
    marker = (3, 0, float(np.degrees(pose[2])) - 90.0)
    edge: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.5, "linestyle": "none"}
    ax.plot(pose[0], pose[1], marker=marker, markersize=9, color=colour, label=label, zorder=6.0, **edge)


def fit(ax: Axes, points: Array, margin: float = 0.06) -> None:
    """Show points (n, 2) with equal aspect and fill the place of the axes."""
    finite = points[np.isfinite(points).all(axis=1)]
    low, high = finite.min(axis=0), finite.max(axis=0)
    place = ax.get_position(original=True)
    inches = np.asarray(ax.figure.transSubfigure.transform((1.0, 1.0))) / ax.figure.dpi * [place.width, place.height]
    scale = float(((high - low) / inches).max())
    half = 0.5 * max((1.0 + 2.0 * margin) * scale, 1.0 / float(inches.min())) * inches
    middle = 0.5 * (low + high)
    ax.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
    ax.set_aspect("equal")


def write_numbers(
    ax: Axes,
    xy: Array,
    numbers: IntArray,
    colour: str,
    size: float,
    offset: tuple[float, float] = (3.0, 2.5),
    *,
    first: int = 0,
) -> None:
    """Numbers (n,) at points, `offset` pt from them; `first`: what 0 is called."""
    across, up = "left" if offset[0] >= 0 else "right", "baseline" if offset[1] >= 0 else "top"
    look: dict[str, Any] = {"fontsize": size, "color": colour, "ha": across, "va": up, "path_effects": HALO}
    place: dict[str, Any] = {"xytext": offset, "textcoords": "offset points", "annotation_clip": True}
    for (x, y), number in zip(xy.tolist(), numbers.tolist(), strict=True):
        ax.annotate(str(number + first), (x, y), zorder=8, **place, **look)


def robot_axes(ax: Axes, left: bool = True, bottom: bool = True) -> None:
    """Labels of the axes of the robot frame."""
    ax.set(xlabel="x forward [m]" if bottom else "", ylabel="y left [m]" if left else "")


def called(name: str, others: Sequence[str] = ()) -> str:
    """The title of a method's panel; its name where another panel has the same title."""
    title = TITLES.get(name, name)
    same = [n for n in (*others, name) if TITLES.get(n, n) == title]
    return name if len(set(same)) > 1 else title


@dataclass(frozen=True, eq=False)
class Plane:
    """A problem laid out in the robot frame; `compatible` pairs (m, n) pass the gate, `near` ones are drawn in grey."""

    xy: Array
    P: Array
    landmarks: Array
    Pl: Array
    compatible: BoolArray
    near: BoolArray
    shown: Array
    number: IntArray  # (n,) of the landmarks
    named: BoolArray  # (n,) those whose number is written
    column: dict[int, int]  # of a number, its place among them
    first: int  # what landmark and observation 0 are called


def plane_of(m: Matching) -> Plane:
    """Places, compatible pairs, and the part of the plane that is shown."""
    e = m.expectation
    xy, P = m.sensor.body_points(e.z, e.R)
    landmarks, Pl = m.sensor.body_points(e.z_hat, e.HPHt)
    d2 = e.individual_distances()
    compatible: BoolArray = d2 < e.threshold(m.gate)
    near: BoolArray = d2 < gate_threshold(SHOWN_WITHOUT_GATE if m.gate is None else m.gate)
    involved = near.any(axis=0) if m.right is None else near.any(axis=0) | np.isin(e.number, m.right)
    # far landmarks would make everything else small
    scene = np.concatenate([xy, np.zeros((1, 2))])
    low, high = scene.min(axis=0), scene.max(axis=0)
    reach = max(float((high - low).max()), 1.0)
    involved &= np.all((landmarks > low - reach) & (landmarks < high + reach), axis=1)
    shown = np.concatenate([scene, landmarks[involved]])
    column = {int(n): j for j, n in enumerate(e.number)}
    return Plane(xy, P, landmarks, Pl, compatible, near, shown, e.number, involved, column, m.first)


def make_panels(fig: Figure, names: Sequence[str]) -> tuple[list[Axes], tuple[float, float] | None]:
    """One panel per name, at most six, and the place for a legend, if any."""
    fig.set_layout_engine("none")
    fig.set_size_inches(*MANY)
    full = len(names) == 6
    bottom, high = (0.14, 0.335) if full else (0.065, 0.375)
    corners = [(0.055 + 0.318 * column, bottom + row * (high + 0.085)) for row in (1, 0) for column in range(3)]
    axes = [fig.add_axes((x, y, 0.28, high)) for (x, y), _ in zip(corners, names, strict=False)]
    return axes, None if full else corners[len(names)]


def legend(fig: Figure, place: tuple[float, float] | None, handles: Sequence[Line2D | Patch]) -> None:
    """The legend in a free panel, or else below all."""
    if place is not None:
        fig.legend(handles=handles, loc="lower left", bbox_to_anchor=place, fontsize=8.0, labelspacing=0.8)
    else:
        fig.legend(handles=handles, loc="lower center", ncols=4)


def background(ax: Axes, p: Plane, size: float = 4.5) -> None:
    """Expected landmarks (marks of a `size` [pt]) and observations with their ellipses, compatible pairs in grey."""
    outlines(ax, p.landmarks, p.Pl, DULL, 1.5, 0.08)
    ax.plot(*p.landmarks.T, "+", color=DULL, markersize=size, markeredgewidth=0.15 * size, zorder=3)
    outlines(ax, p.xy, p.P, GOOD, 2.0, 0.08)
    lines(ax, p, [(int(i), int(j)) for i, j in np.argwhere(p.near)], color=FAINT, linewidth=0.8, zorder=2.5)


def lines(ax: Axes, p: Plane, pairs: Sequence[tuple[int, int]], **look: Any) -> None:
    """Lines from observations to landmarks, pairs of (observation, row of the landmark)."""
    if pairs:
        ax.add_collection(
            LineCollection([np.stack([p.xy[i], p.landmarks[j]]) for i, j in pairs], **look), autolim=False
        )


def name_landmarks(ax: Axes, p: Plane) -> None:
    """Numbers of possible landmarks, below left of them; observations have theirs above."""
    low, high = np.array(ax.get_xlim()), np.array(ax.get_ylim())
    x, y = p.landmarks.T
    inside = p.named & (x >= low[0]) & (x <= low[1]) & (y >= high[0]) & (y <= high[1])
    write_numbers(ax, p.landmarks[inside], p.number[inside], LANDMARK, 5.0, (-2.5, -2.5), first=p.first)


def field_of_view(sensor: Sensor) -> Array | None:
    """Outline (c, 2) m of the field of view, in the body frame; None if its range is infinite."""
    if not np.isfinite(sensor.max_range):
        return None
    angle = np.linspace(sensor.min_angle, sensor.max_angle, 73)
    arc = np.stack([np.full(len(angle), sensor.max_range), angle], axis=-1)
    polar = RangeBearing(rotation=sensor.rotation, translation=sensor.translation)
    outline = polar.inverse(np.zeros(3), arc)[0]
    if sensor.max_angle - sensor.min_angle < 2.0 * np.pi - 1e-9:
        apex = polar.inverse(np.zeros(3), np.zeros((1, 2)))[0]
        outline = np.concatenate([apex, outline, apex])
    return outline


def picture_axes(fig: Figure) -> Axes:
    """The axes of a figure with one picture, at a fixed place."""
    fig.set_layout_engine("none")
    fig.set_size_inches(*ONE)
    return fig.add_axes((0.09, 0.145, 0.89, 0.8))


def _scene(log: Log) -> Array:
    """Points always shown, so that pictures do not move from step to step."""
    known, truth = true_landmarks(log), log.truth.pose
    points = [np.atleast_2d(log.recorded.prior.mean[:2])]
    if known is not None:
        points.append(log.recorded.sensor.split(known.xy)[0])
    if truth is not None:
        points.append(truth[:, :2])
    if not log.recorded.sensor.sees_points:
        reach, path = float(log.recorded.observations.z[:, 0].max(initial=0.0)), points[-1]
        points += [path - reach, path + reach]
    return np.concatenate(points)


def _legend_below(fig: Figure, ax: Axes, columns: int = 4) -> None:
    fig.legend(*ax.get_legend_handles_labels(), loc="lower left", ncols=columns)


def paint_ground_truth(fig: Figure, log: Log, frame: int, title: str) -> None:
    """The world: true landmarks, path so far and pose, field of view and observed landmarks."""
    ax = picture_axes(fig)
    known, truth, inputs = true_landmarks(log), log.truth.pose, log.recorded
    rows = slice(int(inputs.start[frame]), int(inputs.start[frame + 1]))
    shown: list[Array] = [_scene(log)]
    points, walls = inputs.sensor.split(np.empty((0, 2)) if known is None else known.xy)
    if len(points):
        ax.plot(*points.T, "k+", markersize=5.0, markeredgewidth=0.8, label="true landmarks", zorder=4)
    if truth is not None and np.isfinite(truth[frame]).all():
        ax.plot(*truth[: frame + 1, :2].T, color=TRUTH_COLOUR, linewidth=1.0, label="true path", zorder=3)
        outline = field_of_view(inputs.sensor)
        if outline is not None:
            view = transform_points(truth[frame], outline)
            shown.append(view)
            ax.fill(*view.T, facecolor=GOOD, alpha=0.07, edgecolor=GOOD, linewidth=0.5, label="sensor's view", zorder=1)
        _seen(ax, log, rows, truth[frame], known)
        mark_robot(ax, truth[frame], TRUTH_COLOUR, "true pose")
    else:
        title += "\n(no true pose here)"
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_title(f"{title}: ground truth", loc="left")
    fit(ax, np.concatenate(shown))
    draw_walls(ax, walls, "black", label="true landmarks", zorder=1)
    _legend_below(fig, ax)


def _seen(ax: Axes, log: Log, rows: slice, pose: Array, known: LandmarkMap | None) -> None:
    if log.truth.landmark_of is None:
        return
    sensor = log.recorded.sensor
    who = log.truth.landmark_of[rows]
    ring: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "none", "markersize": 7.0, "zorder": 5}
    if not sensor.sees_points:
        feet = sensor.body_points(log.recorded.observations.z[rows], log.recorded.observations.R[rows])[0]
        ax.plot(*transform_points(pose, feet).T, "o", markeredgecolor=GOOD, label=f"{len(feet)} observed", **ring)
        return
    if known is not None:
        seen = known.xy[np.isin(known.id, who)]
        ax.plot(*seen.T, "o", markeredgecolor=GOOD, label=f"{len(seen)} observed", **ring)
    stray = log.recorded.observations.z[rows][who == CLUTTER]
    if len(stray):
        xy = sensor.inverse(pose, stray)[0]
        ax.plot(*xy.T, "s", markeredgecolor=BAD, label=f"{len(stray)} of no landmark", **ring)


def paint_map(
    fig: Figure,
    log: Log,
    frame: int,
    estimator: str,
    path: Array,
    now: PoseEstimate,
    landmarks: MapState,
    title: str,
    first: int = 0,
) -> None:
    """The estimate: path so far (k, 2), robot and landmarks numbered from `first`, each with its 3 sigma ellipse."""
    ax = picture_axes(fig)
    style, known, truth = style_of(estimator), true_landmarks(log), log.truth.pose
    points = log.recorded.sensor.sees_points
    if known is not None and points:
        name = "true landmarks" if np.any(landmarks.covariance) or log.truth.landmarks is not None else "given map"
        ax.plot(*known.xy.T, "+", color=FAINT, markersize=5.0, label=name, zorder=1)
    if truth is not None:
        ax.plot(*truth[: frame + 1, :2].T, color=FAINT, linewidth=1.6, label="true path", zorder=1)
    ax.plot(*path.T, color=style.colour, linewidth=1.0, label="estimated path", zorder=3)
    if np.any(landmarks.covariance) and points:
        outlines(ax, landmarks.xy, landmarks.covariance, style.colour)
        label = f"{counted(len(landmarks.xy), 'landmark')}, numbered"
        ax.plot(*landmarks.xy.T, ".", color=style.colour, markersize=3.0, label=label)
        write_numbers(ax, landmarks.xy, landmarks.number, LANDMARK, 4.5, (1.5, 1.5), first=first)
    outlines(ax, now.mean[None, :2], now.covariance[None, :2, :2], "#202020", 5.0)
    mark_robot(ax, now.mean, style.colour, "robot")
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_title(f"{title}: map with 3σ ellipses", loc="left")
    box = ellipses(now.mean[None, :2], now.covariance[None, :2, :2])[0]
    fit(ax, np.concatenate([_scene(log), path, landmarks.xy if points else path, box]))
    if not points:
        if known is not None:
            draw_walls(ax, known.xy, FAINT, label="true landmarks", zorder=1)
        rows, ends = draw_walls(ax, landmarks.xy, style.colour, label=counted(len(landmarks.xy), "landmark"))
        write_numbers(ax, ends.mean(axis=1), landmarks.number[rows], LANDMARK, 4.5, (1.5, 1.5), first=first)
    _legend_below(fig, ax, 5)


def paint_observations(fig: Figure, sensor: Sensor, z: Array, R: Array, title: str, first: int = 0) -> None:
    """Observations z (m, 2) with their 3 sigma ellipses in the robot frame, numbered from `first`."""
    ax = picture_axes(fig)
    xy, P = sensor.body_points(z, R)
    outline = field_of_view(sensor)
    shown = [xy, np.zeros((1, 2))]
    if outline is not None:
        shown.append(outline)
        ax.fill(*outline.T, facecolor=GOOD, alpha=0.07, edgecolor=GOOD, linewidth=0.5, label="sensor's view", zorder=1)
    outlines(ax, xy, P, GOOD)
    ax.plot(*xy.T, ".", color=GOOD, markersize=4.0, label="observations with 3σ ellipses", zorder=4)
    write_numbers(ax, xy, np.arange(len(xy)), "#202020", 7.0, first=first)
    mark_robot(ax, np.zeros(3), "black", "robot")
    robot_axes(ax)
    ax.set_title(f"{title}: {len(xy)} observation{'s' * (len(xy) != 1)}, robot frame", loc="left")
    fit(ax, np.concatenate(shown))
    _legend_below(fig, ax)


DPI = 110
WINDOWED = ("macosx", "qt", "tk", "gtk", "wx")  # prefixes of matplotlib's backends with windows
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def open_windows() -> Any:
    """Matplotlib's pyplot if it can open windows here, else None."""
    if sys.platform not in ("darwin", "win32") and not any(os.environ.get(name) for name in SCREENS):
        return None
    try:
        from matplotlib import pyplot

        pyplot.switch_backend(pyplot.get_backend())
    except (ImportError, ValueError, RuntimeError):
        return None
    return pyplot if pyplot.get_backend().lower().startswith(WINDOWED) else None


class ImageWriter:
    """Writes images to windows, files, both, or nowhere."""

    def __init__(self, folder: Path | None, windows: Any) -> None:
        """Make the folder. Raises UsageError if that fails."""
        self.folder, self.windows = folder, windows
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as fault:
                raise UsageError(f"--save {folder}: {fault.strerror}") from fault

    @property
    def wanted(self) -> bool:
        """Whether images are wanted."""
        return self.folder is not None or self.windows is not None

    def show(self, name: str, paint: Callable[[Figure], object], stem: str | None) -> None:
        """An image in the window `name` and, with a stem, as a file."""
        if self.windows is None and (self.folder is None or stem is None):
            return
        # a layout engine would draw everything twice; saving a figure restores the one in the settings, so none is set
        with drawing(), rc_context({"figure.constrained_layout.use": False}):
            figure = Figure() if self.windows is None else self.windows.figure(num=name, clear=True)
            paint(figure)
            if stem is not None:
                self.write(f"{stem}.png", _png(figure))
            if self.windows is not None:
                figure.canvas.draw_idle()
                self.windows.pause(0.01)

    def show_made(self, name: str, figure: Figure) -> None:
        """A finished figure, as the file `name` and as an image in the window."""
        with drawing():
            png = _png(figure)
        self.show_image(name, png, name)

    def show_image(self, name: str, png: bytes, stem: str) -> None:
        """An image, as the file `stem` and in the window `name`."""
        self.write(f"{stem}.png", png)
        if self.windows is None:
            return
        image = imread(io.BytesIO(png))
        self.show(name, lambda fig: fig.add_axes((0, 0, 1, 1), frameon=False).imshow(image), None)

    def write(self, name: str, data: bytes) -> None:
        """Write a file atomically."""
        if self.folder is None:
            return
        try:
            with whole_file(self.folder / name) as partial:
                partial.write_bytes(data)
        except OSError as fault:
            raise UsageError(f"--save {self.folder}: {name} cannot be written: {fault.strerror}") from fault


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()
