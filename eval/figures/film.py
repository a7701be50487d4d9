"""A film of one run: robot, rays to what it observes, landmarks as they were, ellipses, true ghost, fading paths.

VP8 in WebM, which browsers play; the same pictures make the same bytes.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from data.errors import SlamrefError
from data.inputs import Inputs, IntArray
from data.locked import read_only
from data.log import Log
from data.result import NEW, Run
from data.se2 import Array, BoolArray, transform_points
from eval.figures.plane import SIGMAS, View, along_path, ellipses, enlargement, longest_axis, true_landmarks, view_of
from eval.figures.style import Series, series, style_of

AS_THEN, AT_THE_END = "as then", "as at the end"


@dataclass(frozen=True, eq=False)
class History:
    """Changes (C,) of landmarks, in the order of their frames."""

    frame: IntArray  # frame, number: (C,) after which frame, of which landmark
    number: IntArray
    there: BoolArray  # (C,) false where it left the map
    xy: Array  # (C, 2) m, covariance: (C, 2, 2) m^2, world frame
    covariance: Array
    when: str = AS_THEN  # of what instant this is, in words: `AS_THEN` or `AT_THE_END`

    def __post_init__(self) -> None:
        read_only(self)

    def after(self, frames: IntArray) -> Iterator[IntArray]:
        """For each of some frames (P,), ascending: the changes (L,) that stand after it, by landmark number."""
        standing: dict[int, int] = {}
        next_one = 0
        for k in frames.tolist():
            while next_one < len(self.frame) and self.frame[next_one] <= k:
                number = int(self.number[next_one])
                if self.there[next_one]:
                    standing[number] = next_one
                else:
                    standing.pop(number, None)
                next_one += 1
            yield np.array([standing[n] for n in sorted(standing)], np.int64)


def at_the_end(run: Run) -> History:
    """The last map, each landmark from the frame on in which it was first seen."""
    if run.map is None:
        none = np.empty(0, np.int64)
        return History(none, none, none.astype(bool), np.empty((0, 2)), np.empty((0, 2, 2)), AT_THE_END)
    m = run.map
    usable = np.isfinite(m.xy).all(axis=1) & np.isfinite(m.covariance).all(axis=(1, 2)) & (m.first_frame >= 0)
    order = np.flatnonzero(usable)[np.argsort(m.first_frame[usable], kind="stable")]
    there = np.ones(len(order), bool)
    return History(m.first_frame[order], m.number[order], there, m.xy[order], m.covariance[order], AT_THE_END)


FPS = 20  # pictures a second
LONGEST = 60.0  # s; a film whose speed nobody asked for lasts no longer
STEPS = (1.0, 2.0, 5.0)  # speeds that are chosen: these, and their multiples by powers of ten
FRAMES_A_SECOND = 5.0  # the slowest speed that is chosen for a log whose time counts frames: each can be looked at


@dataclass(frozen=True)
class Pace:
    """Seconds of the log in one of the film (frames, without stamps); the frame (P,) of each picture."""

    speed: float
    frame: IntArray
    counts_frames: bool

    @property
    def text(self) -> str:
        """The speed in words."""
        return f"{self.speed:g} frames a second" if self.counts_frames else f"{self.speed:g} x real time"


def pace_of(inputs: Inputs, speed: float | None = None, fps: int = FPS, longest: float = LONGEST) -> Pace:
    """The pace asked for, or the slowest round one from real time on with which the film is short enough."""
    time = inputs.time - inputs.time[0]
    length = float(time[-1])
    if speed is None:
        speed = FRAMES_A_SECOND if inputs.time_is_index else 1.0
        least = max(speed, length / longest)
        power = 10.0 ** math.floor(math.log10(least))
        speed = next(s * power for s in (*STEPS, 10.0) if s * power >= least * (1.0 - 1e-12))
    pictures = max(math.ceil(length / speed * fps - 1e-9), 0) + 1
    instant = np.minimum(np.arange(pictures) * (speed / fps), length)
    return Pace(speed, np.searchsorted(time, instant + 1e-9, side="right").astype(np.int64) - 1, inputs.time_is_index)


Image = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]

CODEC = "VP80"
EXPECTED = b"'VP80' is not supported with codec id"
"""OpenCV looks the codec up in a list that WebM has none of, says so on the standard error stream, and goes on."""

TRACK_UID = bytes.fromhex("73c588")
"""Ahead of the track's number of 8 bytes in the file's head (RFC 9559), which the muxer draws at random."""


@contextmanager
def _film(path: Path, fps: float, width: int, height: int) -> Iterator[cv2.VideoWriter]:
    """A film that is being written, whole when it was closed. SlamrefError: the file cannot be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _without(EXPECTED):
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*CODEC), float(fps), (width, height))
    if not writer.isOpened():
        raise SlamrefError(f"{path}: cannot be written as a WebM film (VP8, {width} x {height} pixels)")
    try:
        yield writer
    finally:
        writer.release()
    # give the track the number 1 instead of a random one, in its own element and in the tags that refer to it
    with path.open("r+b") as file:
        head = file.read(1 << 16)
        _, _, after = head.partition(TRACK_UID)
        file.seek(0)
        file.write(head.replace(after[:8], (1).to_bytes(8, "big")) if after else head)


