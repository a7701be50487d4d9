"""Unwrapped odometry and the frames made of packets: on past the overflow; errors are as large as stated."""

import numpy as np
import pytest

from data.se2 import between, wrap_angle
from wings.robot.driving import WallFollower
from wings.robot.log import FLOOR, ROUNDING, SENSOR, Framing, inputs_of
from wings.robot.packets import FASTEST, Answer, overflowed
from wings.robot.simulated import drive, room
from wings.robot.traffic import Packet, Unwrapper, reachable
from wings.robot.world import lines

FAR = (4000,) * 8


def answer(x, y, heading, distances=FAR):
    return Answer(distances, overflowed(x), overflowed(y), overflowed(heading))


def carried(answers, joined=lambda _: True):
    unwrapper = Unwrapper()
    return [unwrapper.packet(0.25 * i, a, joined(i)) for i, a in enumerate(answers)]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1, -1])
def test_x_y_and_heading_go_on_beyond_their_overflow(axis, sign):
    truth = np.zeros((1500, 3), int)
    truth[:, axis] = sign * 90 * np.arange(1500)
    packets = carried([answer(*row) for row in truth.tolist()])
    np.testing.assert_allclose([p.odometry for p in packets], truth / 1000.0, atol=1e-9)
    assert abs(truth[-1, axis]) > 4 * 32768


def test_after_odometry_began_anew_the_robot_drives_on_from_where_it_was():
    first = [answer(1000, 2000, 1571), answer(1000, 2100, 1571)]
    anew = [answer(0, 0, 0), answer(100, 0, 0), answer(200, 0, 785)]
    packets = carried(first + anew, joined=lambda i: i != 2)
    assert [p.joined for p in packets] == [False, True, False, True, True]
    np.testing.assert_allclose(packets[2].odometry, [1.0, 2.1, 1.571], atol=1e-9)
    np.testing.assert_allclose(packets[3].odometry, [1.0, 2.2, 1.571], atol=1e-4)
    np.testing.assert_allclose(packets[4].odometry, [1.0, 2.3, 1.571 + 0.785], atol=1e-4)


@pytest.mark.parametrize(("after", "elapsed", "fine"), [
    ((138, 0, 0), 0.25, True), ((145, 0, 0), 0.25, False), ((105, 105, 0), 0.25, False), ((-540, 0, 0), 1.25, True),
    ((0, 0, 1115), 0.25, True), ((0, 0, -1130), 0.25, False), ((100, 0, 0), 0.0, True),
])  # fmt: skip
def test_the_robot_moves_no_faster_than_its_wheels(after, elapsed, fine):
    """0.4 m/s and 3.2 rad/s for the time and a tenth of a second; in less than a period, as far as in one."""
    before = np.array([32700, -32760, 32000])
    assert reachable(answer(*before), answer(*before + after), elapsed) == fine


def packet(k, pose, *, joined=True):
    """A packet that saw nothing, its odometry rounded as the robot rounds it."""
    x, y, heading = (round(1000 * v) for v in pose)
    odometry = np.array([x, y, heading]) / 1000
    return Packet(0.25 * k, np.full(8, np.inf), odometry, joined, Answer((4000,) * 8, x, y, heading))


def arc(f, theta):
    """Motion (3,) of an arc of length f that turns by theta."""
    return np.array([f * np.cos(0.5 * theta), f * np.sin(0.5 * theta), theta])


def test_the_first_frame_has_no_motion_and_a_robot_at_rest_only_the_floor():
    framing = Framing()
    first, still, gone = (framing.frame(packet(k, [0.5, 0.2, x])) for k, x in enumerate([1.0, 1.0, 1.1]))
    assert first.increment is None
    assert (still.increment.mean == 0).all()
    assert (still.increment.covariance == FLOOR * np.eye(3)).all()
    assert np.diag(gone.increment.covariance)[2] > ROUNDING**2


def test_after_odometry_began_anew_the_robot_may_be_where_it_can_have_driven():
    framing = Framing()
    framing.frame(packet(0, [0, 0, 0]))
    increment = framing.frame(packet(40, [3, 2, 1], joined=False)).increment
    assert (increment.mean == 0).all()
    assert np.sqrt(increment.covariance[0, 0]) == pytest.approx(2.0 * FASTEST)
    assert increment.covariance[2, 2] == pytest.approx(np.pi**2)


@pytest.mark.slow
def test_increments_and_walls_err_by_what_is_stated():
    """NEES of 600 increments, 3 dof, and of about 100 walls, 2 dof: within 3 sigma of their means."""
    place = room(0)
    driven = drive(place, WallFollower(), 150.0, np.random.default_rng(2))
    framing = Framing()
    inputs = inputs_of([framing.frame(p) for p in driven.packets])
    error = inputs.increments.mean[1:] - between(driven.poses[:-1], driven.poses[1:])
    error[:, 2] = wrap_angle(error[:, 2])
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(inputs.increments.covariance[1:]), error)
    assert nees.mean() == pytest.approx(3.0, abs=3 * np.sqrt(6 / len(nees)))
    o, known = inputs.observations, lines(place).xy
    path = between(place.start, driven.poses)
    errors = [SENSOR.residual(z, SENSOR.predict(path[k], known)) for k, z in zip(o.frame, o.z, strict=True)]
    nearest = np.array([e[np.argmin((np.abs(e) / [0.1, 0.15]).sum(axis=1))] for e in errors])
    nees = np.einsum("ni,nij,nj->n", nearest, np.linalg.inv(o.R), nearest)
    assert len(nees) > 80
    assert nees.mean() == pytest.approx(2.0, abs=3 * 2 / np.sqrt(len(nees)))
