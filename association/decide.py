"""Decide: a method by its name, then newness; what a replay calls in every frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from association.evidence.pairings import jcbb_hindsight
from association.expectation import Expectation, gate_threshold
from association.gnn import gnn
from association.jcbb import BUDGET, search
from association.likelihood import ALPHA, RATIO, ml, ml_ratio
from association.nearest import nn
from association.newness import newness
from association.singles import singles
from data.errors import UsageError
from data.inputs import IntArray
from data.result import DISCARD, NEW

Method = Callable[[Expectation, float | None], IntArray]
"""A way of association: pairs what is compatible at a gate (a probability, or None), and leaves the rest at `NEW`."""
PLAIN: dict[str, Method] = {
    "nn": nn,
    "ml": ml,
    "ml-ratio": ml_ratio,
    "singles": singles,
    "gnn": gnn,
}
"""Methods that always come to an end."""
SEARCHES = {"jcbb": False, "jcbb-first": True}
"""Methods with a node budget, and whether the first of the largest hypotheses stays."""
METHODS = (*PLAIN, *SEARCHES)
"""Names of all methods that decide for themselves (`known` does not: see `association.known`)."""
HINDSIGHT = "jcbb-hindsight"
"""The method whose decisions may be revised; what it decides in a frame needs no later one."""
OWN_NEWNESS = frozenset({"ml-ratio", HINDSIGHT})
"""Methods that say themselves what is new."""


class Decided(NamedTuple):
    """Decisions (m,): landmark number, `NEW` or `DISCARD`; complete: False if a search ran out of its budget."""

    decisions: IntArray
    complete: bool


def horizon(method: str, gate: float | None, new_gate: float | None, *, known_map: bool = False) -> float:
    """Squared distance from every reading beyond which no candidate has any influence on the decisions; may be inf.

    Without a gate every candidate has some. The ratio test asks how far the second best is, of what may be anywhere
    inside the gate or compete with "new".
    """
    if method == HINDSIGHT or gate is None:
        return math.inf
    outer = 0.0 if known_map or method in OWN_NEWNESS else gate_threshold(new_gate)
    return max(RATIO * max(ALPHA, gate_threshold(gate)), outer)


def decide(
    method: str | Method,
    expectation: Expectation,
    gate: float | None,
    new_gate: float | None,
    *,
    known_map: bool = False,
    budget: int = BUDGET,
) -> Decided:
    """Decisions of a frame: pair by `method`, then say which of the unpaired found a landmark.

    Args:
        method: one of `METHODS`, `HINDSIGHT`, or any function that pairs as those of `PLAIN` do.
        expectation: candidates and observations.
        gate: chi-square probability of the method's tests, None for no gate.
        new_gate: chi-square probability outside which an observation is new; None: only where there is no candidate.
            `ml-ratio` and `jcbb-hindsight` decide that themselves.
        known_map: the map is given, so nothing is new and the unpaired are discarded.
        budget: nodes a search may visit in this frame.

    Raises:
        UsageError: no such method.
        ValueError: a gate is no probability.
        SingularInnovationError: an innovation covariance is not positive definite.
    """
    complete = True
    if method == "ml-ratio" and known_map:
        decisions = ml_ratio(expectation, gate, alpha=math.inf)
    elif not isinstance(method, str):
        decisions = method(expectation, gate)
    elif method in PLAIN:
        decisions = PLAIN[method](expectation, gate)
    elif method in SEARCHES:
        found = search(expectation, gate, first=SEARCHES[method], budget=budget)
        decisions, complete = found.decisions, found.complete
    elif method == HINDSIGHT:
        decisions, complete = jcbb_hindsight(expectation, gate, new_gate, budget=budget)
    else:
        raise UsageError(f"no association method {method!r}; there are {', '.join((*METHODS, HINDSIGHT))}")
    if known_map:
        decisions = np.where(decisions == NEW, DISCARD, decisions)
    elif method not in OWN_NEWNESS:
        decisions = newness(expectation, decisions, new_gate)
    return Decided(decisions, complete)
