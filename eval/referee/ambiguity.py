"""Which landmarks of a finished map are ambiguous: those not to be told from a neighbour, and those that may be two.

A landmark that its own readings call two is ambiguous with itself (`association.evidence.doubles`). Two landmarks are
told apart where one frame saw both, or where their difference is significant given the covariances of both and of a
reading. Only marginal covariances are at hand; of neighbours, whose errors are alike, they overstate that of the
difference, so that where a map is badly known rather too many are called ambiguous.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from association.evidence.doubles import doubles
from association.evidence.registered import taken_for
from association.expectation import gate_threshold
from data.inputs import Inputs, IntArray
from data.result import MapEstimate, Run
from data.se2 import Array

GATE = 0.99
"""Chi-square probability inside which a difference is not significant."""
MOST = 32
"""Neighbours of a landmark that are looked at, the nearest ones: of a map that is lost all would be."""
NONE = -1
"""For a landmark that can be told from all others."""


def ambiguous(run: Run, inputs: Inputs) -> IntArray:
    """For each landmark (L,) of a run's map the number of the nearest that it cannot be told from, its own if it may be
    two (and can be told from all others), or `NONE`.

    All `NONE` for walls, and where the decisions are not about the observations of these inputs.
    """
    m, o = run.map, inputs.observations
    if m is None or not len(m) or run.walls or len(run.final_decisions) != len(o.frame) or not len(o.frame):
        return np.full(0 if m is None else len(m), NONE, np.int64)
    number = taken_for(run)
    seen = np.flatnonzero(number >= 0)
    _, covariance = inputs.sensor.body_points(o.z[seen], o.R[seen])
    variance = 0.5 * np.trace(covariance, axis1=1, axis2=2)
    found = neighbours(m, variance_of(m, number[seen], variance), number[seen], o.frame[seen])
    return np.where((found == NONE) & doubles(run, inputs), m.number, found)


def variance_of(m: MapEstimate, number: IntArray, variance: Array) -> Array:
    """Mean variance [m^2] of the readings of each landmark (L,), of readings (M,) of these numbers; 0 without any."""
    size = int(max(m.number.max(initial=-1), number.max(initial=-1))) + 1
    count = np.bincount(number, minlength=size)
    total = np.bincount(number, weights=variance, minlength=size)
    mean: Array = (total / np.maximum(count, 1))[m.number]
    return mean


def neighbours(m: MapEstimate, variance: Array, number: IntArray, frame: IntArray) -> IntArray:
    """The same from the variance of a reading of each landmark (L,) [m^2], number and frame of all readings (M,)."""
    found = np.full(len(m), NONE, np.int64)
    pairs = _near(m, variance)
    if not len(pairs):
        return found
    order = np.lexsort((frame, number))
    number, frame = number[order], frame[order]
    begin, end = np.searchsorted(number, m.number, "left"), np.searchsorted(number, m.number, "right")
    distance = np.linalg.norm(m.xy[pairs[:, 0]] - m.xy[pairs[:, 1]], axis=1)
    for i, j in pairs[np.argsort(-distance, kind="stable")].tolist():  # the nearest last, which stays
        if not np.isin(frame[begin[i] : end[i]], frame[begin[j] : end[j]]).any():
            found[i], found[j] = m.number[j], m.number[i]
    return found


def _near(m: MapEstimate, variance: Array) -> IntArray:
    """Rows (K, 2) of the landmarks whose difference is not significant, each pair once."""
    threshold = gate_threshold(GATE)
    size = np.linalg.eigvalsh(m.covariance)[:, -1]
    known = np.flatnonzero(np.isfinite(m.xy).all(axis=1) & np.isfinite(size))
    xy, size = m.xy[known], size[known]
    # a pair is found from the landmark that is known worse, whose circle holds all that can be near it
    reach = np.sqrt(threshold * (2.0 * np.maximum(size, 0.0) + variance.max(initial=0.0)))
    if len(xy) < 2:
        return np.empty((0, 2), np.int64)
    distance, around = cKDTree(xy).query(xy, k=min(MOST + 1, len(xy)))
    first, which = np.nonzero(distance <= reach[:, None])
    second = np.asarray(around)[first, which]
    pairs = np.unique(np.sort(np.stack([first, second], axis=1)[first != second], axis=1), axis=0)
    rows = known[pairs]
    i, j = rows.T
    S = m.covariance[i] + m.covariance[j] + np.maximum(variance[i], variance[j])[:, None, None] * np.eye(2)
    d = m.xy[i] - m.xy[j]
    square = np.einsum("ka,ka->k", d, np.linalg.solve(S, d[:, :, None])[:, :, 0])
    near: IntArray = rows[square < threshold]
    return near
