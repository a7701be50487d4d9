"""Joint compatibility branch and bound: the largest set of jointly compatible pairings.

Two compiled searches: most pairings with least joint distance (`search_best`), and first found (`search_first`). Both
take m observations and k candidates, each individually compatible with something: nu (m, k, 2) innovations, compatible
(m, k), C (2k, 2k) joint covariance of the expectations, R (m, 2, 2), unlike (m, k) terms of appearance, thresholds
(m + 1,) squared joint distance at 2 q dof for q pairings (3 q with descriptors), infinite for q = 0 and without a gate.
The joint distance grows with two rows of the factor per pairing: S = L L', w = L^-1 nu, d^2 = w'w, and by its term.
"""

import math
import warnings
from typing import NamedTuple

import numpy as np

from association.expectation import SINGULAR, Expectation, SingularInnovationError
from data.compiled import njit
from data.inputs import IntArray
from data.result import NEW
from data.se2 import Array, BoolArray

UNPAIRED = -1
COMPLETE = 0
EXHAUSTED = 1
SINGULAR_JOINT = 2
TIE = 1e-12  # joint distances within this relative difference are equal, so that rounding cannot choose between them


@njit
def _factor(a: float, b: float, c: float, scale_a: float, scale_c: float) -> tuple[float, float, float]:
    """Cholesky factor (l00, l10, l11) of [[a, b], [b, c]]; l00 = 0 where it is singular relative to its scale."""
    if not a > SINGULAR * scale_a:
        return 0.0, 0.0, 0.0
    l00 = math.sqrt(a)
    l10 = b / l00
    rest = c - l10 * l10
    if not rest > SINGULAR * scale_c:
        return 0.0, 0.0, 0.0
    return l00, l10, math.sqrt(rest)


class Given(NamedTuple):
    """The candidates conditioned on the first q pairings, by q."""

    V: Array  # (m, k, 2, 2) rows of L^-1 C
    shift: Array  # (m + 1, k, 2) of the expectation
    D: Array  # (m + 1, k, 3) remaining covariance (xx, xy, yy)


@njit
def _unconditioned(m: int, C: Array) -> Given:
    """The candidates before any of m observations is paired."""
    k = len(C) // 2
    given = Given(np.empty((m, k, 2, 2)), np.zeros((m + 1, k, 2)), np.empty((m + 1, k, 3)))
    for j in range(k):
        given.D[0, j, 0], given.D[0, j, 1] = C[2 * j, 2 * j], C[2 * j + 1, 2 * j]
        given.D[0, j, 2] = C[2 * j + 1, 2 * j + 1]
    return given


@njit
def _whitened(i: int, j: int, q: int, nu: Array, R: Array, given: Given) -> tuple[float, float, float, float, float]:
    """Innovation (x, y) of observation i and candidate j given q pairings, whitened by its factor (l00, l10, l11)."""
    D, shift = given.D, given.shift
    l00, l10, l11 = _factor(
        D[q, j, 0] + R[i, 0, 0], D[q, j, 1] + R[i, 1, 0], D[q, j, 2] + R[i, 1, 1], D[0, j, 0] + R[i, 0, 0],
        D[0, j, 2] + R[i, 1, 1],
    )  # fmt: skip
    if l00 == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    x = (nu[i, j, 0] - shift[q, j, 0]) / l00
    y = (nu[i, j, 1] - shift[q, j, 1] - l10 * x) / l11
    return x, y, l00, l10, l11