@contextmanager
def _without(expected: bytes) -> Iterator[None]:
    """Keep one known line of a compiled library off the standard error stream; whatever else it says goes through."""
    real = os.dup(2)
    with tempfile.TemporaryFile() as caught:
        os.dup2(caught.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(real, 2)
            caught.seek(0)
            for line in caught.read().splitlines(keepends=True):
                if expected not in line:
                    os.write(real, line)
            os.close(real)


LONGER_SIDE = 960  # px of the picture's longer side; the scene decides the shorter one
SHORTER_SIDE = 480
SHIFT = 4  # bits of a pixel that OpenCV draws with

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


def write(image: Image, text: str, at: tuple[int, int], colour: Colour = BLACK, size: float = 0.5) -> None:
    """A line of text, its lower left corner `at` px."""
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


HEADER = 56  # px above the scene for names and time
VISIBLE = 0.025  # share of the picture's side that the robot's ellipse is enlarged to: it must show around the robot
TRAIL, BANDS, FADED = 5.0, 10, 0.35
"""s of the film in which a path fades, in how many tones, and the share of its colour that stays."""


@dataclass(frozen=True)
class _Scene:
    """Everything of a film that does not change from frame to frame."""

    log: Log
    shown: Series
    pace: Pace
    canvas: Canvas
    colour: Colour
    robot: float
    pose_factor: int
    landmark_factor: int
    landmarks: History


def _scene(log: Log, run: Run, phase: str, pace: Pace, history: History | None) -> _Scene:
    shown = next(s for s in series([run]) if s.phase == phase)
    last = at_the_end(run)
    view = view_of(log, [shown], {"path": shown.trajectory.pose[:, :2]}, {"map": ellipses(last.xy, last.covariance)})
    pose_factor = enlargement(view, longest_axis(along_path(shown)[1]), VISIBLE)
    landmark_factor = enlargement(view, longest_axis(last.covariance))
    canvas, colour = canvas_of(view), bgr(style_of(run.estimator).colour)
    robot = 14.0 / canvas.scale
    as_then = history if phase == "online" else None
    return _Scene(log, shown, pace, canvas, colour, robot, pose_factor, landmark_factor, as_then or last)


def _backdrop(scene: _Scene) -> Image:
    canvas = scene.canvas
    image: Image = np.full((canvas.height, canvas.width, 3), 255, np.uint8)
    known = true_landmarks(scene.log)
    if known is not None:
        arm = 5.0 / canvas.scale
        for x, y in known.xy:
            canvas.line(image, np.array([[x - arm, y], [x + arm, y]]), GREY)
            canvas.line(image, np.array([[x, y - arm], [x, y + arm]]), GREY)
    # how long a metre is, in the lower right corner
    wanted = 0.18 * canvas.width / canvas.scale
    power = 10.0 ** np.floor(np.log10(wanted))
    length = max(f * power for f in (1.0, 2.0, 5.0) if f * power <= wanted)
    right, base = canvas.width - 24, canvas.height - 20
    left = right - round(length * canvas.scale)
    cv2.line(image, (left, base), (right, base), BLACK, 2)
    for x in (left, right):
        cv2.line(image, (x, base - 5), (x, base + 5), BLACK, 1)
    write(image, f"{length:g} m", (left, base - 10), size=0.45)
    return image


def _triangle(pose: Array, size: float) -> Array:
    """Outline (3, 2) m of a robot of `size` m that looks along its heading."""
    body = size * np.array([[1.0, 0.0], [-0.6, 0.55], [-0.6, -0.55]])
    return transform_points(pose, body)


def _draw_paths(image: Image, scene: _Scene, begin: int, end: int, share: float) -> None:
    """True and estimated path between two frames, in what is left of their colours."""
    for poses, colour in ((scene.log.truth.pose, BLACK), (scene.shown.trajectory.pose, scene.colour)):
        if poses is not None:
            b, g, r = (round(255 - share * (255 - part)) for part in colour)
            faded = (b, g, r)
            points = poses[begin : end + 1, :2]
            finite = np.asarray(np.isfinite(points).all(axis=1))
            cuts = np.flatnonzero(np.diff(finite)) + 1
            for part, known in zip(np.split(points, cuts), finite[np.r_[0, cuts]], strict=True):
                if known and len(part) > 1:
                    scene.canvas.line(image, part, faded, 2 if share > FADED else 1)


def _draw_landmarks(image: Image, scene: _Scene, standing: IntArray) -> None:
    h = scene.landmarks
    outlines = ellipses(h.xy[standing], h.covariance[standing], SIGMAS * scene.landmark_factor)
    for xy, outline in zip(h.xy[standing], outlines, strict=True):
        scene.canvas.line(image, outline, scene.colour, closed=True)
        scene.canvas.dot(image, xy, 2.0, scene.colour)


def _draw_robot(image: Image, scene: _Scene, k: int) -> None:
    """What is seen at frame k, on top of the paths and the map so far."""
    canvas, run, colour = scene.canvas, scene.shown.run, scene.colour
    pose, covariance = scene.shown.trajectory.pose[k], scene.shown.trajectory.covariance[k]
    truth = scene.log.truth.pose
    if truth is not None and np.isfinite(truth[k]).all():
        canvas.line(image, _triangle(truth[k], 1.25 * scene.robot), BLACK, 1, closed=True)
    if not np.isfinite(pose).all():
        return
    _draw_rays(image, scene, k, pose)
    if np.isfinite(covariance).all():
        outline = ellipses(pose[None, :2], covariance[None, :2, :2], SIGMAS * scene.pose_factor)[0]
        canvas.line(image, outline, colour, 2, closed=True)
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
    seen = inputs.sensor_of(np.arange(rows.start, rows.stop)).inverse(pose, z)[0]
    for point, decision in zip(seen, run.decisions[rows].tolist(), strict=True):
        if not np.isfinite(point).all():  # a bearing or a range alone has no place
            continue
        used = decision >= 0 or decision == NEW
        canvas.line(image, np.stack([pose[:2], point]), scene.colour if used else PALE)
        canvas.dot(image, point, 2.5, scene.colour if used else PALE)


def _header(scene: _Scene, k: int) -> Image:
    inputs, run = scene.log.recorded, scene.shown.run
    image: Image = np.full((HEADER, scene.canvas.width, 3), 255, np.uint8)
    names = f"{scene.log.name}: {run.task}, {run.estimator}, {run.association} ({scene.shown.phase})"
    write(image, f"{names}   {scene.pace.text}", (12, 20))
    stamp = f"frame {k}" if inputs.time_is_index else f"t = {inputs.time[k]:.1f} s"
    if run.flaw is not None and k >= run.flaw.frame:
        stamp += f"   {run.flaw.status} at frame {run.flaw.frame}"
    if scene.log.truth.known_poses:
        stamp += "   truth: black"
    of_landmarks = ""
    if len(scene.landmarks.frame):
        of_landmarks = f", landmarks ({scene.landmarks.when}) x {scene.landmark_factor}"
    stamp += f"   3 sigma ellipses: robot x {scene.pose_factor}{of_landmarks}"
    write(image, stamp, (12, 44), GREY, 0.45)
    return image


def animate(
    log: Log,
    run: Run,
    path: Path,
    *,
    fps: int = FPS,
    speed: float | None = None,
    max_seconds: float = LONGEST,
    phase: str | None = None,
    history: History | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Film one run as WebM: its online phase, or else the final one. Raises SlamrefError if it cannot be written.

    `speed`: of a `Pace`; None: see `pace_of`, `max_seconds`. `history`: landmarks as they were; None, or another
    phase than `online`: as at the end. `progress(done, total)` is called after each picture.
    """
    pace = pace_of(log.recorded, speed, fps, max_seconds)
    scene = _scene(log, run, phase or run.phases[0], pace, history)
    canvas, shown = scene.canvas, pace.frame
    step = max(round(fps * TRAIL / BANDS), 1)
    background, drawn = _backdrop(scene), 0
    with _film(path, fps, canvas.width, canvas.height + HEADER) as film:
        for p, (k, standing) in enumerate(zip(shown.tolist(), scene.landmarks.after(shown), strict=True)):
            edges = [int(shown[max(p - step * band, 0)]) for band in range(BANDS, -1, -1)]
            _draw_paths(background, scene, drawn, edges[0], FADED)
            drawn = edges[0]
            image = background.copy()
            for band, (begin, end) in enumerate(pairwise(edges), start=1):
                if begin < end:
                    _draw_paths(image, scene, begin, end, FADED + (1.0 - FADED) * band / BANDS)
            _draw_landmarks(image, scene, standing)
            _draw_robot(image, scene, k)
            film.write(np.vstack([_header(scene, k), image]))
            if progress is not None:
                progress(p + 1, len(shown))
