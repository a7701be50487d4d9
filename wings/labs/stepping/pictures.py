"""Figures of one step, as in the university lab: truth, map and observations; and of its association problem."""

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
from matplotlib.ticker import MaxNLocator

from association.expectation import gate_threshold
from data.errors import UsageError
from data.inputs import CLUTTER, IntArray, LandmarkMap
from data.log import Log
from data.result import NEW, MapState, PoseEstimate
from data.se2 import Array, BoolArray, transform_points
from data.sensors import RangeBearing, Sensor
from data.terminal import counted
from data.whole import whole_file
from eval.figures.plane import draw_walls, ellipses, true_landmarks
from eval.figures.style import NARROW, TRUTH_COLOUR, drawing, page_width, style_of
from wings.labs.stepping.problem import Matching, TruthRow

ONE, MANY = (7.0, 5.6), (10.5, 6.8)  # in; size of a figure with one picture, and with one per method
GOOD, BAD, DULL, FAINT = "#0064A8", "#D55E00", "#606060", "#B0B0B0"
LANDMARK = "#6A3D9A"  # landmark numbers; those of observations are black, of wrong ones like their marks
TITLES = {name: name.upper() for name in ("nn", "singles", "ml", "jcbb", "gnn")} | {
    "truth": "ground truth", "jcbb-first": "JCBB", "jcbb-hindsight": "hindsight", "known": "by labels",
}  # fmt: skip
"""The lab's JCBB is `jcbb-first`; next to `jcbb` the titles are the plain names."""
SHOWN_WITHOUT_GATE = 0.99  # gate of drawn pairs, if there is none
DASHES = (0, (3.0, 1.5))
HALO = [withStroke(linewidth=1.5, foreground="white")]


def outlines(ax: Axes, xy: Array, covariance: Array, colour: str, order: float = 2.0, fill: float = 0.15) -> None:
    """Ellipses of points (m, 2) with covariances (m, 2, 2), filled faintly."""
    if len(xy):
        outline = list(ellipses(xy, covariance))
        filled = PolyCollection(outline, facecolor=colour, edgecolor="none", alpha=fill, zorder=order)
        ax.add_collection(filled, autolim=False)
        edge = PolyCollection(outline, facecolor="none", edgecolor=colour, linewidth=0.6, zorder=order)
        ax.add_collection(edge, autolim=False)


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
    ax: Axes, xy: Array, numbers: IntArray, colour: str, size: float, offset: tuple[float, float] = (3.0, 2.5), *,
    first: int = 0,
) -> None:  # fmt: skip
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
    return name if len({n for n in (*others, name) if TITLES.get(n, n) == title}) > 1 else title


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
    scene = np.concatenate([xy, np.zeros((1, 2))])  # far landmarks would make everything else small
    low, high = scene.min(axis=0), scene.max(axis=0)
    reach = max(float((high - low).max()), 1.0)
    involved &= np.all((landmarks > low - reach) & (landmarks < high + reach), axis=1)
    shown = np.concatenate([scene, landmarks[involved]])
    column = {int(n): j for j, n in enumerate(e.number)}
    return Plane(xy, P, landmarks, Pl, compatible, near, shown, e.number, involved, column, m.first)


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
    fig: Figure, log: Log, frame: int, estimator: str, path: Array, now: PoseEstimate, landmarks: MapState,
    title: str, first: int = 0,
) -> None:  # fmt: skip
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