@njit
def _condition(
    i: int, j: int, q: int, nu: Array, C: Array, R: Array, given: Given, need: BoolArray
) -> tuple[float, float]:
    """Pair i with j as pairing q and condition the candidates in `need`; returns the whitened innovation (x, y)."""
    V, shift, D = given
    x, y, l00, l10, l11 = _whitened(i, j, q, nu, R, given)
    for c in range(len(need)):
        if not need[c]:
            continue
        v00, v01 = C[2 * j, 2 * c], C[2 * j, 2 * c + 1]
        v10, v11 = C[2 * j + 1, 2 * c], C[2 * j + 1, 2 * c + 1]
        for r in range(q):
            a00, a01, a10, a11 = V[r, j, 0, 0], V[r, j, 0, 1], V[r, j, 1, 0], V[r, j, 1, 1]
            b00, b01, b10, b11 = V[r, c, 0, 0], V[r, c, 0, 1], V[r, c, 1, 0], V[r, c, 1, 1]
            v00 -= a00 * b00 + a10 * b10
            v01 -= a00 * b01 + a10 * b11
            v10 -= a01 * b00 + a11 * b10
            v11 -= a01 * b01 + a11 * b11
        v00, v01 = v00 / l00, v01 / l00
        v10, v11 = (v10 - l10 * v00) / l11, (v11 - l10 * v01) / l11
        V[q, c, 0, 0], V[q, c, 0, 1], V[q, c, 1, 0], V[q, c, 1, 1] = v00, v01, v10, v11
        shift[q + 1, c, 0] = shift[q, c, 0] + v00 * x + v10 * y
        shift[q + 1, c, 1] = shift[q, c, 1] + v01 * x + v11 * y
        D[q + 1, c, 0] = D[q, c, 0] - v00 * v00 - v10 * v10
        D[q + 1, c, 1] = D[q, c, 1] - v00 * v01 - v10 * v11
        D[q + 1, c, 2] = D[q, c, 2] - v01 * v01 - v11 * v11
    return x, y


@njit
def search_best(
    nu: Array, compatible: BoolArray, C: Array, R: Array, unlike: Array, thresholds: Array, budget: int
) -> tuple[IntArray, float, int, int, int]:
    """Most pairings, one-to-one, jointly compatible as a whole; among these the least joint distance.

    Branch and bound with forward checking: at every node each open pairing has its distance given those made, a lower
    bound of its increment. The observation with the fewest open pairings comes next, its nearest candidate first.

    A branch is cut only if it cannot have more pairings than the best so far, nor as many at a smaller distance. The
    gate applies to the whole hypothesis: a part may exceed chi-square at its own dof and the whole still pass.

    Returns (choice (m,), d^2, pairings, nodes, status).
    """
    m, k = compatible.shape
    observation, candidate = np.nonzero(compatible)  # of each pair, those of i from first[i] to first[i + 1]
    first, pairs = np.searchsorted(observation, np.arange(m + 1)), len(candidate)
    given = _unconditioned(m, C)
    made, d2 = np.zeros(m + 1, np.int64), np.zeros(m + 1)  # by depth: pairings and joint distance
    chosen, branch, branches = np.empty(m + 1, np.int64), np.zeros(m + 1, np.int64), np.zeros(m + 1, np.int64)
    order = np.empty((m + 1, k), np.int64)
    closed_at = np.full(pairs, m + 2)  # depth at which a pairing was closed
    gain, need = np.empty(pairs), np.empty(k, np.bool_)
    decided, taken = np.zeros(m, np.bool_), np.zeros(k, np.bool_)
    choice, best_choice = np.full(m, UNPAIRED), np.full(m, UNPAIRED)
    best, best_d2 = 0, 0.0
    t, nodes, arriving = 0, 0, True
    while t >= 0:
        q = made[t]
        if arriving:
            nodes += 1
            if nodes > budget:
                return best_choice, best_d2, best, nodes - 1, EXHAUSTED
            reach = q
            for i in range(m):
                if not decided[i]:
                    for p in range(first[i], first[i + 1]):
                        if closed_at[p] > t and not taken[candidate[p]]:
                            reach += 1
                            break
            # distances given the pairings made; close pairings that cannot improve the best hypothesis
            slack = best_d2 - TIE * max(1.0, best_d2) if reach == best else np.inf
            limit = min(thresholds[reach], slack)
            after, bound, fewest, pick = q, 0.0, k + 1, -1
            for i in range(m):
                if decided[i]:
                    continue
                open_pairs, least = 0, np.inf
                for p in range(first[i], first[i + 1]):
                    j = candidate[p]
                    if closed_at[p] <= t or taken[j]:
                        continue
                    x, y, l00, _, _ = _whitened(i, j, q, nu, R, given)
                    if l00 == 0.0:
                        return best_choice, best_d2, best, nodes, SINGULAR_JOINT
                    gain[p] = x * x + y * y + unlike[i, j]
                    if d2[t] + gain[p] >= limit:
                        closed_at[p] = t
                        continue
                    open_pairs += 1
                    least = min(least, gain[p])
                if open_pairs > 0:
                    after += 1
                    bound = max(bound, least)
                    if open_pairs < fewest:
                        fewest, pick = open_pairs, i
            slack = best_d2 - TIE * max(1.0, best_d2)
            if pick < 0:
                if d2[t] < thresholds[q] and (q > best or (q == best and d2[t] < slack)):
                    best, best_d2 = q, d2[t]
                    best_choice[:] = choice
                hopeless = True
            else:
                hopeless = after < best or (after == best and d2[t] + bound >= slack) or d2[t] >= thresholds[after]
            if hopeless:
                t -= 1
                arriving = False
                continue
            n = 0  # its open candidates, nearest first; ties in the given order
            for p in range(first[pick], first[pick + 1]):
                if closed_at[p] > t and not taken[candidate[p]]:
                    at = n
                    while at > 0 and gain[order[t, at - 1]] > gain[p]:
                        order[t, at] = order[t, at - 1]
                        at -= 1
                    order[t, at] = p
                    n += 1
            chosen[t], branches[t], branch[t] = pick, n, 0
            decided[pick] = True
        i = chosen[t]
        if choice[i] != UNPAIRED:
            taken[choice[i]] = False
            choice[i] = UNPAIRED
        for p in range(pairs):
            if t < closed_at[p] <= m + 1:
                closed_at[p] = m + 2
        number = branch[t]
        branch[t] += 1
        if number > branches[t]:
            decided[i] = False
            t -= 1
            arriving = False
            continue
        arriving = True
        if number == branches[t]:  # last: leave it unpaired
            made[t + 1], d2[t + 1] = q, d2[t]
            t += 1
            continue
        j = candidate[order[t, number]]
        choice[i] = j
        taken[j] = True
        need[:] = False
        for o in range(m):
            if not decided[o]:
                for p in range(first[o], first[o + 1]):
                    if closed_at[p] > t:
                        need[candidate[p]] = True
        x, y = _condition(i, j, q, nu, C, R, given, need)
        made[t + 1], d2[t + 1] = q + 1, d2[t] + x * x + y * y + unlike[i, j]
        t += 1
    return best_choice, best_d2, best, nodes, COMPLETE


