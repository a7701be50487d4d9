"""Loops that agree with each other and with nothing else: tested together, as each of them is vouched for by the rest.

The relations near a suspicious one in the order of keys, between the same two places, are its cluster. With the
residuals r and the redundancy matrix R of its rows, off-diagonal blocks included, T = r' R^-1 r is the chi-square of
all of them against everything else, and Sigma A' R^-1 r the motion of the estimate without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import chi2

from data.inputs import IntArray
from data.se2 import Array
from wings.audit.factors import UNSEEN, Directions, Tested, log_tail, positions
from wings.audit.linear import Factored, forward, solved

NEAR = 5.0  # poses between the ends of the worst loop of a cluster and of another one, at each end
LOOKED, LARGEST = 60, 40  # clusters that are tested, those of largest mean test first; factors of one


@dataclass(frozen=True)
class Cluster:
    """Factors that agree with each other: T on `rank` degrees of freedom, its p value, and the motion without them."""

    factors: tuple[int, ...]
    T: float
    rank: int
    p: float
    moved: float

    @property
    def log_p(self) -> float:
        """Logarithm of the p value, which may underflow."""
        return float(log_tail(self.T, self.rank)) if self.rank else 0.0


def clusters(
    f: Factored, seen: Sequence[Directions], t: Tested, loops: Sequence[int], metres: Sequence[IntArray]
) -> tuple[list[Cluster], int]:
    """Tested clusters of two or more of the factors `loops`, each of two variables, and the number of all clusters."""
    if len(loops) < 2:
        return [], 0
    where = {int(i): (k, n) for k, g in enumerate(f.system.groups) for n, i in enumerate(g.factor)}
    loops = [i for i in loops if i in where and f.system.groups[where[i][0]].variables.shape[1] == 2]
    if len(loops) < 2:
        return [], 0
    ends = np.array([np.sort(f.system.groups[where[i][0]].variables[where[i][1]]) for i in loops], float)
    T, rank = np.nan_to_num(t.deleted[loops]), t.rank[loops]
    near, free = cKDTree(ends).query_ball_point(ends, NEAR, p=np.inf), np.ones(len(loops), bool)
    members = []
    for j in np.argsort(-T, kind="stable").tolist():  # each loop that is left, and those beside it
        if free[j]:
            beside = np.array(near[j])
            beside = beside[free[beside]]
            beside = beside[np.argsort(-T[beside], kind="stable")[:LARGEST]]
            free[beside] = False
            if len(beside) > 1:
                members.append(beside)
    members.sort(key=lambda m: -float(np.sum(T[m] - rank[m])))
    found = [_tested(f, seen, [where[loops[j]] for j in m.tolist()]) for m in members[:LOOKED]]
    if not found:
        return [], 0
    moved = positions(f, metres)(solved(f, np.column_stack([push for *_, push in found])))
    made = [
        Cluster(factors, T, rank, float(chi2.sf(T, rank)) if rank else np.nan, float(far))
        for (factors, T, rank, _), far in zip(found, moved, strict=True)
    ]
    return made, len(members)


def beside(f: Factored, seen: Sequence[Directions], some: Sequence[Cluster], wrong: IntArray) -> list[float]:
    """P values of clusters, of their other factors in a system without wrong ones if that is larger.

    One wrong factor with its neighbours is no cluster, nor are factors that it disturbs from afar.
    """
    where = {int(i): (k, n) for k, g in enumerate(f.system.groups) for n, i in enumerate(g.factor)}
    out = []
    for c in some:
        others = [i for i in c.factors if i not in wrong]
        p = c.p
        if len(c.factors) - len(others) <= 1 and len(wrong):
            _, T, rank, _ = _tested(f, seen, [where[i] for i in others])
            p = max(p, float(chi2.sf(T, rank)) if rank else 1.0)
        out.append(p)
    return out


def _tested(
    f: Factored, seen: Sequence[Directions], some: Sequence[tuple[int, int]]
) -> tuple[tuple[int, ...], float, int, Array]:
    """Factors, T, its degrees of freedom, and the right-hand side whose solution is the motion without them."""
    at = np.cumsum([0] + [f.system.groups[k].r.shape[1] for k, _ in some])
    right, r = np.zeros((f.columns, at[-1])), np.empty(at[-1])
    for (k, n), first, end in zip(some, at[:-1], at[1:], strict=True):
        g, root = f.system.groups[k], np.sqrt(f.system.groups[k].weight[n])
        right[f.at_of(g, n), first:end] = root * g.A[n].T
        r[first:end] = root * seen[k].r[n]
    y = forward(f, right.copy(), np.unique([f.home[k][n] for k, n in some]))
    size, V = np.linalg.eigh(np.eye(at[-1]) - y.T @ y)
    kept = size > UNSEEN
    u = V[:, kept].T @ r
    factors = tuple(sorted(int(f.system.groups[k].factor[n]) for k, n in some))
    return factors, float(np.sum(u**2 / size[kept])), int(kept.sum()), right @ (V[:, kept] @ (u / size[kept]))
