"""Calibration and noise of the UTIAS robots, tuned on Dataset 9 robot 3 only; every other log tests it.

Corrections are applied once on loading, before preintegration, so filter and smoother see the same numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from data.errors import UsageError
from data.motion.velocity import MAX_HOLD, VelocityModel, VelocityNoise
from data.se2 import Array

MOTION = VelocityModel(VelocityNoise("density", (0.03, 0.06)))
"""Noise of the odometry: m and rad per sqrt(s)."""
MIN_COSINE = 0.5
"""Smallest divisor of depth; bearings of this camera end at 33 degrees."""
POSITIVE = ("scale_v", "scale_omega", "range_scale", "sigma_range", "sigma_bearing")
FINITE = ("odometry_delay", "latency", "range_bias", "bearing_bias")


@dataclass(frozen=True)
class Calibration:
    """Corrections and noise of odometry and camera. The defaults correct nothing; UsageError for an invalid value.

    Attributes:
        scale_v: factor on the forward velocity of the odometry file.
        scale_omega: factor on its angular velocity.
        turn_limit: rad/s; largest turn rate of the robot (after `scale_omega`).
        turn_drag: m/rad; speed lost per turn rate (as limited), without reversing.
        midpoint_hold: a command acts from half-way between the stamp before it and its own (at most 0.5 s earlier).
        odometry_delay: s from the stamp of a command to its effect.
        latency: s from the exposure of an image to its stamp.
        range_is_depth: the measured range is the depth, true range * cos(measured bearing).
        range_scale: range_bias: m; measured range = range_scale * true range (or depth) + range_bias.
        bearing_bias: rad; measured bearing = true bearing + bearing_bias.
        sigma_range: m, sigma_bearing: rad, standard deviations of a corrected observation.
        sigma_range_growth: m/m; the range sigma is sigma_range + sigma_range_growth * (corrected range).
        motion: how odometry becomes increments, and its noise.
    """

    scale_v: float = 1.0
    scale_omega: float = 1.0
    turn_limit: float = math.inf
    turn_drag: float = 0.0
    midpoint_hold: bool = False
    odometry_delay: float = 0.0
    latency: float = 0.0
    range_is_depth: bool = False
    range_scale: float = 1.0
    range_bias: float = 0.0
    bearing_bias: float = 0.0
    sigma_range: float = 0.15
    sigma_bearing: float = 0.1
    sigma_range_growth: float = 0.0
    motion: VelocityModel = MOTION

    def __post_init__(self) -> None:
        rules: tuple[tuple[str, Callable[[float], bool], tuple[str, ...]], ...] = (
            ("a positive number is needed", lambda v: 0.0 < v < math.inf, POSITIVE),
            ("a positive turn rate is needed", lambda v: v > 0.0, ("turn_limit",)),
            ("must not be negative", lambda v: 0.0 <= v < math.inf, ("sigma_range_growth", "turn_drag")),
            ("a finite number is needed", math.isfinite, FINITE),
        )
        for what, fine, names in rules:
            for name in names:
                if not fine(getattr(self, name)):
                    raise UsageError(f"calibration: {name} = {getattr(self, name)}; {what}")

    def with_sigma(self, sigma_range: float, sigma_bearing: float) -> Calibration:
        """The same with standard deviations [m, rad] that do not depend on the range."""
        return replace(self, sigma_range=sigma_range, sigma_bearing=sigma_bearing, sigma_range_growth=0.0)

    def velocities(self, v: Array, omega: Array) -> tuple[Array, Array]:
        """Corrected velocities [m/s, rad/s] (K,) of commands (K,)."""
        turn = np.clip(self.scale_omega * omega, -self.turn_limit, self.turn_limit)
        speed = np.sign(v) * np.maximum(self.scale_v * np.abs(v) - self.turn_drag * np.abs(turn), 0.0)
        return speed, turn

    def instants(self, seconds: Array) -> Array:
        """Times at which commands stamped at `seconds` (K,), ascending, begin to act."""
        before = np.minimum(np.diff(seconds, prepend=seconds[:1]), MAX_HOLD)
        begin: Array = seconds - 0.5 * before if self.midpoint_hold else seconds
        return begin + self.odometry_delay

    def readings(self, z: Array) -> Array:
        """Corrected range [m] and bearing [rad] (M, 2) of raw ones; ranges are >= 0."""
        distance = np.maximum((z[:, 0] - self.range_bias) / self.range_scale, 0.0)
        if self.range_is_depth:
            distance = distance / np.maximum(np.cos(z[:, 1]), MIN_COSINE)
        return np.stack([distance, z[:, 1] - self.bearing_bias], axis=-1)

    def noise(self, z: Array) -> Array:
        """R (M, 2, 2) of corrected observations (M, 2), from the measured range."""
        R = np.zeros((len(z), 2, 2))
        R[:, 0, 0] = np.square(self.sigma_range + self.sigma_range_growth * z[:, 0])
        R[:, 1, 1] = self.sigma_bearing**2
        return R


# Measured on Dataset 9 robot 3 against its ground truth, without bad stretches:
# - range_is_depth: the published range is a depth, 0.06 m + 1.01 r cos(bearing); the residual's spread falls from
#   0.118 m (best line in r) to 0.030 m.
# - turn_limit: both turn commands, 0.90 and -1.00 rad/s, turn the robot at 0.59 rad/s: a limit, not a scale.
# - scale_v, turn_drag: v = 1.07 v_cmd - 0.073 |omega| reduces the RMS displacement error over 0.5 s from 8.4 to 2.9 mm.
# - latency: the bearing residual's spread is smallest at 0.04 s.
# - bearing_bias stays 0: that log has -0.021 rad, but a camera's mounting differs between robots and days.
# The noise minimizes the localizer's position RMSE there. It exceeds the observations' spread (0.03 m, 0.02 rad),
# because the remaining errors are constant for minutes, not white.
FROZEN = Calibration(
    scale_v=1.07,
    turn_drag=0.073,
    turn_limit=0.59,
    midpoint_hold=True,
    odometry_delay=0.11,
    latency=0.04,
    range_is_depth=True,
    range_scale=1.01,
    range_bias=0.06,
    sigma_range=0.05,
    sigma_range_growth=0.03,
    sigma_bearing=0.05,
    motion=VelocityModel(VelocityNoise("density", (0.03, 0.08))),
)
"""The default calibration."""
