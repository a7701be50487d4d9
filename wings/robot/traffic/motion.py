"""From an answer to a packet: whether it is possible and reachable, and its unwrapped odometry.

Odometry is counted in int16 and overflows; between packets the robot moves less than half the counters' range, so
differences modulo 2^16 are right. Odometry that restarted continues from the last pose, and the packet says that the
motion in between is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data.se2 import Array, between, compose
from wings.robot.packets import FASTEST, FASTEST_TURN, PERIOD, TIMEOUT_MM, WATCHDOG, Answer, overflowed
from wings.robot.scan_packets import Scan

SLACK = 0.1  # s, largest delay of a byte's stamp
ROUNDING = 2  # mm, mrad: rounding of a difference, and one for the ticks


@dataclass(frozen=True)
class Packet:
    """A usable answer.

    Attributes:
        t: s, time of its last byte.
        ranges: (8,) m, inf for no echo.
        odometry: (3,) pose by the wheels [m, m, rad], heading included unwrapped.
        joined: False where the motion since the last packet is unknown: the first packet, or restarted odometry.
        answer: the transmitted numbers.
        scan: the lidar's, taken where the odometry is that of the answer; None: no lidar, or the scan was lost.
    """

    t: float
    ranges: Array
    odometry: Array
    joined: bool
    answer: Answer
    scan: Scan | None = None


def possible(answer: Answer) -> bool:
    """Whether each distance lies between 0 and the timeout value; the pose may have any value."""
    return min(answer.distances) >= 0 and max(answer.distances) <= TIMEOUT_MM


def reachable(before: Answer, after: Answer, elapsed: float, *, held_up: bool = False) -> bool:
    """Whether the robot can have moved from one answer to the other within `elapsed` [s] and `SLACK`.

    Delayed answers come at once, so less than a period counts as one. An answer `held_up` on the line leaves the robot
    the time until its watchdog stopped it.
    """
    time = max(elapsed + WATCHDOG * held_up, PERIOD) + SLACK
    dx, dy, turn = moved(before, after)
    return (
        math.hypot(dx, dy) <= 1000.0 * FASTEST * time + ROUNDING
        and abs(turn) <= 1000.0 * FASTEST_TURN * time + ROUNDING
    )


def moved(before: Answer, after: Answer) -> tuple[int, int, int]:
    """Differences of x, y [mm] and heading [mrad], across overflow."""
    return (overflowed(after.x - before.x), overflowed(after.y - before.y), overflowed(after.heading - before.heading))


class Unwrapper:
    """Unwraps the odometry from answer to answer."""

    def __init__(self) -> None:
        self._before: Answer | None = None
        self._counted = np.zeros(3, np.int64)  # mm, mm, mrad, unwrapped
        self._base = np.zeros(3)  # pose of the odometry's frame

    def packet(self, t: float, answer: Answer, joined: bool, scan: Scan | None = None) -> Packet:
        """The next packet, see `Packet`; if not `joined`, odometry goes on from the last pose in a frame of its own."""
        present = np.array([answer.x, answer.y, answer.heading], np.int64)
        if self._before is None:
            self._counted, joined = present, False
        elif joined:
            self._counted = self._counted + moved(self._before, answer)
        else:
            # the frame in which `present` is where the last pose is; headings are not wrapped
            pose, counted = self._pose(), present / 1000.0
            self._base = compose(pose, between(counted, np.zeros(3)))
            self._base[2] = pose[2] - counted[2]
            self._counted = present
        self._before = answer
        mm = np.array(answer.distances, float)
        ranges = np.where(mm < TIMEOUT_MM, mm / 1000.0, np.inf)
        return Packet(t, ranges, self._pose(), joined, answer, scan)

    def _pose(self) -> Array:
        counted = self._counted / 1000.0
        pose = compose(self._base, counted)
        pose[2] = self._base[2] + counted[2]
        return pose
