"""Wall observations z = (rho, alpha) with covariance R, completed by packets.

Each sonar collects readings while it hears one smooth wall, which only the sonar within 22.5 degrees of the wall's
normal does. Once its readings make a good enough line, the line is an observation and the readings are used up: no
reading counts twice, so sonar errors of observations are independent.

A wall's end echoes through the whole cone, 26 cm wide at a metre, and looks like a tilted line to a passing sonar. So a
reading counts only after the cone has swept its own width since it began to hear the wall, and again before it ceases;
the first packet of a log is exempt from the former.

Odometry joins readings of several packets, and the estimator's motion model contains the same odometry errors. R
includes them (`_of_odometry`) but not their correlation with the motion, so `LONGEST` is short.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from data.inputs import FrameObservations, IntArray
from data.se2 import Array, between, compose, wrap_angle
from wings.robot.packets import CONE_HALF_ANGLE, SONARS, WHEEL_BASE
from wings.robot.traffic import Packet
from wings.robot.walls import FITS, MIRROR, SIGMA, USUAL_FIT, Line, echo_points, fit_author, geometry, visible

SLIP = 0.005  # m per sqrt(m) of a wheel's travel, as of the simulated robot (`wings.robot.simulated`)
FEWEST = 5  # fewest readings of a line: two fix it, three check it
LONGEST = 0.8  # m, longest travel of either wheel since the oldest reading of a line
OLDEST = 64  # most packets kept: 16 s
VAGUEST = 0.05  # rad, largest sigma of alpha from sonar noise; the fewest readings, 5.5 cm apart, give 0.03
MISSES = 2  # consecutive packets without an echo that end a sonar's collection
GOOD = 0.7  # smallest mean weight of a line's readings; good ones weigh 0.9, so one in five may be an outlier
RESIDUAL = 2.0  # sigmas, largest RMS residual of readings of one wall
CONE_WIDTH = 2.0 * math.tan(CONE_HALF_ANGLE)  # width of the cone over the distance
ACROSS = math.radians(45.0)
"""rad, least angle between a wall's normal and the sonar's path: straight towards a wall all echoes come from one
point, and noise becomes an angle."""


class _Reading(NamedTuple):
    """One sonar reading: packet number, distance [m], sonar pose (3,) by odometry, distance its cone has swept [m]."""

    packet: int
    distance: float
    sensor: Array
    swept: float = 0.0


class _Run:
    """Readings of one sonar while it hears one wall."""

    def __init__(self, sigma: float) -> None:
        self._noise = 4.0 * math.sqrt(2.0) * sigma
        self.readings: list[_Reading] = []
        self.used = -1  # number of the last packet whose reading is used up
        self._pending: _Reading | None = None
        self._silent = 0
        self._began = 0.0  # part of `swept` that is a wall's end

    def add(self, packet: int, distance: float, sensor: Array) -> None:
        """Add a reading, inf for no echo; one that does not continue the last waits for a second."""
        if math.isinf(distance):
            self._silent += 1
            if self._silent >= MISSES:
                self.readings = []
            return
        self._silent = 0
        new, pending = _Reading(packet, distance, sensor), self._pending
        self._pending = None
        if not self.readings:
            self._began, self.readings = 0.0 if packet else -math.inf, [new]
        elif self._continues(self.readings[-1], new):
            last = self.readings[-1]
            step = between(last.sensor, sensor)
            swept = abs(float(step[1])) + distance * abs(float(step[2]))
            self.readings.append(new._replace(swept=last.swept + swept))
        elif pending is not None and self._continues(pending, new):
            self._began, self.readings = 0.0, [pending]
            self.add(packet, distance, sensor)
        else:
            self._pending = new

    def _continues(self, last: _Reading, new: _Reading) -> bool:
        """Whether one wall can give both: the distance changes by at most the sonar's travel and turn."""
        step = between(last.sensor, new.sensor)
        possible = math.hypot(step[0], step[1]) + math.tan(MIRROR) * last.distance * abs(float(step[2]))
        return abs(new.distance - last.distance) < possible + self._noise

    def complete(self, oldest: int) -> list[_Reading]:
        """Unused readings of packets from `oldest` on, without those of the wall's ends."""
        if not self.readings:
            return []
        last = self.readings[-1]
        oldest = max(oldest, self.used + 1)
        self.readings = [r for r in self.readings if r.packet >= oldest] or [last]
        known = [r for r in self.readings if r.packet >= oldest]
        return [r for r in known if min(r.swept - self._began, last.swept - r.swept) >= CONE_WIDTH * r.distance]


