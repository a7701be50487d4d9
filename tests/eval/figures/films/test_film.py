"""The film: everything where and when it should be, and the same bytes twice."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from data.errors import SlamrefError
from data.notice import stopped
from data.result import Failure
from eval.figures.film import AT_THE_END, HEADER, History, animate, at_the_end, bgr, canvas_of
from eval.figures.plane import View
from eval.figures.style import style_of
from tests.eval.handmade import FRAMES, circle_log, run_with_error

EVERY_FOURTH = 40.0
"""A speed at which a film of the circle, whose frames are half a second apart, shows every fourth of them."""
ENDS = 400.0
"""... and its first and its last frame only."""


def frames_of(path) -> list[np.ndarray]:
    film, frames = cv2.VideoCapture(str(path)), list[np.ndarray]()
    while True:
        more, image = film.read()
        if not more:
            return frames
        frames.append(image)


def of_the_estimate(image) -> np.ndarray:
    return np.abs(image[HEADER:].astype(int) - bgr(style_of("ekf").colour)).sum(axis=2) < 60


def test_the_same_film_twice_has_the_same_bytes_and_is_a_webm_that_says_nothing(tmp_path, capfd):
    seen = []
    for name in ("a", "b"):
        animate(circle_log(), run_with_error(np.array([0.5, 0.0, 0.0])), tmp_path / "films" / f"{name}.webm",
                speed=4 * EVERY_FOURTH, progress=lambda done, total: seen.append((done, total)))  # fmt: skip
    assert seen == 2 * [(k, 4) for k in range(1, 5)]
    written = (tmp_path / "films" / "a.webm").read_bytes()
    assert written == (tmp_path / "films" / "b.webm").read_bytes()
    assert written[:4] == bytes.fromhex("1a45dfa3")
    assert b"webm" in written[:64]
    assert b"V_VP8" in written[:512]
    assert capfd.readouterr() == ("", "")
    frames = frames_of(tmp_path / "films" / "a.webm")
    assert len(frames) == 4
    assert frames[0].shape[0] % 2 == frames[0].shape[1] % 2 == 0
    assert cv2.VideoCapture(str(tmp_path / "films" / "a.webm")).get(cv2.CAP_PROP_FPS) == 20.0


@pytest.mark.slow
def test_the_robot_is_where_its_estimate_is_and_nothing_is_there_before(tmp_path):
    animate(circle_log(), run_with_error(np.array([1.0, 0.0, 0.0])), tmp_path / "film.webm", speed=EVERY_FOURTH)
    coloured = [of_the_estimate(f) for f in frames_of(tmp_path / "film.webm")]
    # the scene is at least 12 m wide; the robot, a metre right of the truth at (-4, 0), in the middle of the film
    half = FRAMES // 2 // 4
    height, width = coloured[0].shape
    assert not coloured[0][:, : width // 4].any()
    solid = cv2.erode(coloured[half].astype(np.uint8), np.ones((7, 7), np.uint8))  # the robot; lines are thinner
    rows, columns = np.nonzero(solid)
    assert len(rows) > 0
    assert abs(float(np.mean(rows)) - height / 2) < 0.05 * height
    assert columns.max() < width / 2


@pytest.mark.slow
def test_landmarks_stand_where_they_were_believed_to_be_at_each_instant(tmp_path):
    # believed at (5, 5) from the first frame on, at (-5, -5) from the tenth, and removed after the thirtieth
    xy = np.array([[5.0, 5.0], [-5.0, -5.0], [-5.0, -5.0]])
    history = History(
        np.array([0, 10, 30]), np.zeros(3, np.int64), np.array([True, True, False]), xy,
        np.tile(0.01 * np.eye(2), (3, 1, 1)),
    )  # fmt: skip
    log = circle_log()
    animate(log, run_with_error(np.zeros(3)), tmp_path / "film.webm", speed=EVERY_FOURTH, history=history)
    frames = [f[HEADER:].min(axis=2) < 200 for f in frames_of(tmp_path / "film.webm")]
    n = len(frames[0]) // 6  # the corners of the square scene, which the circle does not touch
    upper_right = [bool(f[:n, -n:].any()) for f in frames]
    lower_left = [bool(f[-n:, :n].any()) for f in frames]
    assert upper_right == [True] * 3 + [False] * 8  # frames 0, 4, 8 of the log
    assert lower_left == [False] * 3 + [True] * 5 + [False] * 3  # 12 to 28


def test_without_a_history_a_landmark_appears_when_it_is_first_seen_where_it_is_at_the_end():
    history = at_the_end(run_with_error(np.zeros(3)))
    assert history.when == AT_THE_END
    assert [len(rows) for rows in history.after(np.array([0, 5]))] == [1, 1]
    assert not len(at_the_end(run_with_error(np.zeros(3), mapped=False)).frame)


@pytest.mark.slow
def test_a_path_fades_behind_the_robot(tmp_path):
    # from the right counter-clockwise, 19.5 s in all; the trail is 5 s of the film, 8 s of the log
    log, run = circle_log(truth=False, landmarks=False), run_with_error(np.zeros(3), mapped=False)
    animate(log, run, tmp_path / "film.webm", speed=1.6, fps=2)
    last = frames_of(tmp_path / "film.webm")[-1][HEADER:].astype(int)
    left = 765 - last[:, : last.shape[1] * 2 // 3].sum(axis=2)  # without the robot
    old, fresh = left[: len(last) // 2].max(), left[len(last) // 2 :].max()
    assert 60 < old < 0.6 * fresh


def test_metres_fall_on_pixels_with_one_scale_and_y_upward():
    canvas = canvas_of(View(np.array([-6.0, -3.0]), np.array([6.0, 3.0])))
    assert (canvas.width, canvas.height) == (960, 480)
    pixels = canvas.pixels(np.array([[-6.0, 3.0], [6.0, -3.0], [0.0, 0.0]])) / 16
    assert pixels.tolist() == [[0.0, 0.0], [960.0, 480.0], [480.0, 240.0]]


@pytest.mark.parametrize("phase", ["online", "final"])
@pytest.mark.parametrize("truth", [True, False])
def test_any_phase_is_filmed_with_and_without_truth_and_after_a_failure(tmp_path, phase, truth):
    halted = Failure("diverged", 3, stopped("covariance not positive semidefinite"))
    run = run_with_error(np.zeros(3), phases=(phase,), failure=halted, mapped=truth)
    log = circle_log(truth=truth, landmarks=truth, known_map=not truth)
    animate(log, run, tmp_path / "film.webm", speed=ENDS)
    assert len(frames_of(tmp_path / "film.webm")) == 2


def test_a_path_that_leaves_the_scene_is_cut_and_not_an_error(tmp_path):
    away = run_with_error(np.outer(np.arange(FRAMES), [1e6, 0.0, 0.0]))
    animate(circle_log(), away, tmp_path / "film.webm", speed=ENDS)
    assert len(frames_of(tmp_path / "film.webm")) == 2


def test_a_film_that_cannot_be_written_is_a_clear_error(tmp_path):
    (tmp_path / "film.webm").mkdir()
    with pytest.raises(SlamrefError, match=r"film\.webm: cannot be written as a WebM film"):
        animate(circle_log(), run_with_error(np.zeros(3)), tmp_path / "film.webm")


def test_the_true_path_is_drawn_black_where_it_is_fresh(tmp_path):
    log = circle_log()
    animate(log, run_with_error(np.array([1.5, 1.5, 0.0]), mapped=False), tmp_path / "film.webm", speed=EVERY_FOURTH)
    last = frames_of(tmp_path / "film.webm")[-1][HEADER:].astype(int)
    grey = last.max(axis=2) - last.min(axis=2) < 40  # not the estimate's colour
    dark = grey & (last.sum(axis=2) < 600)
    # a circle of 8 m diameter, at 50 pixels or more to the metre
    assert dark.sum() > 3.14 * 8 * 50


def test_true_landmarks_are_upright_crosses_where_they_stand(tmp_path):
    # four, 6 m from the middle to each side; the robot is before the right one, and ahead of it is the scale bar
    animate(circle_log(), run_with_error(np.zeros(3), mapped=False), tmp_path / "film.webm", speed=ENDS)
    first = frames_of(tmp_path / "film.webm")[0][HEADER:].astype(int)
    side = len(first)
    assert first.shape[1] == side
    grey = first[:, : 3 * side // 4].sum(axis=2) < 600
    _, _, found, _ = cv2.connectedComponentsWithStats(grey.astype(np.uint8), connectivity=8)
    assert len(found) == 1 + 3, "the background and three crosses"
    assert found[1:, 2:4] == pytest.approx(11, abs=1), "5 pixels to each side of the middle"
    (upper, left, lower) = found[1:, :2] + (found[1:, 2:4] - 1) / 2
    away = side / 2 - left[0]
    assert 0.4 * side < away < 0.5 * side
    assert upper == pytest.approx([side / 2, side / 2 - away], abs=1.5)
    assert left[1] == pytest.approx(side / 2, abs=1.5)
    assert lower == pytest.approx([side / 2, side / 2 + away], abs=1.5)
    for x, y in np.round([upper, left, lower]).astype(int):
        assert grey[y, x - 4 : x + 5].all()
        assert grey[y - 4 : y + 5, x].all()
        assert not grey[[y - 3, y - 3, y + 3, y + 3], [x - 3, x + 3, x - 3, x + 3]].any()
