"""Factors left out, and the graph solved again: how far the path moves, and how much the cost falls, nonlinearly.

Newton's steps keep the factored system of the whole graph, without the rows left out (Woodbury's identity): a step
costs a gradient and a solution. Where that does not descend, the graph is optimized anew.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from wings.audit.audit import Audit, places
from wings.audit.factors import UNSEEN
from wings.audit.files import moved, optimized
from wings.audit.linear import Graph, Values, solved

STEPS, CLOSE = 12, 1e-2  # steps; length in sigmas of one that ends them


def left_out(graph: Graph, values: Values, a: Audit, sets: Sequence[Sequence[int]]) -> list[tuple[float, float]]:
    """Of each set of factors without it: motion of the worst point in m, and decrease of the sum of squares.

    Args:
        graph: the graph.
        values: its optimum.
        a: the audit of both.
        sets: numbers of factors that are left out together.
    """
    where = {int(i): (k, n) for k, g in enumerate(a.f.system.groups) for n, i in enumerate(g.factor)}
    begin = 2.0 * graph.error(values)
    out = []
    for some in sets:
        rest = gtsam.NonlinearFactorGraph(graph)
        for i in some:
            rest.remove(int(i))
        end = _solved(rest, values, a, [where[int(i)] for i in some])
        apart = np.linalg.norm(places(end, a.f.system.keys) - a.place, axis=1)
        out.append((float(np.nanmax(apart, initial=0.0)), begin - 2.0 * rest.error(end)))
    return out


def _solved(rest: Graph, values: Values, a: Audit, some: Sequence[tuple[int, int]]) -> Values:
    f = a.f
    rows = [(f.at_of(g, n), np.sqrt(g.weight[n]) * g.A[n]) for g, n in ((f.system.groups[k], n) for k, n in some)]
    A = np.zeros((sum(len(J) for _, J in rows), f.columns))
    at = 0
    for columns, J in rows:
        A[at : at + len(J), columns] = J
        at += len(J)
    Z = solved(f, A.T.copy())
    size, V = np.linalg.eigh(np.eye(len(A)) - A @ Z)
    inverse = np.divide(1.0, size, out=np.zeros_like(size), where=size > UNSEEN)  # unseen directions stay
    cost, now = rest.error(values), values
    for _ in range(STEPS):
        g = np.zeros(f.columns)
        gradient = rest.linearize(now).gradientAtZero()
        for v, key in enumerate(f.system.keys):
            if gradient.exists(key):
                g[f.at[v] : f.at[v] + f.system.dim[v]] = gradient.at(key)
        y = solved(f, -g[:, None].copy())[:, 0]
        x = y + Z @ (V @ (inverse * (V.T @ (A @ y))))
        if float(-g @ x) < CLOSE**2:
            return now
        tried = moved(f.system, f.at, x, now)
        new = rest.error(tried)
        if not new < cost:
            return optimized(rest, now, quick=True)
        now, cost = tried, new
    return optimized(rest, now, quick=True)
