"""Every sensor predicts, linearizes and inverts alike, wraps angles once, and stays finite at its own position.

Fixes and closures: expected measurements, their Jacobians, and which frame gets what.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from data.pose_measurements import Closures, Fixes, FixKind, FixSource, expected_closure, expected_fix
from data.se2 import compose, inverse, wrap_angle
from data.sensors import LINE, MIN_RANGE, Line, RangeBearing, RelativePoint, residual
from tests.quick import examples

SENSORS = [
    RangeBearing(), RelativePoint(), RangeBearing(rotation=0.4, translation=(0.2, -0.1)),
    RelativePoint(rotation=-1.5, translation=(0.0, 0.3)), Line(), Line(rotation=0.4, translation=(0.2, -0.1)),
]  # fmt: skip
angle = st.floats(-math.pi, math.pi)
coordinate = st.floats(-20, 20)


@settings(max_examples=examples(150), deadline=None)
@given(st.sampled_from(SENSORS), coordinate, coordinate, angle, coordinate, coordinate)
def test_jacobians_meet_central_differences_and_inverse_undoes_predict(sensor, x, y, theta, lx, ly):
    pose, landmark = np.array([x, y, theta]), np.array([[lx, ly]])
    z, Hx, Hl = sensor.linearize(pose, landmark)
    assume(sensor.polar(z)[0, 0] > 0.3)
    h = 1e-6
    for i in range(3):
        d = np.eye(3)[i] * h
        numeric = sensor.residual(sensor.predict(pose + d, landmark), sensor.predict(pose - d, landmark))[0] / (2 * h)
        assert np.abs(Hx[0, :, i] - numeric).max() < 1e-6
    for i in range(2):
        d = np.eye(2)[i] * h
        numeric = sensor.residual(sensor.predict(pose, landmark + d), sensor.predict(pose, landmark - d))[0] / (2 * h)
        assert np.abs(Hl[0, :, i] - numeric).max() < 1e-6
    back, Gx, Gz = sensor.inverse(pose, z)
    if sensor.sees_points:
        assert np.abs(back - landmark).max() < 1e-10
    else:
        assert np.abs(sensor.residual(back, landmark)).max() < 1e-10, "a wall, like its measurement, has two names"
        z, Hx, Hl = sensor.linearize(pose, back)
    # l = g(x, z) inverts z = h(x, l): Hl Gz = I and Hx + Hl Gx = 0
    assert np.allclose(Hl[0] @ Gz[0], np.eye(2), atol=1e-9)
    assert np.allclose(Hx[0] + Hl[0] @ Gx[0], 0, atol=1e-8)


@settings(max_examples=examples(100), deadline=None)
@given(coordinate, coordinate, angle, st.floats(0.5, 9), angle, st.floats(-8, 8), st.floats(-8, 8))
def test_a_wall_is_where_its_points_are(x, y, theta, d, phi, along, other):
    # two points of a wall as the robot sees it; in the world they lie on rho, alpha
    body = [[d * math.cos(phi) - t * math.sin(phi), d * math.sin(phi) + t * math.cos(phi)] for t in (along, other)]
    (rho, alpha), *_ = (row[0] for row in Line().inverse(np.array([x, y, theta]), np.array([[d, phi]])))
    for bx, by in body:
        px = x + bx * math.cos(theta) - by * math.sin(theta)
        py = y + bx * math.sin(theta) + by * math.cos(theta)
        assert abs(px * math.cos(alpha) + py * math.sin(alpha) - rho) < 1e-9
    for name in ([rho, alpha], [-rho, alpha + math.pi]):
        z = Line().predict(np.array([x, y, theta]), np.array([name]))
        assert np.allclose(z[0], [d, wrap_angle(phi)], atol=1e-9) or abs(abs(wrap_angle(phi)) - math.pi) < 1e-9


@pytest.mark.parametrize(("z", "z_hat", "expected"), [
    ([0.20, 0.1], [0.15, 0.3], [0.05, -0.2]), ([0.02, 0.1], [0.01, 0.1 - math.pi], [-0.03, 0.0]),
    ([2.0, math.pi - 0.1], [2.0, -math.pi + 0.1], [0.0, -0.2]),
])  # fmt: skip
def test_the_innovation_of_a_wall_does_not_depend_on_which_side_it_is_named_from(z, z_hat, expected):
    assert np.allclose(residual(LINE, *z, np.array(z_hat)), expected)
    assert np.allclose(Line().residual(np.array(z), np.array(z_hat)), expected)


@pytest.mark.parametrize("heading", [0.3, np.pi - 1e-9, -np.pi + 1e-9])
def test_bearings_wrap_at_the_seam(heading):
    sensor = RangeBearing()
    behind = np.array([[-3 * math.cos(heading), -3 * math.sin(heading)]])
    assert abs(abs(sensor.predict(np.array([0, 0, heading]), behind)[0, 1]) - math.pi) < 1e-6
    assert abs(sensor.residual(np.array([[3.0, math.pi]]), np.array([[3.0, -math.pi]]))[0, 1]) < 1e-12
    assert RelativePoint().residual(np.array([[3.0, 4.0]]), np.array([[3.0, -4.0]]))[0, 1] == 8.0


@pytest.mark.parametrize("offset", [0.0, 0.1 * MIN_RANGE])
def test_a_landmark_at_the_sensor_has_zero_jacobians(offset):
    z, Hx, Hl = RangeBearing().linearize(np.array([1.0, 2.0, 0.3]), np.array([[1.0 + offset, 2.0]]))
    assert np.isfinite(z).all()
    assert not Hx.any()
    assert not Hl.any()


def test_extrinsic_is_p_sensor_equals_R_p_body_plus_T():
    # a camera whose z axis looks forward and whose x axis looks right: x_s = -y_b, z_s = x_b + 0.2
    camera = RelativePoint(rotation=math.pi / 2, translation=(0.0, 0.2))
    assert np.allclose(camera.predict(np.zeros(3), np.array([[3.0, 1.0]])), [[-1.0, 3.2]])


def test_field_of_view_may_lie_across_the_seam_and_be_widened():
    rear = RangeBearing(max_range=5.0, min_angle=math.radians(150), max_angle=math.radians(210))
    z = np.array([[4.0, math.pi], [4.0, -math.pi + 0.1], [4.0, 0.0], [6.0, math.pi], [4.0, math.radians(145)]])
    assert rear.in_view(z).tolist() == [True, True, False, False, False]
    assert rear.in_view(z, margin_range=2.0, margin_angle=math.radians(6)).tolist() == [True, True, False, True, True]
    edge = RelativePoint(min_angle=-math.pi / 2, max_angle=math.pi / 2)
    assert edge.in_view(np.array([[0.0, 1.0], [0.0, -1.0]])).all(), "both ends are inside"


@settings(max_examples=examples(200))
@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_lie_in_the_half_open_circle_and_keep_their_direction(a):
    w = wrap_angle(a)
    assert -math.pi < w <= math.pi
    assert abs(math.remainder(w - a, 2 * math.pi)) < 1e-9
    if -math.pi < a <= math.pi:
        assert w == a


far = st.floats(-50.0, 50.0)
poses = st.tuples(far, far, st.floats(-3.1, 3.1)).map(np.array)


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
