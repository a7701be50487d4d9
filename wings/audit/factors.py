"""Per factor: leverage, redundancy, the test of its deleted residual, reliability and influence.

With the joint covariance Sigma of a factor's variables, its leverage is H = A Sigma A' and its redundancy R = I - w H,
w the weight of a robust noise. Predicted from all other factors, its residual is R^-1 r with covariance
(I + (1 - w) H) R^-1, so that

    T = r' (I + (1 - w) H)^-1 R^-1 r ~ chi2(rank R)

is its NIS without itself (Baarda, "A testing procedure for use in geodetic networks", 1968; Cook and Weisberg,
"Residuals and influence in regression", 1982, section 2.2). Where R is singular nothing else sees the factor: T is
taken on the rest.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
from scipy import special
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from data.inputs import IntArray
from data.se2 import Array
from data.tails import least_of, log_tail
from wings.audit.linear import PART, Factored, forward, joint_covariances, solved, step

UNSEEN = 1e-6  # redundancy of a direction below which an error in it is not seen; leverages are accurate to 1e-9
UNCHECKED = 0.05  # share of its dimension below which the redundancy of a factor checks nothing
SIGNIFICANCE, POWER = 1e-3, 0.8  # of the smallest error that is found (Baarda 1968)
INEXACT, BRIEF = 1e-9, 1e-6
"""Error of the sum of all redundancies, to the degrees of freedom, beyond which leverages are redone; where only a
report's ten worst factors are wanted."""
QUICK = 2e5  # fronts times rows up to which they are taken by rows at once
BUDGET = 3e8  # factors times coefficients up to which the influence of every factor is solved for
WORST, LEAST = 768, 20  # factors whose influence is solved for beyond that: those of most motion, and of least p


@dataclass(frozen=True, eq=False)
class Directions:
    """Leverage of a group's factors in its principal directions."""

    h: Array  # (n, d) eigenvalues of H
    V: Array  # (n, d, d) eigenvectors, in columns
    r: Array  # (n, d) residual at the minimum of the linearized problem
    weight: Array  # (n,)
    joint: Array  # (n, c, c) covariance of the variables

    @property
    def R(self) -> Array:
        """Redundancy (n, d) of each direction, zero where an error is not seen."""
        R = 1.0 - self.weight[:, None] * self.h
        return np.asarray(np.where(R > UNSEEN, R, 0.0))

    def tested(self, r: Array) -> Array:
        """T of residuals (n, d, c), for each of c draws: (n, c)."""
        return np.asarray(np.einsum("nd,ndc->nc", self.gain, np.matmul(self.V.transpose(0, 2, 1), r) ** 2))

    @property
    def gain(self) -> Array:
        """T per squared residual (n, d) of each direction."""
        R = self.R
        return np.divide(1.0, R * (1.0 + (1.0 - self.weight[:, None]) * self.h), out=np.zeros_like(R), where=R > 0.0)


@dataclass(frozen=True, eq=False)
class Tested:
    """Statistics of each factor of the graph, NaN in empty slots: arrays (F,)."""

    dim: IntArray  # number of residuals
    chi2: Array  # squared norm of the whitened residual at the values
    redundancy: Array  # trace of R, the share of its dimension that others check
    deleted: Array  # T, NaN where nothing is seen, as log_p
    rank: IntArray  # degrees of freedom of T
    log_p: Array  # logarithm of its p value
    minimal_error: Array  # in sigmas, that the test finds with 80 % power at 0.1 %, in its worst seen direction
    weight: Array  # of a robust noise
    moved: Array  # m, how far the worst point moves without the factor, among all points where affordable, else its own
    missed: Array  # m, how far a just missed error moves the worst of its own points
    cost: Array  # decrease of the sum of squares without the factor


