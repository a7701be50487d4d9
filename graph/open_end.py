"""The open end of the graph: newest pose and systematic errors, composed since the newest pose in the graph.

All poses and covariances are in the sensor's frame, and so is the graph; poses go in and out as the robot's in the
world. Pose and errors are propagated together, with the arithmetic of a filter's prediction.

The factor of an increment with errors is exact in both poses, and linear in the errors. A factor linear in the poses as
well is exact only to first order: poses move by metres while increments are known to millimetres. So the residual is
evaluated at each linearization at the present errors, and extrapolated by its tangent to the errors of gtsam's
linearization point. These may be far apart, without another elimination of the rest.
"""

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.blocks import diagonal_blocks
from data.inputs import FrameObservations, Increment, Increments, IntArray, Prior
from data.motion.systematic import corrected, forgotten, knot
from data.motion.velocity import carried
from data.result import MapState, PoseEstimate, Systematics
from data.se2 import Array, world_from_body, wrap_angle
from data.sensors import Sensor
from graph import factors
from graph.engine import EXTRA, JUMP, Engine, Window
from graph.problem import Problem
from graph.systematic import Errors, Motion, drift_key, linearize_increments

PINNED = 1e-4
"""m. Sigma of a known landmark in the sensor's frame, where no prior can hold it exactly. It adds 1e-4 to the variance
of observations of 0.01 m; Cholesky fails at a weight of 1e10."""
UNIT = {n: factors.noise.Unit.Create(n) for n in (1, 2, 3)}


def linear_factor(terms: list[tuple[int, Array]], b: Array, point: gtsam.Values) -> factors.Factor:
    """The residual sum of A x - b in units of its sigma, x relative to `point`. A `JacobianFactor` of more than three
    variables has no constructor in Python; its subclass `GaussianConditional` has.
    """
    whole = gtsam.GaussianConditional(terms, 1, b, UNIT[len(b)])
    return gtsam.LinearContainerFactor(gtsam.JacobianFactor(whole), point)


def knot_factor(errors: Errors, knot: int, ended: float) -> factors.Factor:
    """The factor between a knot's drift and that of the next one, after `ended` metres."""
    decay, fresh = forgotten(ended, errors.length)
    sigma = np.sqrt(fresh)
    terms = [(drift_key(knot), np.array([[-decay / sigma]])), (drift_key(knot + 1), np.array([[1.0 / sigma]]))]
    return linear_factor(terms, np.zeros(1), errors.zero(key for key, _ in terms))


def first_factors(errors: Errors, prior: Prior) -> tuple[list[factors.Factor], gtsam.Values]:
    """The prior of the first pose and the errors, with start values; `prior` is the robot's, in its own frame."""
    values = errors.zero(errors.keys(0))
    sizes = zip(errors.keys(0), errors.sizes.values(), strict=True)
    alone = [gtsam.PriorFactorVector(key, np.zeros(n), factors.noise.Unit.Create(n)) for key, n in sizes]
    sigma = errors.sigma
    mean, P = errors.frame.prior_in(prior, sigma)
    values.insert(X(0), factors.pose2(mean[:3]))
    if errors.frame.same:
        return [factors.prior_factor(prior), *alone], values
    B = world_from_body(mean[2])  # the pose given the errors, in gtsam's body frame
    K = P[:3, 3:] / sigma**2
    variance, axes = np.linalg.eigh(B.T @ (P[:3, :3] - K @ P[3:, :3]) @ B)
    given = axes @ np.diag(np.maximum(variance, PINNED**2)) @ axes.T
    root = factors.root_information(given[None])[0][0]
    pose = linear_factor([(X(0), root), *errors.terms(-root @ B.T @ K * sigma, 0)], np.zeros(3), values)
    return [pose, *alone], values


