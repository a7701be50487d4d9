"""Faults injected into a simulated log, to test whether its own data reveal them.

Stated covariances, sensor, map and prior do not change, nor do truth and frames. Each fault is a pure function of log,
size and generator. It keeps the noise of the log, so logs with different sizes differ by the fault alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from data.errors import UsageError
from data.inputs import Increments, IntArray
from data.log import Log
from data.se2 import Array, between, interpolate, pose_error, rotation, wrap_angle
from data.sensors import RELATIVE_POINT
from eval.studies.scenario import with_wrong_labels

NOISE, ASSOCIATIONS = "noise", "associations"
NEAREST = 1e-3  # m; no fault makes a range shorter than this (as in the corridor)


@dataclass(frozen=True)
class Fault:
    """A fault of a log."""

    put_in: Callable[[Log, float, np.random.Generator], Log]  # (log, size, generator) -> the log with it
    sizes: tuple[float, float, float]  # three, from small to large
    none: float  # the size without fault
    unit: str  # of the size, empty for a share or a factor
    called: str  # the fault in words
    cause: str  # expected attribution, the `NOISE` model (systematic errors included) or the `ASSOCIATIONS`


def curvature(log: Log, size: float, rng: np.random.Generator) -> Log:
    """The odometry has a constant curvature error of `size` [rad/m]: wheels of unequal radius."""
    mean = log.recorded.increments.mean.copy()
    mean[:, 2] = wrap_angle(mean[:, 2] + size * np.hypot(mean[:, 0], mean[:, 1]))
    return _with_odometry(log, mean)


def distance_scale(log: Log, size: float, rng: np.random.Generator) -> Log:
    """The odometry overestimates distances by the share `size`: worn wheels."""
    mean = log.recorded.increments.mean.copy()
    mean[:, :2] *= 1.0 + size
    return _with_odometry(log, mean)


def odometry_noise(log: Log, size: float, rng: np.random.Generator) -> Log:
    """The error of each increment is multiplied by `size`, body frame."""
    mean, truth = log.recorded.increments.mean.copy(), _true_poses(log)
    error = pose_error(mean[1:], between(truth[:-1], truth[1:]))
    mean[1:] += (size - 1.0) * error
    mean[:, 2] = wrap_angle(mean[:, 2])
    return _with_odometry(log, mean)


def range_scale(log: Log, size: float, rng: np.random.Generator) -> Log:
    """The sensor overestimates distances by the share `size`."""
    z = log.recorded.observations.z.copy()
    z[:, : 1 if log.recorded.sensor.kind != RELATIVE_POINT else 2] *= 1.0 + size
    return _with_observations(log, z)


def bearing_bias(log: Log, size: float, rng: np.random.Generator) -> Log:
    """The sensor is rotated by `size` [rad] on its mount."""
    z = log.recorded.observations.z.copy()
    if log.recorded.sensor.kind != RELATIVE_POINT:
        z[:, 1] = wrap_angle(z[:, 1] + size)
    else:
        z = z @ rotation(size).T
    return _with_observations(log, z)


def latency(log: Log, size: float, rng: np.random.Generator) -> Log:
    """Observations are of the pose `size` [s] earlier; each keeps its noise.

    Between frames and before the first, the robot keeps its velocity; a log without stamps has a frame each second.
    """
    r, truth = log.recorded, _true_poses(log)
    rows, landmarks = _seen(log)
    frame, z = r.observations.frame[rows], r.observations.z.copy()
    moved = pose_error(_at(truth, r.time, r.time[frame] - size), _at(truth, r.time, r.time[frame]))
    exact, late = (r.sensor.predict(pose, landmarks) for pose in (truth[frame], truth[frame] + moved))
    z[rows] += r.sensor.residual(late, exact)
    if r.sensor.kind != RELATIVE_POINT:
        z[:, 1] = wrap_angle(z[:, 1])
    return _with_observations(log, z)


def wrong_labels(log: Log, size: float, rng: np.random.Generator) -> Log:
    """A share `size` of the labels names another landmark, see `with_wrong_labels`."""
    return with_wrong_labels(log, size, int(rng.integers(2**32)))


def heavy_tails(log: Log, size: float, rng: np.random.Generator) -> Log:
    """Observations have noise of a Student t distribution of `size` dof and the stated covariance.

    Bivariate, so an observation is bad as a whole: a Gaussian vector over the root of an independent chi-square (Kotz
    and Nadarajah, "Multivariate t Distributions and Their Applications", 2004). So each observation's own noise is
    multiplied. Infinitely many dof are the Gaussian. Raises ValueError for 2 or fewer, which have no covariance.
    """
    if not size > 2.0:
        raise ValueError(f"Student t with {size:g} dof has no covariance; more than 2 are needed")
    r, (rows, landmarks) = log.recorded, _seen(log)
    z = r.observations.z.copy()
    factor = np.ones(len(rows))
    if math.isfinite(size):
        factor = np.sqrt((size - 2.0) / rng.chisquare(size, len(rows)))
    noise = r.sensor.residual(z[rows], r.sensor.predict(_true_poses(log)[r.observations.frame[rows]], landmarks))
    z[rows] += (factor - 1.0)[:, None] * noise
    if r.sensor.kind != RELATIVE_POINT:
        z[:, 1] = wrap_angle(z[:, 1])
    return _with_observations(log, z)


FAULTS: Mapping[str, Fault] = {
    "curvature": Fault(
        curvature, (0.005, 0.01, 0.02), 0.0, "rad/m", "the odometry has a constant curvature error", NOISE
    ),
    "distance-scale": Fault(distance_scale, (0.01, 0.02, 0.05), 0.0, "", "the odometry overestimates distances", NOISE),
    "odometry-noise": Fault(odometry_noise, (0.5, 1.5, 2.0), 1.0, "", "the odometry's noise is misstated", NOISE),
    "range-scale": Fault(range_scale, (0.01, 0.02, 0.05), 0.0, "", "the sensor overestimates distances", NOISE),
    "bearing-bias": Fault(bearing_bias, (0.0025, 0.005, 0.01), 0.0, "rad", "the sensor is rotated on its mount", NOISE),
    "latency": Fault(latency, (0.05, 0.1, 0.2), 0.0, "s", "observations are stamped too late", NOISE),
    "wrong-labels": Fault(wrong_labels, (0.005, 0.02, 0.05), 0.0, "", "labels name other landmarks", ASSOCIATIONS),
    "heavy-tails": Fault(heavy_tails, (5.0, 3.0, 2.5), math.inf, "dof", "observations have heavy tails", NOISE),
}
"""Faults by name.

