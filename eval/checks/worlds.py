"""Small inputs with known results: a linear world, an arena without noise, rotated, or without observations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.log import Log
from data.se2 import Array, between, compose, rotation, wrap_angle
from data.worlds import arena, linear

FRAMES = 16
SEED = 3
SILENT = slice(6, 10)  # frames that see nothing, in the log with empty frames


def linear_log() -> Log:
    """A short world with a linearization error of 1e-3 standard deviations."""
    return linear.simulate(linear.LinearWorld(frames=FRAMES, laps=0.3), SEED)


def arena_log() -> Log:
    """A robot surrounded by landmarks, with bearings across +-pi."""
    return arena.simulate(arena.Arena(frames=FRAMES, landmarks=14, side=18.0), SEED)


def noise_free(log: Log) -> Log:
    """The same without noise; the covariances stay as stated."""
    r, t = log.recorded, log.truth
    assert t.pose is not None
    assert t.landmarks is not None
    assert t.landmark_of is not None
    mean = np.zeros_like(r.increments.mean)
    mean[1:] = between(t.pose[:-1], t.pose[1:])
    o = r.observations
    z = r.sensor.predict(t.pose[o.frame], t.landmarks.positions(t.landmark_of))
    exact = replace(
        r,
        prior=Prior(t.pose[0], r.prior.covariance),
        increments=Increments(mean, r.increments.covariance),
        observations=Observations(o.frame, z, o.R),
    )
    return replace(log, recorded=exact)


def silent(log: Log, frames: slice) -> Log:
    """The same without the observations of some frames."""
    r, t = log.recorded, log.truth
    assert t.landmark_of is not None
    seen = ~np.isin(r.observations.frame, np.arange(len(r))[frames])
    o = Observations(r.observations.frame[seen], r.observations.z[seen], r.observations.R[seen])
    return replace(log, recorded=replace(r, observations=o), truth=replace(t, landmark_of=t.landmark_of[seen]))


def turned(inputs: Inputs, angle: float) -> Inputs:
    """The same inputs in a world rotated about its origin by an angle [rad]."""
    R = np.eye(3)
    R[:2, :2] = rotation(angle)
    prior = Prior(compose(np.array([0.0, 0.0, angle]), inputs.prior.mean), R @ inputs.prior.covariance @ R.T)
    known = None if inputs.map is None else LandmarkMap(inputs.map.id, inputs.map.xy @ R[:2, :2].T)
    return replace(inputs, prior=prior, map=known)


def turned_back(poses: Array, angle: float) -> Array:
    """Poses (N, 3) in the world before its rotation."""
    back = np.array(poses)
    back[:, :2] = back[:, :2] @ rotation(angle)
    back[:, 2] = wrap_angle(back[:, 2] - angle)
    return back
