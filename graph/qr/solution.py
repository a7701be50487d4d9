"""The step of an eliminated problem and its covariances: from the root of the elimination tree back to its leaves.

With residuals A x + C c - b and a standard normal prior on c (q,), the right-hand sides of the elimination are b and
the columns of C. Their residual products `left` give the least-squares problem of c alone; given c, x = x_b - X c with
the solutions of the right-hand sides, so that cov(x) = cov(x | c) + X cov(c) X' and cov(x, c) = -X cov(c).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from graph.qr.elimination import Rows, Structure, Triangle, columns_of, put_places


def means(rows: Rows, s: Structure, t: Triangle) -> Array:
    """Solution (V, 3, c) of the least-squares problem, for each right-hand side; beyond a variable's dimension 0."""
    x = backward(s, t, t.d)
    columns = columns_of(s, np.arange(len(rows.dim)), rows.dim)
    return np.where(columns[:, :, None] >= 0, x[columns], 0.0)


def marginals(rows: Rows, s: Structure, t: Triangle) -> Array:
    """Marginal covariances (V, 3, 3); beyond a variable's dimension 0."""
    return _joint(rows, s, t, np.empty((0, 2), np.int64))[0]


def _joint(rows: Rows, s: Structure, t: Triangle, pairs: IntArray) -> tuple[Array, Array]:
    """`marginals`, and covariances (Q, 3, 3) between the variables of pairs (Q, 2), which share a block each."""
    columns = columns_of(s, np.arange(len(rows.dim)), rows.dim)
    own, across = joint_covariances(s, t, [columns, columns[pairs].reshape(-1, 6)])
    return own, across[:, :3, 3:]


def joint_covariances(s: Structure, t: Triangle, sets: Sequence[IntArray]) -> list[Array]:
    """Joint covariances (n, k, k) of sets (n, k) of columns that share a block, -1: none, by one pass from the roots.

    Takahashi, Fagan and Chin, "Formation of a sparse bus impedance matrix", PICA 1973, by fronts. Directions that are
    not determined have zero variance.
    """
    size, wide = np.array([len(each) for each in sets]), np.array([each.shape[1] for each in sets])
    column, width = np.concatenate([each.ravel() for each in sets]), np.repeat(wide, size)
    least = [np.where(each >= 0, each, t.d.shape[0]).min(axis=1, initial=t.d.shape[0]) for each in sets]
    home = np.searchsorted(s.column, np.concatenate(least), side="right") - 1
    order = np.argsort(home, kind="stable")
    first = np.searchsorted(home[order], np.arange(len(s.parent) + 1))
    at, at_out = np.append(0, np.cumsum(width)), np.append(0, np.cumsum(width**2))
    out = np.zeros(at_out[-1])
    _covariances(s, t, first, order, column, at, out, at_out)
    ends = np.cumsum(size * wide**2)
    return [out[e - n * k * k : e].reshape(n, k, k) for e, n, k in zip(ends, size, wide, strict=True)]


@njit
def forward(s: Structure, t: Triangle, right: Array, some: BoolArray) -> Array:
    """Solution (N, c) of  R' y = right, which is overwritten; products of its columns are those of `right` with the
    covariance between. `some` (V,): positions at which `right` is not zero; those above them are added.
    """
    y = np.zeros_like(right)
    first_of, parent, start, after = s.column, s.parent, s.start, s.after
    R, S, at_R, at_S = t.R, t.S, t.at_R, t.at_S
    c = right.shape[1]
    for v in range(len(parent)):
        if not some[v]:
            continue
        p, w = first_of[v + 1] - first_of[v], start[v + 1] - start[v]
        z = right[first_of[v] : first_of[v + 1]].copy()
        for j in range(p):
            diagonal = R[at_R[v] + j * p + j]
            if diagonal == 0.0:
                z[j] = 0.0
                continue
            for i in range(j):
                a = R[at_R[v] + i * p + j]
                for q in range(c):
                    z[j, q] -= a * z[i, q]
            z[j] /= diagonal
        y[first_of[v] : first_of[v + 1]] = z
        if parent[v] < 0:
            continue
        some[parent[v]] = True
        for i in range(w):
            u = after[start[v] + i]
            for j in range(p):
                a = S[at_S[v] + j * w + i]
                for q in range(c):
                    right[u, q] -= a * z[j, q]
    return y


