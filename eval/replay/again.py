"""A filter's run once more with the decisions that it made, to see what it does not keep: its map at every instant."""

from __future__ import annotations

import math

import numpy as np

from data.inputs import Inputs
from data.result import Run
from data.se2 import Array
from eval.replay.estimators import make_estimator
from eval.replay.names import FILTERS

MOST_WORK = 3e7
"""Entries of covariances, frame by frame: beyond (Victoria Park: 2e9) looking again takes longer than a figure may."""


def landmark_sigmas(inputs: Inputs, run: Run) -> Array | None:
    """Standard deviation (N, L) [m] of each landmark along its least certain direction after every frame.

    NaN before a landmark is initialized and after it was removed. None of runs that are no EKF-SLAM of ours from start
    to end, that parked landmarks, or that are too large to be looked at again.
    """
    size = run.state_size
    if run.estimator not in FILTERS or run.task != "slam" or run.failure is not None or size is None:
        return None
    if float(np.sum(np.asarray(size, float) ** 2)) > MOST_WORK or run.events:
        return None
    inputs = inputs.without_map().without_labels()
    estimator = make_estimator(run.estimator, inputs)
    count = int(run.created.max(initial=-1)) + 1
    sigma = np.full((len(inputs), count), math.nan)
    for k in range(len(inputs)):
        frame = inputs.frame(k)
        if frame.increment is not None:
            estimator.predict(frame.increment)
        estimator.stamp(frame.time)
        rows = slice(frame.first, frame.first + len(frame.sightings.z))
        if rows.stop > rows.start:
            done = estimator.update(frame.sightings, run.decisions[rows])
            if not np.array_equal(done.created, run.created[rows]):
                return None
        if run.removed is not None and np.any(run.removed == k):
            estimator.remove(np.flatnonzero(run.removed == k))
        m = estimator.landmarks()
        if len(m.number):
            largest = np.linalg.eigvalsh(m.covariance)[:, -1]
            sigma[k, m.number] = np.sqrt(np.maximum(largest, 0.0))
        if not np.allclose(estimator.estimate().mean, run.trajectory("online").pose[k], atol=1e-6):
            return None
    return sigma
