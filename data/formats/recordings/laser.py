"""What the estimators get of a recorded laser robot: increments of its odometry, its scans, and no observations.

Increments of a robot from the poses of its wheel odometry, with the noise that wheels have.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.inputs import Increments, Inputs, Observations, Prior, Scans
from data.motion.velocity import floor_covariances
from data.se2 import Array, between
from data.sensors import RangeBearing

TRANSLATION_PER_METRE, TRANSLATION_PER_RADIAN = 0.05, 0.05
"""m / sqrt(m), m / sqrt(rad)."""
ROTATION_PER_METRE, ROTATION_PER_RADIAN = 0.075, 0.045
"""rad / sqrt(m), rad / sqrt(rad). All four are measured: the largest-likelihood fit of the variances to the difference
between raw odometry and the poses of a particle filter over the 909 stretches between corrections of the Intel log
(median 0.7 m, 0.5 rad): 0.051 and 0.033 along, 0.032 and 0.072 across, 0.075 and 0.043 in heading; standardised,
the errors have a fourth moment of 3.8, 3.0 and 3.9, a Gaussian's being 3."""
FLOOR = 1e-10
"""Smallest eigenvalue of an increment's covariance, for a robot at rest [m^2, rad^2]."""


class TravelNoise(NamedTuple):
    """Odometry noise that grows with the way: standard deviations per square root of a metre and of a radian.

    `translation_*` of the motion along and across [m / sqrt(m), m / sqrt(rad)], `rotation_*` of the heading
    [rad / sqrt(m), rad / sqrt(rad)].
    """

    translation_per_metre: float = TRANSLATION_PER_METRE
    translation_per_radian: float = TRANSLATION_PER_RADIAN
    rotation_per_metre: float = ROTATION_PER_METRE
    rotation_per_radian: float = ROTATION_PER_RADIAN


MEASURED = TravelNoise()


def increments_of(pose: Array, noise: TravelNoise = MEASURED) -> tuple[Increments, int]:
    """Increments (N) between odometry poses (N, 3), and how many got the covariance floor.

    Variances grow with the distance d and the turn |a| of an increment: those along and across by
    0.05^2 d + 0.05^2 |a|, that of the heading by 0.075^2 d + 0.045^2 |a| (with the default noise). It is the
    four-parameter model of Probabilistic Robotics, section 5.4, with variances instead of sigmas in proportion to the
    motion, so that an increment cut in two has the same total however often odometry is logged.
    """
    mean = np.zeros((len(pose), 3))
    mean[1:] = between(pose[:-1], pose[1:])
    mean[1:][(pose[1:] == pose[:-1]).all(axis=1)] = 0.0  # at rest, not a rounding away from it
    distance, turn = np.hypot(mean[:, 0], mean[:, 1]), np.abs(mean[:, 2])
    covariance = np.zeros((len(pose), 3, 3))
    along = noise.translation_per_metre**2 * distance + noise.translation_per_radian**2 * turn
    covariance[:, 0, 0] = covariance[:, 1, 1] = along
    covariance[:, 2, 2] = noise.rotation_per_metre**2 * distance + noise.rotation_per_radian**2 * turn
    covariance, floored = floor_covariances(covariance, FLOOR)
    return Increments(mean, covariance), floored


def made_increasing(stamp: Array) -> Array:
    """Stamps (N,) in the order they were recorded as strictly increasing times: one that is not above all before it
    becomes the largest before it plus 1 us (or the next number there is, where 1 us is lost to rounding).
    """
    time = np.array(stamp, float)
    for i in range(1, len(time)):
        if not time[i] > time[i - 1]:
            time[i] = max(time[i - 1] + 1e-6, np.nextafter(time[i - 1], np.inf))
    return time


def laser_inputs(pose: Array, stamp: Array, scans: Scans) -> Inputs:
    """Inputs from odometry poses (N, 3) and stamps (N,) [s] in the order they were recorded, and scans.

    The first pose is that of the odometry, exactly: nothing else fixes the frame of the map. Times are the stamps made
    strictly increasing.
    """
    increments, floored = increments_of(pose)
    return Inputs(
        prior=Prior(pose[0], np.zeros((3, 3))),
        time=made_increasing(stamp),
        increments=increments,
        observations=Observations(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2))),
        sensor=RangeBearing(scans.scanner.max_range),
        covariance_floor=FLOOR,
        floored=floored,
        scans=scans,
    )
