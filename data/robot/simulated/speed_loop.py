"""The speed loop of one wheel: PI with anti-windup on the encoder's speed, and the motor it drives.

The motor is a first-order lag from duty to speed, with friction; a load of up to all it has can hold it. The loop's
zero cancels the motor's lag, so without a load the wheel follows as a lag of `RESPONSE` (pole cancellation; Astrom and
Hagglund, PID Controllers, section 4.4).
"""

from __future__ import annotations

from dataclasses import dataclass

from data.robot.body import FASTEST_WHEEL

LAG = 0.1
"""s in which the motor gets to 63 % of its speed: a geared motor of 6 V with a 65 mm wheel."""
FULL_SPEED = 1.25 * FASTEST_WHEEL
"""m/s of the rim at full duty without load; the rest over the fastest is for the loop to work with."""
RESPONSE = 0.05
"""s, the lag of the closed loop: half the motor's own, five steps of 0.01 s."""
PROPORTIONAL = LAG / (FULL_SPEED * RESPONSE)
"""Duty per m/s."""
INTEGRAL = 1.0 / (FULL_SPEED * RESPONSE)
"""Duty per m."""
FRICTION = 0.1
"""Duty that does not turn the wheel yet."""


@dataclass
class SpeedLoop:
    """A wheel's PI controller.

    Attributes:
        integral: duty that it has come to by itself.
    """

    integral: float = 0.0

    def duty(self, wanted: float, measured: float, dt: float) -> float:
        """Duty, -1 to 1, for speeds [m/s] wanted and measured, dt [s] after the last call.

        When the duty is at its limit, the integral stays where it is unless the error leads away from the limit, so a
        wheel that was held does not run on when it is let go (conditional integration). To stand it needs no integral:
        friction holds it, and what had worked against friction would push it on.
        """
        error = wanted - measured
        if wanted == 0.0:
            self.integral = 0.0
            return min(max(PROPORTIONAL * error, -1.0), 1.0)
        integral = self.integral + INTEGRAL * error * dt
        duty = PROPORTIONAL * error + integral
        limited = min(max(duty, -1.0), 1.0)
        if duty == limited or (duty - limited) * error < 0.0:
            self.integral = integral
        return limited


def turned(speed: float, duty: float, dt: float, load: float = 0.0) -> float:
    """Speed [m/s] of a motor's wheel dt [s] on; `load` in parts of what full duty can push, against the motion.

    Friction and load hold a wheel at rest and bring a turning one to rest, not beyond.
    """
    against = FRICTION + load
    pushed = speed + (duty * FULL_SPEED - speed) * dt / LAG
    brake = against * FULL_SPEED * dt / LAG
    if abs(pushed) <= brake:
        return 0.0
    return pushed - brake if pushed > 0.0 else pushed + brake
