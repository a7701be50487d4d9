"""The truth at other stamps: exact at equal stamps, interpolated in short gaps, unknown elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from eval.referee.given.runs import match

TIME = np.array([0.0, 0.5, 1.0, 3.0, 3.5, 4.0, 4.5])
TRUTH = np.array([
    [0.0, 0.0, 3.0], [1.0, 0.0, 3.1], [2.0, 2.0, -3.1], [5.0, 2.0, 0.0], [np.nan] * 3, [6.0, 2.0, 0.2], [7.0, 2.0, 0.4],
])  # fmt: skip


def test_stamps_of_the_truth_take_it_bit_for_bit():
    found = match(TIME, TIME, TRUTH)
    assert found.truth.tobytes() == TRUTH.tobytes()
    assert (found.matched, found.unmatched, found.interpolated) == (6, 1, 0)


def test_microseconds_that_were_written_make_no_difference():
    found = match(TIME + 4e-7, TIME, TRUTH)
    assert (found.matched, found.interpolated) == (6, 0)  # the last one, too, which is beyond the span


def test_between_two_truths_the_heading_goes_the_shorter_way():
    found = match(np.array([0.75]), TIME, TRUTH)
    assert found.truth[0] == pytest.approx([1.5, 1.0, np.pi], abs=1e-9) or found.truth[0, 2] == pytest.approx(-np.pi)
    assert found.interpolated == 1


@pytest.mark.parametrize("stamp", [-0.01, 4.51, 2.0, 3.2, 3.5, 3.7])
def test_outside_in_a_gap_and_next_to_an_unknown_truth_it_is_unknown(stamp):
    found = match(np.array([stamp]), TIME, TRUTH)
    assert np.isnan(found.truth).all()
    assert (found.matched, found.unmatched) == (0, 1)


def test_the_gap_is_the_one_asked_for():
    assert match(np.array([2.0]), TIME, TRUTH, 2.0).matched == 1
    assert match(np.array([0.25]), TIME, TRUTH, 0.4).matched == 0


def test_truths_a_second_apart_are_near_whatever_their_microseconds():
    truth_time = np.array([0.0, 1.0 + 6e-7, 2.0 + 8e-7, 3.0 + 1.7e-6])
    truth = np.column_stack([np.array([0.0, 1.0, 1.0, 2.0]), np.zeros(4), np.zeros(4)])
    found = match(np.array([0.5, 2.5]), truth_time, truth)
    assert found.interpolated == 2
    # the two in the middle are half a metre from the chord of their neighbours
    assert found.error == pytest.approx(0.25 * 0.5, rel=1e-5)
    assert np.isnan(match(np.array([0.5]), truth_time, truth, 0.9).error)
