"""Expected measurements of a smoother's candidates, and their covariance."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from association.candidates import MARGIN, SIGMAS, Places, UncertaintyBounds, may_be_in_view
from association.expectation import Expectation
from data.blocks import coordinates, diagonal_blocks
from data.inputs import FrameObservations, Increment, IntArray, LandmarkMap
from data.se2 import Array, pose_error
from data.sensors import Sensor

REFRESH = 50  # frames between two queries of all positions: a twentieth of the time of a query in every frame
STEADY = 1.0  # m; all positions are queried after this correction of the newest pose, or half of it of a landmark
MOST_WAITING = 20_000  # steps of the bookkeeping that wait, 10 MB

UNKNOWN = 1e12  # m^2, rad^2. Stands in for the variances of a wall that were never queried


class PositionCache:
    """Landmarks of a smoother that may be near the robot, without a query of all positions in every frame.

    Landmarks within `STEADY` of the search radius, by their cached positions, are queried again. None is missed that
    has moved by less than that since, while neither the newest pose nor a landmark near it moved.
    """

    def __init__(self) -> None:
        self._number, self._xy = np.empty(0, np.int64), np.empty((0, 2))
        self._frames, self._corrected = 0, 0.0

    def corrected(self, step: Array) -> None:
        """Add a correction (2,) [m] of the newest pose."""
        self._corrected += float(np.hypot(*step))

    def around(
        self, number: IntArray, point: Array, radius: Array, positions_of: Callable[[list[int]], Array]
    ) -> tuple[IntArray, Array]:
        """A superset of the landmarks (n,) within radii (n,) [m] of a point (2,): indices (m,) and positions (m, 2)."""
        self._frames += 1
        stale = self._frames >= REFRESH or self._corrected > STEADY or not np.isfinite(radius).all()
        if not stale and not np.array_equal(number, self._number):
            old = len(self._number)
            stale = len(number) < old or not np.array_equal(number[:old], self._number)
            if not stale:
                self._number, self._xy = number, np.concatenate([self._xy, positions_of(number[old:].tolist())])
        if not stale:
            near = np.flatnonzero(np.hypot(*(self._xy - point).T) <= radius + STEADY)
            xy = positions_of(number[near].tolist())
            stale = bool((np.abs(xy - self._xy[near]) > 0.5 * STEADY).any())
            self._xy[near] = xy
        if stale:
            self._number, self._xy = number, positions_of(number.tolist())
            self._frames, self._corrected = 0, 0.0
            near = np.flatnonzero(np.hypot(*(self._xy - point).T) <= radius)
            xy = self._xy[near].copy()
        return near, xy


class Candidates:
    """Landmarks that may be in view, without a joint covariance of all. A known map of walls is small: all of it."""

    def __init__(self, sensor: Sensor, known: LandmarkMap | None) -> None:
        self.sensor, self.map = sensor, known
        self._drift, self._near = UncertaintyBounds(), PositionCache()
        self._places = Places(np.empty((0, 2)) if known is None else known.xy)
        self._waiting = list[Callable[[], None]]()
        self._walls = np.empty((0, 2, 2))
        """By number, last known covariance of walls, an upper bound of the present one."""

    def move(self, increment: Increment) -> None:
        """Add the uncertainty of an increment."""
        self._later(partial(self._drift.move, increment))

    def _later(self, step: Callable[[], None]) -> None:
        """Do this before the next question: with labels there is none."""
        self._waiting.append(step)
        if len(self._waiting) >= MOST_WAITING:
            self._catch_up()

    def _catch_up(self) -> None:
        for step in self._waiting:
            step()
        self._waiting.clear()

    def corrected(self, step: Array) -> None:
        """Add a correction (2,) [m] of the newest pose."""
        self._later(partial(self._near.corrected, step))

    def see(self, observations: FrameObservations, number: IntArray, P: Array) -> None:
        """Landmarks (m,) of SLAM were observed from a pose of covariance P (3, 3)."""
        if self.sensor.sees_points and self.sensor.locates:
            self._later(partial(self._drift.see, self.sensor, observations, number, P.copy()))

    def know(self, number: IntArray, J: Array) -> None:
        """Joint covariance J, world frame, of some variables and, last, landmarks (n,) of SLAM."""
        self._catch_up()
        if self.sensor.sees_points:
            self._drift.know(number, np.sqrt(np.diag(J)[-2 * len(number) :].reshape(-1, 2).sum(1)))
        elif len(number):
            self._room(number)
            self._walls[number] = diagonal_blocks(J[-2 * len(number) :, -2 * len(number) :])

    def _room(self, number: IntArray) -> None:
        """Room for the covariances of walls (n,)."""
        more = int(number.max(initial=-1)) + 1 - len(self._walls)
        self._walls = np.concatenate([self._walls, np.tile(UNKNOWN * np.eye(2), (max(more, 0), 1, 1))])

    def expect(self, number: IntArray, z_hat: Array, HPHt: Array) -> None:
        """Landmarks (n,) of SLAM are expected at z_hat (n, 2), with covariances (n, 2, 2)."""
        self._catch_up()
        if self.sensor.sees_points and self.sensor.locates:
            self._drift.expect(self.sensor, number, z_hat, HPHt)

    def known(self, point: Array, radius: float) -> tuple[IntArray, Array]:
        """Ids (n,) and positions (n, 2) of known landmarks at most a radius [m] from a point (2,)."""
        assert self.map is not None
        rows = self._places.around(point, radius)
        return self.map.id[rows], self.map.xy[rows]

    def of_slam(
        self, number: IntArray, pose: Array, P: Array, positions_of: Callable[[list[int]], Array]
    ) -> tuple[IntArray, Array]:
        """Landmarks among (n,) near a pose (3,) of covariance P, and their positions (m, 2)."""
        self._catch_up()
        if not self.sensor.sees_points:
            lines = positions_of(number.tolist())
            self._room(number)
            z_hat, Hx, Hl = self.sensor.linearize(pose, lines)
            # bound of a sum for any correlation
            sigma = np.sqrt(np.einsum("nqi,ij,nqj->nq", Hx, P, Hx))
            sigma += np.sqrt(np.einsum("nqi,nij,nqj->nq", Hl, self._walls[number], Hl))
            angle = np.minimum(SIGMAS * sigma[:, 1] + MARGIN, np.pi)
            near = self.sensor.in_view(z_hat, margin_range=SIGMAS * sigma[:, 0], margin_angle=angle)
            return number[near], lines[near]
        sigma, heading = self._drift.sigmas(number, P)
        lever = np.hypot(*self.sensor.translation)
        radius = self.sensor.max_range + lever + SIGMAS * (sigma + lever * heading)
        around, xy = self._near.around(number, pose[:2], radius, positions_of)
        near = may_be_in_view(self.sensor, pose, xy, sigma[around], heading[around])
        return number[around][near], xy[near]


def form(
    sensor: Sensor,
    pose: Array,
    covariance: Array,
    number: IntArray,
    xy: Array,
    observations: FrameObservations,
    at: Array | None = None,
    inside: Callable[[Array], Array] | None = None,
) -> Expectation:
    """Expectation over landmarks `number` (n,) at xy (n, 2) from `pose` (3,), linearized there or `at` (3,).

    `inside` maps a robot's pose into the frame of the arguments; None: identity. `covariance`, world frame: (3 + 2n, 3
    + 2n) of pose and landmarks, or (3, 3) of the pose where they are known.
    """
    n, m = len(number), len(observations.z)
    z_hat, Hx, Hl = sensor.linearize(pose if at is None else at, xy)
    if at is not None:
        z_hat = z_hat + Hx @ pose_error(pose, at)
    known = len(covariance) == 3
    Pxx = covariance[:3, :3]
    blocks = Hx @ Pxx @ Hx.transpose(0, 2, 1)
    if not known:
        Pxl = covariance[:3, 3:].reshape(3, n, 2).transpose(1, 0, 2)
        Pll = diagonal_blocks(covariance[3:, 3:])
        cross = Hx @ Pxl @ Hl.transpose(0, 2, 1)
        blocks = blocks + cross + cross.transpose(0, 2, 1) + Hl @ Pll @ Hl.transpose(0, 2, 1)
    zeros = np.zeros(n + m, np.int64)

    def joint(indices: IntArray) -> Array:
        chosen = np.asarray(indices, np.int64)
        k = len(chosen)
        H = np.zeros((k, 2, 3 if known else 3 + 2 * k))
        H[:, :, :3] = Hx[chosen]
        of = np.arange(3)
        if not known:
            for q in range(2):
                H[np.arange(k), :, 3 + 2 * np.arange(k) + q] = Hl[chosen, :, q]
            of = np.concatenate([of, 3 + coordinates(chosen)])
        rows = H.reshape(2 * k, H.shape[2])
        S: Array = rows @ covariance[np.ix_(of, of)] @ rows.T
        return 0.5 * (S + S.T)

    def elsewhere(at: Array) -> Expectation:
        return form(sensor, pose, covariance, number, xy, observations, at if inside is None else inside(at), inside)

    return Expectation(
        number, z_hat, blocks, zeros[:n], observations.z, observations.R, zeros[:m], sensor.residual, joint, elsewhere,
        len(sensor.measures),
    )  # fmt: skip
