"""JCBB written plainly in Python: the recorded lab program's rule to the letter, and faults seen in public."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from tests.association.problems import joint_distances

FAULTS = ("no joint test", "joint test at 2 dof", "ties cut", "cdf for its inverse")


def threshold(gate, dof, fault=None):
    return chi2.cdf(gate, dof) if fault == "cdf for its inverse" else chi2.ppf(gate, dof)


def lab_rule(e, gate):
    """Order of operations of the recorded program: decisions (m,), -1 for unpaired."""
    m, n = len(e.z), len(e.number)
    compatible = e.individual_distances() < threshold(gate, 2)
    best = []

    def descend(i, pairs):
        nonlocal best
        if i == m:
            if len(pairs) > len(best):
                best = pairs
            return
        for j in range(n):
            if compatible[i, j]:
                more = [*pairs, (i, j)]
                if joint_distances(e, np.array([more]))[0] < threshold(gate, 2 * len(more)):
                    descend(i + 1, more)
        if len(pairs) + compatible[i + 1 :].any(axis=1).sum() >= len(best):
            descend(i + 1, pairs)

    descend(0, [])
    decisions = np.full(m, -1)
    for i, j in best:
        decisions[i] = e.number[j]
    return decisions


def least_distance(e, gate, fault=None):
    """Most pairings one-to-one, ties to the least joint distance; with one of `FAULTS` if asked."""
    m, n = len(e.z), len(e.number)
    compatible = e.individual_distances() < threshold(gate, 2, fault)
    best, best_d2 = [], np.inf

    def passes(pairs):
        if fault == "no joint test" or not pairs:
            return True
        dof = 2 if fault == "joint test at 2 dof" else 2 * len(pairs)
        return joint_distances(e, np.array([pairs]))[0] < threshold(gate, dof, fault)

    def descend(i, pairs):
        nonlocal best, best_d2
        if i == m:
            d2 = joint_distances(e, np.array([pairs]))[0] if pairs else 0.0
            if passes(pairs) and (len(pairs) > len(best) or (len(pairs) == len(best) and d2 < best_d2)):
                best, best_d2 = pairs, d2
            return
        for j in range(n):
            if compatible[i, j] and all(j != other for _, other in pairs):
                descend(i + 1, [*pairs, (i, j)])
        reach = len(pairs) + compatible[i + 1 :].any(axis=1).sum()
        if reach > len(best) if fault == "ties cut" else reach >= len(best):
            descend(i + 1, pairs)

    descend(0, [])
    decisions = np.full(m, -1)
    for i, j in best:
        decisions[i] = e.number[j]
    return decisions
