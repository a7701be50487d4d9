"""A wheel comes to the speed it is told, whatever friction there is, and forgets what it could not do."""

from __future__ import annotations

import numpy as np
import pytest

from wings.robot.simulated.physics import FRICTION, FULL_SPEED, LAG, SpeedLoop, turned

DT = 0.01


def speeds(wanted, load=lambda t: 0.0, loop=None):
    """Speeds of a wheel after each step for the speeds wanted."""
    loop, speed, out = loop or SpeedLoop(), 0.0, []
    for k, w in enumerate(wanted):
        speed = turned(speed, loop.duty(w, speed, DT), DT, load(k * DT))
        out.append(speed)
    return np.array(out)


def test_without_loop_the_motor_lags_and_friction_slows_it():
    speed = 0.0
    for _ in range(round(LAG / 1e-4)):
        speed = turned(speed, 0.5, 1e-4)
    assert speed == pytest.approx((0.5 - FRICTION) * FULL_SPEED * (1 - np.exp(-1.0)), rel=1e-3)
    assert turned(0.0, 0.9 * FRICTION, DT) == 0.0


def test_a_wheel_that_was_held_does_not_run_on():
    """Held for 5 s by a load it cannot move, then let go: it is at its speed within 0.3 s and never 10 % above."""
    out = speeds([0.2] * 700, load=lambda t: 1.0 if 1.0 <= t < 6.0 else 0.0)
    assert (out[150:600] == 0.0).all()
    assert out[600:].max() < 1.1 * 0.2
    assert out[630:] == pytest.approx(0.2, rel=0.05)