def pinned_landmark_factors(
    errors: Errors, sensor: Sensor, seen: FrameObservations, frames: IntArray, number: IntArray, xy: Array, row: int,
    now: Array,
) -> list[factors.ObservationFactors]:  # fmt: skip
    """Known landmarks at xy (m, 2) of the world, which depend on the errors in the sensor's frame. Copies L(row), ...
    for each observation, of relative points as well; they start according to the errors `now` (p,).
    """
    copies = np.arange(row, row + len(number))
    there, _ = errors.frame.points_in(xy, now)
    zero, J = errors.frame.points_in(xy, np.zeros_like(now))
    found = factors.landmark_factors(sensor, *seen, frames, copies)
    result = []
    for i, s in enumerate(found):
        assert s.key is not None
        point = errors.zero(errors.keys(0)[:1])
        point.insert(s.key, zero[i])
        terms = [(s.key, np.eye(2) / PINNED), *errors.terms(-J[i] / PINNED * errors.sigma, 0)[:1]]
        result.append(replace(s, number=int(number[i]), pin=linear_factor(terms, np.zeros(2), point), xy=there[i]))
    return result


def increment_factor(
    errors: Errors, frame: int, increment: Increment, root: Array, knot: int, now: Array
) -> gtsam.CustomFactor:
    """The increment into a frame; root (3, 3): R with R'R the information of odometry's noise; `knot`: of its drift.
    `now` (q,): the present constants, in prior sigmas, read at each linearization.
    """
    keys, q = [X(frame - 1), X(frame), *errors.keys(knot)], len(errors.constant)
    # copies: read-only arrays would compile the kernel once more
    motion, roots = (np.array(a[None], float, order="C") for a in (increment.mean, root))
    order, place, mount = np.array(errors.order), np.array(errors.place), np.array(errors.frame.mount, float)
    sigma, b = errors.sigma[order], np.empty((1, len(order)))

    def residual(_: gtsam.CustomFactor, values: gtsam.Values, H: list[Array] | None) -> Array:
        at = np.concatenate([values.atVector(key) for key in keys[2:]])
        about = np.concatenate([now, at[q:]])
        b[0, order] = about * sigma
        poses = np.array([factors.pose_array(values.atPose2(key)) for key in keys[:2]])
        found, before, after, by = linearize_increments(poses, motion, roots, b, place, mount)
        J = by[0][:, order] * sigma
        if H is not None:
            H[0], H[1] = before[0], after[0]
            if q:
                H[2] = J[:, :q]
            if errors.drift >= 0:
                H[-1] = J[:, q:]
        return np.asarray(found[0] + J @ (at - about))

    return gtsam.CustomFactor(UNIT[3], keys, residual)


RELINEARIZE = 0.2
"""Share of all updates after which everything is relinearized. Otherwise the noise of odometry biases the effect of an
error on an increment: errors of turns are 1.5 sigma off in the arena without, 0.2 with it, 0.03 with half of it."""


