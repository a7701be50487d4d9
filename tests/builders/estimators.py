"""Estimators driven frame by frame with given decisions."""

from typing import Any, NamedTuple

import numpy as np

from data.inputs import Inputs, IntArray
from data.result import Updated
from data.se2 import Array
from ekf.filter import FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam


class Driven(NamedTuple):
    """The estimates of the newest pose (N, 3), (N, 3, 3), and what each update returned."""

    pose: Array
    covariance: Array
    updates: list[Updated]


def ekf_of(inputs: Inputs, options: FilterOptions | None = None) -> EkfLocalizer | EkfSlam:
    options = options or FilterOptions()
    if inputs.map is None:
        return EkfSlam(inputs.prior, inputs.sensor, options, systematic=inputs.systematic)
    return EkfLocalizer(inputs.prior, inputs.sensor, inputs.map, options, systematic=inputs.systematic)


def drive(
    estimator: Any, inputs: Inputs, decisions: IntArray, *, threshold: float = np.inf, until: int | None = None
) -> Driven:
    """Predict, update and estimate through frames [0, until); an update in frames with observations only."""
    poses, covariances, done = [], [], []
    for k in range(len(inputs) if until is None else until):
        if k:
            estimator.predict(inputs.increment(k))
        if hasattr(estimator, "stamp"):
            estimator.stamp(inputs.time[k])
        rows = slice(inputs.start[k], inputs.start[k + 1])
        if rows.stop > rows.start:
            done.append(estimator.update(inputs.frame_observations(k), decisions[rows], threshold=threshold))
        pose, covariance = estimator.estimate()
        poses.append(pose)
        covariances.append(covariance)
    return Driven(np.array(poses), np.array(covariances), done)
