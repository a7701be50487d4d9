"""A film of one run: map and path so far, the robot with its ellipse, its true pose, rays to what it observes.

VP8 in WebM, which browsers play; the same pictures make the same bytes. Landmarks are as at the end, since first seen.
"""

import math
import os
from pathlib import Path

import cv2
import numpy as np
from matplotlib.colors import to_rgb

from data.errors import SlamrefError
from data.inputs import Inputs, IntArray
from data.log import Log
from data.result import NEW, Run
from data.se2 import Array, transform_points
from eval.figures.plane import SIGMAS, along_path, ellipses, enlargement, feet, longest_axis, true_landmarks, view_of
from eval.figures.style import series, style_of

FPS, LONGEST = 20, 60.0  # pictures a second; a film whose speed nobody asked for lasts at most so many seconds
SIDE, HEADER = 960, 56  # px of the longer side; above the scene, for names and time
BLACK, GREY, PALE = [0.0] * 3, [120.0] * 3, [205.0] * 3
ROBOT = np.array([[14.0, 0.0], [-8.4, 7.7], [-8.4, -7.7]])  # px
CROSS = np.array([[-5.0, 0.0], [5.0, 0.0], [0.0, 0.0], [0.0, -5.0], [0.0, 5.0]])  # px


def pace_of(inputs: Inputs, speed: float | None = None) -> tuple[str, IntArray]:
    """The speed in words, as asked for or a whole one at which the film is short enough; each picture's frame (P,)."""
    time = inputs.time - inputs.time[0]
    speed = speed or math.ceil(max(5.0 if inputs.time_is_index else 1.0, float(time[-1]) / LONGEST))
    instant = np.arange(math.ceil(float(time[-1]) / speed * FPS - 1e-9) + 1) * (speed / FPS)
    frames = np.searchsorted(time, instant + 1e-9, side="right").astype(np.int64) - 1
    return f"{speed:g} frames a second" if inputs.time_is_index else f"{speed:g} x real time", frames


def animate(log: Log, run: Run, path: Path, speed: float | None = None) -> None:
    """Film the first phase of a run. Raises SlamrefError if the file cannot be written."""
    inputs, truth, shown, m = log.recorded, log.truth.pose, series([run])[0], run.map
    pose, covariance = shown.trajectory.pose, np.nan_to_num(shown.trajectory.covariance[:, :2, :2])
    truth = np.full_like(pose, np.nan) if truth is None else truth
    xy, P, since = np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, np.int64)
    if m is not None and len(inputs.sensor.split(m.xy)[0]):
        xy, P, since = m.xy, np.nan_to_num(m.covariance), m.first_frame
    view = view_of(log, [shown], {"path": pose[:, :2]}, {"map": ellipses(xy, P)})
    large, larger = enlargement(view, longest_axis(P)), enlargement(view, longest_axis(along_path(shown)[1]), 0.025)
    outlines, used = ellipses(xy, P, SIGMAS * large), run.decisions >= NEW
    rays = np.stack([pose[inputs.observations.frame, :2], feet(log, pose)], axis=1)
    scale = SIDE / max(float(view.size.max()), 1e-3)
    width, height = (max(SIDE // 2, 2 * round(scale * float(side) / 2)) for side in view.size)
    corner = 0.5 * (view.low + view.high) + 0.5 * np.array([-width, height]) / scale
    colour = [255.0 * part for part in to_rgb(style_of(run.estimator).colour)[::-1]]
    background = np.full((height + HEADER, width, 3), 255, np.uint8)
    title = f"{log.name}: {run.task}, {run.estimator}, {run.association} ({shown.phase})"

    def draw(on: cv2.typing.MatLike, points: Array, ink: list[float], width: int = 1, closed: bool = False) -> None:
        """Lines through world points (n, k, 2) m; those with an unknown point are left out."""
        pixels = np.clip((points - corner) * scale * (1, -1) + (0, HEADER), -2e4, 2e4)
        lines = list(np.round(16.0 * pixels[np.isfinite(points).all(axis=(1, 2))]).astype(np.int32))
        cv2.polylines(on, lines, closed, ink, width, cv2.LINE_AA, 4)

    (text, frames), film, before = pace_of(inputs, speed), _film(path, width, height + HEADER), 0
    if (known := true_landmarks(log)) is not None:
        draw(background, inputs.sensor.split(known.xy)[0][:, None] + CROSS / scale, GREY)
    for k in frames.tolist():
        for poses, ink in ((truth, BLACK), (pose, colour)):
            draw(background, np.stack([poses[before:k, :2], poses[before + 1 : k + 1, :2]], axis=1), ink)
        image, before, rows = background.copy(), k, np.arange(inputs.start[k], inputs.start[k + 1])
        draw(image, outlines[since <= k], colour, closed=True)
        draw(image, rays[rows], PALE)
        draw(image, rays[rows[used[rows]]], colour)
        draw(image, ellipses(pose[[k], :2], covariance[[k]], SIGMAS * larger), colour, 2, closed=True)
        draw(image, transform_points(truth[k], 1.25 * ROBOT / scale)[None], BLACK, closed=True)
        draw(image, transform_points(pose[k], ROBOT / scale)[None], colour, 9, closed=True)
        when = f"frame {k}" if inputs.time_is_index else f"t = {inputs.time[k]:.1f} s"
        what = f"{when}   truth: black   3 sigma ellipses: robot x {larger}, landmarks at the end x {large}"
        for y, line in ((20, f"{title}   {text}"), (44, what)):
            cv2.putText(image, line, (12, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, BLACK, 1, cv2.LINE_AA)
        film.write(image)
    film.release()
    made = path.read_bytes()  # the muxer numbers the track at random, behind TrackUID (RFC 9559): 1 instead
    path.write_bytes(made.replace(made.partition(bytes.fromhex("73c588"))[2][:8], (1).to_bytes(8, "big")))


def _film(path: Path, width: int, height: int) -> cv2.VideoWriter:
    """An open film. OpenCV looks VP80 up in a list that WebM has none of, says so on standard error, and goes on."""
    path.parent.mkdir(parents=True, exist_ok=True)
    real = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
        film = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"VP80"), FPS, (width, height))
    os.dup2(real, 2)
    os.close(real)
    if not film.isOpened():
        raise SlamrefError(f"{path}: cannot be written as a WebM film (VP8, {width} x {height} pixels)")
    return film