class WallObserver:
    """Makes walls of readings; `sigma`: m, of a sonar, `slip`: m per sqrt(m) of a wheel, `fit`: one of `FITS`."""

    def __init__(self, sigma: float = SIGMA, slip: float = SLIP, fit: str = USUAL_FIT) -> None:
        self._sigma, self._slip, self._fit = sigma, slip, FITS[fit]
        self._restart()

    def _restart(self) -> None:
        self._odometry: deque[Array] = deque()
        self._first = 0  # number of the packet that the odometry begins with
        self._runs = [_Run(self._sigma) for _ in SONARS]

    def observe(self, packet: Packet) -> FrameObservations:
        """The walls that this packet completes, in its body frame: z (m, 2) rho [m] and alpha [rad], R (m, 2, 2)."""
        if not packet.joined:
            self._restart()
        self._odometry.append(packet.odometry)
        # Drop packets older than `LONGEST` or `OLDEST`.
        ago = np.cumsum(_wheel_ways(np.array(self._odometry))[::-1], axis=0).max(axis=1)[::-1]
        for _ in range(max(int(np.sum(ago > LONGEST)), len(self._odometry) - OLDEST)):
            self._odometry.popleft()
            self._first += 1
        number = self._first + len(self._odometry) - 1
        sensors = compose(packet.odometry, SONARS)
        lines = []
        for row, run in enumerate(self._runs):
            run.add(number, float(packet.ranges[row]), sensors[row])
            readings = run.complete(self._first)
            line = self._line(readings) if len(readings) >= FEWEST else None
            if line is not None:
                lines.append(line)
                run.used = readings[-1].packet
        z = np.array([[line.rho, line.alpha] for line in lines]).reshape(-1, 2)
        R = np.array([line.cov for line in lines]).reshape(-1, 2, 2)
        return FrameObservations(z, 0.5 * (R + R.transpose(0, 2, 1)))

    def _line(self, readings: list[_Reading]) -> Line | None:
        """The line through readings in the newest body frame, or None where it is not good enough."""
        odometry = np.array(self._odometry)
        sensors = between(odometry[-1], np.array([r.sensor for r in readings]))
        ranges = np.array([r.distance for r in readings])
        line = self._fit(sensors, ranges, self._sigma)
        w, total = line.weights, float(line.weights.sum())
        way = sensors[-1, :2] - sensors[0, :2]
        across = abs(way @ (math.cos(line.alpha), math.sin(line.alpha))) <= math.cos(ACROSS) * math.hypot(*way.tolist())
        if w.mean() < GOOD or total < FEWEST - 1 or not visible(line, sensors) or not across:
            return None
        if float(w @ line.residuals**2) > total * (RESIDUAL * self._sigma) ** 2:
            return None
        G = geometry(sensors, ranges, line.alpha)
        J = w[:, None] * G
        information = J.T @ G
        # from the sonar's sigma: so few residuals say little about their own spread
        gain = np.asarray(np.linalg.solve(information, J.T), float)
        # weights by range say nothing of a reading's own noise
        sonar = self._sigma**2 * (gain @ gain.T if self._fit is fit_author else np.linalg.inv(information))
        if not sonar[1, 1] < VAGUEST**2:
            return None
        packets = np.array([r.packet for r in readings]) - self._first
        points = echo_points(sensors, ranges, line.alpha)
        return line._replace(cov=sonar + _of_odometry(odometry, packets, points, line.alpha, gain, self._slip))


def _wheel_ways(odometry: Array) -> Array:
    """Travel (F - 1, 2) [m] of the left and right wheel between poses (F, 3), unsigned."""
    x, y, turn = between(odometry[:-1], odometry[1:]).T
    forward, side = x * np.cos(0.5 * turn) + y * np.sin(0.5 * turn), 0.5 * WHEEL_BASE * turn
    return np.asarray(np.abs(np.stack([forward - side, forward + side], -1)))


def _of_odometry(odometry: Array, packets: IntArray, points: Array, alpha: float, gain: Array, slip: float) -> Array:
    """Covariance (2, 2) of rho and alpha from the slip s of each wheel on each step since the readings: it moves by
    s / 2 and turns by s / WHEEL_BASE. `odometry` (F, 3): body poses, echoes at its rows `packets` (N,), `points` (N, 2)
    in the last frame; `gain` (2, N): change of rho and alpha by their distances from the line with normal `alpha`.
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
