"""Frames without a scan, in the end: the odometry between two scans, made to lead from the one to the other."""

from __future__ import annotations

import numpy as np

from data.inputs import Inputs
from data.se2 import Array, between, compose, dead_reckoned


def between_scans(inputs: Inputs, pose: Array) -> Array:
    """The path (N, 3) with each frame between two scans moved by its share of what the odometry between them is off.

    The share is that of the variance of the odometry that was gathered since the scan before. Frames with a scan, and
    those before the first and after the last, stay.
    """
    assert inputs.scans is not None
    count = len(inputs)
    scanned = np.zeros(count, np.bool_)
    scanned[inputs.scans.frame] = True
    frames = np.arange(count)
    before = np.maximum.accumulate(np.where(scanned, frames, -1))
    after = np.minimum.accumulate(np.where(scanned, frames, count)[::-1])[::-1]
    row = np.flatnonzero(~scanned & (before >= 0) & (after < count))
    a, b = before[row], after[row]
    odometry = dead_reckoned(np.zeros(3), inputs.increments.mean)
    gathered = np.cumsum(np.trace(inputs.increments.covariance, axis1=1, axis2=2))
    way = gathered[b] - gathered[a]
    share = np.divide(gathered[row] - gathered[a], way, out=np.zeros(len(row)), where=way > 0.0)
    off = between(between(odometry[a], odometry[b]), between(pose[a], pose[b]))
    result = pose.copy()
    result[row] = compose(compose(pose[a], between(odometry[a], odometry[row])), share[:, None] * off)
    return result
