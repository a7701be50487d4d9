"""Readings of a finished run laid onto its map: each where the others of its frame put it, and how exact that is.

A path online is as it was known then, and later loops moved the map. Where a frame's other readings stand tells where
it was taken in the map as it is now; what is then left of a reading is its own error. How large such errors are is
taken from the readings, not from what was stated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from association.evidence import constants
from data.inputs import Inputs, IntArray
from data.result import Run
from data.se2 import Array, BoolArray

ROUNDS = 2
"""Fits of a frame: the first by equal weights, the second without what does not fit the first."""
UNKNOWN_POSE = 1e-6
"""Information (1/m^2, 1/rad^2) about a pose of which a run states no covariance."""
MEDIAN_1, MEDIAN_2 = 0.4549, 1.3863
"""Medians of chi-square with one and two degrees of freedom."""
ENOUGH = 4
"""Readings of a landmark whose median tells of the noise."""
LEAST = 1e-4
"""Share of the stated variance that the noise has at least."""


class Registered(NamedTuple):
    """Every reading of a log on the map of a run.

    row: (M,) of the landmark it is taken for in the map, -1: of none; xy: (M, 2) m, where it was read, in the world, by
    the others of its frame; covariance: (M, 2, 2) of that, by the noise that there is; stated: the same as stated.
    """

    row: IntArray
    xy: Array
    covariance: Array
    stated: Array


def taken_for(run: Run) -> IntArray:
    """The landmark (M,) that each reading is taken for by the final decisions, the first one too; negative: none."""
    created = run.initialized
    number: IntArray = np.where(created >= 0, created, run.final_decisions)
    return number


def registered(run: Run, inputs: Inputs) -> Registered | None:
    """The readings of these inputs on the map of a run; None without a map, and where they are not the run's."""
    m, o = run.map, inputs.observations
    if m is None or not len(m) or run.walls or len(run.final_decisions) != len(o.frame) or not run.phases:
        return None
    number, path = taken_for(run), run.trajectory(run.phases[-1])
    rows = np.full(int(max(number.max(initial=0), m.number.max())) + 1, -1, np.int64)
    rows[m.number] = np.where(_finite(m.xy), np.arange(len(m)), -1)
    known = _finite(path.pose)
    row = np.where((number >= 0) & known[o.frame], rows[np.maximum(number, 0)], -1)
    pose = np.where(known[:, None], path.pose, 0.0)[o.frame]
    xy, Gx, Gz = inputs.sensor.inverse(pose, o.z)
    R = Gz @ o.R @ np.swapaxes(Gz, 1, 2) + constants.EXACT_VARIANCE * np.eye(2)
    off = np.where(row[:, None] >= 0, xy - m.xy[np.maximum(row, 0)], 0.0)
    shift, S = _by_others(off, R, Gx, row >= 0, o.frame, _information(path.covariance))
    S = 0.5 * (S + np.swapaxes(S, 1, 2))
    xy = np.where(known[o.frame][:, None], xy + shift, np.nan)
    return Registered(row, xy, _as_it_is(off + shift, S, xy - pose[:, :2], row), S)


def _information(covariance: Array) -> Array:
    """About each pose (N, 3, 3)."""
    known = _finite(covariance.reshape(-1, 9))[:, None, None]
    P = np.where(known, covariance, np.eye(3)) + constants.EXACT_VARIANCE * np.eye(3)
    return np.where(known, inverses(P), UNKNOWN_POSE * np.eye(3))


def _finite(rows: Array) -> BoolArray:
    """Which rows (n,) of a table (n, k) are."""
    return np.asarray(np.isfinite(rows).all(axis=1), np.bool_)


def _by_others(
    off: Array, R: Array, Gx: Array, paired: BoolArray, frame: IntArray, information: Array
) -> tuple[Array, Array]:
    """How the other pairings of its frame shift each reading (M, 2), and the covariance (M, 2, 2) of what is left.

    Least squares in the pose of a frame, without the reading itself; Student's weights for the pairings.
    """
    weight, W = paired.astype(np.float64), np.linalg.inv(R)
    shift, S = np.zeros_like(off), R
    for _ in range(ROUNDS):
        GW = np.swapaxes(Gx, 1, 2) @ (W * weight[:, None, None])
        own, pull = GW @ Gx, np.einsum("mij,mj->mi", GW, off)
        A, b = information.copy(), np.zeros((len(information), 3))
        np.add.at(A, frame, own)
        np.add.at(b, frame, pull)
        P = np.linalg.inv(A[frame] - own)
        shift = -np.einsum("mij,mjk,mk->mi", Gx, P, b[frame] - pull)
        S = R + Gx @ P @ np.swapaxes(Gx, 1, 2)
        if paired.any():
            d2 = squares(off + shift, inverses(S))
            scale = max(float(np.median(d2[paired])) / MEDIAN_2, LEAST)
            weight = paired * (constants.FREEDOM + 2.0) / (constants.FREEDOM + d2 / scale)
    return shift, S


def _as_it_is(off: Array, S: Array, sight: Array, row: IntArray) -> Array:
    """Covariances (M, 2, 2) with the variance that there is along the line of sight (M, 2) and across it.

    The median over landmarks of the median over each one's readings: neither a reading nor a landmark that is none
    makes a difference.
    """
    along = sight / np.maximum(np.hypot(sight[:, 0], sight[:, 1]), LEAST)[:, None]
    axes = np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)
    turned = axes @ S @ np.swapaxes(axes, 1, 2)
    p = np.flatnonzero(row >= 0)
    count = np.bincount(row[p], minlength=1)
    often = np.flatnonzero(count >= ENOUGH)
    scale = np.ones(2)
    for c in range(2 if len(often) else 0):
        ratio = np.einsum("mj,mj->m", axes[p, c], off[p]) ** 2 / turned[p, c, c]
        order = np.lexsort((ratio, row[p]))
        middle = (np.cumsum(count) - count)[often] + (count[often] - 1) // 2
        scale[c] = max(float(np.median(ratio[order][middle])) / MEDIAN_1, LEAST)
    D = np.sqrt(scale)
    found: Array = np.swapaxes(axes, 1, 2) @ (turned * D[:, None] * D[None, :]) @ axes
    return found


def inverses(S: Array) -> Array:
    """Inverses (m, k, k) of covariances (m, k, k)."""
    return np.asarray(np.linalg.inv(S), np.float64)


def squares(off: Array, information: Array) -> Array:
    """Squared distances (m,) of offsets (m, 2) by their information (m, 2, 2), which is symmetric."""
    x, y = off.T
    square: Array = information[:, 0, 0] * x * x + 2.0 * information[:, 0, 1] * x * y + information[:, 1, 1] * y * y
    return square
