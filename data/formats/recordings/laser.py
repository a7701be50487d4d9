"""Estimator inputs of a recorded laser robot: odometry increments with wheel noise, scans, and no observations."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from data.inputs import Increments, Inputs, Observations, Prior, Scans
from data.motion.velocity import floor_covariances
from data.se2 import Array, between
from data.sensors import RangeBearing

FLOOR = 1e-10  # Smallest eigenvalue of an increment's covariance, for a robot at rest [m^2, rad^2]


class TravelNoise(NamedTuple):
    """Odometry noise that grows with travel: standard deviations per sqrt(m) and per sqrt(rad).

    The defaults are a maximum-likelihood fit to raw odometry against particle filter poses, over the 909 stretches
    between corrections of the Intel log: 0.051 and 0.033 along, 0.032 and 0.072 across, 0.075 and 0.043 in heading.
    """

    translation_per_metre: float = 0.05  # along and across the motion, m / sqrt(m)
    translation_per_radian: float = 0.05  # the same, m / sqrt(rad)
    rotation_per_metre: float = 0.075  # of the heading, rad / sqrt(m)
    rotation_per_radian: float = 0.045  # the same, rad / sqrt(rad)


MEASURED = TravelNoise()


def increments_of(pose: Array, noise: TravelNoise = MEASURED) -> tuple[Increments, int]:
    """Increments (N) between odometry poses (N, 3), and how many got the covariance floor.

    Variances grow with the distance d and the turn |a| of an increment: along and across 0.05^2 d + 0.05^2 |a|, of the
    heading 0.075^2 d + 0.045^2 |a| (with the default noise). It is the four-parameter model of Probabilistic Robotics,
    section 5.4, with additive variances, so that splitting an increment does not change the total.
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
    """Stamps (N,) made strictly increasing: one not above all before becomes the largest + 1 us, or the next float."""
    time = np.array(stamp, float)
    for i in range(1, len(time)):
        if not time[i] > time[i - 1]:
            time[i] = max(time[i - 1] + 1e-6, np.nextafter(time[i - 1], np.inf))
    return time


SPEED, TURN_RATE = 0.3, 0.7  # m/s, rad/s, sigmas of an unknown motion's changes, times the time between frames
BURST = 0.1  # Share of the mean time between frames, and of shorter ones, from which on stamps come in bursts


def unknown_motion(time: Array, speed: float = SPEED) -> Increments:
    """No motion between frames at `time` (N,), with the standard deviation of a robot's speed [m/s]."""
    covariance = np.zeros((len(time), 3, 3))
    covariance[1:] = np.diag([speed**2, speed**2, TURN_RATE**2]) * time_steps(time)[1:, None, None] ** 2
    return Increments(np.zeros((len(time), 3)), covariance)


def without_odometry(inputs: Inputs, speed: float = SPEED) -> Inputs:
    """The same log with unknown motion, within a robot's speed [m/s]."""
    return replace(inputs, increments=unknown_motion(inputs.time, speed), floored=0)


def time_steps(time: Array) -> Array:
    """Seconds (N,) from the frame before, 0 for the first; their mean where stamps come in bursts."""
    step = np.diff(time, prepend=time[0])
    if len(time) > 1 and float(np.mean(step[1:] < BURST * step[1:].mean())) > BURST:
        step[1:] = step[1:].mean()
    return step


def laser_inputs(pose: Array, stamp: Array, scans: Scans) -> Inputs:
    """Inputs of odometry poses (N, 3), the first exact, and stamps (N,) [s], made strictly increasing, and scans."""
    increments, floored = increments_of(pose)
    return Inputs(
        prior=Prior(pose[0], np.zeros((3, 3))), time=made_increasing(stamp), increments=increments,
        observations=Observations(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2))),
        sensor=RangeBearing(scans.scanner.max_range), covariance_floor=FLOOR, floored=floored, scans=scans,
    )  # fmt: skip
