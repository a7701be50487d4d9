"""Sparse QR of a smoothing problem: elimination of poses and landmarks, with recovery of the covariances.

Each variable is eliminated from a small dense front by Householder reflections (multifrontal QR, Davis, "Direct methods
for sparse linear systems", chapters 4 and 5; Dellaert and Kaess, "Factor graphs for robot perception", chapter 3),
which leaves  R x_v + S x_sep = d + N(0, I)  with the separator `sep` inside the parent's clique. From the root back,

    cov(x_v, x_sep) = -R^-1 S cov(x_sep),    cov(x_v) = R^-1 R^-T + R^-1 S cov(x_sep) S' R^-T,

so every marginal follows from the parent's by sums of squares. No information matrix is formed or inverted, which
allows increments known a hundred thousand times better in one direction than in another. Time and memory grow with the
sum of the squared clique sizes, for a path with loops nearly with its length. The order of elimination is along the
path without landmarks, COLAMD otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numba
import numpy as np

from data.inputs import IntArray
from data.se2 import Array


class Structure(NamedTuple):
    """The sparsity of an elimination; positions in the order of elimination (a postorder)."""

    variable: IntArray  # (V,) eliminated at each position
    parent: IntArray  # (V,) position, -1 for a root
    children: IntArray  # (V,) their number
    start: IntArray  # (V + 1,) first index of each position in `separator`
    separator: IntArray  # positions of each separator, ascending
    first: IntArray  # (V + 1,) first index of each position in `block`
    block: IntArray  # (B,) rows of `Rows` by position


def structure(variable: IntArray, order: IntArray) -> Structure:
    """Symbolic elimination, in the order (V,), of blocks of the variables (B, 2) or (B, 3), as of `Rows`. The order is
    rearranged to a postorder of the elimination tree, which changes nothing else.
    """
    position = np.empty(len(order), np.int64)
    position[order] = np.arange(len(order))
    placed = np.where(variable >= 0, position[variable], -1)
    ends = np.sort(np.where(placed >= 0, placed, placed.max(axis=1, keepdims=True)), axis=1)
    parent, start, separator = _separators(ends, len(order))
    post = _postorder(parent)  # post[new] = old
    new = np.empty_like(post)
    new[post] = np.arange(len(post))
    parent = np.where(parent[post] >= 0, new[parent[post]], -1)
    length = np.diff(start)[post]
    moved = np.concatenate([[0], np.cumsum(length)])
    separator = _moved(separator, start, post, new, moved)
    owner = new[ends[:, 0]]
    block = np.argsort(owner, kind="stable")
    first = np.searchsorted(owner[block], np.arange(len(order) + 1))
    children = np.bincount(parent[parent >= 0], minlength=len(order))
    return Structure(order[post], parent, children, moved, separator, first, block)


@numba.njit(cache=True)
def _separators(ends: IntArray, size: int) -> tuple[IntArray, IntArray, IntArray]:
    """Parent and separator of each position, from blocks of positions `ends` (B, k), the least first."""
    count = np.zeros(size + 1, np.int64)
    others = ends.shape[1] - 1
    for i in range(len(ends)):
        count[ends[i, 0] + 1] += others
    first, fill = np.zeros(size + 1, np.int64), np.zeros(size + 1, np.int64)
    for v in range(size):
        first[v + 1] = fill[v + 1] = first[v] + count[v + 1]
    later = np.empty(others * len(ends), np.int64)
    for i in range(len(ends)):
        for q in range(others):
            later[fill[ends[i, 0]]] = ends[i, 1 + q]
            fill[ends[i, 0]] += 1
    parent, mark = np.empty(size, np.int64), np.empty(size, np.int64)
    child, sibling = np.empty(size, np.int64), np.empty(size, np.int64)
    for v in range(size):
        parent[v] = mark[v] = child[v] = sibling[v] = -1
    start, out, used = np.zeros(size + 1, np.int64), np.empty(4 * size + 16, np.int64), 0
    for v in range(size):
        begin = used
        mark[v] = v
        bound = first[v + 1] - first[v]
        c = child[v]
        while c >= 0:
            bound += start[c + 1] - start[c]
            c = sibling[c]
        if used + bound > len(out):
            more = np.empty(2 * len(out) + bound, np.int64)
            for i in range(used):
                more[i] = out[i]
            out = more
        for i in range(first[v], first[v + 1]):
            u = later[i]
            if mark[u] != v:
                mark[u] = v
                out[used] = u
                used += 1
        c = child[v]
        while c >= 0:
            for i in range(start[c], start[c + 1]):
                u = out[i]
                if mark[u] != v:
                    mark[u] = v
                    out[used] = u
                    used += 1
            c = sibling[c]
        start[v + 1] = used
        if used > begin:
            p = out[begin]
            for i in range(begin + 1, used):
                p = min(p, out[i])
            parent[v] = p
            sibling[v] = child[p]
            child[p] = v
    return parent, start, out[:used].copy()


@numba.njit(cache=True)
def _postorder(parent: IntArray) -> IntArray:
    """Positions with children before their parents, subtree by subtree."""
    n = len(parent)
    child, sibling = np.empty(n, np.int64), np.empty(n, np.int64)
    for v in range(n):
        child[v] = sibling[v] = -1
    for v in range(n - 1, -1, -1):
        if parent[v] >= 0:
            sibling[v] = child[parent[v]]
            child[parent[v]] = v
    post, stack, done = np.empty(n, np.int64), np.empty(n, np.int64), 0
    for root in range(n):
        if parent[root] >= 0:
            continue
        depth = 1
        stack[0] = root
        while depth > 0:
            v = stack[depth - 1]
            c = child[v]
            if c >= 0:
                child[v] = sibling[c]
                stack[depth] = c
                depth += 1
            else:
                post[done] = v
                done += 1
                depth -= 1
    return post


def _moved(separator: IntArray, start: IntArray, post: IntArray, new: IntArray, moved: IntArray) -> IntArray:
    """The separators by their new positions, each ascending."""
    row = np.repeat(np.arange(len(post)), np.diff(moved))
    position = new[separator[np.arange(len(separator)) - moved[row] + start[post][row]]]
    row *= len(post)  # so that a sort leaves every position in its separator
    sorted_: IntArray = np.sort(row + position) - row
    return sorted_


SLACK = 1.25  # A front with more than this many times the rows that its columns can need is made triangular first
SINGULAR = 1e-12  # A diagonal of R below this share of its column is rounding, not information
SMALLEST = 1e-150  # least diagonal of R whose square has an inverse


class Rows(NamedTuple):
    """Whitened rows of a least-squares problem in V variables, in B blocks of up to three."""

    variable: IntArray  # (B, 2) of a block, -1 for none; (B, 3) with a third variable, of one column
    A: Array  # (B, 3, 6) coefficients, three columns each; (B, 3, 7) with a third variable
    b: Array  # (B, 3, c) right-hand sides
    height: IntArray  # (B,) rows in use
    dim: IntArray  # (V,) 1 to 3 columns in use


class Triangle(NamedTuple):
    """The eliminated problem: R, S and d of all positions, row-major, concatenated."""

    R: Array
    S: Array
    d: Array
    at_S: IntArray  # offsets of the positions in S
    free: int  # the first variable that the rows do not determine, -1: none
    left: Array  # (c, c) squares and products of the residuals of the right-hand sides


def eliminate(rows: Rows, s: Structure) -> Triangle:
    """QR of all rows, variable by variable."""
    dim = rows.dim[s.variable]
    width = _widths(dim, s.start, s.separator)
    at_S = np.concatenate([[0], np.cumsum(dim * width)])
    R, S, d, left, free = _eliminate(rows, s, dim, width, at_S)
    return Triangle(R, S, d, at_S, int(s.variable[free]) if free >= 0 else -1, left)


@numba.njit(cache=True)
def _widths(dim: IntArray, start: IntArray, separator: IntArray) -> IntArray:
    """Columns of each separator."""
    width = np.zeros(len(dim), np.int64)
    for v in range(len(dim)):
        for i in range(start[v], start[v + 1]):
            width[v] += dim[separator[i]]
    return width


@numba.njit(cache=True)
def reflect(F: Array, columns: int) -> None:
    """Householder reflections that make the first columns of F (m, n) upper triangular, in place."""
    m, n = F.shape
    w = np.empty(n)
    for k in range(min(columns, m)):
        total = 0.0
        for i in range(k + 1, m):
            total += F[i, k] * F[i, k]
        if total == 0.0:
            continue
        norm = np.sqrt(F[k, k] * F[k, k] + total)
        if F[k, k] > 0.0:
            norm = -norm
        head = F[k, k] - norm
        scale = -1.0 / (norm * head)  # of (head, F[k+1:, k]): 2 / its square
        for j in range(k + 1, n):
            w[j] = head * F[k, j]
        for i in range(k + 1, m):
            f = F[i, k]
            if f != 0.0:
                for j in range(k + 1, n):
                    w[j] += f * F[i, j]
        for j in range(k + 1, n):
            w[j] *= scale
            F[k, j] -= head * w[j]
        for i in range(k + 1, m):
            f = F[i, k]
            if f != 0.0:
                for j in range(k + 1, n):
                    F[i, j] -= f * w[j]
            F[i, k] = 0.0
        F[k, k] = norm


@numba.njit(cache=True)
def _eliminate(
    rows: Rows, s: Structure, dim: IntArray, width: IntArray, at_S: IntArray
) -> tuple[Array, Array, Array, Array, int]:
    variables, A, b, height, _ = rows
    variable, parent, children, start, separator, first, block = s
    c, size = b.shape[2], len(variable)
    R, S, d = np.zeros((size, 3, 3)), np.empty(at_S[-1]), np.zeros((size, 3, c))
    place, column = np.empty(size, np.int64), np.empty(size, np.int64)
    for v in range(size):
        place[variable[v]] = v
    # stack of rows for parents, child by child; the last `children` entries are for this variable
    waiting, used = np.empty(1024), 0
    kept, depth = np.empty((size, 2), np.int64), 0
    left = np.zeros((c, c))
    for v in range(size):
        n = width[v] + c
        m = 0
        for i in range(first[v], first[v + 1]):
            m += height[block[i]]
        for q in range(depth - children[v], depth):
            m += kept[q, 1]
        F = np.zeros((max(m, dim[v]), dim[v] + n))
        column[v] = 0
        at = dim[v]
        for i in range(start[v], start[v + 1]):
            column[separator[i]] = at
            at += dim[separator[i]]
        r = 0
        for i in range(first[v], first[v + 1]):
            k = block[i]
            for q in range(variables.shape[1]):
                if variables[k, q] >= 0:
                    to = place[variables[k, q]]
                    for row in range(height[k]):
                        for j in range(dim[to]):
                            F[r + row, column[to] + j] = A[k, row, 3 * q + j]
            for row in range(height[k]):
                for j in range(c):
                    F[r + row, at + j] = b[k, row, j]
            r += height[k]
        for q in range(depth - children[v], depth):
            child = kept[q, 0]
            wide = width[child] + c
            begin = used
            for other in range(q, depth):
                begin -= kept[other, 1] * (width[kept[other, 0]] + c)
            for row in range(kept[q, 1]):
                source = begin + row * wide
                for i in range(start[child], start[child + 1]):
                    to = separator[i]
                    for j in range(dim[to]):
                        F[r, column[to] + j] = waiting[source]
                        source += 1
                for j in range(c):
                    F[r, at + j] = waiting[source + j]
                r += 1
        for q in range(depth - children[v], depth):
            used -= kept[q, 1] * (width[kept[q, 0]] + c)
        depth -= children[v]
        norm = np.zeros(dim[v])
        for i in range(m):
            for j in range(dim[v]):
                norm[j] += F[i, j] * F[i, j]
        reflect(F, dim[v])
        for j in range(dim[v]):
            if not abs(F[j, j]) > max(SINGULAR * np.sqrt(norm[j]), SMALLEST):
                return R, S, d, left, v
        for i in range(dim[v]):
            for j in range(dim[v]):
                R[v, i, j] = F[i, j]
            for j in range(width[v]):
                S[at_S[v] + i * width[v] + j] = F[i, dim[v] + j]
            for j in range(c):
                d[v, i, j] = F[i, at + j]
        # the rest of the rows begins in F at (corner, corner)
        corner, remain = dim[v], max(m - dim[v], 0)
        if remain > SLACK * n:
            rest = np.empty((remain, n))
            for i in range(remain):
                for j in range(n):
                    rest[i, j] = F[corner + i, corner + j]
            reflect(rest, n)
            F, corner, remain = rest, 0, n
        if parent[v] < 0:
            for i in range(remain):
                for j in range(c):
                    for q in range(c):
                        left[j, q] += F[corner + i, corner + j] * F[corner + i, corner + q]
            continue
        if used + remain * n > len(waiting):
            more = np.empty(2 * (used + remain * n))
            for i in range(used):
                more[i] = waiting[i]
            waiting = more
        for i in range(remain):
            for j in range(n):
                waiting[used] = F[corner + i, corner + j]
                used += 1
        kept[depth, 0], kept[depth, 1] = v, remain
        depth += 1
    return R, S, d, left, -1


NO_DRIFT = np.empty(0, np.int64)


def ordering(variable: IntArray, poses: int, size: int, drift: IntArray = NO_DRIFT) -> IntArray:
    """Order (V,) for blocks of the variables (B, 2) or (B, 3), -1 for none: poses first, landmarks, drifts last.

    Poses alone are a chain, eliminated backwards, and each drift after the last pose that it leads to: `drift` (K,) is
    the first one. With landmarks gtsam's COLAMD finds an order with little fill-in.
    """
    if poses + len(drift) == size:
        along = np.concatenate([np.arange(poses), drift - 0.5])
        return np.argsort(along, kind="stable")[::-1].astype(np.int64)
    pattern = gtsam.SymbolicFactorGraph()
    for block in np.unique(np.sort(variable, axis=1), axis=0).tolist():
        pattern.push_factor(*(v for v in block if v >= 0))
    found = gtsam.Ordering.ColamdSymbolicFactorGraph(pattern)
    return np.array([found.at(i) for i in range(found.size())], np.int64)
