"""The step of an eliminated problem and its covariances: from the root of the elimination tree back to its leaves.

With residuals A x + C c - b and a standard normal prior on c (q,), the right-hand sides of the elimination are b and
the columns of C. Their residual products `left` give the least-squares problem of c alone; given c, x = x_b - X c with
the solutions of the right-hand sides, so that cov(x) = cov(x | c) + X cov(c) X' and cov(x, c) = -X cov(c).
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from data.inputs import IntArray
from data.se2 import Array
from graph.qr.elimination import Rows, Structure, Triangle


def means(rows: Rows, s: Structure, t: Triangle) -> Array:
    """Solution (V, 3, c) of the least-squares problem, for each right-hand side; beyond a variable's dimension 0."""
    x = np.zeros((len(rows.dim), 3, t.d.shape[2]))
    _substitute(s, t, rows.dim[s.variable], x)
    return x


def marginals(rows: Rows, s: Structure, t: Triangle) -> Array:
    """Marginal covariances (V, 3, 3); beyond a variable's dimension 0."""
    return _joint(rows, s, t, np.empty((0, 2), np.int64))[0]


def _joint(rows: Rows, s: Structure, t: Triangle, pairs: IntArray) -> tuple[Array, Array]:
    """`marginals`, and covariances (Q, 3, 3) between the variables of pairs (Q, 2), which share a block each."""
    position = np.empty_like(s.variable)
    position[s.variable] = np.arange(len(position))
    at = np.sort(position[pairs], axis=1)
    order = np.argsort(at[:, 0], kind="stable")
    first = np.searchsorted(at[order, 0], np.arange(len(position) + 1))
    covariance, across = np.zeros((len(rows.dim), 3, 3)), np.zeros((len(pairs), 3, 3))
    found = across[order]
    _covariances(s, t, rows.dim[s.variable], covariance, first, at[order, 1], found)
    across[order] = found
    swapped = position[pairs[:, 0]] != at[:, 0]
    across[swapped] = across[swapped].transpose(0, 2, 1)
    return covariance, across


@numba.njit(cache=True)
def _substitute(s: Structure, t: Triangle, dim: IntArray, x: Array) -> None:
    variable, start, separator = s.variable, s.start, s.separator
    R, S, d, at_S = t.R, t.S, t.d, t.at_S
    c = x.shape[2]
    total = np.empty((3, c))
    for v in range(len(variable) - 1, -1, -1):
        n = dim[v]
        for r in range(n):
            for q in range(c):
                total[r, q] = d[v, r, q]
        width = (at_S[v + 1] - at_S[v]) // n
        for r in range(n):
            at = at_S[v] + r * width
            for i in range(start[v], start[v + 1]):
                u = separator[i]
                for j in range(dim[u]):
                    for q in range(c):
                        total[r, q] -= S[at] * x[variable[u], j, q]
                    at += 1
        for r in range(n - 1, -1, -1):
            for q in range(c):
                for j in range(r + 1, n):
                    total[r, q] -= R[v, r, j] * x[variable[v], j, q]
                x[variable[v], r, q] = total[r, q] / R[v, r, r]


