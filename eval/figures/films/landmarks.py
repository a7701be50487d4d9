"""Landmarks as an estimator held them at each instant: what changed in which frame, and what stands after it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from data.inputs import IntArray, read_only
from data.result import Run
from data.se2 import Array, BoolArray

AS_THEN, AT_THE_END = "as then", "as at the end"


@dataclass(frozen=True, eq=False)
class History:
    """Changes (C,) of landmarks, in the order of their frames.

    Attributes:
        frame, number: (C,) after which frame, of which landmark.
        there: (C,) false where it left the map.
        xy: (C, 2) m, covariance: (C, 2, 2) m^2, world frame.
        when: of what instant this is, in words: `AS_THEN` or `AT_THE_END`.
    """

    frame: IntArray
    number: IntArray
    there: BoolArray
    xy: Array
    covariance: Array
    when: str = AS_THEN

    def __post_init__(self) -> None:
        read_only(self)

    def after(self, frames: IntArray) -> Iterator[IntArray]:
        """For each of some frames (P,), ascending: the changes (L,) that stand after it, by landmark number."""
        standing: dict[int, int] = {}
        next_one = 0
        for k in frames.tolist():
            while next_one < len(self.frame) and self.frame[next_one] <= k:
                number = int(self.number[next_one])
                if self.there[next_one]:
                    standing[number] = next_one
                else:
                    standing.pop(number, None)
                next_one += 1
            yield np.array([standing[n] for n in sorted(standing)], np.int64)


def at_the_end(run: Run) -> History:
    """The last map, each landmark from the frame on in which it was first seen."""
    if run.map is None:
        none = np.empty(0, np.int64)
        return History(none, none, none.astype(bool), np.empty((0, 2)), np.empty((0, 2, 2)), AT_THE_END)
    m = run.map
    usable = np.isfinite(m.xy).all(axis=1) & np.isfinite(m.covariance).all(axis=(1, 2)) & (m.first_frame >= 0)
    order = np.flatnonzero(usable)[np.argsort(m.first_frame[usable], kind="stable")]
    there = np.ones(len(order), bool)
    return History(m.first_frame[order], m.number[order], there, m.xy[order], m.covariance[order], AT_THE_END)
