"""The order of elimination: along the path where that is all there is, COLAMD otherwise."""

from __future__ import annotations

import gtsam
import numpy as np

from data.inputs import IntArray

NO_DRIFT = np.empty(0, np.int64)


def ordering(variable: IntArray, poses: int, size: int, drift: IntArray = NO_DRIFT) -> IntArray:
    """Order (V,) for blocks of the variables (B, 2) or (B, 3), -1 for none: poses first, landmarks, drifts last.

    Poses alone are a chain, eliminated backwards, and each drift after the last pose that it leads to: `drift` (K,) is
    the first one. With landmarks gtsam's COLAMD finds an order of little fill.
    """
    if poses + len(drift) == size:
        along = np.concatenate([np.arange(poses), drift - 0.5])
        return np.argsort(along, kind="stable")[::-1].astype(np.int64)
    pattern = gtsam.SymbolicFactorGraph()
    for block in np.unique(np.sort(variable, axis=1), axis=0).tolist():
        pattern.push_factor(*(v for v in block if v >= 0))
    found = gtsam.Ordering.ColamdSymbolicFactorGraph(pattern)
    return np.array([found.at(i) for i in range(found.size())], np.int64)
