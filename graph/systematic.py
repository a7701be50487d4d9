"""Score test of systematic errors: how much of each hypothetical one the data ask for, beside path and map.

Every hypothetical error has one unknown size, zero under the null hypothesis. Around the smoothed solution the sizes
are regression coefficients beside the landmarks (de Jong, see `graph.marginals`), so one run of the Kalman filter over
a column for each gives the derivative of the log-likelihood, path and map profiled out, and its covariance (Rao, "Large
sample tests of statistical hypotheses concerning several parameters", Proc. Cambridge Phil. Soc. 44, 1948).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.inputs import Inputs, IntArray
from data.se2 import Array, compose, pose_error
from graph.marginals import forward, gains, root_of_inverse

UNTOLD = 1e-16
"""Of the square of a column: what path and map leave of it, if it is less, is rounding (some 1e-26 was seen)."""

ALIKE = 1e-9
"""Share of its information that others leave of an error which they explain wholly: rounding."""


class Score(NamedTuple):
    """What the data say about p systematic errors; all of it is zero for an error that they cannot tell.

    Attributes:
        score: (p,) derivative of the log-likelihood by the size of each error, path and map profiled out, at size zero.
        information: (p, p) covariance of the score under the null hypothesis. The efficient estimate of error j, if it
            is the only one, is score[j] / information[j, j], its variance 1 / information[j, j].
    """

    score: Array
    information: Array

    @property
    def sigmas(self) -> Array:
        """Estimate of each error alone in units of its standard deviation (p,): N(0, 1) under the null hypothesis."""
        root = np.sqrt(np.diag(self.information))
        return np.divide(self.score, root, out=np.zeros_like(root), where=root > 0.0)

    def beside(self, others: IntArray) -> Score:
        """The same with the errors `others` (q,) estimated, too, so that only what they do not explain is left."""
        root = np.sqrt(np.diag(self.information))
        scale = np.where(root > 0.0, root, 1.0)
        score, correlation = self.score / scale, self.information / np.outer(scale, scale)
        # pseudo-inverse: a SLAM robot's scales of odometry and of ranges, of which it can tell one, may both be others
        inverse = np.linalg.pinv(correlation[np.ix_(others, others)], rcond=ALIKE, hermitian=True)
        across = correlation[:, others] @ inverse
        left = correlation - across @ correlation[others]
        told = np.diag(left) > ALIKE
        told[others] = False
        score = scale * (score - across @ score[others])
        left = 0.5 * (left + left.T) * np.outer(scale, scale)
        return Score(np.where(told, score, 0.0), np.where(np.outer(told, told), left, 0.0))


def systematic(
    inputs: Inputs, number: IntArray, path: Array, landmarks: Array, motion: Array, readings: Array
) -> Score:
    """Score of p hypothetical errors phi, linearized at a smoothed path.

    Model: stated increment k = true one + motion[k] phi + noise (body frame of k - 1), observation i = what the sensor
    would read without noise + readings[i] phi + noise, the first pose as the prior says.

    Args:
        inputs: with a map, the landmarks are exact (localization); without, they are estimated (SLAM).
        number: (M,) row of `landmarks` that each observation is of; -1: not used.
        path: (N, 3) smoothed poses, world frame. At the optimum the score is the likelihood's; elsewhere that of the
            problem as linearized there.
        landmarks: (L, 2) m, world frame.
        motion: (N, 3, p) m, m, rad by unit of each error; row 0 does not matter.
        readings: (M, 2, p) in the sensor's units by unit of each error. A column that is made of distances, turns or
            ranges takes them from the smoothed solution: taken as measured, they and the residuals have noise in
            common, and an error of scale would be found where there is none (in the arena by 7 sigma).

    Raises:
        UndeterminedError: a landmark that no observation determines; its slot counts the rows in use.
        LinAlgError: the covariance of an observation is not positive definite.
    """
    n, p = len(path), motion.shape[2]
    used = np.flatnonzero(number >= 0)
    frame, row = inputs.observations.frame[used], number[used]
    m = len(used)
    F, B, moved = _chain(inputs, path)
    Q = B @ inputs.increments.covariance @ B.transpose(0, 2, 1)
    Q[0] = inputs.prior.covariance
    step = np.concatenate([moved[:, :, None], -B @ motion], axis=2)
    step[0, :, 1:] = 0.0
    z_hat, Hx, Hl = inputs.sensor.linearize(path[frame], landmarks[row])
    white = np.linalg.inv(np.linalg.cholesky(inputs.observations.R[used]))
    Hx = white @ Hx
    seen, slot = np.unique(row, return_inverse=True)
    size = 2 * len(seen) if inputs.map is None else 0
    data = np.zeros((m, 2, 1 + p + size))
    data[:, :, 0] = np.einsum("mij,mj->mi", white, inputs.sensor.residual(inputs.observations.z[used], z_hat))
    data[:, :, 1 : 1 + p] = -white @ readings[used]
    if size:
        Hl = white @ Hl
        for q in range(2):
            data[np.arange(m), :, 1 + p + 2 * slot + q] = -Hl[:, :, q]
    first = np.searchsorted(frame, np.arange(n + 1)).astype(np.int64)
    P_minus, K, W, E = np.empty((n, 3, 3)), np.empty((m, 3, 2)), np.empty((m, 2, 2)), np.empty_like(data)
    gains(F, Q, first, Hx, P_minus, K, W)
    forward(F, step, first, Hx, K, W, data, np.empty((0, 3, 0)), E, False)
    # white innovations as functions of errors and landmarks: E_y + E_phi phi + E_l l
    return _profiled(E[:, :, : 1 + p].reshape(2 * m, 1 + p), E[:, :, 1 + p :].reshape(2 * m, size))


def _chain(inputs: Inputs, path: Array) -> tuple[Array, Array, Array]:
    """Jacobians F to the pose before and B to the increment (N, 3, 3), and where the data put each pose (N, 3).

    The last is a deviation from `path`, of the prior in row 0, of the stated increment in the others. F turns the way
    as smoothed, not as stated: there, with the noise as smoothed, is the optimum (`data.motion.carried` at that way).
    """
    n = len(path)
    c, s = np.cos(path[:-1, 2]), np.sin(path[:-1, 2])
    F, B, moved = np.tile(np.eye(3), (n, 1, 1)), np.tile(np.eye(3), (n, 1, 1)), np.empty((n, 3))
    F[1:, 0, 2], F[1:, 1, 2] = path[:-1, 1] - path[1:, 1], path[1:, 0] - path[:-1, 0]
    B[1:, 0, 0], B[1:, 0, 1], B[1:, 1, 0], B[1:, 1, 1] = c, -s, s, c
    moved[0] = pose_error(inputs.prior.mean, path[0])
    moved[1:] = pose_error(compose(path[:-1], inputs.increments.mean[1:]), path[1:])
    return F, B, moved


def _profiled(E: Array, landmark: Array) -> Score:
    """Score from white columns E (2m, 1 + p), the data first, and those of the landmarks (2m, 2L)."""
    size = np.einsum("ij,ij->j", E, E)
    if landmark.shape[1]:
        T = root_of_inverse(landmark.T @ landmark)
        # the part that no map explains; twice, since the first time loses what the landmarks' condition number says
        for _ in range(2):
            E = E - landmark @ (T @ (T.T @ (landmark.T @ E)))
    product = E.T @ E
    told = np.diag(product)[1:] > UNTOLD * size[1:]
    score = np.where(told, -product[1:, 0], 0.0)
    return Score(score, np.where(np.outer(told, told), product[1:, 1:], 0.0))