@numba.njit(cache=True)
def _covariances(
    s: Structure, t: Triangle, dim: IntArray, out: Array, first: IntArray, other: IntArray, across: Array
) -> None:
    """Marginals by clique: the covariance of a clique is kept until its last child is done.

    `first` (V + 1,), `other` (Q,): of each position, those positions in its separator that it is asked with.
    """
    variable, parent, children, start, separator = s.variable, s.parent, s.children, s.start, s.separator
    R, S, at_S = t.R, t.S, t.at_S
    size = len(variable)
    cliques, used = np.empty(1024), 0
    begin, open_children = np.empty(size, np.int64), np.empty(size, np.int64)
    for v in range(size):
        open_children[v] = children[v]
    within = np.empty(size, np.int64)
    for v in range(size - 1, -1, -1):
        n = dim[v]
        w = (at_S[v + 1] - at_S[v]) // n
        p = parent[v]
        # covariance of the separator from the parent's clique
        below = np.empty((w, w))
        if p >= 0:
            side = dim[p] + (at_S[p + 1] - at_S[p]) // dim[p]
            within[p] = 0
            at = dim[p]
            for i in range(start[p], start[p + 1]):
                within[separator[i]] = at
                at += dim[separator[i]]
            index = np.empty(w, np.int64)
            at = 0
            for i in range(start[v], start[v + 1]):
                u = separator[i]
                for j in range(dim[u]):
                    index[at] = within[u] + j
                    at += 1
            for i in range(w):
                row = begin[p] + index[i] * side
                for j in range(w):
                    below[i, j] = cliques[row + index[j]]
            open_children[p] -= 1
            if open_children[p] == 0:
                used = begin[p]  # top of the stack: the subtrees of its other children are done
        inverse = np.zeros((n, n))
        for j in range(n):
            inverse[j, j] = 1.0 / R[v, j, j]
            for i in range(j - 1, -1, -1):
                total = 0.0
                for q in range(i + 1, j + 1):
                    total += R[v, i, q] * inverse[q, j]
                inverse[i, j] = -total / R[v, i, i]
        G = np.zeros((n, w))
        for r in range(n):
            for q in range(r, n):
                at = at_S[v] + q * w
                for j in range(w):
                    G[r, j] -= inverse[r, q] * S[at + j]
        cross = np.zeros((n, w))
        for r in range(n):
            for i in range(w):
                g = G[r, i]
                for j in range(w):
                    cross[r, j] += g * below[i, j]
        own = np.zeros((n, n))
        for r in range(n):
            for q in range(r + 1):
                total = 0.0
                for j in range(w):
                    total += 0.5 * (cross[r, j] * G[q, j] + cross[q, j] * G[r, j])
                for j in range(r, n):
                    total += inverse[r, j] * inverse[q, j]
                own[r, q], own[q, r] = total, total
        for r in range(n):
            for q in range(n):
                out[variable[v], r, q] = own[r, q]
        for k in range(first[v], first[v + 1]):
            at = 0
            for i in range(start[v], start[v + 1]):
                u = separator[i]
                if u == other[k]:
                    for r in range(n):
                        for j in range(dim[u]):
                            across[k, r, j] = cross[r, at + j]
                at += dim[u]
        if children[v] == 0:
            continue
        side = n + w
        if used + side * side > len(cliques):
            more = np.empty(2 * (used + side * side))
            for i in range(used):
                more[i] = cliques[i]
            cliques = more
        begin[v] = used
        for r in range(n):
            at = used + r * side
            for q in range(n):
                cliques[at + q] = own[r, q]
            for i in range(w):
                cliques[at + n + i] = cross[r, i]
        for i in range(w):
            at = used + (n + i) * side
            for r in range(n):
                cliques[at + r] = cross[r, i]
            for j in range(w):
                cliques[at + n + j] = below[i, j]
        used += side * side


class Solution(NamedTuple):
    """A step to the minimum of the linearized problem."""

    step: Array  # (V, 3), of the variables
    constants: Array  # (q,), of the constant errors, in sigmas
    length: float  # of the whole step, in sigmas; half its square is the predicted decrease of the cost
    columns: Array  # (V, 3, q); -columns is the derivative of the variables with respect to the constant errors
    covariance: Array  # (q, q) of the constant errors, in sigmas


def solve(rows: Rows, s: Structure, t: Triangle, now: Array) -> Solution:
    """The step, from errors that are `now` (q,) sigmas from their prior means."""
    x, d = means(rows, s, t), t.d[:, :, :1]
    square = float(np.einsum("vic,vic->", d, d))
    if not len(now):
        return Solution(x[:, :, 0], now, float(np.sqrt(square)), x[:, :, 1:], np.empty((0, 0)))
    slope = t.left[1:, 0] - now
    covariance = np.linalg.inv(t.left[1:, 1:] + np.eye(len(now)))
    covariance = 0.5 * (covariance + covariance.T)
    constants = covariance @ slope
    length = float(np.sqrt(square + slope @ constants))
    return Solution(x[:, :, 0] - x[:, :, 1:] @ constants, constants, length, x[:, :, 1:], covariance)


def covariances(rows: Rows, s: Structure, t: Triangle, solution: Solution, pairs: IntArray) -> tuple[Array, Array]:
    """Marginal covariances (V, 3, 3) of the variables; beyond a variable's dimension 0. Also covariances (Q, 3, 3)
    between those of pairs (Q, 2), of which each shares a block.
    """
    own, across = _joint(rows, s, t, pairs)
    if len(solution.constants):
        X = solution.columns
        own += X @ solution.covariance @ X.transpose(0, 2, 1)
        across += X[pairs[:, 0]] @ solution.covariance @ X[pairs[:, 1]].transpose(0, 2, 1)
    return own, across
