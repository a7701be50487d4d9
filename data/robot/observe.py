"""From packet to packet: the walls an answer completes, as observations z = (rho, alpha) with covariance R.

Each sonar collects readings while it hears one thing; a smooth wall is heard by the one sonar that points within 22.5
degrees of its normal. Once readings make a line that is good enough, the line is an observation and they are used up:
no reading counts twice, so errors of observations are independent of each other as far as the sonars go.

A wall's end sends its echo through the whole cone, 26 cm wide at a metre, and an arc about a point is a line at an
angle to any sonar that passes. It is the first a sonar hears of a wall and the last, so readings count only when the
cone has swept its own width since it began to hear the wall, and again before it ceases. What the first packet
hears has not just begun.

Readings of several packets are joined by odometry, whose errors the estimator meets again in its motion model. The
covariance holds their part in the line (`_of_odometry`), not that they are correlated with the motion's: so `LONGEST`
is short.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data.robot.packets import CONE_HALF_ANGLE, SONARS, WHEEL_BASE
from data.robot.traffic.motion import Packet
from data.robot.walls import MIRROR, SIGMA, Line, echo_points, fit_weighted, geometry, visible
from data.se2 import Array, between, compose, wrap_angle

SLIP = 0.005
"""m per square root of a metre of a wheel's way: that of the simulated robot (`data.robot.simulated.physics`)."""
FEWEST = 5
"""Readings of a line: two fix it, three are left to doubt it."""
LONGEST = 0.8
"""m of way of either wheel since the oldest reading of a line."""
OLDEST = 64
"""Packets that are kept, however slowly it drives: 16 s."""
VAGUEST = 0.05
"""rad, standard deviation of alpha by the sonars' noise; the fewest readings, 5.5 cm apart, give 0.03."""
MISSES = 2
"""Packets in a row without an echo that end what a sonar collects; a single echo is missed now and then."""
GOOD = 0.7
"""Weight of the readings, on average, of a line they are taken for; good ones weigh 0.9, so one in five is lost."""
RESIDUAL = 2.0
"""Sigmas; readings that spread more about their line are not of one wall."""
CONE_WIDTH = 2.0 * math.tan(CONE_HALF_ANGLE)
"""Of the distance."""
ACROSS = math.radians(45.0)
"""rad, at least, between a wall's normal and the way of the sonar. Straight towards a wall all echoes come from one
point; the distance falls as the cosine of the angle, which is even and flat there: noise becomes an angle."""


Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Seen:
    """Walls that a packet completes, in its body frame.

    Attributes:
        z: (m, 2) rho [m] and alpha [rad].
        R: (m, 2, 2) covariance [m, rad].
        sonars: (m,) rows of `body.SONARS` that saw them.
    """

    z: Array
    R: Array
    sonars: Rows


class _Reading(NamedTuple):
    """Of one sonar: packet's number, distance [m], pose (3,) of the sonar by odometry, way its cone has swept [m]."""

    packet: int
    distance: float
    sensor: Array
    swept: float


class _Run:
    """What one sonar hears while it hears one thing."""

    def __init__(self, sigma: float) -> None:
        self._noise = 4.0 * math.sqrt(2.0) * sigma
        self.readings: list[_Reading] = []
        self._used = -1  # number of the packet up to which readings are used up
        self._doubtful: tuple[int, float, Array] | None = None
        self._silent = 0
        self._began = 0.0  # what of `swept` is a wall's end

    def add(self, packet: int, distance: float, sensor: Array) -> None:
        """The next reading, inf where nothing was heard; one that does not go on from the last waits for a second."""
        if math.isinf(distance):
            self._silent += 1
            if self._silent >= MISSES:
                self.readings = []
            return
        self._silent = 0
        new, doubtful = (packet, distance, sensor), self._doubtful
        self._doubtful = None
        if not self.readings:
            self._began = 0.0 if packet else -math.inf
            self.readings = [_Reading(packet, distance, sensor, 0.0)]
        elif self._goes_on(self.readings[-1], new):
            last = self.readings[-1]
            step = between(last.sensor, sensor)
            swept = abs(float(step[1])) + distance * abs(float(step[2]))
            self.readings.append(_Reading(packet, distance, sensor, last.swept + swept))
        elif doubtful is None:
            self._doubtful = new
        elif self._goes_on(_Reading(*doubtful, 0.0), new):
            self._began, self.readings = 0.0, [_Reading(*doubtful, 0.0)]
            self.add(*new)
        else:
            self._doubtful = new

    def _goes_on(self, last: _Reading, new: tuple[int, float, Array]) -> bool:
        """Whether one wall can give both: it comes nearer by no more than the sonar's way, and by its turn."""
        step = between(last.sensor, new[2])
        possible = math.hypot(step[0], step[1]) + math.tan(MIRROR) * last.distance * abs(float(step[2]))
        return abs(new[1] - last.distance) < possible + self._noise

    def complete(self, oldest: int) -> list[_Reading]:
        """Readings not used up, of packets from `oldest` on, that are not of the wall's ends."""
        if not self.readings:
            return []
        last = self.readings[-1]
        oldest = max(oldest, self._used + 1)
        self.readings = [r for r in self.readings if r.packet >= oldest] or [last]
        return [
            r
            for r in self.readings
            if r.packet >= oldest and min(r.swept - self._began, last.swept - r.swept) >= CONE_WIDTH * r.distance
        ]

    def use_up(self, packet: int) -> None:
        """Readings up to this packet's."""
        self._used = packet


