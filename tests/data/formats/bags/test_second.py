"""A second topic of odometry in a bag: closures between successive frames, with the noise that its twists state."""

import numpy as np
import pytest

from data.se2 import between, compose, interpolate
from tests.data.formats.bags.made import Full

TIMES = np.arange(0.0, 4.01, 0.5)
CAMERA = np.column_stack([0.4 * TIMES, 0.01 * TIMES**2, 0.05 * TIMES])


@pytest.fixture
def maker() -> Full:
    made = Full()
    made.drive(TIMES)
    made.mounting("base_link", "camera", 0.25, 0.1, 0.5)
    made.poses(1.25, [(2.0, 0.5)])
    return made


@pytest.fixture
def bag(convert, tmp_path):
    words = ("out", "--point-sigma", "0.1", "--odom", "/odom")
    return lambda maker, *more, **status: convert({}, "bag", maker.save(tmp_path), *words, *more, **status)


def with_camera(maker, twist=0.0, body="base_link", times=TIMES):
    for t, pose in zip(TIMES, CAMERA, strict=True):
        if t in times:
            maker.odometry(t, pose, "/vo", twist, body)
    return maker


def test_it_is_another_measurement_of_each_step_that_it_covers(maker, bag):
    log, said = bag(with_camera(maker, 0.04, times=TIMES[:7]), "--second-odom", "/vo")
    assert "/vo is a second odometry: closures between 3 of 5 pairs of successive frames; noise by the twist" in said
    r = log.recorded
    closures, time = r.closures, r.time[:4]
    assert time[:3].tolist() == [0.0, 0.625, 1.25]
    assert (closures.frame1.tolist(), closures.frame2.tolist()) == ([0, 1, 2], [1, 2, 3])
    assert closures.sources == ("vo",)
    at = interpolate(TIMES, CAMERA, time)
    np.testing.assert_allclose(closures.relative, between(at[:-1], at[1:]), atol=1e-12)
    # twists hold half a second: C 0.5^2 of an interval, and the same share of a part
    along = 0.04 * 0.5 * np.diff(time)
    np.testing.assert_allclose(closures.covariance[:, 0, 0], along, rtol=2e-2)
    np.testing.assert_allclose(closures.covariance[:, 2, 2], 0.1 * along, rtol=1e-9)
    assert r.increments.mean[1, 2] == pytest.approx(0.0625), "the first one is the motion"


def test_a_camera_is_carried_to_the_robot_by_tf(maker, bag):
    mounted = np.array([0.25, 0.1, 0.5])
    for t, pose in zip(TIMES, CAMERA, strict=True):
        maker.odometry(t, compose(pose, mounted), "/vo", 1e-12, "camera")
    closures, time = (r := bag(maker, "--second-odom", "/vo")[0].recorded).closures, r.time
    at = interpolate(TIMES, CAMERA, time)
    np.testing.assert_allclose(closures.relative, between(at[:-1], at[1:]), atol=1e-3)  # interpolated at the camera
    assert np.linalg.eigvalsh(closures.covariance).min() > 0.0


@pytest.mark.parametrize(("words", "said"), [
    (("--second-odom", "/vo"), "/vo: messages whose twist has no positive definite covariance of vx, vy and the turn"),
    (("--second-odom", "/odom"), "--second-odom /odom: --odom is the same topic"),
    (("--second-odom", "/far", "--second-odom-sigma", "1,1,1,1"), "/far: its messages at 1700000090.000 to"),
])  # fmt: skip
def test_one_line_says_what_is_wrong(maker, bag, words, said):
    for t in (90.0, 91.0):
        maker.odometry(t, (0.0, 0.0, 0.0), "/far")
    maker.odometry(0.0, (0.0, 0.0, 0.0), "/arm", 1.0, "arm")
    assert said in bag(with_camera(maker), *words, status=2)
