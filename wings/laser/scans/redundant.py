"""Redundant key poses, whose scans add little information, and the pose graph without them.

Kretzschmar and Stachniss, "Information-theoretic compression of pose graphs for laser-based SLAM", IJRR 31, 2012: the
scan with the least expected information about the map is removed first. Here the information about a cell is the number
of scans that end in it; one of n scans has 1/n of it. Constraints of a removed key pose move to the nearest one kept,
along the chain (their section 5).
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np

from data.inputs import IntArray
from data.se2 import Array, BoolArray
from wings.laser.scans.constraints import Chain, Loops
from wings.laser.scans.uncertainty import Link, composed, reversed_link

CELL = 0.1  # m, a few standard deviations of a key pose, so that scans of one wall end in the same cells
MOST_IN_A_ROW = 3  # consecutive key poses that may be removed


def redundant(ends: Sequence[Array], least: float) -> BoolArray:
    """Which of K key poses to remove, until each has a share of `least` in the information about the cells it observes.
    `ends`: end points (n, 2) of each key scan in the world [m]. The first and the last key pose are kept.
    """
    keep = np.zeros(len(ends), np.bool_)
    keep[:1] = keep[-1:] = True
    return least_informative([cells_of(xy) for xy in ends], least, keep, in_a_row=MOST_IN_A_ROW)


def least_informative(
    cells: Sequence[IntArray],
    least: float,
    keep: BoolArray,
    *,
    in_a_row: int | None = None,
    most: int | None = None,
) -> BoolArray:
    """Which of K key poses to remove, as of `redundant`, by the cells of each scan (`cells_of`).

    Those to `keep` (K,) stay. `in_a_row`: consecutive key poses that may be removed; `most`: in all.
    """
    number = np.unique(np.concatenate([*cells, np.zeros(0, np.int64)]), return_inverse=True)[1].ravel()
    cells = np.split(number, np.cumsum([len(a) for a in cells])[:-1])
    hits = np.bincount(number)
    removed = np.zeros(len(cells), np.bool_)

    def share(k: int) -> float:
        # rounded, so that the older of two equal key poses is removed whatever the order of a sum
        return round(float((1.0 / hits[cells[k]]).mean()), 12) if len(cells[k]) else 0.0

    waiting = [(share(k), k) for k in np.flatnonzero(~keep).tolist()]
    heapq.heapify(waiting)
    while waiting and (most is None or removed.sum() < most):
        information, k = heapq.heappop(waiting)
        if information >= least:
            break
        # removals since then can only have increased its information
        now = share(k)
        if now > information:
            heapq.heappush(waiting, (now, k))
            continue
        if in_a_row is None or _row(removed, k) < in_a_row:
            removed[k] = True
            hits[cells[k]] -= 1
    return removed


def _row(removed: BoolArray, k: int) -> int:
    """Number of consecutive key poses around k that are removed."""
    before, after = k, k
    while removed[before - 1]:
        before -= 1
    while removed[after + 1]:
        after += 1
    return after - before


def cells_of(xy: Array) -> IntArray:
    """The cells, as numbers, that points (n, 2) [m] lie in, each once."""
    at = np.floor(xy / CELL).astype(np.int64)
    return np.unique((at[:, 0] << 32) + at[:, 1])


def without(chain: Chain, loops: Loops, removed: BoolArray) -> tuple[Chain, Loops]:
    """The constraints without the removed key poses (K,), which do not include the first.

    Steps of the chain are composed, and frames are relative to the last key pose kept. Loop closures lead to the kept
    key pose with less uncertainty along the chain; those within one key pose are dropped. The information of chain
    steps in a composed closure is counted twice.
    """
    number, kept = np.cumsum(~removed) - 1, np.flatnonzero(~removed)  # number: the last one kept at or before each
    before = _along(chain, removed)
    motion, covariance = np.zeros((len(kept), 3)), np.zeros((len(kept), 3, 3))
    for i, k in enumerate(kept[1:].tolist(), start=1):
        motion[i], covariance[i] = composed(before[k - 1], (chain.motion[k], chain.covariance[k]))
    since, since_covariance = chain.since.copy(), chain.since_covariance.copy()
    for f in np.flatnonzero(removed[chain.key]).tolist():
        since[f], since_covariance[f] = composed(before[chain.key[f]], (chain.since[f], chain.since_covariance[f]))
    thinned = Chain(chain.frame[kept], motion, covariance, number[chain.key], since, since_covariance)
    return thinned, _moved(loops, removed, *_nearest(chain, removed, before), len(kept))


HERE: Link = (np.zeros(3), np.zeros((3, 3)))


def _along(chain: Chain, removed: BoolArray) -> list[Link]:
    """Each key pose relative to the last one kept at or before it."""
    links = list[Link]()
    for k, out in enumerate(removed.tolist()):
        links.append(composed(links[-1], (chain.motion[k], chain.covariance[k])) if out else HERE)
    return links


def _nearest(chain: Chain, removed: BoolArray, before: list[Link]) -> tuple[IntArray, list[Link]]:
    """Number of the kept key pose, before or after each, with less uncertainty along the chain; the link from it."""
    to, links = np.cumsum(~removed) - 1, before.copy()
    onward = HERE  # from a key pose to the next one kept
    for k in range(int(np.flatnonzero(~removed)[-1]), 0, -1):
        if not removed[k]:
            onward = HERE
            continue
        onward = composed((chain.motion[k + 1], chain.covariance[k + 1]), onward)
        if np.trace(onward[1][:2, :2]) < np.trace(links[k][1][:2, :2]):
            to[k], links[k] = to[k] + 1, reversed_link(onward)
    return to, links


def _moved(loops: Loops, removed: BoolArray, to: IntArray, links: list[Link], keys: int) -> Loops:
    """Loop closures between the key poses that are kept."""
    relative, covariance = loops.relative.copy(), loops.covariance.copy()
    for i in np.flatnonzero(removed[loops.key1] | removed[loops.key2]).tolist():
        first, last = links[loops.key1[i]], links[loops.key2[i]]
        found = composed(first, (loops.relative[i], loops.covariance[i]))
        relative[i], covariance[i] = composed(found, reversed_link(last))
    key1, key2 = to[loops.key1], to[loops.key2]
    # a closure that joined at a removed key pose joins at the next one kept
    after = np.minimum(np.cumsum(~removed) - 1 + removed, keys - 1)
    believed = np.where(loops.believed >= 0, np.maximum(after[loops.believed], key2), -1)
    kept = key1 < key2
    return Loops(key1[kept], key2[kept], relative[kept], covariance[kept], loops.score[kept], believed[kept])
