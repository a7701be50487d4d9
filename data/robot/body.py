"""The robot as numbers: where its sonars sit, how it is driven, how fast it can be.

A round hobby robot on two driven wheels. Body frame: x ahead, y to the left, the origin midway between the wheels.
"""

from __future__ import annotations

import math

import numpy as np

from data.se2 import Array

RADIUS = 0.15
"""m, of the round body; the sonars sit on its rim."""


def _ring(count: int) -> Array:
    angle = 2.0 * math.pi * np.arange(count) / count
    return np.stack(
        [RADIUS * np.cos(angle), RADIUS * np.sin(angle), np.where(angle > math.pi, angle - 2 * math.pi, angle)], axis=-1
    )


SONARS: Array = _ring(8)
"""Poses (8, 3) of the sonars on the body [m, m, rad], counter-clockwise from the one ahead.

Steps of 45 degrees all round: whatever the heading, one sonar points within 22.5 degrees of a wall's normal, which is
where a smooth wall stops to send an echo back (see `data.robot.simulated.physics`). A ring that is denser ahead would
lose the walls beside and behind, from which a position along a corridor comes.
"""
SONARS.setflags(write=False)
AHEAD, LEFT, BEHIND, RIGHT = 0, 2, 4, 6
"""Rows of `SONARS`."""

CONE_HALF_ANGLE = math.radians(7.5)
"""rad. A sonar hears the nearest thing inside 15 degrees and does not know in which direction it is."""
TIMEOUT_MM = 4000
"""mm. The distance that stands for "nothing seen".

All eight are fired in turn within a cycle of 0.25 s: 8 echoes of 5.8 us/mm x 4000 mm = 0.19 s; 5000 mm would not fit.
"""
LONGEST_RANGE = TIMEOUT_MM / 1000.0
"""m. An echo from here on is not waited for."""

WHEEL_BASE = 0.25
"""m, between the tracks of the two wheels."""
WHEEL_RADIUS = 0.0325
"""m; 65 mm is the common wheel of such kits."""
TICKS_PER_TURN = 960
"""Encoder ticks of one turn of a wheel; 0.21 mm of way each."""
FASTEST_WHEEL = 0.4
"""m/s of a wheel's rim; commands beyond are brought down to it."""
FASTEST = FASTEST_WHEEL
"""m/s of the body."""
FASTEST_TURN = 2.0 * FASTEST_WHEEL / WHEEL_BASE
"""rad/s, both wheels at their fastest against each other."""


def wheel_speeds(v: float, omega: float) -> tuple[float, float]:
    """Speeds of the left and the right rim [m/s] for a body speed v [m/s] and turn rate omega [rad/s]."""
    return v - 0.5 * WHEEL_BASE * omega, v + 0.5 * WHEEL_BASE * omega


def body_speeds(left: float, right: float) -> tuple[float, float]:
    """Body speed v [m/s] and turn rate omega [rad/s] from the rims' speeds [m/s]; undoes `wheel_speeds`."""
    return 0.5 * (left + right), (right - left) / WHEEL_BASE
