"""The open end of a graph with systematic errors: newest pose and errors, composed since the newest pose in it.

All poses and covariances are in the sensor's frame, and so is the graph; what is handed out, or comes in as a pose, is
the robot's in the world.

A pose and the systematic errors carried along together: the same arithmetic as a filter's joint prediction.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import gtsam
import numba
import numpy as np
from gtsam.symbol_shorthand import X

from data.blocks import diagonal_blocks
from data.inputs import Increment, Increments, IntArray, Prior
from data.motion.systematic import correct, forgotten, knot
from data.motion.velocity import carried
from data.result import MapState, PoseEstimate, Systematics
from data.se2 import Array, world_from_body
from data.sensors import wrap_angle_jit
from graph.calibration.factors import Motion, first_factors, knot_factor
from graph.calibration.variables import Errors
from graph.engine import EXTRA, JUMP, Engine, Window
from graph.factors import Factor, Sighted, is_exact, pose2
from graph.open_end import Left, OpenEnd
from graph.problem import Calibrated, Problem, drift_key


@numba.njit(cache=True)
def forget(b, P, F, Q, drift, stays, fresh):  # type: ignore[no-untyped-def]
    """At a new knot, in place: of the drift, at `drift` among errors b (p,), a share stays, and variance comes."""
    i = 3 + drift
    b[drift] *= stays
    for M in (P, Q):
        M[i] *= stays
        M[:, i] *= stays
        M[i, i] += fresh
    F[i] *= stays


@numba.njit(cache=True)
def advance(mean, b, P, F, Q, motion, M, place, mount):  # type: ignore[no-untyped-def]
    """Pose (3,), covariance P of pose and errors b (p,), both (3 + p), Jacobian F and gathered covariance Q since an
    anchor, one raw increment later. Errors stand at `place` among all; `mount` as of `correct`.
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


ANEW = 0.2
"""Of all updates so far: after so many everything is linearized anew, however little it moved. What an error changes of
an increment is taken at the poses, and there the noise of odometry would bias it: without, errors of turns are 1.5
sigma off in the arena, with it 0.2; with half of it 0.03, and the arena takes 1.5 times as long."""


