"""Uncertainty between key poses along the shortest paths of the graph (Olson 2009, section 3), and a variance scale.

The variance scale of scan-matching covariances is learned from the residuals of loop closures.
"""

import heapq
import math
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import gammaln

from data.compiled import njit
from data.inputs import IntArray
from data.motion.velocity import compose_in_place
from data.se2 import Array, BoolArray, between, pose_error

AnyArray = TypeVar("AnyArray", Array, IntArray)

LEVER = 2.0  # m, weight of a heading error when paths are compared: the typical range of a scan


class PoseEdges:
    """A growing list of relative poses between key poses; `project` gives uncertainties over them."""

    def __init__(self) -> None:
        self._count = 0
        self._keys = np.zeros((64, 2), np.int64)
        self._relative = np.zeros((64, 3))
        self._covariance = np.zeros((64, 3, 3))
        self._next = np.zeros((64, 2), np.int64)
        self._head = np.full(64, -1, np.int64)
        self._work = _work(64)

    def add(self, key1: int, key2: int, relative: Array, covariance: Array) -> None:
        """Pose (3,) of key2 in the frame of key1, covariance (3, 3) of its additive error."""
        e = self._count
        if e == len(self._keys):
            self._keys, self._next = _doubled(self._keys), _doubled(self._next)
            self._relative, self._covariance = _doubled(self._relative), _doubled(self._covariance)
        while max(key1, key2) >= len(self._head):
            self._head = np.concatenate([self._head, np.full(len(self._head), -1, np.int64)])
        self._keys[e] = key1, key2
        self._relative[e], self._covariance[e] = relative, covariance
        self._next[e] = self._head[key1], self._head[key2]
        self._head[key1] = self._head[key2] = e
        self._count += 1

    def project(self, root: int, wanted: IntArray) -> Array:
        """Covariances (W, 3, 3) of the poses of `wanted` keys (W,) in the frame of `root`, infinite where there is no
        path. It ends when these are known: what others cost is not paid. Each is propagated along the path of least
        summed variance (Dijkstra 1959): an upper bound of the covariance by all paths together.
        """
        keys = len(self._head)
        if keys > len(self._work.cost):
            self._work = _work(keys)
        edges = (self._head, self._next, self._keys, self._relative, self._covariance)
        return _project(root, wanted, *edges, self._work)


class Work(NamedTuple):
    """Arrays by key that every search finds clean, and leaves clean: their size is no cost of a search."""

    result: Array
    pose: Array
    done: BoolArray
    cost: Array
    edge: IntArray
    asked: BoolArray


def _work(keys: int) -> Work:
    return Work(
        np.full((keys, 3, 3), np.inf), np.zeros((keys, 3)), np.zeros(keys, np.bool_), np.full(keys, np.inf),
        np.full(keys, -1, np.int64), np.zeros(keys, np.bool_),
    )  # fmt: skip


def compose_covariances(pose: Array, covariance: Array, motion: Array, motion_covariance: Array) -> Array:
    """Covariance (3, 3) of `compose(pose, motion)`, additive errors, to first order (Smith, Self, Cheeseman 1990)."""
    out, out_pose = np.empty((3, 3)), np.empty(3)
    # copies: read-only arrays would compile the kernel once more
    pose, covariance, motion, M = (np.array(a, float) for a in (pose, covariance, motion, motion_covariance))
    compose_in_place(pose, covariance, motion, M, out_pose, out)
    return out


def inverse_covariance(pose: Array, covariance: Array) -> Array:
    """Covariance (3, 3) of `inverse(pose)`, additive errors, to first order."""
    out, out_pose = np.empty((3, 3)), np.empty(3)
    _invert(pose, covariance, out_pose, out)
    return out


def _doubled(array: AnyArray) -> AnyArray:
    return np.concatenate([array, np.zeros_like(array)])


@njit
def _project(
    root: int, wanted: IntArray, head: IntArray, following: IntArray, ends: IntArray, relative: Array,
    covariance: Array, work: Work,
) -> Array:  # fmt: skip
    result, pose, done, cost, edge, asked = work
    cost[root] = 0.0
    heap = [(0.0, root)]
    touched = [root]
    left = 0
    for k in wanted:
        left += not asked[k]
        asked[k] = True
    z = np.zeros(3)
    C = np.zeros((3, 3))
    while len(heap) > 0:
        so_far, a = heapq.heappop(heap)
        if done[a]:
            continue
        done[a] = True
        e = edge[a]
        if e < 0:
            result[a] = 0.0
        elif ends[e, 1] == a:
            b = ends[e, 0]
            compose_in_place(pose[b], result[b], relative[e], covariance[e], pose[a], result[a])
        else:
            b = ends[e, 1]
            _invert(relative[e], covariance[e], z, C)
            compose_in_place(pose[b], result[b], z, C, pose[a], result[a])
        if asked[a]:
            left -= 1
            if left == 0:
                break
        e = head[a]
        while e >= 0:
            side = 0 if ends[e, 0] == a else 1
            b = ends[e, 1 - side]
            if not done[b]:
                V = covariance[e]
                total = so_far + V[0, 0] + V[1, 1] + LEVER * LEVER * V[2, 2]
                if total < cost[b]:
                    if edge[b] < 0:
                        touched.append(b)
                    cost[b] = total
                    edge[b] = e
                    heapq.heappush(heap, (total, b))
            e = following[e, side]
    found = result[wanted]
    for k in wanted:
        asked[k] = False
    for k in touched:
        result[k], pose[k], done[k], cost[k], edge[k] = np.inf, 0.0, False, np.inf, -1
    return found


