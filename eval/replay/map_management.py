"""Which landmarks leave the map, and when: map maintenance, forgetting and parking."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.inputs import IntArray
from eval.replay.settings import Setup

MAINTENANCE_FRAMES = 2
"""A landmark seen only once is removed when its sighting is more frames ago than this."""


class Leaving(NamedTuple):
    """Landmark numbers: `retracted` as if never seen, `forgotten` from now on, `parked` until seen again."""

    retracted: IntArray
    forgotten: IntArray
    parked: IntArray


class MapManagement:
    """When each landmark was seen, and what follows from it: `begin` a frame, `see`, `leaving`.

    Attributes:
        removed: frame after which a landmark was no longer in the map.
        retracted: landmarks that were removed as if never seen.
    """

    def __init__(self, setup: Setup) -> None:
        """Nothing seen."""
        self.setup = setup
        self.removed: dict[int, int] = {}
        self.retracted: set[int] = set()
        self._frame, self._now = 0, 0.0
        # by landmark: frame of the first sighting, number of sightings, time of the last one, time since which it is
        # active (seen or restored last)
        self._first, self._times = np.empty(0, np.int64), np.empty(0, np.int64)
        self._last, self._active = np.empty(0), np.empty(0)
        self._parked, self._gone = np.empty(0, np.bool_), np.empty(0, np.bool_)

    def begin(self, frame: int, time: float) -> None:
        """The next frame, at a time in the unit of the setup's spans."""
        self._frame, self._now = frame, time

    def see(self, numbers: IntArray) -> None:
        """Landmarks paired or initialized in this frame; numbers come in order of creation."""
        more = int(numbers.max(initial=-1)) + 1 - len(self._first)
        if more > 0:
            self._first = np.concatenate([self._first, np.full(more, self._frame)])
            self._times = np.concatenate([self._times, np.zeros(more, np.int64)])
            self._last = np.concatenate([self._last, np.full(more, self._now)])
            self._active = np.concatenate([self._active, np.full(more, self._now)])
            self._parked = np.concatenate([self._parked, np.zeros(more, np.bool_)])
            self._gone = np.concatenate([self._gone, np.zeros(more, np.bool_)])
        np.add.at(self._times, numbers, 1)
        self._last[numbers] = self._active[numbers] = self._now

    def restored(self, numbers: IntArray) -> None:
        """Parked landmarks came back; the time until they are parked again starts anew."""
        self._parked[numbers] = False
        self._active[numbers] = self._now

    def leaving(self) -> Leaving:
        """What leaves after this frame; afterwards it counts as gone."""
        s, now, nobody = self.setup, self._now, np.empty(0, np.int64)
        retracted = forgotten = parked = nobody
        if s.maintain:
            old = self._frame - self._first > MAINTENANCE_FRAMES
            retracted = np.flatnonzero(~self._gone & (self._times == 1) & old)
            self.remove(retracted)
            self.retracted.update(retracted.tolist())
        if s.forget_after is not None:
            forgotten = np.flatnonzero(~self._gone & (now - self._last > s.forget_after))
            self.remove(forgotten)
        if s.deactivate_after is not None:
            parked = np.flatnonzero(~self._gone & ~self._parked & (now - self._active > s.deactivate_after))
            self._parked[parked] = True
        return Leaving(retracted, forgotten, parked)

    def remove(self, numbers: IntArray) -> None:
        """Landmarks (r,) that leave the map after this frame, by these rules or for another reason."""
        self._gone[numbers] = True
        self.removed.update((n, self._frame) for n in numbers.tolist())

    def removal_frames(self, count: int) -> IntArray:
        """Frame (count,) after which each landmark was no longer in the map; -1: it stayed."""
        frames = np.full(count, -1, np.int64)
        for n, frame in self.removed.items():
            frames[n] = frame
        return frames