def directions(f: Factored, inexact: float = INEXACT) -> list[Directions]:
    """Leverages of all factors, by group."""
    joint, x = joint_covariances(f), step(f)
    out = []
    for g, C in zip(f.system.groups, joint, strict=True):
        H = np.matmul(np.matmul(g.A, C), g.A.transpose(0, 2, 1))
        h, V = np.linalg.eigh(0.5 * (H + H.transpose(0, 2, 1)))
        out.append(Directions(h, V, g.r + np.einsum("ndc,nc->nd", g.A, x[f.index(g)]), g.weight, C))
    total = sum(float(np.sum(1.0 - each.weight[:, None] * each.h)) for each in out)
    freedom = f.system.rows - f.rank
    quick = inexact == INEXACT and len(f.structure.parent) * f.system.rows < QUICK
    if quick or abs(total - freedom) > inexact * max(1, freedom):
        out = [_by_rows(f, k, each) for k, each in enumerate(out)]
    return out


def _by_rows(f: Factored, k: int, rough: Directions) -> Directions:
    """Leverages as squares of the rows of the orthogonal factor: exact where the variances are huge."""
    g, index = f.system.groups[k], f.index(f.system.groups[k])
    n, d, c = g.A.shape
    H = np.empty((n, d, d))
    for first in range(0, n, max(1, PART // max(d, 1))):
        part = np.arange(first, min(n, first + max(1, PART // max(d, 1))))
        right = np.zeros((f.columns, len(part), d))
        for j in range(c):
            right[index[part, j], np.arange(len(part))] += g.A[part][:, :, j]
        y = forward(f, right.reshape(f.columns, -1)).reshape(f.columns, len(part), d)
        H[part] = np.einsum("xnd,xne->nde", y, y)
    h, V = np.linalg.eigh(H)
    return replace(rough, h=h, V=V)


@cache
def noncentrality(rank: int) -> float:
    """Noncentrality of a chi-square of `rank` that is found with power 80 % at 0.1 %; 17.07 for rank 1."""
    gate = special.chdtri(rank, SIGNIFICANCE)
    return float(brentq(lambda v: 1.0 - special.chndtr(gate, rank, v) - POWER, 1e-3, 1e3))


def holm(log_p: Array, weight: Array | None = None, share: Array | None = None) -> Array:
    """Family-wise p values of those known, weighted (Holm, Scandinavian Journal of Statistics 6, 1979); NaN stays. All
    are logarithms (K,): they rank where p values are 0. weight (K,): parts of the level, of any sum; share (K,):
    independent tests over all tests of a kind, as each other's residuals tell of the same errors.
    """
    out = np.full(log_p.shape, np.nan)
    at = np.flatnonzero(~np.isnan(log_p))
    part = np.ones(len(at)) if weight is None else weight[at]
    few = np.ones(len(at)) if share is None else share[at]
    order = np.argsort(log_p[at] + np.log(few / part), kind="stable")
    at, part, few = at[order], part[order], few[order]
    left = np.maximum(few * np.cumsum(part[::-1])[::-1] / part, 1.0)
    steps = np.where(few < 1.0, least_of(log_p[at], left), np.minimum(log_p[at] + np.log(left), 0.0))
    out[at] = np.maximum.accumulate(steps)
    return out


def examine(f: Factored, seen: Sequence[Directions], metres: Sequence[IntArray]) -> Tested:
    """Statistics of all factors. `metres`: per variable, the components that are a position in m."""
    size = f.system.size
    arrays: dict[str, Any] = {each.name: np.full(size, np.nan) for each in fields(Tested)}
    out = Tested(**arrays | {name: np.zeros(size, np.int64) for name in ("dim", "rank")})
    for g, s in zip(f.system.groups, seen, strict=True):
        i, R, w = g.factor, s.R, s.weight[:, None]
        out.dim[i], out.chi2[i], out.weight[i] = g.r.shape[1], np.sum(g.r**2, 1), g.weight
        out.redundancy[i] = np.sum(1.0 - w * s.h, 1)
        u = np.einsum("nij,ni->nj", s.V, s.r)
        out.deleted[i], out.rank[i] = np.sum(s.gain * u**2, 1), np.sum(R > 0.0, 1)
        seen_of = out.rank[i] > 0
        out.log_p[i[seen_of]] = log_tail(out.deleted[i[seen_of]], out.rank[i[seen_of]])
        out.cost[i] = np.sum(np.divide(w * u**2, R, out=np.zeros_like(R), where=R > 0.0), 1)
        found = np.where(R > 0.0, R**2 * s.gain, np.inf)  # an error e shifts the residual by R e
        if found.shape[1]:
            worst = np.argmin(found, 1)
            lowest = found[np.arange(len(i)), worst]
            needed = np.array([noncentrality(int(k)) if k else np.inf for k in out.rank[i]])
            out.minimal_error[i] = np.sqrt(needed / np.where(seen_of, lowest, 1.0))
            push = w * np.where(seen_of, out.minimal_error[i], 0.0)[:, None] * s.V[np.arange(len(i)), :, worst]
            moved = _own(f, g.variables, np.einsum("ncx,ndx,nd->nc", s.joint, g.A, push), metres)
            out.missed[i] = np.where(seen_of, moved, np.inf)
        else:
            out.minimal_error[i], out.missed[i] = np.inf, np.inf
    _influence(f, seen, metres, out)
    return out


def tests(f: Factored, seen: Sequence[Directions]) -> tuple[Array, IntArray]:
    """T (F,) of each factor and its degrees of freedom (F,), 0 where nothing sees it."""
    T, rank = np.zeros(f.system.size), np.zeros(f.system.size, np.int64)
    for g, s in zip(f.system.groups, seen, strict=True):
        T[g.factor], rank[g.factor] = s.tested(s.r[:, :, None])[:, 0], np.sum(s.R > 0.0, 1)
    return T, rank


def log_p_of(T: Array | float, rank: IntArray | int) -> Array:
    """Logarithms of p values, 0 where nothing is seen."""
    return np.asarray(np.where(np.asarray(rank) > 0, log_tail(T, np.maximum(rank, 1)), 0.0))


def _own(f: Factored, variables: IntArray, x: Array, metres: Sequence[IntArray]) -> Array:
    """Largest displacement (n,) among the variables (n, k) of each factor, moved by x (n, c)."""
    far, at = np.zeros(len(x)), 0
    for j, size in enumerate(f.system.dim[variables[0]] if len(variables) else []):
        flag = np.zeros((len(x), size))
        for n, v in enumerate(variables[:, j].tolist()):
            flag[n, metres[v]] = 1.0
        far = np.maximum(far, np.sqrt(np.sum(flag * x[:, at : at + size] ** 2, 1)))
        at += int(size)
    return far


def _influence(f: Factored, seen: Sequence[Directions], metres: Sequence[IntArray], out: Tested) -> None:
    """How far the worst point moves without each factor: its own ones first, all where that is affordable."""
    right = []  # per group, of the normal equations whose solution is the motion without each factor
    for g, s in zip(f.system.groups, seen, strict=True):
        u = np.einsum("nij,ni->nj", s.V, s.r)
        without = np.divide(s.weight[:, None] * u, s.R, out=np.zeros_like(u), where=s.R > 0.0)
        right.append(np.einsum("ndc,ndj,nj->nc", g.A, s.V, without))
        out.moved[g.factor] = _own(f, g.variables, np.einsum("ncx,nx->nc", s.joint, right[-1]), metres)
    size = len(f.triangle.R) + len(f.triangle.S)
    ranked = np.argsort(-np.nan_to_num(out.moved), kind="stable")
    chosen = np.zeros(f.system.size, bool)
    chosen[np.argsort(np.nan_to_num(out.log_p), kind="stable")[:LEAST]] = True
    chosen[ranked if size * f.system.size <= BUDGET else ranked[:WORST]] = True
    point = positions(f, metres)
    for k, g in enumerate(f.system.groups):
        some, index, home = np.flatnonzero(chosen[g.factor]), f.index(g), f.home[k]
        some = some[np.argsort(home[some], kind="stable")]
        for first in range(0, len(some), PART):
            part = some[first : first + PART]
            b = np.zeros((f.columns, len(part)))
            np.add.at(b, (index[part], np.arange(len(part))[:, None]), right[k][part])
            out.moved[g.factor[part]] = point(solved(f, b, np.unique(home[part])))


def positions(f: Factored, metres: Sequence[IntArray]) -> Callable[[Array], Array]:
    """A function of steps (N, c) that returns the largest displacement (c,) of a point, in m."""
    at = [f.at[v] + m for v, m in enumerate(metres) if len(m)]
    if not at:
        return lambda x: np.zeros(x.shape[1])
    by_size = [np.array([a for a in at if len(a) == d]) for d in {len(a) for a in at}]

    def farthest(x: Array) -> Array:
        square = [sum(x[columns[:, j]] ** 2 for j in range(columns.shape[1])).max(axis=0) for columns in by_size]
        return np.asarray(np.sqrt(np.max(square, axis=0)))

    return farthest


FAMILY, PARTS = 0.05, (0.5, 0.25, 0.25)  # family-wise level of a rejection; parts of factors, components, clusters
NEAR = 5.0  # poses between the ends of the worst loop of a cluster and of another one, at each end
LOOKED, LARGEST = 60, 40  # clusters that are tested, those of largest mean test first; factors of one


@dataclass(frozen=True)
class Cluster:
    """Factors that agree with each other: T of their common error on `rank` degrees of freedom, the motion without.
    `log_p`: logarithm of the p value, corrected for the choice of some of the factors between two places.
    """

    factors: tuple[int, ...]
    T: float
    rank: int
    log_p: float
    moved: float


def cluster_level(count: int) -> float:
    """Logarithm of the p value below which one of so many clusters is rejected."""
    return float(np.log(PARTS[2] * FAMILY / max(count, 1)))


def clusters(
    f: Factored, seen: Sequence[Directions], T: Array, rank: IntArray, loops: Sequence[int], metres: Sequence[IntArray]
) -> tuple[list[Cluster], int]:
    """Tested clusters of two or more of the factors `loops`, each of two variables, and the number of all clusters.

    T, rank: (F,) of each factor.

    Loops that agree with each other and with nothing else vouch for each other. The relations near a suspicious one in
    the order of keys, between the same two places, are its cluster. With the residuals r and the redundancy matrix R of
    its rows, off-diagonal blocks included, and the errors B that a common motion of the later place would make,
    T = r' B (B' R B)^-1 B' r is the chi-square of one error against everything else, and Sigma A' R^-1 r the motion of
    the estimate without them.
    """
    where = {int(i): (k, n) for k, g in enumerate(f.system.groups) for n, i in enumerate(g.factor)}
    loops = [i for i in loops if i in where and f.system.groups[where[i][0]].variables.shape[1] == 2]
    if len(loops) < 2:
        return [], 0
    group, place = np.array([where[i] for i in loops]).T
    ends = np.array([np.sort(f.system.groups[k].variables[n]) for k, n in zip(group, place, strict=True)])
    T, rank, chain = np.nan_to_num(T[loops]), rank[loops], _chain(f)
    near, free = cKDTree(ends).query_ball_point(ends, NEAR, p=np.inf), np.ones(len(loops), bool)
    members = []
    for j in np.argsort(-T, kind="stable").tolist():  # each loop that is left, and those beside it
        if free[j]:
            beside = np.array(near[j])
            beside = beside[free[beside] & (group[beside] == group[j])]
            beside = beside[np.argsort(-T[beside], kind="stable")[:LARGEST]]
            free[beside] = False
            if len(beside) > 1:
                members.append(beside)
    members.sort(key=lambda m: -float(np.sum(T[m] - rank[m])))
    found = [_tested(f, seen, int(group[m[0]]), place[m], chain) for m in members[:LOOKED]]
    if not found:
        return [], 0
    moved = positions(f, metres)(solved(f, np.column_stack([push for _, push in found])))
    return [replace(c, moved=float(far)) for (c, _), far in zip(found, moved, strict=True)], len(members)


def beside(f: Factored, seen: Sequence[Directions], some: Sequence[Cluster], wrong: IntArray) -> list[float]:
    """Logarithms of the p values of clusters, of their other factors in a system without wrong ones if that is larger.
    One wrong factor with its neighbours is no cluster, nor are factors that it disturbs from afar.
    """
    out, chain = [], _chain(f)
    for c in some:
        others, log_p = np.setdiff1d(c.factors, wrong), c.log_p
        if len(c.factors) - len(others) <= 1 and len(wrong):
            k = next(k for k, g in enumerate(f.system.groups) if others[0] in g.factor)
            rows = np.flatnonzero(np.isin(f.system.groups[k].factor, others))
            log_p = max(log_p, _tested(f, seen, k, rows, chain)[0].log_p)
        out.append(log_p)
    return out


def _chain(f: Factored) -> dict[int, Array]:
    """By variable, how the next one moves with it if the relation of both stays."""
    out = dict[int, Array]()
    for g in f.system.groups:
        d = g.r.shape[1]
        if g.variables.shape[1] == 2 and (f.system.dim[g.variables[0]] == d).all():
            rows = np.flatnonzero((np.diff(g.variables)[:, 0] == 1) & (np.linalg.det(g.A[:, :, d:]) != 0.0))
            ahead = np.linalg.solve(g.A[rows, :, d:], -g.A[rows, :, :d])
            out.update(zip(g.variables[rows, 0].tolist(), ahead, strict=True))
    return out


def _tested(
    f: Factored, seen: Sequence[Directions], k: int, rows: IntArray, chain: Mapping[int, Array]
) -> tuple[Cluster, Array]:
    """The factors of group k that agree most, by the least p value, and the right-hand side without them."""
    g, (n, d), every = f.system.groups[k], (len(rows), seen[k].r.shape[1]), np.arange(len(rows))
    root, index, later = np.sqrt(g.weight[rows])[:, None], f.index(g)[rows], g.variables[rows].max(1)
    A, r = root[:, :, None] * g.A[rows], root * seen[k].r[rows]
    right = np.zeros((f.columns, n, d))
    right[index, every[:, None]] = A.transpose(0, 2, 1)
    y = forward(f, right.reshape(f.columns, -1).copy(), np.unique(f.home[k][rows]))
    R = (np.eye(n * d) - y.T @ y).reshape(n, d, n, d)
    motion = {int(later.min()): np.eye(f.system.dim[later[0]])}  # of the later place as one body
    for v in range(later.min(), later.max()):
        motion[v + 1] = chain[v] @ motion[v] if v in chain and chain[v].shape == motion[v].shape else motion[v]
    B = A.reshape(n, d, 2, -1)[every, :, g.variables[rows].argmax(1)] @ np.array([motion[v] for v in later.tolist()])
    Q = np.linalg.qr(B.reshape(n * d, -1))[0].reshape(n, d, -1)
    M = np.einsum("iap,iajb,jbq->ijpq", Q, R, Q, optimize=True)
    u, of, found = np.einsum("iap,ia->ip", Q, r), every, list[tuple[float, IntArray, float, int]]()
    while len(of) > 1 or not found:
        part, size = M[np.ix_(of, of)], len(of)
        T, rank = _squared(part.sum((0, 1)), u[of].sum(0))
        some = special.gammaln(n + 1) - special.gammaln(size + 1) - special.gammaln(n - size + 1)
        among = np.log(2.0) + (size < n) * (np.log(n) + some)
        found.append((float(min(log_p_of(T, rank) + among, 0.0)), of, float(T), int(rank)))
        rest = part.sum((0, 1)) - part.sum(0) - part.sum(1) + M[of, of]
        of = np.delete(of, np.argmax(_squared(rest, u[of].sum(0) - u[of])[0]))
    best = min(found, key=lambda each: each[0])
    of = best[1]
    share, V = np.linalg.eigh(R[of][:, :, of].reshape(len(of) * d, -1))
    kept = share > UNSEEN
    push = V[:, kept] @ (V[:, kept].T @ r[of].ravel() / share[kept])
    factors = tuple(sorted(g.factor[rows[of]].tolist()))
    return Cluster(factors, *best[2:], best[0], np.nan), right[:, of].reshape(f.columns, -1) @ push


def _squared(M: Array, u: Array) -> tuple[Array, IntArray]:
    """Of vectors u (..., q) in the directions of M (..., q, q) that are seen, u' M^-1 u, and their number."""
    size, V = np.linalg.eigh(M)
    kept = size > UNSEEN
    square = np.einsum("...ij,...i->...j", V, u) ** 2
    return np.sum(np.divide(square, size, out=np.zeros_like(size), where=kept), -1), kept.sum(-1)
