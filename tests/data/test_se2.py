"""SE(2) helpers: group laws, interpolation across the seam."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from data import se2

poses = arrays(float, 3, elements=st.floats(-50, 50))


@given(poses, poses, poses)
def test_composition_is_a_group(a, b, c):
    def same(x, y):
        return np.abs(se2.pose_error(x, y)).max() < 1e-9

    assert same(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))
    assert same(se2.compose(a, se2.inverse(a)), np.zeros(3))
    assert same(se2.compose(a, se2.between(a, b)), b)


@given(poses, arrays(float, (4, 2), elements=st.floats(-50, 50)))
def test_points_follow_the_pose(pose, points):
    moved = se2.transform_points(pose, points)
    assert np.allclose(moved, points @ se2.rotation(pose[2]).T + pose[:2], atol=1e-9)
    for p, m in zip(points, moved, strict=True):
        assert np.allclose(se2.compose(pose, np.array([*p, 0.0]))[:2], m, atol=1e-9)


def test_headings_are_interpolated_along_the_shorter_way():
    time = np.array([0.0, 1.0])
    ends = np.array([[0.0, 0.0, math.radians(179)], [1.0, 2.0, math.radians(-179)]])
    middle = se2.interpolate(time, ends, np.array([0.5]))[0]
    assert middle[:2].tolist() == [0.5, 1.0]
    assert abs(middle[2]) == pytest.approx(math.pi)


def test_errors_of_headings_close_across_the_seam_are_small():
    e = se2.pose_error(np.array([0, 0, math.radians(359.9)]), np.array([0, 0, math.radians(0.1)]))
    assert math.degrees(e[2]) == pytest.approx(-0.2)


@given(poses, arrays(float, (5, 3), elements=st.floats(-3, 3)))
def test_dead_reckoning_composes_the_increments_one_by_one(start, increments):
    path, pose = se2.dead_reckoned(start, increments), start
    for reckoned, increment in zip(path, increments, strict=True):
        pose = se2.compose(pose, increment)
        assert np.abs(se2.pose_error(reckoned, pose)).max() < 1e-9
