"""What localizer and SLAM filter share: the state buffers, prediction, and the expectation formed from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from association.expectation import Expectation
from data.blocks import coordinates_from
from data.inputs import Increment, IntArray, Prior, Sightings
from data.result import PoseEstimate
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import Sensor
from ekf import kernels, updates


class FilterDivergedError(Exception):
    """The filter cannot go on: its state is not finite or a covariance is not positive semidefinite."""


@dataclass(frozen=True)
class FilterOptions:
    """How the update is done; the defaults are what every report uses unless it says otherwise.

    Attributes:
        each: one update per observation (linearized one after the other) instead of one stacked update per frame.
        invariant: the correction moves pose and landmarks together (right-invariant EKF); Jacobians stay as they are.
        iterations: how often an update is linearized at most, each time where the last one led (1: the plain EKF).
        first_estimates: Jacobians at the first estimates, predicted poses and landmarks as initialized (FEJ-EKF).
        new_variance: m^2; a new landmark gets this variance and no correlation (None: the exact augmentation).
        new_variance_per_square: the same as a share of its squared distance from the sensor; step by step only.
    """

    each: bool = False
    invariant: bool = False
    iterations: int = 1
    first_estimates: bool = False
    new_variance: float | None = None
    new_variance_per_square: float | None = None

    def __post_init__(self) -> None:
        if self.first_estimates and (self.iterations > 1 or self.invariant):
            raise ValueError(
                "first estimates exclude iterations and the invariant correction, which linearize elsewhere"
            )

    @property
    def rule(self) -> tuple[int, int]:
        """How the correction is found and applied, as the kernels take it."""
        return updates.INVARIANT if self.invariant else updates.ADDITIVE, self.iterations

    def augment_variance(self, distance: float) -> float:
        """Variance of a new landmark at a distance [m], as the kernels take it: negative for the exact augmentation."""
        if self.new_variance_per_square is not None:
            return self.new_variance_per_square * distance**2
        return -1.0 if self.new_variance is None else self.new_variance


DEFAULT = FilterOptions()
"""One stacked update per frame, exact augmentation."""
NO_LANDMARK = np.empty(0, np.int64)
NO_LANDMARK.setflags(write=False)


class Filter:
    """State mean and covariance in buffers that grow in place; see `ekf.kernels` for the layout.

    The state is the leading `size` entries. The `_carried` entries behind it go through every step with it but are no
    part of it (see `ekf.parking`; only a SLAM filter with parked landmarks has any).

    Attributes:
        smooths: False: a filter does not revise its past.
        size: length of the state, parked landmarks aside.
    """

    smooths = False

    def __init__(self, prior: Prior, sensor: Sensor, options: FilterOptions, capacity: int = 3) -> None:
        """Start at the prior. `capacity` is the number of states to have room for."""
        self.sensor, self.options = sensor, options
        self._kind, self._extrinsic = sensor.kind, sensor.extrinsic
        self._mean, self._P = np.zeros(capacity), np.zeros((capacity, capacity))
        self._mean[:3], self._P[:3, :3] = prior.mean, prior.covariance
        self._first = self._mean.copy() if options.first_estimates else kernels.NEWEST
        self.size, self._carried = 3, 0
        self._version = 0

    @property
    def _used(self) -> int:
        """How much of the buffers is in use."""
        return self.size + self._carried

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        self._version += 1
        kernels.predict(self._mean, self._P, self._used, increment.mean, increment.covariance, self._first)

    def stamp(self, time: float) -> None:
        """The present frame's time, which a filter need not know."""

    @property
    def fixed_linearization(self) -> bool:
        """Whether it linearizes at its first estimates and nowhere else: then `update` takes no `at`."""
        return self.options.first_estimates

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of the parked landmarks, ascending: none in a known map."""
        return NO_LANDMARK

    def parked_xy(self) -> Array:
        """Present means (b, 2) of the parked landmarks, ordered as `parked`."""
        return np.empty((0, 2))

    def park(self, numbers: IntArray) -> None:
        """A known map is no part of the state: asking for it is an error."""
        raise ValueError("a localizer's map is given; none of its landmarks can be parked")

    def restore(self, numbers: IntArray) -> None:
        """None is parked: asking for it is an error."""
        raise ValueError(f"cannot restore {np.asarray(numbers).tolist()}: a localizer's landmarks are never parked")

    def amend(self, frames: IntArray, sightings: Sightings, decisions: IntArray) -> None:
        """What frames (m,) up to now saw was for other landmarks: too late, a filter does not revise its past."""

    def inflate(self, covariance: Array) -> None:
        """The last motion is not to be believed: so much covariance (3, 3), world frame, is added to the pose's."""
        self._version += 1
        self._P[:3, :3] += covariance

    def estimate(self) -> PoseEstimate:
        """The newest pose with its world-frame covariance (copies)."""
        return PoseEstimate(self._mean[:3].copy(), self._P[:3, :3].copy())

    @property
    def mean(self) -> Array:
        """The whole state vector (d,), a copy."""
        return self._mean[: self.size].copy()

    @property
    def covariance(self) -> Array:
        """The whole covariance (d, d), a copy."""
        return self._P[: self.size, : self.size].copy()

    def _state_at(self, pose: Array) -> Array:
        """A copy of the state with this pose (3,), its heading not wrapped: differences to the mean are as they are.

        Raises ValueError for a filter with first estimates, which are where it linearizes.
        """
        if len(self._first):
            raise ValueError("a filter with first estimates linearizes nowhere else")
        state = self._mean[: self._used].copy()
        state[:2], state[2] = pose[:2], state[2] + wrap_angle(float(pose[2]) - float(state[2]))
        return state

    def _expect(
        self, sightings: Sightings, number: IntArray, at: IntArray, known: Array, pose: Array | None = None
    ) -> Expectation:
        """Expectation over candidates that stand at offsets `at` of the state, or in `known` where `at` is negative.

        It is linearized at the mean, or at another `pose` (3,).
        """
        n, m = len(number), len(sightings.z)
        z_hat, blocks = np.empty((n, 2)), np.empty((n, 2, 2))
        version, state = self._version, self._mean
        if pose is not None:
            state = self._state_at(pose)
        kernels.expect(self._kind, self._extrinsic, state, self._P, at, known, z_hat, blocks, self._first)
        if pose is not None:
            xy = np.where(at[:, None] >= 0, state[np.maximum(at, 0)[:, None] + np.arange(2)], known)
            z_hat += self.sensor.jacobians(state[:3], xy)[0] @ (self._mean[:3] - state[:3])

        def joint(indices: IntArray) -> Array:
            if version != self._version:
                raise RuntimeError("the filter has moved on since this expectation was formed")
            chosen = np.asarray(indices, np.int64)
            k = len(chosen)
            # only pose and chosen landmarks enter: gathered, the cost does not grow with the map
            here = at[chosen]
            held = here >= 0
            index = np.concatenate([np.arange(3), coordinates_from(here[held])])
            d = len(index)
            moved = np.full(k, -1, np.int64)
            moved[held] = np.arange(3, d, 2)
            PHt, S = np.empty((d, 2 * k)), np.empty((2 * k, 2 * k))
            zero = np.zeros((k, 2))
            mean = state[index]
            first = self._first[index] if len(self._first) else self._first
            kernels.innovate(
                self._kind, self._extrinsic, mean, mean, self._P[np.ix_(index, index)], d, moved, known[chosen],
                zero, np.zeros((k, 2, 2)), np.empty(2 * k), PHt, S, first,
            )  # fmt: skip
            return S

        def elsewhere(pose: Array) -> Expectation:
            if version != self._version:
                raise RuntimeError("the filter has moved on since this expectation was formed")
            return self._expect(sightings, number, at, known, pose)

        frames = np.zeros(n, np.int64), np.zeros(m, np.int64)
        return Expectation(
            number, z_hat, blocks, frames[0], sightings.z, sightings.R, frames[1], self.sensor.residual, joint,
            None if len(self._first) else elsewhere,
        )  # fmt: skip

    def _correct(
        self,
        sightings: Sightings,
        rows: IntArray,
        at: IntArray,
        known: Array,
        threshold: float,
        pose: Array | None = None,
    ) -> tuple[BoolArray, Array, Array]:
        """Update with the observations `rows` (k,); returns which passed the gate, (NIS, log-likelihood, dof), and each
        innovation in units of its own standard deviation (k, 2). It is first linearized at the mean, or at `pose` (3,).
        """
        self._version += 1
        keep, stats, white = np.ones(len(rows), np.bool_), np.zeros(3), np.full((len(rows), 2), np.nan)
        if len(rows):
            rest = (
                self._mean, self._P, self._used, at, known, sightings.z[rows], sightings.R[rows], threshold, keep,
                stats, white, self.options.rule, self._first,
            )  # fmt: skip
            if pose is not None:
                status = updates.update_from(self._kind, self._extrinsic, self._state_at(pose), *rest)
            else:
                step = updates.update_each if self.options.each else updates.update
                status = step(self._kind, self._extrinsic, *rest)
            if status != kernels.OK:
                raise FilterDivergedError(kernels.FAILURES[status])
        return keep, stats, white
