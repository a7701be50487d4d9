"""A film (MP4) of one run: robot, rays to what it observes, ellipses, true ghost. Drawn with OpenCV, for speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data.errors import SlamrefError
from data.inputs import IntArray
from data.log import Log
from data.result import NEW, Run
from data.se2 import Array, transform_points
from eval.figures.ellipses import SIGMAS, along_path, ellipses, longest_axis
from eval.figures.style import Series, series, style_of
from eval.figures.view import View, enlargement, true_landmarks, view_of

LONGER_SIDE = 960
"""px of the picture's longer side; the scene decides the shorter one."""
SHORTER_SIDE = 480
HEADER = 56
"""px above the scene for names and time."""
VISIBLE = 0.025
"""Share of the picture's side that the robot's ellipse is enlarged to: it must show around the robot."""
SHIFT = 4
"""Bits of a pixel that OpenCV draws with."""

Image = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
Colour = tuple[int, int, int]

WHITE, BLACK, GREY, PALE = (255, 255, 255), (0, 0, 0), (120, 120, 120), (205, 205, 205)


def bgr(colour: str) -> Colour:
    """`#rrggbb` in OpenCV's order."""
    return int(colour[5:7], 16), int(colour[3:5], 16), int(colour[1:3], 16)


@dataclass(frozen=True)
class Canvas:
    """Where metres fall on pixels: x to the right, y up, one scale for both."""

    low: Array
    scale: float
    width: int
    height: int

    def pixels(self, xy: Array) -> IntArray:
        """World points (..., 2) m as fixed-point pixels with `SHIFT` fractional bits, kept within drawing range."""
        x = (xy[..., 0] - self.low[0]) * self.scale
        y = self.height - (xy[..., 1] - self.low[1]) * self.scale
        fixed = np.clip(np.stack([x, y], axis=-1), -20000.0, 20000.0) * (1 << SHIFT)
        return np.asarray(np.round(fixed), np.int32)

    def line(self, image: Image, points: Array, colour: Colour, thickness: int = 1, closed: bool = False) -> None:
        """Lines through points (k, 2) m."""
        cv2.polylines(image, [self.pixels(points)], closed, colour, thickness, cv2.LINE_AA, SHIFT)

    def area(self, image: Image, points: Array, colour: Colour) -> None:
        """A filled polygon (k, 2) m."""
        cv2.fillPoly(image, [self.pixels(points)], colour, cv2.LINE_AA, SHIFT)

    def dot(self, image: Image, point: Array, radius: float, colour: Colour) -> None:
        """A filled circle of `radius` px."""
        x, y = self.pixels(point).tolist()
        cv2.circle(image, (x, y), round(radius * (1 << SHIFT)), colour, -1, cv2.LINE_AA, SHIFT)


def canvas_of(view: View) -> Canvas:
    """A canvas of even size that holds the view."""
    w, h = (max(float(s), 1e-3) for s in view.size)
    scale = min(LONGER_SIDE / max(w, h), 4000.0)
    width, height = (max(SHORTER_SIDE, 2 * round(scale * side / 2)) for side in (w, h))
    middle = 0.5 * (view.low + view.high)
    return Canvas(middle - 0.5 * np.array([width, height]) / scale, scale, width, height)


def frames_shown(frames: int, fps: int, max_seconds: float) -> IntArray:
    """Which of the log's frames the film shows: every k-th, k as small as the length allows, and always the last."""
    most = max(int(fps * max_seconds), 1)
    stride = -(-frames // most)
    return np.arange(frames - 1, -1, -stride, dtype=np.int64)[::-1].copy()


def _write(image: Image, text: str, at: tuple[int, int], colour: Colour = BLACK, size: float = 0.5) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def _triangle(pose: Array, size: float) -> Array:
    """Outline (3, 2) m of a robot of `size` m that looks along its heading."""
    body = size * np.array([[1.0, 0.0], [-0.6, 0.55], [-0.6, -0.55]])
    return transform_points(pose, body)


def _scale_bar(image: Image, canvas: Canvas) -> None:
    wanted = 0.18 * canvas.width / canvas.scale
    power = 10.0 ** np.floor(np.log10(wanted))
    length = max(f * power for f in (1.0, 2.0, 5.0) if f * power <= wanted)
    right, base = canvas.width - 24, canvas.height - 20
    left = right - round(length * canvas.scale)
    cv2.line(image, (left, base), (right, base), BLACK, 2)
    for x in (left, right):
        cv2.line(image, (x, base - 5), (x, base + 5), BLACK, 1)
    _write(image, f"{length:g} m", (left, base - 10), size=0.45)


@dataclass(frozen=True)
class _Scene:
    """Everything of a film that does not change from frame to frame."""

    log: Log
    shown: Series
    canvas: Canvas
    colour: Colour
    robot: float
    pose_factor: int
    landmark_factor: int
    landmark_outlines: Array
    first_frame: IntArray


def _scene(log: Log, run: Run, phase: str) -> _Scene:
    shown = next(s for s in series([run]) if s.phase == phase)
    xy, P, first = np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, np.int64)
    if run.map is not None:
        usable = np.isfinite(run.map.xy).all(axis=1) & np.isfinite(run.map.covariance).all(axis=(1, 2))
        xy, P, first = run.map.xy[usable], run.map.covariance[usable], run.map.first_frame[usable]
    path = shown.trajectory.pose[:, :2]
    view = view_of(log, [shown], {"path": path}, {"map": ellipses(xy, P)})
    pose_factor = enlargement(view, longest_axis(along_path(shown)[1]), VISIBLE)
    landmark_factor = enlargement(view, longest_axis(P))
    canvas, colour = canvas_of(view), bgr(style_of(run.estimator).colour)
    outlines = ellipses(xy, P, SIGMAS * landmark_factor)
    return _Scene(log, shown, canvas, colour, 14.0 / canvas.scale, pose_factor, landmark_factor, outlines, first)


