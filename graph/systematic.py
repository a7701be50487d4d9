"""Systematic errors as variables of a graph, in prior sigmas: the constants in one vector, the drift by knot.

A graph without errors to estimate has none of these variables; all else is the same. All is in the sensor's frame
(`data.motion.systematic`).

The residual of an increment is Log(m^-1 g(X^-1 Y, b)) for poses X, Y: of the stated motion m, against the motion g that
odometry would have stated without noise (`data.motion.systematic`). Without errors it is that of gtsam's between
factor. The errors act on the smoothed motion: acting on the stated one they would share its noise, and a scale would be
biased low by the noise's share of the squared motion (Fuller, "Measurement Error Models", 1987, section 1.1). Nor does
the whitening depend on the errors: a large range error would make any residual cheap.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from data.compiled import njit
from data.errors import UsageError
from data.inputs import ERRORS, Increments, IntArray, Prior, Systematic
from data.motion.systematic import BETWEEN_KNOTS, SensorFrame, corrected_all, forgotten, knots, sensor_frame, stated
from data.se2 import Array
from data.sensors import Sensor, wrap_angle_jit
from graph.factors import between_factors, increment_roots

NO_SENSOR_ERRORS = (
    "systematic errors of range or bearing are not estimated beside fixes or closures: those of odometry are "
    "(--calibrate scale,curvature,left,right,drift)"
)

CONSTANTS = gtsam.symbol("c", 0)  # key of all constant systematic errors, a vector in units of their prior sigmas


def drift_key(knot: int) -> int:
    """Key of the drift of a knot, a vector (1,) in units of its sigma."""
    return int(gtsam.symbol("d", knot))


@dataclass(frozen=True, eq=False)
class Errors:
    """Systematic errors to estimate (p may be zero), and the place of each in the graph; q of them are constant."""

    names: tuple[str, ...]  # (p,)
    sigma: Array  # (p,)
    length: float  # m, of the drift
    frame: SensorFrame  # in which the sensor has no errors; the frame of the graph

    @cached_property
    def place(self) -> IntArray:
        """Index of each error (p,) among all."""
        return np.array([list(ERRORS).index(n) for n in self.names], np.int64)

    @cached_property
    def drift(self) -> int:
        """Index of the drift, -1: none."""
        return self.names.index("drift") if "drift" in self.names else -1

    @cached_property
    def constant(self) -> IntArray:
        """Indices (q,) of the constant errors."""
        return np.array([j for j in range(len(self.names)) if j != self.drift], np.int64)

    @property
    def step(self) -> float:
        """Metres from knot to knot."""
        return BETWEEN_KNOTS * self.length

    @property
    def order(self) -> IntArray:
        """Error (p,) of each coordinate of the variables: the constants, then the drift."""
        return np.append(self.constant, [self.drift] * (self.drift >= 0)).astype(np.int64)

    @property
    def sizes(self) -> dict[str, int]:
        """Dimensions of the variables, by the character of their keys."""
        return {name: size for name, size in {"c": len(self.constant), "d": int(self.drift >= 0)}.items() if size}

    def keys(self, knot: int) -> list[int]:
        """Their variables while the drift is that of a knot."""
        return [CONSTANTS] * bool(len(self.constant)) + [drift_key(knot)] * (self.drift >= 0)

    def zero(self, keys: Iterable[int]) -> gtsam.Values:
        """Some of the variables at zero."""
        values, sizes = gtsam.Values(), self.sizes
        for key in keys:
            values.insert(key, np.zeros(sizes[chr(gtsam.symbolChr(key))]))
        return values

    def of_variables(self, at: Array) -> Array:
        """The errors (p,), or their sigmas, from those of the variables (p,)."""
        found = np.empty(len(self.place))
        found[self.order] = at
        return found * self.sigma

    def terms(self, J: Array, knot: int) -> list[tuple[int, Array]]:
        """A Jacobian (m, p) to the errors in prior sigmas, by variable."""
        found = [(CONSTANTS, J[:, self.constant])] if len(self.constant) else []
        if self.drift >= 0:
            found.append((drift_key(knot), J[:, self.drift : self.drift + 1]))
        return found

    def along(self, increments: Increments) -> "Motion":
        """These errors with the increments of a whole path."""
        return Motion(self.names, self.sigma, self.length, self.frame, increments)

    def refuse_pose_measurements(self) -> None:
        """Raise UsageError for fixes or closures beside errors of the sensor, whose frame is not the world."""
        if not self.frame.same:
            raise UsageError(NO_SENSOR_ERRORS)


def errors_of(systematic: Systematic | None, sensor: Sensor, prior: Prior) -> Errors:
    """The errors that a smoother estimates; without `systematic` there are none."""
    frame = sensor_frame(systematic, sensor, prior)
    if systematic is None:
        return Errors((), np.empty(0), 1.0, frame)
    return Errors(systematic.names, systematic.sigma, systematic.length, frame)


@dataclass(frozen=True, eq=False)
class Motion(Errors):
    """The motion along a whole path of N poses, with the systematic errors in it; the drift has K knots."""

    increments: Increments  # of the log, as stated by odometry

    @cached_property
    def _knots(self) -> tuple[IntArray, Array]:
        return knots(self.length, self.increments.mean)

    @property
    def of(self) -> IntArray:
        """Knot (N,) of the drift into each frame."""
        return self._knots[0]

    @property
    def knots(self) -> int:
        """K, 0 without a drift."""
        return len(self._knots[1]) + 1 if self.drift >= 0 else 0

    @property
    def first_of(self) -> IntArray:
        """First frame (K,) of the drift of each knot."""
        return np.maximum(np.searchsorted(self.of, np.arange(self.knots)), 1).astype(np.int64)

    @cached_property
    def drift_rows(self) -> tuple[Array, Array]:
        """Coefficients (K,) of each knot's drift and of the one before in its whitened prior, drifts in sigmas. drift j
        - decay * drift j - 1 ~ N(0, fresh), with decay 0 at the first.
        """
        known = [(0.0, 1.0), *(forgotten(metres, self.length) for metres in self._knots[1])][: self.knots]
        decay, fresh = np.array(known).reshape(-1, 2).T
        return 1.0 / np.sqrt(fresh), -decay / np.sqrt(fresh)

    def drift_steps(self, errors: Array) -> Array:
        """Whitened steps of the drift (K,) from knot to knot, the first from zero, of errors (N, p)."""
        drift = self._by_knot(errors)
        own, earlier = self.drift_rows
        steps: Array = own * drift
        steps[1:] += earlier[1:] * drift[:-1]
        return steps

    def _by_knot(self, errors: Array) -> Array:
        """The drift (K,) in sigmas from errors (N, p): that of a knot's first frame."""
        at = np.searchsorted(self.of, np.arange(self.knots))
        return np.asarray(errors[at, self.drift] / self.sigma[self.drift] if self.knots else np.empty(0))

    def errors(self, values: gtsam.Values) -> Array:
        """The errors (N, p) into each frame, in their units."""
        found = np.empty((len(self.increments.mean), len(self.names)))
        if len(self.constant):
            found[:, self.constant] = values.atVector(CONSTANTS)
        if self.knots:
            found[:, self.drift] = np.array([values.atVector(drift_key(j))[0] for j in range(self.knots)])[self.of]
        return found * self.sigma

    def insert(self, values: gtsam.Values, errors: Array) -> None:
        """Errors (N, p) as start values."""
        if len(self.constant):
            values.insert(CONSTANTS, errors[-1, self.constant] / self.sigma[self.constant])
        for j, drift in enumerate(self._by_knot(errors)):
            values.insert(drift_key(j), np.array([drift]))

    def factors(self) -> list[gtsam.BetweenFactorPose2]:
        """The increments as factors, without errors. Raises DataError for a singular one."""
        given, none = self.increments, np.zeros((len(self.increments.mean), len(self.names)))
        mean, covariance, _ = corrected_all(given.mean, given.covariance, none, self.place, self.frame.mount)
        return between_factors(1, mean[1:], covariance[1:])[0]

    @cached_property
    def _stated(self) -> tuple[Array, Array]:
        """Copies, since read-only arrays would compile the kernel once more, with the roots of their information."""
        return np.array(self.increments.mean[1:]), increment_roots(1, self.increments.covariance[1:])[0]

    def linearized(self, pose: Array, errors: Array) -> tuple[Array, Array, Array, Array]:
        """As `linearize_increments`, of poses (N, 3) and errors (N, p). Raises DataError for a singular increment."""
        return linearize_increments(pose, *self._stated, errors[1:], self.place, self.frame.mount)


