"""Sparse QR of a linearized graph in dense fronts, with solutions and joint marginal covariances (Takahashi).

As `graph.qr.elimination`, for variables of any dimension and factors of any number of variables: each front holds a
few variables (a supernode) and is made triangular by LAPACK. A column that depends on those before it, gauge freedom or
a variable that nothing ties, is left out: its variable keeps its value in that direction. All that residuals depend on
is invariant to this choice (Rao and Mitra, "Generalized inverse of matrices", 1971, section 2.5).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from scipy.linalg import lapack

from data.inputs import IntArray
from data.se2 import Array
from graph.audit.linear import Group, System
from graph.qr.elimination import structure

DEPENDENT = 1e-9  # share of a column's norm below which its remainder is rounding: 1e-10 was seen on 20 000 poses
NOTHING = 1e-60  # coefficients below are zero: rounding of rounding ends in slow subnormal numbers
SMALL_FRONT = 24  # columns of a front into which a child is merged even if zeros are stored
PART = 128  # right-hand sides solved at once: they stay in the cache


@dataclass(eq=False)
class Front:
    """Variables eliminated together: columns of the permuted system.

    Attributes:
        pivot: first and end column of the variables; `kept` (p,) those that are determined.
        after: (s,) columns of the separator, ascending.
        parent: number of the parent's front, -1 at a root.
        R, S: (p, p) and (p, s) of the kept columns: R x_kept + S x_after = d.
        inverse, W: R^-1, and -R^-1 S.
        d: (p,).
    """

    pivot: tuple[int, int]
    after: IntArray
    parent: int
    kept: IntArray
    R: Array
    S: Array
    inverse: Array
    W: Array
    d: Array


@dataclass(frozen=True, eq=False)
class Factored:
    """A system made triangular.

    Attributes:
        at: (V,) first column of each variable in the order of elimination.
        columns: their number.
        fronts: children before parents.
        home: per group, (n,) the front of each factor.
        dropped: columns that the others determine.
        square: least sum of squares of the weighted linear system.
    """

    system: System
    at: IntArray
    columns: int
    fronts: Sequence[Front]
    home: Sequence[IntArray]
    dropped: IntArray
    square: float

    @property
    def rank(self) -> int:
        """Number of determined columns."""
        return self.columns - len(self.dropped)

    def index(self, group: Group) -> IntArray:
        """Columns (n, c) of the variables of each factor."""
        return index_of(group, self.at, self.system.dim)

    def at_of(self, group: Group, n: int) -> IntArray:
        """Columns (c,) of the variables of one factor of a group."""
        return np.concatenate([self.at[v] + np.arange(self.system.dim[v]) for v in group.variables[n].tolist()])


def index_of(group: Group, at: IntArray, dim: IntArray) -> IntArray:
    """Columns (n, c) of the variables of each factor, the first of each variable at `at` (V,)."""
    sizes = dim[group.variables[0]]
    within = np.concatenate([np.arange(size) for size in sizes]) if len(sizes) else np.zeros(0, np.int64)
    out: IntArray = np.repeat(at[group.variables], sizes, axis=1) + within
    return out


def ordering(system: System, last: Sequence[int] = ()) -> IntArray:
    """Order (V,) of elimination with little fill-in; the variables `last` at the end."""
    pattern = gtsam.SymbolicFactorGraph()
    for variables in unique_variables(system):
        pattern.push_factor(*variables)
    if len(last):
        found = gtsam.Ordering.ColamdConstrainedLastSymbolicFactorGraph(pattern, [int(v) for v in last], False)
    else:
        found = gtsam.Ordering.ColamdSymbolicFactorGraph(pattern)
    return np.array([found.at(i) for i in range(found.size())], np.int64)


def unique_variables(system: System) -> Iterator[list[int]]:
    """Sets of variables that share a factor; gtsam's symbolic factors have at most four, larger sets are chained."""
    for group in system.groups:
        if group.variables.shape[1]:
            for variables in np.unique(np.sort(group.variables, axis=1), axis=0).tolist():
                if len(variables) <= 4:
                    yield variables
                else:
                    yield from ([a, b] for k, a in enumerate(variables) for b in variables[k + 1 :])


