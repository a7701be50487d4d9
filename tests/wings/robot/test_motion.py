"""Unwrapped odometry: on past the overflow, on after the robot was switched off; what is possible and what is not."""

from __future__ import annotations

import numpy as np
import pytest

from wings.robot.packets import Answer, overflowed
from wings.robot.traffic.stream import Unwrapper, reachable

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


@pytest.mark.parametrize(
    ("after", "elapsed", "fine"),
    [
        ((138, 0, 0), 0.25, True),
        ((145, 0, 0), 0.25, False),
        ((105, 105, 0), 0.25, False),
        ((-540, 0, 0), 1.25, True),
        ((0, 0, 1115), 0.25, True),
        ((0, 0, -1130), 0.25, False),
        ((100, 0, 0), 0.0, True),
    ],
)
def test_the_robot_moves_no_faster_than_its_wheels(after, elapsed, fine):
    """0.4 m/s and 3.2 rad/s for the time and a tenth of a second; in less than a period, as far as in one."""
    before = np.array([32700, -32760, 32000])
    assert reachable(answer(*before), answer(*before + after), elapsed) == fine