class CalibratedEnd(OpenEnd):
    """As `OpenEnd`, with the errors as they are known.

    Attributes:
        b: (p,) the errors, the drift that of the newest knot.
        whole: (3 + p, 3 + p) covariance of newest pose and errors, world frame, in the sensor's frame.
    """

    def __init__(self, prior: Prior, errors: Errors) -> None:
        """At the prior."""
        super().__init__(prior)
        self._errors, self.frame = errors, errors.frame
        mean, self.whole = errors.frame.prior_in(prior, errors.systematic.sigma)
        self.mean, self.b = mean[:3], mean[3:]
        self._motion_log = Motion(errors)
        self._since, self._ended = 0.0, list[float]()
        """m since the last knot; of each increment since the anchor, the m that a new knot before it ended, or 0."""
        self._path_b = list[Array]()
        self._units = np.zeros_like(self.whole)
        self._units[3 + errors.order, 3 + np.arange(len(self.b))] = errors.systematic.sigma[errors.order]
        self._updates, self._looked = 0, 0
        self._from_here()

    def _from_here(self) -> None:
        """The newest pose is the anchor."""
        n = len(self.whole)
        self._anchor, self._F, self._gathered = (self.mean, self.b, self.whole), np.eye(n), np.zeros((n, n))
        self.P = self.whole[:3, :3]

    @property
    def keys(self) -> list[int]:
        """Variables of the graph that the newest pose follows from."""
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
        """One increment further."""
        ended = 0.0
        if self._errors.drift >= 0:
            ended, self._since = knot(self._since, increment.mean, self._errors.step)
        self._ended.append(ended)
        super().move(increment)

    def _advance(self, increment: Increment) -> None:
        """The newest pose, the errors and their covariance by one increment."""
        e, ended = self._errors, self._ended[len(self._path)]
        if ended > 0.0:
            stays, anew = forgotten(ended, e.systematic.length)
            self.b, self.whole, self._F, self._gathered = (
                np.array(a) for a in (self.b, self.whole, self._F, self._gathered)
            )
            fresh = anew * e.systematic.sigma[e.drift] ** 2
            forget(self.b, self.whole, self._F, self._gathered, e.drift, stays, fresh)
        mean, M = np.array(increment.mean), np.array(increment.covariance)
        self.mean, self.whole, self._F, self._gathered = advance(
            self.mean, self.b, self.whole, self._F, self._gathered, mean, M, e.place, e.frame.mount
        )
        self.P = self.whole[:3, :3]
        self._path.append(self.mean)
        self._path_b.append(self.b)

    def inflate(self, covariance: Array) -> None:
        """So much covariance (3, 3), alike in all directions, is added to the last increment's."""
        if not self._increments:
            raise ValueError("there was no motion since the last sighting")
        mean, stated = self._increments[-1]
        self._increments[-1] = Increment(mean, stated + covariance)
        self._again()

    def _again(self) -> None:
        """All increments since the anchor once more."""
        (self.mean, self.b, self.whole), self._path, self._path_b = self._anchor, [], []
        self._from_here()
        for increment in self._increments:
            self._advance(increment)

    def inside(self, pose: Array) -> Array:
        """A pose (3,) of the robot as it is in the graph."""
        there: Array = self.frame.poses_in(pose[None], self.b[None])[0]
        return there

    def carried(self, J: Array) -> Array:
        """Joint covariance of the newest pose and landmarks (there) from that of the variables `keys` and landmarks."""
        n = len(self.whole)
        T, J = self._F[:3] @ self._raw(self._anchor[0][2]), self._free(J)
        found = np.empty((len(J) - n + 3,) * 2)
        across = T @ J[:n]
        found[:3, :3] = across[:, :n] @ T.T + self._gathered[:3, :3]
        found[:3, 3:], found[3:, :3], found[3:, 3:] = across[:, n:], across[:, n:].T, J[n:, n:]
        return found

    def _free(self, J: Array) -> Array:
        """Joint covariance of the anchor and others, as it is where a hard constraint holds the anchor."""
        if self.anchor == 0 and self.frame.same and is_exact(self.prior):
            J[:3], J[:, :3] = 0.0, 0.0  # gtsam's joint marginal takes it for a variance of about 1
        return J

    def _raw(self, heading: float) -> Array:
        """Jacobian of anchor (world) and errors to their variables: its body frame, prior sigmas, another order."""
        J = self._units.copy()
        J[:3, :3] = world_from_body(heading)
        return J

    def join_graph(self, values: gtsam.Values) -> tuple[list[Factor], float]:
        """Factors of the increments (and the prior), start values added to `values`: the newest pose is the anchor."""
        e, log = self._errors, self._motion_log
        found = list[Factor]()
        if self.anchor < 0:
            self.anchor = 0
            found, start = first_factors(e, self.prior)
            values.insert(start)
        if not self._increments:
            return found, np.inf
        first, knots = self.anchor + 1, list[int]()
        for ended, b in zip(self._ended, self._path_b, strict=True):
            if ended > 0.0:
                found.append(knot_factor(e, log.knot, ended))
                log.knot += 1
                values.insert(drift_key(log.knot), b[[e.drift]] / e.systematic.sigma[e.drift])
            knots.append(log.knot)
        for k, pose in enumerate(self._path, first):
            values.insert(X(k), pose2(pose))
        factors, pivot = log.extend(first, self._increments, knots)
        self.anchor += len(self._increments)
        self._increments, self._path, self._path_b, self._ended = [], [], [], []
        return found + factors, pivot

    def read(self, engine: Engine) -> None:
        """The graph has a new estimate of anchor and errors: the newest pose follows from it."""
        self._settle(engine, pose2(self.mean))
        self._again()

    def _settle(self, engine: Engine, before: gtsam.Pose2) -> None:
        """As `Engine.settle`, with all that the newest pose and the errors are read from at once.

        After a jump it goes on until the pose stays: the loop says something new of the errors, and they of the path.
        """
        self._updates += 1
        pose, far = self._take(engine), JUMP
        for _ in range(EXTRA):
            due = self._updates - self._looked >= ANEW * self._updates
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
        """The anchor and the errors as the graph has them."""
        change, J = engine.newest(self.keys)
        point = engine.point
        pose = point.atPose2(self.keys[0]).retract(change[:3])
        at = np.concatenate([point.atVector(key) for key in self.keys[1:]]) + change[3:]
        self._motion_log.now[:] = at[: len(self._motion_log.now)]
        self.b = np.empty_like(self.b)
        self.b[self._errors.order] = at
        self.b *= self._errors.systematic.sigma
        self.mean = np.array([pose.x(), pose.y(), pose.theta()])
        T, J = self._raw(self.mean[2]), self._free(J)
        self.whole = T @ J @ T.T
        self.whole = 0.5 * (self.whole + self.whole.T)
        self._anchor = self.mean, self.b, self.whole
        return pose

    def points(self, xy: Array) -> Array:
        """Points (n, 2) of the world from those of the graph."""
        return self.frame.points_out(xy, self.b)[0]

    def reach(self, radius: float) -> tuple[Array, float]:
        """Where the newest pose (2,) is on a known map, and a radius [m] around it there."""
        point, scale, _ = self.frame.points_out(self.mean[None, :2], self.b)
        return point[0], scale * radius

    def known(self, xy: Array) -> tuple[Array, Array]:
        """Known landmarks (n, 2) as they are there; covariance of the newest pose, and of them if not known."""
        if self.frame.range_at < 0 or not len(xy):
            return xy, self.P
        there, J = self.frame.points_in(xy, self.b)
        T = np.eye(3 + 2 * len(xy), len(self.whole))
        T[3:, 3:] = J.reshape(2 * len(xy), -1)
        return there, T @ self.whole @ T.T

    def map_of(self, number: IntArray, xy: Array, J: Array) -> MapState:
        """Landmarks (n,) of the graph, at xy (n, 2) there; J: joint covariance of the variables `keys` and them."""
        e, n = self._errors, len(self.whole)
        out, scale, D = self.frame.points_out(xy, self.b)
        C = scale**2 * diagonal_blocks(J[n:, n:])
        if self.frame.range_at >= 0:
            D = D[:, :, e.order] * e.systematic.sigma[e.order]
            across = scale * D @ J[3:n, n:].reshape(n - 3, -1, 2).transpose(1, 0, 2)
            C += across + across.transpose(0, 2, 1) + D @ J[3:n, 3:n] @ D.transpose(0, 2, 1)
        return MapState(number, out, C)

    def leaving(self, window: Window, frames: Iterable[int]) -> list[Left]:
        """Poses of frames in a window, which may leave it."""
        return [self._leaving(window, k) for k in frames]

    def _leaving(self, window: Window, frame: int) -> Left:
        e, n = self._errors, len(self.whole)
        key, knot = int(X(frame)), self._motion_log.knot_of(frame)
        pose, b = window.pose(key), e.read(window, knot)
        if self.frame.same:
            C, of_pose = window.covariance([key]), pose
            spread = np.concatenate([np.sqrt(np.diag(window.covariance([k]))) for k in e.keys(knot)])
        else:
            J = window.covariance([key, *e.keys(knot)])
            T = self._raw(pose[2])
            out, D = self.frame.poses_out(pose[None], b[None])
            of_pose, D = out[0], world_from_body(out[0, 2]).T @ D[0] @ T
            C, spread = D @ J @ D.T, np.sqrt(np.diag(J)[3:])
        sigma = np.empty(n - 3)
        sigma[e.order] = spread
        return Left(of_pose, C, (b, sigma * e.systematic.sigma))

    def forget(self, oldest: int) -> list[int]:
        """Frame `oldest` becomes the first one in the graph: knots of the drift that leave it."""
        gone = self._motion_log.forget(oldest)
        return [drift_key(k) for k in gone if self._errors.drift >= 0]

    def history(self, left: Array) -> Systematics | None:
        """Systematic errors by frame: the constants as known last, the drift as it was when a frame left."""
        e, found = self._errors, left.copy()
        found[:, :, e.constant] = found[-1:, :, e.constant]
        return Systematics(e.systematic.names, found[:, 0], found[:, 1])

    def problem(self, sighted: Sequence[Sighted], known_map: bool) -> Problem:
        """All of the run as a problem."""
        mean, covariance = self._motion_log.raw
        calibrated = Calibrated(self._errors.systematic, self.frame, Increments(mean, covariance))
        motion = calibrated.motion(np.zeros((len(mean), len(self.b))))
        return Problem(self.prior, motion, sighted, known_map, calibrated)

    def start(self, values: gtsam.Values, problem: Problem) -> gtsam.Values:
        """Where the search for the optimum starts: the present estimate, known landmarks exactly where errors put them.

        The first copy of the constants is that of the problem.
        """
        if self.frame.range_at >= 0 and problem.known_map:
            b = self._errors.read_from(values)
            for s in problem.sighted:
                if s.key is not None and s.xy is not None:
                    values.update(s.key, self.frame.points_in(s.xy[None], b)[0][0])
        return values
