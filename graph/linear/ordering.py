"""The order of elimination: along the path where that is all there is, COLAMD otherwise."""

from __future__ import annotations

import gtsam
import numpy as np

from data.inputs import IntArray


def ordering(variable: IntArray, poses: int, size: int) -> IntArray:
    """Order (V,) for blocks of the variables (B, 2) or (B, 3), -1 for none; the first are poses, the others landmarks.

    Poses alone are a chain, eliminated backwards. With landmarks gtsam's COLAMD finds an order of little fill.
    """
    if poses == size:
        return np.arange(size)[::-1]
    pattern = gtsam.SymbolicFactorGraph()
    for block in np.unique(np.sort(variable, axis=1), axis=0).tolist():
        pattern.push_factor(*(v for v in block if v >= 0))
    found = gtsam.Ordering.ColamdSymbolicFactorGraph(pattern)
    return np.array([found.at(i) for i in range(found.size())], np.int64)


def chain(poses: int, first: IntArray) -> IntArray:
    """Order of poses and drifts alone, drift j (K,) from the increment into frame `first[j]` on: backwards, too.

    A drift is eliminated after the last pose that it leads to.
    """
    return np.argsort(np.concatenate([np.arange(poses), first - 0.5]), kind="stable")[::-1].astype(np.int64)
