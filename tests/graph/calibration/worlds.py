"""A small world whose odometry and sensor err systematically, and marks for what can err."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data import se2
from data.inputs import Increments, Inputs, LabelledObservations, LandmarkMap, Prior, Systematic
from data.motion.systematic import corrected_all, places
from data.sensors import RangeBearing, RelativePoint

OFF_CENTRE = {"rotation": 0.6, "translation": (0.3, -0.2)}
ODOMETRY = ("scale", "curvature", "left", "right")
ALL = ("scale", "curvature", "left", "right", "drift", "range", "bearing")
SIGMA = {"scale": 0.05, "curvature": 0.05, "left": 0.05, "right": 0.05, "drift": 0.02, "range": 0.05, "bearing": 0.05}
TRUE = {"scale": 0.04, "curvature": 0.05, "left": 0.03, "right": -0.04, "drift": 0.02, "range": 0.05, "bearing": -0.06}
POLAR, CARTESIAN = RangeBearing(max_range=8.0), RelativePoint(max_range=8.0)
POLAR_OFF, CARTESIAN_OFF = RangeBearing(max_range=8.0, **OFF_CENTRE), RelativePoint(max_range=8.0, **OFF_CENTRE)
P0 = np.array([[0.0004, 0.0001, 0.0], [0.0001, 0.0002, 0.0], [0.0, 0.0, 0.0001]])


def to_estimate(*names):
    """Errors with the world's sigmas; a drift with knots every 1.6 m."""
    return Systematic(names, np.array([SIGMA[n] for n in names]), 8.0)


def erring(systematic, sensor, *, frames=40, landmarks=8, noise=0.3, seed=0, see=0.7, sigma=(0.04, 0.02, 0.015)):
    """(Inputs with a map and labels, true poses, true landmarks); `noise` scales what is drawn, not what is stated."""
    rng = np.random.default_rng(seed)
    M = np.diag(np.array(sigma) ** 2)
    M[0, 2] = M[2, 0] = 0.4 * sigma[0] * sigma[2]
    measured = np.tile([0.4, 0.0, 0.17], (frames, 1))
    measured[:, 2] *= np.where(np.arange(frames) % 17 < 12, 1.0, -0.8)
    measured[0] = 0.0
    b = np.array([0.0 if n in ("range", "bearing") else TRUE[n] for n in systematic.names])
    noisy = measured + noise * rng.multivariate_normal(np.zeros(3), M, frames) * (np.arange(frames) > 0)[:, None]
    covariance = np.tile(M, (frames, 1, 1))
    covariance[0] = 0.0
    moved = corrected_all(measured, covariance, np.tile(b, (frames, 1)), places(systematic), np.zeros(3)).mean
    path = np.tile([2.0, -1.0, 0.4], (frames, 1))
    for k in range(1, frames):
        path[k] = se2.compose(path[k - 1], moved[k])
    xy = path[:, :2].mean(0) + rng.uniform(-5.0, 5.0, (landmarks, 2))
    frame, label = np.nonzero(rng.random((frames, landmarks)) < see)
    z = read_wrongly(sensor, sensor.predict(path[frame], xy[label]), systematic.names, TRUE)
    near = sensor.polar(z)[:, 0] < sensor.max_range
    frame, label, z = frame[near], label[near], z[near]
    R = np.array(
        [[0.01, 0.001], [0.001, 0.0009]] if isinstance(sensor, RangeBearing) else [[0.02, 0.006], [0.006, 0.01]]
    )
    z = z + noise * rng.multivariate_normal(np.zeros(2), R, len(z))
    start = path[0] + noise * rng.multivariate_normal(np.zeros(3), P0)
    inputs = Inputs(
        Prior(start, P0),
        np.arange(frames, dtype=float),
        Increments(noisy, covariance),
        LabelledObservations(frame, z, np.tile(R, (len(z), 1, 1)), label),
        sensor,
        LandmarkMap(np.arange(landmarks), xy),
        systematic=systematic,
    )
    return inputs, path, xy


def read_wrongly(sensor, z, names, errors):
    """What a sensor that errs reads for z (m, 2): ranges (1 + range) times too long, bearings + bearing."""
    far = 1.0 + (errors["range"] if "range" in names else 0.0)
    turn = errors["bearing"] if "bearing" in names else 0.0
    if isinstance(sensor, RangeBearing):
        return z * np.array([far, 1.0]) + np.array([0.0, turn])
    return far * z @ se2.rotation(turn).T


def truncated(inputs, frames):
    """The first frames of a log."""
    o, m = inputs.observations, inputs.start[frames]
    return replace(
        inputs,
        time=inputs.time[:frames],
        increments=Increments(inputs.increments.mean[:frames], inputs.increments.covariance[:frames]),
        observations=LabelledObservations(o.frame[:m], o.z[:m], o.R[:m], o.label[:m]),
    )
