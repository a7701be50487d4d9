"""What a graph does not determine, and what it says twice: gauge freedom, loose variables, parts, duplicates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from data.inputs import IntArray
from data.se2 import Array
from graph.audit.components import weighted_rows
from graph.audit.fronts import Factored, solved

MOVES = 1e-6  # share of a null vector's largest entry that counts as motion
WEAKEST, ITERATIONS = 3, 3  # directions, and inverse iterations, in which the curvature is looked at
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


def condition(f: Factored, part: IntArray, first: Sequence[int]) -> Condition:
    """The findings; `part` (V,) is the connected part of each variable, `first` the variable of each that stays."""
    sizes = tuple(sorted(np.bincount(part).tolist(), reverse=True))
    gauge, loose = 0, list[tuple[int, int]]()
    N = _null(f, f.dropped[-MOST:])
    for v in first if N.shape[1] else []:
        rows = np.concatenate([_columns(f, u) for u in np.flatnonzero(part == part[v]).tolist()])
        mine = N[:, (np.abs(N[rows]) > MOVES).any(0)]
        _, s, Vt = np.linalg.svd(mine[_columns(f, v)])
        rank = int((s > MOVES).sum())
        gauge += rank
        rest = mine @ Vt[rank:].T  # what else moves while the first variable stays
        if rest.shape[1]:
            for u in np.flatnonzero(part == part[v]).tolist():
                moved = int((np.linalg.svd(rest[_columns(f, u)], compute_uv=False) > MOVES).sum())
                loose += [(u, moved)] * (moved > 0)
    return Condition(sizes, gauge, tuple(sorted(loose)), _duplicates(f))


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
