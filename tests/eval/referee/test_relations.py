"""Errors against reference relations, computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.truth import Relations
from eval.referee.relations import at_stamps, errors, nearest_frames, relation_errors

RIGHT = math.pi / 2


def test_the_two_orders_differ_by_the_error_of_heading_over_the_length_of_the_relation():
    """Found 10 m ahead, turned left; the reference says 10 m ahead, not turned."""
    a, b = np.zeros((1, 3)), np.array([[10.0, 0.0, RIGHT]])
    relative = np.array([[10.0, 0.0, 0.0]])
    np.testing.assert_allclose(errors(a, b, relative, "kuemmerle"), [[0.0, 0.0, RIGHT]], atol=1e-12)
    np.testing.assert_allclose(errors(a, b, relative, "cartographer"), [[10.0, -10.0, RIGHT]], atol=1e-12)


PATH = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.1], [4.0, 0.0, 0.0]])


def test_mean_population_std_and_maximum_by_row():
    relative = np.array([[1.0, 0.0, 0.0], [1.0, 0.4, 0.0], [2.0, 0.0, 0.0]])
    relations = Relations(np.array([0, 0, 2]), np.array([1, 1, 4]), relative, np.array([1, 0, 1]))
    got = relation_errors(PATH, relations, np.arange(5.0))
    assert got.relations == 3
    assert got.trans_mean_m == pytest.approx(0.4 / 3)
    assert got.trans_std_m == pytest.approx(0.4 * math.sqrt(2.0) / 3)
    assert got.trans_max_m == pytest.approx(0.4)
    assert (got.rot_mean_deg, got.rot_max_deg) == (0.0, 0.0)
    exact = relation_errors(PATH, relations, np.arange(5.0), subset="exact")
    assert (exact.relations, exact.trans_max_m) == (2, 0.0)


def test_rotation_is_in_degrees_and_without_sign():
    relations = Relations(np.array([2, 3]), np.array([3, 4]), np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    got = relation_errors(PATH, relations, np.arange(5.0))
    assert got.rot_mean_deg == got.rot_max_deg == pytest.approx(math.degrees(0.1))
    assert got.rot_std_deg == pytest.approx(0.0, abs=1e-12)


def test_relations_that_say_nothing_of_stamps_or_of_exactness_are_not_asked_for_it_and_lost_poses_not_counted():
    relations = Relations(np.array([0, 1]), np.array([1, 2]), np.array([[1.0, 0.0, 0.0]] * 2))
    time = np.arange(5.0)
    assert relation_errors(PATH, relations, time, tie="time") is None
    assert relation_errors(PATH, relations, time, subset="exact") is None
    lost = PATH.copy()
    lost[2] = np.nan
    assert relation_errors(lost, relations, time).relations == 1
    nothing = relation_errors(np.full((5, 3), np.nan), relations, time)
    assert nothing.relations == 0
    assert math.isnan(nothing.trans_mean_m)
    with pytest.raises(ValueError, match="'rows'; known: row, time"):
        relation_errors(PATH, relations, time, tie="rows")


def test_a_stamp_between_two_frames_is_between_their_poses_and_headings_take_the_shorter_way():
    path = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0], [3.0, 2.0, -3.0]])
    stamp = np.array([0.0, 1.0, 2.0])
    got = at_stamps(path, stamp, np.array([0.25, 0.75, 1.0, 1.5, -4.0, 9.0]))
    turn = 2.0 * (math.pi - 3.0)
    np.testing.assert_allclose(got[0], [0.25, 0.5, 3.0 + 0.25 * turn], atol=1e-12)
    np.testing.assert_allclose(got[1], [0.75, 1.5, -3.0 - 0.25 * turn], atol=1e-12)
    np.testing.assert_allclose(got[2:], [path[1], [2.0, 2.0, -3.0], path[0], path[2]], atol=1e-12)


def test_stamps_that_come_in_bursts_and_go_back_are_tied_to_the_nearest_frame_by_line_order():
    """Frames 1 to 3 were stamped together, frame 4 before them."""
    path = np.array([[float(k), 0.0, 0.0] for k in range(6)])
    stamp = np.array([0.0, 1.0, 1.0, 1.0, 0.9, 2.0])
    assert nearest_frames(stamp, np.array([1.0, 0.91, 0.96, 1.4, 1.6])).tolist() == [1, 4, 1, 1, 5]
    assert nearest_frames(np.array([2.0, 1.0]), np.array([1.5])).tolist() == [0]  # half way: the first in line order
    got = at_stamps(path, stamp, np.array([1.0, 0.92, 0.98, 1.4, 1.6]))
    # 0.92: nearest is frame 4; the next one (2.0) is on that side: 0.02 of 1.1 on. 1.4: nearest is frame 1, whose
    # neighbours (1.0 and 0.0) are not on that side: the frame's own pose
    np.testing.assert_allclose(got[:, 0], [1.0, 4.0 + 0.02 / 1.1, 0.98, 1.0, 4.0 + 0.7 / 1.1], atol=1e-12)


def test_by_time_the_recorded_stamps_count_and_not_the_logs_time():
    recorded = np.array([0.0, 1.0, 1.0, 3.0, 4.0])
    relations = Relations(
        np.array([0]), np.array([4]), np.array([[2.5, 0.0, 0.0]]), stamp=np.array([[0.5, 3.0]]), frame_stamp=recorded
    )
    by_time = relation_errors(PATH, relations, np.arange(5.0), tie="time")
    assert by_time.trans_mean_m == pytest.approx(math.hypot(0.0, 0.25), abs=0.01)
    assert relation_errors(PATH, relations, np.arange(5.0)).trans_mean_m == pytest.approx(1.5)
