"""Sparse QR of linearized problems: elimination of their variables, then the step and its covariances from the root.

Each variable is eliminated from a small dense front by Householder reflections (multifrontal QR, Davis, "Direct methods
for sparse linear systems", chapters 4 and 5; Dellaert and Kaess, "Factor graphs for robot perception", chapter 3),
which leaves  R x_v + S x_sep = d + N(0, I)  with the separator `sep` inside the parent's front. From the root back,

    cov(x_v, x_sep) = -R^-1 S cov(x_sep),    cov(x_v) = R^-1 R^-T + R^-1 S cov(x_sep) S' R^-T,

so every marginal follows from the parent's by sums of squares. No information matrix is formed or inverted, which
allows increments known a hundred thousand times better in one direction than in another. Time and memory grow with the
sum of the squared front sizes, for a path with loops nearly with its length. The order of elimination is along the path
without landmarks, COLAMD otherwise.

With residuals A x + C c - b and a standard normal prior on c (q,), the right-hand sides of the elimination are b and
the columns of C. Their residual products `left` give the least-squares problem of c alone; given c, x = x_b - X c with
the solutions of the right-hand sides, so that cov(x) = cov(x | c) + X cov(c) X' and cov(x, c) = -X cov(c).
"""

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import NamedTuple

import gtsam
import numpy as np

from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array, BoolArray


class Structure(NamedTuple):
    """The sparsity of an elimination: positions in its order, a postorder, and their columns."""

    variable: IntArray  # (V,) eliminated at each position
    column: IntArray  # (V + 1,) first column of each position
    parent: IntArray  # (V,) position, -1 for a root
    children: IntArray  # (V,) their number
    start: IntArray  # (V + 1,) first index of each position in `after`
    after: IntArray  # columns of each separator, ascending
    first: IntArray  # (V + 1,) first index of each position in `block`
    block: IntArray  # (B,) blocks of rows by position

    @property
    def at(self) -> IntArray:
        """First column (V,) of each variable."""
        out = np.empty_like(self.variable)
        out[self.variable] = self.column[:-1]
        return out


def structure(variable: IntArray, dim: IntArray, order: IntArray) -> Structure:
    """Symbolic elimination of blocks of the variables (B, k), -1 for none, of dimensions (V,), in the order (V,). The
    order is rearranged to a postorder of the elimination tree, which changes nothing else.
    """
    position = np.empty(len(order), np.int64)
    position[order] = np.arange(len(order))
    placed = np.where(variable >= 0, position[variable], -1)
    ends = np.sort(np.where(placed >= 0, placed, placed.max(axis=1, keepdims=True)), axis=1)
    parent, separators = _separators(ends, len(order))
    new = _postorder(parent)
    post = np.argsort(new)  # post[new] = old
    size = dim[order[post]]
    column = np.append(0, np.cumsum(size))
    count = np.array([len(separators[v]) for v in post.tolist()], np.int64)
    owner = np.repeat(np.arange(len(post)), count)
    separator = new[np.fromiter(chain.from_iterable(separators[v] for v in post.tolist()), np.int64, count.sum())]
    separator = separator[np.lexsort((separator, owner))]
    many = size[separator]
    ahead = np.append(0, np.cumsum(many))
    after = np.repeat(column[separator] - ahead[:-1], many) + np.arange(ahead[-1])
    of_block = new[ends[:, 0]]
    block = np.argsort(of_block, kind="stable")
    first = np.searchsorted(of_block[block], np.arange(len(order) + 1))
    parent = np.where(parent[post] >= 0, new[parent[post]], -1)
    children = np.bincount(parent[parent >= 0], minlength=len(order))
    return Structure(order[post], column, parent, children, ahead[np.append(0, np.cumsum(count))], after, first, block)


