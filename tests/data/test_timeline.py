"""Frames hold every given instant and no long gap; truth is known only where truth was recorded."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data.timeline import frame_times, truth_at

instants = st.lists(st.floats(-50.0, 50.0), max_size=30)


@given(instants, st.floats(0.05, 20.0), st.sampled_from([0.0, 1.3e9]))
def test_frames_ascend_hold_every_instant_and_leave_no_long_gap(at, max_gap, epoch):
    at = np.array(at) + epoch
    frames = frame_times(at, epoch - 50.0, epoch + 50.0, max_gap)
    assert (np.diff(frames) > 0).all()
    assert frames[0] == epoch - 50.0
    assert frames[-1] == epoch + 50.0
    assert np.array_equal(frames[np.searchsorted(frames, at)], at)
    assert np.diff(frames).max() <= max_gap * (1 + 1e-12) + 1e-6


def test_a_long_gap_is_cut_into_the_fewest_equal_parts():
    assert frame_times(np.array([0.5, 3.0]), 0.0, 3.2).tolist() == pytest.approx(
        [0.0, 0.5, 0.5 + 2.5 / 3, 0.5 + 5 / 3, 3.0, 3.2]
    )
    assert frame_times(np.array([]), 0.0, 2.0, 1.0).tolist() == [0.0, 1.0, 2.0]
    assert frame_times(np.array([]), 7.0, 7.0).tolist() == [7.0]


def test_stamps_one_second_apart_need_no_keyframe_whatever_their_rounding():
    at = np.array([3.4, 4.4, 5.4])
    assert at[1] - at[0] > 1.0  # by a rounding
    assert np.array_equal(frame_times(at, at[0], at[-1]), at)


def test_truth_is_unknown_outside_its_span_and_across_a_gap():
    time = np.array([1.0, 2.0, 4.0, 4.5])
    pose = np.column_stack([time, -time, np.zeros(4)])
    at = np.array([0.999, 1.0, 1.5, 2.0, 2.5, 4.0, 4.25, 4.5, 4.501])
    found = truth_at(time, pose, at)
    known = np.array([False, True, True, True, False, True, True, True, False])
    assert np.array_equal(np.isfinite(found).all(axis=1), known)
    assert np.array_equal(np.isnan(found).all(axis=1), ~known)
    assert found[known, 0] == pytest.approx(at[known])


def test_a_row_marked_unknown_hides_its_neighbourhood_and_nothing_else():
    time = np.arange(0.0, 2.01, 0.5)
    pose = np.column_stack([time, np.zeros(5), np.full(5, 3.0)])
    pose[2, 0] = np.nan
    at = np.array([0.0, 0.4, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75])
    found = truth_at(time, pose, at)
    assert np.isnan(found[:, 0]).tolist() == [False, False, False, True, True, True, False, False]
    assert found[[0, 1, 2, 6, 7], 2] == pytest.approx(3.0)