Sizes of systematic ones are around 2, 4 and 10 standard deviations of the efficient estimate (`graph.qr.score_test`) in
SLAM of the default arena, seed 0: 2.9, 5.8, 11.6 of curvature, 2.0, 3.9, 9.8 of either scale, 2.9, 5.8, 11.6 of the
bearing, 2.2, 4.4, 8.9 of latency."""


def _true_poses(log: Log) -> Array:
    """True poses (N, 3). Raises UsageError if one is missing."""
    if log.truth.known_poses < len(log.recorded) or log.truth.pose is None:
        raise UsageError(f"{log.name}: this fault needs the true pose of every frame")
    return log.truth.pose


def _at(truth: Array, time: Array, at: Array) -> Array:
    """Poses (m, 3) at the instants `at` [s], before the first frame with the velocity of the first interval."""
    pose = interpolate(time, truth, at)
    if len(time) > 1:
        early = np.minimum((at - time[0]) / (time[1] - time[0]), 0.0)
        pose += early[:, None] * pose_error(truth[1], truth[0])
    return pose


def _seen(log: Log) -> tuple[IntArray, Array]:
    """Rows (m,) of the observations of landmarks, and their true positions (m, 2); clutter is excluded."""
    if log.truth.landmark_of is None or log.truth.landmarks is None:
        raise UsageError(f"{log.name}: this fault needs the true landmark of every observation")
    rows = np.flatnonzero(log.truth.landmark_of >= 0)
    return rows, log.truth.landmarks.positions(log.truth.landmark_of[rows])


def _with_odometry(log: Log, mean: Array) -> Log:
    """The log with increments of this mean (N, 3), their covariances as stated."""
    r = log.recorded
    return replace(log, recorded=replace(r, increments=Increments(mean, r.increments.covariance)))


def _with_observations(log: Log, z: Array) -> Log:
    """The log with observations z (M, 2), their covariances as stated; ranges are at least `NEAREST`."""
    r = log.recorded
    if r.sensor.kind != RELATIVE_POINT:
        z[:, 0] = np.maximum(z[:, 0], np.minimum(r.observations.z[:, 0], NEAREST))
    return replace(log, recorded=replace(r, observations=replace(r.observations, z=z)))
