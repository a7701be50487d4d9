"""Parts of a run, written by hand."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from data.result import MapEstimate, Run, Trajectory
from data.se2 import Array


def path_of(pose: ArrayLike, covariance: ArrayLike = 1e-4) -> Trajectory:
    """Poses (N, 3) with one variance of all components, or (3, 3), or (N, 3, 3)."""
    poses, C = np.asarray(pose, float), np.asarray(covariance, float)
    return Trajectory(poses, np.broadcast_to(C if C.ndim else C * np.eye(3), (len(poses), 3, 3)).copy())


def estimate_of(xy: ArrayLike, sigma: float = 0.1, number: ArrayLike | None = None) -> MapEstimate:
    """Landmarks (L, 2) with the standard deviation [m] of both coordinates, seen once, in frame 0."""
    places = np.reshape(np.asarray(xy, float), (-1, 2))
    n = np.arange(len(places)) if number is None else np.asarray(number, np.int64)
    C = np.tile(sigma**2 * np.eye(2), (len(places), 1, 1))
    return MapEstimate(n, places, C, np.zeros(len(n), np.int64), np.ones(len(n), np.int64))


def run_of(path: Trajectory, decisions: ArrayLike, created: ArrayLike | None = None, **fields: object) -> Run:
    """A run of the EKF with `jcbb` whose first and last decisions (M,) are the same."""
    names = {"estimator": "ekf", "association": "jcbb", "task": "slam", "final": None, "map": None} | fields
    decided = np.asarray(decisions, np.int64)
    begun: Array = np.full(len(decided), -1) if created is None else np.asarray(created, np.int64)
    return Run(online=path, decisions=decided, final_decisions=decided, created=begun, **names)  # type: ignore[arg-type]
