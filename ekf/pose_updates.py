"""Updates of a filter by measurements of poses: absolute fixes, and closures with frames that are kept in the state.

Delayed states, or stochastic cloning (Roumeliotis and Burdick, "Stochastic cloning: a generalized framework for
processing relative state measurements", ICRA 2002; Eustice, Singh and Leonard, "Exactly sparse delayed-state filters",
IEEE TRO 22(6), 2006): the pose of a frame that a later closure names is appended as it is, with all its correlations.
Every update corrects it, and it is marginalized after its last use.

An update of d states costs d^2 per measurement.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from data.compiled import njit
from data.inputs import IntArray
from data.motion.systematic import SensorFrame
from data.pose_measurements import Closures, Fixes, FixSource, GaussianMeasurement, PoseUpdated, closure_of, fixes_of
from data.se2 import Array
from data.sensors import wrap_angle_jit
from ekf.kernels import NOT_PSD, OK, healthy
from ekf.updates import ADDITIVE, UpdateRule, move

Measure = Callable[[Array, Array], tuple[Array, Array]]
"""Innovation (m,) and Jacobian (m, q) for the states (q,) that are measured, and for those to take the Jacobian at."""


class MeasurementModel(NamedTuple):
    """A measurement of the pose, or of the pose relative to an earlier one."""

    rows: list[int]  # entries of (x, y, theta) that are measured, m of them
    measure: Measure  # of the states pose and errors, and the earlier pose if there is one
    R: Array  # (m, m)
    earlier: int | None = None  # its frame


def absorb(
    mean: Array, P: Array, d: int, at: IntArray, measured: MeasurementModel, rule: UpdateRule, done: PoseUpdated,
    row: int, linearized: Array | None = None,
) -> tuple[int, float]:  # fmt: skip
    """Update `d` states with one measurement of the states `at` (q,), if it is inside the gate. Its NIS, innovation and
    covariance, of the first linearization, are written to a row of `done`; returns a status, and log det of that
    covariance. `linearized` (q,): where to take the Jacobian; None: at the mean. As `ekf.updates.correct`: P -= W W',
    which stays symmetric to the bit.
    """
    (_, measure, R, _), prior, rows = measured, mean[at], P[at, :d]
    _, H, L, white = _innovation(measure, prior, prior, prior if linearized is None else linearized, rows[:, at], R)
    if L is None:
        return NOT_PSD, math.nan
    nis, log_det = float(white @ white), 2.0 * float(np.log(np.diag(L)).sum())
    done.used[row], done.nis[row], done.white[row, measured.rows] = nis < rule.threshold, nis, white
    done.S[row][np.ix_(measured.rows, measured.rows)] = L @ L.T
    if not done.used[row]:
        return OK, log_det
    point, sigma = prior, np.sqrt(np.maximum(rows[np.arange(len(at)), at], 0.0))
    for _ in range(rule.iterations - 1):
        moved, point = point, prior + np.linalg.solve(L, H @ rows[:, at]).T @ white
        _, H, L, white = _innovation(measure, prior, point, point, rows[:, at], R)
        if L is None:
            return NOT_PSD, log_det
        if (np.abs(point - moved) <= 1e-6 * sigma).all():
            break
    V = np.ascontiguousarray(np.linalg.solve(L, H @ rows))
    return correct_all(mean, P, d, V, white, rule.retraction, rule.clones, rule.clones_end), log_det


def _innovation(
    measure: Measure, prior: Array, point: Array, jacobian_at: Array, P: Array, R: Array
) -> tuple[Array, Array, Array | None, Array]:
    """Innovation about `point`, its Jacobian, L of its covariance (None: not positive definite), L^-1 of it."""
    nu, H = measure(point, jacobian_at)
    if point is not prior:
        nu = nu - H @ (prior - point)
    S = H @ P @ H.T + R
    try:
        L = np.asarray(np.linalg.cholesky(0.5 * (S + S.T)), np.float64)
    except np.linalg.LinAlgError:
        return nu, H, None, nu
    return nu, H, L, np.asarray(np.linalg.solve(L, nu), np.float64)


@njit
def correct_all(
    mean: Array, P: Array, d: int, V: Array, white: Array, retraction: int, clones: int, clones_end: int
) -> int:
    """The Kalman update: mean += V' white (or see `move`), P -= V' V, for V (m, d); returns a status."""
    m = len(V)
    shift = np.zeros(d)
    for i in range(m):
        for r in range(d):
            shift[r] += V[i, r] * white[i]
    for r in range(d):  # the order of factors does not matter to a bit, so P stays symmetric
        i = 0
        while i + 3 <= m:  # a row stays in the cache
            a, b, c = V[i, r], V[i + 1, r], V[i + 2, r]
            for j in range(d):
                P[r, j] -= a * V[i, j] + b * V[i + 1, j] + c * V[i + 2, j]
            i += 3
        while i < m:
            a = V[i, r]
            for j in range(d):
                P[r, j] -= a * V[i, j]
            i += 1
    if retraction == ADDITIVE:
        mean[:d] += shift
    else:
        move(mean, P, d, shift, retraction, clones, clones_end)
    mean[2] = wrap_angle_jit(mean[2])
    for r in range(clones, clones_end, 3):
        mean[r + 2] = wrap_angle_jit(mean[r + 2])
    return healthy(mean, P)


def append_pose(mean: Array, P: Array, d: int, first: Array) -> None:
    """Append a copy of the pose with its correlations; the buffers have room for d + 3 states."""
    for values in (mean, first) if len(first) else (mean,):
        values[d : d + 3] = values[:3]
    P[d : d + 3, :d] = P[:3, :d]
    P[:d, d : d + 3] = P[:3, :d].T
    P[d : d + 3, d : d + 3] = P[:3, :3]


def replace_pose(mean: Array, P: Array, d: int, at: int, first: Array) -> None:
    """Marginalize the pose at offset `at` out; the last three of the d states take its place."""
    last, own = slice(d - 3, d), slice(at, at + 3)
    if own == last:
        return
    for values in (mean, first) if len(first) else (mean,):
        values[own] = values[last]
    P[own, : d - 3] = P[last, : d - 3]
    P[own, own] = P[last, last]
    P[: d - 3, own] = P[own, : d - 3].T


def of_fixes(frame: SensorFrame, fixes: Fixes, sources: tuple[FixSource, ...]) -> list[MeasurementModel]:
    """The fixes (f,) of a frame, for states in `frame`."""
    return [model_of(frame, m) for m in fixes_of(fixes, sources)]


def of_closures(frame: SensorFrame, closures: Closures, now: int) -> list[MeasurementModel]:
    """The closures (c,) known at frame `now`, for states in `frame`."""
    found = []
    both = zip(closures.frame1.tolist(), closures.frame2.tolist(), closures.relative, closures.covariance, strict=True)
    for frame1, frame2, relative, covariance in both:
        ends = (3, 0) if frame2 == now else (0, 3)  # of the present pose and the earlier one
        found.append(model_of(frame, closure_of(relative, covariance, *ends, 6), frame1 if frame2 == now else frame2))
    return found


def model_of(frame: SensorFrame, measured: GaussianMeasurement, earlier: int | None = None) -> MeasurementModel:
    """A measurement of the present pose, or of this and the pose of an earlier frame, stacked."""

    def stacked(x: Array) -> tuple[Array, Array]:
        errors = x[3:] if earlier is None else x[3:-3]
        pose, J = _in_world(frame, x[:3], errors)
        if earlier is None:
            return pose, J
        before, K = _in_world(frame, x[-3:], errors)
        both = np.zeros((6, len(x)))
        both[:3, :-3], both[3:, -3:], both[3:, 3:-3] = J, K[:, :3], K[:, 3:]
        return np.concatenate([pose, before]), both

    def measure(x: Array, at: Array) -> tuple[Array, Array]:
        poses, J = stacked(at)
        nu, H = measured.innovation(poses)
        return nu if x is at else measured.innovation(stacked(x)[0])[0], H @ J

    return MeasurementModel(list(measured.entries), measure, measured.R, earlier)


def _in_world(frame: SensorFrame, pose: Array, errors: Array) -> tuple[Array, Array]:
    """World pose (3,) and its Jacobian (3, 3 + p) to pose (3,) and errors (p,) of a state."""
    if frame.same:
        return pose, np.eye(3, 3 + len(errors))
    found, J = frame.poses_out(pose[None], errors[None])
    return found[0], J[0]


class Clones:
    """Which frames' poses are in the state, in the order of their places, and until when."""

    def __init__(self) -> None:
        self.now = 0  # number of the present frame
        self.frames: list[int] = []  # of the clones, by place
        self._last: dict[int, int] = {}
        self._ends: dict[int, list[int]] = {}
        self._held = set[int]()

    def hold(self, frame: int) -> None:
        """Keep a frame, the present one or one that is kept already, until it is released."""
        self._held.add(frame)

    def release(self, frame: int) -> None:
        """Keep a frame no longer than later closures need it."""
        self._held.discard(frame)
        if self._last.get(frame, -1) <= self.now:
            self._ends.setdefault(self.now, []).append(frame)

    def keep(self, last_use: dict[int, int]) -> None:
        """The frames to keep, each with the frame of its last use."""
        self._last, self._ends = dict(last_use), {}
        for frame, last in self._last.items():
            self._ends.setdefault(last, []).append(frame)

    def at(self, measured: MeasurementModel, base: int, size: int) -> IntArray | None:
        """States (q,) measured: pose and errors (`base`), an earlier pose from `size` on; None: that is not there."""
        present = np.arange(base)
        if measured.earlier is None:
            return present
        if measured.earlier not in self.frames:
            return None
        return np.concatenate([present, size + 3 * self.frames.index(measured.earlier) + np.arange(3)])

    @property
    def expected(self) -> bool:
        """Whether there are frames to keep."""
        return bool(self._last or self._held)

    @property
    def wanted(self) -> bool:
        """Whether the present frame is to be kept."""
        return self.now in self._held or self._last.get(self.now, -1) > self.now

    def over(self) -> list[int]:
        """The frames in the state that were used for the last time in the present frame."""
        if self.now not in self._ends:
            return []
        ends = dict.fromkeys(self._ends.pop(self.now))
        return [frame for frame in ends if frame in self.frames and frame not in self._held]
