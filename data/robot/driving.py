"""Driving along walls by the sonars alone: which speed and turn rate to command for the packets that came.

A policy is called as `policy(packet)` and returns the speed [m/s] and turn rate [rad/s], counter-clockwise, to command
next: what `data.robot.simulated.physics.drive` takes, and what a link's packets go to. `WallFollower` keeps the wall
on its right.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from data.robot.packets import AHEAD, RADIUS, RIGHT, SONARS
from data.robot.traffic.motion import Packet
from data.robot.walls import fit_weighted, sensor_poses, visible
from data.se2 import Array, wrap_angle

SPEED = 0.22
"""m/s along a wall: 5.5 cm from packet to packet, and twice round a room of 10 x 6 m in five minutes."""
WANTED = 0.45
"""m from the robot's middle to the wall: twice its radius of free floor, and half of the narrowest gap (`room.GAP`)."""
DAMPING = 0.8
"""1/s, turn rate over angle. The line is that of the last second, half a second late, and a command comes 0.25 s after:
0.8 x 0.75 s is a lag of 34 degrees at the crossover, which leaves 56 to instability."""
STIFFNESS = DAMPING**2 / 4.0 / SPEED
"""1/(m s), turn rate over distance; with e' = -v a, a' = STIFFNESS e - DAMPING a this is critical damping."""
STEEPEST = 0.3
"""rad to the wall on the way to it. The sonar beside loses it at 22.5 degrees = 0.39 rad."""
FARTHEST = 1.0
"""m. A wall beyond is not followed."""
FASTEST_FOLLOWING = 0.8
"""rad/s of turn while driving on."""

FRAMES = 6
"""Packets for a line: 1.25 s, 0.27 m."""
FEWEST = 4
"""Readings of a sonar for a line; one of them may be wrong."""
VAGUEST = 0.1
"""rad, standard deviation of the angle of a line that is followed."""
BESIDE_ROWS = (RIGHT - 1, RIGHT, RIGHT + 1)
AROUND = WANTED + 0.1
"""m, radius of the circle about a wall's end. The end itself sends no echo; it is passed by 0.17 m when the sonar
beside has lost the wall twice, and the circle's far side comes that much nearer to a thin wall's other face."""
NEAR = 0.6
"""m. A reading below is a wall to turn along even without a line."""

STOP = WANTED - RADIUS + SPEED * 0.25
"""m before the rim where the robot stops for what is ahead and turns; what a period drives is left to the next wall."""
SLOW = 3.0 * STOP
"""m before the rim where it begins to brake."""
SLOWEST = 0.4
"""Share of `SPEED` that is left when it stops; slower, the last readings would be too near each other for a line."""
CLEAR = 0.7
"""m that must be free ahead and ahead to the right to drive on after a turn."""
BESIDE = 0.2
"""m. Nearer at 45 degrees from ahead is in the way."""
SPIN = 1.0
"""rad/s of a turn on the spot, 14 degrees from packet to packet: a wall is in each sonar's 45 three times."""


class WallFollower:
    """Follows the wall on its right at `WANTED`, turns left at obstacles, right around a wall's end."""

    def __init__(self) -> None:
        """Nothing seen yet."""
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
        return self._decide()

    def _decide(self) -> tuple[float, float]:
        ranges = self._ranges[-1]
        before = self._ranges[-2] if len(self._ranges) > 1 else ranges
        ahead, left, right = ranges[AHEAD], ranges[AHEAD + 1], ranges[AHEAD - 1]
        # one short reading may be another sonar's ping; two are a wall
        if (
            max(ahead, before[AHEAD]) < STOP
            or max(min(left, right), min(before[AHEAD + 1], before[AHEAD - 1])) < BESIDE
        ):
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
        """Turn rate [rad/s] along a wall: PD on distance and angle, the angle towards it kept below `STEEPEST`."""
        self._lost_at = None
        angle = wrap_angle(alpha - float(SONARS[RIGHT, 2]))
        towards = min(max(STIFFNESS / DAMPING * (rho - WANTED), -STEEPEST), STEEPEST)
        return min(max(DAMPING * (angle - towards), -FASTEST_FOLLOWING), FASTEST_FOLLOWING)

    def _around(self) -> float:
        """Turn rate [rad/s] where the wall has ended: a circle about its end, and after a whole one straight on."""
        heading = float(self._odometry[-1][2])
        if self._lost_at is None:
            self._lost_at = heading
        return -SPEED / AROUND if self._lost_at - heading < 2.0 * math.pi else 0.0

    def _wall(self) -> tuple[float, float] | None:
        """The nearest wall on the right as rho [m] and alpha [rad], by one sonar's last readings."""
        sensors, ranges = sensor_poses(np.array(self._odometry)), np.array(self._ranges)
        lines = []
        for row in BESIDE_ROWS:
            seen = ranges[:, row] < FARTHEST
            if seen.sum() < FEWEST or not seen[-2:].any():
                continue
            line = fit_weighted(sensors[seen, row], ranges[seen, row])
            if line.weights.sum() > FEWEST - 1 and line.cov[1, 1] < VAGUEST**2 and visible(line, sensors[seen, row]):
                lines.append((line.rho, line.alpha))
        return min(lines, default=None)

    def _glimpse(self) -> tuple[float, float] | None:
        """What is near on the right when there is no line yet, or on a turn no more: the normal is the sonar's axis."""
        if len(self._ranges) < 2:
            return None
        # whichever sonar it was before: at 22.5 degrees between two, the wall is heard by one and the other in turns
        distance, row = min((float(self._ranges[-1][row]), row) for row in BESIDE_ROWS)
        distance = max(distance, min(float(self._ranges[-2][row]) for row in BESIDE_ROWS))
        return (distance + RADIUS, float(SONARS[row, 2])) if distance < NEAR else None