def factorize(system: System, order: IntArray, scale: Sequence[Array] | None = None) -> Factored:
    """Make the system triangular.

    Args:
        system: the linearized graph.
        order: (V,) of elimination.
        scale: factor (n, d) of each row of each group, besides the root of its weight.
    """
    widest = max(group.variables.shape[1] for group in system.groups)
    padded = np.concatenate(
        [np.pad(g.variables, ((0, 0), (0, widest - g.variables.shape[1])), constant_values=-1) for g in system.groups]
    )
    count = np.cumsum([0] + [len(g.factor) for g in system.groups])
    s = structure(padded, order)
    dim = system.dim[s.variable]
    at_position = np.concatenate([[0], np.cumsum(dim)])
    at = np.empty(len(dim), np.int64)
    at[s.variable] = at_position[:-1]
    heads, ends = _supernodes(s.parent, s.children, np.diff(s.start), dim)
    front_of = np.repeat(np.arange(len(heads)), ends - heads)
    home = np.empty(count[-1], np.int64)
    home[s.block] = np.repeat(front_of, np.diff(s.first))
    homes = [home[a:b] for a, b in pairwise(count.tolist())]
    entries = _entries(system, at, homes, len(heads), scale)
    norm = np.sqrt(np.bincount(entries.column, entries.value**2, at_position[-1]))
    fronts: list[Front] = []
    waiting: list[list[tuple[IntArray, Array]]] = [[] for _ in heads]
    place = np.empty(at_position[-1], np.int64)
    square, dropped = 0.0, list[int]()
    for k, (head, end) in enumerate(zip(heads, ends, strict=True)):
        sep = s.separator[s.start[end - 1] : s.start[end]]
        after = _spread(at_position[sep], dim[sep])
        first, stop = int(at_position[head]), int(at_position[end])
        p, width = stop - first, stop - first + len(after)
        place[first:stop], place[after] = np.arange(p), np.arange(p, width)
        height = entries.height[k]
        F = np.zeros((height + sum(len(rest) for _, rest in waiting[k]), width + 1), order="F")
        part = slice(entries.start[k], entries.start[k + 1])
        F[entries.row[part], place[entries.column[part]]] = entries.value[part]
        F[:height, width] = entries.b[entries.b_start[k] : entries.b_start[k + 1]]
        for columns, rest in waiting[k]:
            F[height : height + len(rest), place[columns]] = rest[:, :-1]
            F[height : height + len(rest), width] = rest[:, -1]
            height += len(rest)
        waiting[k] = []
        kept, T = _triangle(F, p, norm[first:stop])
        q = len(kept)
        dropped += [first + j for j in range(p) if j not in kept] if q < p else []
        R, S, d, rest = T[:q, :q], T[:q, q:-1], T[:q, -1], T[q:, q:]
        inverse = lapack.dtrtri(R)[0] if q else np.zeros((0, 0))
        parent = int(front_of[sep[0]]) if len(sep) else -1
        fronts.append(Front((first, stop), after, parent, first + kept, R, S, inverse, -inverse @ S, d))
        if parent >= 0:
            waiting[parent].append((after, rest))
        else:
            square += float(np.sum(rest[:, -1] ** 2))
    return Factored(system, at, int(at_position[-1]), fronts, homes, np.array(dropped, np.int64), square)


def _triangle(F: Array, p: int, norm: Array) -> tuple[IntArray, Array]:
    """Determined columns among the first `p`, and the triangle (q + rest, q + after + 1) of all other columns."""
    kept = np.arange(p)
    if not len(F):
        return kept[:0], F[:, p:]
    while True:
        T = lapack.dgeqrf(F[:, _all_but(p, kept, F.shape[1])] if len(kept) < p else F)[0]
        q = len(kept)
        T = np.triu(T[: T.shape[1]])
        T[np.abs(T) < NOTHING] = 0.0
        diagonal = np.zeros(q)
        m = min(q, len(T))
        diagonal[:m] = np.abs(np.diagonal(T))[:m]
        bad = np.flatnonzero(~(diagonal > DEPENDENT * norm[kept]))
        if not len(bad):
            return kept, T
        kept = np.delete(kept, bad[0])


def _all_but(p: int, kept: IntArray, width: int) -> IntArray:
    return np.concatenate([kept, np.arange(p, width)])


def _spread(first: IntArray, size: IntArray) -> IntArray:
    """Numbers first ... first + size - 1 of each, concatenated."""
    if not len(first):
        return np.zeros(0, np.int64)
    out: IntArray = np.repeat(first - np.cumsum(size) + size, size) + np.arange(int(size.sum()))
    return out


def _supernodes(parent: IntArray, children: IntArray, seps: IntArray, dim: IntArray) -> tuple[IntArray, IntArray]:
    """First and end position of each front: a variable joins its parent's where that stores no or few zeros."""
    heads = [0]
    for v in range(1, len(parent)):
        joined = parent[v - 1] == v
        exact = seps[v - 1] == seps[v] + 1 and children[v] == 1
        small = int(dim[heads[-1] : v + 1].sum()) + int(dim[v]) * int(seps[v]) <= SMALL_FRONT and children[v] == 1
        if not (joined and (exact or small)):
            heads.append(v)
    return np.array(heads), np.array([*heads[1:], len(parent)])


@dataclass(frozen=True, eq=False)
class _Entries:
    """Coefficients by front: row in its front, column, value; right-hand sides; number of rows of each front."""

    start: IntArray
    row: IntArray
    column: IntArray
    value: Array
    b_start: IntArray
    b: Array
    height: IntArray


