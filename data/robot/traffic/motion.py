"""From an answer to a packet: is it possible at all, could the robot have come there, and where is that, unwrapped.

Odometry is counted in int16 and overflows; between two packets the robot moves far less than half a turn of the
counters, so differences modulo 2^16 are right. A robot whose odometry began anew (switched off and on) is carried on
from the pose it had; how far it moved meanwhile is not known, and the packet says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.robot.packets import FASTEST, FASTEST_TURN, PERIOD, TIMEOUT_MM, WATCHDOG, Answer, overflowed
from data.se2 import Array, between, compose

SLACK = 0.1
"""s by which two answers may be farther apart than their stamps: how late a byte can be stamped."""
ROUNDING = 2
"""mm, mrad: the difference of two rounded numbers, one more for the ticks."""


class Heard(NamedTuple):
    """An answer as it came.

    Attributes:
        t: s, of its last byte.
        answer: its numbers.
        sure: probability that it is an answer and not bytes of two.
    """

    t: float
    answer: Answer
    sure: float


@dataclass(frozen=True)
class Packet:
    """An answer that can be used.

    Attributes:
        t: s, when its last byte came.
        ranges: (8,) m, inf where nothing was seen.
        odometry: (3,) pose of the wheels' odometry [m, m, rad], unwrapped: it and its heading go on without bound.
        joined: False where the motion since the packet before is not known: the first, and after odometry began anew.
        sure: probability that the bytes are those of one answer.
        answer: the numbers as they came.
    """

    t: float
    ranges: Array
    odometry: Array
    joined: bool
    sure: float
    answer: Answer


def possible(answer: Answer) -> bool:
    """Whether each distance is one: 0 to the timeout value. x, y and heading may have any value."""
    return min(answer.distances) >= 0 and max(answer.distances) <= TIMEOUT_MM


def reachable(before: Answer, after: Answer, elapsed: float) -> bool:
    """Whether the robot at its fastest can have moved from one answer to the other in `elapsed` [s] and `SLACK`.

    Commands and answers that waited somewhere come at once, so less than a period counts as one.
    """
    time = max(elapsed, PERIOD) + SLACK
    dx, dy, turn = moved(before, after)
    return (
        math.hypot(dx, dy) <= 1000.0 * FASTEST * time + ROUNDING
        and abs(turn) <= 1000.0 * FASTEST_TURN * time + ROUNDING
    )


def came_from(before: Answer, after: Answer, elapsed: float, *, held_up: bool) -> bool:
    """Whether the robot can have come from one answer to a later one, stamped `elapsed` [s] after it.

    If the first was `held_up` on the line, the robot drove on meanwhile, until its watchdog stopped it.
    """
    return reachable(before, after, elapsed + WATCHDOG * held_up)


def moved(before: Answer, after: Answer) -> tuple[int, int, int]:
    """Differences of x, y [mm] and heading [mrad], over the counters' overflow."""
    return (
        overflowed(after.x - before.x),
        overflowed(after.y - before.y),
        overflowed(after.heading - before.heading),
    )


class Unwrapper:
    """Carries the odometry on from answer to answer."""

    def __init__(self) -> None:
        """Before the first answer."""
        self._before: Answer | None = None
        self._counted = np.zeros(3, np.int64)  # mm, mm, mrad: of the present count, without overflow
        self._base = np.zeros(3)  # pose of the frame in which is counted

    def packet(self, heard: Heard, joined: bool) -> Packet:
        """The next packet; not `joined`, odometry counts in a frame of its own and goes on from the pose it had."""
        answer = heard.answer
        present = np.array([answer.x, answer.y, answer.heading], np.int64)
        if self._before is None:
            self._counted, joined = present, False
        elif joined:
            self._counted = self._counted + moved(self._before, answer)
        else:
            self._base = _apart(self._pose(), present / 1000.0)
            self._counted = present
        self._before = answer
        mm = np.array(answer.distances, float)
        ranges = np.where(mm < TIMEOUT_MM, mm / 1000.0, np.inf)
        return Packet(heard.t, ranges, self._pose(), joined, heard.sure, answer)

    def _pose(self) -> Array:
        counted = self._counted / 1000.0
        pose = compose(self._base, counted)
        pose[2] = self._base[2] + counted[2]
        return pose


def _apart(pose: Array, counted: Array) -> Array:
    """Pose of a frame in which `counted` stands where `pose` does; the headings' difference is not wrapped."""
    base = compose(pose, between(counted, np.zeros(3)))
    base[2] = pose[2] - counted[2]
    return base
