"""Symbolic elimination: which variables meet in which clique, for a given order."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from data.inputs import IntArray


class Structure(NamedTuple):
    """What elimination in a given order does to the sparsity; positions in the order of elimination (a postorder).

    variable: (V,) eliminated at each position; parent: (V,) position, -1 for a root; children: (V,) how many;
    start: (V + 1,) and separator: positions of each separator, ascending; first, block: the rows by position (CSR).
    """

    variable: IntArray
    parent: IntArray
    children: IntArray
    start: IntArray
    separator: IntArray
    first: IntArray
    block: IntArray


def structure(variable: IntArray, order: IntArray) -> Structure:
    """Symbolic elimination, in the order (V,), of blocks of the variables (B, 2) or (B, 3), as of `Rows`.

    The order is rearranged to a postorder of the elimination tree, which changes nothing else.
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
def _separators(ends, size):  # type: ignore[no-untyped-def]
    """Parent and separator of each position, from blocks of positions `ends` (B, k), the least first."""
    count = np.zeros(size + 1, np.int64)
    others = ends.shape[1] - 1
    for i in range(len(ends)):
        count[ends[i, 0] + 1] += others
    first = np.cumsum(count)
    later, fill = np.empty(others * len(ends), np.int64), first.copy()
    for i in range(len(ends)):
        for q in range(others):
            later[fill[ends[i, 0]]] = ends[i, 1 + q]
            fill[ends[i, 0]] += 1
    parent, mark = np.full(size, -1), np.full(size, -1)
    child, sibling = np.full(size, -1), np.full(size, -1)
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
            more[:used] = out[:used]
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
            p = out[begin:used].min()
            parent[v] = p
            sibling[v] = child[p]
            child[p] = v
    return parent, start, out[:used].copy()


@numba.njit(cache=True)
def _postorder(parent):  # type: ignore[no-untyped-def]
    """Positions in an order in which children come before their parents, subtree by subtree."""
    n = len(parent)
    child, sibling = np.full(n, -1), np.full(n, -1)
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


@numba.njit(cache=True)
def _moved(separator, start, post, new, moved):  # type: ignore[no-untyped-def]
    """The separators by their new positions, each ascending."""
    out = np.empty_like(separator)
    for v in range(len(post)):
        old = post[v]
        n = start[old + 1] - start[old]
        for i in range(n):
            out[moved[v] + i] = new[separator[start[old] + i]]
        out[moved[v] : moved[v] + n] = np.sort(out[moved[v] : moved[v] + n])
    return out
