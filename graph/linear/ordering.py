"""The order of elimination: along the path where that is all there is, COLAMD otherwise."""

from __future__ import annotations

import gtsam
import numpy as np

from data.inputs import IntArray


def ordering(variable: IntArray, poses: int, size: int) -> IntArray:
    """Order (V,) for blocks of the variables (B, 2), -1 for none; the first are poses, the others landmarks.

    Poses alone are a chain, eliminated backwards. With landmarks gtsam's COLAMD finds an order of little fill.
    """
    if poses == size:
        return np.arange(size)[::-1]
    pattern = gtsam.SymbolicFactorGraph()
    for a, b in np.unique(np.sort(variable, axis=1), axis=0).tolist():
        if a < 0:
            pattern.push_factor(b)
        else:
            pattern.push_factor(a, b)
    found = gtsam.Ordering.ColamdSymbolicFactorGraph(pattern)
    return np.array([found.at(i) for i in range(found.size())], np.int64)
