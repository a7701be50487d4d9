"""The common part of localizer and SLAM filter: state buffers, prediction, and the expectation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from association.expectation import Expectation, gate_threshold
from data.inputs import FrameObservations, Increment, IntArray, Prior, Systematic, not_estimable
from data.motion.systematic import SensorFrame, sensor_frame
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated, not_used
from data.result import PoseEstimate, Updated
from data.se2 import Array, wrap_angle
from data.sensors import Sensor
from ekf import kernels, pose_updates, systematic, updates
from ekf.pose_updates import Clones, MeasurementModel
from ekf.systematic import WallFrame


class FilterDivergedError(Exception):
    """The state is not finite, or a covariance is not positive semidefinite."""


@dataclass(frozen=True)
class FilterOptions:
    """Variants of the update; reports use the defaults unless they say otherwise."""

    invariant: bool = False  # the correction moves pose and landmarks together (right-invariant EKF)
    iterations: int = 1  # largest number of linearizations of an update (1: the plain EKF)
    first_estimates: bool = False  # Jacobians at predicted poses and landmarks as initialized (FEJ-EKF)
    new_variance: float | None = None  # m^2, of a new landmark, without correlation; None: exact augmentation
    new_variance_per_square: float | None = None  # share of its squared distance; step by step only

    def __post_init__(self) -> None:
        if self.first_estimates and (self.iterations > 1 or self.invariant):
            why = "which linearize elsewhere"
            raise ValueError(f"first estimates exclude iterations and the invariant correction, {why}")

    def rule(self, errors: int = 0) -> tuple[int, int]:
        """Retraction and iterations for the kernels, for a state with this many systematic errors."""
        return updates.INVARIANT + errors if self.invariant else updates.ADDITIVE, self.iterations

    def augment_variance(self, distance: float) -> float:
        """Variance of a new landmark at a distance [m]; negative for the exact augmentation."""
        if self.new_variance_per_square is not None:
            return self.new_variance_per_square * distance**2
        return -1.0 if self.new_variance is None else self.new_variance


DEFAULT = FilterOptions()  # one stacked update per frame, exact augmentation


def frame_of(
    systematic: Systematic | None, sensor: Sensor, prior: Prior, options: FilterOptions, *, slam: bool
) -> SensorFrame:
    """The frame of a filter's state. Raises ValueError for options that walls exclude (see `lack`)."""
    if not sensor.sees_points:
        if why := lack(options, sensor, systematic, slam=slam):
            raise ValueError(why)
        if slam:
            return WallFrame(np.zeros(3), np.array(prior.mean[:2]), -1, -1)
    return sensor_frame(systematic, sensor, prior)


def lack(options: FilterOptions, sensor: Sensor, systematic: Systematic | None, *, slam: bool) -> str | None:
    """Why a filter with these options and errors cannot use walls, in a sentence; None if it can."""
    if slam and options.invariant:
        return "the invariant correction moves landmarks as points; walls need another filter"
    if slam and (options.new_variance is not None or options.new_variance_per_square is not None):
        return "a new wall has a distance and a direction, which have no variance in common"
    return not_estimable(systematic, None, sensor)