@njit
def _invert(pose: Array, covariance: Array, z: Array, C: Array) -> None:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    z[0], z[1], z[2] = -c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2]
    J = ((-c, -s, z[1]), (s, -c, -z[0]), (0.0, 0.0, -1.0))  # J = [-c, -s, z1; s, -c, -z0; 0, 0, -1]
    for i in range(3):
        u0 = J[i][0] * covariance[0, 0] + J[i][1] * covariance[1, 0] + J[i][2] * covariance[2, 0]
        u1 = J[i][0] * covariance[0, 1] + J[i][1] * covariance[1, 1] + J[i][2] * covariance[2, 1]
        u2 = J[i][0] * covariance[0, 2] + J[i][1] * covariance[1, 2] + J[i][2] * covariance[2, 2]
        for j in range(3):
            C[i, j] = u0 * J[j][0] + u1 * J[j][1] + u2 * J[j][2]


def nearest_first(keys: IntArray, distance: Array, apart: int, most: int) -> IntArray:
    """Of ascending keys (K,) those of the smallest finite distances (K,): at most `most`, no two within `apart`."""
    chosen: list[int] = []
    for i in np.argsort(distance, kind="stable"):
        key = int(keys[i])
        if len(chosen) == most or not np.isfinite(distance[i]):
            break
        if all(abs(key - c) >= apart for c in chosen):
            chosen.append(key)
    return np.array(chosen, np.int64)


DOF = 3
TAILS = np.geomspace(2.5, 200.0, 40)  # degrees of freedom of Student's t that are tried


def residuals(poses: Array, key1: IntArray, key2: IntArray, relative: Array, covariance: Array) -> Array:
    """Squared Mahalanobis distances (E,) of relative poses (E, 3) with covariances (E, 3, 3) from key poses (K, 3)."""
    error = pose_error(between(poses[key1], poses[key2]), relative)
    return np.asarray(np.einsum("ki,ki->k", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]))


def spanned(keys: int, key1: IntArray, key2: IntArray) -> BoolArray:
    """Which chain steps (K - 1,) lie between the key poses of some loop closure key1 -> key2. The others have a zero
    residual at the optimum, whatever their errors, and carry no information about a scale.
    """
    ends = np.zeros(keys, np.int64)
    np.add.at(ends, np.minimum(key1, key2), 1)
    np.add.at(ends, np.maximum(key1, key2), -1)
    return np.cumsum(ends)[:-1] > 0


def learned_scale(d2: Array, closures: int) -> tuple[float, float]:
    """Variance scale of a pose graph, and its standard error.

    `d2` (E,) are the `residuals`, at the optimum, of its loop closures and of the steps that they span; `closures` of
    them are loop closures. The optimum leaves closures / E of each one's variance, on average. A Student's t of three
    dimensions models the heavy tails (Lange, Little, Taylor 1989), its degrees of freedom by likelihood. The scale is
    that of its covariance, the standard error from the Fisher information. Raises ValueError without loop closures.
    """
    if closures < 1 or len(d2) < closures:
        raise ValueError("a variance scale needs loop closures: a chain alone has no residuals")
    d2 = np.asarray(d2, float) * (len(d2) / closures)
    best = (-math.inf, 1.0, 1.0)
    for nu in TAILS:
        scale = float(np.median(d2)) / DOF + 1e-300
        for _ in range(200):
            new = float(np.mean((nu + DOF) / (nu + d2 / scale) * d2)) / DOF
            done = abs(new - scale) <= 1e-10 * scale
            scale = new
            if done:
                break
        constant = gammaln(0.5 * (nu + DOF)) - gammaln(0.5 * nu) - 0.5 * DOF * math.log(nu * scale)
        likelihood = float(np.sum(constant - 0.5 * (nu + DOF) * np.log1p(d2 / (nu * scale))))
        best = max(best, (likelihood, float(nu), scale))
    _, nu, scale = best
    factor = scale * nu / (nu - 2.0)
    return factor, factor * math.sqrt(2.0 * (nu + DOF + 2.0) / (len(d2) * DOF * nu))
