"""Batch optimization of a pose graph: the optimum of all constraints with its exact covariances, by sparse QR.

As `graph.optimum` for landmarks: Gauss-Newton steps shortened until the cost falls, with convergence measured in
sigmas. A robust loss is on the norm of the whole whitened residual of a loop closure, by reweighting.

Unknowns are poses [x, y, theta] (world). The error of a relative pose is gtsam's, so that all smoothers have the same
optimum: the logarithm of measured^-1 . estimated, in the frame of the end. To first order that is the additive error,
turned there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numba
import numpy as np

from data.inputs import IntArray, Prior
from data.se2 import Array, pose_error, wrap_angle
from data.sensors import wrap_angle_jit
from graph.anderson import extended, mixture
from graph.factors import CAUCHY, HUBER, LOSSES
from graph.optimum import ARMIJO, ERROR_ROUNDING, FAILED, SHORTEST, SHRANK, STEP, TINY, NotConvergedError
from graph.poses.online import roots_at_end
from graph.qr.elimination import Rows, Structure, Triangle, eliminate, ordering, structure
from graph.qr.rows import EXACT, put_prior
from graph.qr.solution import marginals, means


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """Prior, chain and loop closures over K key poses."""

    prior: Prior  # on key pose 0; zero covariance is allowed
    key1: IntArray  # (E,) ends of the edges, with key2: the K - 1 of the chain, then the L loop closures
    key2: IntArray
    relative: Array  # (E, 3) pose of key2 in the frame of key1, as measured
    root: Array  # (E, 3, 3) roots of the information, in the frame of key2
    loops: int  # L, number of loop closures
    structure: Structure = field(repr=False)  # of the elimination

    @property
    def keys(self) -> int:
        """Number of key poses."""
        return len(self.key1) - self.loops + 1

    @property
    def dof(self) -> int:
        """Degrees of freedom of the chi-square: the chain alone has none."""
        return 3 * self.loops

    def residuals(self, pose: Array) -> Array:
        """Whitened residuals (E, 3) of all edges at poses (K, 3)."""
        residual: Array = _residuals(np.ascontiguousarray(pose), self.key1, self.key2, self.relative, self.root)
        return residual

    def prior_residual(self, pose: Array) -> tuple[Array, Array, Array]:
        """Start (3,), z (3,) and U (3, 3): the first pose is pose[0] + start + U w, where z + w ~ N(0, I). The start is
        zero unless `pose` contradicts an exact direction of the prior.
        """
        variance, axes = np.linalg.eigh(self.prior.covariance)
        sigma = np.sqrt(np.where(variance > EXACT * variance[-1], variance, 0.0))
        off = axes.T @ pose_error(pose[0], self.prior.mean)
        z = np.divide(off, sigma, out=np.zeros(3), where=sigma > 0.0)
        return -axes @ np.where(sigma > 0.0, 0.0, off), z, axes * sigma

    def step(self, pose: Array, weight: Array) -> Newton:
        """The least-squares step at poses (K, 3), loops weighted (L,); the chain determines all variables."""
        A, b = _linearize(np.ascontiguousarray(pose), self.key1, self.key2, self.relative, self.root)
        scale = np.sqrt(weight)
        first = len(b) - self.loops
        A[first:] *= scale[:, None, None]
        b[first:] *= scale[:, None, None]
        variable = _variables(self.key1, self.key2)
        A, b = np.concatenate([np.zeros((1, 3, 6)), A]), np.concatenate([np.zeros((1, 3, 1)), b])
        start, z, U = self.prior_residual(pose)
        put_prior(variable, A, b, start, z, U)
        rows = Rows(variable, A, b, np.full(len(b), 3), np.full(self.keys, 3))
        triangle = eliminate(rows, self.structure)
        delta = means(rows, self.structure, triangle)[:, :, 0]
        delta[0] = start + U @ delta[0]
        return Newton(delta, float(np.linalg.norm(triangle.d)), rows, triangle, U)

    def covariances(self, newton: Newton) -> Array:
        """Marginal covariances (K, 3, 3), world frame, additive, at the poses of that step."""
        P = marginals(newton.rows, self.structure, newton.triangle)
        P[0] = newton.U @ P[0] @ newton.U.T
        return P


@dataclass(frozen=True, eq=False)
class Newton:
    """A step (K, 3) [m, m, rad] of the poses, its length in sigmas, and the elimination for the covariances."""

    delta: Array
    length: float
    rows: Rows = field(repr=False)
    triangle: Triangle = field(repr=False)
    U: Array = field(repr=False)


def pose_problem(
    prior: Prior,
    motion: Array,
    motion_covariance: Array,
    key1: IntArray,
    key2: IntArray,
    relative: Array,
    covariance: Array,
) -> PoseProblem:
    """Chain: motion (K, 3), covariance (K, 3, 3), row 0 unused; loops key1, key2 (L,), relative (L, 3), (L, 3, 3).

    Covariances are of the additive error [m, m, rad] in the frame of key1. Raises DataError for a singular one, and
    ValueError for a loop closure of an unknown key pose.
    """
    n = len(motion)
    ends = np.concatenate([key1, key2]).astype(np.int64)
    if len(ends) and not (ends.min() >= 0 and ends.max() < n):
        raise ValueError(f"a loop closure is between key poses 0 ... {n - 1}")
    chain, _ = roots_at_end(motion[1:], motion_covariance[1:], "motion between key poses")
    loops, _ = roots_at_end(relative, covariance, "loop closure")
    first = np.concatenate([np.arange(n - 1), key1]).astype(np.int64)
    second = np.concatenate([np.arange(1, n), key2]).astype(np.int64)
    edges = np.concatenate([motion[1:], relative])
    roots = np.concatenate([chain, loops])
    variable = _variables(first, second)
    # no variable counts as a pose of a bare chain, whose order would be another one
    s = structure(variable, np.full(n, 3), ordering(variable, 0, n))
    return PoseProblem(prior, first, second, edges, roots, len(key1), s)


def _variables(key1: IntArray, key2: IntArray) -> IntArray:
    """Variables (1 + E, 2) of the blocks: the prior's first."""
    return np.concatenate([np.array([[0, -1]], np.int64), np.stack([key2, key1], 1)])