def draw_decisions(
    ax: Axes, p: Plane, decisions: IntArray, truth: TruthRow | None, *, all_numbers: bool, size: float = 5.5
) -> None:
    """Pairings as lines; shapes show the decision, colours whether it is right; wrong ones are numbered."""
    wrong = np.zeros(len(decisions), bool) if truth is None else ~np.array(truth.correct, bool)
    pairs = [(i, p.column.get(n, -1)) for i, n in enumerate(decisions.tolist()) if n >= 0]
    pairs = [(i, j) for i, j in pairs if j >= 0]  # a labelled landmark need not be a candidate
    lines(ax, p, [q for q in pairs if not wrong[q[0]]], color=GOOD, linewidth=1.3, zorder=4)
    lines(ax, p, [q for q in pairs if wrong[q[0]]], color=BAD, linewidth=1.3, linestyle=DASHES, zorder=4)
    if truth is not None:
        missed = [(int(i), p.column.get(int(truth.ground_truth[i]), -1)) for i in np.flatnonzero(wrong)]
        lines(ax, p, [q for q in missed if q[1] >= 0], color=BAD, linewidth=0.9, linestyle=":", zorder=3.8)
    kinds = (("o", decisions >= 0, 3.0), ("*", decisions == NEW, 6.5), ("x", decisions < NEW, 4.5))
    for colour, group in ((GOOD, ~wrong), (BAD, wrong)):
        for marker, kind, large in kinds:
            ax.plot(*p.xy[kind & group].T, marker, color=colour, markersize=large, linestyle="none", zorder=5)
    named = np.arange(len(wrong)) if all_numbers else np.flatnonzero(wrong)
    colour, size = ("#202020", size) if all_numbers else (BAD, size + 1.0)
    write_numbers(ax, p.xy[named], named, colour, size, first=p.first)


def wrong_of(truth: TruthRow | None) -> IntArray:
    """Observations decided wrongly."""
    return np.empty(0, np.int64) if truth is None else np.flatnonzero(~np.array(truth.correct, bool))


def scene_of_wrong(p: Plane, decisions: IntArray, truth: TruthRow | None) -> Array | None:
    """Points (k, 2) of the smallest wrong decision: observation, paired and right landmark; None: none wrong."""
    found: list[Array] = []
    for i in wrong_of(truth).tolist():
        numbers = [int(decisions[i])] + ([] if truth is None else [int(truth.ground_truth[i])])
        columns = [p.column[n] for n in numbers if n in p.column]
        if columns:
            found.append(np.concatenate([p.xy[[i]], p.landmarks[columns]]))
    # two confused landmarks are more informative than one
    return min(found, key=lambda points: (-len(points), float(np.ptp(points, axis=0).max())), default=None)


def enlarge(ax: Axes, p: Plane, scene: Array) -> tuple[Array, float]:
    """The problem around some points (k, 2), its landmarks numbered; middle (2,) and half side [m] of what is shown."""
    low, high = scene.min(axis=0), scene.max(axis=0)
    middle, half = 0.5 * (low + high), max(0.8 * float((high - low).max()), AROUND)
    background(ax, p, SIZE)
    ax.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
    ax.set_aspect("equal")
    seen = np.all(np.abs(p.landmarks - middle) <= half, axis=1)
    write_numbers(ax, p.landmarks[seen], p.number[seen], LANDMARK, SIZE, (-3.0, -3.0), first=p.first)
    return middle, half


def _mark(marker: str, label: str, colour: str = GOOD, **look: Any) -> Line2D:
    return Line2D([], [], marker=marker, color=colour, linestyle="none", label=label, **look)


def _stroke(label: str, colour: str = GOOD, **look: Any) -> Line2D:
    return Line2D([], [], color=colour, label=label, **{"linewidth": 1.3, **look})


def _background_handles(gate: float | None) -> list[Line2D | Patch]:
    inside = f"d² inside {SHOWN_WITHOUT_GATE:g} (no gate: every pair is compatible)"
    return [
        _mark("+", "predicted landmark, 3σ ellipse", DULL), _mark("$7$", "landmark number", LANDMARK, markersize=4.0),
        _stroke(inside if gate is None else "individually compatible pair", FAINT, linewidth=0.8),
    ]  # fmt: skip


