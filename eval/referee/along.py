"""The errors of one run frame by frame along its log, from which its metrics, scores and intervals are made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data.log import Log
from data.result import Run
from data.se2 import Array, BoolArray
from eval.referee import consistency, errors


@dataclass(frozen=True, eq=False)
class Along:
    """Errors of one run and phase, per frame (N,); NaN: no truth.

    Attributes:
        distance: of the estimated position from the true one [m].
        thin: frames of nearly singular covariance, which are in no NEES and no score of the belief.
        nees: of each quantity (`consistency.QUANTITIES`); NaN also where thin or not invertible.
    """

    distance: Array
    thin: BoolArray
    nees: Mapping[str, Array]


def along(run: Run, phase: str, log: Log) -> Along | None:
    """Errors of a run in a phase along its log; None where no pose is known or the run did not get to the end."""
    truth = log.truth.pose
    if run.failure is not None or truth is None or not np.isfinite(truth).all(axis=1).any():
        return None
    trajectory = run.trajectory(phase)
    pose, covariance = trajectory.pose, trajectory.covariance
    thin = consistency.nearly_singular(covariance, log.recorded.covariance_floor)
    sound = np.where(thin[:, None], np.nan, pose)
    nees = {q: consistency.nees(sound, covariance, truth, q) for q in consistency.QUANTITIES}
    return Along(errors.position_distance(pose, truth), thin, nees)