@numba.njit(cache=True)
def _error(a: Array, b: Array, m: Array, r: Array) -> tuple[float, float, float, float, float, float, float]:
    """The logarithm r (3,) of m^-1 a^-1 b; returns the terms of its derivatives."""
    ca, sa, cm, sm = np.cos(a[2]), np.sin(a[2]), np.cos(m[2]), np.sin(m[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    x, y = ca * dx + sa * dy, -sa * dx + ca * dy  # of b in a
    tx, ty = cm * (x - m[0]) + sm * (y - m[1]), -sm * (x - m[0]) + cm * (y - m[1])
    h = 0.5 * wrap_angle_jit(b[2] - a[2] - m[2])
    if abs(h) < 1e-4:
        g, slope = 1.0 - h * h / 3.0, -2.0 * h / 3.0
    else:
        tangent = np.tan(h)
        g = h / tangent
        slope = 1.0 / tangent - h / np.sin(h) ** 2
    r[0], r[1], r[2] = g * tx + h * ty, -h * tx + g * ty, 2.0 * h
    return x, y, tx, ty, g, h, slope


@numba.njit(cache=True)
def _residuals(pose: Array, key1: IntArray, key2: IntArray, relative: Array, root: Array) -> Array:
    out, r = np.empty((len(key1), 3)), np.empty(3)
    for e in range(len(key1)):
        _error(pose[key1[e]], pose[key2[e]], relative[e], r)
        for i in range(3):
            out[e, i] = root[e, i, 0] * r[0] + root[e, i, 1] * r[1] + root[e, i, 2] * r[2]
    return out


@numba.njit(cache=True)
def _linearize(pose: Array, key1: IntArray, key2: IntArray, relative: Array, root: Array) -> tuple[Array, Array]:
    """Rows A (E, 3, 6), columns of key2 before those of key1, and right-hand sides b (E, 3, 1)."""
    A, rhs = np.empty((len(key1), 3, 6)), np.empty((len(key1), 3, 1))
    r, J = np.empty(3), np.zeros((3, 6))
    J[2, 2], J[2, 5] = 1.0, -1.0
    for e in range(len(key1)):
        a, m = pose[key1[e]], relative[e]
        x, y, tx, ty, g, h, slope = _error(a, pose[key2[e]], m, r)
        c, s = np.cos(a[2] + m[2]), np.sin(a[2] + m[2])
        cm, sm = np.cos(m[2]), np.sin(m[2])
        # derivatives of (tx, ty, w): by the position of b, the heading of b, then of a
        ux, uy = cm * y - sm * x, -sm * y - cm * x  # derivative of (tx, ty) by a's heading
        kx, ky = 0.5 * slope * tx + 0.5 * ty, -0.5 * tx + 0.5 * slope * ty  # of the logarithm by w
        J[0, 0], J[0, 1] = g * c - h * s, g * s + h * c
        J[1, 0], J[1, 1] = -h * c - g * s, -h * s + g * c
        J[0, 2], J[1, 2] = kx, ky
        J[0, 5], J[1, 5] = g * ux + h * uy - kx, -h * ux + g * uy - ky
        for i in range(2):
            J[i, 3], J[i, 4] = -J[i, 0], -J[i, 1]
        for i in range(3):
            rhs[e, i, 0] = -(root[e, i, 0] * r[0] + root[e, i, 1] * r[1] + root[e, i, 2] * r[2])
            for j in range(6):
                A[e, i, j] = root[e, i, 0] * J[0, j] + root[e, i, 1] * J[1, j] + root[e, i, 2] * J[2, j]
    return A, rhs


CUT = 30.0
"""sigma. From Cauchy's optimum on, a loop closure further off has no weight. There it has a pull of 3 % of a sigma, but
two hundred false ones add up: in grids of corridors with as many false loop closures as true ones they changed the
path's error by up to a third, cut by less than 2 %. Cut at 10, true ones were lost, too."""
MOST = 400  # steps of one search. With a robust loss 50 to 150 are usual
ROUNDING = 1e-5  # sigma. A step that hardly shrank and is shorter than this, for each direction, ends the search


Loss = Callable[[Array], tuple[Array, Array]]  # squared residuals (L,) to twice the losses, weights


@dataclass(frozen=True, eq=False)
class SmoothedPoses:
    """The optimum of a pose graph."""

    pose: Array  # (K, 3), world frame
    covariance: Array  # (K, 3, 3), world frame, additive; of the information as weighted
    weight: Array  # (L,) of each loop closure, 0: left out, 1: trusted
    cost: float  # twice the sum of all losses; without a robust one the chi-square
    dof: int  # its degrees of freedom
    iterations: int  # steps in all
    last_step: float  # sigmas, largest component of the remaining step


def smooth_poses(problem: PoseProblem, start: Array, *, loss: str = "gaussian") -> SmoothedPoses:
    """The optimum reached from poses `start` (K, 3); `loss` (gaussian, huber, cauchy) is on loop closures only. Raises
    `NotConvergedError` if none was reached, ValueError for an unknown loss or a start that is not finite.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss {loss!r}; known: {', '.join(LOSSES)}")
    if start.shape != (problem.keys, 3) or not np.isfinite(start).all():
        raise ValueError("start: not a finite pose for every key pose")
    found = descend(problem, start, KERNELS[loss])
    if loss == "cauchy":
        first = found[-1]
        found = descend(problem, found[0], _cauchy_cut)
        return finished(problem, *found[:-1], first + found[-1])
    return finished(problem, *found)


def descend(problem: PoseProblem, pose: Array, loss: Loss) -> tuple[Array, Array, Newton, float, int]:
    """Steps from poses (K, 3), until one is short or none descends. Returns poses, weights of the loops (L,), the
    remaining step, the cost, and the number of steps.
    """
    cost, weight = evaluate(problem, pose, loss)
    before, rounding = math.inf, ROUNDING * math.sqrt(3 * problem.keys)
    past: list[tuple[Array, Array]] = []
    for count in range(MOST + 1):
        newton = problem.step(pose, weight)
        left = newton.length
        if left < STEP or SHRANK * before < left < rounding or count == MOST:
            break
        past = extended(past, pose, newton.delta)
        for share, moved in _trials(past):
            moved_cost, moved_weight = evaluate(problem, moved, loss)
            promised = share * (2.0 - share) * left**2
            if moved_cost <= cost - ARMIJO * promised + ERROR_ROUNDING * (1.0 + cost):
                break
            if share < 1.0:
                past = past[-1:]
        else:
            break
        pose, cost, weight, before = moved, moved_cost, moved_weight, left
    return pose, weight, newton, cost, count


def _trials(past: Sequence[tuple[Array, Array]]) -> Iterator[tuple[float, Array]]:
    """Next poses to try, and their share of a step: extrapolated, in full, then shorter and shorter."""
    pose, delta = past[-1]
    extrapolated = mixture(past)
    if extrapolated is not None:
        yield 1.0, extrapolated
    share = 1.0
    while share > SHORTEST:
        yield share, pose + share * delta
        share *= 0.5


def evaluate(problem: PoseProblem, pose: Array, loss: Loss) -> tuple[float, Array]:
    """Twice the sum of all losses at poses (K, 3), and the weights (L,) of the loop closures there."""
    square = (problem.residuals(pose) ** 2).sum(axis=1)
    first = problem.keys - 1
    _, z, _ = problem.prior_residual(pose)
    cost, weight = loss(square[first:])
    return float(square[:first].sum() + z @ z) + float(cost.sum()), weight


def _gaussian(square: Array) -> tuple[Array, Array]:
    return square, np.ones(len(square))


def _huber(square: Array) -> tuple[Array, Array]:
    length = np.sqrt(np.maximum(square, HUBER**2))
    return np.where(square > HUBER**2, HUBER * (2.0 * length - HUBER), square), HUBER / length


def _cauchy(square: Array) -> tuple[Array, Array]:
    share = square / CAUCHY**2
    return CAUCHY**2 * np.log1p(share), 1.0 / (1.0 + share)


def _cauchy_cut(square: Array) -> tuple[Array, Array]:
    cost, weight = _cauchy(np.minimum(square, CUT**2))
    return cost, np.where(square > CUT**2, 0.0, weight)


KERNELS: dict[str, Loss] = {"gaussian": _gaussian, "huber": _huber, "cauchy": _cauchy}


def finished(
    problem: PoseProblem,
    pose: Array,
    weight: Array,
    newton: Newton,
    cost: float,
    iterations: int,
    dof: int | None = None,
) -> SmoothedPoses:
    """The end of a search with covariances; raises `NotConvergedError` if it is no optimum."""
    dof = problem.dof if dof is None else dof
    covariance = problem.covariances(newton)
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), TINY**2))
    share = np.abs(newton.delta) / sigma
    last_step = float(share.max())
    if not last_step < FAILED:
        raise NotConvergedError(
            f"the optimization did not converge: after {iterations} steps {last_step:.2g} sigma are left at key pose "
            f"{int(share.max(axis=1).argmax())}, cost {cost:.6g} for {dof} degrees of freedom"
        )
    pose = np.column_stack([pose[:, :2], wrap_angle(pose[:, 2])])
    return SmoothedPoses(pose, covariance, weight, cost, dof, iterations, last_step)
