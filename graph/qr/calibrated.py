"""Systematic errors in a linearized problem: rows of increments and priors, and columns of the errors.

The drift of a knot is a variable like a pose. The few constant errors affect all rows: they are further right-hand
sides (see `graph.qr.solution`), the effect of a prior sigma of each on the residuals. All is in the sensor's frame
(`data.motion.systematic`), except the first pose, which the prior knows in the world: its variable is the motion of the
robot's own pose, with a column for the errors.

The residual of an increment is Log(m^-1 g(X^-1 Y, b)) for poses X, Y: of the stated motion m, against the motion g that
odometry would have stated without noise (`data.motion.systematic`). Without errors it is that of gtsam's between
factor. The errors act on the smoothed motion: acting on the stated one they would share its noise, and a scale would be
biased low by the noise's share of the squared motion (Fuller, "Measurement Error Models", 1987, section 1.1). Nor does
the whitening depend on the errors: a large range error would make any residual cheap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.compiled import njit
from data.inputs import IntArray
from data.motion.systematic import forgotten, stated
from data.result import MapState, Systematics, Trajectory
from data.se2 import Array, compose, covariances_in_world, world_from_body, worlds_from_bodies
from data.sensors import wrap_angle_jit
from graph.factors import pose2, pose_array, prior_factor, root_information
from graph.problem import Problem, displaced
from graph.qr.solution import Solution
from graph.systematic import CONSTANTS, Calibrated, drift_key

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
    """Left @ right, (3, 3) each, into `out`."""
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
        for j in range(p):
            all_errors[place[j]] = errors[k, j]
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
        # a shift of the pose before is the opposite shift of the pose after
        _adjoint(way[0], way[1], way[2], Ad)
        _product(after[k], Ad, K)
        for i in range(3):
            for j in range(3):
                before[k, i, j] = -K[i, j]
    return residual, before, after, by_errors


class CalibratedRows:
    """The rows and columns of the systematic errors."""

    def __init__(self, problem: Problem) -> None:
        assert problem.calibrated is not None
        self._problem, self._of = problem, problem.calibrated
        c = problem.calibrated
        self.constants = len(c.constant)  # q
        self.first_of = first_frames(c.of, c.knots)  # (K,)
        self._root = root_information(c.increments.covariance[1:])[0]
        self._prior = prior_factor(problem.prior)
        self._own, self._earlier = drift_rows(c.ended, c.systematic.length)
        self._last: tuple[gtsam.Values, Array, Array] | None = None
        self._world = np.array([s.xy for s in problem.observations]).reshape(-1, 2) if problem.known_map else None

    def fill(self, A: Array, b: Array, values: gtsam.Values) -> tuple[Array, Array]:
        """Rows of the increments and of the drift, and the columns of the constant errors, in place.

        Returns Jacobians (3, 3) and (3, q) of the first pose's tangent coordinates in the frame to those of the robot's
        pose and to the constant errors in sigmas.
        """
        c, n = self._of, len(self._of.of)
        pose, errors = self._state(values)
        residual, before, after, by_errors = self._increments(pose, errors)
        by_errors *= c.systematic.sigma
        A[1:n, :, :3], A[1:n, :, 3:6] = after, before
        b[1:n, :, 0], b[1:n, :, 1:] = -residual, by_errors[:, :, c.constant]
        if c.knots:
            A[1:n, :, 6] = by_errors[:, :, c.drift]
            A[-c.knots :, 0, 0], A[-c.knots :, 0, 3] = self._own, self._earlier
            b[-c.knots :, 0, 0] = -self._drifts(values)
        if c.frame.range_at >= 0 and self._world is not None:
            # observations are relative: a shift of the landmark is the opposite shift of the pose
            seen = np.array([s.frame for s in self._problem.observations], np.int64)
            shift = (self._world - c.frame.origin) * c.systematic.sigma[c.frame.range_at]
            cos, sin = np.cos(pose[seen, 2]), np.sin(pose[seen, 2])
            body = np.stack([cos * shift[:, 0] + sin * shift[:, 1], cos * shift[:, 1] - sin * shift[:, 0]], 1)
            rows, at = slice(n, n + len(seen)), 1 + int(np.searchsorted(c.constant, c.frame.range_at))
            b[rows, :, at] -= np.einsum("mij,mj->mi", A[rows, :, :2], body)
        return self._first(errors[0], pose[0])

    def _state(self, values: gtsam.Values) -> tuple[Array, Array]:
        """Poses (N, 3), in the order of gtsam's keys, and errors (N, p); cached."""
        if self._last is None or self._last[0] is not values:
            self._last = values, np.ascontiguousarray(gtsam.utilities.extractPose2(values)), self._of.errors(values)
        return self._last[1:]

    def _increments(self, pose: Array, errors: Array) -> tuple[Array, Array, Array, Array]:
        """As `linearize_increments`, of poses (N, 3) and errors (N, p)."""
        c = self._of
        return linearize_increments(pose, c.increments.mean[1:], self._root, errors[1:], c.place, c.frame.mount)

    def _drifts(self, values: gtsam.Values) -> Array:
        """Whitened steps of the drift (K,) from knot to knot, the first from zero."""
        drift = np.array([values.atVector(drift_key(j))[0] for j in range(self._of.knots)])
        steps: Array = self._own * drift
        steps[1:] += self._earlier[1:] * drift[:-1]
        return steps

    def _first(self, errors: Array, pose: Array) -> tuple[Array, Array]:
        c = self._of
        J, by_constants = np.eye(3), np.zeros((3, self.constants))
        if c.frame.same:
            return J, by_constants
        size = 1.0
        sigma = c.systematic.sigma
        bearing = 0.0
        if c.frame.bearing_at >= 0:
            bearing = errors[c.frame.bearing_at]
            by_constants[2, np.searchsorted(c.constant, c.frame.bearing_at)] = -sigma[c.frame.bearing_at]
        if c.frame.range_at >= 0:
            size += errors[c.frame.range_at]
            away = world_from_body(pose[2])[:2, :2].T @ (pose[:2] - c.frame.origin) / size
            by_constants[:2, np.searchsorted(c.constant, c.frame.range_at)] = sigma[c.frame.range_at] * away
        sensor = compose(c.frame.mount, np.array([0.0, 0.0, -bearing]))
        J = np.diag([size, size, 1.0]) @ pose2(sensor).inverse().AdjointMap()
        return J, by_constants

    def robot(self, values: gtsam.Values) -> gtsam.Values:
        """The robot's first pose in the world, as values."""
        pose, errors = self._state(values)
        out, _ = self._of.frame.poses_out(pose[:1], errors[:1])
        first = gtsam.Values()
        first.insert(X(0), pose2(out[0]))
        return first

    def cost(self, values: gtsam.Values) -> float:
        """Half the sum of squares of increments, drift and priors; see `graph.qr.rows.Linearizer.cost`."""
        residual, _, _, _ = self._increments(*self._state(values))
        total = float(np.sum(residual**2))
        if self.constants:
            total += float(np.sum(values.atVector(CONSTANTS) ** 2))
        if self._of.knots:
            total += float(np.sum(self._drifts(values) ** 2))
        return 0.5 * total + float(self._prior.error(self.robot(values)))

    def moved(
        self, values: gtsam.Values, vector: gtsam.VectorValues, first: Array, drifts: Array, constants: Array
    ) -> gtsam.Values:
        """Apply a step: `vector` of poses and landmarks except the first pose, where the robot moves by `first`."""
        for j, drift in enumerate(drifts):
            vector.insert(drift_key(j), np.array([drift]))
        if self.constants:
            vector.insert(CONSTANTS, constants)
        pose = self.robot(values).atPose2(X(0)).retract(first)
        moved = values.retract(vector)
        errors = self._of.errors(moved)
        moved.update(X(0), pose2(self._of.frame.poses_in(pose_array(pose)[None], errors[:1])[0]))
        if self._world is not None and self._of.frame.range_at >= 0:
            for s, xy in zip(self._problem.observations, self._landmarks(errors), strict=True):
                if s.key is not None:
                    moved.update(s.key, xy)
        return moved

    def measured(self, values: gtsam.Values) -> list[Sequence[gtsam.NonlinearFactor]] | None:
        """The factors of all observations at the errors of `values`, None if they are constant."""
        observations = self._problem.observations
        if self._world is None or self._of.frame.range_at < 0 or all(s.key is not None for s in observations):
            return None
        xy = self._landmarks(self._state(values)[1])
        return [displaced(s, at).measured for s, at in zip(observations, xy, strict=True)]

    def _landmarks(self, errors: Array) -> Array:
        """The known landmarks (M,) of the observations, in the frame."""
        assert self._world is not None
        return self._of.frame.points_in(self._world, errors[-1])[0]


