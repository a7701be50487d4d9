"""The Kalman filter of the exactness checks: dense and plain, with the mistakes that people make as its options.

In a linear Gaussian world it is exact. A mistake that gives the numbers of an estimator under test names its bug.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from data.blocks import block_diagonal, diagonal_blocks
from data.inputs import Frame, FrameObservations, Inputs, IntArray
from data.result import NEW
from data.se2 import Array, compose, world_from_body, wrap_angle

Bug = StrEnum(
    "Bug",
    "PRIOR_IGNORED Q_NONE Q_DOUBLED Q_HALVED Q_ROOT Q_SQUARED Q_DIAGONAL Q_NOT_TURNED Q_TURNED_LATE MOTION_NOT_TURNED "
    "MOTION_JACOBIAN_NONE MOTION_JACOBIAN_SIGN CROSS_NOT_PREDICTED R_NONE R_DOUBLED R_HALVED R_ROOT R_SQUARED "
    "R_DIAGONAL R_OF_THE_FIRST JACOBIAN_STALE JACOBIAN_NO_HEADING JACOBIAN_SIGN_OF_HEADING JACOBIAN_NO_LANDMARK "
    "INNOVATION_NOT_WRAPPED OBSERVATIONS_UNCORRELATED COVARIANCE_NOT_UPDATED MEAN_NOT_UPDATED MEAN_OF_MAP_NOT_UPDATED "
    "CROSS_NOT_UPDATED JOSEPH_WITHOUT_NOISE NEW_WITHOUT_CROSS NEW_HALF_CROSS NEW_CROSS_TO_POSE_ONLY NEW_WITHOUT_NOISE "
    "NEW_WITHOUT_POSE NEW_NOISE_NOT_TURNED NEW_NO_HEADING NEW_FROM_PREDICTION FIRST_DROPPED LAST_DROPPED "
    "EVERY_SECOND_DROPPED ALL_DROPPED DISCARDED_USED POSE_IN_BODY_FRAME JOINT_UNCORRELATED JOINT_PERMUTED "
    "EXPECTED_WITH_NOISE EXPECTED_WITHOUT_LANDMARK EXPECTED_BEFORE_MOTION NIS_IS_DOF NIS_OF_RESIDUALS "
    "NIS_WITHOUT_STATE NIS_WITHOUT_NOISE NIS_UNCORRELATED",
)
"""Mistakes in a Kalman filter; `templates/checks.j2` has the words."""

Change = Callable[[Array], Array]


def same(a: Array) -> Array:
    """No change."""
    return a


@dataclass(frozen=True)
class Rules:
    """How the filter works; the defaults are right. Matrices are changed by functions, parts by their name."""

    prior: Change = same
    Q: Change = same
    R: Change = same  # (m, 2, 2) in the update
    R_new: Change = same  # (2, 2) of a new landmark
    F: Change = same  # (3, 3) pose Jacobian of the motion
    Hx: Change = same  # (m, 2, 3)
    Hl: Change = same  # (m, 2, 2)
    Gx: Change = same  # (2, 3) of a new landmark
    Gz: Change = same  # (2, 2)
    S: Change = same  # (2k, 2k)
    used: Callable[[IntArray], IntArray] = field(default=lambda rows: rows)
    joint: Change = same  # as the association method gets it
    joseph: bool = False  # the covariance's update for any gain, instead of the one for the optimal gain
    mistake: Bug | None = None  # other mistakes, by name


def blocks_alone(A: Array) -> Array:
    """Only the 2 x 2 blocks on the diagonal of (2k, 2k)."""
    return np.asarray(A * np.kron(np.eye(len(A) // 2), np.ones((2, 2))))


def permuted(A: Array) -> Array:
    """Rows and columns of (2k, 2k), by candidates, rotated by one; the blocks on the diagonal as they were."""
    k = len(A) // 2
    order = np.roll(np.arange(2 * k).reshape(k, 2), 1, axis=0).ravel()
    moved = np.array(A[np.ix_(order, order)])
    inside = np.kron(np.eye(k), np.ones((2, 2))) > 0.0
    moved[inside] = A[inside]
    return moved


def root(A: Array) -> Array:
    """Standard deviations where variances belong."""
    return np.asarray(np.sign(A) * np.sqrt(np.abs(A)))


def diagonal(A: Array) -> Array:
    """The diagonal of a matrix, or of each of (n, d, d)."""
    return np.asarray(A * np.eye(A.shape[-1]))


def scaled(*factors: float) -> Change:
    """Multiplication of all columns, or of each by its factor."""
    return lambda A: np.array(factors) * A


Changes = tuple[dict[str, Any], ...]  # of the fields of `Rules`, for each way in which a filter may have a bug


def _of_noise(change: Change) -> Changes:
    """A change of R everywhere, or in the update alone, not where landmarks are initialized."""
    return {"R": change, "R_new": change}, {"R": change}


CHANGES: dict[Bug, Changes] = {
    Bug.PRIOR_IGNORED: ({"prior": scaled(0.0)},),
    Bug.Q_NONE: ({"Q": scaled(0.0)},),
    Bug.Q_DOUBLED: ({"Q": scaled(2.0)},),
    Bug.Q_HALVED: ({"Q": scaled(0.5)},),
    Bug.Q_ROOT: ({"Q": root},),
    Bug.Q_SQUARED: ({"Q": np.square},),
    Bug.Q_DIAGONAL: ({"Q": diagonal},),
    Bug.MOTION_JACOBIAN_NONE: ({"F": lambda F: np.eye(3)},),
    Bug.MOTION_JACOBIAN_SIGN: ({"F": lambda F: 2.0 * np.eye(3) - F},),
    Bug.R_NONE: _of_noise(scaled(0.0)),
    Bug.R_DOUBLED: _of_noise(scaled(2.0)),
    Bug.R_HALVED: _of_noise(scaled(0.5)),
    Bug.R_ROOT: (*_of_noise(root), *_of_noise(lambda R: root(diagonal(R)))),
    Bug.R_SQUARED: _of_noise(np.square),
    Bug.R_DIAGONAL: ({"R": diagonal, "R_new": diagonal},),
    Bug.R_OF_THE_FIRST: ({"R": lambda R: np.repeat(R[:1], len(R), axis=0)},),
    Bug.JACOBIAN_NO_HEADING: ({"Hx": scaled(1.0, 1.0, 0.0)},),
    Bug.JACOBIAN_SIGN_OF_HEADING: ({"Hx": scaled(1.0, 1.0, -1.0)},),
    Bug.JACOBIAN_NO_LANDMARK: ({"Hl": scaled(0.0)},),
    Bug.OBSERVATIONS_UNCORRELATED: ({"S": blocks_alone}, {"S": blocks_alone, "joseph": True}),
    Bug.NEW_WITHOUT_NOISE: ({"R_new": scaled(0.0)},),
    Bug.NEW_WITHOUT_POSE: ({"Gx": scaled(0.0)},),
    Bug.NEW_NO_HEADING: ({"Gx": scaled(1.0, 1.0, 0.0)},),
    Bug.NEW_NOISE_NOT_TURNED: ({"Gz": lambda Gz: np.eye(2)},),
    Bug.FIRST_DROPPED: ({"used": lambda rows: rows[1:]},),
    Bug.LAST_DROPPED: ({"used": lambda rows: rows[:-1]},),
    Bug.EVERY_SECOND_DROPPED: ({"used": lambda rows: rows[::2]},),
    Bug.ALL_DROPPED: ({"used": lambda rows: rows[:0]},),
    Bug.JOINT_UNCORRELATED: ({"joint": blocks_alone},),
    Bug.JOINT_PERMUTED: ({"joint": permuted},),
}


def rules_of(bug: Bug) -> list[Rules]:
    """Ways in which a filter may have a bug."""
    return [Rules(mistake=bug, **changes) for changes in CHANGES.get(bug, ({},))]


@dataclass(frozen=True, eq=False)
class Expected:
    """Candidates (n,) of observations (m,), as an association method gets them.

    Attributes:
        number: (n,) landmark numbers.
        z_hat: (n, 2); joint: (2n, 2n), covariance of all of them, without noise; blocks: (n, 2, 2), of each.
        innovations: (m, n, 2), wrapped; R: (m, 2, 2), noise of the observations.
        decided: (m,) by JCBB; None: not formed.
    """

    number: IntArray
    z_hat: Array
    joint: Array
    blocks: Array
    innovations: Array
    R: Array
    decided: IntArray | None = None


@dataclass(frozen=True, eq=False)
class State:
    """What an estimator says about a frame.

    Attributes:
        expected: before the update; None: no observations, or it does not say.
        decisions: (m,) handed to the update.
        used: rows (k,) of the observations that it claims to have used.
        nis: as it states it; NaN: it does not.
        pose: (3,); covariance: (3, 3) of it, NaN: none.
        number, xy, blocks: landmarks (L,), (L, 2), (L, 2, 2); empty in localization.
    """

    expected: Expected | None
    decisions: IntArray
    used: IntArray
    nis: float
    pose: Array
    covariance: Array
    number: IntArray
    xy: Array
    blocks: Array


NONE = np.empty(0, np.int64)


class Kalman:
    """An EKF for localization (a map in the inputs) or SLAM: state and covariance, dense."""

    def __init__(self, inputs: Inputs, rules: Rules) -> None:
        self.sensor, self.map, self.rules = inputs.sensor, inputs.map, rules
        self.x, self.P = np.array(inputs.prior.mean), rules.prior(np.array(inputs.prior.covariance))
        self.before = self.x[:3].copy()

    def predict(self, mean: Array, covariance: Array) -> None:
        """Move by an increment (3,) with covariance (3, 3)."""
        r, d = self.rules, len(self.x)
        self.before = self.x[:3].copy()
        moved = compose(self.x[:3], mean)
        if r.mistake is Bug.MOTION_NOT_TURNED:
            moved = self.x[:3] + mean
        F = np.eye(d)
        F[:3, :3] = r.F(_motion_jacobian(float(self.x[2]), mean))
        turned = {Bug.Q_NOT_TURNED: 0.0, Bug.Q_TURNED_LATE: float(moved[2])}
        G = world_from_body(turned.get(r.mistake, float(self.x[2])) if r.mistake else float(self.x[2]))
        P = F @ self.P @ F.T
        if r.mistake is Bug.CROSS_NOT_PREDICTED:
            P[:3, 3:], P[3:, :3] = self.P[:3, 3:], self.P[3:, :3]
        P[:3, :3] += G @ r.Q(covariance) @ G.T
        self.x[:3], self.P = moved, P
        self.x[2] = wrap_angle(float(self.x[2]))

    def _linearized(self, number: IntArray, pose: Array) -> tuple[Array, Array]:
        """z_hat (n, 2) and H (2n, d) of landmarks (n,), seen from a pose (3,)."""
        r, n, d = self.rules, len(number), len(self.x)
        xy = self.x[3:].reshape(-1, 2)[number] if self.map is None else self.map.positions(number)
        z_hat, Hx, Hl = self.sensor.linearize(pose, xy)
        if r.mistake is Bug.JACOBIAN_STALE:
            Hx, Hl = self.sensor.jacobians(self.before, xy)
        H = np.zeros((n, 2, d))
        H[:, :, :3] = r.Hx(Hx)
        if self.map is None:
            for i, j in enumerate(number.tolist()):
                H[i, :, 3 + 2 * j : 5 + 2 * j] = r.Hl(Hl)[i]
        return z_hat, H.reshape(2 * n, d)

    def expect(self, observations: FrameObservations) -> Expected:
        """Of every landmark."""
        r = self.rules
        number = np.arange((len(self.x) - 3) // 2) if self.map is None else self.map.id
        z_hat, H = self._linearized(number, self.before if r.mistake is Bug.EXPECTED_BEFORE_MOTION else self.x[:3])
        if r.mistake is Bug.EXPECTED_WITHOUT_LANDMARK:
            H[:, 3:] = 0.0
        joint = r.joint(H @ self.P @ H.T)
        if r.mistake is Bug.EXPECTED_WITH_NOISE:
            joint = joint + np.kron(np.eye(len(number)), observations.R[0])
        innovations = np.asarray(self.sensor.residual(observations.z[:, None], z_hat[None]))
        return Expected(number, z_hat, joint, diagonal_blocks(joint), innovations, observations.R)

    def update(self, observations: FrameObservations, decisions: IntArray) -> tuple[IntArray, float]:
        """One update with all pairings, then new landmarks; the rows used, and the NIS."""
        r, predicted = self.rules, self.x[:3].copy()
        rows = np.flatnonzero(decisions >= 0)
        chosen, nis = r.used(rows), 0.0
        numbers = decisions[chosen]
        if r.mistake is Bug.DISCARDED_USED:
            held = NONE if self.map is None else self.map.id
            extra = np.flatnonzero(decisions < NEW) if len(self.x) > 3 or len(held) else NONE
            chosen = np.concatenate([chosen, extra])
            first = held[0] if len(held) else 0
            numbers = np.concatenate([numbers, np.full(len(extra), first, np.int64)])
        if len(chosen):
            nis = self._correct(observations.z[chosen], observations.R[chosen], numbers)
        if self.map is None:
            for i in np.flatnonzero(decisions == NEW).tolist():
                self._found(observations.z[i], observations.R[i], predicted)
        return rows, nis

    def _correct(self, z: Array, R: Array, number: IntArray) -> float:
        r, k = self.rules, len(number)
        z_hat, H = self._linearized(number, self.x[:3])
        nu = np.asarray(self.sensor.residual(z, z_hat))
        if r.mistake is Bug.INNOVATION_NOT_WRAPPED:
            nu = z - z_hat
        HPH, noise, stated = H @ self.P @ H.T, block_diagonal(r.R(R)), block_diagonal(R)
        S = r.S(HPH + noise)
        K = (np.linalg.pinv(S) @ H @ self.P).T
        shift = K @ nu.ravel()
        if r.mistake is Bug.MEAN_NOT_UPDATED:
            shift = 0.0 * shift
        if r.mistake is Bug.MEAN_OF_MAP_NOT_UPDATED:
            shift[3:] = 0.0
        self.x = self.x + shift
        self.x[2] = wrap_angle(float(self.x[2]))
        P, W = self.P, K @ H
        A = np.eye(len(P)) - W
        if r.mistake is Bug.JOSEPH_WITHOUT_NOISE:
            P = A @ P @ A.T
        elif r.joseph:
            P = A @ P @ A.T + K @ noise @ K.T
        elif r.mistake is not Bug.COVARIANCE_NOT_UPDATED:
            P = A @ P
        if r.mistake is Bug.CROSS_NOT_UPDATED:
            P[:3, 3:], P[3:, :3] = self.P[:3, 3:], self.P[3:, :3]
        self.P = 0.5 * (P + P.T)
        weights = {Bug.NIS_WITHOUT_STATE: stated, Bug.NIS_WITHOUT_NOISE: HPH, Bug.NIS_UNCORRELATED: blocks_alone(S)}
        if r.mistake is Bug.NIS_IS_DOF:
            return 2.0 * k
        if r.mistake is Bug.NIS_OF_RESIDUALS:
            nu = np.asarray(self.sensor.residual(z, self._linearized(number, self.x[:3])[0]))
        weight = weights.get(r.mistake, S) if r.mistake else S
        return float(nu.ravel() @ np.linalg.pinv(weight) @ nu.ravel())

    def _found(self, z: Array, R: Array, predicted: Array) -> None:
        r, d = self.rules, len(self.x)
        start = predicted if r.mistake is Bug.NEW_FROM_PREDICTION else self.x[:3]
        xy, Gx, Gz = (a[0] for a in self.sensor.inverse(start, z[None]))
        J, Gz = np.zeros((2, d)), r.Gz(Gz)
        J[:, :3] = r.Gx(Gx)
        cross = J @ self.P
        own = cross @ J.T + Gz @ r.R_new(R) @ Gz.T
        parts = {Bug.NEW_WITHOUT_CROSS: 0.0, Bug.NEW_HALF_CROSS: 0.5}
        cross = cross * (parts.get(r.mistake, 1.0) if r.mistake else 1.0)
        if r.mistake is Bug.NEW_CROSS_TO_POSE_ONLY:
            cross[:, 3:] = 0.0
        self.x, self.P = np.concatenate([self.x, xy]), np.block([[self.P, cross.T], [cross, own]])

    def state(
        self, expected: Expected | None, decisions: IntArray, used: IntArray = NONE, nis: float = np.nan
    ) -> State:
        """What it says at the end of a frame."""
        P = self.P[:3, :3].copy()
        if self.rules.mistake is Bug.POSE_IN_BODY_FRAME:
            B = world_from_body(float(self.x[2]))
            P = B.T @ P @ B
        n = 0 if self.map is not None else (len(self.x) - 3) // 2
        blocks = diagonal_blocks(self.P[3:, 3:]) if n else np.empty((0, 2, 2))
        xy = self.x[3:].reshape(-1, 2).copy() if n else np.empty((0, 2))
        return State(expected, decisions, used, nis, self.x[:3].copy(), P, np.arange(n), xy, blocks)


def states_of(frames: list[tuple[Frame, IntArray]], inputs: Inputs, rules: Rules) -> list[State]:
    """What the filter with these rules says about frames, each with the decisions about its observations."""
    found, f = [], Kalman(inputs, rules)
    for frame, decisions in frames:
        if frame.increment is not None:
            f.predict(*frame.increment)
        expected, used, nis = None, NONE, np.nan
        if len(decisions):
            expected = f.expect(frame.observations)
            used, nis = f.update(frame.observations, decisions)
        found.append(f.state(expected, decisions, used, nis))
    return found


def _motion_jacobian(heading: float, mean: Array) -> Array:
    """Jacobian (3, 3) of a composed pose to the pose before, which has this heading."""
    F = np.eye(3)
    dx, dy = world_from_body(heading)[:2, :2] @ mean[:2]
    F[0, 2], F[1, 2] = -dy, dx
    return F
