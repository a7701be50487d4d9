"""Rooms of straight walls, and scans of them by plain geometry."""

import math

import numpy as np

from data.inputs import Scanner
from data.se2 import Array, compose

SCANNER = Scanner(-0.5 * math.pi, math.pi / 180.0, 30.0, 0.01)
ROOM = np.array(
    [[-4, -3, 5, -3], [5, -3, 5, 4], [5, 4, -4, 4], [-4, 4, -4, -3], [2, 4, 2, 2], [-1, -3, -1, -1.5]], float
)
"""(W, 4) x1 y1 x2 y2 of the walls of a room with two partitions."""
CORRIDOR = np.array([[-60, -1, 60, -1], [-60, 1, 60, 1]], float)


def scan(pose: Array, walls: Array, scanner: Scanner = SCANNER, beams: int = 180) -> Array:
    """Exact ranges (B,) of the body at pose (3,); 0 where no wall is within reach."""
    c, s = math.cos(scanner.rotation), math.sin(scanner.rotation)
    tx, ty = scanner.translation
    x, y, theta = compose(pose, np.array([-c * tx - s * ty, s * tx - c * ty, -scanner.rotation]))
    ranges = np.zeros(beams)
    for k in range(beams):
        u = np.array([math.cos(theta + scanner.angle_min + k * scanner.angle_step),
                      math.sin(theta + scanner.angle_min + k * scanner.angle_step)])  # fmt: skip
        best = scanner.max_range
        for x1, y1, x2, y2 in walls:
            A = np.array([[u[0], x1 - x2], [u[1], y1 - y2]])
            if abs(np.linalg.det(A)) > 1e-12:
                r, t = np.linalg.solve(A, [x1 - x, y1 - y])
                if r > 0.0 and 0.0 <= t <= 1.0:
                    best = min(best, r)
        ranges[k] = best if best < scanner.max_range else 0.0
    return ranges
