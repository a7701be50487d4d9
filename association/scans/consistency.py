"""Whether a map draws walls once: scans of revisited places contradict each other no more than neighbouring ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from association.scans.occupancy import contradiction
from data.inputs import IntArray, Scans
from data.se2 import Array, between

NEAR, APART, BESIDE = 3.0, 12, 3
"""m between two key poses whose scans are compared; key poses between them: revisits, and neighbours at most."""
MOST_PAIRS, LEAST_PAIRS = 300, 10
MAX_RANGE = 20.0  # m, of beams that are compared
TOLERANCE = (0.15, 0.03)
"""m, and share of the range: a doubled wall is farther off, a grazing wall by a right heading is not."""
DOUBLED = 0.03
"""Share of beams by which revisits contradict more than neighbours do: at most 0.008 on recorded logs and on simulated
ones with people and glass; 0.12 where the path of a simulated one drifts by half a metre."""


class Consistency(NamedTuple):
    """Shares of beams of one key scan that pass a surface of another: among revisits, among neighbours (its noise, with
    people and glass), and the number of revisits compared.
    """

    revisits: float
    neighbours: float
    pairs: int

    @property
    def excess(self) -> float:
        """What revisits contradict more."""
        return self.revisits - self.neighbours

    @property
    def is_doubled(self) -> bool:
        """Whether walls are drawn twice."""
        return self.excess > DOUBLED


def consistency(scans: Scans, frames: IntArray, pose: Array) -> Consistency | None:
    """Of the scans at key poses (K, 3), which are these frames (K,); None without revisits."""
    pairs: list[tuple[int, int]] = []
    for k in range(len(pose)):
        before = pose[: max(k - APART + 1, 0), :2]
        old = np.flatnonzero(np.hypot(before[:, 0] - pose[k, 0], before[:, 1] - pose[k, 1]) < NEAR)  # NaN is far
        if len(old):
            pairs.append((int(old[len(old) // 2]), k))
    if len(pairs) < LEAST_PAIRS:
        return None
    pairs = pairs[:: max(len(pairs) // MOST_PAIRS, 1)]
    row = dict(zip(scans.frame.tolist(), scans.ranges, strict=True))

    def share(some: Sequence[tuple[int, int]]) -> float:
        shares = [
            contradiction(
                row[int(frames[i])], row[int(frames[j])], between(pose[i], pose[j]), scans.scanner, MAX_RANGE, TOLERANCE
            )
            for i, j in some
            if int(frames[i]) in row and int(frames[j]) in row
        ]
        return float(np.mean(shares)) if shares else 0.0

    return Consistency(share(pairs), share([(max(j - BESIDE, 0), j) for _, j in pairs]), len(pairs))
