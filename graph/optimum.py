"""The optimum of a smoothing problem with its exact covariances: Gauss-Newton on gtsam's factors, by sparse QR.

Every step is the exact one of the linearized problem (`graph.qr`), shortened where the cost would not fall; its length
in sigmas measures the distance from the optimum. gtsam's own optimizers stop on a small decrease of the error instead;
by Cholesky they stall where increments are known much better in one direction than in another.

A search that converges linearly, as by reweighting or with large residuals, is accelerated: the next estimate is
extrapolated by the mixture of the last steps that is shortest (Anderson, "Iterative procedures for nonlinear integral
equations", J. ACM 12, 1965).

The innovation of a fix or closure against the estimate without it follows from its residual at the optimum. With
whitened Jacobian A, residual e and covariance P of the estimate, M = A P A' is the share of the measurement in its own
fit; the innovation is (I - M)^-1 e, its covariance (I - M)^-1 (Cook and Weisberg, "Residuals and influence in
regression", 1982, section 2.2). So each is chi-square by itself, as a filter's is, though not independent of the
others.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import IntArray
from data.pose_measurements import PoseUpdated, not_used
from data.result import MapState, Systematics, Trajectory
from data.se2 import Array, covariances_in_world, worlds_from_bodies
from data.sensors import about_origin
from graph.factors import CAUCHY, HUBER, UnderConstrained, pose_array
from graph.pose_factors import PoseFactor
from graph.problem import Problem
from graph.qr.elimination import Rows, Solution, Triangle, covariances, eliminate, solve
from graph.qr.rows import Linearizer
from graph.systematic import Motion

UNCHECKED = 1e-9  # least share of a measurement that the others must say as well; less is rounding
LEAST_WEIGHT = 1e-12  # of a robust loss


def innovations(
    factors: Sequence[PoseFactor], rows: Rows, blocks: IntArray, covariance: Array, across: Array, loss: str
) -> tuple[PoseUpdated | None, PoseUpdated | None]:
    """Innovations of all fixes and closures, `factors` (k,) of a problem; None: there are none. `rows`: the problem at
    its optimum, weighted by its loss, with these factors in `blocks` (k,). `covariance` (V, 3, 3): of all variables, of
    the first as of `Linearizer`; `across` (q, 3, 3): between the two frames of each closure.
    """
    if not factors:
        return None, None
    used = np.array([p.used for p in factors])
    weight = _weight((rows.b[blocks, :, 0] ** 2).sum(1), loss)
    root = np.sqrt(weight)  # taken off again
    A, error = rows.A[blocks, :, :6] / root[:, None, None], -rows.b[blocks, :, 0] / root[:, None]
    P = np.zeros((len(factors), 6, 6))
    P[:, :3, :3] = covariance[np.array([p.frames[0] for p in factors])]
    two = [i for i, p in enumerate(factors) if p.closure]
    P[two, 3:, 3:] = covariance[[factors[i].frames[-1] for i in two]]
    P[two, :3, 3:], P[two, 3:, :3] = across, across.transpose(0, 2, 1)
    M = A @ P @ A.transpose(0, 2, 1)
    G = np.eye(3) - np.where(used, weight, 0.0)[:, None, None] * M
    checked = np.linalg.eigvalsh(G)[:, 0] > UNCHECKED
    G[~checked] = np.eye(3)
    innovation = np.linalg.solve(G, error[:, :, None])
    S = np.eye(3) + np.linalg.solve(G, M)
    T = np.tile(np.eye(3), (len(factors), 1, 1))
    for i, p in enumerate(factors):
        T[i, : len(p.entries), : len(p.entries)] = p.unwhiten
    S = T @ S @ T.transpose(0, 2, 1)
    white = np.linalg.solve(np.linalg.cholesky(0.5 * (S + S.transpose(0, 2, 1))), T @ innovation)[:, :, 0]
    white[~checked] = np.nan
    return _of(factors, [i for i, p in enumerate(factors) if not p.closure], white), _of(factors, two, white)


def left_by(A: Array, covariance: Array, pairs: IntArray, across: Array) -> Array:
    """Eigenvalues (m, 2), ascending, of I - M for observations of both coordinates: variances of their residuals at the
    optimum, over those of their noise. Constant systematic errors count as known. A (m, 3, 6): of pose and landmark,
    whitened; `covariance`: as of `innovations`; `pairs` (m, 2): the variables, a known landmark is -1; `across` (m, 3,
    3): between them.
    """
    P = np.zeros((len(A), 6, 6))
    P[:, :3, :3], P[:, :3, 3:], P[:, 3:, :3] = covariance[pairs[:, 0]], across, across.transpose(0, 2, 1)
    P[:, 3:, 3:] = np.where((pairs[:, 1] >= 0)[:, None, None], covariance[pairs[:, 1]], 0.0)
    M = A[:, :2] @ P @ A[:, :2].transpose(0, 2, 1)
    return np.asarray(np.clip(np.linalg.eigvalsh(np.eye(2) - 0.5 * (M + M.transpose(0, 2, 1))), 0.0, 1.0))


def _of(factors: Sequence[PoseFactor], some: Sequence[int], white: Array) -> PoseUpdated | None:
    """The innovations of some of the factors, by their rows in the log."""
    if not some:
        return None
    row = np.array([factors[i].row for i in some])
    done = not_used(np.zeros(int(row.max()) + 1, np.int64))
    for k, i in zip(row.tolist(), some, strict=True):
        p = factors[i]
        d = len(p.entries)
        done.used[k], done.dof[k] = p.used, d
        done.white[k, list(p.entries)] = white[i, :d]
        done.nis[k] = float(white[i, :d] @ white[i, :d])
    return done


def _weight(square: Array, loss: str) -> Array:
    """Weights (k,) under a loss, from squared weighted residuals (k,)."""
    if loss == "huber":
        return HUBER**2 / np.maximum(square, HUBER**2)
    return np.maximum(1.0 - square / CAUCHY**2, LEAST_WEIGHT) if loss == "cauchy" else np.ones(len(square))


DEPTH = 6  # steps of an extrapolation


def mixture(past: Sequence[tuple[Array, Array]]) -> Array | None:
    """The estimate extrapolated from the last ones and the step from each, of any shape; None: there is only one."""
    if len(past) < 2:
        return None
    steps = np.array([d.ravel() for _, d in past])
    ends = np.array([(p + d).ravel() for p, d in past])
    mix = np.linalg.lstsq(np.diff(steps, axis=0).T, steps[-1], rcond=1e-8)[0]
    found: Array = ends[-1] - mix @ np.diff(ends, axis=0)
    return found.reshape(past[-1][0].shape)


STEP = 1e-6  # sigma. A shorter step ends the search, as a root sum of squares over all directions
ROUNDING = 2e-5  # sigma; so does one that hardly shrank: gtsam's logarithm of a pose is accurate to about 1e-5 sigma
CONVERGED = 1e-3  # sigma. Largest component of the remaining step at an optimum; above, the search is tried otherwise
FAILED = 1e-2  # sigma. Above that it is no optimum; a hundredth of a sigma adds 1e-4 to the NEES of a coordinate
SHRANK = 0.9  # share above which a step hardly shrank. The steps of a robust loss shrink to half or so each time
MOST = 200  # steps of one search. Five to fifteen are usual; a robust loss converges linearly and may take fifty
FURTHER = 200  # steps of each further search, damped or by dog leg, before a smoother gives up
SHORTEST = 1e-3  # share of a step below which it is not shortened further: the search is stuck
ARMIJO = 0.1  # share of the predicted decrease of the linearized problem that a step must reach
ERROR_ROUNDING = 1e-9  # relative increase of the cost allowed in a step (ranges to beacons are rounded to nanometres)
SLACK = (1.0, 0.3)
"""Shares of the worst sigma of an increment to which its best is loosened if the direct search fails: the curved valley
of a stiff path is crossed more easily while it is wide."""
SEARCHES = (
    (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams()),
    (gtsam.DoglegOptimizer, gtsam.DoglegParams()),
)  # Of gtsam, tried in turn where ours fails: short steps first, where the linearized problem predicts badly
SUSPECT = 2.0  # cost per degree of freedom (its half the expectation) above which a minimum may be a wrong one
ON_THE_ROBOT = 0.01  # m. A landmark estimated nearer to a pose that observed it has no well-defined bearing
TINY = 1e-9  # m, rad. Replaces a sigma of zero when a step is measured in sigmas


class NotConvergedError(UnderConstrained):
    """The search did not reach an optimum; the message gives the remaining step."""


@dataclass(frozen=True)
class Smoothed:
    """The optimum of a smoothing problem."""

    trajectory: Trajectory  # exact covariances; under a robust loss, of the information as weighted
    map: MapState | None  # landmarks, or None in localization
    cost: float  # twice the sum of all losses; without a robust loss the chi-square
    dof: int  # degrees of freedom of the chi-square
    iterations: int  # steps in all
    last_step: float  # sigmas, largest component of the remaining Newton step: near zero at an optimum
    suspect: bool  # the cost is so high that there may be a lower minimum elsewhere
    robust: bool  # the cost is of a robust loss
    systematic: Systematics | None = None  # the systematic errors, if estimated
    fixes: PoseUpdated | None = None  # of each by itself, against all other data; None: there are none
    closures: PoseUpdated | None = None
    gated: tuple[float, float] | None = None  # mean and variance of chi-square per dof, if measurements were truncated
    # (m, 2) variances of the residuals of observations over those of their noise, principal ones; None: see `optimize`
    residual_share: Array | None = None

    @property
    def total_nis(self) -> tuple[float, int] | None:
        """(chi-square, degrees of freedom), or None under a robust loss."""
        return None if self.robust else (self.cost, self.dof)


class _Found(NamedTuple):
    """End of a search: estimate, half the cost, number of steps; linearized, eliminated, and the remaining step."""

    values: gtsam.Values
    error: float
    iterations: int
    rows: Rows
    triangle: Triangle
    solution: Solution


def _suspect(error: float, problem: Problem) -> bool:
    return 2.0 * error > SUSPECT * max(problem.dof, 1)


def optimize(
    problem: Problem, start: gtsam.Values, *, loss: str = "gaussian", with_shares: bool = False, enough: float = STEP
) -> Smoothed:
    """Minimize from `start`; if that fails, also by way of looser increments, and take the lowest minimum. `loss`: of
    the factors; `with_shares`: of points observed in both coordinates, the shares of noise that residuals keep;
    `enough` [sigma]: a shorter step ends the search. UnderConstrained: names a variable; NotConvergedError: no optimum.
    """
    linearizer = Linearizer(problem)
    best = _descend(linearizer, start, enough=enough)
    iterations = best.iterations
    short = CONVERGED * math.sqrt(3 * len(linearizer.structure.variable))
    # a wrong closure costs much at every minimum
    if best.solution.length > short or (_suspect(best.error, problem) and not problem.pose_factors):
        for share in SLACK:
            first = _descend(Linearizer(problem.loosened(share)), start, enough=1.0)
            second = _descend(linearizer, first.values, enough=enough)
            iterations += first.iterations + second.iterations
            if second.error < best.error * (1.0 - ERROR_ROUNDING):
                best = second
    if best.solution.length > FAILED * math.sqrt(3 * len(linearizer.structure.variable)):
        for search in SEARCHES:
            other = _descend(linearizer, _searched(problem, best.values, *search), enough=enough)
            iterations += other.iterations
            if other.error < best.error * (1.0 - ERROR_ROUNDING) or other.solution.length < best.solution.length:
                best = other
            if best.solution.length < short:
                break
    return _smoothed(problem, linearizer, best, iterations, loss, with_shares=with_shares)


def _descend(linearizer: Linearizer, values: gtsam.Values, *, enough: float = STEP) -> _Found:
    """Gauss-Newton steps, each shortened until the cost falls, until one is short `enough` or none descends."""
    error, before, first = linearizer.cost(values), math.inf, 1.0
    rounding = ROUNDING * math.sqrt(3 * len(linearizer.structure.variable))
    past, extrapolates, drop = list[tuple[Array, Array]](), linearizer.extrapolates, 0.0
    for step in range(MOST + 1):
        rows = linearizer(values)
        triangle = eliminate(rows, linearizer.structure)
        if triangle.free >= 0:
            raise UnderConstrained(f"{linearizer.name(triangle.free)} is not determined by the observations")
        solution = solve(rows, linearizer.structure, triangle, linearizer.constants(values))
        left = solution.length
        if left < enough or SHRANK * before < left < rounding or step == MOST:
            break
        # below the resolution of the cost, a step that grew went too far: large residuals bend the valley
        resolved = extrapolates and drop > ERROR_ROUNDING * (1.0 + error)
        if left > before and left < 1.0 and not resolved:
            first *= 0.5
        elif left < 0.1 * before:
            first = min(1.0, 2.0 * first)
        delta = linearizer.step(linearizer.tangent(solution, values), solution.constants)
        if extrapolates:
            past = [*past, linearizer.flat(values, linearizer.moved(values, delta))][-DEPTH:]
        for share, moved in _trials(linearizer, values, delta, first, past):
            moved_error = linearizer.cost(moved)
            limit = error - ARMIJO * share * (1.0 - 0.5 * share) * left**2 + ERROR_ROUNDING * (1.0 + error)
            if moved_error <= limit:
                break
            past = past[-1:]
        else:
            break
        values, error, before, drop = moved, moved_error, left, error - moved_error
    return _Found(values, error, step, rows, triangle, solution)


def _trials(
    linearizer: Linearizer, values: gtsam.Values, delta: gtsam.VectorValues, first: float,
    past: Sequence[tuple[Array, Array]],
) -> Iterator[tuple[float, gtsam.Values]]:  # fmt: skip
    """Next estimates to try, and their share of a step: extrapolated, then from `first` on shorter and shorter."""
    extrapolated = mixture(past)
    if extrapolated is not None:
        yield 1.0, linearizer.unflat(extrapolated, values)
    share = first
    while share > SHORTEST:
        yield share, linearizer.moved(values, delta.scale(share))
        share *= 0.5


def _searched(problem: Problem, values: gtsam.Values, optimizer: Any, parameters: Any) -> gtsam.Values:
    """The end of a search of gtsam, or its start where that stops; systematic errors have no graph of their own."""
    if problem.motion.names:
        return values
    parameters.setLinearSolverType("MULTIFRONTAL_QR")
    parameters.setMaxIterations(FURTHER)
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(0.0)
    try:
        found: gtsam.Values = optimizer(problem.graph(), values, parameters).optimize()
    except RuntimeError:  # an indeterminate system: its message names no more than our own search does
        return values
    return found


def _smoothed(
    problem: Problem, linearizer: Linearizer, found: _Found, iterations: int, loss: str, *, with_shares: bool
) -> Smoothed:
    """The end of a search with covariances. Raises `NotConvergedError` if it is no optimum."""
    n = linearizer.frames
    ties = np.array([p.frames for p in problem.pose_factors if p.closure], np.int64).reshape(-1, 2)
    blocks = n + np.arange(len(problem.observations) if with_shares else 0)
    seen = found.rows.variable[blocks, :2]
    pairs = np.concatenate([ties, seen])
    covariance, across = covariances(found.rows, linearizer.structure, found.triangle, found.solution, pairs)
    kept = left_by(found.rows.A[blocks, :, :6], covariance, seen, across[len(ties) :]) if with_shares else None
    across = across[: len(ties)]
    fixes, closures = innovations(problem.pose_factors, found.rows, linearizer.of_poses, covariance, across, loss)
    root = linearizer.first(found.values)[2]
    covariance[0] = root @ covariance[0] @ root.T
    delta = linearizer.tangent(found.solution, found.values)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), TINY**2))
    share = np.abs(delta) / sigma
    of_errors = np.abs(found.solution.constants) / np.sqrt(np.diag(found.solution.covariance))
    last_step = float(max(share.max(), of_errors.max(initial=0.0)))
    if not last_step < FAILED:
        variable = int(share.max(axis=1).argmax())
        weakest = int(sigma[: n + len(linearizer.numbers), :2].max(axis=1).argmax())
        raise NotConvergedError(
            f"the optimization did not converge: after {iterations} steps {last_step:.2g} sigma are left at "
            f"{linearizer.name(variable)}, cost {2.0 * found.error:.6g} for {problem.dof} degrees of freedom; "
            f"weakest is {linearizer.name(weakest)}, sigma {sigma[weakest, :2].max():.3g} m"
            f"{_on_the_robot(problem, found.values)}"
        )
    state = None
    if not problem.known_map:
        xy = np.array([found.values.atPoint2(L(k)) for k in linearizer.numbers.tolist()]).reshape(-1, 2)
        state = MapState(linearizer.numbers, xy, covariance[n : n + len(xy), :2, :2])
    path, state, errors = _in_world(problem.motion, found, poses_of(found.values, n), covariance, state)
    if state is not None and problem.about is not None:
        state = MapState(state.number, *about_origin(state.xy, state.covariance, problem.about))
    effort = iterations, last_step, _suspect(found.error, problem), loss != "gaussian"
    return Smoothed(path, state, 2.0 * found.error, problem.dof, *effort, errors, fixes, closures, residual_share=kept)


def _in_world(
    motion: Motion, found: _Found, pose: Array, covariance: Array, state: MapState | None
) -> tuple[Trajectory, MapState | None, Systematics | None]:
    """Path, map and errors in the world; `covariance` (V, 3, 3): poses in body frames, landmarks, drifts."""
    n, solution, errors = len(pose), found.solution, motion.errors(found.values)
    sigma, at = motion.sigma, motion.constant
    of_errors = solution.covariance * np.outer(sigma[at], sigma[at])
    across = -solution.columns @ (solution.covariance * sigma[at])
    out, J = motion.frame.poses_out(pose, errors)
    of_path = _joint(covariance[:n], across[:n], of_errors)
    J = J[:, :, np.concatenate([np.arange(3), 3 + at])]  # from the body to the sensor's world, then to the robot's
    J[:, :, :3] = J[:, :, :3] @ worlds_from_bodies(pose[:, 2])
    world = J @ of_path @ J.transpose(0, 2, 1)
    world[:1] = covariances_in_world(out[:1, 2], covariance[:1])
    path = Trajectory(out, 0.5 * (world + world.transpose(0, 2, 1)))
    if state is not None:
        rows = slice(n, n + len(state.number))
        xy, scale, by_errors = motion.frame.points_out(state.xy, errors[-1])
        joint = _joint(state.covariance, across[rows, :2], of_errors)
        J = np.concatenate([np.tile(scale * np.eye(2), (len(xy), 1, 1)), by_errors[:, :, at]], axis=2)
        state = MapState(state.number, xy, J @ joint @ J.transpose(0, 2, 1))
    if not motion.names:
        return path, state, None
    deviation = np.empty_like(errors)
    deviation[:, at] = np.sqrt(np.diag(of_errors))
    if motion.knots:
        deviation[:, motion.drift] = np.sqrt(covariance[-motion.knots :, 0, 0])[motion.of] * sigma[motion.drift]
    return path, state, Systematics(motion.names, errors, deviation)


def _joint(own: Array, across: Array, of_errors: Array) -> Array:
    """Joint covariances (n, d + q, d + q) of n variables with the constant errors."""
    n, d, q = across.shape
    joint = np.empty((n, d + q, d + q))
    joint[:, :d, :d], joint[:, d:, d:] = own, of_errors
    joint[:, :d, d:], joint[:, d:, :d] = across, across.transpose(0, 2, 1)
    return joint


def _on_the_robot(problem: Problem, values: gtsam.Values) -> str:
    """A likely reason: a landmark that converged to the robot's position, where its bearing is singular."""
    for s in problem.observations:
        if s.key is not None and problem.about is None:
            gap = float(np.hypot(*(values.atPoint2(s.key) - values.atPose2(X(s.frame)).translation())))
            if gap < ON_THE_ROBOT:
                return f"; landmark {s.number} is only {gap:.1g} m from the robot at frame {s.frame}"
    return ""


def poses_of(values: gtsam.Values, n: int) -> Array:
    """Poses (n, 3) of frames 0 ... n - 1."""
    return np.array([pose_array(values.atPose2(X(k))) for k in range(n)])


def in_world(pose: Array, covariance: Array) -> Array:
    """Body-frame covariances (N, 3, 3) of poses (N, 3) turned into the world frame."""
    world = covariances_in_world(pose[:, 2], covariance)
    return 0.5 * (world + world.transpose(0, 2, 1))
