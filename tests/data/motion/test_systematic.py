"""Systematic errors: what each does to an increment, Jacobians against central differences, and their priors."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from data.errors import UsageError
from data.inputs import ERRORS, Increment, Prior, Systematic
from data.motion.priors import AUTO, PRIORS, read_errors, systematic, written
from data.motion.systematic import BETWEEN_KNOTS, corrected, corrected_inputs, knots, places, sensor_frame
from data.se2 import compose, inverse, pose_error
from data.sensors import RangeBearing, RelativePoint
from data.worlds.registry import named_log

EVERY = Systematic(tuple(ERRORS), np.full(7, 0.1))
PLACE = places(EVERY)
small = st.floats(-0.1, 0.1)
errors = st.tuples(*[small] * 7).map(np.array)
motions = st.tuples(st.floats(-2, 2), st.floats(-0.5, 0.5), st.floats(-1, 1)).map(np.array)
poses = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-3, 3)).map(np.array)
MOUNT = np.array([0.4, -0.2, 0.7])
NONE = np.zeros(3)


def of(motion, b, mount=NONE, noise=None):
    return corrected(Increment(motion, np.eye(3) if noise is None else noise), b, PLACE, mount)


def by_hand(motion, b, mount):
    e = dict(zip(ERRORS, b, strict=True))
    d = np.hypot(*motion[:2]) * (-1.0 if motion[0] < 0 else 1.0)
    extra = d * (e["curvature"] + e["drift"]) + (e["left"] if motion[2] > 0 else e["right"]) * motion[2]
    half = np.array([0.0, 0.0, extra / 2])
    step = np.array([(1 + e["scale"]) * motion[0], (1 + e["scale"]) * motion[1], motion[2]])
    body = compose(compose(half, step), half)
    seen = compose(mount, np.array([0.0, 0.0, -e["bearing"]]))
    there = compose(compose(inverse(seen), body), seen)
    return np.array([(1 + e["range"]) * there[0], (1 + e["range"]) * there[1], there[2]])


def differences(f, x, h=1e-6):
    return np.array([(f(x + h * unit) - f(x - h * unit)) / (2 * h) for unit in np.eye(len(x))]).T


@given(motions, errors)
def test_an_increment_is_corrected_as_rigid_motions_say(motion, b):
    assert np.abs(pose_error(of(motion, b, MOUNT).mean, by_hand(motion, b, MOUNT))).max() < 1e-12


@given(motions.filter(lambda m: abs(m[0]) > 1e-3 and abs(m[2]) > 1e-3), errors)
def test_the_jacobian_to_the_errors_is_that_of_central_differences(motion, b):
    found = differences(lambda q: of(motion, q, MOUNT).mean, b)
    assert np.allclose(of(motion, b, MOUNT).A, found, atol=1e-8)


@given(motions, errors)
def test_noise_of_the_odometry_is_carried_to_the_sensor(motion, b):
    seen = compose(MOUNT, np.array([0.0, 0.0, -b[6]]))
    plain = of(motion, np.concatenate([b[:5], [0.0, 0.0]])).mean

    def there(w):
        moved = compose(compose(inverse(seen), plain + w), seen)
        return np.array([(1 + b[5]) * moved[0], (1 + b[5]) * moved[1], plain[2] + w[2]])

    G = differences(there, np.zeros(3))
    noise = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.002], [0.0, 0.002, 0.01]])
    assert np.allclose(of(motion, b, MOUNT, noise).covariance, G @ noise @ G.T, atol=1e-8)


@pytest.mark.parametrize("sensor", [RangeBearing(rotation=0.3, translation=(0.2, -0.5)), RelativePoint(rotation=-0.4)])
@given(poses, errors)
def test_in_the_sensors_frame_a_reading_with_its_errors_is_right(sensor, pose, b):
    frame = sensor_frame(EVERY, sensor, Prior(np.array([1.0, 2.0, 0.3]), np.eye(3)))
    point = np.array([[7.0, -3.0]])
    true = sensor.polar(sensor.predict(pose, point))[0]
    there = frame.poses_in(pose[None], b[None])[0]
    seen = frame.sensor(sensor)
    polar = seen.polar(seen.predict(there, frame.points_in(point, b)[0]))[0]
    assert polar[0] == pytest.approx((1 + b[5]) * true[0])
    assert abs(pose_error(np.array([0, 0, polar[1]]), np.array([0, 0, true[1] + b[6]]))[2]) < 1e-9


@given(poses, errors)
def test_there_and_back_a_pose_is_the_same_and_its_jacobian_that_of_differences(pose, b):
    sensor = RangeBearing(rotation=0.3, translation=(0.2, -0.5))
    frame = sensor_frame(EVERY, sensor, Prior(np.array([1.0, 2.0, 0.3]), np.eye(3)))
    there = frame.poses_in(pose[None], b[None])
    back, J = frame.poses_out(there, b[None])
    assert np.abs(pose_error(back[0], pose)).max() < 1e-9

    def out(x):
        moved = frame.poses_out(x[None, :3], x[None, 3:])[0][0]
        return np.array([*moved[:2], pose_error(moved, pose)[2]])

    assert np.allclose(J[0], differences(out, np.concatenate([there[0], b])), atol=1e-6)
    point, scale, to_errors = frame.points_out(pose[None, :2], b)
    assert np.allclose(frame.points_in(point, b)[0], pose[None, :2])
    assert np.allclose(to_errors[0], differences(lambda q: frame.points_out(pose[None, :2], q)[0][0], b), atol=1e-7)
    assert scale == pytest.approx(1 / (1 + b[5]))


def test_a_prior_there_is_the_same_belief():
    sensor, prior = (
        RangeBearing(translation=(0.5, 0.1)),
        Prior(np.array([1.0, 2.0, 0.3]), np.diag([0.1, 0.2, 0.05]) ** 2),
    )
    frame = sensor_frame(EVERY, sensor, prior)
    mean, P = frame.prior_in(prior, EVERY.sigma)
    pose, J = frame.poses_out(mean[None, :3], mean[None, 3:])
    assert np.allclose(pose[0], prior.mean)
    assert np.allclose(J[0] @ P @ J[0].T, prior.covariance)
    assert np.allclose(P[3:, 3:], np.diag(EVERY.sigma**2))


def test_knots_are_so_far_apart_and_a_robot_at_rest_makes_none():
    step = np.array([[0.0, 0.0, 0.0], *[[1.0, 0.0, 0.0]] * 35, *[[0.0, 0.0, 0.1]] * 5])
    number, ended = knots(50.0, step)
    assert ended.tolist() == [BETWEEN_KNOTS * 50.0] * 3
    assert number.tolist() == [0] * 11 + [1] * 10 + [2] * 10 + [3] * 10


@pytest.mark.parametrize(
    "names", [(), ("turn",), ("curvature", "scale"), ("scale", "scale")], ids=["none", "unknown", "order", "twice"]
)
def test_errors_that_are_not_known_are_refused(names):
    with pytest.raises(ValueError, match="systematic errors"):
        Systematic(names, np.full(len(names), 0.1))


IN_A_NAME = "scale=-0.1+curvature=0.03+left=0.05+drift=0.002+bearing_error=0.04"


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_point"])
def test_less_its_true_errors_odometry_and_readings_are_those_of_the_world_without(sensor):
    plain = named_log(f"arena:2:frames=60+sensor={sensor}").inputs()
    off = named_log(f"arena:2:frames=60+sensor={sensor}+{IN_A_NAME}")
    found = corrected_inputs(off.inputs(), off.truth.errors)
    assert np.abs(pose_error(found.increments.mean, plain.increments.mean)).max() < 1e-12
    if sensor == "range_bearing":
        np.testing.assert_allclose(found.observations.z, plain.observations.z, atol=1e-12)
        np.testing.assert_allclose(found.observations.R, plain.observations.R)
    else:  # the noise is turned along with the point
        assert np.linalg.norm(found.observations.z - plain.observations.z, axis=1).max() < 0.04 * 5 * 0.1
        np.testing.assert_allclose(found.observations.R, plain.observations.R, atol=1e-12)


def test_ranges_shrink_with_their_noise():
    off = named_log("arena:2:frames=60+range_error=0.25")
    found = corrected_inputs(off.inputs(), off.truth.errors).observations
    o = off.inputs().observations
    np.testing.assert_allclose(found.z[:, 0] * 1.25, o.z[:, 0])
    np.testing.assert_allclose(found.R[:, 0, 0] * 1.25**2, o.R[:, 0, 0])
    np.testing.assert_array_equal(found.R[:, 1, 1], o.R[:, 1, 1])


def test_every_error_has_a_wide_and_a_tight_prior_with_a_reason():
    assert list(PRIORS) == list(ERRORS)
    assert all(0.0 < p.tight < p.wide and p.why for p in PRIORS.values())


def test_a_stated_sigma_counts_and_else_the_wide_prior():
    found = systematic(read_errors("--calibrate", "bearing,scale=0.03"))
    assert found.names == ("scale", "bearing")
    assert found.sigma.tolist() == [0.03, PRIORS["bearing"].wide]


@pytest.mark.parametrize("tight", [True, False])
def test_what_is_written_is_read_again(tight):
    text = written(["drift", "left"], tight=tight)
    assert read_errors("", ",".join(text)) == text
    sigma = systematic(text).sigma.tolist()
    assert sigma == [getattr(PRIORS[n], "tight" if tight else "wide") for n in ("left", "drift")]


@pytest.mark.parametrize(("value", "read"), [
    (True, (AUTO,)), (False, ()), ("auto", (AUTO,)), (["auto"], (AUTO,)), (" auto ,", (AUTO,)),
    ("bearing,scale", ("scale", "bearing")), (["bearing", "scale"], ("scale", "bearing")),
    (("range = 0.1,drift", "left"), ("left", "drift", "range=0.1")), (" , left,", ("left",)),
])  # fmt: skip
def test_names_come_as_one_text_or_as_a_list_and_are_put_in_their_order(value, read):
    assert read_errors("--calibrate", value) == read


NAMES = "scale, curvature, left, right, drift, range, bearing"


@pytest.mark.parametrize(("value", "said"), [
    (3, f"calibrate 3: names are needed, of {NAMES}, or auto"),
    (["scale", 0.1], f"calibrate ['scale', 0.1]: names are needed, of {NAMES}, or auto"),
    ("", f"calibrate: a name is needed, of {NAMES}, or auto"),
    ("left,wheels", f"calibrate wheels: unknown; known: {NAMES}, each NAME or NAME=SIGMA; or auto"),
    ("left,range,left=2", "calibrate left,range,left=2: left is named twice"),
    ("left=0", "calibrate left=0: a positive prior sigma is needed"),
    ("left=wide", "calibrate left=wide: a positive prior sigma is needed"),
])  # fmt: skip
def test_what_cannot_be_read_is_said_with_what_would_be_right(value, said):
    with pytest.raises(UsageError) as wrong:
        read_errors("calibrate", value)
    assert str(wrong.value) == said
