"""An estimate given by weighted samples, as a particle filter has it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.result import PoseEstimate
from data.se2 import Array, wrap_angle


class Samples(NamedTuple):
    """Poses (n, 3), world frame, and their weights (n,), which need not sum to one (None: all alike)."""

    poses: Array
    weights: Array | None = None

    def estimate(self) -> PoseEstimate:
        """Weighted mean, of the heading the circular one, and unbiased weighted covariance about it.

        For weights that sum to one the covariance is sum w d d' / (1 - sum w^2), which is the sample covariance with
        n - 1 where all weights are alike. Raises ValueError for shapes that do not fit, weights that are negative or
        not finite, or where a single sample has all of it.
        """
        poses = np.asarray(self.poses, float)
        if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) < 2:
            raise ValueError(f"samples have shape {poses.shape}; (n, 3) with n > 1 is needed")
        w = np.ones(len(poses)) if self.weights is None else np.asarray(self.weights, float)
        if w.shape != (len(poses),) or not np.isfinite(w).all() or (w < 0.0).any() or not w.sum() > 0.0:
            raise ValueError(f"{len(poses)} samples need as many weights, none negative, not all zero")
        w = w / w.sum()
        spread = 1.0 - float(w @ w)
        if spread <= 1e-12:
            raise ValueError("one sample has all the weight; of one sample there is no covariance")
        mean = w @ poses
        mean[2] = np.arctan2(w @ np.sin(poses[:, 2]), w @ np.cos(poses[:, 2]))
        off = poses - mean
        off[:, 2] = wrap_angle(off[:, 2])
        return PoseEstimate(mean, (w[:, None] * off).T @ off / spread)
