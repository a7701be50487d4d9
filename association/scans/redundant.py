"""Key poses whose scans tell next to nothing that others do not: which ones, and the pose graph without them.

Kretzschmar and Stachniss, "Information-theoretic compression of pose graphs for laser-based SLAM", IJRR 31, 2012: the
scan with the least expected information about the map goes first. Here what scans tell about a cell is the number of
those that end in it, as with independent measurements of one variance; a scan that is one of n has 1/n of it. The graph
without a key pose is one of their trees (section 5): what led to it leads to the nearest one left, along the chain.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from association.scans.constraints import Chain, Loops
from association.scans.uncertainty import compose_covariances, inverse_covariance
from data.inputs import IntArray
from data.se2 import Array, BoolArray, compose, inverse, wrap_angle

CELL = 0.1
"""m, side of a cell: a few standard deviations of a key pose, so that scans of one wall end in the same cells."""
MOST_IN_A_ROW = 3
"""Key poses in a row that may go: frames hang on the last one left, and closures lead to the nearest."""


def redundant(ends: Sequence[Array], least: float) -> BoolArray:
    """Which of K key poses go: (K,), the one that tells least first, until each has a share of `least` in what is told
    about the cells that it sees.

    `ends`: end points (n, 2) of each key scan in the world [m]. The first and the last key pose stay.
    """
    cells = _cells(ends)
    hits = np.bincount(np.concatenate([*cells, np.zeros(0, np.int64)]))
    gone = np.zeros(len(ends), np.bool_)

    def share(k: int) -> float:
        # rounded: of equal ones the older key pose goes, whatever the order of a sum
        return round(float((1.0 / hits[cells[k]]).mean()), 12) if len(cells[k]) else 0.0

    waiting = [(share(k), k) for k in range(1, len(ends) - 1)]
    heapq.heapify(waiting)
    while waiting:
        told, k = heapq.heappop(waiting)
        if told >= least:
            break
        # others that went meanwhile can only have made it tell more
        now = share(k)
        if now > told:
            heapq.heappush(waiting, (now, k))
            continue
        if _row(gone, k) < MOST_IN_A_ROW:
            gone[k] = True
            hits[cells[k]] -= 1
    return gone


def _row(gone: BoolArray, k: int) -> int:
    """Key poses in a row around k that went already."""
    before, after = k, k
    while gone[before - 1]:
        before -= 1
    while gone[after + 1]:
        after += 1
    return after - before


def _cells(ends: Sequence[Array]) -> list[IntArray]:
    """The cells, numbered from 0, that each scan's end points lie in, each once."""
    at = [np.unique(np.floor(xy / CELL).astype(np.int64), axis=0) for xy in ends]
    _, number = np.unique(np.concatenate([*at, np.zeros((0, 2), np.int64)]), axis=0, return_inverse=True)
    return np.split(number.ravel(), np.cumsum([len(a) for a in at])[:-1])


class _Way(NamedTuple):
    """From key poses that are left to those that each key pose hangs on: numbers (K,) among those left, pose, error."""

    to: IntArray
    pose: Array
    covariance: Array


def without(chain: Chain, loops: Loops, gone: BoolArray) -> tuple[Chain, Loops]:
    """The constraints with key poses (K,) gone, the first one not among them.

    Steps of the chain are composed, frames hang on the last key pose left, loop closures lead to the one that is nearer
    along the chain, and those within one key pose go. Steps that a composed closure and the chain share are counted
    in both.
    """
    keys = np.arange(len(gone))
    number = np.cumsum(~gone) - 1  # of the last one left at or before each
    before = _along(chain, gone)
    kept = np.flatnonzero(~gone)
    nearest = _nearest(chain, gone, before)
    motion, covariance = np.zeros((len(kept), 3)), np.zeros((len(kept), 3, 3))
    for i, k in enumerate(kept[1:].tolist(), start=1):
        motion[i], covariance[i] = _step(
            before.pose[k - 1], before.covariance[k - 1], chain.motion[k], chain.covariance[k]
        )
    hung = keys[chain.key]
    since, since_covariance = chain.since.copy(), chain.since_covariance.copy()
    for f in np.flatnonzero(gone[hung]).tolist():
        k = hung[f]
        since[f], since_covariance[f] = _step(
            before.pose[k], before.covariance[k], chain.since[f], chain.since_covariance[f]
        )
    thinned = Chain(chain.frame[kept], motion, covariance, number[chain.key], since, since_covariance)
    return thinned, _moved(loops, gone, nearest, len(kept))


def _step(pose: Array, P: Array, motion: Array, C: Array) -> tuple[Array, Array]:
    found = compose(pose, motion)
    found[2] = wrap_angle(float(found[2]))
    return found, compose_covariances(pose, P, motion, C)


def _along(chain: Chain, gone: BoolArray) -> _Way:
    """Each key pose from the last one left at or before it."""
    count = len(gone)
    pose, covariance = np.zeros((count, 3)), np.zeros((count, 3, 3))
    for k in np.flatnonzero(gone).tolist():
        pose[k], covariance[k] = _step(pose[k - 1], covariance[k - 1], chain.motion[k], chain.covariance[k])
    return _Way(np.cumsum(~gone) - 1, pose, covariance)


def _nearest(chain: Chain, gone: BoolArray, before: _Way) -> _Way:
    """Each key pose from the one left that is surer along the chain, before it or after."""
    to, pose, covariance = before.to.copy(), before.pose.copy(), before.covariance.copy()
    onward, P = np.zeros(3), np.zeros((3, 3))  # from a key pose to the next one left
    for k in range(len(gone) - 1, 0, -1):
        if not gone[k]:
            onward, P = np.zeros(3), np.zeros((3, 3))
            continue
        if gone[k:].all():  # none is left after it
            continue
        onward, P = _step(chain.motion[k + 1], chain.covariance[k + 1], onward, P)
        if np.trace(P[:2, :2]) < np.trace(covariance[k, :2, :2]):
            to[k], pose[k], covariance[k] = before.to[k] + 1, inverse(onward), inverse_covariance(onward, P)
    return _Way(to, pose, covariance)


def _moved(loops: Loops, gone: BoolArray, way: _Way, keys: int) -> Loops:
    """Loop closures between the key poses that are left."""
    relative, covariance = loops.relative.copy(), loops.covariance.copy()
    for i in np.flatnonzero(gone[loops.key1] | gone[loops.key2]).tolist():
        a, b = loops.key1[i], loops.key2[i]
        found, P = _step(way.pose[a], way.covariance[a], loops.relative[i], loops.covariance[i])
        back, Q = inverse(way.pose[b]), inverse_covariance(way.pose[b], way.covariance[b])
        relative[i], covariance[i] = _step(found, P, back, Q)
    key1, key2 = way.to[loops.key1], way.to[loops.key2]
    # a closure that joined at a key pose that went joins at the next one left
    after = np.minimum(np.cumsum(~gone) - 1 + gone, keys - 1)
    believed = np.where(loops.believed >= 0, after[loops.believed], -1)
    stay = key1 < key2
    return Loops(
        key1[stay], key2[stay], relative[stay], covariance[stay], loops.score[stay],
        np.maximum(believed, np.where(believed >= 0, key2, -1))[stay],
    )  # fmt: skip
