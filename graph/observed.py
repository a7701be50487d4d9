"""Removable observations in the graph: by landmark in SLAM, by frame where the landmarks are known."""

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
from graph.engine import Engine
from graph.factors import Factor, ObservationFactors, known_landmark_factors, landmark_factors, name_of
from graph.open_end import OpenEnd, pinned_landmark_factors
from graph.problem import LandmarkPrior, Problem, landmark_priors
from graph.systematic import Errors
from graph.walls import WallObservation, as_vectors, known_wall_factors, line_factors, wall_factors


class Observed:
    """All observations in the graph, in the order of frames, and the engine's handles on their factors."""

    def __init__(self, sensor: Sensor, known: LandmarkMap | None, errors: Errors | None = None) -> None:
        """`errors`: on which a known map depends in this graph."""
        self.sensor, self.map = sensor, known
        self.observations: list[ObservationFactors] = []
        self._handles: dict[int, list[int]] = {}
        depends = known is not None and errors is not None and errors.frame.range_at >= 0
        self._errors = errors if depends else None
        self._plain: dict[int, ObservationFactors] = {}
        self._copies = 0
        self._joined = set[int]()
        self._numbers: IntArray | None = None

    @property
    def numbers(self) -> IntArray:
        """Landmark numbers in the map of SLAM, ascending."""
        if self._numbers is None:
            self._numbers = np.array(sorted(self._handles) if self.map is None else [], np.int64)
        return self._numbers

    def missing(self, numbers: IntArray) -> list[int]:
        """Numbers that are absent from the map."""
        if self.map is not None:
            return [int(n) for n in np.setdiff1d(numbers, self.map.id)]
        return [n for n in numbers.tolist() if n not in self._handles]

    def name(self, key: int) -> str:
        """Name of a variable; the copies of known landmarks are numbered by observation."""
        return next((f"landmark {s.number}" for s in self.observations if key in s.own_variables), name_of(key))

    def factors_of(
        self,
        seen: FrameObservations,
        frames: IntArray,
        number: IntArray,
        end: OpenEnd,
        engine: Engine,
        joining: gtsam.Values,
    ) -> Sequence[ObservationFactors]:
        """Factors of observations (m) of landmarks (m,) from frames (m,), of which the newest may be `joining`."""
        row, walls = self._copies, not self.sensor.sees_points
        self._copies += len(number)
        if not walls and (self.map is None or self.map.sigma is not None):
            return landmark_factors(self.sensor, *seen, frames, number)
        pose = np.array([engine.pose(X(k), joining) for k in frames.tolist() if walls]).reshape(-1, 3)
        if self.map is None or self.map.sigma is not None:
            there = [n for n in dict.fromkeys(number.tolist()) if n in self._handles]
            old = dict(zip(there, engine.points(there), strict=True))
            return wall_factors(self.sensor, seen, frames, number, pose, old, row)
        at = self.map.positions(number)
        if walls:
            return known_wall_factors(self.sensor, seen, frames, number, pose, at, row)
        plain = known_landmark_factors(self.sensor, *seen, frames, number, at, row)
        if self._errors is None:
            return plain
        self._plain.update(enumerate(plain, row))
        observed = seen, frames, number, at, row
        return pinned_landmark_factors(self._errors, self.sensor, *observed, end.b)

    @property
    def joined(self) -> IntArray:
        """Landmarks of an uncertain map that are variables, by id, ascending."""
        return np.array(sorted(self._joined), np.int64)

    def join(self, number: IntArray, values: gtsam.Values) -> list[LandmarkPrior]:
        """Priors of landmarks (m,) of an uncertain map that are no variables yet, which they are then; none without
        one. Their start values are added to `values`.
        """
        new = np.array([n for n in dict.fromkeys(number.tolist()) if n not in self._joined], np.int64)
        priors = landmark_priors(self.map, new)
        self._joined.update(p.number for p in priors)
        for p in priors:
            values.insert(L(p.number), p.xy)
        return priors

    def start(self, seen: FrameObservations, number: IntArray, pose: Array, values: gtsam.Values) -> None:
        """Add start values of new points, observed from a pose (3,); walls have their own."""
        for n in dict.fromkeys(self.missing(number) if self.sensor.sees_points else []):
            i = int(np.flatnonzero(number == n)[0])
            values.insert(L(n), self.sensor.inverse(pose, seen.z[i : i + 1])[0][0])

    def renumbered(self, other: dict[int, int], engine: Engine) -> list[ObservationFactors]:
        """The observations (SLAM) of some landmarks, assigned to the others of `other`."""
        moved = [s for s in self.observations if s.number in other]
        _, opposite = self.sensor.difference(engine.points([*other]), engine.points([*other.values()]))
        turned = {n for n, o in zip(other, opposite, strict=True) if o}
        return [s.renumbered(other[s.number], opposite=s.number in turned) for s in moved]

    def replace(self, frames: IntArray, seen: FrameObservations, number: IntArray) -> None:
        """Replace the observed points of SLAM, for `problem` alone; by ascending frame, number negative for none."""
        take = np.flatnonzero(number >= 0)
        found = FrameObservations(seen.z[take], seen.R[take])
        self.observations = landmark_factors(self.sensor, *found, frames[take], number[take])

    def problem(self, end: OpenEnd, values: gtsam.Values) -> Problem:
        """The whole run as a problem, with known landmarks at their positions; `values` are converted to it."""
        if self.sensor.sees_points:
            plain = [self._plain.get(symbolIndex(s.key), s) if s.key is not None else s for s in self.observations]
            known_map = self.map is not None and self.map.sigma is None
            problem = Problem(end.prior, end.motion, plain, known_map)
            return replace(problem, priors=landmark_priors(self.map, problem.numbers))
        about = end.prior.mean[:2]
        problem = Problem(end.prior, end.motion, self._lines(about), self.map is not None, about)
        as_vectors(values, problem.numbers, about)
        return problem

    def _lines(self, about: Array) -> list[ObservationFactors]:
        """Walls as factors of a problem with distances from a point (2,)."""
        walls = [s for s in self.observations if isinstance(s, WallObservation)]
        if not walls:
            return []
        z, R = np.array([s.z for s in walls]), np.array([s.R for s in walls])
        frame, number = np.array([[s.frame, s.number] for s in walls]).T
        known = None if self.map is None else self.map.positions(number)
        return line_factors(self.sensor, z, R, frame, number, about, known=known)

    def own_variables(self, frames: range, numbers: Sequence[int] | None = None) -> list[int]:
        """Variables of single observations from some frames (of some landmarks only)."""
        first, end = (bisect_left(self.observations, f, key=lambda s: s.frame) for f in (frames.start, frames.stop))
        of = self.observations[first:end]
        return [key for s in of if numbers is None or s.number in numbers for key in s.own_variables]

    def forget(self, oldest: int, alive: Callable[[int], bool]) -> None:
        """Remove observations from frames before `oldest`, which left the graph; `alive` tests a handle."""
        first = bisect_left(self.observations, oldest, key=lambda s: s.frame)
        removed, self.observations = self.observations[:first], self.observations[first:]
        for s in removed:
            if s.key is not None:
                self._plain.pop(symbolIndex(s.key), None)
        if self.map is not None:
            for frame in {s.frame for s in removed}:
                self._handles.pop(frame, None)
            return
        for number in {s.number for s in removed}:
            if number in self._handles:
                self._handles[number] = [h for h in self._handles[number] if alive(h)]

    def add(self, seen: Sequence[ObservationFactors], values: gtsam.Values, *, late: bool = False) -> list[Factor]:
        """Add observations, and start values of their own variables to `values`; returns their factors. `late`: they
        may be from frames before the newest one.
        """
        self.observations += seen
        if late:
            self.observations.sort(key=lambda s: s.frame)
        for s in seen:
            for key, start in s.start_values:
                values.insert(key, start)
        return [f for s in seen for f in s.factors]

    def hold(self, seen: Sequence[ObservationFactors], handles: Sequence[int]) -> None:
        """Store the engine's handles on the factors of `add`, in their order."""
        begin, count = 0, len(self._handles)
        for s in seen:
            end = begin + len(s.factors)
            self._handles.setdefault(s.number if self.map is None else s.frame, []).extend(handles[begin:end])
            begin = end
        if len(self._handles) != count:
            self._numbers = None

    def withdraw(self, which: Sequence[int]) -> list[int]:
        """Remove the observations of some landmarks, or from some frames of a known map; handles on their factors."""
        removed, self._numbers = set(which), None
        self.observations = [s for s in self.observations if (s.number if self.map is None else s.frame) not in removed]
        return [h for n in which for h in self._handles.pop(n, [])]
