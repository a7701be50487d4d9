"""Known association: pairing by the labels that an experiment grants. Needs no expectation and no filter."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from data.inputs import Inputs, IntArray, LabelledObservations
from data.result import DISCARD, NEW


def known_decisions(inputs: Inputs) -> tuple[IntArray, IntArray]:
    """Pairing by label: decisions (M,) and the number (M,) of the landmark each observation initializes (-1: none).

    Localization: the label, if the map has it. SLAM: the first sighting of a label is `NEW`, later ones its number;
    a label seen twice in the frame that creates its landmark: the first creates, the others are discarded. Clutter and
    blank labels are discarded. Labels do not depend on the estimate, so this needs no filter.
    """
    o = inputs.observations
    if not isinstance(o, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")
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
    """SLAM decisions (m,) of one frame by labels (m,), for a map that may have lost landmarks.

    `held`: number of the landmark that is in the map for a label. Without removals this makes the decisions of
    `known_decisions`.
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
