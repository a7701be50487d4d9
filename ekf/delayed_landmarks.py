"""Landmarks that several observations determine together: delayed initialization from poses that are kept in the state.

With whitened residuals r = Hx dx + Hl dl + v of all observations at the place found, an orthogonal Q splits them: the
two rows of Q' Hl that are not zero give the landmark and its correlations, the others measure the poses alone and
update them (Mourikis and Roumeliotis, ICRA 2007, section III-D, projects likewise). So no observation is used twice,
and none is lost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from data.blocks import block_diagonal
from data.inputs import IntArray
from data.se2 import Array
from ekf.kernels import NOT_PSD
from ekf.pose_updates import correct_all


class Split(NamedTuple):
    """Residuals (m,) of observations and their Jacobians to states (m, q) and landmark (m, 2), all whitened."""

    nu: Array
    Hx: Array
    Hl: Array


def whitened(residual: Array, Hx: Array, Hl: Array, R: Array) -> Split:
    """Of residuals (n, 2), Jacobians (n, 2, 3) each to its own pose and (n, 2, 2), covariances (n, 2, 2)."""
    L = np.linalg.cholesky(R)
    turned = (np.linalg.solve(L, each) for each in (residual[:, :, None], Hx, Hl))
    nu, Hx, Hl = turned
    return Split(nu.ravel(), block_diagonal(Hx), Hl.reshape(-1, 2))


class Initialized(NamedTuple):
    """Outcome: status of the filter's kernels; NIS, degrees of freedom and log-likelihood of what updated the poses."""

    status: int
    nis: float
    dof: int
    log_likelihood: float


def initialize(
    mean: Array, P: Array, d: int, at: IntArray, found: Split, xy: Array, measured: int, rule: tuple[int, int, int]
) -> Initialized:
    """Append the landmark at xy (2,) to `d` states, and update them by the rest of its observations.

    `at` (q,): the states of the poses; `measured`: how many numbers were measured; `rule`: retraction and clones as of
    `ekf.pose_updates.correct_all`, after the landmark was appended. The buffers have room for d + 2 states.
    """
    Q, triangle = np.linalg.qr(found.Hl, mode="complete")
    nu, Hx = Q.T @ found.nu, Q.T @ found.Hx
    back = np.linalg.inv(triangle[:2])
    A = -back @ Hx[:2]
    mean[d : d + 2] = xy + back @ nu[:2]
    P[d : d + 2, :d] = A @ P[at, :d]
    P[:d, d : d + 2] = P[d : d + 2, :d].T
    P[d : d + 2, d : d + 2] = A @ P[np.ix_(at, at)] @ A.T + back @ back.T
    H, rest = Hx[2:], nu[2:]
    rows = P[at, : d + 2]
    S = H @ rows[:, at] @ H.T + np.eye(len(rest))
    try:
        L = np.linalg.cholesky(0.5 * (S + S.T))
    except np.linalg.LinAlgError:
        return Initialized(NOT_PSD, math.nan, 0, math.nan)
    white = np.asarray(np.linalg.solve(L, rest), np.float64)
    V = np.ascontiguousarray(np.linalg.solve(L, H @ rows))
    status = correct_all(mean, P, d + 2, V, white, *rule)
    nis, dof = float(white @ white), measured - 2
    log_det = 2.0 * float(np.log(np.diag(L)).sum())
    return Initialized(status, nis, dof, -0.5 * (nis + log_det + dof * math.log(2.0 * math.pi)))
