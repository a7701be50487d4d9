"""Fixes and closures: expected measurements, their Jacobians, and which frame gets what."""

import numpy as np
from hypothesis import given, strategies as st

from data.pose_measurements import Closures, Fixes, FixKind, FixSource, expected_closure, expected_fix
from data.se2 import compose, inverse, wrap_angle

coordinate = st.floats(-50.0, 50.0)
poses = st.tuples(coordinate, coordinate, st.floats(-3.1, 3.1)).map(np.array)


def numeric(function, x):
    """Central differences (d, 3) of a function of a pose."""
    columns = []
    for step in 1e-6 * np.eye(3):
        high, low = function(x + step), function(x - step)
        difference = high - low
        difference[-1] = wrap_angle(float(difference[-1])) if len(difference) != 2 else difference[-1]
        columns.append(difference / 2e-6)
    return np.stack(columns, 1)


@given(poses, st.tuples(st.floats(-2, 2), st.floats(-2, 2)), st.sampled_from(list(FixKind)))
def test_a_fix_measures_the_composed_pose_of_its_source(pose, lever, kind):
    source = FixSource("gps", lever, 0.3)
    z, H = expected_fix(pose, kind, source)
    whole = compose(pose, np.array([*lever, 0.3]))
    np.testing.assert_allclose(z, {0: whole[:2], 1: whole[2:], 2: whole}[int(kind)], atol=1e-12)
    np.testing.assert_allclose(H, numeric(lambda x: expected_fix(x, kind, source)[0], pose), atol=1e-6)


@given(poses, poses)
def test_a_closure_measures_the_relative_pose(first, second):
    z, H1, H2 = expected_closure(first, second)
    np.testing.assert_allclose(compose(first, z)[:2], second[:2], atol=1e-9)
    np.testing.assert_allclose(z[:2], compose(inverse(first), second)[:2], atol=1e-9)
    np.testing.assert_allclose(H1, numeric(lambda x: expected_closure(x, second)[0], first), atol=1e-6)
    np.testing.assert_allclose(H2, numeric(lambda x: expected_closure(first, x)[0], second), atol=1e-6)


def test_each_frame_gets_its_fixes_and_the_closures_it_ends():
    eye = np.eye(3)[None]
    fixes = Fixes(np.array([1, 1, 4]), np.zeros(3), np.zeros(3), np.zeros((3, 3)), eye.repeat(3, 0), (FixSource("a"),))
    assert fixes.of(0) is None
    assert fixes.of(1).row.tolist() == [0, 1]
    assert len(fixes.of(1).z) == 2
    assert fixes.of(4).row.tolist() == [2]
    none = np.zeros(3)
    closures = Closures(np.array([0, 5, 2]), np.array([3, 2, 6]), np.zeros((3, 3)), eye.repeat(3, 0), none, ("a",))
    assert closures.of(2) is None
    assert closures.of(5).row.tolist() == [1]
    assert closures.last_use() == {0: 3, 2: 6}