class Filter:
    """State mean and covariance in growing buffers; see `ekf.kernels` for the layout.

    The state is the leading `size` entries. The `_carried` entries behind it are updated along with it: they are parked
    landmarks (see `ekf.parking`), or poses of earlier frames (see `ekf.pose_updates`).

    Systematic errors are states behind the pose. With errors of the sensor, state and expectations are in the sensor's
    frame; in SLAM with walls, about the first pose (`WallFrame`). Poses and maps go in and out in the world frame.
    """

    smooths = False  # a filter does not revise its past

    def __init__(
        self, prior: Prior, sensor: Sensor, options: FilterOptions, errors: Systematic | None, landmarks: int = 0
    ) -> None:
        """Start at the prior with room for `landmarks` of SLAM; 0 in a known map."""
        self._frame, self._systematic = frame_of(errors, sensor, prior, options, slam=landmarks > 0), errors
        self._errors = systematic.as_states(errors, self._frame)
        self.sensor, self.options = self._frame.sensor(sensor), options
        self._kind, self._extrinsic = self.sensor.kind, self.sensor.extrinsic
        self.base = self.size = 3 + len(self._errors.place)  # offset of the landmarks; length without parked ones
        self._rule = options.rule(len(self._errors.place))
        capacity, start = self.base + 2 * landmarks, slice(0, self.base)
        self._mean, self._P = np.zeros(capacity), np.zeros((capacity, capacity))
        self._mean[start], self._P[start, start] = systematic.begin(prior, errors, self._frame)
        self._first = self._mean.copy() if options.first_estimates else kernels.NEWEST
        self._carried = 0
        self._clones = Clones()
        self._version = 0

    @property
    def _used(self) -> int:
        return self.size + self._carried

    def _grow(self, extra: int) -> None:
        """Room for `extra` more landmarks; the capacity at least doubles."""
        need, old = self._used + 2 * extra, len(self._mean)
        if need > old:
            capacity = max(need, 2 * old)
            mean, P = np.zeros(capacity), np.zeros((capacity, capacity))
            mean[:old], P[:old, :old] = self._mean, self._P
            self._mean, self._P = mean, P
            if len(self._first):
                self._first = np.concatenate([self._first, np.zeros(capacity - old)])

    def _before_carried(self, d: int, e: int, end: int) -> None:
        """Move new landmarks at the offsets from e to end in front of the carried states, which begin at d."""
        order = np.concatenate([np.arange(e, end), np.arange(d, e)])
        self._mean[d:end] = self._mean[order]
        self._P[:end, d:end] = self._P[:end, order]
        self._P[d:end, :end] = self._P[order, :end]
        if len(self._first):
            self._first[d:end] = self._first[order]

    def look(self, sensor: Sensor) -> None:
        """Expect and use observations of this sensor from now on. ValueError beside errors of the sensor."""
        if self._systematic is not None and {"range", "bearing"} & set(self._systematic.names):
            raise ValueError("systematic errors of range or bearing belong to one sensor; this log has several")
        self.sensor = self._frame.sensor(sensor)
        self._kind, self._extrinsic = self.sensor.kind, self.sensor.extrinsic

    def predict(self, increment: Increment) -> None:
        """Predict with an increment; the pose before it stays in the state if a later closure names its frame."""
        self._version += 1
        self._end_frame()
        # copies: read-only arrays would compile the kernels once more
        motion, M = np.array(increment.mean), np.array(increment.covariance)
        state = self._mean, self._P, self._used, motion, M, self._first
        if self._systematic is None:
            kernels.predict(*state)
        else:
            systematic.predict_with_errors(*state, self._errors)

    def _end_frame(self) -> None:
        """Poses leave the state after their last use; that of the present frame enters it if it is to be kept."""
        clones = self._clones
        for frame in clones.over():
            place = clones.frames.index(frame)
            pose_updates.replace_pose(self._mean, self._P, self._used, self.size + 3 * place, self._first)
            clones.frames[place] = clones.frames[-1]
            clones.frames.pop()
            self._carried -= 3
        if clones.wanted:
            self._grow(2)
            pose_updates.append_pose(self._mean, self._P, self._used, self._first)
            clones.frames.append(clones.now)
            self._carried += 3
        clones.now += 1

    def keep(self, last_use: dict[int, int]) -> None:
        """Before the first frame: the frames that later closures name, each with the frame of its last use."""
        self._clones.keep(last_use)

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """Update with absolute measurements of the pose, one after another; those outside the gate are not used."""
        return self._absorb(pose_updates.of_fixes(self._frame, fixes, sources), gate)

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """Update with relative poses in turn, but those outside the gate or of a frame that is not in the state."""
        return self._absorb(pose_updates.of_closures(self._frame, closures, self._clones.now), gate)

    def _absorb(self, measured: Sequence[MeasurementModel], gate: float | None) -> PoseUpdated:
        """Update with measurements of the pose, one after another."""
        done = not_used([len(m.rows) for m in measured])
        for i, m in enumerate(measured):
            at = self._clones.at(m, self.base, self.size)
            if at is None:
                continue
            self._version += 1
            linearized = None
            if len(self._first):
                linearized = self._mean[at]
                poses = (at < 3) | (at >= self.base)  # errors have no first estimates
                linearized[poses] = self._first[at[poses]]
            gated, state = gate_threshold(gate, len(m.rows)), (self._mean, self._P, self._used)
            rule = updates.UpdateRule(gated, *self._rule, self._first, self.size, self.size + self.kept)
            status, _ = pose_updates.absorb(*state, at, m, rule, done, i, linearized)
            if status != kernels.OK:
                raise FilterDivergedError(kernels.FAILURES[status])
        return done

    @property
    def kept(self) -> int:
        """Number of states that are poses of earlier frames."""
        return 3 * len(self._clones.frames)

    def inflate(self, covariance: Array) -> None:
        """Add covariance (3, 3), world frame, to the pose's after an unreliable motion."""
        self._version += 1
        if not self._frame.same:
            inside = self._inside()
            covariance = inside @ covariance @ inside.T
        self._P[:3, :3] += covariance

    def _inside(self) -> Array:
        """Jacobian (3, 3) of the pose in the state with respect to the pose in the world."""
        _, J = self._frame.poses_out(self._mean[None, :3], self._mean[None, 3 : self.base])
        return np.asarray(np.linalg.inv(J[0, :, :3]), np.float64)

    def estimate(self) -> PoseEstimate:
        """The newest pose with its world-frame covariance (copies)."""
        if self._frame.same:
            return PoseEstimate(self._mean[:3].copy(), self._P[:3, :3].copy())
        b = slice(0, self.base)
        pose, covariance = systematic.poses(self._mean[None, b], self._P[None, b, b], self._frame)
        return PoseEstimate(pose[0], covariance[0])

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """Systematic errors (p,) and their covariance (p, p) (copies), or None."""
        b = slice(3, self.base)
        return None if self._systematic is None else (self._mean[b].copy(), self._P[b, b].copy())

    @property
    def mean(self) -> Array:
        """The whole state vector (d,), a copy: pose, systematic errors, landmarks."""
        return self._mean[: self.size].copy()

    @property
    def covariance(self) -> Array:
        """The whole covariance (d, d), a copy."""
        return self._P[: self.size, : self.size].copy()

    def _state_at(self, pose: Array) -> Array:
        """A copy of the state with this pose (3,), its heading within half a turn of the mean's."""
        state = self._mean[: self._used].copy()
        if not self._frame.same:
            pose = self._frame.poses_in(pose[None], state[None, 3 : self.base])[0]
        state[:2], state[2] = pose[:2], state[2] + wrap_angle(float(pose[2]) - float(state[2]))
        return state

    def _expect(
        self, observations: FrameObservations, number: IntArray, at: IntArray, known: Array, pose: Array | None = None
    ) -> Expectation:
        """Expectation of candidates at state offsets `at`, or in `known` where negative, about the mean or `pose`."""
        n, m = len(number), len(observations.z)
        z_hat, blocks = np.empty((n, 2)), np.empty((n, 2, 2))
        version, state = self._version, self._mean if pose is None else self._state_at(pose)
        mean, P, first, place = self._substate(state, at, known)
        kernels.expect(self._kind, self._extrinsic, mean, P, place, known, z_hat, blocks, first)
        if pose is not None:
            xy = np.where(at[:, None] >= 0, state[np.maximum(at, 0)[:, None] + np.arange(2)], self._in_frame(known))
            z_hat += self.sensor.jacobians(state[:3], xy)[0] @ (self._mean[:3] - state[:3])

        def check() -> None:
            if version != self._version:
                raise RuntimeError("the filter was updated since this expectation was formed; form a new one")

        def joint(indices: IntArray) -> Array:
            check()
            chosen = np.asarray(indices, np.int64)
            there, k = known[chosen], len(chosen)
            mean, P, first, place = self._substate(state, at[chosen], there)
            seen = kernels.Pairings(place, there, z_hat[chosen], np.zeros((k, 2, 2)))
            found = kernels.Innovation(np.empty(2 * k), np.empty((len(mean), 2 * k)), np.empty((2 * k, 2 * k)))
            kernels.innovate(self._kind, self._extrinsic, mean, mean, P, len(mean), seen, 0, found, first)
            return found.S

        def elsewhere(pose: Array) -> Expectation:
            check()
            return self._expect(observations, number, at, known, pose)

        frames = np.zeros(n, np.int64), np.zeros(m, np.int64)
        return Expectation(
            number, z_hat, blocks, frames[0], observations.z, observations.R, frames[1], self.sensor.residual, joint,
            None if len(self._first) else elsewhere, len(self.sensor.measures),
        )  # fmt: skip

    def _in_frame(self, known: Array) -> Array:
        """Known landmarks (n, 2) in the frame of the state."""
        return known

    def _substate(self, state: Array, at: IntArray, known: Array) -> tuple[Array, Array, Array, IntArray]:
        """Mean, covariance and first estimates with the candidates at offsets `at` (k,), and their offsets there."""
        return state[: self._used], self._P, self._first, at

    def _updated(
        self, observations: FrameObservations, decisions: IntArray, at: IntArray, known: Array, threshold: float,
        pose: Array | None,
    ) -> Updated:  # fmt: skip
        """Update with paired observations, linearized at the mean, at `pose` (3,) or at first estimates."""
        self._version += 1
        m = len(decisions)
        start = self._mean if pose is None or len(self._first) else self._state_at(pose)
        used, white, created, stats = np.empty(m, np.bool_), np.empty((m, 2)), np.empty(m, np.int64), np.empty(3)
        status = updates.of_frame(
            self._kind, self._extrinsic, start, self._mean, self._P, self._used,
            at, known, np.array(observations.z), np.array(observations.R), decisions,
            threshold, *self._rule, self._first, self.size, self.size + self.kept,
            used, white, created, stats,
        )  # fmt: skip
        if status != kernels.OK:
            raise FilterDivergedError(kernels.FAILURES[status])
        nis, log_likelihood, dof = stats.tolist()
        measures = self.sensor.measures
        if len(measures) < 2:  # numbers that are not measured are in no statistics (`data.sensors`)
            absent = [q for q in range(2) if q not in measures]
            count = int(used.sum()) * len(absent)
            log_likelihood += 0.5 * count * math.log(2.0 * math.pi)
            dof -= count
            white[:, absent] = np.nan
        return Updated(used, created, nis, int(dof), log_likelihood, white)
