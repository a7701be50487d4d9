"""Exact covariances and Newton step of a linearized smoothing problem: a chain of poses that saw landmarks.

Given the landmarks, the poses are a Markov chain, so a Kalman smoother gives their distribution; the landmarks enter as
unknown regression coefficients (de Jong, "The likelihood for a state space model", Biometrika 75, 1988; smoother
recursion: Durbin and Koopman, "Time Series Analysis by State Space Methods", section 4.4). Only motion covariances and
their sums are used, never their inverses. A singular prior, a robot at rest for minutes and long stretches without a
sighting are therefore harmless here, where Cholesky on the information matrix (gtsam's Marginals) breaks down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from data.inputs import IntArray
from data.se2 import Array

COLUMNS = 64
"""Landmark coordinates smoothed at once: bounds the memory at N x 3 x 64 numbers."""
SINGULAR = 1e-13
"""A pivot of the landmarks' information below this share of its diagonal is rounding, not information."""


@dataclass(frozen=True)
class Linearized:
    """x_0 ~ N(step[0], Q[0]); x_k = F[k] x_{k-1} + step[k] + N(0, Q[k]); y_i = Hx_i x_k + Hl_i l_{slot_i} + N(0, I).

    Attributes:
        F: (N, 3, 3). step: (N, 3). Q: (N, 3, 3).
        first: (N + 1,) offsets: the observations of frame k are rows first[k]:first[k + 1].
        Hx: (M, 2, 3). Hl: (M, 2, 2). y: (M, 2), whitened.
        slot: (M,) index of the landmark.
        landmarks: number L of landmarks to estimate; 0 where they are known exactly (then Hl, slot do not matter).
    """

    F: Array
    step: Array
    Q: Array
    first: IntArray
    Hx: Array
    Hl: Array
    y: Array
    slot: IntArray
    landmarks: int


@dataclass(frozen=True)
class Solution:
    """Means and covariances: pose (N, 3) and (N, 3, 3), landmark (L, 2) and (L, 2, 2)."""

    pose: Array
    pose_covariance: Array
    landmark: Array
    landmark_covariance: Array


class UndeterminedError(ValueError):
    """The landmark in `slot` is not determined by the observations."""

    def __init__(self, slot: int) -> None:
        super().__init__(f"landmark in slot {slot}")
        self.slot = slot


@numba.njit(cache=True)
def gains(F, Q, first, Hx, P_minus, K, W):  # type: ignore[no-untyped-def]
    """Kalman filter, covariances only: predicted P_minus (N, 3, 3), gains K (M, 3, 2), whitening W (M, 2, 2) = L^-1.

    S = L L' is the innovation covariance.
    """
    P = np.zeros((3, 3))
    for k in range(len(F)):
        P = F[k] @ P @ F[k].T + Q[k] if k > 0 else Q[0].copy()
        P = 0.5 * (P + P.T)
        P_minus[k] = P
        for i in range(first[k], first[k + 1]):
            PHt = P @ Hx[i].T
            S = Hx[i] @ PHt
            a, c = np.sqrt(S[0, 0] + 1.0), S[1, 0]
            b = c / a
            d = np.sqrt(max(S[1, 1] + 1.0 - b * b, 1.0))  # S >= I, whatever rounding says
            W[i, 0, 0], W[i, 0, 1], W[i, 1, 0], W[i, 1, 1] = 1.0 / a, 0.0, -b / (a * d), 1.0 / d
            K[i] = PHt @ (W[i].T @ W[i])
            # Joseph's form: symmetric, and no difference of large numbers
            A = np.eye(3) - K[i] @ Hx[i]
            P = A @ P @ A.T + K[i] @ K[i].T


@numba.njit(cache=True)
def _variances(F, first, Hx, P_minus, K, W, V):  # type: ignore[no-untyped-def]
    """Covariance V (N, 3, 3) of each pose given all observations and the landmarks."""
    N = np.zeros((3, 3))
    for k in range(len(F) - 1, -1, -1):
        for i in range(first[k + 1] - 1, first[k] - 1, -1):
            A = np.eye(3) - K[i] @ Hx[i]
            WH = W[i] @ Hx[i]
            N = WH.T @ WH + A.T @ N @ A
        V[k] = P_minus[k] - P_minus[k] @ N @ P_minus[k]
        if k > 0:
            N = F[k].T @ N @ F[k]


@numba.njit(cache=True)
def forward(F, step, first, Hx, K, W, B, a_minus, E, keep):  # type: ignore[no-untyped-def]
    """Run the filter on the columns of data B (M, 2, c).

    Whitened innovations go to E (M, 2, c) and, where `keep`, predictions to a_minus (N, 3, c). `step` (N, 3, s) moves
    the first s columns only.
    """
    c = B.shape[2]
    a, e = np.zeros((3, c)), np.zeros((2, c))
    for k in range(len(F)):
        for q in range(c):
            if k > 0:
                x, y, t = a[0, q], a[1, q], a[2, q]
                for r in range(3):
                    a[r, q] = F[k, r, 0] * x + F[k, r, 1] * y + F[k, r, 2] * t
        for r in range(3):
            for q in range(step.shape[2]):
                a[r, q] += step[k, r, q]
        if keep:
            a_minus[k] = a
        for i in range(first[k], first[k + 1]):
            for q in range(c):
                for r in range(2):
                    e[r, q] = B[i, r, q] - Hx[i, r, 0] * a[0, q] - Hx[i, r, 1] * a[1, q] - Hx[i, r, 2] * a[2, q]
                for r in range(3):
                    a[r, q] += K[i, r, 0] * e[0, q] + K[i, r, 1] * e[1, q]
                E[i, 0, q] = W[i, 0, 0] * e[0, q]
                E[i, 1, q] = W[i, 1, 0] * e[0, q] + W[i, 1, 1] * e[1, q]


