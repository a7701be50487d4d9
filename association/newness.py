"""Newness: may an observation that a method left unpaired found a landmark, or is it too close to one for that?"""

from __future__ import annotations

import numpy as np

from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.result import DISCARD, NEW


def newness(expectation: Expectation, decisions: IntArray, new_gate: float | None) -> IntArray:
    """Turn `NEW` into `DISCARD` where some landmark is inside the second gate: the two-gate rule.

    An inner gate to associate and an outer one to augment, as in Bailey's EKF-SLAM simulator. An observation
    initializes a landmark only if every candidate is outside the gate: d^2 >= chi-square at `new_gate`, 2 dof. With
    `new_gate` equal to the method's gate this is the lab's rule, under which one true pair in a hundred falls out of
    its own landmark's gate and initializes a duplicate; a wider gate discards it instead.

    Args:
        expectation: candidates (n) and observations (m).
        decisions: (m,) as a method made them.
        new_gate: chi-square probability; None: no candidate is ever outside, so only an empty map gets new landmarks.

    Returns:
        (m,) landmark number, `NEW` or `DISCARD`.
    """
    inside = (expectation.individual_distances() < gate_threshold(new_gate)).any(axis=1)
    return np.where((decisions == NEW) & inside, DISCARD, decisions)