SMALL = 1e-3  # rad. Below this turn the functions of the logarithm use their series, accurate to 1e-15


@njit
def _logarithm(theta: float) -> tuple[float, float]:
    """(theta/2) cot(theta/2), and (1 - that) / theta^2."""
    if abs(theta) < SMALL:
        square = theta * theta
        return 1.0 - square / 12.0 - square * square / 720.0, 1.0 / 12.0 + square / 720.0
    a = 0.5 * theta / math.tan(0.5 * theta)
    return a, (1.0 - a) / (theta * theta)


@njit
def _product(left: Array, right: Array, out: Array) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = left[i, 0] * right[0, j] + left[i, 1] * right[1, j] + left[i, 2] * right[2, j]


@njit
def _adjoint(x: float, y: float, theta: float, out: Array) -> None:
    """Adjoint of the inverse of the pose (x, y, theta), into `out` (3, 3)."""
    c, s = math.cos(theta), math.sin(theta)
    out[0, 0], out[0, 1], out[0, 2] = c, s, s * x - c * y
    out[1, 0], out[1, 1], out[1, 2] = -s, c, c * x + s * y
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0


@njit
def linearize_increments(
    pose: Array, motion: Array, root: Array, errors: Array, place: IntArray, mount: Array
) -> tuple[Array, Array, Array, Array]:
    """Whitened residuals (n, 3) and Jacobians: to the pose before and after (n, 3, 3), body frame of each, and to the
    errors (n, 3, p); of `motion` (n, 3) from pose k to k + 1 of `pose` (n + 1, 3), each under `errors` (n, p).

    `root` (n, 3, 3): R with R'R the information of the odometry's own noise; `place` (p,) and `mount` (3,) as of
    `data.motion.systematic`.
    """
    n, p = errors.shape
    residual, before, after, by_errors = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.empty((n, 3, p))
    all_errors, way, m, A = np.zeros(7), np.zeros(3), np.zeros(3), np.zeros((3, 7))
    H, B, J, Ad = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    W, K = np.zeros((3, 3)), np.zeros((3, 3))
    B[2, 2] = J[2, 2] = 1.0
    for k in range(n):
        all_errors[place] = errors[k]
        c, s = math.cos(pose[k, 2]), math.sin(pose[k, 2])
        wx, wy = pose[k + 1, 0] - pose[k, 0], pose[k + 1, 1] - pose[k, 1]
        way[0], way[1], way[2] = c * wx + s * wy, c * wy - s * wx, pose[k + 1, 2] - pose[k, 2]
        stated(way, all_errors, mount, motion[k, 2] > 0.0, m, H, A)
        # difference from the stated motion (tx, ty, theta), its logarithm (x, y, theta), and the Jacobian of that
        theta: float = wrap_angle_jit(m[2] - motion[k, 2])
        c, s = math.cos(motion[k, 2]), math.sin(motion[k, 2])
        wx, wy = m[0] - motion[k, 0], m[1] - motion[k, 1]
        tx, ty = c * wx + s * wy, c * wy - s * wx
        a, kappa = _logarithm(theta)
        x, y = a * tx + 0.5 * theta * ty, a * ty - 0.5 * theta * tx
        J[0, 0], J[0, 1], J[0, 2] = 1.0 - kappa * theta * theta, -0.5 * theta, 0.5 * y + kappa * theta * x
        J[1, 0], J[1, 1], J[1, 2] = 0.5 * theta, 1.0 - kappa * theta * theta, -0.5 * x + kappa * theta * y
        # whitened in the body frame before: derivatives by the logarithm, m, the motion, and the poses
        B[0, 0], B[0, 1], B[1, 0], B[1, 1] = c, -s, s, c
        _product(root[k], B, W)
        for i in range(3):
            residual[k, i] = W[i, 0] * x + W[i, 1] * y + W[i, 2] * theta
        _product(W, J, K)
        c, s = math.cos(m[2]), math.sin(m[2])
        B[0, 0], B[0, 1], B[1, 0], B[1, 1] = c, s, -s, c
        _product(K, B, W)
        for i in range(3):
            for j in range(p):
                e = place[j]
                by_errors[k, i, j] = W[i, 0] * A[0, e] + W[i, 1] * A[1, e] + W[i, 2] * A[2, e]
        _product(W, H, K)
        c, s = math.cos(way[2]), math.sin(way[2])
        B[0, 0], B[0, 1], B[1, 0], B[1, 1] = c, -s, s, c
        _product(K, B, after[k])
        _adjoint(way[0], way[1], way[2], Ad)  # a shift of the pose before is the opposite shift of the pose after
        _product(after[k], Ad, K)
        before[k] = -K
    return residual, before, after, by_errors