def _handles(m: Matching) -> list[Line2D | Patch]:
    shapes = (("o", "paired"), ("*", "NEW"), ("x", "discarded"))
    handles: list[Line2D | Patch] = [_mark(s, f"observation: {what}") for s, what in shapes]
    handles += [*_background_handles(m.gate), _stroke("pairing")]
    if m.right is not None:
        handles += [_stroke("wrong pairing", BAD, linestyle=DASHES), _mark("o", "wrong (FP or FN)", BAD)]
        handles += [_stroke("to the right landmark", BAD, linewidth=0.9, linestyle=":")]
    return handles


def _problem(ax: Axes, p: Plane) -> None:
    """The problem, the robot in its middle, and the numbers of landmarks."""
    background(ax, p)
    mark_robot(ax, np.zeros(3), "black", "robot")
    fit(ax, p.shown, 0.1)
    # Numbers of possible landmarks, below left of them; observations have theirs above.
    low, high = np.array(ax.get_xlim()), np.array(ax.get_ylim())
    x, y = p.landmarks.T
    inside = p.named & (x >= low[0]) & (x <= low[1]) & (y >= high[0]) & (y <= high[1])
    write_numbers(ax, p.landmarks[inside], p.number[inside], LANDMARK, 5.0, (-2.5, -2.5), first=p.first)


def paint_compatibility(fig: Figure, m: Matching) -> None:
    """All compatible pairs, and the right ones that are not compatible."""
    p, ax = plane_of(m), picture_axes(fig)
    _problem(ax, p)
    ax.plot(*p.xy.T, "o", color=GOOD, markersize=3.5, zorder=5)
    write_numbers(ax, p.xy, np.arange(len(p.xy)), "#202020", 7.0, first=p.first)
    right = [] if m.right is None else [(i, p.column[n]) for i, n in enumerate(m.right.tolist()) if n in p.column]
    bad = [pair for pair in right if not p.compatible[pair]]
    lines(ax, p, bad, color=BAD, linewidth=1.3, linestyle=DASHES, zorder=4)
    robot_axes(ax)
    ax.set_title(f"{m.title}: compatibility ({int(p.compatible.sum())} pairs), robot frame", loc="left")
    handles = [_mark("o", "observation, 3σ ellipse"), *_background_handles(m.gate)]
    handles += [_stroke("true pair that is not compatible", BAD, linestyle=DASHES)] if bad else []
    fig.legend(handles=handles, loc="lower left", ncols=3)


def paint_matching(fig: Figure, m: Matching) -> None:
    """Decisions of each method on the same expectation: shapes show the decision, colours whether it is right."""
    p, names = plane_of(m), list(m.decisions)
    fig.set_layout_engine("none")  # One panel per name, at most six, and the place for a legend, if any
    fig.set_size_inches(*MANY)
    full = len(names) == 6
    bottom, high = (0.14, 0.335) if full else (0.065, 0.375)
    corners = [(0.055 + 0.318 * column, bottom + row * (high + 0.085)) for row in (1, 0) for column in range(3)]
    axes = [fig.add_axes((x, y, 0.28, high)) for (x, y), _ in zip(corners, names, strict=False)]
    for at, (ax, name) in enumerate(zip(axes, names, strict=True)):
        _problem(ax, p)
        made, truth, update = m.decisions[name], m.truth.get(name), " (updates)" if name == m.chosen else ""
        if update:
            for spine in ax.spines.values():
                spine.set(linewidth=1.8, edgecolor="black")
        if not isinstance(made, str):
            draw_decisions(ax, p, made, truth, all_numbers=at == 0)
        ax.set_title(f"{called(name, names)}{update}: {made if isinstance(made, str) else _counted(made, truth)}")
        robot_axes(ax, left=at % 3 == 0, bottom=at >= len(names) - 3)
    if full:  # no panel is free
        fig.legend(handles=_handles(m), loc="lower center", ncols=4)
    else:
        look: dict[str, Any] = {"bbox_to_anchor": corners[len(names)], "fontsize": 8.0, "labelspacing": 0.8}
        fig.legend(handles=_handles(m), loc="lower left", **look)
    fig.suptitle(f"{m.title}: matching, robot frame", x=0.01, ha="left")