def _entries(
    system: System, at: IntArray, homes: Sequence[IntArray], fronts: int, scale: Sequence[Array] | None
) -> _Entries:
    row_home = np.concatenate(
        [np.repeat(home, g.r.shape[1]) for home, g in zip(homes, system.groups, strict=True)]
    )  # front of each row
    by_front = np.argsort(row_home, kind="stable")
    b_start = np.searchsorted(row_home[by_front], np.arange(fronts + 1))
    local = np.empty(len(row_home), np.int64)
    local[by_front] = np.arange(len(row_home)) - np.repeat(b_start[:-1], np.diff(b_start))
    rows, columns, values, right, used = [], [], [], [], 0
    for k, g in enumerate(system.groups):
        n, d, c = g.A.shape
        factor = np.sqrt(g.weight)[:, None] if scale is None else np.sqrt(g.weight)[:, None] * scale[k]
        rows.append(np.repeat(np.arange(used, used + n * d), c))
        columns.append(np.repeat(index_of(g, at, system.dim), d, axis=0).ravel())
        values.append((g.A * np.broadcast_to(factor, (n, d))[:, :, None]).ravel())
        right.append((-g.r * factor).ravel())
        used += n * d
    row, column, value = np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
    order = np.argsort(row_home[row], kind="stable")
    start = np.searchsorted(row_home[row][order], np.arange(fronts + 1))
    b = np.concatenate(right)[by_front]
    return _Entries(start, local[row[order]], column[order], value[order], b_start, b, np.diff(b_start))


def step(f: Factored) -> Array:
    """Columns (N,) of the least-squares step."""
    x = np.zeros(f.columns)
    for front in reversed(f.fronts):
        x[front.kept] = front.inverse @ front.d + front.W @ x[front.after]
    return x


def forward(f: Factored, right: Array, homes: IntArray | None = None) -> Array:
    """R^-T right (N, c), which is overwritten; products of columns are those of `right` with the covariance between.

    `homes`: fronts in which alone `right` is not zero, or all.
    """
    y = np.zeros_like(right)
    for front in f.fronts if homes is None else _above(f, homes):
        z = front.inverse.T @ right[front.kept]
        y[front.kept] = z
        if len(front.after):
            right[front.after] -= front.S.T @ z
    return y


def solved(f: Factored, right: Array, homes: IntArray | None = None) -> Array:
    """Solution (N, c) of the normal equations  A' W A x = right (N, c); arguments as of `forward`."""
    y = forward(f, right, homes)
    for front in reversed(f.fronts):
        y[front.kept] = front.inverse @ y[front.kept] + front.W @ y[front.after]
    return y


def _above(f: Factored, homes: IntArray) -> Iterator[Front]:
    """The fronts on the ways from some to their roots, children before parents."""
    seen = set[int]()
    for home in homes.tolist():
        while home >= 0 and home not in seen:
            seen.add(home)
            home = f.fronts[home].parent
    return (f.fronts[k] for k in sorted(seen))


def joint_covariances(f: Factored) -> list[Array]:
    """Joint marginal covariance (n, c, c) of the variables of each factor, per group, by one pass from the roots.

    Takahashi, Fagan and Chin, "Formation of a sparse bus impedance matrix", PICA 1973, by fronts. Directions that are
    not determined have zero variance.
    """
    indices = [f.index(g) for g in f.system.groups]
    out = [np.empty((*i.shape, i.shape[1])) for i in indices]
    members: list[list[tuple[int, IntArray]]] = [[] for _ in f.fronts]
    for k, home in enumerate(f.home):
        by_front = np.argsort(home, kind="stable")
        edges = np.flatnonzero(np.diff(home[by_front])) + 1
        for part in np.split(by_front, edges):
            if len(part):
                members[home[part[0]]].append((k, part))
    children = np.bincount([front.parent for front in f.fronts if front.parent >= 0], minlength=len(f.fronts))
    place = np.empty(f.columns, np.int64)
    full: list[Array | None] = [None] * len(f.fronts)
    for v in range(len(f.fronts) - 1, -1, -1):
        front = f.fronts[v]
        first, stop = front.pivot
        p, s, q = stop - first, len(front.after), len(front.kept)
        C = np.zeros((p + s, p + s))
        own = slice(0, p) if q == p else front.kept - first
        if s:
            above = f.fronts[front.parent]
            a, b = above.pivot
            place[a:b], place[above.after] = np.arange(b - a), np.arange(b - a, b - a + len(above.after))
            whole = full[front.parent]
            assert whole is not None
            at = place[front.after]
            C[p:, p:] = whole[at[:, None], at]
            children[front.parent] -= 1
            if not children[front.parent]:
                full[front.parent] = None
            cross = front.W @ C[p:, p:]
            C[own, p:], C[p:, own] = cross, cross.T
            block = front.inverse @ front.inverse.T + cross @ front.W.T
        else:
            block = front.inverse @ front.inverse.T
        if q == p:
            C[:p, :p] = block
        else:
            C[np.ix_(front.kept - first, front.kept - first)] = block
        if children[v]:
            full[v] = C
        if members[v]:
            place[first:stop], place[front.after] = np.arange(p), np.arange(p, p + s)
            for k, part in members[v]:
                at = place[indices[k][part]]
                out[k][part] = C[at[:, :, None], at[:, None, :]]
    return out
