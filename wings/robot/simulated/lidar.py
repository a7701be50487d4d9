"""The simulated robot's lidar: a planar scanner over the centre of the body, in the robot's room.

A scan is taken at once, as if the head turned infinitely fast; a real one turns in 0.1 s, in which the robot moves by
2 cm. Ranges are measured at the walls of the room; sonars see the same walls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data.se2 import Array
from wings.laser.floorplan.world import scan_ranges
from wings.robot.scan_packets import Beams, Scan
from wings.robot.simulated.room import Room

SIGMA = 0.01  # m, standard deviation of a range, as of low-cost lidars for hobby robots


@dataclass(frozen=True)
class Lidar:
    """A lidar.

    Attributes:
        beams: in a circle, the first one astern, counter-clockwise.
        reach: m, largest range.
        sigma: m, standard deviation of a range.
        dropout: share of beams without a return.
    """

    beams: int = 360
    reach: float = 8.0
    sigma: float = SIGMA
    dropout: float = 0.01

    @property
    def directions(self) -> Beams:
        """As they are transmitted."""
        step = 2.0 * math.pi / self.beams
        return Beams(self.beams, round(-1e6 * math.pi), round(1e9 * step), round(1000.0 * self.reach))

    def scan(self, room: Room, pose: Array, t: float, odometry: tuple[int, int, int], rng: np.random.Generator) -> Scan:
        """The scan from a true pose (3,) at robot time t [s]; odometry as in the answer, int16."""
        walls = np.ascontiguousarray(room.segments.reshape(-1, 4))  # x0, y0, x1, y1
        ranges = scan_ranges(pose[None], self.directions.scanner(self.sigma), self.beams, walls)[0]
        noise, missed = rng.standard_normal(self.beams), rng.random(self.beams) < self.dropout
        mm = np.round(1000.0 * (ranges + self.sigma * noise))
        mm = np.where(np.isfinite(mm) & ~missed & (mm < 1000.0 * self.reach), np.maximum(mm, 1.0), 0.0)
        return Scan(round(1000.0 * t) % (1 << 32), odometry, self.directions, tuple(mm.astype(int).tolist()))
