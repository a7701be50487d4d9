"""A park: a robot drives rounds among trees, sees few of them at a time, and its odometry errs in system."""

from __future__ import annotations

import numpy as np

from data import se2
from data.inputs import Increment, Increments, Inputs, Observations, Prior
from data.motion.systematic import CURVATURE, LEFT, RIGHT, SCALE, corrected
from data.sensors import RelativePoint

PLACE = np.array([SCALE, CURVATURE, LEFT, RIGHT])
ERRORS = np.array([0.0, 0.0015, 0.04, 0.01])
M = np.diag([0.02, 0.01, 0.004]) ** 2
R = 0.3**2 * np.eye(2)


def park(seed, *, rounds=2.2, trees=90, seen=0.25, radius=55.0):
    """(Inputs, true poses (N, 3), true id of each observation (M,)); a round is about 350 m."""
    rng = np.random.default_rng(seed)
    sensor = RelativePoint(max_range=25.0, min_angle=-np.pi / 2, max_angle=np.pi / 2)
    frames = int(rounds * 2 * np.pi * radius)
    turn = np.full(frames, 1.0 / radius) + 0.03 * np.sin(np.arange(frames) / 17.0)
    truth, mean = [np.zeros(3)], [np.zeros(3)]
    for k in range(1, frames):
        step = np.array([1.0, 0.0, turn[k]])
        truth.append(se2.compose(truth[-1], step))
        A = corrected(Increment(step, M), np.zeros(4), PLACE, np.zeros(3)).A
        mean.append(step - A @ ERRORS + rng.multivariate_normal(np.zeros(3), M))
    truth = np.array(truth)
    xy = np.empty((0, 2))
    while len(xy) < trees:
        tree = truth[rng.integers(frames), :2] + rng.uniform(-18.0, 18.0, 2)
        if np.hypot(*(truth[:, :2] - tree).T).min() > 2.0 and np.all(np.hypot(*(xy - tree).T) > 2.0):
            xy = np.vstack([xy, tree])
    frame, z, who = [], [], []
    for k in range(frames):
        there = sensor.predict(truth[k], xy)
        looked = sensor.in_view(there) & (rng.random(trees) < seen)
        for i in np.flatnonzero(looked & (np.hypot(*there.T) < 20.0)):
            frame.append(k)
            z.append(there[i] + rng.multivariate_normal(np.zeros(2), R))
            who.append(i)
    increments = Increments(np.array(mean), np.concatenate([np.zeros((1, 3, 3)), np.tile(M, (frames - 1, 1, 1))]))
    seen_all = Observations(np.array(frame), np.array(z), np.tile(R, (len(z), 1, 1)))
    start = Prior(np.zeros(3), np.zeros((3, 3)))
    return Inputs(start, np.arange(frames, dtype=float), increments, seen_all, sensor, None), truth, np.array(who)
