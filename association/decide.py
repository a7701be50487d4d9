"""Decisions of a frame: by an association method and a gate for new landmarks, or by granted labels."""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from association import methods
from association.expectation import Expectation, gate_threshold
from association.jcbb import BUDGET, search
from association.methods import ALPHA, RATIO, ml_ratio, newness
from association.names import METHODS
from data.errors import UsageError, unknown
from data.inputs import Inputs, IntArray, LabelledObservations
from data.result import DISCARD, NEW

Method = Callable[[Expectation, float | None], IntArray]
"""An association method: pairs compatible observations at a gate probability (or None), and leaves the rest at `NEW`.
"""
SEARCHES = {"jcbb": False, "jcbb-first": True}  # node budget; whether the first hypothesis wins
PLAIN: dict[str, Method] = {n: getattr(methods, n.replace("-", "_")) for n in METHODS if n not in SEARCHES}
"""Methods without a search budget."""
OWN_NEWNESS = "ml-ratio"  # the method that decides itself which observations are new


class Decided(NamedTuple):
    """Decisions (m,): landmark number, `NEW` or `DISCARD`; complete: False if a search exhausted its budget."""

    decisions: IntArray
    complete: bool


def horizon(
    method: str, gate: float | None, new_gate: float | None, *, known_map: bool = False, looks: tuple[int, int] = (0, 0)
) -> float:
    """Squared distance from every observation beyond which no candidate influences the decisions; infinite without a
    gate. The ratio test needs the second best candidate, which may be anywhere inside the gate or compete with "new".
    `looks`: as of `Inputs.looks`; terms of appearance only add to a distance.
    """
    if gate is None:
        return math.inf
    dof, classes = 2 + looks[0], max(looks[1], 1)

    def reach(p: float | None) -> float:
        # the tail of a distance with misread classes is at most as many times that of the plain one
        return gate_threshold(p if p is None or classes == 1 else 1.0 - (1.0 - p) / classes, dof)

    return max(RATIO * max(ALPHA, reach(gate)), 0.0 if known_map or method == OWN_NEWNESS else reach(new_gate))


def decide(
    method: str | Method, expectation: Expectation, gate: float | None, new_gate: float | None, *,
    known_map: bool = False, budget: int = BUDGET,
) -> Decided:  # fmt: skip
    """Decide about the observations of a frame: pair them by `method`, then choose which start a landmark.

    Args:
        method: one of `METHODS`, or a function of (expectation, gate) to decisions (m,).
        expectation: n candidates and m observations.
        gate: chi-square probability of the tests; None: no gate.
        new_gate: an observation outside this gate of every candidate is new; None: only without candidates (`ml-ratio`
            has its own test).
        known_map: nothing is new, and unpaired observations are discarded.
        budget: most nodes of a search (`jcbb`).

    Returns:
        Decisions (m,): landmark number, `NEW` or `DISCARD`; `complete` is False for an exhausted search.

    Raises:
        UsageError: unknown method.
        ValueError: a gate that is no probability.
        SingularInnovationError: an innovation covariance is not positive definite.

    Example:
        >>> e = slamref.Expectation.from_arrays([[1.0, 0.1]], [[1.0, 0.0]], 0.1 * np.eye(2), 0.1 * np.eye(2)[None])
        >>> slamref.decide("jcbb", e, 0.99, 0.99999).decisions  # array([0])
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
    else:
        raise UsageError(f"association method {method!r}: {unknown(method, METHODS)}")
    if known_map:
        decisions = np.where(decisions == NEW, DISCARD, decisions)
    elif method != OWN_NEWNESS:
        decisions = newness(expectation, decisions, new_gate)
    return Decided(decisions, complete)


def known_decisions(inputs: Inputs) -> tuple[IntArray, IntArray]:
    """Pairing by label: decisions (M,) and the number (M,) of the landmark each observation initializes (-1: none).

    Localization: the label, if the map has it. SLAM: the first observation of a label is `NEW`, later ones its number,
    and repetitions within the first frame are discarded. Clutter and blank labels are discarded.
    """
    o = inputs.observations
    if not isinstance(o, LabelledObservations):
        raise ValueError("known association needs inputs with labels; use log.inputs(labels=True)")
    label, created = o.label, np.full(len(o.label), -1, np.int64)
    decisions = np.full(len(label), DISCARD, np.int64)
    if inputs.map is not None:
        paired = np.isin(label, inputs.map.id)
        decisions[paired] = label[paired]
        return decisions, created
    named = np.flatnonzero(label >= 0)
    _, first, which = np.unique(label[named], return_index=True, return_inverse=True)
    number = np.empty(len(first), np.int64)
    number[np.argsort(first)] = np.arange(len(first))
    decisions[named] = number[which]
    initializing = named[first]
    decisions[named[o.frame[named] == o.frame[initializing][which]]] = DISCARD
    decisions[initializing] = NEW
    created[initializing] = number
    return decisions, created


def pair_by_label(label: IntArray, held: Mapping[int, int]) -> IntArray:
    """SLAM decisions (m,) of one frame by labels (m,), for a map that may have lost landmarks. `held` is the landmark
    number of each label in the map. Without removals the decisions are those of `known_decisions`.
    """
    decisions = np.full(len(label), DISCARD, np.int64)
    initialized: set[int] = set()
    for i, name in enumerate(label.tolist()):
        if name in held:
            decisions[i] = held[name]
        elif name >= 0 and name not in initialized:
            initialized.add(name)
            decisions[i] = NEW
    return decisions
