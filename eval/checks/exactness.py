"""An estimator against the exact Kalman filter, frame by frame: what it expects, uses, states and estimates.

In a linear Gaussian world an estimator that claims to be exact agrees within `EXACTLY`. In a mildly nonlinear one every
sound estimator agrees within `NEARLY`. The Kalman filter is dense and plain, with the mistakes that people make as its
options: a mistake that gives the numbers of an estimator under test names its bug.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache, lru_cache
from typing import Any

import numpy as np
import scipy

from association.decide import decide, known_decisions
from association.expectation import Expectation, SingularInnovationError
from data.blocks import block_diagonal, coordinates, diagonal_blocks
from data.inputs import Frame, FrameObservations, Inputs, IntArray
from data.result import DISCARD, NEW
from data.se2 import Array, between, compose, rotation, world_from_body, wrap_angle
from data.sensors import RangeBearing
from data.words import environment
from eval.checks import worlds
from eval.checks.finding import APPROXIMATE, Finding, check
from eval.replay.estimators import Able, Estimator, capabilities, make_estimator
from eval.replay.external.adapter import Adapter, ForeignError, Samples, call, load
from eval.replay.external.spec import is_foreign
from eval.replay.run import DIVERGED
from eval.replay.settings import INCREMENTAL

Bug = StrEnum(
    "Bug",
    "PRIOR_IGNORED Q_NONE Q_DOUBLED Q_HALVED Q_ROOT Q_SQUARED Q_DIAGONAL Q_NOT_TURNED Q_TURNED_LATE MOTION_NOT_TURNED "
    "MOTION_NOT_SIDEWAYS MOTION_JACOBIAN_NONE MOTION_JACOBIAN_SIGN CROSS_NOT_PREDICTED R_NONE R_DOUBLED R_HALVED "
    "R_ROOT R_SQUARED R_DIAGONAL R_OF_THE_FIRST FIRST_ALONE SECOND_ALONE JACOBIAN_STALE JACOBIAN_NO_HEADING "
    "JACOBIAN_SIGN_OF_HEADING JACOBIAN_SIGN_OF_POSITION JACOBIAN_NO_LANDMARK INNOVATION_NOT_WRAPPED "
    "OBSERVATIONS_UNCORRELATED COVARIANCE_NOT_UPDATED MEAN_NOT_UPDATED MEAN_OF_MAP_NOT_UPDATED CROSS_NOT_UPDATED "
    "JOSEPH_WITHOUT_NOISE NEW_WITHOUT_CROSS NEW_HALF_CROSS NEW_CROSS_TO_POSE_ONLY NEW_WITHOUT_NOISE NEW_WITHOUT_POSE "
    "NEW_NOISE_NOT_TURNED NEW_NO_HEADING NEW_FROM_PREDICTION NEW_FIXED NEW_FIXED_CORRECTED FIRST_DROPPED LAST_DROPPED "
    "EVERY_SECOND_DROPPED ALL_DROPPED DISCARDED_USED POSE_IN_BODY_FRAME JOINT_UNCORRELATED JOINT_PERMUTED "
    "EXPECTED_WITH_NOISE EXPECTED_WITHOUT_LANDMARK EXPECTED_BEFORE_MOTION NIS_IS_DOF NIS_OF_RESIDUALS "
    "NIS_WITHOUT_STATE NIS_WITHOUT_NOISE NIS_UNCORRELATED PRIOR_ELSEWHERE ONE_DRAW LIKELIHOODS_ADDED "
    "WEIGHTS_FORGOTTEN WEIGHTS_KEPT NOT_RESAMPLED DEPLETED ACROSS_PI OWN_GATE",
)  # mistakes in a Kalman filter; `templates/checks.j2` has the words

Change = Callable[[Array], Array]


def same(a: Array) -> Array:
    """No change."""
    return a


@dataclass(frozen=True)
class Rules:
    """How the filter works; the defaults are right. Matrices are changed by functions, parts by their name."""

    prior: Change = same
    mean: Change = same  # (3,) of an increment
    Q: Change = same
    R: Change = same  # (m, 2, 2) in the update
    R_new: Change = same  # (2, 2) of a new landmark
    F: Change = same  # (3, 3) pose Jacobian of the motion
    Hx: Change = same  # (m, 2, 3)
    Hl: Change = same  # (m, 2, 2)
    Gx: Change = same  # (2, 3) of a new landmark
    Gz: Change = same  # (2, 2)
    S: Change = same  # (2k, 2k)
    fixed: float = math.nan  # m^2, variances of a new landmark that is uncorrelated; NaN: as propagated
    used: Callable[[IntArray], IntArray] = field(default=lambda rows: rows)
    joint: Change = same  # as the association method gets it
    turned_back: bool = False  # bearings that are not wrapped are expected as atan2(y, x) - heading
    one_by_one: bool = False  # an update for each pairing, linearized after the one before; no mistake
    gate: float = math.inf  # squared distance of a pairing from which it is not used
    joseph: bool = False  # the covariance's update for any gain, instead of the one for the optimal gain
    mistakes: tuple[Bug, ...] = ()  # all by name, also those that no field above has


def blocks_alone(A: Array) -> Array:
    """Only the 2 x 2 blocks on the diagonal of (2k, 2k)."""
    return block_diagonal(diagonal_blocks(A))


def permuted(A: Array) -> Array:
    """Rows and columns of (2k, 2k), by candidates, rotated by one; the blocks on the diagonal as they were."""
    order = coordinates(np.roll(np.arange(len(A) // 2), 1))
    moved = A[np.ix_(order, order)]
    return moved - blocks_alone(moved) + blocks_alone(A)


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


UNSEEN = 1e6  # as much noise leaves a component out
FIXED: Changes = tuple({"fixed": v} for v in (1e-3, 0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 10.0, 25.0, 100.0))
CHANGES: dict[Bug, Changes] = {
    Bug.NEW_FIXED: FIXED, Bug.NEW_FIXED_CORRECTED: FIXED, Bug.PRIOR_IGNORED: ({"prior": scaled(0.0)},),
    Bug.Q_NONE: ({"Q": scaled(0.0)},), Bug.Q_DOUBLED: ({"Q": scaled(2.0)},), Bug.Q_HALVED: ({"Q": scaled(0.5)},),
    Bug.Q_ROOT: ({"Q": root}, {"Q": lambda Q: root(diagonal(Q))}), Bug.Q_DIAGONAL: ({"Q": diagonal},),
    Bug.Q_SQUARED: ({"Q": np.square}, {"Q": lambda Q: diagonal(Q) ** 2}),
    Bug.MOTION_NOT_SIDEWAYS: tuple(
        {"mean": mean, "Q": Q}
        for mean in (
            scaled(1.0, 0.0, 1.0), lambda m: np.array([np.hypot(*m[:2]), 0.0, m[2]]),
            lambda m: np.append(np.hypot(*m[:2]) * np.sinc(m[2] / math.tau) * rotation(0.5 * m[2])[:, 0], m[2]),
        )  # the last is an arc
        for Q in (same, lambda Q: Q * np.outer([1.0, 0.0, 1.0], [1.0, 0.0, 1.0]))
    ),
    Bug.MOTION_JACOBIAN_NONE: ({"F": lambda F: np.eye(3)},),
    Bug.MOTION_JACOBIAN_SIGN: ({"F": lambda F: 2.0 * np.eye(3) - F},), Bug.R_NONE: _of_noise(scaled(0.0)),
    Bug.R_DOUBLED: _of_noise(scaled(2.0)), Bug.R_HALVED: _of_noise(scaled(0.5)),
    Bug.R_ROOT: (*_of_noise(root), *_of_noise(lambda R: root(diagonal(R)))),
    Bug.R_SQUARED: (*_of_noise(np.square), *_of_noise(lambda R: diagonal(R) ** 2)),
    Bug.FIRST_ALONE: ({"R": lambda R: R + UNSEEN * R * [[0.0, 0.0], [0.0, 1.0]]},),
    Bug.SECOND_ALONE: ({"R": lambda R: R + UNSEEN * R * [[1.0, 0.0], [0.0, 0.0]]},),
    Bug.R_DIAGONAL: ({"R": diagonal, "R_new": diagonal},),
    Bug.R_OF_THE_FIRST: ({"R": lambda R: np.repeat(R[:1], len(R), axis=0)},),
    Bug.JACOBIAN_NO_HEADING: ({"Hx": scaled(1.0, 1.0, 0.0)},),
    Bug.JACOBIAN_SIGN_OF_HEADING: ({"Hx": scaled(1.0, 1.0, -1.0)},),
    Bug.JACOBIAN_SIGN_OF_POSITION: ({"Hx": lambda H: H * [[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0]]},),
    Bug.JACOBIAN_NO_LANDMARK: ({"Hl": scaled(0.0)},),
    Bug.INNOVATION_NOT_WRAPPED: ({"turned_back": True}, {}),
    Bug.OBSERVATIONS_UNCORRELATED: ({"S": blocks_alone}, {"S": blocks_alone, "joseph": True}),
    Bug.NEW_WITHOUT_NOISE: ({"R_new": scaled(0.0)},), Bug.NEW_WITHOUT_POSE: ({"Gx": scaled(0.0)},),
    Bug.NEW_NO_HEADING: ({"Gx": scaled(1.0, 1.0, 0.0)},), Bug.NEW_NOISE_NOT_TURNED: ({"Gz": lambda Gz: np.eye(2)},),
    Bug.FIRST_DROPPED: ({"used": lambda rows: rows[1:]},), Bug.LAST_DROPPED: ({"used": lambda rows: rows[:-1]},),
    Bug.EVERY_SECOND_DROPPED: ({"used": lambda rows: rows[::2]},), Bug.ALL_DROPPED: ({"used": lambda rows: rows[:0]},),
    Bug.OWN_GATE: tuple({"gate": v} for v in (4.0, 5.99, 7.81, 9.0, 9.21, 11.83, 13.82)),
    Bug.JOINT_UNCORRELATED: ({"joint": blocks_alone},), Bug.JOINT_PERMUTED: ({"joint": permuted},),
}  # fmt: skip


RIGHT = Rules()


def rules_of(bug: Bug) -> list[Rules]:
    """Ways in which a filter may have a bug."""
    return [Rules(mistakes=(bug,), **changes) for changes in CHANGES.get(bug, ({},))]


MISTAKEN = tuple(r for bug in Bug for r in rules_of(bug))
ALONE = MISTAKEN + tuple(replace(r, one_by_one=True) for r in MISTAKEN)
OF_WEIGHTS = {Bug.LIKELIHOODS_ADDED, Bug.INNOVATION_NOT_WRAPPED, Bug.WEIGHTS_FORGOTTEN, Bug.WEIGHTS_KEPT}
WEIGHINGS = [
    r for r in MISTAKEN
    if Bug.R_NONE not in r.mistakes and (r.R is not same or r.used is not RIGHT.used or {*r.mistakes} & OF_WEIGHTS)
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Expected:
    """Candidates (n,) of observations (m,), as an association method gets them."""

    number: IntArray  # (n,) landmark numbers
    z_hat: Array  # (n, 2)
    joint: Array  # (2n, 2n), covariance of all of them, without noise
    blocks: Array  # (n, 2, 2), of each
    innovations: Array  # (m, n, 2), wrapped
    R: Array  # (m, 2, 2), noise of the observations
    decided: IntArray | None = None  # (m,) by JCBB; None: not formed


@dataclass(frozen=True, eq=False)
class State:
    """What an estimator says about a frame."""

    expected: Expected | None  # before the update; None: no observations, or it does not say
    decisions: IntArray  # (m,) handed to the update
    used: IntArray  # rows (k,) of the observations that it claims to have used
    nis: float  # as it states it; NaN: it does not
    pose: Array  # (3,)
    covariance: Array  # (3, 3), NaN: none
    number: IntArray  # landmarks (L,), none in localization
    xy: Array  # (L, 2)
    blocks: Array  # (L, 2, 2)


NONE, NOWHERE = np.empty(0, np.int64), np.empty((0, 3))
Frames = list[tuple[Frame, IntArray]]  # with the decisions about their observations


def unwrapped(z: Array, z_hat: Array, heading: Array | float) -> Array:
    """Differences of bearings from those expected, which are atan2(y, x) - heading."""
    return np.asarray(z - wrap_angle(z_hat + heading) + heading)


def _of(mistakes: tuple[Bug, ...], table: dict[Bug, Any], right: Any) -> Any:
    """What one of the mistakes puts in the place of what is right."""
    return next((table[b] for b in mistakes if b in table), right)


class Kalman:
    """An EKF for localization (a map in the inputs) or SLAM: state and covariance, dense."""

    def __init__(self, inputs: Inputs, rules: Rules) -> None:
        self.sensor, self.map, self.rules = inputs.sensor, inputs.map, rules
        self.x, self.P = np.array(inputs.prior.mean), rules.prior(np.array(inputs.prior.covariance))
        self.before = self.x[:3].copy()

    def predict(self, mean: Array, covariance: Array) -> None:
        """Move by an increment (3,) with covariance (3, 3)."""
        r, d = self.rules, len(self.x)
        self.before, mean = self.x[:3].copy(), r.mean(mean)
        moved = compose(self.x[:3], mean)
        if Bug.MOTION_NOT_TURNED in r.mistakes:
            moved = self.x[:3] + mean
        F, J = np.eye(d), np.eye(3)  # J: of a composed pose to the pose before
        dx, dy = world_from_body(float(self.x[2]))[:2, :2] @ mean[:2]
        J[0, 2], J[1, 2] = -dy, dx
        F[:3, :3] = r.F(J)
        turned = {Bug.Q_NOT_TURNED: 0.0, Bug.Q_TURNED_LATE: float(moved[2])}
        G = world_from_body(_of(r.mistakes, turned, float(self.x[2])))
        P = F @ self.P @ F.T
        if Bug.CROSS_NOT_PREDICTED in r.mistakes:
            P[:3, 3:], P[3:, :3] = self.P[:3, 3:], self.P[3:, :3]
        P[:3, :3] += G @ r.Q(covariance) @ G.T
        self.x[:3], self.P = moved, P
        self.x[2] = wrap_angle(float(self.x[2]))

    def _linearized(self, number: IntArray, pose: Array) -> tuple[Array, Array]:
        """z_hat (n, 2) and H (2n, d) of landmarks (n,), seen from a pose (3,)."""
        r, n, d = self.rules, len(number), len(self.x)
        xy = self.x[3:].reshape(-1, 2)[number] if self.map is None else self.map.positions(number)
        z_hat, Hx, Hl = self.sensor.linearize(pose, xy)
        if Bug.JACOBIAN_STALE in r.mistakes:
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
        z_hat, H = self._linearized(number, self.before if Bug.EXPECTED_BEFORE_MOTION in r.mistakes else self.x[:3])
        if Bug.EXPECTED_WITHOUT_LANDMARK in r.mistakes:
            H[:, 3:] = 0.0
        joint = r.joint(H @ self.P @ H.T)
        if Bug.EXPECTED_WITH_NOISE in r.mistakes:
            joint = joint + np.kron(np.eye(len(number)), observations.R[0])
        innovations = np.asarray(self.sensor.residual(observations.z[:, None], z_hat[None]))
        return Expected(number, z_hat, joint, diagonal_blocks(joint), innovations, observations.R)

    def update(self, observations: FrameObservations, decisions: IntArray) -> tuple[IntArray, float]:
        """One update with all pairings, then new landmarks; the rows used, and the NIS."""
        r, predicted = self.rules, self.x[:3].copy()
        rows = np.flatnonzero(decisions >= 0)
        chosen, nis = r.used(rows), 0.0
        numbers = decisions[chosen]
        if Bug.DISCARDED_USED in r.mistakes:
            held = NONE if self.map is None else self.map.id
            extra = np.flatnonzero(decisions < NEW) if len(self.x) > 3 or len(held) else NONE
            chosen = np.concatenate([chosen, extra])
            numbers = np.concatenate([numbers, np.full(len(extra), held[0] if len(held) else 0, np.int64)])
        step = 1 if r.one_by_one else max(len(chosen), 1)
        for i in range(0, len(chosen), step):
            some = chosen[i : i + step]
            nis += self._correct(observations.z[some], observations.R[some], numbers[i : i + step])
        if self.map is None:
            for i in np.flatnonzero(decisions == NEW).tolist():
                self._found(observations.z[i], observations.R[i], predicted)
        return rows, nis

    def _correct(self, z: Array, R: Array, number: IntArray) -> float:
        r, k = self.rules, len(number)
        z_hat, H = self._linearized(number, self.x[:3])
        nu = np.asarray(self.sensor.residual(z, z_hat))
        if Bug.INNOVATION_NOT_WRAPPED in r.mistakes:
            nu = z - z_hat
            if r.turned_back and isinstance(self.sensor, RangeBearing):
                nu[:, 1] = unwrapped(z[:, 1], z_hat[:, 1], self.x[2])
        HPH, noise, stated = H @ self.P @ H.T, block_diagonal(r.R(R)), block_diagonal(R)
        S = r.S(HPH + noise)
        own = np.linalg.pinv(diagonal_blocks(HPH + stated)) if r.gate < math.inf else np.zeros((k, 2, 2))
        if not (inside := np.einsum("ki,kij,kj->k", nu, own, nu) < r.gate).all():
            return self._correct(z[inside], R[inside], number[inside])
        inverse = np.linalg.pinv(S)
        K = (inverse @ H @ self.P).T
        shift = K @ nu.ravel()
        if Bug.MEAN_NOT_UPDATED in r.mistakes:
            shift = 0.0 * shift
        if Bug.MEAN_OF_MAP_NOT_UPDATED in r.mistakes:
            shift[3:] = 0.0
        self.x = self.x + shift
        self.x[2] = wrap_angle(float(self.x[2]))
        P, W = self.P, K @ H
        A = np.eye(len(P)) - W
        if Bug.JOSEPH_WITHOUT_NOISE in r.mistakes:
            P = A @ P @ A.T
        elif r.joseph:
            P = A @ P @ A.T + K @ noise @ K.T
        elif Bug.COVARIANCE_NOT_UPDATED not in r.mistakes:
            P = A @ P
        if Bug.CROSS_NOT_UPDATED in r.mistakes:
            P[:3, 3:], P[3:, :3] = self.P[:3, 3:], self.P[3:, :3]
        self.P = 0.5 * (P + P.T)
        weights = {Bug.NIS_WITHOUT_STATE: stated, Bug.NIS_WITHOUT_NOISE: HPH, Bug.NIS_UNCORRELATED: blocks_alone(S)}
        if Bug.NIS_IS_DOF in r.mistakes:
            return 2.0 * k
        if Bug.NIS_OF_RESIDUALS in r.mistakes:
            nu = np.asarray(self.sensor.residual(z, self._linearized(number, self.x[:3])[0]))
        weight = _of(r.mistakes, weights, S)
        return float(nu.ravel() @ (inverse if weight is S else np.linalg.pinv(weight)) @ nu.ravel())

    def _found(self, z: Array, R: Array, predicted: Array) -> None:
        r, d = self.rules, len(self.x)
        start = predicted if Bug.NEW_FROM_PREDICTION in r.mistakes else self.x[:3]
        xy, Gx, Gz = (a[0] for a in self.sensor.inverse(start, z[None]))
        J, Gz = np.zeros((2, d)), r.Gz(Gz)
        J[:, :3] = r.Gx(Gx)
        cross = J @ self.P
        own = cross @ J.T + Gz @ r.R_new(R) @ Gz.T
        cross = cross * _of(r.mistakes, {Bug.NEW_WITHOUT_CROSS: 0.0, Bug.NEW_HALF_CROSS: 0.5}, 1.0)
        if Bug.NEW_CROSS_TO_POSE_ONLY in r.mistakes:
            cross[:, 3:] = 0.0
        if not math.isnan(r.fixed):
            cross, own = 0.0 * cross, r.fixed * np.eye(2)
        self.x, self.P = np.concatenate([self.x, xy]), np.block([[self.P, cross.T], [cross, own]])
        if Bug.NEW_FIXED_CORRECTED in r.mistakes:
            self._correct(z[None], R[None], np.array([(d - 3) // 2]))

    def state(self, expected: Expected | None, decided: IntArray, used: IntArray = NONE, nis: float = np.nan) -> State:
        """What it says at the end of a frame."""
        P = self.P[:3, :3].copy()
        if Bug.POSE_IN_BODY_FRAME in self.rules.mistakes:
            B = world_from_body(float(self.x[2]))
            P = B.T @ P @ B
        n = 0 if self.map is not None else (len(self.x) - 3) // 2
        blocks = diagonal_blocks(self.P[3:, 3:]) if n else np.empty((0, 2, 2))
        xy = self.x[3:].reshape(-1, 2).copy() if n else np.empty((0, 2))
        return State(expected, decided, used, nis, self.x[:3].copy(), P, np.arange(n), xy, blocks)


def states_of(frames: Frames, inputs: Inputs, rules: Rules) -> list[State]:
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


EXACTLY, NEARLY = 1e-6, 0.05  # largest differences, in standard deviations of the exact filter
SAMPLING = 5.0
"""Standard errors that a mean or sigma of samples may be off: over the frames and numbers compared, chance gives 4. At
most `APPROXIMATE` is allowed."""
SURE, MOST, LEAST = 10.0, 0.15, 0.7
"""Log-likelihood by which a mistake explains weights better; the divergence that it leaves, as a share and by frame."""
UNDERFLOW = -700.0  # a log-likelihood of all samples below which their weights are zeros, and then mostly made equal
DEPLETED = 8.0  # Least effective number of samples, of which any mean and covariance is chance
ALIKE, TOGETHER = 0.1, 0.01
"""A mistake is named if its filter is this much closer to the estimator than the exact one; several, or one by some
frames alone, if it is closer still: of the pairs with the `NEAREST`, `TRIED` whose consequences almost add up."""
NEAREST, TRIED = 16, 48
SEAM = 4.0  # sigmas from pi of an expected bearing that may be on either side of it
KNOWN = 1e-4  # rad; a heading with a smaller standard deviation is known
GATE, NEW_GATE = 0.99, 0.99999


Quantity = StrEnum(
    "Quantity",
    "CANDIDATES EXPECTED INNOVATIONS NOISE MARGINALS JOINT DECISIONS USED NIS SAMPLES POSE COVARIANCE LANDMARKS "
    "LANDMARK_COVARIANCE",
)  # what is compared, in the order of a frame; `templates/checks.j2` has the words
COUNTED = (Quantity.CANDIDATES, Quantity.DECISIONS, Quantity.USED, Quantity.SAMPLES)
"""Numbers of candidates or observations; all others are in standard deviations."""


@dataclass(frozen=True)
class Agreement:
    """Everything is as the exact filter has it."""

    world: str  # `worlds.LINEAR` or `worlds.MILD`
    frames: int  # number of frames compared
    quantities: tuple[Quantity, ...]  # compared
    largest: float  # difference [sigma]
    allowed: float  # [sigma]


@dataclass(frozen=True)
class Deviation:
    """A quantity is not as the exact filter has it."""

    world: str
    quantity: Quantity
    frame: int  # the first beyond what is allowed
    observed: bool  # whether that frame has observations
    first: bool  # whether no other quantity is beyond it earlier
    largest: float  # difference [sigma], or number of candidates or observations
    allowed: float  # of the largest
    bugs: tuple[Bug, ...]  # mistakes with the same consequences; empty: none known
    exact: bool  # whether the estimator claims to be exact
    new_alone: bool = False  # whether all that is observed in that frame initializes landmarks
    linear_alone: bool = False  # whether the other world agrees so far, so that a sensor of its own may be the cause
    left_out: bool = False  # whether all that it uses are given pairings, and without the others its numbers are off
    sigmas: tuple[float, float] = (1.0, 1.0)  # of x and y, the least and largest of all frames, over the right ones
    samples: str = ""  # what `of_samples` finds


@dataclass(frozen=True)
class Stopped:
    """An estimator stopped in a frame, for a reason in words; `bugs` as of `Deviation`."""

    world: str
    frame: int
    why: str
    bugs: tuple[Bug, ...]


Fact = Agreement | Deviation | Stopped


def sentence(fact: Fact, others: tuple[Quantity, ...] = ()) -> str:
    """It in words, with `others` that are off by the same mistake."""
    macro = getattr(environment("eval.checks").get_template("checks.j2").module, type(fact).__name__.lower())
    return str(macro(fact, others) if others else macro(fact)).strip()


@check("exactness")
def exactness(text: str, task: str) -> Iterator[Finding]:
    """All that an estimator says about two small worlds is as the exact filter has it: one finding each."""
    # a foreign one claims it unless `exact = False`; ours in `INCREMENTAL` leave out changes below a limit
    exact = bool(getattr(load(text).thing, "exact", True)) if is_foreign(text) else text not in INCREMENTAL
    both = {w: compared(text, task, w, exact=exact) for w in (worlds.LINEAR, worlds.MILD)[not exact :]}
    off = {(w, f.quantity, f.frame) for w, facts in both.items() for f in facts if isinstance(f, Deviation)}
    for world, found in both.items():
        facts = [
            replace(f, linear_alone=world == worlds.LINEAR and (worlds.MILD, f.quantity, f.frame) not in off)
            if isinstance(f, Deviation) else f for f in found
        ]  # fmt: skip
        yield Finding(f"{world} world", isinstance(facts[0], Agreement), sentences(facts), facts)


def sentences(facts: Sequence[Fact]) -> str:
    """A sentence for each mistake: the fact that shows it first, and which others follow from it."""
    wrong = [f for f in facts if not isinstance(f, Agreement)]
    named = {f.bugs for f in wrong if f.bugs}
    if len(named) == 1:  # it explains the rest, too, unless that began before
        since = min(f.frame for f in wrong if f.bugs)
        wrong = [replace(f, bugs=min(named)) if f.frame >= since else f for f in wrong]
    said = []
    for bugs in dict.fromkeys(f.bugs for f in wrong):
        first, *others = (f for f in wrong if f.bugs == bugs)
        said.append(sentence(first, tuple(f.quantity for f in others if isinstance(f, Deviation))))
    return ". ".join(said) or sentence(facts[0])


def compared(text: str, task: str, world: str, *, exact: bool) -> list[Fact]:
    """The facts about an estimator in a world: it agrees, or deviations in the order of their appearance."""
    frames, right = exact_states(world, task)
    given, samples, stop = recorded(text, inputs_of(world, task), frames, exact=exact)
    allowed = EXACTLY if exact and world == worlds.LINEAR else NEARLY
    if drawn := samples < math.inf:
        allowed = min(NEARLY + SAMPLING / math.sqrt(samples), APPROXIMATE)
    each = [differences(g, r) for g, r in zip(given, right[: len(given)], strict=True)]
    begin: dict[Quantity, int] = {}
    largest = dict.fromkeys(Quantity, 0.0)
    told, bugs, again = of_samples(text, inputs_of(world, task), frames[: len(given)]) if drawn else ("", (), False)
    if bugs:
        begin[Quantity.SAMPLES] = 0
    for k, found in enumerate(each):
        for quantity, size in found.items():
            largest[quantity] = max(largest[quantity], size)
            if size > (0.0 if quantity in COUNTED else allowed):
                begin.setdefault(quantity, k)
    if not begin and stop is None:
        measured = tuple(q for q in Quantity if any(q in found for found in each))
        most = max(size for q, size in largest.items() if q not in COUNTED)
        return [Agreement(world, len(each), measured, most, allowed)]
    order = sorted(begin, key=lambda q: (begin[q], list(Quantity).index(q)))
    first = begin.get(Quantity.LANDMARKS, 0)
    # landmarks that are elsewhere as soon as there are any were initialized elsewhere, which no update explains
    elsewhere = order[:1] == [Quantity.LANDMARKS] and not any(len(s.number) for s in right[:first])
    if not bugs and samples < DEPLETED and told != "weights":
        bugs = (Bug.DEPLETED if again else Bug.NOT_RESAMPLED,)
    since = begin[order[0]] + 1 if order else 0
    # what is later may have other causes
    ways = ((len(given), None), (since + 3, None), (since, None), (since, Quantity.POSE))
    for until, only in ways[: 0 if elsewhere else 4 if len(begin) > 1 else 1]:
        early = numbers(given[:until], right[: len(given[:until])])
        bugs = bugs or likely(world, task, early, only, most=1 if drawn or only else 3)
    if not bugs and not elsewhere:  # whether it begins with another pose or covariance than the prior's
        with suppress(ForeignError, *DIVERGED):
            begun = Kalman(inputs_of(world, task), RIGHT).state(None, NONE)
            pose, P = make_estimator(text, inputs_of(world, task)).estimate()
            off_prior = max(differences(replace(begun, pose=pose, covariance=P), begun).values())
            bugs = (Bug.PRIOR_ELSEWHERE,) if off_prior > max(allowed, NEARLY) else ()
    if not bugs and not drawn and world == worlds.MILD and largest[Quantity.POSE] > allowed:
        bugs = across_pi(text, inputs_of(world, task), frames, right, largest[Quantity.POSE])
    left_out = len(begin) > 1 and all(np.isin(g.used, r.used).all() for g, r in zip(given, right, strict=False))
    facts: list[Fact] = []
    for q in order:
        chosen, limit = frames[begin[q]][1], 0.0 if q in COUNTED else allowed
        own = bugs if bugs or elsewhere else likely(world, task, numbers(given, right[: len(given)]), q)
        new = NEW in chosen and not (chosen >= 0).any()
        off = Deviation(world, q, begin[q], len(chosen) > 0, q is order[0], largest[q], limit, own, exact, new)
        if q is Quantity.COVARIANCE:
            P, C = (np.array([np.diag(s.covariance)[:2] for s in states]) for states in (given, right[: len(given)]))
            off = replace(off, sigmas=(float(np.nanmin(P / C)) ** 0.5, float(np.nanmax(P / C)) ** 0.5))
        facts.append(replace(off, left_out=left_out and q is Quantity.USED, samples=told))
    return facts if stop is None else [*facts, Stopped(world, len(given), str(stop), bugs)]


def across_pi(text: str, inputs: Inputs, frames: Frames, right: Sequence[State], worst: float) -> tuple[Bug, ...]:
    """Whether poses that are `worst` sigmas off agree without landmarks whose bearings may be on both sides of pi:
    those of sigma points, or measured and expected.
    """
    near: Frames = []
    for (frame, decisions), state in zip(frames, right, strict=True):
        if (e := state.expected) is not None:
            sigma = np.sqrt(e.blocks[:, 1, 1] + e.R[:, 1, 1].max())
            behind = e.number[math.pi - np.abs(wrap_angle(e.z_hat[:, 1])) < SEAM * sigma]
            decisions = np.where(np.isin(decisions, behind), DISCARD, decisions)
        near.append((frame, decisions))
    given = recorded(text, inputs, near, exact=False)[0]
    off = [differences(g, r)[Quantity.POSE] for g, r in zip(given, states_of(near, inputs, RIGHT), strict=False)]
    return (Bug.ACROSS_PI,) if len(off) == len(frames) and max(off) < ALIKE * worst else ()


def of_samples(text: str, inputs: Inputs, frames: Frames) -> tuple[str, tuple[Bug, ...], bool]:
    """Compare draws of the motion with Q, and weights, or how often each sample is drawn again, with likelihoods.

    Returns what is wrong ("draws", "weights", "moved" by an update; "right"; empty: nothing was compared),
    the mistakes that have a name, and whether samples are ever drawn again.
    """
    made, what, again, weighed = make_estimator(text, inputs), "", False, list[Weighed]()
    assert isinstance(made, Adapter)
    bugs: tuple[Bug, ...] = ()

    def cloud() -> tuple[Array, Array]:
        given, none = call(text, made.inner.estimate), (NOWHERE, NOWHERE[:, 0])
        return (np.array(given.poses, float), given.normalized) if isinstance(given, Samples) else none

    now, w = cloud()
    for frame, decisions in frames:
        if frame.increment is not None:
            made.predict(frame.increment)
            before, (now, w) = now, cloud()
            if before.shape == now.shape and len(now) and not what:
                what, bugs = _drawn(between(before, now), frame.increment.covariance)
        if len(decisions):
            made.update(frame.observations, decisions)
            before, prior, (now, w) = now, w, cloud()
            _, at = np.unique(np.concatenate([before, now]), axis=0, return_inverse=True)
            old, new = np.split(at.ravel(), [len(before)])
            again |= (repeated := len(np.unique(new)) < len(new))
            rows = np.flatnonzero(decisions >= 0)
            if not np.isin(new, old).all():
                what = what or "moved"
            elif inputs.map is not None and len(rows) and len(new):
                z, xy = frame.observations.z[rows, None], inputs.map.positions(decisions[rows])
                z_hat = np.array([inputs.sensor.predict(before, np.tile(p, (len(old), 1))) for p in xy])
                nu = inputs.sensor.residual(z, z_hat)
                raw = np.stack([nu[..., 0], unwrapped(z[..., 1], z_hat[..., 1], before[:, 2])], axis=-1)
                given, kept = np.bincount(new, w, old.max() + 1).astype(float), repeated and float(np.ptp(w)) > 0.0
                weighed.append(((nu, raw), frame.observations.R[rows], old, prior, given, kept))
    if bugs or what == "moved" or not weighed:
        return what, bugs, again
    rules, off = RIGHT, (most := _divergence(RIGHT, weighed))
    for _ in range(3):
        others = [r for r in (both(rules, w) for w in WEIGHINGS) if r is not None]
        each = [_divergence(r, weighed) for r in others]
        if len(now) * (off - min(each)) < SURE:
            break
        rules, off = others[int(np.argmin(each))], min(each)
    close = off < min(MOST * most, LEAST * len(weighed))
    return ("weights", rules.mistakes if close else (), again) if rules.mistakes else (what or "right", (), again)


def _drawn(each: Array, Q: Array) -> tuple[str, tuple[Bug, ...]]:
    """Whether motions (n, 3) of samples have the covariance Q within its standard errors, or the mistake that has."""
    if (each.var(axis=0) < EXACTLY * np.diag(Q)).all():
        return "draws", (Bug.ONE_DRAW,)
    for rules in (RIGHT, *(r for r in MISTAKEN if r.Q is not same)):
        sigma = np.sqrt(np.diag(C := rules.Q(Q)))
        if sigma.all() and _size((np.cov(each.T) - C) / _outer(sigma)) < SAMPLING * math.sqrt(2.0 / len(each)):
            return "draws" * bool(rules.mistakes), rules.mistakes
    return "draws", ()


Weighed = tuple[tuple[Array, Array], Array, IntArray, Array, Array, bool]
"""Of a frame: innovations (m, n, 2), wrapped or not; R; numbers of different samples (n,) and their weights before, and
weights (s,) by number afterwards; whether they differ after samples were drawn again."""


def _divergence(r: Rules, weighed: Sequence[Weighed]) -> float:
    """Divergence of weights from those by some rules, or of how often samples are drawn again."""
    total = 0.0
    for nu, R, old, before, given, kept in weighed:
        rows, own = r.used(np.arange(len(R))), nu[Bug.INNOVATION_NOT_WRAPPED in r.mistakes]
        each = -0.5 * np.einsum("mni,mij,mnj->mn", own[rows], np.linalg.pinv(r.R(R)[rows]), own[rows])
        log = np.logaddexp.reduce(each, initial=-1e9) if Bug.LIKELIHOODS_ADDED in r.mistakes else each.sum(axis=0)
        known = 0.0 if Bug.WEIGHTS_FORGOTTEN in r.mistakes else np.log(np.maximum(before, 1e-300))
        power = 2.0 if kept and Bug.WEIGHTS_KEPT in r.mistakes else 1.0
        ways = (log, np.zeros_like(log)) if log.max() < UNDERFLOW else (log,)
        right = (np.bincount(old, scipy.special.softmax(power * (way + known))) for way in ways)
        total += min(float(scipy.special.rel_entr(given, np.maximum(p, 1e-300)).sum()) for p in right)
    return total


def inputs_of(world: str, task: str) -> Inputs:
    """Labelled inputs of a world for a task."""
    inputs = worlds.small(world)
    return inputs if task == "localization" else inputs.without_map()


@lru_cache(maxsize=4)
def exact_states(world: str, task: str) -> tuple[Frames, list[State]]:
    """Frames with the decisions that are handed to every estimator, and the exact filter."""
    inputs = inputs_of(world, task)
    decisions, _ = known_decisions(inputs)
    frames = [(inputs.frame(k), decisions[inputs.start[k] : inputs.start[k + 1]]) for k in range(len(inputs))]
    states = states_of(frames, inputs, Rules())
    for k, (state, (frame, _)) in enumerate(zip(states, frames, strict=True)):
        if (e := state.expected) is not None:
            z, residual = frame.observations.z, inputs.sensor.residual
            problem = Expectation.from_arrays(z, e.z_hat, e.joint, e.R, residual, number=e.number)
            states[k] = replace(state, expected=_formed(problem, known_map=inputs.map is not None))
    return frames, states


@lru_cache(maxsize=2048)
def _numbers(world: str, task: str, rules: Rules) -> Array:
    (frames, right), inputs = exact_states(world, task), inputs_of(world, task)
    return numbers(states_of(frames, inputs, rules), right)


@lru_cache(maxsize=8)
def filters(world: str, task: str, rules: tuple[Rules, ...]) -> tuple[list[Rules], Array]:
    """The rules (b,) among these that make a difference, and the filter with each in `numbers` (b, n)."""
    found = [(r, n) for r in rules if _distance(n := _numbers(world, task, r), _layout(world, task)[0]) > 0.0]
    return [r for r, _ in found], np.array([n for _, n in found])


@cache
def both(first: Rules, then: Rules) -> Rules | None:
    """A filter with the mistakes of two, one after the other; None if they exclude each other."""
    own, more = ({n: v for n, v in vars(r).items() if v is not getattr(RIGHT, n)} for r in (first, then))
    shared = own.keys() & more.keys() - {"mistakes", "one_by_one"}
    if set(first.mistakes) & set(then.mistakes) or not all(callable(own[n]) for n in shared):
        return None
    joined = {n: lambda A, f=own[n], g=more[n]: g(f(A)) for n in shared}
    return replace(first, **more | joined | {"mistakes": first.mistakes + then.mistakes})


@lru_cache(maxsize=4)
def _layout(world: str, task: str) -> tuple[Array, Array]:
    """Weights (n,) of `numbers`, the same for every quantity of every frame; and the quantities (n,), as strings."""
    _, right = exact_states(world, task)
    each = [(q, part.size) for s in right for q, part in parts(s, s).items()]
    return np.concatenate([np.full(n, 1.0 / n) for _, n in each]), np.repeat([q for q, _ in each], [n for _, n in each])


def likely(world: str, task: str, mine: Array, only: Quantity | None = None, most: int = 1) -> tuple[Bug, ...]:
    """The mistakes, at `most` so many, by which the filter gives the `numbers` of an estimator (n,), or those of a
    quantity; empty: none such.
    """
    n, (rules, each), (single, changes) = len(mine), *(filters(world, task, r) for r in (ALONE, MISTAKEN))
    weights, quantities = (a[:n] for a in _layout(world, task))
    if only is not None:
        weights = np.where(quantities == only, weights, 0.0)
    size, nearest = _distance(mine, weights), np.empty(0, np.int64)
    for count in range(most):
        if count:  # consequences nearly add up
            rest = np.array([_distance(mine - e[:n] - changes[:, :n], weights) for e in each[nearest]])
            tried = zip(*np.unravel_index(np.argsort(rest, axis=None, kind="stable")[:TRIED], rest.shape), strict=True)
            found = (both(rules[nearest[i]], single[j]) for i, j in tried)
            rules, each = filters(world, task, tuple(r for r in found if r is not None))
        apart = _distance(mine - each[:, :n], weights) if len(rules) else np.array([math.inf])
        nearest = np.argsort(apart, kind="stable")[:NEAREST]
        if apart[nearest[0]] < (TOGETHER if count or n < each.shape[-1] else ALIKE) * size:
            return tuple(rules[nearest[0]].mistakes)
    return ()


def _distance(off: Array, weights: Array) -> Array:
    """Weighted mean of absolute differences (..., n), each at most 1, without those that are unknown."""
    known = np.isfinite(off)
    size = np.minimum(np.abs(np.where(known, off, 0.0)), 1.0)
    return np.asarray((size @ weights) / np.maximum(known @ weights, 1e-300))


def numbers(given: Sequence[State], right: Sequence[State]) -> Array:
    """All deviations of frames from the exact filter as one vector (n,), in standard deviations; NaN: not stated."""
    each = [part.ravel() for g, r in zip(given, right, strict=True) for part in parts(g, r).values()]
    return np.concatenate(each) if each else np.empty(0)


def parts(given: State, right: State) -> dict[Quantity, Array]:
    """Deviations of a frame by quantity, in standard deviations of the exact filter `right`, and in its shapes. NaN:
    not stated, or of a candidate or landmark that only one of both has.
    """
    found, g, r = {}, given.expected, right.expected
    if r is not None and len(r.number):
        both, mine, theirs = np.intersect1d([] if g is None else g.number, r.number, return_indices=True)
        each = r.blocks + r.R.min(axis=0)  # by candidate, with the least noise of the frame
        sigma = np.sqrt(np.einsum("nii->ni", each))
        off = [np.full(a.shape, np.nan) for a in (r.z_hat, r.blocks, r.joint)]
        if g is not None and len(both):
            inner, outer = (np.ix_(coordinates(w), coordinates(w)) for w in (mine, theirs))
            off[0][theirs], off[1][theirs] = g.z_hat[mine] - r.z_hat[theirs], g.blocks[mine] - r.blocks[theirs]
            off[2][outer] = g.joint[inner] - r.joint[outer]
        found[Quantity.EXPECTED] = off[0] / sigma
        found[Quantity.MARGINALS] = off[1] / _outer(sigma)
        found[Quantity.JOINT] = off[2] / _outer(sigma.ravel())
    if len(right.used):
        found[Quantity.NIS] = np.array([(given.nis - right.nis) / max(right.nis, 2.0 * len(right.used))])
    sigma = np.sqrt(np.diag(right.covariance))
    shift = given.pose - right.pose
    shift[2] = wrap_angle(float(shift[2]))
    found[Quantity.POSE] = shift / sigma
    found[Quantity.COVARIANCE] = (given.covariance - right.covariance) / _outer(sigma)
    if len(right.number):
        xy, own = np.full_like(right.xy, np.nan), np.full_like(right.blocks, np.nan)
        if np.array_equal(given.number, right.number):
            xy, own = given.xy - right.xy, given.blocks - right.blocks
        sigma = np.sqrt(np.einsum("nii->ni", right.blocks))
        found[Quantity.LANDMARKS] = xy / sigma
        found[Quantity.LANDMARK_COVARIANCE] = own / _outer(sigma)
    return found


def _outer(sigma: Array) -> Array:
    """Products (..., d, d) of standard deviations (..., d)."""
    return np.asarray(sigma[..., :, None] * sigma[..., None, :])


HALVED = (Quantity.NIS, Quantity.COVARIANCE, Quantity.LANDMARK_COVARIANCE, Quantity.MARGINALS, Quantity.JOINT)
"""A difference of variances is twice that of standard deviations; all but the last two need not be stated."""


def differences(given: State, right: State) -> dict[Quantity, float]:
    """Differences of a frame from the exact filter, in its standard deviations; infinite where a value is missing."""
    found, off = {} if given.expected is None else _expectations(given, right), parts(given, right)
    if len(given.decisions):
        found[Quantity.USED] = float(len(np.setxor1d(given.used, right.used)))
    if right.covariance[2, 2] < KNOWN**2:  # a heading that is known has no covariance beyond rounding
        off |= {Quantity.POSE: off[Quantity.POSE][:2], Quantity.COVARIANCE: off[Quantity.COVARIANCE][:2, :2]}
    e, r = given.expected, right.expected
    if r is not None and len(r.number):  # of the candidates that the estimator names
        shared = np.isin(r.number, [] if e is None else e.number)
        rows = coordinates(np.flatnonzero(shared))
        off[Quantity.JOINT] = off[Quantity.JOINT][np.ix_(rows, rows)]
        off |= {q: off[q][shared] for q in (Quantity.EXPECTED, Quantity.MARGINALS)}
    for q, each in off.items():
        unsaid = (q in HALVED[:3] and np.isnan(each).any()) or (q.startswith("landmark") and not len(given.number))
        if each.size and not unsaid:
            found[q] = (0.5 if q in HALVED else 1.0) * _size(each)
    return found


def _expectations(given: State, right: State) -> dict[Quantity, float]:
    """Differences of candidates, innovations, noise and decisions, over the candidates that the estimator names."""
    g, r = given.expected, right.expected
    assert g is not None
    assert r is not None
    strange = len(np.setdiff1d(given.decisions[given.decisions >= 0], g.number)) + len(np.setdiff1d(g.number, r.number))
    noise = 0.5 * (g.R - r.R) / _outer(np.sqrt(np.einsum("nii->ni", r.R)))
    found = {Quantity.CANDIDATES: float(strange), Quantity.NOISE: _size(noise)}
    both, mine, theirs = np.intersect1d(g.number, r.number, return_indices=True)
    if len(both):
        S = r.blocks[theirs][None] + r.R[:, None]
        off = g.innovations[:, mine] - r.innovations[:, theirs]
        found[Quantity.INNOVATIONS] = _size(off / np.sqrt(np.einsum("mnii->mni", S)))
        if g.decided is not None and r.decided is not None:
            found[Quantity.DECISIONS] = float((g.decided != r.decided).sum())
    return found


def _size(off: Array) -> float:
    """Largest absolute value; infinite if one is not finite."""
    return float(np.abs(off).max(initial=0.0)) if np.isfinite(off).all() else math.inf


def recorded(
    text: str, inputs: Inputs, frames: Frames, *, exact: bool = True
) -> tuple[list[State], float, ForeignError | None]:
    """What an estimator says about frames, its least effective number of samples (infinite: none), and why it stopped.
    A landmark that is not initialized at once ends the comparison; of an `exact` estimator, or if no pairing was
    compared before, it is a reason.
    """
    estimator, slam = make_estimator(text, inputs), inputs.map is None
    foreign = estimator if isinstance(estimator, Adapter) else None
    timed = capabilities(estimator).get("stamp")
    found: list[State] = []
    stop = None
    try:
        for frame, decisions in frames:
            state, absent = _said(estimator, timed, frame, decisions, slam=slam)
            if state.expected is not None and isinstance(inputs.sensor, RangeBearing):  # bearings may be beyond pi
                state.expected.z_hat[:, 1] = wrap_angle(state.expected.z_hat[:, 1])
            if absent:
                why, some = f"{absent} NEW observations initialize no landmark", any(len(s.used) for s in found)
                if not some:
                    why += ", so nothing could be compared: initialize each at once in `update`, at least for the check"
                stop = ForeignError(why) if exact or not some else None
                break
            found.append(state)
    except (ForeignError, *DIVERGED) as fault:
        stop = ForeignError(str(fault))
    return found, math.inf if foreign is None else foreign.samples, stop


def _said(estimator: Estimator, timed: Able | None, frame: Frame, chosen: IntArray, *, slam: bool) -> tuple[State, int]:
    """One frame of `recorded`, and how many landmarks are not initialized."""
    if frame.increment is not None:
        estimator.predict(frame.increment)
    if timed is not None:
        timed.stamp(frame.time)
    expected, used, nis, absent = None, NONE, math.nan, 0
    if len(chosen):
        if not isinstance(estimator, Adapter) or estimator.has("expect"):
            expected = _formed(estimator.expect(frame.observations), known_map=not slam)
        done = estimator.update(frame.observations, chosen.copy())
        used, nis = np.flatnonzero(done.used), done.nis
        absent = int(((chosen == NEW) & (done.created < 0)).sum()) if slam else 0
    pose, P = estimator.estimate()
    number, xy, blocks = estimator.landmarks() if slam else (NONE, np.empty((0, 2)), np.empty((0, 2, 2)))
    return State(expected, chosen, used, nis, pose, P, number, xy, blocks), absent


def _formed(e: Expectation, *, known_map: bool) -> Expected:
    """An expectation in numbers, before the update makes it invalid."""
    n = len(e.number)
    joint = np.asarray(e.joint(np.arange(n))) if n else np.empty((0, 0))
    nu = np.asarray(call("the residual of the expectation", e.innovations))
    try:
        decided = decide("jcbb", e, GATE, NEW_GATE, known_map=known_map).decisions
    except SingularInnovationError:
        decided = np.full(len(e.z), DISCARD)
    return Expected(e.number, np.array(e.z_hat), joint, e.HPHt, nu, e.R, decided)