@numba.njit(cache=True)
def _backward(F, first, Hx, P_minus, K, W, E, smoothed):  # type: ignore[no-untyped-def]
    """Smooth columns: `smoothed` (N, 3, c) comes in as the predictions and leaves as the smoothed states."""
    c = E.shape[2]
    r = np.zeros((3, c))
    for k in range(len(F) - 1, -1, -1):
        for i in range(first[k + 1] - 1, first[k] - 1, -1):
            for q in range(c):
                u = W[i, 0, 0] * E[i, 0, q] + W[i, 1, 0] * E[i, 1, q]
                v = W[i, 1, 1] * E[i, 1, q]
                u -= K[i, 0, 0] * r[0, q] + K[i, 1, 0] * r[1, q] + K[i, 2, 0] * r[2, q]
                v -= K[i, 0, 1] * r[0, q] + K[i, 1, 1] * r[1, q] + K[i, 2, 1] * r[2, q]
                for j in range(3):
                    r[j, q] += Hx[i, 0, j] * u + Hx[i, 1, j] * v
        for q in range(c):
            x, y, t = r[0, q], r[1, q], r[2, q]
            for j in range(3):
                smoothed[k, j, q] += P_minus[k, j, 0] * x + P_minus[k, j, 1] * y + P_minus[k, j, 2] * t
            if k > 0:
                for j in range(3):
                    r[j, q] = F[k, 0, j] * x + F[k, 1, j] * y + F[k, 2, j] * t


def solve(p: Linearized) -> Solution:
    """Posterior means and marginal covariances of all poses and landmarks; raises `UndeterminedError`."""
    n, m, size = len(p.F), len(p.Hx), 2 * p.landmarks
    P_minus, V = np.empty((n, 3, 3)), np.empty((n, 3, 3))
    K, W = np.empty((m, 3, 2)), np.empty((m, 2, 2))
    gains(p.F, p.Q, p.first, p.Hx, P_minus, K, W)
    _variances(p.F, p.first, p.Hx, P_minus, K, W, V)

    def filtered(step: Array, data: Array, keep: bool) -> tuple[Array, Array]:
        a_minus, E = np.empty((n if keep else 0, 3, data.shape[2])), np.empty_like(data)
        forward(p.F, step[:, :, None], p.first, p.Hx, K, W, data, a_minus, E, keep)
        return a_minus, E

    def smoothed(step: Array, data: Array) -> Array:
        states, E = filtered(step, data, True)
        _backward(p.F, p.first, p.Hx, P_minus, K, W, E, states)
        return states

    if size == 0:
        pose = smoothed(p.step, p.y[:, :, None])[:, :, 0]
        return Solution(pose, 0.5 * (V + V.transpose(0, 2, 1)), np.empty((0, 2)), np.empty((0, 2, 2)))
    # innovations as functions of the landmarks, E_y + E_l l: they are white, so their square is the likelihood of l
    data = np.zeros((m, 2, 1 + size))
    data[:, :, 0] = p.y
    for q in range(2):
        data[np.arange(m), :, 1 + 2 * p.slot + q] = -p.Hl[:, :, q]
    E = filtered(p.step, data, False)[1].reshape(2 * m, 1 + size)
    T = root_of_inverse(E[:, 1:].T @ E[:, 1:])
    landmark = -(T @ (T.T @ (E[:, 1:].T @ E[:, 0]))).reshape(-1, 2)
    del data, E
    pose = smoothed(p.step, (p.y - np.einsum("mij,mj->mi", p.Hl, landmark[p.slot]))[:, :, None])[:, :, 0]
    # each pose's sensitivity to the landmarks, C (3, 2L), adds C cov(l) C' = (C T)(C T)'
    blocks = T.reshape(-1, 2, size)
    for left in range(0, size, COLUMNS):
        C = smoothed(np.zeros((n, 3)), -np.einsum("mij,mjc->mic", p.Hl, blocks[p.slot, :, left : left + COLUMNS]))
        V += C @ C.transpose(0, 2, 1)
    return Solution(pose, 0.5 * (V + V.transpose(0, 2, 1)), landmark, blocks @ blocks.transpose(0, 2, 1))


def root_of_inverse(information: Array) -> Array:
    """T (d, d) with T T' = information^-1; raises `UndeterminedError` with the landmark where it has no inverse."""
    root = np.zeros_like(information)
    fault = _invert_root(np.ascontiguousarray(information), np.zeros_like(information), root)
    if fault >= 0:
        raise UndeterminedError(fault // 2)
    return root


@numba.njit(cache=True)
def _invert_root(A, L, T):  # type: ignore[no-untyped-def]
    """A = L L', T = L^-T, both filled in; returns -1, or the first row of A that depends on the rows before it.

    Compiled here instead of called from LAPACK: its threads wait for each other for a second where two processes share
    two cores, and the result would depend on their number.
    """
    d = len(A)
    for i in range(d):
        for j in range(i + 1):
            total = A[i, j]
            for q in range(j):
                total -= L[i, q] * L[j, q]
            if i == j:
                if not total > SINGULAR * A[i, i]:
                    return i
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    for j in range(d):
        T[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, d):
            total = 0.0
            for q in range(j, i):
                total -= L[i, q] * T[j, q]
            T[j, i] = total / L[i, i]
    return -1
