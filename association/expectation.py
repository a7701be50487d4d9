"""What an estimator expects to see, and nothing else: all that an association method is given.

The EKF forms it from its covariance, iSAM2 from joint marginals; a recorded problem can be stated with plain arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from data.inputs import IntArray
from data.se2 import Array

Residual = Callable[[Array, Array], Array]


def gate_threshold(probability: float | None, dof: int = 2) -> float:
    """Squared distance that a chi-square variable of `dof` stays below with `probability`; None: no gate."""
    if probability is None:
        return float("inf")
    if not 0.0 < probability < 1.0:
        raise ValueError(f"gate {probability}: a probability between 0 and 1, or none")
    return float(chi2.ppf(probability, dof))


def plain_residual(z: Array, z_hat: Array) -> Array:
    """Difference without angles, for problems stated in Cartesian coordinates."""
    difference: Array = np.asarray(z, float) - np.asarray(z_hat, float)
    return difference


@dataclass(frozen=True)
class Expectation:
    """Candidates and observations of a frame (or of a window of frames).

    Attributes:
        number: (n,) landmark number of each candidate.
        z_hat: (n, 2) expected measurement.
        HPHt: (n, 2, 2) covariance of the expectation, measurement noise not included.
        frame: (n,) frame in which the candidate is expected.
        z: (m, 2), R: (m, 2, 2) the observations; observed_frame: (m,) their frames.
        residual: the sensor's `residual(z, z_hat)`, broadcasting.
        joint: `joint(indices)` gives the joint covariance (2k, 2k) of the expectations of k candidates, in that order.
    """

    number: IntArray
    z_hat: Array
    HPHt: Array
    frame: IntArray
    z: Array
    R: Array
    observed_frame: IntArray
    residual: Residual
    joint: Callable[[IntArray], Array]

    @classmethod
    def from_arrays(
        cls, z: Array, z_hat: Array, joint_HPHt: Array, R: Array, residual: Residual = plain_residual
    ) -> Expectation:
        """A problem stated with plain arrays: z (m, 2), z_hat (n, 2), joint_HPHt (2n, 2n), R (m, 2, 2)."""
        z, z_hat = np.asarray(z, float).reshape(-1, 2), np.asarray(z_hat, float).reshape(-1, 2)
        full = np.asarray(joint_HPHt, float)
        n, m = len(z_hat), len(z)
        if full.shape != (2 * n, 2 * n):
            raise ValueError(f"joint covariance has shape {full.shape}; {n} candidates need {(2 * n, 2 * n)}")

        def joint(indices: IntArray) -> Array:
            rows = (2 * np.asarray(indices)[:, None] + np.arange(2)).ravel()
            block: Array = full[np.ix_(rows, rows)]
            return block

        blocks = full.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :]
        zeros = np.zeros(n, np.int64)
        return cls(
            np.arange(n),
            z_hat,
            blocks,
            zeros,
            z,
            np.asarray(R, float).reshape(m, 2, 2),
            np.zeros(m, np.int64),
            residual,
            joint,
        )

    def innovations(self) -> Array:
        """z_i - z_hat_j for every observation i and candidate j, (m, n, 2)."""
        return self.residual(self.z[:, None, :], self.z_hat[None, :, :])

    def individual_distances(self) -> Array:
        """Squared Mahalanobis distance (m, n) of every observation to every candidate."""
        nu = self.innovations()
        S = self.HPHt[None] + self.R[:, None]
        distances: Array = np.einsum("mni,mni->mn", nu, np.linalg.solve(S, nu[..., None])[..., 0])
        return distances