class OpenEnd:
    """The newest pose with the errors b (p,), drift of the newest knot, and the increments that are not in the graph
    yet. `whole` (3 + p, 3 + p): covariance of both, world frame, in the sensor's frame; `P`: that of the pose.
    """

    def __init__(self, prior: Prior, errors: Errors) -> None:
        self.prior, self._errors, self.frame = prior, errors, errors.frame
        self.anchor = -1  # frame of the newest pose in the graph, -1 before there is one
        self._increments = list[Increment]()
        self._joined: Increment | None = None  # the motion into the newest pose in the graph
        self._known_exactly = factors.is_exact(prior) and self.frame.same
        mean, whole = errors.frame.prior_in(prior, errors.sigma)
        self._origin = mean[:3], mean[3:], whole
        self._since, self._ended = 0.0, list[float]()
        """m since the last knot; of each increment since the anchor, the m that a new knot before it ended, or 0."""
        self._units = np.zeros_like(whole)
        self._units[3 + errors.order, 3 + np.arange(len(errors.place))] = errors.sigma[errors.order]
        self._updates, self._looked = 0, 0
        self._log, self._knots = [Increment(np.zeros(3), np.zeros((3, 3)))], list[int]()  # of the graph, by frame
        self._knot = self._first_knot = 0  # the newest and the first one of the drift in the graph
        self._oldest = 0  # first frame in the graph
        self._now = np.zeros(len(errors.constant))  # in prior sigmas: factors are linearized there
        self._reset()

    def _reset(self) -> None:
        self.mean, self.b, self.whole = self._origin
        self._path, self._path_b = list[Array](), list[Array]()
        self._steps = list[tuple[Array, Array]]()  # of each increment: Jacobian and noise of pose and errors

    @property
    def P(self) -> Array:
        """Covariance (3, 3) of the newest pose."""
        return self.whole[:3, :3]

    @property
    def keys(self) -> list[int]:
        """Variables of the graph that determine the newest pose."""
        return [int(X(self.anchor)), *self._errors.keys(self._knot)]

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """Newest mean (p,) and covariance (p, p) of the errors; None: none are estimated."""
        return (self.b.copy(), self.whole[3:, 3:].copy()) if len(self.b) else None

    def estimate(self) -> PoseEstimate:
        """The newest pose of the robot (copies)."""
        if self.frame.same:
            return PoseEstimate(self.mean.copy(), self.P.copy())
        pose, J = self.frame.poses_out(self.mean[None], self.b[None])
        P = J[0] @ self.whole @ J[0].T
        return PoseEstimate(pose[0], 0.5 * (P + P.T))

    def carried(self, J: Array) -> Array:
        """Joint covariance of the newest pose and landmarks from that of `keys` and landmarks, in graph coordinates."""
        F, gathered = np.eye(len(self.whole)), np.zeros_like(self.whole)
        for step, added in self._steps:
            F, gathered = step @ F, step @ gathered @ step.T + added
        T, J = F[:3] @ self._raw(self._origin[0][2]), self._fix_anchor(J)
        n = T.shape[1]
        found = np.empty((len(J) - n + 3,) * 2)
        across = T @ J[:n]
        found[:3, :3] = across[:, :n] @ T.T + gathered[:3, :3]
        found[:3, 3:], found[3:, :3], found[3:, 3:] = across[:, n:], across[:, n:].T, J[n:, n:]
        return found

    def _raw(self, heading: float) -> Array:
        """Jacobian of anchor (world) and errors to their variables: its body frame, prior sigmas, another order."""
        J = self._units.copy()
        J[:3, :3] = world_from_body(heading)
        return J

    def _fix_anchor(self, J: Array) -> Array:
        """Joint covariance of the anchor and others, corrected where a hard constraint holds the anchor."""
        if self.anchor == 0 and self._known_exactly:
            J[:3], J[:, :3] = 0.0, 0.0  # gtsam's joint marginal has a variance of about 1
        return J

    def move(self, increment: Increment) -> None:
        """Add an increment."""
        ended = 0.0
        if self._errors.drift >= 0:
            ended, self._since = knot(self._since, increment.mean[0], increment.mean[1], self._errors.step)
        self._ended.append(ended)
        self._increments.append(increment)
        self._advance(increment)

    def _advance(self, increment: Increment) -> None:
        """Propagate the newest pose, the errors and their covariance by one increment."""
        e, ended, d, before = self._errors, self._ended[len(self._path)], len(self.whole), None
        if ended > 0.0:  # the drift decays at a new knot, and gets its fresh variance
            before = np.ones(d), np.zeros(d)
            before[0][3 + e.drift], share = forgotten(ended, e.length)
            before[1][3 + e.drift] = share * e.sigma[e.drift] ** 2
            self.b = self.b * before[0][3:]
        moved, M, A = corrected(increment, self.b, e.place, e.frame.mount) if e.names else (*increment, None)
        wx, wy, step, B = carried(float(self.mean[2]), moved)
        added = B @ M @ B.T
        if A is not None:
            J, own, added = np.eye(d), added, np.zeros((d, d))
            J[:3, :3], J[:3, 3:] = step, B @ A
            step = J
            if before is not None:
                step, added = J * before[0], (J * before[1]) @ J.T
            added[:3, :3] += own
        self.whole = step @ self.whole @ step.T + added
        self._steps.append((step, added))
        x, y, heading = self.mean
        self.mean = np.array([x + wx, y + wy, wrap_angle(heading + moved[2])])
        self._path.append(self.mean)
        self._path_b.append(self.b)

    def inflate(self, covariance: Array) -> None:
        """Add an isotropic covariance (3, 3) to the last increment's."""
        if not self._increments:
            raise ValueError("there was no motion since the last observation")
        mean, stated = self._increments[-1]
        self._increments[-1] = Increment(mean, stated + covariance)
        self._propagate_again()

    def inflated(self, covariance: Array) -> factors.Factor:
        """Factor of the motion into the newest pose in the graph, with that much covariance (3, 3) more."""
        assert self._joined is not None  # the newest pose joined with a motion
        mean, stated = self._joined
        self._joined = Increment(mean, stated + covariance)
        # The newest motion's factor anew, with another covariance.
        self._log[-1:] = [self._joined]  # of a window, none are kept
        (factor,), _ = self._factors(self.anchor, [self._joined], self._knots[-1:])
        return factor

    def _propagate_again(self) -> None:
        """Propagate all increments since the anchor again."""
        self._reset()
        for increment in self._increments:
            self._advance(increment)

    def inside(self, pose: Array) -> Array:
        """A robot's pose (3,) in the frame of the graph."""
        return np.asarray(self.frame.poses_in(pose[None], self.b[None])[0])

    def place(self, pose: Array, *, joined: bool = False) -> None:
        """Start the newest pose at another pose (3,) of the graph, if there was motion or it is in the graph."""
        if self._increments:
            self.mean = self._path[-1] = pose.copy()
        elif joined:
            self.mean = pose.copy()

    def join_graph(self, values: gtsam.Values) -> tuple[list[factors.Factor], float]:
        """Factors of the increments (and the prior), start values added to `values`: the newest pose is the anchor.
        Also returns the smallest pivot of their covariances (see `graph.factors.between_factors`).
        """
        e, found, knots = self._errors, list[factors.Factor](), list[int]()
        if self.anchor < 0:
            self.anchor = 0
            found, start = first_factors(e, self.prior)
            values.insert(start)
        if not self._increments:
            return found, np.inf
        for k, pose in enumerate(self._path, self.anchor + 1):
            values.insert(X(k), factors.pose2(pose))
        for ended, b in zip(self._ended, self._path_b, strict=True):
            if ended > 0.0:
                found.append(knot_factor(e, self._knot, ended))
                self._knot += 1
                values.insert(drift_key(self._knot), b[[e.drift]] / e.sigma[e.drift])
            knots.append(self._knot)
        joining, pivot = self._factors(self.anchor + 1, self._increments, knots)
        self._log += self._increments
        self._knots += knots
        self._joined = self._increments[-1]
        self.anchor += len(self._increments)
        self._increments, self._ended, self._path, self._path_b = [], [], [], []
        return [*found, *joining], pivot

    def _factors(
        self, first: int, increments: Sequence[Increment], knots: Sequence[int]
    ) -> tuple[Sequence[factors.Factor], float]:
        """Factors of increments (n) with knots (n,) of drift, and the smallest pivot. DataError: one is singular."""
        mean, covariance = (np.array(rows) for rows in zip(*increments, strict=True))
        if not self._errors.names:
            return factors.between_factors(first, mean, covariance)
        roots, pivot = factors.increment_roots(first, covariance)
        each = zip(increments, roots, knots, strict=True)
        return [increment_factor(self._errors, k, *of, self._now) for k, of in enumerate(each, first)], pivot

    def read(self, engine: Engine) -> None:
        """Propagate the newest pose from the new estimate of the anchor."""
        self._settle(engine, factors.pose2(self.mean))
        self._propagate_again()

    def _settle(self, engine: Engine, before: gtsam.Pose2) -> None:
        """Read the anchor, after more updates if it jumped from `before`; with errors until the pose stays."""
        if not self._errors.names:
            pose = engine.settle(self.keys[0], before)
            B = world_from_body(pose.theta())
            P = B @ engine.covariance(self.keys) @ B.T
            # a sum with a view takes 80 us after gtsam's work
            self._origin = factors.pose_array(pose), self.b, 0.5 * (P + P.T.copy())
            return
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
        self._now[:] = at[: len(self._now)]
        T, J = self._raw(pose.theta()), self._fix_anchor(J)
        whole = T @ J @ T.T
        self._origin = factors.pose_array(pose), self._errors.of_variables(at), 0.5 * (whole + whole.T)
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
            D = D[:, :, e.order] * e.sigma[e.order]
            across = scale * D @ J[3:n, n:].reshape(n - 3, -1, 2).transpose(1, 0, 2)
            C += across + across.transpose(0, 2, 1) + D @ J[3:n, 3:n] @ D.transpose(0, 2, 1)
        return MapState(number, out, C)

    def leaving(self, window: Window, frame: int) -> list[float]:
        """Of the pose of a frame in a window, before its marginalization: pose (3,), covariance (3, 3), body frame, and
        the errors (p,) at that time with their sigmas (p,), one after another.
        """
        e, key = self._errors, int(X(frame))
        variables = e.keys(self._knot_of(frame))
        apart = np.concatenate([np.empty(0), *(window.vector(k) for k in variables)])
        pose, b = window.pose(key), e.of_variables(apart)
        if self.frame.same:
            C, of_pose = window.covariance([key]), pose
            spread = np.concatenate([np.empty(0), *(np.sqrt(np.diag(window.covariance([k]))) for k in variables)])
        else:
            J = window.covariance([key, *variables])
            T = self._raw(pose[2])
            out, D = self.frame.poses_out(pose[None], b[None])
            of_pose, D = out[0], world_from_body(out[0, 2]).T @ D[0] @ T
            C, spread = D @ J @ D.T, np.sqrt(np.diag(J)[3:])
        found: list[float] = np.concatenate([of_pose, C.ravel(), b, e.of_variables(spread)]).tolist()
        return found

    def _knot_of(self, frame: int) -> int:
        """Knot of the increment into a frame of the graph (0 of frame 0)."""
        return self._knots[max(frame - 1 - self._oldest, 0)] if self._knots else self._knot

    def forget(self, oldest: int) -> list[int]:
        """Make frame `oldest` the first one in the graph; returns the knots of the drift that leave it."""
        first = self._first_knot
        self._log.clear()
        del self._knots[: oldest - self._oldest]
        self._oldest = oldest
        self._first_knot = self._knots[0] if self._knots else self._knot
        return [drift_key(k) for k in range(first, self._first_knot)]

    def history(self, left: Array) -> Systematics | None:
        """Systematic errors by frame (N, 2, p): the last constants, the drift as it was when a frame left."""
        e, found = self._errors, left.copy()
        found[:, :, e.constant] = found[-1:, :, e.constant]
        return Systematics(e.names, found[:, 0], found[:, 1]) if e.names else None

    @property
    def motion(self) -> Motion:
        """The motion of the whole run."""
        return self._errors.along(Increments(*(np.array(rows) for rows in zip(*self._log, strict=True))))

    def start(self, values: gtsam.Values, problem: Problem) -> gtsam.Values:
        """The present estimate with known landmarks exactly at their positions under the errors."""
        if self.frame.range_at >= 0 and problem.known_map:
            b = problem.motion.errors(values)[0]
            for s in problem.observations:
                if s.key is not None and s.xy is not None:
                    values.update(s.key, self.frame.points_in(s.xy[None], b)[0][0])
        return values