def _tally(truth: TruthRow | None) -> str:
    return "" if truth is None else "  ".join(f"{name.upper()} {n}" for name, n in truth.counts.items())


def _counted(decisions: IntArray, truth: TruthRow | None) -> str:
    if truth is not None:
        return _tally(truth)
    paired, new = int((decisions >= 0).sum()), int((decisions == NEW).sum())
    return f"{paired} paired, {new} new, {len(decisions) - paired - new} discarded"


AROUND = 0.5  # m, smallest half side of the section: the corridor's points are 0.25 m apart
SIZE = 7.0  # pt, of the numbers
DISTANCE: dict[str, Any] = {"fontsize": 5.5, "color": "#303030", "path_effects": HALO, "ha": "center", "va": "center"}
"""Text style of the d² of a pair."""


def enlarged_figure(m: Matching, panels: Sequence[str], *, compatibility: bool = False) -> Figure:
    """Decisions of methods in a frame side by side, enlarged at a wrong decision of the first (or where it is crowded).
    `compatibility`: before them a panel of all compatible pairs, each in view with its squared Mahalanobis distance d².
    """
    with drawing():
        p, first = plane_of(m), m.decisions[panels[0]]
        scene = None if isinstance(first, str) else scene_of_wrong(p, first, m.truth.get(panels[0]))
        if scene is None:
            scene = p.xy[[int(p.near.sum(axis=1).argmax()) if p.near.size else 0]]
        names, by = (["", *panels], "matching by ") if compatibility else (list(panels), "")
        columns, foot = (len(names), 0.9) if page_width() >= NARROW else (1, 1.4)  # foot, side, high: in
        wide = (1.0 - 0.525 / page_width()) / columns
        side, below = (wide - 0.03) * page_width(), len(names) // columns - 1
        high = foot + 0.6 + side + (side + 0.6) * below
        fig = Figure(figsize=(page_width(), high))
        fig.set_layout_engine("none")
        for k, name in enumerate(names):
            left, bottom = 0.525 / page_width() + k % columns * wide, foot + (side + 0.6) * (below - k // columns)
            ax = fig.add_axes((left, bottom / high, wide - 0.03, side / high))
            middle, half = enlarge(ax, p, scene)
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
            ax.tick_params(labelleft=k % columns == 0)
            robot_axes(ax, left=k % columns == 0)
            if not name:
                _distances(ax, m, p, middle, half, wrong_of(m.truth.get(panels[0])))
                continue
            made, truth = m.decisions[name], m.truth.get(name)
            if not isinstance(made, str):
                draw_decisions(ax, p, made, truth, all_numbers=True, size=SIZE)
            ax.set_title(f"{by}{called(name)}: {made if isinstance(made, str) else _tally(truth)}", loc="left")
        fig.legend(handles=_handles(m), loc="lower center", ncols=4 if columns > 1 else 2, columnspacing=1.0)
        fig.suptitle(m.title, x=0.01, ha="left")
        return fig


def _distances(ax: Axes, m: Matching, p: Plane, middle: Array, half: float, wrong: IntArray) -> None:
    """All observations, and the d² of the compatible pairs in view."""
    ax.plot(*p.xy.T, "o", color=GOOD, markersize=3.5, zorder=5)
    ax.plot(*p.xy[wrong].T, "o", color=BAD, markersize=3.5, zorder=5.1)
    write_numbers(ax, p.xy, np.arange(len(p.xy)), "#202020", SIZE, first=p.first)
    d2 = m.expectation.individual_distances()
    for i, j in np.argwhere(p.near):
        at = 0.5 * (p.xy[i] + p.landmarks[j])
        if np.all(np.abs(at - middle) < 0.95 * half):
            ax.annotate(f"{d2[i, j]:.2g}", at, zorder=9, **DISTANCE)
    ax.set_title("compatibility: pairs inside the gate, with their d²", loc="left")
