"""A pose graph that key poses leave as it grows: what they tell about their neighbours stays.

The constraints of a removed key pose form a star. Of the marginal over its neighbours, which connects all of them, a
tree is kept: each neighbour is measured from the one that is known best, through the removed key pose (Kretzschmar and
Stachniss, "Information-theoretic compression of pose graphs for laser-based SLAM", IJRR 31, 2012, section 5). So no
removal adds constraints. All of the tree contain the measurement of the best neighbour: each takes its share of that
information, so none counts more than once, and the tree claims no more than the marginal. Two constraints between the
same key poses become one, with the information of both.
"""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import IntArray, Prior
from data.se2 import Array, compose, pose_error, wrap_angle
from graph.factors import Factor, pose2, relative_factors
from graph.incremental import DELICATE
from wings.laser.poses.online import PoseGraph
from wings.laser.scans.uncertainty import LEVER, Link, composed, reversed_link


class ThinnedPoseGraph(PoseGraph):
    """`PoseGraph` whose key poses can be removed; conventions as there."""

    def __init__(self, prior: Prior) -> None:
        """Start at the prior with key pose 0."""
        super().__init__(prior)
        self._engine.reuses_slots = self._engine.isam.params().findUnusedFactorSlots = True
        self._links: dict[int, dict[int, Link]] = {0: {}}
        self._handle: dict[tuple[int, int], int] = {}
        self._new: set[tuple[int, int]] = set()  # constraints that the engine does not have yet, ...
        self._old: list[int] = []  # ... and factors that it has no longer to have

    @property
    def links(self) -> Mapping[int, Mapping[int, Link]]:
        """Constraints by key pose and neighbour: the neighbour's pose in the key pose's frame. Both ways."""
        return self._links

    @property
    def size(self) -> int:
        """Number of key poses in the graph."""
        return len(self._links)

    def add_key(self, motion: Array, covariance: Array) -> None:
        """As `PoseGraph.add_key`."""
        self._tip = compose(self._tip, motion)
        self._values.insert(X(self.keys), pose2(self._tip))
        self._links[self.keys] = {}
        self._connect(self.keys - 1, self.keys, (motion, covariance))
        self.keys += 1

    def add_loops(self, key1: IntArray, key2: IntArray, relative: Array, covariance: Array) -> None:
        """As `PoseGraph.add_loops`, between key poses that are in the graph."""
        for a, b, pose, P in zip(key1.tolist(), key2.tolist(), relative, covariance, strict=True):
            if a not in self._links or b not in self._links:
                raise ValueError(f"a loop closure between key poses {a} and {b}, of which one is not in the graph")
            self._connect(a, b, (pose, P))
            self._loops = True

    def remove(self, key: int) -> list[tuple[int, int]]:
        """Remove a key pose, from the next `update` on; returns the pairs of neighbours that are connected instead.

        Raises ValueError for the first, the newest, or an unknown one.
        """
        if key in (0, self.keys - 1) or key not in self._links:
            raise ValueError(f"key pose {key} cannot be removed")
        legs = self._links.pop(key)
        for other in legs:
            del self._links[other][key]
            pair = _pair(key, other)
            self._new.discard(pair)
            if pair in self._handle:
                self._old.append(self._handle.pop(pair))
        if self._values.exists(X(key)):  # not in the engine yet
            self._values.erase(X(key))
        best = min(legs, key=lambda k: _spread(legs[k][1]))
        pose, covariance = reversed_link(legs.pop(best))
        shared = pose, len(legs) * covariance
        for other, leg in legs.items():
            self._connect(best, other, composed(shared, leg))
        return [(best, other) for other in legs]

    def _connect(self, a: int, b: int, link: Link) -> None:
        """Add a constraint, or its information to the one that there is."""
        known = self._links[a].get(b)
        link = link if known is None else _both(known, link)
        self._links[a][b], self._links[b][a] = link, reversed_link(link)
        pair = _pair(a, b)
        self._new.add(pair)
        if pair in self._handle:
            self._old.append(self._handle.pop(pair))

    def update(self) -> None:
        """As `PoseGraph.update`."""
        if not (self._new or self._factors):
            return
        pairs = sorted(self._new)
        priors, self._factors = self._factors, []
        made: list[Factor] = [self._factor(a, b) for a, b in pairs]
        handles = self._engine.replace([*priors, *made], self._values, self._old)
        self._handle.update(zip(pairs, handles[len(priors) :], strict=True))
        self._values, self._new, self._old = gtsam.Values(), set(), []
        newest = int(X(self.keys - 1))
        if self._loops:
            self._engine.settle(newest, pose2(self._tip))
        self._tip, self._loops = self._engine.pose(newest), False

    def _factor(self, a: int, b: int) -> Factor:
        relative, covariance = self._links[a][b]
        ends, what = (np.array([a]), np.array([b])), f"motion from key pose {a} to {b}"
        (factor,), pivot, _ = relative_factors(*ends, relative[None], covariance[None], lambda _: what)
        if pivot < DELICATE:
            self._engine.use_qr()
        return factor

    def poses(self) -> Array:
        """All key poses (K, 3) after the last update, NaN for those that were removed."""
        found = np.full((self.keys, 3), np.nan)
        found[sorted(self._links)] = self._present()
        return found

    def _ready(self) -> None:
        if self._new:
            raise ValueError("additions are pending: call update() first")


def _pair(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)


def _spread(covariance: Array) -> float:
    """Uncertainty [m^2], a heading weighted as in `wings.laser.scans.uncertainty`."""
    return float(covariance[0, 0] + covariance[1, 1] + LEVER**2 * covariance[2, 2])


def _both(one: Link, other: Link) -> Link:
    """Two measurements of one relative pose as one, with the sum of their information."""
    gain = one[1] @ np.linalg.inv(one[1] + other[1])
    pose = one[0] + gain @ pose_error(other[0], one[0])
    pose[2] = wrap_angle(float(pose[2]))
    P = one[1] - gain @ one[1]
    return pose, 0.5 * (P + P.T)
