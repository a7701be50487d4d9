"""The first fix: at which frame the readings tell the pose, which one, and how sure it is; all worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.formats.mrclam.load import first_fix
from data.se2 import dead_reckoned

NO_MORE = (0.0, 0.0, 0.0)
AHEAD, BESIDE = (2.0, 0.0), (0.0, 2.0)


def fixed(truth, seen, *, time=None, increments=None, noise=0.0, sigma=NO_MORE):
    """The fix of readings `seen`, pairs of frame and landmark, from true poses (N, 3); `noise`: added to the points."""
    frame = np.array([k for k, _ in seen])
    landmark = np.array([at for _, at in seen], float)
    pose = truth[frame]
    away = landmark - pose[:, :2]
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    points = np.stack([c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]], 1) + noise
    time = np.arange(len(truth), dtype=float) if time is None else time
    increments = np.zeros((len(truth), 3)) if increments is None else increments
    return first_fix(time, increments, frame, points, landmark, sigma)


def standing(frames, pose=(0.0, 0.0, 0.0)):
    return np.tile(np.array(pose, float), (frames, 1))


def test_the_fix_is_at_the_frame_of_its_last_reading_and_its_pose_that_of_then():
    """A robot drives a curve and reads one landmark a frame; nobody told it where it starts."""
    increments = np.tile([0.3, 0.02, 0.2], (9, 1))
    increments[0] = 0.0
    truth = dead_reckoned(np.array([3.0, -2.0, 2.5]), increments)
    places = [(4.0, 1.0), (0.0, -3.0)]
    fix = fixed(truth, [(k, places[k % 2]) for k in range(9)], increments=increments)
    assert (fix.frame, fix.readings) == (5, 6)
    off = fix.prior.mean - truth[5]
    assert np.array([off[0], off[1], math.remainder(off[2], math.tau)]) == pytest.approx(0.0, abs=1e-12)
    assert fix.rms == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("apart", "readings"), [(10.0, 6), (10.001, None)])
def test_readings_count_for_ten_seconds(apart, readings):
    time = np.array([5.0, 5.0 + apart])
    fix = fixed(standing(2), [(0, AHEAD), *[(1, BESIDE)] * 2, *[(1, AHEAD)] * 3], time=time)
    assert (fix and fix.readings) == readings
    later = fixed(standing(2), [(0, AHEAD), *[(1, BESIDE)] * 3, *[(1, AHEAD)] * 3], time=time)
    assert later.readings == (7 if readings else 6)


def test_five_readings_or_six_of_one_landmark_fix_nothing():
    assert fixed(standing(1), [(0, AHEAD)] * 3 + [(0, BESIDE)] * 2) is None
    assert fixed(standing(1), [(0, AHEAD)] * 30) is None
    assert fixed(standing(1), [(0, AHEAD)] * 3 + [(0, BESIDE)] * 3).readings == 6


def test_the_covariance_is_that_of_two_points_a_tenth_of_a_metre_off_each():
    """A robot at (3, 1) looks along y, with landmarks 1 and 3 m ahead. The mean point errs by 0.1 / sqrt(2) m, so
    theta, which moves the two by a metre each from their middle, by as much rad; x, which it turns about 2 m
    ahead, errs by its own share and twice that of theta."""
    seen = [(0, (3.0, 2.0))] * 3 + [(0, (3.0, 4.0))] * 3
    fix = fixed(standing(1, (3.0, 1.0, math.pi / 2)), seen, sigma=(0.1, 0.2, 0.3))
    assert fix.prior.mean == pytest.approx([3.0, 1.0, math.pi / 2])
    assert fix.prior.covariance == pytest.approx(
        np.array([[0.025 + 0.01, 0.0, 0.01], [0.0, 0.005 + 0.04, 0.0], [0.01, 0.0, 0.005 + 0.09]])
    )


@pytest.mark.parametrize(
    ("pair", "sure"),
    [
        # theta errs by 0.0707 m over half the distance between the two: 0.15 rad at 0.9428 m
        (((0.0, -0.470), (0.0, 0.470)), False),
        (((0.0, -0.473), (0.0, 0.473)), True),
        # x by 0.0707 m and, as far as the middle is away along y, by what theta errs: 0.25 m at 3.3912 m
        (((-1.0, 3.390), (1.0, 3.390)), True),
        (((-1.0, 3.393), (1.0, 3.393)), False),
        (((3.390, -1.0), (3.390, 1.0)), True),
        (((3.393, -1.0), (3.393, 1.0)), False),
        # all but one place
        (((1.0, 0.0), (1.001, 0.0)), False),
    ],
)
def test_a_fix_waits_until_place_and_heading_are_sure(pair, sure):
    seen = [(0, pair[0])] * 3 + [(0, pair[1])] * 3
    assert (fixed(standing(1), seen) is not None) == sure
    # landmarks better placed come afterwards
    later = fixed(standing(2), seen + [(1, at) for at in ((3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0))])
    assert (later.frame, later.readings) == ((0, 6) if sure else (1, 10))
