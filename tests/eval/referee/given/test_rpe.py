"""Relative errors computed by hand, and pairs by exhaustive search."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data import se2
from eval.referee.errors import TOLERANCE, pairs_by_way, rpe_columns

STAMPS = np.arange(101.0)


def line(n=101, step=0.25):
    return np.column_stack([step * np.arange(n), np.zeros(n), np.zeros(n)])


def test_a_scale_error_of_two_percent_is_two_percent_of_the_way():
    truth = line()
    found = rpe_columns(truth * [1.02, 1.0, 1.0], truth, STAMPS)
    assert found["rpe_1m_m"] == pytest.approx(0.02)
    assert found["rpe_10m_m"] == pytest.approx(0.2, rel=0.01)  # the last poses have ways of 9 m and more
    assert found["rpe_frame_m"] == pytest.approx(0.005)
    assert found["rpe_10m_deg"] == 0.0


def test_a_common_motion_and_the_angle_seam_leave_no_error():
    truth = np.column_stack([line()[:, :2], np.linspace(3.0, 3.3, 101)])
    moved = se2.compose(np.array([5.0, 6.0, 1.0]), truth)
    truth[:, 2] = se2.wrap_angle(truth[:, 2])
    assert max(rpe_columns(moved, truth, STAMPS).values()) < 1e-6


def test_a_way_shorter_than_the_distance_leaves_blanks():
    found = rpe_columns(line(9), line(9), STAMPS[:9])
    assert found["rpe_1m_m"] == 0.0
    assert found["rpe_10m_m"] is None
    assert rpe_columns(line(1), line(1), STAMPS[:1])["rpe_frame_m"] is None


def test_poses_without_truth_are_left_out_first():
    truth = line()
    truth[::2] = np.nan
    estimate = np.column_stack([line()[:, :2], 0.01 * np.arange(101)])
    assert rpe_columns(estimate, truth, STAMPS)["rpe_frame_deg"] == pytest.approx(math.degrees(0.02))


@pytest.mark.parametrize("step", [0.1, 1.0009, 7.0])
def test_no_pair_is_across_a_gap_of_the_truth(step):
    truth = line()
    estimate = truth + np.where(np.arange(101) < 50, 0.0, 3.0)[:, None] * [1, 0, 0]
    truth[45:56] = np.nan
    found = rpe_columns(estimate, truth, step * STAMPS)
    assert max(found[f"rpe_{name}_m"] for name in ("frame", "1m", "10m")) < 1e-9


def test_pairs_are_those_of_a_search_through_all_poses():
    rng = np.random.default_rng(3)
    step = rng.uniform(0.0, 0.5, 300) * (rng.random(300) > 0.3)  # it often stands still
    xy = np.column_stack([np.cumsum(step), np.zeros(300)])
    way = np.cumsum(np.abs(np.diff(xy[:, 0], prepend=xy[0, 0])))
    for distance in (0.3, 1.0, 10.0):
        wanted = []
        for i in range(299):
            off = np.abs(way[i + 1 :] - way[i] - distance)
            if off.min() <= TOLERANCE * distance:
                wanted.append((i, i + 1 + int(off.argmin())))
        assert list(zip(*(p.tolist() for p in pairs_by_way(xy, distance)))) == wanted
