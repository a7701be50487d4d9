"""SINGLES: only observations and landmarks that have nobody else to go with are paired."""

from __future__ import annotations

import numpy as np

from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.result import NEW


def singles(expectation: Expectation, gate: float | None) -> IntArray:
    """Pairs without any ambiguity (SINGLES of the data-association lab after Neira and Tardos 2001).

    Observation i and landmark j are paired if j is the only landmark compatible with i and i the only observation
    compatible with j; compatible: d^2 < chi-square at `gate`, 2 dof.

    Args:
        expectation: candidates (n) and observations (m).
        gate: chi-square probability, or None for no gate (then everything is compatible with everything).

    Returns:
        (m,) landmark number, or `NEW` (-1) for unpaired.
    """
    compatible = expectation.individual_distances() < gate_threshold(gate)
    alone = compatible.sum(axis=1) == 1
    pair = compatible & alone[:, None] & (compatible.sum(axis=0) == 1)[None, :]
    decisions = np.full(len(pair), NEW, np.int64)
    observation, candidate = np.nonzero(pair)
    decisions[observation] = expectation.number[candidate]
    return decisions
