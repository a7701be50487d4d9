"""Wall following by sonar: the speed and turn rate to command after each packet.

A policy is called as `policy(packet)` and returns speed [m/s] and turn rate [rad/s], counter-clockwise.
`wings.robot.simulated.drive` and the live link take one. `WallFollower` keeps the wall on its right.
"""

import math
from collections import deque

import numpy as np

from data.se2 import Array, between, compose, wrap_angle
from wings.robot.packets import AHEAD, RADIUS, RIGHT, SONARS
from wings.robot.traffic import Packet
from wings.robot.walls import FITS, SIGMA, USUAL_FIT, visible

SPEED = 0.22  # m/s along a wall: 5.5 cm per packet, two rounds of a 10 x 6 m room in five minutes
WANTED = 0.45  # m from the robot's centre to the wall: half of the narrowest gap (`room.GAP`)
DAMPING = 0.8
"""1/s, turn rate over angle. Line (0.5 s late) and command (0.25 s) lag by 0.8 x 0.75 s = 34 deg: phase margin 56 deg.
"""
STIFFNESS = DAMPING**2 / 4.0 / SPEED
"""1/(m s), turn rate over distance: critical damping of e' = -v a, a' = STIFFNESS e - DAMPING a."""
STEEPEST = 0.3  # rad, largest approach angle. The side sonar loses the wall at 22.5 degrees = 0.39 rad.
FARTHEST = 1.0  # m, largest distance of a wall to follow
FASTEST_FOLLOWING = 0.8  # rad/s, largest turn rate while driving

FRAMES = 6  # packets that a line is fitted to: 1.25 s, 0.27 m
FEWEST = 4  # fewest readings of a sonar for a line; one may be wrong
VAGUEST = 0.1  # rad, largest standard deviation of a followed line's angle
BESIDE_ROWS = (RIGHT - 1, RIGHT, RIGHT + 1)
AROUND = WANTED + 0.1
"""m, radius of the circle about a wall's end, which sends no echo and is passed by 0.17 m before the wall is lost."""
NEAR = 0.6  # m. A nearer reading is a wall to turn along even without a line.

STOP = WANTED - RADIUS + SPEED * 0.25  # m ahead of the rim: the robot stops for a nearer obstacle and turns
SLOW = 3.0 * STOP  # m ahead of the rim: the robot brakes for a nearer obstacle
SLOWEST = 0.4  # smallest share of `SPEED` while braking; slower readings lie too close together for a line
CLEAR = 0.7  # m that must be free ahead and to the right before a turn ends
BESIDE = 0.2  # m. A nearer reading at 45 degrees from ahead is an obstacle.
SPIN = 1.0  # rad/s of a turn on the spot: 14 degrees per packet, so each sonar's 45 degrees meet a wall three times


class WallFollower:
    """Follow the wall on the right at `WANTED`; turn left at obstacles, right around a wall's end."""

    def __init__(self, fit: str = USUAL_FIT) -> None:
        self._fit = FITS[fit]
        self._odometry: deque[Array] = deque(maxlen=FRAMES)
        self._ranges: deque[Array] = deque(maxlen=FRAMES)
        self._turning = False
        self._clear = 0
        self._lost_at: float | None = math.inf  # heading [rad] where the wall ended; none yet: straight on

    def __call__(self, packet: Packet) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] after a packet."""
        if not packet.joined:
            self._odometry.clear()
            self._ranges.clear()
        self._odometry.append(packet.odometry)
        self._ranges.append(packet.ranges)
        ranges = packet.ranges
        before = self._ranges[-2] if len(self._ranges) > 1 else ranges
        ahead, left, right = ranges[AHEAD], ranges[AHEAD + 1], ranges[AHEAD - 1]
        # one short reading may be another sonar's ping; two are a wall
        beside = max(min(left, right), min(before[AHEAD + 1], before[AHEAD - 1]))
        if max(ahead, before[AHEAD]) < STOP or beside < BESIDE:
            self._turning, self._clear = True, 0
        if self._turning:
            self._clear = self._clear + 1 if min(ahead, right) > CLEAR and left > BESIDE else 0
            self._turning = self._clear < 2
            if self._turning:
                self._lost_at = math.inf
                return 0.0, SPIN
        slow = min(max((ahead - STOP) / (SLOW - STOP), SLOWEST), 1.0)
        wall = self._wall() or self._glimpse()
        return slow * SPEED, (self._along(*wall) if wall is not None else slow * self._around())

    def _along(self, rho: float, alpha: float) -> float:
        """Turn rate [rad/s] along a wall: PD on distance and angle, with a bounded approach angle."""
        self._lost_at = None
        angle = wrap_angle(alpha - float(SONARS[RIGHT, 2]))
        towards = min(max(STIFFNESS / DAMPING * (rho - WANTED), -STEEPEST), STEEPEST)
        return min(max(DAMPING * (angle - towards), -FASTEST_FOLLOWING), FASTEST_FOLLOWING)

    def _around(self) -> float:
        """Turn rate [rad/s] after the wall has ended: one full circle about its end, then straight on."""
        heading = float(self._odometry[-1][2])
        if self._lost_at is None:
            self._lost_at = heading
        return -SPEED / AROUND if self._lost_at - heading < 2.0 * math.pi else 0.0

    def _wall(self) -> tuple[float, float] | None:
        """Nearest wall on the right as (rho [m], alpha [rad]), fitted to one sonar's last readings."""
        odometry, ranges = np.array(self._odometry), np.array(self._ranges)
        sensors = compose(between(odometry[-1], odometry)[:, None], SONARS)
        lines = []
        for row in BESIDE_ROWS:
            seen = ranges[:, row] < FARTHEST
            if seen.sum() < FEWEST or not seen[-2:].any():
                continue
            line = self._fit(sensors[seen, row], ranges[seen, row], SIGMA)
            if line.weights.sum() > FEWEST - 1 and line.cov[1, 1] < VAGUEST**2 and visible(line, sensors[seen, row]):
                lines.append((line.rho, line.alpha))
        return min(lines, default=None)

    def _glimpse(self) -> tuple[float, float] | None:
        """Nearest right-hand reading, taken along the sonar's axis, where no line can be fitted."""
        if len(self._ranges) < 2:
            return None
        # either sonar will do: at 22.5 degrees between two, they hear the wall in turns
        distance, row = min((float(self._ranges[-1][row]), row) for row in BESIDE_ROWS)
        distance = max(distance, min(float(self._ranges[-2][row]) for row in BESIDE_ROWS))
        return (distance + RADIUS, float(SONARS[row, 2])) if distance < NEAR else None
