"""The open end of a graph with systematic errors: newest pose and errors, composed since the newest pose in it.

All poses and covariances are in the sensor's frame, and so is the graph; poses go in and out as the robot's in the
world. Pose and errors are propagated together, with the arithmetic of a filter's prediction.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.blocks import diagonal_blocks
from data.compiled import njit
from data.inputs import Increment, Increments, IntArray, Prior
from data.motion.systematic import correct, forgotten, knot
from data.motion.velocity import carried
from data.result import MapState, PoseEstimate, Systematics
from data.se2 import Array, world_from_body
from data.sensors import wrap_angle_jit
from graph.calibration.factors import Motion, first_factors, knot_factor
from graph.engine import EXTRA, JUMP, Engine, Window
from graph.factors import Factor, ObservationFactors, pose_array
from graph.open_end import MarginalizedPose, OpenEnd
from graph.problem import Problem
from graph.systematic import Calibrated, Errors, drift_key


@njit
def forget(b: Array, P: Array, F: Array, Q: Array, drift: int, stays: float, fresh: float) -> None:
    """Decay the drift, at `drift` among errors b (p,), at a new knot in place, and add its fresh variance."""
    i = 3 + drift
    b[drift] *= stays
    for M in (P, Q):
        M[i] *= stays
        M[:, i] *= stays
        M[i, i] += fresh
    F[i] *= stays


@njit
def advance(
    mean: Array, b: Array, P: Array, F: Array, Q: Array, motion: Array, M: Array, place: IntArray, mount: Array
) -> tuple[Array, Array, Array, Array]:
    """Pose (3,), covariance P of pose and errors b (p,), Jacobian F and gathered covariance Q since an anchor, one raw
    increment later, all (3 + p, 3 + p). Errors have index `place` among all; `mount` as of `correct`.
    """
    p = len(b)
    errors, moved, A, G = np.zeros(7), np.zeros(3), np.zeros((3, 7)), np.zeros((3, 3))
    for j in range(p):
        errors[place[j]] = b[j]
    correct(motion, errors, mount, moved, A, G)
    wx, wy, Fx, B = carried(mean[2], moved)
    J = np.eye(3 + p)
    J[:3, :3] = Fx
    for j in range(p):
        J[:3, 3 + j] = B @ np.ascontiguousarray(A[:, place[j]])
    W = B @ G
    noise = W @ M @ W.T
    P, F, Q = J @ P @ J.T, J @ F, J @ Q @ J.T
    P[:3, :3] += noise
    Q[:3, :3] += noise
    return np.array([mean[0] + wx, mean[1] + wy, wrap_angle_jit(mean[2] + moved[2])]), P, F, Q


RELINEARIZE = 0.2
"""Share of all updates after which everything is relinearized. Otherwise the noise of odometry biases the effect of an
error on an increment: errors of turns are 1.5 sigma off in the arena without, 0.2 with it, 0.03 with half of it."""


class CalibratedEnd(OpenEnd):
    """As `OpenEnd`, with the errors b (p,), of which the drift is that of the newest knot.

    `whole` (3 + p, 3 + p) is the covariance of newest pose and errors, world frame, in the sensor's frame.
    """

    def __init__(self, prior: Prior, errors: Errors) -> None:
        super().__init__(prior)
        self._errors, self.frame = errors, errors.frame
        self._known_exactly &= self.frame.same
        mean, whole = errors.frame.prior_in(prior, errors.systematic.sigma)
        self._origin = mean[:3], mean[3:], whole
        self._motion_log = Motion(errors)
        self._since, self._ended = 0.0, list[float]()
        """m since the last knot; of each increment since the anchor, the m that a new knot before it ended, or 0."""
        self._units = np.zeros_like(whole)
        self._units[3 + errors.order, 3 + np.arange(len(errors.place))] = errors.systematic.sigma[errors.order]
        self._updates, self._looked = 0, 0
        self._reset()

    def _reset(self) -> None:
        (self.mean, self.b, self.whole), self._path_b = self._origin, list[Array]()
        self._F, self._gathered = np.eye(len(self.whole)), np.zeros_like(self.whole)
        self.P = self.whole[:3, :3]

    @property
    def keys(self) -> list[int]:
        """Variables of the graph that determine the newest pose."""
        return [int(X(self.anchor)), *self._errors.keys(self._motion_log.knot)]

    @property
    def errors(self) -> tuple[Array, Array]:
        """Newest mean (p,) and covariance (p, p) of the errors."""
        return self.b.copy(), self.whole[3:, 3:].copy()

    def estimate(self) -> PoseEstimate:
        """The newest pose of the robot."""
        if self.frame.same:
            return super().estimate()
        pose, J = self.frame.poses_out(self.mean[None], self.b[None])
        P = J[0] @ self.whole @ J[0].T
        return PoseEstimate(pose[0], 0.5 * (P + P.T))

    def move(self, increment: Increment) -> None:
        """Add an increment."""
        ended = 0.0
        if self._errors.drift >= 0:
            ended, self._since = knot(self._since, increment.mean[0], increment.mean[1], self._errors.step)
        self._ended.append(ended)
        super().move(increment)

    def _advance(self, increment: Increment) -> None:
        """Propagate the newest pose, the errors and their covariance by one increment."""
        e, ended = self._errors, self._ended[len(self._path)]
        if ended > 0.0:
            decay, share = forgotten(ended, e.systematic.length)
            self.b, self.whole, self._F, self._gathered = (
                np.array(a) for a in (self.b, self.whole, self._F, self._gathered)
            )
            fresh = share * e.systematic.sigma[e.drift] ** 2
            forget(self.b, self.whole, self._F, self._gathered, e.drift, decay, fresh)
        mean, M = np.array(increment.mean), np.array(increment.covariance)
        self.mean, self.whole, self._F, self._gathered = advance(
            self.mean, self.b, self.whole, self._F, self._gathered, mean, M, e.place, e.frame.mount
        )
        self.P = self.whole[:3, :3]
        self._path.append(self.mean)
        self._path_b.append(self.b)

    def inside(self, pose: Array) -> Array:
        """A robot's pose (3,) in the frame of the graph."""
        there: Array = self.frame.poses_in(pose[None], self.b[None])[0]
        return there

    def _since_anchor(self) -> tuple[Array, Array]:
        """Jacobian (3, n) of the newest pose to the variables `keys`, and covariance (3, 3) gathered since."""
        return self._F[:3] @ self._raw(self._origin[0][2]), self._gathered[:3, :3]

    def _raw(self, heading: float) -> Array:
        """Jacobian of anchor (world) and errors to their variables: its body frame, prior sigmas, another order."""
        J = self._units.copy()
        J[:3, :3] = world_from_body(heading)
        return J

    def _first_factors(self, values: gtsam.Values) -> list[Factor]:
        found, start = first_factors(self._errors, self.prior)
        values.insert(start)
        return found

    def _motion_factors(self, values: gtsam.Values) -> tuple[list[Factor], float]:
        e, log = self._errors, self._motion_log
        found, knots = list[Factor](), list[int]()
        for ended, b in zip(self._ended, self._path_b, strict=True):
            if ended > 0.0:
                found.append(knot_factor(e, log.knot, ended))
                log.knot += 1
                values.insert(drift_key(log.knot), b[[e.drift]] / e.systematic.sigma[e.drift])
            knots.append(log.knot)
        factors, pivot = log.extend(self.anchor + 1, self._increments, knots)
        self._path_b, self._ended = [], []
        return found + factors, pivot

    def _motion_again(self, increment: Increment) -> Factor:
        return self._motion_log.again(self.anchor, increment)

    def _settle(self, engine: Engine, before: gtsam.Pose2) -> None:
        """As `Engine.settle`, with all that determines newest pose and errors. After a jump it goes on until the pose
        stays: a loop closure changes the errors, and they the path.
        """
        self._updates += 1
        pose, far = self._take(engine), JUMP
        for _ in range(EXTRA):
            due = self._updates - self._looked >= RELINEARIZE * self._updates
            if not (due or engine.jumped(before, pose, far)):
                break
            before, far = pose, 1.0
            if due:
                self._looked = self._updates
                engine.linearize_all(self.keys[0])
            else:
                engine.update(self.keys[0])
            pose = self._take(engine)

    def _take(self, engine: Engine) -> gtsam.Pose2:
        """Read the anchor and the errors from the graph."""
        change, J = engine.newest(self.keys)
        point = engine.point
        pose = point.atPose2(self.keys[0]).retract(change[:3])
        at = np.concatenate([point.atVector(key) for key in self.keys[1:]]) + change[3:]
        self._motion_log.now[:] = at[: len(self._motion_log.now)]
        T, J = self._raw(pose.theta()), self._fix_anchor(J)
        whole = T @ J @ T.T
        self._origin = pose_array(pose), self._errors.of_variables(at), 0.5 * (whole + whole.T)
        return pose

    def points(self, xy: Array) -> Array:
        """Points (n, 2) of the world from those of the graph."""
        return self.frame.points_out(xy, self.b)[0]

    def reach(self, radius: float) -> tuple[Array, float]:
        """Position (2,) of the newest pose on a known map, and a radius [m] around it there."""
        point, scale, _ = self.frame.points_out(self.mean[None, :2], self.b)
        return point[0], scale * radius

    def known(self, xy: Array) -> tuple[Array, Array]:
        """Known landmarks (n, 2) in the graph's frame; covariance of the newest pose, and theirs if not exact."""
        if self.frame.range_at < 0 or not len(xy):
            return xy, self.P
        there, J = self.frame.points_in(xy, self.b)
        T = np.eye(3 + 2 * len(xy), len(self.whole))
        T[3:, 3:] = J.reshape(2 * len(xy), -1)
        return there, T @ self.whole @ T.T

    def map_of(self, number: IntArray, xy: Array, J: Array) -> MapState:
        """Map of landmarks (n,) at xy (n, 2) in the graph; J: joint covariance of the variables `keys` and them."""
        e, n = self._errors, len(self.whole)
        out, scale, D = self.frame.points_out(xy, self.b)
        C = scale**2 * diagonal_blocks(J[n:, n:])
        if self.frame.range_at >= 0:
            D = D[:, :, e.order] * e.systematic.sigma[e.order]
            across = scale * D @ J[3:n, n:].reshape(n - 3, -1, 2).transpose(1, 0, 2)
            C += across + across.transpose(0, 2, 1) + D @ J[3:n, 3:n] @ D.transpose(0, 2, 1)
        return MapState(number, out, C)

    def leaving(self, window: Window, frame: int) -> MarginalizedPose:
        """The pose of a frame in a window, before its marginalization."""
        e, key = self._errors, int(X(frame))
        variables = e.keys(self._motion_log.knot_of(frame))
        pose, b = window.pose(key), e.of_variables(np.concatenate([window.vector(k) for k in variables]))
        if self.frame.same:
            C, of_pose = window.covariance([key]), pose
            spread = np.concatenate([np.sqrt(np.diag(window.covariance([k]))) for k in variables])
        else:
            J = window.covariance([key, *variables])
            T = self._raw(pose[2])
            out, D = self.frame.poses_out(pose[None], b[None])
            of_pose, D = out[0], world_from_body(out[0, 2]).T @ D[0] @ T
            C, spread = D @ J @ D.T, np.sqrt(np.diag(J)[3:])
        return MarginalizedPose(of_pose, C, (b, e.of_variables(spread)))

    def forget(self, oldest: int) -> list[int]:
        """Make frame `oldest` the first one in the graph; returns the knots of the drift that leave it."""
        removed = self._motion_log.forget(oldest)
        return [drift_key(k) for k in removed if self._errors.drift >= 0]

    def history(self, left: Array) -> Systematics | None:
        """Systematic errors by frame: the last constants, the drift as it was when a frame left."""
        e, found = self._errors, left.copy()
        found[:, :, e.constant] = found[-1:, :, e.constant]
        return Systematics(e.systematic.names, found[:, 0], found[:, 1])

    def problem(self, observations: Sequence[ObservationFactors], known_map: bool) -> Problem:
        """The whole run as a problem."""
        mean, covariance = self._motion_log.raw
        calibrated = Calibrated(self._errors.systematic, self.frame, Increments(mean, covariance))
        return Problem(self.prior, calibrated.motion(), observations, known_map, calibrated)

    def start(self, values: gtsam.Values, problem: Problem) -> gtsam.Values:
        """The present estimate with known landmarks exactly at their positions under the errors."""
        if self.frame.range_at >= 0 and problem.known_map and problem.calibrated is not None:
            b = problem.calibrated.errors(values)[0]
            for s in problem.observations:
                if s.key is not None and s.xy is not None:
                    values.update(s.key, self.frame.points_in(s.xy[None], b)[0][0])
        return values