@njit
def backward(s: Structure, t: Triangle, right: Array) -> Array:
    """Solution (N, c) of  R x = right, zero in columns left out."""
    first_of, start, after = s.column, s.start, s.after
    R, S, at_R, at_S = t.R, t.S, t.at_R, t.at_S
    c = right.shape[1]
    x = np.zeros(right.shape)
    for v in range(len(s.parent) - 1, -1, -1):
        p, w = first_of[v + 1] - first_of[v], start[v + 1] - start[v]
        total = right[first_of[v] : first_of[v + 1]].copy()
        for r in range(p):
            for i in range(w):
                u, a = after[start[v] + i], S[at_S[v] + r * w + i]
                for q in range(c):
                    total[r, q] -= a * x[u, q]
        for r in range(p - 1, -1, -1):
            diagonal = R[at_R[v] + r * p + r]
            if diagonal == 0.0:
                continue
            for j in range(r + 1, p):
                a = R[at_R[v] + r * p + j]
                for q in range(c):
                    total[r, q] -= a * x[first_of[v] + j, q]
            x[first_of[v] + r] = total[r] / diagonal
    return x


@njit
def _product(A: Array, B: Array) -> Array:
    out = np.zeros((len(A), B.shape[1]))
    for r in range(len(A)):
        for i in range(len(B)):
            a = A[r, i]
            for j in range(B.shape[1]):
                out[r, j] += a * B[i, j]
    return out


@njit
def _covariances(
    s: Structure,
    t: Triangle,
    first: IntArray,
    sets: IntArray,
    column: IntArray,
    at: IntArray,
    out: Array,
    at_out: IntArray,
) -> None:
    """Joint covariances by front: the covariance of its columns is kept until its last child is done.

    `first` (V + 1,), `sets` (Q,): sets by front; `column`, `at` (Q + 1,): columns of each; `out`, `at_out`: results.
    """  # fmt: skip
    first_of, parent, children, start, after = s.column, s.parent, s.children.copy(), s.start, s.after
    R, S, at_R, at_S = t.R, t.S, t.at_R, t.at_S
    fronts, used = np.empty(1024), 0
    begin, place = np.empty(len(parent), np.int64), np.empty(first_of[-1], np.int64)
    for v in range(len(parent) - 1, -1, -1):
        n, w, u = first_of[v + 1] - first_of[v], start[v + 1] - start[v], parent[v]
        # covariance of the separator from the parent's front
        below = np.empty((w, w))
        if u >= 0:
            side = put_places(s, u, place)
            at_below = place[after[start[v] : start[v + 1]]]
            for i in range(w):
                for j in range(w):
                    below[i, j] = fronts[begin[u] + at_below[i] * side + at_below[j]]
            children[u] -= 1
            if children[u] == 0:
                used = begin[u]  # top of the stack: the subtrees of its other children are done
        inverse = np.zeros((n, n))
        for j in range(n):
            if R[at_R[v] + j * n + j] == 0.0:
                continue
            inverse[j, j] = 1.0 / R[at_R[v] + j * n + j]
            for i in range(j - 1, -1, -1):
                if R[at_R[v] + i * n + i] != 0.0:
                    total = 0.0
                    for q in range(i + 1, j + 1):
                        total += R[at_R[v] + i * n + q] * inverse[q, j]
                    inverse[i, j] = -total / R[at_R[v] + i * n + i]
        G = -_product(inverse, S[at_S[v] : at_S[v + 1]].reshape(n, w))
        cross, side = _product(G, below), put_places(s, v, place)
        C = np.empty((side, side))
        C[:n, n:], C[n:, :n], C[n:, n:] = cross, cross.T, below
        for r in range(n):
            for q in range(r + 1):
                total = 0.0
                for j in range(w):
                    total += 0.5 * (cross[r, j] * G[q, j] + cross[q, j] * G[r, j])
                for j in range(r, n):
                    total += inverse[r, j] * inverse[q, j]
                C[r, q] = C[q, r] = total
        for i in range(first[v], first[v + 1]):
            k = sets[i]
            some = column[at[k] : at[k + 1]]
            for r in range(len(some)):
                for q in range(len(some)):
                    if some[r] >= 0 and some[q] >= 0:
                        out[at_out[k] + r * len(some) + q] = C[place[some[r]], place[some[q]]]
        if children[v] == 0:
            continue
        if used + side * side > len(fronts):
            more = np.empty(2 * (used + side * side))
            more[:used] = fronts[:used]
            fronts = more
        begin[v] = used
        fronts[used : used + side * side] = C.ravel()
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
    x, square = means(rows, s, t), float(t.d[:, 0] @ t.d[:, 0])
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