@njit
def search_first(
    nu: Array, compatible: BoolArray, C: Array, R: Array, unlike: Array, thresholds: Array, budget: int
) -> tuple[IntArray, float, int, int, int]:
    """Depth first over observations in order, candidates in order, last unpaired; the first of most pairings is kept.

    A pairing is kept if the joint distance of the pairings so far is below chi-square at their dof. One candidate may
    be given to two observations. A branch that can only equal the best is cut. Returns as `search_best`.
    """
    m, k = compatible.shape
    given, everything = _unconditioned(m, C), np.ones(k, np.bool_)
    made, d2, branch = np.zeros(m + 1, np.int64), np.zeros(m + 1), np.zeros(m + 1, np.int64)
    choice, best_choice = np.full(m, UNPAIRED), np.full(m, UNPAIRED)
    best, best_d2, t, nodes = 0, 0.0, made[0], 1  # a literal for t would compile what is called with it twice
    while t >= 0:
        q = made[t]
        if t == m:
            if q > best:
                best, best_d2 = q, d2[t]
                best_choice[:] = choice
            t -= 1
            continue
        if branch[t] == 0 and q + m - t <= best:
            t -= 1
            continue
        j = branch[t]
        while j < k and not compatible[t, j]:
            j += 1
        branch[t] = j + 1
        choice[t] = UNPAIRED
        if j > k or (j == k and q + m - t - 1 <= best):
            branch[t] = 0
            t -= 1
            continue
        made[t + 1], d2[t + 1] = q, d2[t]
        if j < k:
            x, y, l00, _, _ = _whitened(t, j, q, nu, R, given)
            if l00 == 0.0:
                return best_choice, best_d2, best, nodes, SINGULAR_JOINT
            distance = d2[t] + x * x + y * y + unlike[t, j]
            if not distance < thresholds[q + 1]:
                continue
            _condition(t, j, q, nu, C, R, given, everything)
            choice[t] = j
            made[t + 1], d2[t + 1] = q + 1, distance
        nodes += 1
        if nodes > budget:
            return best_choice, best_d2, best, nodes - 1, EXHAUSTED
        t += 1
        if t < m:
            branch[t] = 0
    return best_choice, best_d2, best, nodes, COMPLETE


