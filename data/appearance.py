"""What observations tell of their landmark beside its place: a number such as a trunk's diameter, or a class.

Both are measurements with noise of their own, independent of range and bearing. Estimators use places alone;
association uses both.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.locked import IntArray, Locked
from data.se2 import Array

UNREAD = -1
"""Class of an observation whose class was not read."""


@dataclass(frozen=True, eq=False)
class Appearance(Locked):
    """Descriptors and classes of observations or landmarks (M,), as measured.

    Attributes:
        descriptor: (M,) in a unit of its own, NaN where not measured.
        sigma: (M,) its standard deviation; 0 of a known landmark, which is exact.
        category: (M,) row in `names`, `UNREAD` where not read.
        error: (M,) probability that another class than the true one was read, all others alike; 0 as of sigma.
        names: of the classes (C,).
    """

    descriptor: Array
    sigma: Array
    category: IntArray
    error: Array
    names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.descriptor)

    @property
    def measures(self) -> bool:
        """Whether some have a descriptor."""
        return bool(np.isfinite(self.descriptor).any())

    @property
    def classifies(self) -> bool:
        """Whether some have a class."""
        return bool((self.category >= 0).any())

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
    """New readings of known landmarks (L,), where and how `like` (M,) has some; row (M,): the landmark, -1 for none.

    An observation of no landmark, or of one whose appearance is unknown, keeps its reading.
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
        wrong = (chance < like.error) & (len(like.names) > 1)
        read = np.where(wrong, (true + step) % max(len(like.names), 1), true)
        category[known] = read[known]
    return Appearance(descriptor, like.sigma, category, like.error, like.names)


class Spread(NamedTuple):
    """Of descriptors whose landmarks are known: standard deviations about each landmark's mean, of one reading by the
    difference to the next of its landmark, and of the landmarks' means; NaN where there are too few.

    Where errors persist from frame to frame `successive` is too small for a sigma: they are the same in both readings.
    """

    within: float
    successive: float
    between: float


def spread(looks: Appearance, landmark: IntArray) -> Spread:
    """Of observations (M,) in their order, by landmark (M,), negative for none."""
    rows = np.flatnonzero((landmark >= 0) & np.isfinite(looks.descriptor))
    rows = rows[np.argsort(landmark[rows], kind="stable")]
    z, (_, first, of, times) = looks.descriptor[rows], np.unique(
        landmark[rows], return_index=True, return_inverse=True, return_counts=True
    )  # fmt: skip
    more = len(z) - len(first)
    if not more:
        return Spread(np.nan, np.nan, np.nan)
    mean = np.add.reduceat(z, first) / times
    within = float(((z - mean[of]) ** 2).sum()) / more
    step = np.delete(np.diff(z), first[1:] - 1)
    # the means have errors of their own
    between = float(mean.var(ddof=1)) - within * float((1.0 / times).mean()) if len(mean) > 1 else np.nan
    successive = float(np.sqrt(0.5 * (step**2).mean()))
    return Spread(float(np.sqrt(within)), successive, float(np.sqrt(max(between, 0.0))))


def misread(looks: Appearance, landmark: IntArray) -> float:
    """Share of classes read unlike the commonest reading of their landmark (M,), negative for none; NaN without any."""
    rows = np.flatnonzero((landmark >= 0) & (looks.category >= 0))
    if not len(rows):
        return float("nan")
    _, of = np.unique(landmark[rows], return_inverse=True)
    count = np.zeros((int(of.max()) + 1, len(looks.names)), np.int64)
    np.add.at(count, (of, looks.category[rows]), 1)
    return 1.0 - float(count.max(axis=1).sum()) / len(rows)
