"""Inputs of SLAM for replays: of any log, and of a world that is linear."""

import numpy as np

from tests.builders.logs import increments_of, inputs_of, observations_of


def slam(log, *, labels=False):
    return log.inputs(labels=labels).without_map()


def linear_world(seed, frames=25):
    """SLAM with the heading known exactly and a Cartesian sensor: linear and Gaussian, landmarks 0.8 m apart."""
    rng = np.random.default_rng(seed)
    landmarks = np.array([(0.8 * i, 0.8 * j) for i in range(5) for j in range(4)])
    at, mean, frame, z = np.array([1.0, 1.0]), np.zeros((frames, 3)), [], []
    for k in range(frames):
        if k:
            step = rng.uniform(-0.5, 0.5, 2)
            at, mean[k, :2] = at + step, step + rng.normal(0.0, 0.05, 2)
        seen = np.flatnonzero(np.hypot(*(landmarks - at).T) < 2.0)
        frame += [k] * len(seen)
        z += list(landmarks[seen] - at + rng.normal(0.0, 0.08, (len(seen), 2)))
    increments = increments_of(mean, np.diag([0.05**2, 0.05**2, 1e-11]))
    spread = np.diag([0.01, 0.01, 1e-11])
    return inputs_of(increments, observations_of(frame, z, 0.08**2), start=[1.0, 1.0, 0.0], spread=spread)
