"""What observations tell of their landmark beside its place: a number such as a trunk's diameter, or a class.

Both are measurements with noise of their own, independent of range and bearing. Estimators use places alone;
association uses both.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data.locked import IntArray, Locked
from data.se2 import Array

UNREAD = -1  # Class of an observation whose class was not read


@dataclass(frozen=True, eq=False)
class Appearance(Locked):
    """Descriptors and classes of observations or landmarks (M,), as measured."""

    descriptor: Array  # in a unit of its own, NaN where not measured
    sigma: Array  # its standard deviation; 0 of a known landmark, which is exact
    category: IntArray  # row in `names`, `UNREAD` where not read
    error: Array  # probability that another class than the true one was read, all others alike; 0 as of sigma
    names: tuple[str, ...] = ()  # of the classes

    def __len__(self) -> int:
        return len(self.descriptor)

    @property
    def measures(self) -> bool:
        """Whether some have a descriptor."""
        return bool(np.isfinite(self.descriptor).any())

    def arrays(self) -> tuple[Array | IntArray, ...]:
        """All that it consists of, for digests."""
        return self.descriptor, self.sigma, self.category, self.error


def joined(parts: Sequence[Appearance]) -> Appearance:
    """Several in a row (at least one), with the same names."""
    return Appearance(
        np.concatenate([p.descriptor for p in parts]), np.concatenate([p.sigma for p in parts]),
        np.concatenate([p.category for p in parts]), np.concatenate([p.error for p in parts]), parts[0].names,
    )  # fmt: skip


def drawn(like: Appearance, landmark: Appearance, row: IntArray, rng: np.random.Generator) -> Appearance:
    """New readings of known landmarks (L,), where and how `like` (M,) has some; row (M,): the landmark, -1 for none. An
    observation of no landmark, or of one whose appearance is unknown, keeps its reading.
    """
    noise, chance, other = rng.standard_normal(len(like)), rng.random(len(like)), rng.random(len(like))
    of = np.maximum(row, 0)
    descriptor, category = like.descriptor.copy(), like.category.copy()
    if len(landmark):
        mean, true = landmark.descriptor[of], landmark.category[of]
        known = (row >= 0) & np.isfinite(mean) & np.isfinite(descriptor)
        descriptor[known] = (mean + like.sigma * noise)[known]
        known = (row >= 0) & (true >= 0) & (category >= 0)
        # another class: one of the C - 1 others, all alike
        step = 1 + np.minimum((other * (len(like.names) - 1)).astype(np.int64), max(len(like.names) - 2, 0))
        read = np.where((chance < like.error) & (len(like.names) > 1), (true + step) % max(len(like.names), 1), true)
        category[known] = read[known]
    return Appearance(descriptor, like.sigma, category, like.error, like.names)
