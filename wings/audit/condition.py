"""What a graph does not determine, and what it says twice: gauge freedom, loose variables, parts, duplicates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from data.inputs import IntArray
from data.se2 import Array
from wings.audit.components import weighted_rows
from wings.audit.linear import Factored, solved

MOVES = 1e-6  # share of a null vector's largest entry that counts as motion
WEAKEST, ITERATIONS = 3, 3  # directions, and inverse iterations, in which the curvature is looked at
WHOLE, FEW = 0.9, 3  # share, and least number, of the poses that move with the whole graph
MOST = 512  # directions without information that are looked at


@dataclass(frozen=True)
class Condition:
    """Findings about the structure of a graph.

    Attributes:
        parts: numbers of variables of the connected parts, largest first.
        gauge: directions in which whole parts can move.
        loose: variables that nothing ties in some directions: position in the keys, and number of directions.
        duplicates: pairs of factors with equal variables, residuals and Jacobians.
    """

    parts: tuple[int, ...]
    gauge: int
    loose: tuple[tuple[int, int], ...]
    duplicates: tuple[tuple[int, int], ...]


def condition(f: Factored, part: IntArray, metres: Sequence[IntArray]) -> Condition:
    """The findings; `part` (V,) is the connected part of each variable, `metres` its components that are a position."""
    sizes = tuple(sorted(np.bincount(part).tolist(), reverse=True))
    gauge, loose = 0, list[tuple[int, int]]()
    N = _null(f, f.dropped[-MOST:])
    placed = np.array([len(each) > 0 for each in metres])
    for p in np.unique(part).tolist() if N.shape[1] else []:
        members = np.flatnonzero(part == p)
        rows = np.concatenate([_columns(f, u) for u in members.tolist()])
        poses = members[placed[members]] if placed[members].any() else members
        found, rest = _gauge(f, N[:, (np.abs(N[rows]) > MOVES).any(0)], members, poses)
        gauge += found
        moved = _ranks(f, rest, members)
        loose += [(int(u), int(n)) for u, n in zip(members[moved > 0], moved[moved > 0], strict=True)]
    return Condition(sizes, gauge, tuple(sorted(loose)), _duplicates(f))


def _gauge(f: Factored, N: Array, members: IntArray, poses: IntArray) -> tuple[int, Array]:
    """Number of the directions that move nearly all poses, and what still moves while some poses stay.

    A pose stays that lets the fewest others move, of a few: one that is loose itself would let all. More than a pose is
    held only where a number of others moves, as with the scale that cameras leave open.
    """
    gauge, held = 0, np.zeros(0, np.int64)
    while N.shape[1]:
        free = np.setdiff1d(poses, held)
        rank = _ranks(f, N, free)
        if np.count_nonzero(rank) < max(WHOLE * len(free), FEW if len(held) else 1):
            break
        typical = free[rank == np.bincount(rank[rank > 0]).argmax()]
        tries = [_held(f, N, int(v)) for v in typical[[0, len(typical) // 2, -1]]]
        counts = [np.count_nonzero(_ranks(f, rest, members)) for _, rest in tries]
        best = int(np.argmin(counts))
        gauge, N = gauge + tries[best][0], tries[best][1]
        held = np.append(held, typical[[0, len(typical) // 2, -1]][best])
    return gauge, N


def _held(f: Factored, N: Array, v: int) -> tuple[int, Array]:
    """Number of directions in which a variable moves, and the motions in which it stays."""
    _, s, Vt = np.linalg.svd(N[_columns(f, v)])
    rank = int((s > MOVES).sum())
    return rank, N @ Vt[rank:].T


def _ranks(f: Factored, N: Array, some: IntArray) -> IntArray:
    """Number of directions in which each of some variables moves."""
    out = np.zeros(len(some), np.int64)
    for d in np.unique(f.system.dim[some]).tolist() if N.shape[1] else []:
        mine = np.flatnonzero(f.system.dim[some] == d)
        blocks = N[f.at[some[mine]][:, None] + np.arange(d)]
        out[mine] = (np.linalg.svd(blocks, compute_uv=False) > MOVES).sum(1)
    return out


def _columns(f: Factored, v: int) -> IntArray:
    return np.arange(f.at[v], f.at[v] + f.system.dim[v])


def _null(f: Factored, dropped: IntArray) -> Array:
    """Motions (N, k) that cost nothing, one for each dropped column, in sigmas, scaled to 1."""
    A = weighted_rows(f)
    norm = np.sqrt(np.asarray(A.multiply(A).sum(0)).ravel())[:, None]
    n = solved(f, np.asarray(-(A.T @ A[:, dropped]).toarray()))
    n[dropped, np.arange(len(dropped))] += 1.0
    n *= np.where(norm > 0.0, norm, 1.0)
    out: Array = n / np.maximum(np.abs(n).max(0, initial=0.0), np.finfo(float).tiny)
    return out


def curvature(f: Factored, cost: Callable[[Array], float], rng: np.random.Generator, tries: int = WEAKEST) -> float:
    """Least curvature of a cost, half the sum of squares after a step (N,), along the weakest directions.

    It is relative to the linearized problem: 1 if that is exact, negative at a saddle. Each direction is as long as one
    sigma; they are those of a few inverse iterations.
    """
    if f.rank == 0:
        return 1.0
    A = weighted_rows(f)
    x = rng.standard_normal((f.columns, tries))
    for _ in range(ITERATIONS):
        x = solved(f, np.linalg.qr(x)[0])
    length = np.linalg.norm(A @ x, axis=0)
    x = x / np.where(length > 0.0, length, np.inf)
    middle = cost(np.zeros(f.columns))
    return min(cost(step) + cost(-step) - 2.0 * middle for step in x.T)


def _duplicates(f: Factored) -> tuple[tuple[int, int], ...]:
    seen: dict[bytes, int] = {}
    out = []
    for g in f.system.groups:
        for i, variables, A, r in zip(g.factor.tolist(), g.variables, g.A, g.r, strict=True):
            key = variables.tobytes() + A.tobytes() + r.tobytes()
            if key in seen:
                out.append((seen[key], i))
            else:
                seen[key] = i
    return tuple(out)
