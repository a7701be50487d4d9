"""The grid as the tutorials' programs have it: odometry of the frame's own instant, no gaps, frames not used."""

from __future__ import annotations

import numpy as np

from data.formats.mrclam.load import Grid
from tests.data.formats.mrclam import world

ODOMETRY = "Robot1_Odometry.dat"


def ramp(files, rows):
    """Odometry whose speed is 0.1 (t - 1) m/s, at 1 s and some tenths of a second."""
    head = files[ODOMETRY].splitlines()[:4]
    lines = [f"{world.T0 + 1.0 + k / 10:.3f} {0.01 * k:.3f} 0.000" for k in rows]
    return {**files, ODOMETRY: "\n".join(head + lines) + "\n"}


def test_a_frame_may_move_with_the_odometry_at_its_own_instant(files, load):
    log = load(ramp(files, list(range(101))), grid=Grid(0.02, own=True))
    expected = 0.1 * log.recorded.time[1:] * 0.02
    np.testing.assert_allclose(log.recorded.increments.mean[1:, 0], expected, atol=1e-9)


def test_without_gaps_odometry_is_interpolated_across_them_and_held_back_before_its_first_row(files, load):
    rows = [k for k in range(20, 101) if not 40 < k < 70]  # from 2 s after the world's first row; none for 3 s
    log = load(ramp(files, rows), grid=Grid(0.02, gapless=True))
    assert not any("gap" in note for note in log.notes)
    t = log.recorded.time[:-1] + float(str(log.source["first_stamp"])) - world.T0
    assert t[0] < 1.0 + 1e-6  # where the ground truth starts, before the odometry does
    expected = np.maximum(0.1 * (t - 1.0), 0.2) * 0.02
    np.testing.assert_allclose(log.recorded.increments.mean[1:, 0], expected, atol=1e-9)


def test_frames_whose_first_reading_is_of_a_landmark_are_left_out(files, load):
    plain, log = load(files, grid=0.5), load(files, grid=Grid(0.5, skip_led_by=6))
    frame, shown = plain.recorded.observations.frame, plain.truth.landmark_of
    assert shown is not None
    led = np.array([shown[np.flatnonzero(frame == k)[0]] == 6 for k in frame])
    assert 0 < led.sum() < len(led)
    assert np.any(shown[~led] == 6)  # it may come later in a frame
    np.testing.assert_array_equal(log.recorded.observations.frame, frame[~led])
    np.testing.assert_array_equal(log.recorded.observations.z, plain.recorded.observations.z[~led])
    assert any(note.startswith(f"{led.sum()} observations dropped") for note in log.notes)
