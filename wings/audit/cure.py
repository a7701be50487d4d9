"""A cure for a graph file: variance components applied, rejected factors left out or robust; how it predicts loops.

Cross-validation: every tenth relation of poses that are no neighbours is left out, and predicted from all others. The
share of predictions inside their stated 50, 90 and 95 % is the proof that a cure helped, or did not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.stats import chi2

from data.formats.graph_file import Edge, GraphFile
from data.inputs import IntArray
from data.se2 import Array
from wings.audit.audit import FAMILY, Audit, examined, firsts
from wings.audit.factors import log_tail
from wings.audit.files import LAST_FIRST, build, optimized
from wings.audit.linear import factorize, index_of, linearize, ordering, solved, step

LEVELS = (0.5, 0.9, 0.95)
TENTH = 10  # every so many loops are left out
ROUNDS = 8  # of rescaling and leaving out in turn, at most


@dataclass(frozen=True)
class Cure:
    """What a cure changes: information (d, d) of edges by number, edges left out, and weights of those made robust."""

    information: dict[int, Array]
    left_out: set[int]
    robust: dict[int, float]


def cure(file: GraphFile, a: Audit, values: gtsam.Values, *, robust: bool = False) -> Cure:
    """Components and rejected factors in turn, as each disturbs the other: first rescaled, then the rejected left out.

    Args:
        file: the graph.
        a: its audit.
        values: its estimate.
        robust: keep rejected factors under Cauchy's loss; their information is multiplied by their weight at the end,
            so that the file, which has no losses, has the optimum of the robust graph.
    """
    kept, edges, loose = np.arange(len(file.edges)), list(file.edges), set[int]()
    kind = [a.kinds.names[k] for k in a.kinds.of[: len(edges)].tolist()]  # a loss makes no other kind
    for turn in range(ROUNDS):
        if turn % 2 == 0:
            edges = [replace(e, information=each) for e, each in zip(edges, rescaled(edges, a), strict=True)]
        else:
            rejected = rejected_factors(a, len(edges)) - loose
            if not rejected:
                break
            if robust:
                loose |= rejected
            else:
                kept = np.delete(kept, sorted(rejected))
                edges = [edge for i, edge in enumerate(edges) if i not in rejected]
        graph, start, names = build(replace(file, edges=edges), loose)
        start.update(known(values, start))
        values = optimized(graph, start)
        a = examined(graph, values, [kind[i] for i in kept.tolist()] + names[len(edges) :], draws=0)
    weight = {i: float(a.factors.weight[i]) for i in loose}
    information = {
        int(i): edge.information * weight.get(k, 1.0) for k, (i, edge) in enumerate(zip(kept, edges, strict=True))
    }
    return Cure(information, set(range(len(file.edges))) - set(information), weight)


def known(values: gtsam.Values, wanted: gtsam.Values) -> gtsam.Values:
    """The values of the variables that are wanted."""
    out = gtsam.Values(values)
    for key in set(values.dims()) - set(wanted.dims()):
        out.erase(key)
    return out


def rejected_factors(a: Audit, size: int) -> set[int]:
    """Rejected edges; if a cluster is, its factors alone: others are rejected because of it."""
    together = {i for c, p in zip(a.clusters, a.p_cluster, strict=True) if p < FAMILY for i in c.factors}
    alone = set(a.wrong.tolist())
    if together:
        best = min((k for k, p in enumerate(a.p_cluster) if p < FAMILY), key=lambda k: a.clusters[k].log_p)
        single = log_tail(a.factors.deleted, np.maximum(a.factors.rank, 1))[list(alone)]
        if not len(alone) or a.clusters[best].log_p < single.min():
            return {i for i in a.clusters[best].factors if i < size}
    return {i for i in alone if i < size}


def rescaled(edges: Sequence[Edge], a: Audit) -> list[Array]:
    """Information (d, d) of each edge with its component applied; where noise is diagonal each axis has its own."""
    axis = {(k, x): a.by_axis.component[j] for j, (k, x) in enumerate(a.axis.tolist())}
    out = []
    for i, edge in enumerate(edges):
        k, d = int(a.kinds.of[i]), len(edge.information)
        if a.kinds.axes[k]:
            component = np.array([axis[k, x] for x in range(d)])
            component = component[LAST_FIRST] if d == 6 else component  # of the file, translation first
        else:
            component = np.full(d, a.by_kind.component[k])
        root = 1.0 / np.sqrt(np.where(np.isfinite(component), component, 1.0))
        out.append(edge.information * root[:, None] * root)
    return out


def coverage(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, loops: IntArray) -> tuple[Array, int]:
    """Share of every tenth of the loops inside the 50, 90 and 95 % that all others predict, and their number."""
    out = loops[::TENTH]
    rest = gtsam.NonlinearFactorGraph(graph)
    for i in out.tolist():
        rest.remove(i)
    values = optimized(rest, values)
    system, alone = linearize(rest, values), gtsam.NonlinearFactorGraph()
    f = factorize(system, ordering(system, firsts(system)))
    x, place = step(f), {key: k for k, key in enumerate(system.keys)}
    known = [i for i in out.tolist() if all(key in place for key in list(graph.at(i).keys()))]
    for i in known:
        alone.add(graph.at(i))
    inside: list[float] = []
    if known:
        predicted = linearize(alone, values)
        for g in predicted.groups:
            variables = np.array([[place[predicted.keys[v]] for v in row] for row in g.variables.tolist()])
            index = index_of(type(g)(g.factor, variables, g.A, g.r, g.weight), f.at, system.dim)
            for A, r, at in zip(g.A, g.r, index, strict=True):
                right = np.zeros((f.columns, len(r)))
                right[at] = A.T
                C = np.eye(len(r)) + A @ solved(f, right)[at]
                e = r + A @ x[at]
                inside.append(float(chi2.cdf(e @ np.linalg.solve(C, e), len(r))))
    return np.array([np.mean(np.array(inside) <= level) if inside else np.nan for level in LEVELS]), len(inside)