def first_frames(of: IntArray, knots: int) -> IntArray:
    """First frame (K,) of the drift of each knot; `of` (N,) as of `data.motion.systematic.knots`."""
    return np.maximum(np.searchsorted(of, np.arange(knots)), 1).astype(np.int64)


def with_drift(
    variable: IntArray, height: IntArray, dim: IntArray, of: IntArray, knots: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Variables (B, 3), heights (B,) and dimensions (V,) of `Rows` with a drift of `knots` knots as last variables. It
    enters the blocks of the increments, 1 to N - 1; those of its prior come last. The same without a knot.
    """
    if not knots:
        return variable, height, dim
    drift, enters, chain = len(dim) + np.arange(knots), np.full(len(variable), -1), np.full((knots, 3), -1)
    enters[1 : len(of)] = drift[of[1:]]
    chain[:, 0], chain[1:, 1] = drift, drift[:-1]
    one = np.ones(knots, np.int64)
    return (
        np.concatenate([np.column_stack([variable, enters]), chain]),
        np.concatenate([height, one]),
        np.concatenate([dim, one]),
    )


def drift_rows(ended: Array, length: float) -> tuple[Array, Array]:
    """Coefficients (K,) of each knot's drift and of the one before in its whitened prior, drifts in sigmas.

    drift j - decay * drift j - 1 ~ N(0, fresh), with decay 0 at the first. `ended` (K - 1,) and `length` as of
    `data.motion.systematic`.
    """
    decay, fresh = np.array([(0.0, 1.0), *(forgotten(metres, length) for metres in ended)]).T
    return 1.0 / np.sqrt(fresh), -decay / np.sqrt(fresh)


def results_in_world(
    calibrated: Calibrated, errors: Array, solution: Solution, pose: Array, covariance: Array, state: MapState | None
) -> tuple[Trajectory, MapState | None, Systematics]:
    """Path, map (None where it was known) and systematic errors, in the world, from those in the frame.

    `errors` (N, p) and `solution` at the optimum; `covariance` (V, 3, 3) of all variables: poses in body frames, the
    first that of the robot itself; landmarks; drifts in squared sigmas.
    """
    n = len(errors)
    sigma, at = calibrated.systematic.sigma, calibrated.constant
    of_errors = solution.covariance * np.outer(sigma[at], sigma[at])
    across = -solution.columns @ (solution.covariance * sigma[at])
    out, J = calibrated.frame.poses_out(pose, errors)
    of_path = _joint(covariance[:n], across[:n], of_errors)
    # from the body frame to the sensor's world, then to the robot's world
    J = J[:, :, np.concatenate([np.arange(3), 3 + at])]
    J[:, :, :3] = J[:, :, :3] @ worlds_from_bodies(pose[:, 2])
    world = J @ of_path @ J.transpose(0, 2, 1)
    world[:1] = covariances_in_world(out[:1, 2], covariance[:1])
    path = Trajectory(out, 0.5 * (world + world.transpose(0, 2, 1)))
    if state is not None:
        rows = slice(n, n + len(state.number))
        xy, scale, by_errors = calibrated.frame.points_out(state.xy, errors[-1])
        joint = _joint(covariance[rows, :2, :2], across[rows, :2], of_errors)
        J = np.concatenate([np.tile(scale * np.eye(2), (len(xy), 1, 1)), by_errors[:, :, at]], axis=2)
        state = MapState(state.number, xy, J @ joint @ J.transpose(0, 2, 1))
    deviation = np.empty_like(errors)
    deviation[:, at] = np.sqrt(np.diag(of_errors))
    if calibrated.knots:
        deviation[:, calibrated.drift] = (
            np.sqrt(covariance[-calibrated.knots :, 0, 0])[calibrated.of] * sigma[calibrated.drift]
        )
    return path, state, Systematics(calibrated.systematic.names, errors, deviation)


def _joint(own: Array, across: Array, of_errors: Array) -> Array:
    """Joint covariances (n, d + q, d + q) of n variables with the constant errors."""
    n, d, q = across.shape
    joint = np.empty((n, d + q, d + q))
    joint[:, :d, :d], joint[:, d:, d:] = own, of_errors
    joint[:, :d, d:], joint[:, d:, :d] = across, across.transpose(0, 2, 1)
    return joint