def _backdrop(scene: _Scene) -> Image:
    """The landmarks' true places and the scale bar."""
    canvas = scene.canvas
    image: Image = np.full((canvas.height, canvas.width, 3), 255, np.uint8)
    known = true_landmarks(scene.log)
    if known is not None:
        arm = 5.0 / canvas.scale
        for x, y in known.xy:
            canvas.line(image, np.array([[x - arm, y], [x + arm, y]]), GREY)
            canvas.line(image, np.array([[x, y - arm], [x, y + arm]]), GREY)
    _scale_bar(image, canvas)
    return image


def _draw_frame(image: Image, scene: _Scene, k: int) -> None:
    """What is seen at frame k, on top of the paths so far."""
    canvas, run, colour = scene.canvas, scene.shown.run, scene.colour
    pose, covariance = scene.shown.trajectory.pose[k], scene.shown.trajectory.covariance[k]
    for outline, first in zip(scene.landmark_outlines, scene.first_frame, strict=True):
        if 0 <= first <= k:
            canvas.line(image, outline, colour, closed=True)
            canvas.dot(image, outline[:-1].mean(axis=0), 2.0, colour)
    truth = scene.log.truth.pose
    if truth is not None and np.isfinite(truth[k]).all():
        canvas.line(image, _triangle(truth[k], 1.25 * scene.robot), BLACK, 1, closed=True)
    if not np.isfinite(pose).all():
        return
    _draw_rays(image, scene, k, pose)
    if np.isfinite(covariance).all():
        canvas.line(
            image,
            ellipses(pose[None, :2], covariance[None, :2, :2], SIGMAS * scene.pose_factor)[0],
            colour,
            2,
            closed=True,
        )
    canvas.area(image, _triangle(pose, scene.robot), colour)
    if run.failure is not None and k >= run.failure.frame:
        canvas.dot(image, pose[:2], 8.0, BLACK)


def _draw_rays(image: Image, scene: _Scene, k: int, pose: Array) -> None:
    """From the robot to where each observation places its landmark: coloured if used or new, grey if discarded."""
    inputs, run, canvas = scene.log.recorded, scene.shown.run, scene.canvas
    rows = slice(inputs.start[k], inputs.start[k + 1])
    z = inputs.observations.z[rows]
    if len(z) == 0:
        return
    seen = inputs.sensor.inverse(pose, z)[0]
    for point, decision in zip(seen, run.decisions[rows].tolist(), strict=True):
        used = decision >= 0 or decision == NEW
        canvas.line(image, np.stack([pose[:2], point]), scene.colour if used else PALE)
        canvas.dot(image, point, 2.5, scene.colour if used else PALE)


def _header(scene: _Scene, k: int) -> Image:
    inputs, run = scene.log.recorded, scene.shown.run
    image: Image = np.full((HEADER, scene.canvas.width, 3), 255, np.uint8)
    _write(image, f"{scene.log.name}: {run.task}, {run.estimator}, {run.association} ({scene.shown.phase})", (12, 20))
    stamp = f"frame {k}" if inputs.time_is_index else f"t = {inputs.time[k]:.1f} s"
    if run.flaw is not None and k >= run.flaw.frame:
        stamp += f"   {run.flaw.status} at frame {run.flaw.frame}"
    if scene.log.truth.known_poses:
        stamp += "   true robot and path: black"
    of_landmarks = f", landmarks x {scene.landmark_factor}" if len(scene.landmark_outlines) else ""
    stamp += f"   3 sigma ellipses: robot x {scene.pose_factor}{of_landmarks}"
    _write(image, stamp, (12, 44), GREY, 0.45)
    return image


def animate(
    log: Log,
    run: Run,
    path: Path,
    *,
    fps: int = 20,
    max_seconds: float = 60.0,
    phase: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Film one run: its online phase unless told otherwise or it has none.

    Landmarks stand where they are at the end of the run, from the frame on in which they were first seen.

    Every k-th frame is shown, so that the film lasts at most `max_seconds`. `progress(done, total)` is called after
    each. Raises SlamrefError if the file cannot be written.
    """
    scene = _scene(log, run, phase or run.phases[0])
    canvas, truth, estimate = scene.canvas, log.truth.pose, scene.shown.trajectory.pose
    path.parent.mkdir(parents=True, exist_ok=True)
    size = (canvas.width, canvas.height + HEADER)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), float(fps), size)
    if not writer.isOpened():
        raise SlamrefError(f"{path}: cannot be written as an MP4 film (mp4v, {size[0]} x {size[1]} pixels)")
    try:
        background, last = _backdrop(scene), 0
        shown = frames_shown(len(log.recorded), fps, max_seconds)
        for done, k in enumerate(shown.tolist(), start=1):
            for poses, colour in ((truth, BLACK), (estimate, scene.colour)):
                if poses is not None:
                    piece = poses[last : k + 1, :2]
                    for part in _unbroken(piece):
                        canvas.line(background, part, colour)
            last = k
            image = background.copy()
            _draw_frame(image, scene, k)
            writer.write(np.vstack([_header(scene, k), image]))
            if progress is not None:
                progress(done, len(shown))
    finally:
        writer.release()


def _unbroken(points: Array) -> list[Array]:
    """The stretches of at least two finite points (k, 2)."""
    finite = np.asarray(np.isfinite(points).all(axis=1))
    cuts = np.flatnonzero(np.diff(finite)) + 1
    return [p for p, ok in zip(np.split(points, cuts), finite[np.r_[0, cuts]], strict=True) if ok and len(p) > 1]
