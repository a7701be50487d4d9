"""What was observed, as factors that can be taken back: by landmark in SLAM, by frame where the landmarks are known."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam import symbolIndex

from data.inputs import IntArray, LandmarkMap, Sightings
from data.se2 import Array
from data.sensors import Sensor
from graph.calibration.factors import sight_pinned
from graph.calibration.variables import Errors
from graph.factors import Factor, Sighted, name_of, sight_known, sight_landmarks


class Observed:
    """All observations in the graph, in the order of frames, and the engine's handles on their factors."""

    def __init__(self, sensor: Sensor, known: LandmarkMap | None, loss: str, errors: Errors | None = None) -> None:
        """Nothing observed. `loss` as in `graph.batch.smooth`; `errors`: what a known map depends on in this graph."""
        self.sensor, self.map, self.loss = sensor, known, loss
        self.sighted: list[Sighted] = []
        self._handles: dict[int, list[int]] = {}
        depends = known is not None and errors is not None and errors.frame.range_at >= 0
        self._errors = errors if depends else None
        self._plain: dict[int, Sighted] = {}
        self._copies = 0
        self._numbers: IntArray | None = None

    @property
    def numbers(self) -> IntArray:
        """Landmark numbers that SLAM has in its map, ascending."""
        if self._numbers is None:
            self._numbers = np.array(sorted(self._handles) if self.map is None else [], np.int64)
        return self._numbers

    def missing(self, numbers: IntArray) -> list[int]:
        """Those of some numbers (n,) that name no landmark."""
        if self.map is not None:
            return [int(n) for n in np.setdiff1d(numbers, self.map.id)]
        return [n for n in numbers.tolist() if n not in self._handles]

    def name(self, key: int) -> str:
        """A variable in words; the copies of known landmarks are numbered by observation."""
        return next((f"landmark {s.number}" for s in self.sighted if self.map and s.key == key), name_of(key))

    def factors(
        self, sightings: Sightings, frames: IntArray, number: IntArray, errors: tuple[Array, Array] | None = None
    ) -> list[Sighted]:
        """Observations (m) of landmarks (m,) from frames (m,), not taken in yet; `errors` as known now."""
        if self.map is None:
            return sight_landmarks(self.sensor, *sightings, frames, number, self.loss)
        xy = self.map.positions(number)
        self._copies += len(number)
        row = self._copies - len(number)
        plain = sight_known(self.sensor, *sightings, frames, number, xy, row, self.loss)
        if self._errors is None or errors is None:
            return plain
        self._plain.update(enumerate(plain, row))
        pinned = sight_pinned(self._errors, self.sensor, sightings, frames, number, xy, row, self.loss, errors[0])
        return pinned

    @property
    def plainly(self) -> list[Sighted]:
        """All that is taken in, known landmarks where the map has them."""
        return [self._plain.get(symbolIndex(s.key), s) if s.key is not None else s for s in self.sighted]

    def add(self, seen: Sequence[Sighted], values: gtsam.Values, *, late: bool = False) -> list[Factor]:
        """Take observations in, start values of their own variables into `values`; returns their factors.

        `late`: they may be from frames before the newest one.
        """
        self.sighted += seen
        if late:
            self.sighted.sort(key=lambda s: s.frame)
        for s in seen:
            if s.key is not None and s.xy is not None:
                values.insert(s.key, s.xy)
        return [f for s in seen for f in s.factors]

    def hold(self, seen: Sequence[Sighted], handles: Sequence[int]) -> None:
        """The engine's handles on the factors of `add`, in their order."""
        begin, count = 0, len(self._handles)
        for s in seen:
            end = begin + len(s.factors)
            self._handles.setdefault(s.number if self.map is None else s.frame, []).extend(handles[begin:end])
            begin = end
        if len(self._handles) != count:
            self._numbers = None

    def take_back(self, which: Sequence[int]) -> list[int]:
        """Forget the observations of some landmarks, or from some frames of a known map; handles on their factors."""
        gone, self._numbers = set(which), None
        self.sighted = [s for s in self.sighted if (s.number if self.map is None else s.frame) not in gone]
        return [h for n in which for h in self._handles.pop(n, [])]