def _separators(ends: IntArray, size: int) -> tuple[IntArray, list[set[int]]]:
    """Parent and separator of each position, from blocks of positions `ends` (B, k), the least first."""
    parent, separators = np.full(size, -1), [set[int]() for _ in range(size)]
    pairs = np.unique(ends[:, :1] * size + ends)
    for first, other in zip((pairs // size).tolist(), (pairs % size).tolist(), strict=True):
        separators[first].add(other)
    for v, own in enumerate(separators):
        own.discard(v)
        if own:
            parent[v] = least = min(own)
            separators[least] |= own
    return parent, separators


def _postorder(parent: IntArray) -> IntArray:
    """Place (V,) of each position, children before parents, subtree by subtree; parent (V,) > child, -1: root."""
    n, above = len(parent), parent.tolist()
    size, new = [1] * (n + 1), [0] * (n + 1)  # of subtrees, and places; -1, the last one, is above the roots
    for v, p in enumerate(above):
        size[p] += size[v]
    first = new.copy()  # free place of each subtree
    for v in range(n - 1, -1, -1):
        p = above[v]
        first[v], first[p] = first[p], first[p] + size[v]
        new[v] = first[v] + size[v] - 1
    return np.array(new[:n], np.int64)


SLACK = 1.25  # A front with more than this many times the rows that its columns can need is made triangular first
SINGULAR = 1e-12  # A diagonal of R below this share of its column is rounding, not information
SMALLEST = 1e-150  # least diagonal of R whose square has an inverse
NOTHING = 1e-60  # coefficients below are zero: rounding of rounding ends in slow subnormal numbers


class Rows(NamedTuple):
    """Whitened rows of a least-squares problem in V variables, in B blocks of up to three."""

    variable: IntArray  # (B, 2) of a block, -1 for none; (B, 3) with a third variable, of one column
    A: Array  # (B, 3, 6) coefficients, three columns each; (B, 3, 7) with a third variable
    b: Array  # (B, 3, c) right-hand sides
    height: IntArray  # (B,) rows in use
    dim: IntArray  # (V,) 1 to 3 columns in use


class Blocks(NamedTuple):
    """Whitened rows in B blocks of any size, one after the other."""

    A: Array  # coefficients, row by row
    at_A: IntArray  # (B,) first one of each block
    columns: IntArray  # of the coefficients of a row of each block, -1 for none
    at_columns: IntArray  # (B + 1,)
    b: Array  # (rows, c) right-hand sides
    at_b: IntArray  # (B,)
    height: IntArray  # (B,) rows in use


class Triangle(NamedTuple):
    """The eliminated problem: R, S and d of all positions, row-major, concatenated; R is 0 in a column left out."""

    R: Array
    S: Array
    d: Array  # (N, c)
    at_R: IntArray  # (V + 1,) offsets of the positions
    at_S: IntArray
    diagonal: Array  # (N,) of R
    left: Array  # (c, c) squares and products of the residuals of the right-hand sides
    free: int  # the first variable that the rows do not determine, -1: none


def columns_of(s: Structure, variable: IntArray, dim: IntArray) -> IntArray:
    """Columns (..., 3) of variables of up to three dimensions, -1 for none."""
    within = np.arange(3)
    used = (variable[..., None] >= 0) & (within < dim[variable][..., None])
    return np.where(used, s.at[variable][..., None] + within, -1)


def eliminate(rows: Rows, s: Structure) -> Triangle:
    """QR of all rows, variable by variable."""
    B, _, wide = rows.A.shape
    column = columns_of(s, rows.variable, rows.dim).reshape(B, -1)[:, :wide].ravel()
    at, right = np.arange(B + 1), rows.b.reshape(-1, rows.b.shape[2])
    blocks = Blocks(rows.A.ravel(), 3 * wide * at[:-1], column, wide * at, right, 3 * at[:-1], rows.height)
    return triangular(blocks, s, SINGULAR, np.full(s.column[-1], SMALLEST))


def triangular(blocks: Blocks, s: Structure, share: float, least: Array) -> Triangle:
    """QR of all rows. A column is left out whose diagonal of R is below a share of it in its front, or `least` (N,)."""
    p, w = np.diff(s.column), np.diff(s.start)
    at_R, at_S = np.append(0, np.cumsum(p * p)), np.append(0, np.cumsum(p * w))
    R, S, d, left = _eliminate(blocks, s, share, least, at_R, at_S)
    within = np.arange(s.column[-1]) - np.repeat(s.column[:-1], p)
    diagonal = R[np.repeat(at_R[:-1], p) + (within) * np.repeat(p + 1, p)]
    dropped = np.flatnonzero(diagonal == 0.0)
    free = int(s.variable[np.searchsorted(s.column, dropped[0], side="right") - 1]) if len(dropped) else -1
    return Triangle(R, S, d, at_R, at_S, diagonal, left, free)


@njit
def reflect(F: Array, bound: Array) -> IntArray:
    """Householder reflections that make the first columns of F (m, n) upper triangular, in place. A column whose
    remainder is within its `bound` (k,) is left out: returns the row of each, -1 if so.
    """
    m, n = F.shape
    row, w, r = np.full(len(bound), -1), np.empty(n), 0
    for k in range(len(bound)):
        if r >= m:
            break
        total = 0.0
        for i in range(r + 1, m):
            total += F[i, k] * F[i, k]
        norm = np.sqrt(F[r, k] * F[r, k] + total)
        if not norm > bound[k]:
            continue
        row[k] = r
        if total > 0.0:
            if F[r, k] > 0.0:
                norm = -norm
            head = F[r, k] - norm
            scale = -1.0 / (norm * head)  # of (head, F[r+1:, k]): 2 / its square
            for j in range(k + 1, n):
                w[j] = head * F[r, j]
            for i in range(r + 1, m):
                f = F[i, k]
                if f != 0.0:
                    for j in range(k + 1, n):
                        w[j] += f * F[i, j]
            for j in range(k + 1, n):
                w[j] *= scale
                F[r, j] -= head * w[j]
            for i in range(r + 1, m):
                f = F[i, k]
                if f != 0.0:
                    for j in range(k + 1, n):
                        F[i, j] -= f * w[j]
                F[i, k] = 0.0
            F[r, k] = norm
        r += 1
    return row


@njit
def longer(stack: Array, used: int, needed: int) -> Array:
    """A stack with room for `needed` entries, of which the first are in use."""
    if needed <= len(stack):
        return stack
    more = np.empty(2 * needed)
    more[:used] = stack[:used]
    return more


@njit
def put_places(s: Structure, v: int, place: IntArray) -> int:
    """Number the columns of a front in `place` (N,): its own, then those of its separator; returns how many."""
    own = s.column[v + 1] - s.column[v]
    side: int = own + s.start[v + 1] - s.start[v]
    place[s.column[v] : s.column[v + 1]] = np.arange(own)
    place[s.after[s.start[v] : s.start[v + 1]]] = np.arange(own, side)
    return side


@njit
def _eliminate(
    blocks: Blocks, s: Structure, share: float, least: Array, at_R: IntArray, at_S: IntArray
) -> tuple[Array, Array, Array, Array]:
    A, at_A, columns, at_columns, b, at_b, height = blocks
    _, column, parent, children, start, after, first, block = s
    c, size = b.shape[1], len(parent)
    R, S, d = np.zeros(at_R[-1]), np.zeros(at_S[-1]), np.zeros((column[-1], c))
    place = np.empty(column[-1], np.int64)
    # stack of rows for parents, child by child; the last `children` entries are for this variable
    waiting, used = np.empty(1024), 0
    kept, depth = np.empty((size, 2), np.int64), 0
    left = np.zeros((c, c))
    for v in range(size):
        pivot, p, w = column[v], column[v + 1] - column[v], start[v + 1] - start[v]
        n, m = w + c, 0
        for i in range(first[v], first[v + 1]):
            m += height[block[i]]
        for q in range(depth - children[v], depth):
            m += kept[q, 1]
            used -= kept[q, 1] * (start[kept[q, 0] + 1] - start[kept[q, 0]] + c)
        F, r, source = np.zeros((m, p + n)), 0, used
        put_places(s, v, place)
        for i in range(first[v], first[v + 1]):
            k = block[i]
            begin, wide = at_columns[k], at_columns[k + 1] - at_columns[k]
            for row in range(height[k]):
                for j in range(wide):
                    if columns[begin + j] >= 0:
                        F[r, place[columns[begin + j]]] = A[at_A[k] + row * wide + j]
                F[r, p + w :] = b[at_b[k] + row]
                r += 1
        for q in range(depth - children[v], depth):
            begin, end = start[kept[q, 0]], start[kept[q, 0] + 1]
            for _ in range(kept[q, 1]):
                for i in range(begin, end):
                    F[r, place[after[i]]] = waiting[source]
                    source += 1
                F[r, p + w :] = waiting[source : source + c]
                source += c
                r += 1
        depth -= children[v]
        bound = np.zeros(p)
        for i in range(m):
            for j in range(p):
                bound[j] += F[i, j] * F[i, j]
        for j in range(p):
            bound[j] = max(share * np.sqrt(bound[j]), least[pivot + j])
        row_of, corner = reflect(F, bound), 0
        for j in range(p):
            if row_of[j] >= 0:
                corner = row_of[j] + 1
                for i in range(j, p):
                    if row_of[i] >= 0:
                        R[at_R[v] + j * p + i] = F[row_of[j], i]
                S[at_S[v] + j * w : at_S[v] + (j + 1) * w] = F[row_of[j], p : p + w]
                d[pivot + j] = F[row_of[j], p + w :]
        rest = F[corner:, p:]
        if len(rest) > SLACK * n:
            full = rest.copy()
            reflect(full, np.full(n, -1.0))
            rest = full[:n]
        remain = len(rest)
        if parent[v] < 0:
            for i in range(remain):
                for j in range(c):
                    for q in range(c):
                        left[j, q] += rest[i, j] * rest[i, q]
            continue
        waiting = longer(waiting, used, used + remain * n)
        for i in range(remain):
            for j in range(n):
                waiting[used] = rest[i, j] if abs(rest[i, j]) > NOTHING else 0.0
                used += 1
        kept[depth, 0], kept[depth, 1] = v, remain
        depth += 1
    return R, S, d, left


NO_DRIFT = np.empty(0, np.int64)


def ordering(variable: IntArray, poses: int, size: int, drift: IntArray = NO_DRIFT) -> IntArray:
    """Order (V,) for blocks of the variables (B, 2) or (B, 3), -1 for none: poses first, landmarks, drifts last.

    Poses alone are a chain, eliminated backwards, and each drift after the last pose that it leads to: `drift` (K,) is
    the first one. With landmarks gtsam's COLAMD finds an order with little fill-in.
    """
    if poses + len(drift) == size:
        return np.argsort(np.concatenate([np.arange(poses), drift - 0.5]), kind="stable")[::-1].astype(np.int64)
    return colamd([v for v in block if v >= 0] for block in np.unique(np.sort(variable, axis=1), axis=0).tolist())


def colamd(blocks: Iterable[Sequence[int]], last: Sequence[int] = ()) -> IntArray:
    """Order (V,) with little fill-in of variables that share blocks; the variables `last` at the end."""
    pattern = gtsam.SymbolicFactorGraph()
    for block in blocks:
        pattern.push_factor(*block)
    if len(last):
        found = gtsam.Ordering.ColamdConstrainedLastSymbolicFactorGraph(pattern, [int(v) for v in last], False)
    else:
        found = gtsam.Ordering.ColamdSymbolicFactorGraph(pattern)
    return np.array([found.at(i) for i in range(found.size())], np.int64)


def means(rows: Rows, s: Structure, t: Triangle) -> Array:
    """Solution (V, 3, c) of the least-squares problem, for each right-hand side; beyond a variable's dimension 0."""
    x = backward(s, t, t.d)
    columns = columns_of(s, np.arange(len(rows.dim)), rows.dim)
    return np.where(columns[:, :, None] >= 0, x[columns], 0.0)


def marginals(rows: Rows, s: Structure, t: Triangle, pairs: IntArray) -> tuple[Array, Array]:
    """Covariances (V, 3, 3), zero beyond a variable's dimension; (Q, 3, 3) of pairs (Q, 2), which share a block."""
    columns = columns_of(s, np.arange(len(rows.dim)), rows.dim)
    own, across = joint_covariances(s, t, [columns, columns[pairs].reshape(-1, 6)])
    return own, across[:, :3, 3:]


def joint_covariances(s: Structure, t: Triangle, sets: Sequence[IntArray]) -> list[Array]:
    """Joint covariances (n, k, k) of sets (n, k) of columns that share a block, -1: none, from the roots (Takahashi,
    Fagan and Chin, PICA 1973), by fronts. Directions that are not determined have zero variance.
    """
    size, wide = np.array([len(each) for each in sets]), np.array([each.shape[1] for each in sets])
    column, width = np.concatenate([each.ravel() for each in sets]), np.repeat(wide, size)
    least = [np.where(each >= 0, each, t.d.shape[0]).min(axis=1, initial=t.d.shape[0]) for each in sets]
    home = np.searchsorted(s.column, np.concatenate(least), side="right") - 1
    order = np.argsort(home, kind="stable")
    at, at_out = np.append(0, np.cumsum(width)), np.append(0, np.cumsum(width**2))
    out = np.zeros(at_out[-1])
    _covariances(s, t, np.searchsorted(home[order], np.arange(len(s.parent) + 1)), order, column, at, out, at_out)
    ends = np.cumsum(size * wide**2)
    return [out[e - n * k * k : e].reshape(n, k, k) for e, n, k in zip(ends, size, wide, strict=True)]


@njit
def forward(s: Structure, t: Triangle, right: Array, some: BoolArray) -> Array:
    """Solution (N, c) of  R' y = right, which is overwritten; products of its columns are those of `right` with the
    covariance between. `some` (V,): positions at which `right` is not zero; those above them are added.
    """
    y = np.zeros(right.shape)
    first_of, parent, start, after = s.column, s.parent, s.start, s.after
    R, S, at_R, at_S = t.R, t.S, t.at_R, t.at_S
    c = right.shape[1]
    for v in range(len(parent)):
        if not some[v]:
            continue
        at, p, w = first_of[v], first_of[v + 1] - first_of[v], start[v + 1] - start[v]
        for j in range(p):
            diagonal = R[at_R[v] + j * p + j]
            for q in range(c if diagonal != 0.0 else 0):
                total = right[at + j, q]
                for i in range(j):
                    total -= R[at_R[v] + i * p + j] * y[at + i, q]
                y[at + j, q] = total / diagonal
        if parent[v] < 0:
            continue
        some[parent[v]] = True
        for i in range(w):
            u = after[start[v] + i]
            for j in range(p):
                a = S[at_S[v] + j * w + i]
                for q in range(c):
                    right[u, q] -= a * y[at + j, q]
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
            for q in range(c):
                x[first_of[v] + r, q] = total[r, q] / diagonal
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
    s: Structure, t: Triangle, first: IntArray, sets: IntArray, column: IntArray, at: IntArray, out: Array,
    at_out: IntArray,
) -> None:  # fmt: skip
    """Joint covariance of the columns of each front; a front's is kept until its last child is done."""
    first_of, parent, children, start, after = s.column, s.parent, s.children.copy(), s.start, s.after
    R, S, at_R, at_S = t.R, t.S, t.at_R, t.at_S
    fronts, used = np.empty(1024), 0
    begin, place = np.empty(len(parent), np.int64), np.empty(first_of[-1], np.int64)
    for v in range(len(parent) - 1, -1, -1):
        n, w, u = first_of[v + 1] - first_of[v], start[v + 1] - start[v], parent[v]
        below = np.empty((w, w))  # covariance of the separator from the parent's front
        if u >= 0:
            side = put_places(s, u, place)
            for i in range(w):
                row = begin[u] + place[after[start[v] + i]] * side
                for j in range(w):
                    below[i, j] = fronts[row + place[after[start[v] + j]]]
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
        G, side = np.zeros((n, w)), put_places(s, v, place)
        for i in range(n):
            for j in range(i, n):
                for q in range(w):
                    G[i, q] -= inverse[i, j] * S[at_S[v] + j * w + q]
        cross = _product(G, below)
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
        fronts = longer(fronts, used, used + side * side)
        begin[v] = used
        used += side * side
        fronts[begin[v] : used] = C.ravel()


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
    """Covariances (V, 3, 3) of variables, 0 beyond a dimension, and (Q, 3, 3) of pairs (Q, 2) that share a block."""
    own, across = marginals(rows, s, t, pairs)
    if len(solution.constants):
        X = solution.columns
        own += X @ solution.covariance @ X.transpose(0, 2, 1)
        across += X[pairs[:, 0]] @ solution.covariance @ X[pairs[:, 1]].transpose(0, 2, 1)
    return own, across
