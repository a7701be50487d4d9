"""Ambiguous landmarks of a final map: those that may be the same as a neighbour.

Two landmarks are distinct where one frame observed both, or where their difference is significant given their
covariances and an observation's. Neighbours have correlated errors, so marginal covariances call rather too many
ambiguous.
"""

import numpy as np
import scipy

from association.expectation import gate_threshold
from data.inputs import Inputs, IntArray
from data.result import MapEstimate, Run
from data.se2 import Array
from eval.referee.consistency import squares as squared_errors
from eval.referee.errors import observed

GATE = 0.99  # chi-square probability of a significant difference
MOST = 32  # largest number of neighbours of a landmark that are tested
NONE = -1  # for a landmark that is not ambiguous


def ambiguous(run: Run, inputs: Inputs) -> IntArray:
    """Number (L,) of the nearest landmark that each one may be the same as, else `NONE`. All `NONE` for walls, and
    where the decisions are not about the observations of these inputs.
    """
    m, o = run.map, inputs.observations
    given = run.task == "localization"  # the landmarks are no mistakes of the run
    strange = given or inputs.several_or_partial or run.walls or len(run.final_decisions) != len(o.frame)
    if m is None or not len(m) or strange or not len(o.frame):
        return np.full(0 if m is None else len(m), NONE, np.int64)
    number = observed(run)
    seen = np.flatnonzero(number >= 0)
    _, covariance = inputs.sensor.body_points(o.z[seen], o.R[seen])
    variance = 0.5 * np.trace(covariance, axis1=1, axis2=2)
    return neighbours(m, variance_of(m, number[seen], variance), number[seen], o.frame[seen])


def variance_of(m: MapEstimate, number: IntArray, variance: Array) -> Array:
    """Mean variance [m^2] (L,) of each landmark's observations, of these numbers (M,) and variances (M,); else 0."""
    size = int(max(m.number.max(initial=-1), number.max(initial=-1))) + 1
    count = np.bincount(number, minlength=size)
    return np.asarray((np.bincount(number, weights=variance, minlength=size) / np.maximum(count, 1))[m.number])


def neighbours(m: MapEstimate, variance: Array, number: IntArray, frame: IntArray) -> IntArray:
    """Numbers as of `ambiguous`, given each landmark's `variance_of`, and number and frame of all observations (M,)."""
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
    # a pair is found from the landmark of larger covariance
    reach = np.sqrt(threshold * (2.0 * np.maximum(size, 0.0) + variance.max(initial=0.0)))
    if len(xy) < 2:
        return np.empty((0, 2), np.int64)
    distance, around = scipy.spatial.cKDTree(xy).query(xy, k=min(MOST + 1, len(xy)))
    first, which = np.nonzero(distance <= reach[:, None])
    second = np.asarray(around)[first, which]
    rows = known[np.unique(np.sort(np.stack([first, second], axis=1)[first != second], axis=1), axis=0)]
    i, j = rows.T
    S = m.covariance[i] + m.covariance[j] + np.maximum(variance[i], variance[j])[:, None, None] * np.eye(2)
    return np.asarray(rows[squared_errors(m.xy[i] - m.xy[j], S) < threshold])
