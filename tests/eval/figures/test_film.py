"""The film: as long as it may be, everything where it should be, and the same bytes twice."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from data.errors import SlamrefError
from data.result import Failure
from eval.figures.film import HEADER, animate, bgr, canvas_of, frames_shown
from eval.figures.style import style_of
from eval.figures.view import View
from tests.eval.handmade import FRAMES, circle_log, run_with_error


def frames_of(path) -> list[np.ndarray]:
    film, frames = cv2.VideoCapture(str(path)), list[np.ndarray]()
    while True:
        more, image = film.read()
        if not more:
            return frames
        frames.append(image)


def test_a_film_shows_every_frame_if_it_may_and_the_same_bytes_come_twice(tmp_path):
    seen = []
    for name in ("a", "b"):
        animate(circle_log(), run_with_error(np.array([0.5, 0.0, 0.0])), tmp_path / "films" / f"{name}.mp4",
                progress=lambda done, total: seen.append((done, total)))  # fmt: skip
    assert seen[:FRAMES] == [(k + 1, FRAMES) for k in range(FRAMES)]
    assert (tmp_path / "films" / "a.mp4").read_bytes() == (tmp_path / "films" / "b.mp4").read_bytes()
    frames = frames_of(tmp_path / "films" / "a.mp4")
    assert len(frames) == FRAMES
    assert frames[0].shape[0] % 2 == frames[0].shape[1] % 2 == 0
    assert cv2.VideoCapture(str(tmp_path / "films" / "a.mp4")).get(cv2.CAP_PROP_FPS) == 20.0


def test_the_robot_is_where_its_estimate_is_and_nothing_is_there_before(tmp_path):
    animate(circle_log(), run_with_error(np.array([1.0, 0.0, 0.0])), tmp_path / "film.mp4")
    frames = frames_of(tmp_path / "film.mp4")
    coloured = [np.abs(f[HEADER:].astype(int) - bgr(style_of("ekf").colour)).sum(axis=2) < 60 for f in frames]
    # the scene is at least 12 m wide; the robot, a metre right of the truth at (-4, 0), in the middle of the film
    half = FRAMES // 2
    height, width = coloured[0].shape
    assert not coloured[0][:, : width // 4].any()
    rows, columns = np.nonzero(coloured[half][:, : width // 2])
    centre = round(float(np.median(rows))), round(float(np.median(columns)))
    assert abs(centre[0] - height / 2) < 0.05 * height
    assert coloured[half][centre[0] - 1 : centre[0] + 2, centre[1] - 1 : centre[1] + 2].all()


@pytest.mark.parametrize(
    ("frames", "fps", "seconds", "count"),
    [(40, 20, 60, 40), (6969, 20, 60, 1162), (1200, 20, 60, 1200), (5, 20, 0.1, 2), (3, 1, 0.1, 1)],
)
def test_a_long_log_is_thinned_to_the_length_allowed_and_ends_with_its_last_frame(frames, fps, seconds, count):
    shown = frames_shown(frames, fps, seconds)
    assert len(shown) == count <= max(fps * seconds, 1)
    assert shown[-1] == frames - 1
    assert len(set(np.diff(shown))) <= 1


def test_metres_fall_on_pixels_with_one_scale_and_y_upward():
    canvas = canvas_of(View(np.array([-6.0, -3.0]), np.array([6.0, 3.0])))
    assert (canvas.width, canvas.height) == (960, 480)
    pixels = canvas.pixels(np.array([[-6.0, 3.0], [6.0, -3.0], [0.0, 0.0]])) / 16
    assert pixels.tolist() == [[0.0, 0.0], [960.0, 480.0], [480.0, 240.0]]


@pytest.mark.parametrize("phase", ["online", "final"])
@pytest.mark.parametrize("truth", [True, False])
def test_any_phase_is_filmed_with_and_without_truth_and_after_a_failure(tmp_path, phase, truth):
    stopped = Failure("diverged", 3, "covariance not positive semidefinite")
    run = run_with_error(np.zeros(3), phases=(phase,), failure=stopped, mapped=truth)
    animate(circle_log(truth=truth, landmarks=truth, known_map=not truth), run, tmp_path / "film.mp4", max_seconds=0.3)
    assert len(frames_of(tmp_path / "film.mp4")) == 6


def test_a_path_that_leaves_the_scene_is_cut_and_not_an_error(tmp_path):
    away = run_with_error(np.outer(np.arange(FRAMES), [1e6, 0.0, 0.0]))
    animate(circle_log(), away, tmp_path / "film.mp4", max_seconds=0.2)
    assert len(frames_of(tmp_path / "film.mp4")) == 4


def test_a_film_that_cannot_be_written_is_a_clear_error(tmp_path):
    (tmp_path / "film.mp4").mkdir()
    with pytest.raises(SlamrefError, match=r"film\.mp4: cannot be written as an MP4 film"):
        animate(circle_log(), run_with_error(np.zeros(3)), tmp_path / "film.mp4")


def test_the_true_path_is_drawn_black(tmp_path):
    log = circle_log()
    animate(log, run_with_error(np.array([1.5, 1.5, 0.0]), mapped=False), tmp_path / "film.mp4")
    last = frames_of(tmp_path / "film.mp4")[-1][HEADER:].astype(int)
    dark = last.sum(axis=2) < 150
    # a circle of 8 m diameter, at 50 pixels or more to the metre
    assert dark.sum() > 3.14 * 8 * 50
