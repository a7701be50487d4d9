"""What was observed, as factors that can be taken back: by landmark in SLAM, by frame where the landmarks are known."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from gtsam import symbolIndex
from gtsam.symbol_shorthand import L, X

from data.inputs import FrameObservations, IntArray, LandmarkMap
from data.se2 import Array
from data.sensors import Sensor
from graph.calibration.factors import sight_pinned
from graph.engine import Engine
from graph.factors import Factor, Sighted, name_of, sight_known, sight_landmarks
from graph.open_end import OpenEnd
from graph.problem import Problem
from graph.systematic import Errors
from graph.walls import SightedWall, as_vectors, sight_known_walls, sight_lines, sight_walls


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
        return next((f"landmark {s.number}" for s in self.sighted if key in s.alone), name_of(key))

    def sight(
        self,
        seen: FrameObservations,
        frames: IntArray,
        number: IntArray,
        end: OpenEnd,
        engine: Engine,
        joining: gtsam.Values,
    ) -> Sequence[Sighted]:
        """Observations (m) of landmarks (m,) from frames (m,), not taken in yet; the newest of the frames may only be
        `joining` the graph.
        """
        if self.sensor.sees_points:
            return self._points(seen, frames, number, end.errors)
        self._copies += len(number)
        row = self._copies - len(number)
        pose = np.array([engine.pose(X(k), joining) for k in frames.tolist()]).reshape(-1, 3)
        if self.map is not None:
            lines = self.map.positions(number)
            return sight_known_walls(self.sensor, seen, frames, number, pose, lines, row, self.loss)
        there = [n for n in dict.fromkeys(number.tolist()) if n in self._handles]
        old = dict(zip(there, engine.points(there), strict=True))
        return sight_walls(self.sensor, seen, frames, number, pose, old, row, self.loss)

    def _points(
        self, observations: FrameObservations, frames: IntArray, number: IntArray, errors: tuple[Array, Array] | None
    ) -> list[Sighted]:
        """Observations of points; `errors` as known now."""
        if self.map is None:
            return sight_landmarks(self.sensor, *observations, frames, number, self.loss)
        xy = self.map.positions(number)
        self._copies += len(number)
        row = self._copies - len(number)
        plain = sight_known(self.sensor, *observations, frames, number, xy, row, self.loss)
        if self._errors is None or errors is None:
            return plain
        self._plain.update(enumerate(plain, row))
        pinned = sight_pinned(self._errors, self.sensor, observations, frames, number, xy, row, self.loss, errors[0])
        return pinned

    def start(self, seen: FrameObservations, number: IntArray, pose: Array, values: gtsam.Values) -> None:
        """Start values of the points that are new, seen from a pose (3,); walls bring theirs along."""
        for n in dict.fromkeys(self.missing(number) if self.sensor.sees_points else []):
            i = int(np.flatnonzero(number == n)[0])
            values.insert(L(n), self.sensor.inverse(pose, seen.z[i : i + 1])[0][0])

    def renumbered(self, other: dict[int, int], engine: Engine) -> list[Sighted]:
        """The observations (SLAM) of some landmarks, taken for the others that they are said to be."""
        moved = [s for s in self.sighted if s.number in other]
        turned = set[int]()
        if not self.sensor.sees_points:
            a, b = engine.points([*other])[:, 1], engine.points([*other.values()])[:, 1]
            turned = {n for n, opposite in zip(other, np.cos(a - b) < 0.0, strict=True) if opposite}
        return [s.renumbered(other[s.number], opposite=s.number in turned) for s in moved]

    def replace(self, frames: IntArray, seen: FrameObservations, number: IntArray) -> None:
        """In SLAM, for `problem` alone: what points were seen, ascending by frame; number (m,), negative for none."""
        take = np.flatnonzero(number >= 0)
        found = FrameObservations(seen.z[take], seen.R[take])
        self.sighted = sight_landmarks(self.sensor, *found, frames[take], number[take], self.loss)

    def problem(self, end: OpenEnd, values: gtsam.Values) -> Problem:
        """All of the run as a problem, where known landmarks are where the map has them; `values` become its own."""
        if self.sensor.sees_points:
            plain = [self._plain.get(symbolIndex(s.key), s) if s.key is not None else s for s in self.sighted]
            return end.problem(plain, self.map is not None)
        about = end.prior.mean[:2]
        problem = replace(end.problem(self._lines(about), self.map is not None), about=about)
        as_vectors(values, problem.numbers, about)
        return problem

    def _lines(self, about: Array) -> list[Sighted]:
        """Walls as factors of a problem that counts distances from a point (2,)."""
        walls = [s for s in self.sighted if isinstance(s, SightedWall)]
        if not walls:
            return []
        z, R = np.array([s.z for s in walls]), np.array([s.R for s in walls])
        frame, number = np.array([[s.frame, s.number] for s in walls]).T
        known = None if self.map is None else self.map.positions(number)
        return sight_lines(self.sensor, z, R, frame, number, about, self.loss, known)

    def alone(self, frames: range, numbers: Sequence[int] | None = None) -> list[int]:
        """Variables that single observations from some frames (of some landmarks alone) have to themselves."""
        first, end = (bisect_left(self.sighted, f, key=lambda s: s.frame) for f in (frames.start, frames.stop))
        of = self.sighted[first:end]
        return [key for s in of if numbers is None or s.number in numbers for key in s.alone]

    def forget(self, oldest: int, alive: Callable[[int], bool]) -> None:
        """Observations from frames before `oldest` have left the graph; `alive` says it of a handle."""
        first = bisect_left(self.sighted, oldest, key=lambda s: s.frame)
        gone, self.sighted = self.sighted[:first], self.sighted[first:]
        for s in gone:
            if s.key is not None:
                self._plain.pop(symbolIndex(s.key), None)
        if self.map is not None:
            for frame in {s.frame for s in gone}:
                self._handles.pop(frame, None)
            return
        for number in {s.number for s in gone}:
            if number in self._handles:
                self._handles[number] = [h for h in self._handles[number] if alive(h)]

    def add(self, seen: Sequence[Sighted], values: gtsam.Values, *, late: bool = False) -> list[Factor]:
        """Take observations in, start values of their own variables into `values`; returns their factors.

        `late`: they may be from frames before the newest one.
        """
        self.sighted += seen
        if late:
            self.sighted.sort(key=lambda s: s.frame)
        for s in seen:
            for key, start in s.starts:
                values.insert(key, start)
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