BUDGET = 50_000  # nodes that a search may visit: some tenths of a second in a frame of twenty observations


class SearchBudgetWarning(UserWarning):
    """A search ended before it was complete; its decisions are the best found, perhaps not the best."""


class Search(NamedTuple):
    """The result of a search."""

    decisions: IntArray  # (m,) landmark number, or `NEW` (-1) for unpaired
    distance: float  # squared joint Mahalanobis distance of the pairings
    pairings: int  # number of pairings
    nodes: int  # number of nodes visited
    complete: bool  # False if the budget ended the search


def search(
    expectation: Expectation, gate: float | None, *, first: bool = False, budget: int = BUDGET, share: float = 1.0
) -> Search:
    """The search behind `jcbb` and `jcbb_first` with all its results, over the compatible candidates alone; covariances
    are `share` times the stated. Raises SingularInnovationError if one of a pair, or of the pairings, is not definite.
    """
    threshold = expectation.threshold(gate)
    if budget < 1:
        raise ValueError(f"budget {budget}: a search needs at least one node")
    e = expectation if first else expectation.by_age()
    compatible = e.scaled(e.individual_distances(), share) < threshold
    decisions = np.full(len(compatible), NEW, np.int64)
    rows, columns = np.flatnonzero(compatible.any(axis=1)), np.flatnonzero(compatible.any(axis=0))
    if len(rows) == 0:
        return Search(decisions, 0.0, 0, 0, True)
    thresholds = np.array([np.inf, *(e.threshold(gate, q + 1) for q in range(len(rows)))])
    kernel = search_first if first else search_best
    nu = np.array(e.residual(e.z[rows, None, :], e.z_hat[None, columns, :]), float, order="C")
    C, R = share * np.array(e.joint(columns), float, order="C"), share * np.array(e.R[rows], float, order="C")
    of = np.ix_(rows, columns)
    unlike = np.zeros((len(rows), len(columns))) if e.unlike is None else e.unlike.distance[of].copy()
    found = kernel(nu, np.ascontiguousarray(compatible[of]), C, R, unlike, thresholds, budget)
    choice, distance, pairings, nodes, status = found
    if status == SINGULAR_JOINT:
        pairs = f"observations {rows.tolist()} and landmarks {e.number[columns].tolist()}"
        why = "is singular; a positive definite one is needed"
        raise SingularInnovationError(f"the joint innovation covariance of {pairs} {why}")
    paired = choice >= 0
    decisions[rows[paired]] = e.number[columns[choice[paired]]]
    return Search(decisions, float(distance), int(pairings), int(nodes), status == COMPLETE)


def jcbb(expectation: Expectation, gate: float | None, *, budget: int = BUDGET) -> IntArray:
    """Joint compatibility branch and bound (Neira and Tardos 2001), ties by the least joint distance.

    Pairs must be individually compatible (d^2 < chi-square at `gate`, 2 dof), and the hypothesis jointly compatible
    (joint d^2 < chi-square at `gate`, 2 dof per pair, with the full cross-covariance). Of all one-to-one hypotheses the
    one with most pairings wins, then the one with least joint d^2. The order of observations and map does not matter;
    equal landmarks go oldest first. An exhausted `budget` of nodes gives the best hypothesis found and a
    `SearchBudgetWarning`.
    """
    return _warned(search(expectation, gate, budget=budget))


def jcbb_first(expectation: Expectation, gate: float | None, *, budget: int = BUDGET) -> IntArray:
    """Joint compatibility branch and bound as in the recorded lab program: ties to the first hypothesis found.

    Observations and candidates are searched in the given order, and only strictly more pairings replace a hypothesis.
    So the oldest landmarks win ties, whatever the distance. One landmark may be given to two observations (the joint
    test nearly always rejects it).
    """
    return _warned(search(expectation, gate, first=True, budget=budget))


def _warned(result: Search) -> IntArray:
    if not result.complete:
        warnings.warn(
            f"JCBB stopped after {result.nodes} nodes with {result.pairings} pairings; they may not be the most",
            SearchBudgetWarning, stacklevel=3,
        )  # fmt: skip
    return result.decisions