class WallObserver:
    """Collects readings of the last packets and hands out walls."""

    def __init__(self, sigma: float = SIGMA, slip: float = SLIP) -> None:
        """Of sonars with a standard deviation sigma [m], and wheels that slip [m per square root of a metre]."""
        self._sigma, self._slip = sigma, slip
        self._restart()

    def _restart(self) -> None:
        self._odometry: deque[Array] = deque()
        self._first = 0  # number of the packet that the odometry begins with
        self._runs = [_Run(self._sigma) for _ in SONARS]

    def observe(self, packet: Packet) -> Seen:
        """The walls of which this packet has the last reading that was wanted."""
        if not packet.joined:
            self._restart()
        self._odometry.append(packet.odometry)
        self._forget()
        number = self._first + len(self._odometry) - 1
        sensors = compose(packet.odometry, SONARS)
        rows, lines = [], []
        for row, run in enumerate(self._runs):
            run.add(number, float(packet.ranges[row]), sensors[row])
            readings = run.complete(self._first)
            line = self._line(readings) if len(readings) >= FEWEST else None
            if line is not None:
                rows.append(row)
                lines.append(line)
                run.use_up(readings[-1].packet)
        z = np.array([[line.rho, line.alpha] for line in lines]).reshape(-1, 2)
        R = np.array([line.cov for line in lines]).reshape(-1, 2, 2)
        R = 0.5 * (R + R.transpose(0, 2, 1))
        return Seen(z, R, np.array(rows, np.int64))

    def _forget(self) -> None:
        """Drop packets from more than `LONGEST` or `OLDEST` ago."""
        ways = _wheel_ways(np.array(self._odometry))
        ago = np.cumsum(ways[::-1], axis=0).max(axis=1)[::-1]
        for _ in range(max(int(np.sum(ago > LONGEST)), len(self._odometry) - OLDEST)):
            self._odometry.popleft()
            self._first += 1

    def _line(self, readings: list[_Reading]) -> Line | None:
        """The line through readings in the newest body frame, if it is one and good enough; odometry's errors in it."""
        odometry = np.array(self._odometry)
        sensors = between(odometry[-1], np.array([r.sensor for r in readings]))
        ranges = np.array([r.distance for r in readings])
        line = fit_weighted(sensors, ranges, self._sigma)
        w, total = line.weights, float(line.weights.sum())
        if w.mean() < GOOD or total < FEWEST - 1 or not visible(line, sensors) or not _crossed(line, sensors):
            return None
        if float(w @ line.residuals**2) > total * (RESIDUAL * self._sigma) ** 2:
            return None
        J = w[:, None] * geometry(sensors, ranges, line.alpha)
        information = J.T @ geometry(sensors, ranges, line.alpha)
        # by the sonar's sigma, not by the residuals: so few tell little of their own size
        sonar = self._sigma**2 * np.linalg.inv(information)
        if not sonar[1, 1] < VAGUEST**2:
            return None
        gain = np.asarray(np.linalg.solve(information, J.T), float)
        packets = np.array([r.packet for r in readings]) - self._first
        points = echo_points(sensors, ranges, line.alpha)
        return line._replace(cov=sonar + _of_odometry(odometry, packets, points, line.alpha, gain, self._slip))


def _crossed(line: Line, sensors: Array) -> bool:
    """Whether the sonars (N, 3) moved across the line's normal, as far as they moved."""
    way = sensors[-1, :2] - sensors[0, :2]
    along = abs(way @ (math.cos(line.alpha), math.sin(line.alpha)))
    return bool(along <= math.cos(ACROSS) * math.hypot(way[0], way[1]))


def _wheel_ways(odometry: Array) -> Array:
    """Ways (F - 1, 2) [m] of the left and right rim between poses (F, 3), without sign."""
    steps = between(odometry[:-1], odometry[1:])
    forward = steps[:, 0] * np.cos(0.5 * steps[:, 2]) + steps[:, 1] * np.sin(0.5 * steps[:, 2])
    ways: Array = np.abs(
        np.stack([forward - 0.5 * WHEEL_BASE * steps[:, 2], forward + 0.5 * WHEEL_BASE * steps[:, 2]], -1)
    )
    return ways


def _of_odometry(odometry: Array, packets: Rows, points: Array, alpha: float, gain: Array, slip: float) -> Array:
    """Covariance (2, 2) of rho and alpha from the slip of each wheel on each step since the readings.

    Slip of a wheel by a metre moves the body half a metre ahead and turns it by 1 / WHEEL_BASE; for the newest frame,
    what was seen before the step is then half a metre farther back and turned the other way about where the robot was.

    Args:
        odometry: (F, 3) poses of the body.
        packets: (N,) rows of it at which the echoes came.
        points: (N, 2) the echoes in the last body frame [m].
        alpha: rad, of the line's normal.
        gain: (2, N) change of rho and alpha by the points' distances from the line.
        slip: m per square root of a metre.
    """
    poses = between(odometry[-1], odometry)
    normal = np.array([math.cos(alpha), math.sin(alpha)])
    cov = np.zeros((2, 2))
    for k, ways in enumerate(_wheel_ways(odometry), start=1):
        before = packets < k
        heading = poses[k - 1, 2] + 0.5 * wrap_angle(poses[k, 2] - poses[k - 1, 2])
        back = -0.5 * float(normal @ (math.cos(heading), math.sin(heading)))
        arm = points - poses[k, :2]
        turned = (normal[1] * arm[:, 0] - normal[0] * arm[:, 1]) / WHEEL_BASE
        for way, side in zip(ways, (1.0, -1.0), strict=True):
            change = gain @ (before * (back + side * turned))
            cov += slip**2 * way * np.outer(change, change)
    return cov
