"""Velocity (unicycle) motion: increments from (v, omega) samples, four noise conventions, preintegration.

Control noise is a variance per second of displacement D = v dt [m] and rotation A = omega dt [rad], constant over a
sample, so splitting a sample does not change the total. Eigenvalues of covariances get a floor, since information forms
need the inverse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from data.compiled import njit
from data.inputs import Increments
from data.se2 import Array
from data.terminal import counted
from data.timeline import MAX_GAP, usual_gap

ARC = 0
HALF_ANGLE = 1
TURN_FIRST = 2
DRIVE_FIRST = 3
MODELS = {"unicycle": ARC, "half_angle": HALF_ANGLE, "turn_first": TURN_FIRST, "drive_first": DRIVE_FIRST}
NOISES = ("velocity", "displacement", "density", "textbook")
WITH_ALPHAS = {"displacement": (4,), "textbook": (4, 6)}  # Conventions with alphas instead of sigmas, and their number
MAX_HOLD = MAX_GAP  # s, longest hold of a sample (zero-order hold) at usual rates; then follows a gap


@njit
def sinc(a: float) -> float:
    """sin(a) / a, smooth through 0."""
    return 1.0 - a * a / 6.0 if abs(a) < 1e-4 else math.sin(a) / a


@njit
def sinc_slope(a: float) -> float:
    """d/da of sin(a) / a; a series where the closed form cancels."""
    if abs(a) < 0.1:
        q = a * a
        return a * (-1.0 / 3.0 + q * (1.0 / 30.0 + q * (-1.0 / 840.0 + q / 45360.0)))
    return (math.cos(a) - math.sin(a) / a) / a


@njit
def step(model: int, displacement: float, rotation: float, mean: Array, G: Array) -> None:
    """Body-frame increment `mean` (3,) of D m along an arc of A rad, and its Jacobian G (3, 2) to (D, A).

    `ARC`: exact integration, x = D sin(A)/A, y = D (1 - cos A)/A. `HALF_ANGLE`: a chord of length D at the middle
    heading (the classic tutorials' model). `TURN_FIRST` and `DRIVE_FIRST`: a chord at the last or the first heading, as
    many simulators drive; a sample must then not be cut between two frames.
    """
    A = rotation
    if model == ARC:
        half = sinc(0.5 * A)
        along, across = sinc(A), 0.5 * A * half * half
        d_along, d_across = sinc_slope(A), sinc(A) - 0.5 * half * half
    else:
        share = 0.5 if model == HALF_ANGLE else 1.0 if model == TURN_FIRST else 0.0
        along, across = math.cos(share * A), math.sin(share * A)
        d_along, d_across = -share * across, share * along
    mean[0], mean[1], mean[2] = displacement * along, displacement * across, A
    G[0, 0], G[1, 0], G[2, 0] = along, across, 0.0
    G[0, 1], G[1, 1], G[2, 1] = displacement * d_along, displacement * d_across, 1.0


def carried(heading: float, motion: Array) -> tuple[float, float, Array, Array]:
    """Displacement of an increment (3,) at a heading; F to the pose, B to the increment: P becomes F P F' + B M B'."""
    c, s = math.cos(heading), math.sin(heading)
    wx, wy = c * motion[0] - s * motion[1], s * motion[0] + c * motion[1]
    F = np.array([[1.0, 0.0, -wy], [0.0, 1.0, wx], [0.0, 0.0, 1.0]])
    return wx, wy, F, np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@njit
def compose_in_place(pose: Array, covariance: Array, z: Array, C: Array, out_pose: Array, out: Array) -> None:
    """Compose a pose (3,) with the motion z, and their covariances, into `out_pose` and `out`, which may be the inputs.
    The pose's covariance becomes F P F' + B C B', F and B as of `carried`; the heading is not wrapped.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = c * z[0] - s * z[1], s * z[0] + c * z[1]
    P = covariance
    # J = [1, 0, -dy; 0, 1, dx; 0, 0, 1] on the pose, R(theta) on the motion
    xt, yt = P[0, 2] - dy * P[2, 2], P[1, 2] + dx * P[2, 2]
    out[0, 0] = P[0, 0] - dy * (P[0, 2] + xt) + c * c * C[0, 0] - 2.0 * c * s * C[0, 1] + s * s * C[1, 1]
    out[1, 1] = P[1, 1] + dx * (P[1, 2] + yt) + s * s * C[0, 0] + 2.0 * c * s * C[0, 1] + c * c * C[1, 1]
    out[0, 1] = P[0, 1] - dy * P[1, 2] + dx * xt + c * s * (C[0, 0] - C[1, 1]) + (c * c - s * s) * C[0, 1]
    out[0, 2] = xt + c * C[0, 2] - s * C[1, 2]
    out[1, 2] = yt + s * C[0, 2] + c * C[1, 2]
    out[2, 2] = P[2, 2] + C[2, 2]
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    out_pose[0], out_pose[1], out_pose[2] = pose[0] + dx, pose[1] + dy, pose[2] + z[2]


@njit
def _preintegrate(
    model: int, lateral: bool, time: Array, v: Array, omega: Array, rate: Array, hold: Array, beyond: Array,
    lead: float, fastest: Array, at: Array, mean: Array, cov: Array,
) -> None:  # fmt: skip
    """Loop of `preintegrate`; rate (K, 3): variances per second; hold (> K,) [s]; fastest (2,): |v|, |omega|."""
    n, k = len(time), 0
    step_mean, G, Q = np.empty(3), np.empty((3, 2)), np.empty((3, 3))
    for f in range(1, len(at)):
        t = at[f - 1]
        m, P = mean[f], cov[f]
        while t < at[f]:
            while k + 1 < n and time[k + 1] <= t:
                k += 1
            end = at[f]
            if k + 1 < n:
                end = min(end, time[k + 1])
            held_until = time[k] + hold[k]
            if time[k] <= t < held_until:
                end = min(end, held_until)
                dt = end - t
                step(model, v[k] * dt, omega[k] * dt, step_mean, G)
                if lateral:  # the tutorials' mapping: 0.5 m sideways per radian, whatever the distance
                    G[0, 1], G[1, 1] = -0.5 * G[1, 0], 0.5 * G[0, 0]
                of_D, of_A = rate[k, 0] * dt, rate[k, 1] * dt
                for i in range(3):
                    for j in range(3):
                        Q[i, j] = G[i, 0] * of_D * G[j, 0] + G[i, 1] * of_A * G[j, 1]
                Q[2, 2] += rate[k, 2] * dt  # a turn in place
            else:  # a gap: unknown motion
                gap = beyond[k]
                if t < time[0]:
                    end, gap = min(at[f], time[0]), lead
                dt = end - t
                for i in range(3):
                    step_mean[i] = 0.0
                    for j in range(3):
                        Q[i, j] = 0.0
                Q[0, 0] = Q[1, 1] = fastest[0] ** 2 * gap * dt
                Q[2, 2] = fastest[1] ** 2 * gap * dt
            compose_in_place(m, P, step_mean, Q, m, P)
            t = end


@dataclass(frozen=True)
class VelocityNoise:
    """Control noise in one of four conventions.

    `velocity`: sigma of v [m/s] and omega [rad/s], independent for each sample, times its length. `displacement`: per
    sample (a1 |v| + a2 |omega|)^2 and (a3 |v| + a4 |omega|)^2, whatever its length, with the classic tutorials' mapping
    to the pose (along the chord; half sideways and once in heading). `density`: sigma per sqrt(s) of displacement [m]
    and rotation [rad]. `textbook`: variances a1 v^2 + a2 omega^2 of v and a3 v^2 + a4 omega^2 of omega, independent for
    each sample and times its length; with six alphas also a5 v^2 + a6 omega^2 of the rate of a final rotation in place
    (Thrun, Burgard and Fox, Probabilistic Robotics, section 5.3, Tables 5.3 and 7.2).
    """

    kind: str
    sigma: tuple[float, float] = (0.0, 0.0)
    alphas: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.kind not in NOISES:
            raise ValueError(f"noise {self.kind!r}; known: {', '.join(NOISES)}")
        if len(self.alphas) not in WITH_ALPHAS.get(self.kind, (4,)):
            raise ValueError(f"{len(self.alphas)} alphas do not go with {self.kind} noise")
        if min(self.sigma) < 0 or min(self.alphas) < 0:
            raise ValueError("noise parameters must not be negative")

    def variance_per_second(self, v: Array, omega: Array, length: Array) -> Array:
        """Variance per second (K, 3) of displacement, rotation and final rotation, for samples of `length` (K,) s."""
        if self.kind in WITH_ALPHAS:
            weights = np.zeros((3, 2))
            weights.ravel()[: len(self.alphas)] = self.alphas
            if self.kind == "textbook":
                # a sample's total is its variance times length^2
                return np.stack([v**2, omega**2], axis=-1) @ weights.T * length[:, None]
            sigma = np.stack([np.abs(v), np.abs(omega)], axis=-1) @ weights.T
            return sigma**2 / np.maximum(length, 1e-9)[:, None]
        sigma = np.broadcast_to(np.array([*self.sigma, 0.0]), (len(v), 3))
        # of velocities a sample's total is (sigma * length)^2, spread evenly over its length
        return sigma**2 * length[:, None] if self.kind == "velocity" else sigma**2


@dataclass(frozen=True)
class VelocityModel:
    """How (v, omega) become increments: model `unicycle` (exact arc) or another of `MODELS`, and noise."""

    noise: VelocityNoise
    model: str = "unicycle"

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(f"motion model {self.model!r}; known: {', '.join(MODELS)}")

    def scaled(self, factor: float) -> VelocityModel:
        """The model with every noise sigma multiplied by `factor`."""
        n = self.noise
        of_alphas = factor**2 if n.kind == "textbook" else factor  # there they are variances
        sigma, alphas = (n.sigma[0] * factor, n.sigma[1] * factor), tuple(a * of_alphas for a in n.alphas)
        return replace(self, noise=replace(n, sigma=sigma, alphas=alphas))


def preintegrate(model: VelocityModel, time: Array, v: Array, omega: Array, at: Array) -> tuple[Increments, int]:
    """Increments between the instants `at` (N,) from samples at `time` (K,), ascending; also the number of gaps.

    A sample holds until the next one, at most `usual_gap`: 1 s, or 1.5 times their usual interval, at most 5 s. In a
    gap the mean stands still, and standard deviations grow as far as the fastest sample of the log would have gone.
    Composing the increments equals predicting sample by sample (to rounding).
    """
    # copies: read-only arrays would compile the kernel once more
    time, v, omega, at = (np.array(a, float, order="C") for a in (time, v, omega, at))
    mean, cov = np.zeros((len(at), 3)), np.zeros((len(at), 3, 3))
    if len(at) == 0 or len(time) == 0:
        return Increments(mean, cov), 0
    length, hold = _holds(time, at[-1])
    # samples with equal stamps have no length: the last one replaces the others
    rate = model.noise.variance_per_second(v, omega, np.maximum(hold, 1e-9))
    beyond = length - hold
    lead = max(float(time[0] - at[0]), 0.0)
    fastest = np.array([np.abs(v).max(), np.abs(omega).max()])
    lateral = model.noise.kind == "displacement"
    _preintegrate(MODELS[model.model], lateral, time, v, omega, rate, hold, beyond, lead, fastest, at, mean, cov)
    return Increments(mean, cov), len(_unseen(time, at))


def _holds(time: Array, end: float) -> tuple[Array, Array]:
    """Time [s] from each sample (K,) to the next, of the last one at least to `end`, and that for which it holds."""
    length = np.append(np.diff(time), max(time[-1] - time[-2] if len(time) > 1 else MAX_HOLD, end - time[-1]))
    return length, np.minimum(length, usual_gap(time))


def _unseen(time: Array, at: Array) -> Array:
    """Length [s] of each gap of samples at `time` (K,) between the instants `at` (N,)."""
    length, hold = _holds(time, at[-1])
    inside = (length - hold > 1e-9) & (time + hold < at[-1]) & (time + length > at[0])
    gap = np.minimum(time + length, at[-1]) - np.maximum(time + hold, at[0])
    return np.append(gap[inside], max(min(time[0], at[-1]) - at[0], 0.0) if time[0] > at[0] else [])


def gaps_said(time: Array, at: Array) -> str:
    """The note on gaps of samples at `time` (K,) between the instants `at` (N,), where there are some."""
    gap, span = _unseen(time, at), at[-1] - at[0]
    many = f"{counted(len(gap), 'gap')} longer than {usual_gap(time):.3g} s"
    still = f"no motion is assumed over {gap.sum():.4g} of {span:.4g} s"
    return f"{many}, where the robot may have moved unseen: {still}"


def told(time: Array) -> tuple[float, float]:
    """First and last instant [s] whose motion samples at `time` (K,) tell; the last holds for the median interval."""
    return float(time[0]), float(time[-1]) + (float(np.median(np.diff(time))) if len(time) > 1 else 0.0)


def floor_covariances(covariance: Array, floor: float) -> tuple[Array, int]:
    """Add floor * I to every increment covariance (N, 3, 3), except row 0, with an eigenvalue below `floor`; also their
    number.

    Singular increments (a robot at rest, one odometry sample) are harmless in a filter and fatal in an information
    form; flooring here keeps filter and smoother on the same numbers. A floored covariance is returned bit for bit.
    """
    result = np.array(covariance, float)
    if floor <= 0.0 or len(result) < 2:
        return result, 0
    smallest, _, largest = np.linalg.eigvalsh(result).T
    low = smallest < floor * (1.0 - 1e-6) - 1e-15 * largest  # slack for rounding of the floor and the eigenvalues
    low[0] = False
    # a matrix indefinite by rounding needs more than the floor
    result[low] += (floor + np.maximum(-smallest[low], 0.0))[:, None, None] * np.eye(3)
    return result, int(low.sum())
