"""The film: everything where and when it should be, at the pace asked for, and the same bytes twice."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from data.errors import SlamrefError
from data.inputs import Inputs
from data.notice import stopped
from data.result import Failure
from eval.figures.film import FPS, HEADER, animate, pace_of
from eval.figures.style import style_of
from tests.builders.logs import inputs_of, still
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


def test_the_same_film_twice_has_the_same_bytes_and_is_a_webm_that_says_nothing(tmp_path, capfd):
    for name in ("a", "b"):
        run = run_with_error(np.array([0.5, 0.0, 0.0]))
        animate(circle_log(), run, tmp_path / "films" / f"{name}.webm", speed=4 * EVERY_FOURTH)
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
    colour = 255.0 * np.array(to_rgb(style_of("ekf").colour)[::-1])
    coloured = [np.abs(f[HEADER:] - colour).sum(axis=2) < 60 for f in frames_of(tmp_path / "film.webm")]
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
def test_a_landmark_appears_when_it_is_first_seen_where_it_is_at_the_end(tmp_path):
    run = run_with_error(np.zeros(3))
    corner = replace(run.map, xy=np.array([[5.0, 5.0]]), first_frame=np.array([10]))
    animate(circle_log(), replace(run, map=corner), tmp_path / "film.webm", speed=EVERY_FOURTH)
    frames = [f[HEADER:].min(axis=2) < 200 for f in frames_of(tmp_path / "film.webm")]
    n = len(frames[0]) // 6  # the corners of the square scene, which the circle does not touch
    assert [bool(f[:n, -n:].any()) for f in frames] == [False] * 3 + [True] * 8  # frames 0, 4, 8 of the log
    assert not any(f[-n:, :n].any() for f in frames)


@pytest.mark.parametrize("phase", ["online", "final"])
@pytest.mark.parametrize("truth", [True, False])
def test_any_phase_is_filmed_with_and_without_truth_and_after_a_failure(tmp_path, phase, truth):
    halted = Failure("diverged", 3, stopped("covariance not positive semidefinite"))
    run = run_with_error(np.zeros(3), phases=(phase,), failure=halted, mapped=truth)
    log = circle_log(truth=truth, landmarks=truth, known_map=not truth)
    animate(log, run, tmp_path / "film.webm", speed=ENDS)
    assert len(frames_of(tmp_path / "film.webm")) == 2


def test_a_path_that_leaves_the_scene_is_cut_and_a_film_that_cannot_be_written_is_a_clear_error(tmp_path):
    away = run_with_error(np.outer(np.arange(FRAMES), [1e6, 0.0, 0.0]))
    animate(circle_log(), away, tmp_path / "film.webm", speed=ENDS)
    assert len(frames_of(tmp_path / "film.webm")) == 2
    (tmp_path / "folder.webm").mkdir()
    with pytest.raises(SlamrefError, match=r"folder\.webm: cannot be written as a WebM film"):
        animate(circle_log(), run_with_error(np.zeros(3)), tmp_path / "folder.webm")


def inputs_at(time, *, index=False) -> Inputs:
    return inputs_of(still(len(time)), time=time, time_is_index=index)


def test_the_pace_is_as_asked_for_or_real_time_that_fits_a_minute_or_frames_a_second():
    time = np.array([0.0, 0.1, 3.0, 3.05, 10.0])
    for speed in (1.0, 2.5, 0.5):
        _, frames = pace_of(inputs_at(time), speed)
        assert len(frames) == pytest.approx(10.0 / speed * FPS, abs=1.01)
        for picture, frame in enumerate(frames.tolist()):
            now = picture * speed / FPS
            assert time[frame] <= now + 1e-6  # the newest frame there is at that instant
            assert frame == 4 or time[frame + 1] > now
        assert frames[-1] == 4
    assert pace_of(inputs_at(np.arange(44.0), index=True))[0] == "5 frames a second"
    text, frames = pace_of(inputs_at(np.arange(44.0), index=True), 10.0)
    assert frames.tolist() == [k // 2 for k in range(87)]
    assert text == "10 frames a second"


@pytest.mark.parametrize(("length", "speed"), [(30.0, 1), (60.0, 1), (61.0, 2), (130.0, 3), (1500.0, 25), (1e4, 167)])
def test_unasked_it_is_real_time_or_the_next_whole_speed_that_fits_a_minute(length, speed):
    text, frames = pace_of(inputs_at(np.linspace(0.0, length, 50)))
    assert len(frames) <= 60 * 20 + 1
    assert text == f"{speed} x real time"
