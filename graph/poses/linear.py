"""A pose graph linearized, as the rows that `graph.linear.elimination` takes; unknowns are poses [x, y, theta] (world).

The error of a relative pose is gtsam's, so that all smoothers have the same optimum: the logarithm (so that it is the
same seen from either end) of measured^-1 . estimated, in the frame of the end. To first order that is the additive
error, turned there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba
import numpy as np

from data.inputs import IntArray, Prior
from data.se2 import Array, pose_error
from data.sensors import wrap_angle
from graph.linear.elimination import Rows, Triangle, eliminate
from graph.linear.marginals import marginals, means
from graph.linear.ordering import ordering
from graph.linear.rows import EXACT, put_prior
from graph.linear.symbolic import Structure, structure
from graph.poses.factors import roots_at_end


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """Prior, chain and loop closures over K key poses.

    Attributes:
        prior: on key pose 0; zero covariance is allowed.
        key1, key2: (E,) ends of the edges: the K - 1 of the chain, then the L loop closures.
        relative: (E, 3) pose of key2 in the frame of key1, as measured.
        root: (E, 3, 3) roots of the information, in the frame of key2.
        loops: L.
        structure: of the elimination.
    """

    prior: Prior
    key1: IntArray
    key2: IntArray
    relative: Array
    root: Array
    loops: int
    structure: Structure = field(repr=False)

    @property
    def keys(self) -> int:
        """How many key poses there are."""
        return len(self.key1) - self.loops + 1

    @property
    def dof(self) -> int:
        """Degrees of freedom of the chi-square: the chain alone has none."""
        return 3 * self.loops

    def residuals(self, pose: Array) -> Array:
        """Whitened residuals (E, 3) of all edges at poses (K, 3)."""
        residual: Array = _residuals(pose, self.key1, self.key2, self.relative, self.root)
        return residual

    def prior_residual(self, pose: Array) -> tuple[Array, Array, Array]:
        """Start (3,), z (3,) and U (3, 3): the first pose is pose[0] + start + U w, where z + w ~ N(0, I).

        The start is zero unless `pose` contradicts what the prior knows exactly.
        """
        variance, axes = np.linalg.eigh(self.prior.covariance)
        sigma = np.sqrt(np.where(variance > EXACT * variance[-1], variance, 0.0))
        off = axes.T @ pose_error(pose[0], self.prior.mean)
        z = np.divide(off, sigma, out=np.zeros(3), where=sigma > 0.0)
        return -axes @ np.where(sigma > 0.0, 0.0, off), z, axes * sigma

    def step(self, pose: Array, weight: Array) -> Newton:
        """The least-squares step at poses (K, 3), loops weighted (L,); raises nothing: the chain determines all."""
        A, b = _linearize(pose, self.key1, self.key2, self.relative, self.root)
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
        return Newton(delta, float(np.sqrt(np.einsum("vic,vic->", triangle.d, triangle.d))), rows, triangle, U)

    def covariances(self, newton: Newton) -> Array:
        """Marginal covariances (K, 3, 3), world frame, additive, where that step was taken."""
        P = marginals(newton.rows, self.structure, newton.triangle)
        P[0] = newton.U @ P[0] @ newton.U.T
        return P


@dataclass(frozen=True, eq=False)
class Newton:
    """A step (K, 3) [m, m, rad] of the poses, its length in sigmas, and what the covariances come from."""

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
    ValueError for a loop closure of a key pose that is not there.
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
    return PoseProblem(prior, first, second, edges, roots, len(key1), _structure(first, second, n))


def _variables(key1: IntArray, key2: IntArray) -> IntArray:
    """Variables (1 + E, 2) of the blocks: the prior's first."""
    prior = np.array([[0, -1]], np.int64)
    return np.concatenate([prior, np.stack([key2, key1], 1)])


def _structure(key1: IntArray, key2: IntArray, keys: int) -> Structure:
    variable = _variables(key1, key2)
    # none of the variables counts as a pose of a bare chain, or their order would be that of one
    return structure(variable, ordering(variable, 0, keys))


@numba.njit(cache=True)
def _error(a, b, m, r):  # type: ignore[no-untyped-def]
    """The logarithm r (3,) of m^-1 a^-1 b; returns what its derivatives are made of."""
    ca, sa, cm, sm = np.cos(a[2]), np.sin(a[2]), np.cos(m[2]), np.sin(m[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    x, y = ca * dx + sa * dy, -sa * dx + ca * dy  # of b in a
    tx, ty = cm * (x - m[0]) + sm * (y - m[1]), -sm * (x - m[0]) + cm * (y - m[1])
    h = 0.5 * wrap_angle(b[2] - a[2] - m[2])
    if abs(h) < 1e-4:
        g, slope = 1.0 - h * h / 3.0, -2.0 * h / 3.0
    else:
        tangent = np.tan(h)
        g = h / tangent
        slope = 1.0 / tangent - h / np.sin(h) ** 2
    r[0], r[1], r[2] = g * tx + h * ty, -h * tx + g * ty, 2.0 * h
    return x, y, tx, ty, g, h, slope


@numba.njit(cache=True)
def _residuals(pose, key1, key2, relative, root):  # type: ignore[no-untyped-def]
    out, r = np.empty((len(key1), 3)), np.empty(3)
    for e in range(len(key1)):
        _error(pose[key1[e]], pose[key2[e]], relative[e], r)
        out[e] = root[e] @ r
    return out


@numba.njit(cache=True)
def _linearize(pose, key1, key2, relative, root):  # type: ignore[no-untyped-def]
    """Rows A (E, 3, 6), columns of key2 before those of key1, and right-hand sides b (E, 3, 1)."""
    A, rhs = np.empty((len(key1), 3, 6)), np.empty((len(key1), 3, 1))
    r, J = np.empty(3), np.empty((3, 6))
    for e in range(len(key1)):
        a, m = pose[key1[e]], relative[e]
        x, y, tx, ty, g, h, slope = _error(a, pose[key2[e]], m, r)
        c, s = np.cos(a[2] + m[2]), np.sin(a[2] + m[2])
        cm, sm = np.cos(m[2]), np.sin(m[2])
        # of (tx, ty, w) by the poses: by the position of b, the heading of b, then of a
        ux, uy = cm * y - sm * x, -sm * y - cm * x  # derivative of (tx, ty) by a's heading
        kx, ky = 0.5 * slope * tx + 0.5 * ty, -0.5 * tx + 0.5 * slope * ty  # of the logarithm by w
        J[0, 0], J[0, 1] = g * c - h * s, g * s + h * c
        J[1, 0], J[1, 1] = -h * c - g * s, -h * s + g * c
        J[0, 2], J[1, 2] = kx, ky
        J[0, 5], J[1, 5] = g * ux + h * uy - kx, -h * ux + g * uy - ky
        J[:2, 3:5] = -J[:2, :2]
        J[2] = np.array([0.0, 0.0, 1.0, 0.0, 0.0, -1.0])
        A[e] = root[e] @ J
        rhs[e, :, 0] = -(root[e] @ r)
    return A, rhs
