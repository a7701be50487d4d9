"""A film of one run: robot, rays to what it observes, landmarks as they were, ellipses, true ghost, fading paths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from data.inputs import IntArray
from data.log import Log
from data.result import NEW, Run
from data.se2 import Array, transform_points
from eval.figures.ellipses import SIGMAS, along_path, ellipses, longest_axis
from eval.figures.films.canvas import BLACK, GREY, PALE, Canvas, Colour, bgr, blend, canvas_of, scale_bar, write
from eval.figures.films.landmarks import History, at_the_end
from eval.figures.films.pace import FPS, LONGEST, Pace, pace_of
from eval.figures.films.webm import Film, Image
from eval.figures.style import Series, series, style_of
from eval.figures.view import enlargement, true_landmarks, view_of

HEADER = 56
"""px above the scene for names and time."""
VISIBLE = 0.025
"""Share of the picture's side that the robot's ellipse is enlarged to: it must show around the robot."""
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
    """The landmarks' true places and the scale bar."""
    canvas = scene.canvas
    image: Image = np.full((canvas.height, canvas.width, 3), 255, np.uint8)
    known = true_landmarks(scene.log)
    if known is not None:
        arm = 5.0 / canvas.scale
        for x, y in known.xy:
            canvas.line(image, np.array([[x - arm, y], [x + arm, y]]), GREY)
            canvas.line(image, np.array([[x, y - arm], [x, y + arm]]), GREY)
    scale_bar(image, canvas)
    return image


def _triangle(pose: Array, size: float) -> Array:
    """Outline (3, 2) m of a robot of `size` m that looks along its heading."""
    body = size * np.array([[1.0, 0.0], [-0.6, 0.55], [-0.6, -0.55]])
    return transform_points(pose, body)


def _draw_paths(image: Image, scene: _Scene, begin: int, end: int, share: float) -> None:
    """True and estimated path between two frames, in what is left of their colours."""
    for poses, colour in ((scene.log.truth.pose, BLACK), (scene.shown.trajectory.pose, scene.colour)):
        if poses is not None:
            for part in _unbroken(poses[begin : end + 1, :2]):
                scene.canvas.line(image, part, blend(colour, share), 2 if share > FADED else 1)


def _draw_landmarks(image: Image, scene: _Scene, standing: IntArray) -> None:
    """The landmarks of these rows of the history."""
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
    seen = inputs.sensor.inverse(pose, z)[0]
    for point, decision in zip(seen, run.decisions[rows].tolist(), strict=True):
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
    """Film one run as WebM: its online phase unless told otherwise or it has none.

    `speed`: seconds of the log in a second of the film (frames, of a log without stamps); None: see
    `eval.figures.films.pace.pace_of`, with `max_seconds`. `history`: landmarks as they were; None: as they are at the
    end of the run, from the frame on in which they were first seen, as in any other phase than `online`.
    `progress(done, total)` is called after each picture. Raises SlamrefError if the file cannot be written.
    """
    pace = pace_of(log.recorded, speed, fps, max_seconds)
    scene = _scene(log, run, phase or run.phases[0], pace, history)
    canvas, shown = scene.canvas, pace.frame
    step = max(round(fps * TRAIL / BANDS), 1)
    background, drawn = _backdrop(scene), 0
    with Film(path, fps, canvas.width, canvas.height + HEADER) as film:
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
            film.add(np.vstack([_header(scene, k), image]))
            if progress is not None:
                progress(p + 1, len(shown))


def _unbroken(points: Array) -> list[Array]:
    """The stretches of at least two finite points (k, 2)."""
    finite = np.asarray(np.isfinite(points).all(axis=1))
    cuts = np.flatnonzero(np.diff(finite)) + 1
    return [p for p, ok in zip(np.split(points, cuts), finite[np.r_[0, cuts]], strict=True) if ok and len(p) > 1]
