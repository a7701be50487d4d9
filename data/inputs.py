"""The estimator's view of a log: prior, increments, observations, sensor and (for localization) the map.

All arrays are float64 (ids int64), read-only, in SI units and radians. Nothing here contains ground truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from data.appearance import Appearance
from data.compiled import njit
from data.locked import IntArray as IntArray, Locked, read_only
from data.pose_measurements import Closures, Fixes
from data.se2 import Array, BoolArray, inverse
from data.sensors import EachSensor, Sensor

CLUTTER = -1  # Label or true id of a false alarm
UNLABELLED = -2  # Label of an observation whose label is blank, that is unknown


@dataclass(frozen=True, eq=False)
class Prior(Locked):
    """Gaussian belief about the first pose: mean (3,) in the world frame, covariance (3, 3), which may be zero."""

    mean: Array
    covariance: Array


class Increment(NamedTuple):
    """Motion from the previous frame, in its body frame: mean (3,), covariance (3, 3) of the additive error."""

    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Increments(Locked):
    """Motion into each frame, in the body frame of the one before: mean (N, 3), covariance (N, 3, 3); row 0 is zero."""

    mean: Array
    covariance: Array


class FrameObservations(NamedTuple):
    """Observations of one frame: z (m, 2) and R (m, 2, 2)."""

    z: Array
    R: Array


@dataclass(frozen=True, eq=False)
class Observations(Locked):
    """Unlabelled observations: frame (M,) ascending, z (M, 2), R (M, 2, 2).

    sensor: (M,) row in the sensors of a log with several, ascending within a frame; None: there is one.
    appearance: (M,) descriptors and classes; None: there are none.
    """

    frame: IntArray
    z: Array
    R: Array
    sensor: IntArray | None = field(default=None, kw_only=True)
    appearance: Appearance | None = field(default=None, kw_only=True)


@dataclass(frozen=True, eq=False)
class LabelledObservations(Observations):
    """Observations with labels (M,), only where the experiment grants known association. A label is a landmark id >= 0,
    `CLUTTER` or `UNLABELLED`. `sensed`: a sensor read it, so it may be wrong.
    """

    label: IntArray
    sensed: bool = False


ERRORS = {
    "scale": "1", "curvature": "rad/m", "left": "1", "right": "1", "drift": "rad/m", "range": "1", "bearing": "rad",
}  # fmt: skip
"""Systematic errors that can be estimated, and their units; `data.motion.systematic` defines them."""


@dataclass(frozen=True, eq=False)
class Systematic:
    """Systematic errors (p,) to estimate together with the state, a priori zero."""

    names: tuple[str, ...]  # keys of `ERRORS`, in their order
    sigma: Array  # prior standard deviations; of the drift, at any time
    length: float = 50.0  # m, distance over which the drift's correlation falls to 1/e; all others are constant

    def __post_init__(self) -> None:
        read_only(self)
        if not self.names or list(self.names) != [n for n in ERRORS if n in self.names]:
            raise ValueError(f"systematic errors {self.names}; some of {', '.join(ERRORS)}, in this order, are needed")
        if self.sigma.shape != (len(self.names),) or not (self.sigma > 0.0).all() or not self.length > 0.0:
            raise ValueError("each systematic error needs one sigma > 0, and the drift a length > 0")

    @property
    def drifts(self) -> bool:
        """Whether one of them is the drift."""
        return "drift" in self.names


class Frame(NamedTuple):
    """All that is known of one instant when it arrives, from a log or a live robot."""

    number: int  # of the frame, from 0
    time: float  # s (the number of the frame without stamps)
    increment: Increment | None  # motion from the frame before; None in the first frame
    observations: FrameObservations
    label: IntArray | None  # (m,) as in `LabelledObservations`, or None if not granted
    first: int  # number of earlier observations: observation i of this frame is number first + i of the log
    fixes: Fixes | None = None  # absolute measurements of its pose
    closures: Closures | None = None  # measured relative poses of which it is the later frame
    sensor: IntArray | None = None  # (m,) of each observation, as in `Observations`; None: the log has one
    appearance: Appearance | None = None  # (m,) as in `Observations`

    def part(self, rows: slice) -> Frame:
        """The same frame with some of its observations."""
        begin, stop, _ = rows.indices(len(self.observations.z))
        label = None if self.label is None else self.label[begin:stop]
        seen = FrameObservations(self.observations.z[begin:stop], self.observations.R[begin:stop])
        sensor = None if self.sensor is None else self.sensor[begin:stop]
        looks = None if self.appearance is None else self.appearance.only(slice(begin, stop))
        return self._replace(observations=seen, label=label, first=self.first + begin, sensor=sensor, appearance=looks)

    def by_sensor(self) -> list[Frame]:
        """The frame in parts of one sensor each; one part without several sensors."""
        if self.sensor is None or not len(self.sensor):
            return [self]
        edges = [0, *(np.flatnonzero(np.diff(self.sensor)) + 1).tolist(), len(self.sensor)]
        return [self.part(slice(a, b)) for a, b in pairwise(edges)]


@dataclass(frozen=True)
class Scanner:
    """A planar laser scanner: beam i points at angle_min + i * angle_step in its own frame."""

    angle_min: float  # rad
    angle_step: float  # rad
    max_range: float  # m; a longer range is no return
    sigma: float  # m, of a range
    rotation: float = 0.0  # rad, of p_scanner = R(rotation) p_body + translation
    translation: tuple[float, float] = (0.0, 0.0)  # m

    def mounted(self, *, clockwise: bool, turned: float) -> Scanner:
        """In the same place of the body, with its beams the other way round (`clockwise`), turned by an angle [rad]."""
        way = -1.0 if clockwise else 1.0
        on_body = inverse(np.array([*self.translation, self.rotation]))
        on_body[2] += turned
        tx, ty, rotation = inverse(on_body).tolist() if turned else (*self.translation, self.rotation)
        return replace(
            self, angle_min=way * self.angle_min, angle_step=way * self.angle_step, rotation=rotation,
            translation=(tx, ty),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scans(Locked):
    """Range scans: frame (S,) strictly ascending, ranges (S, B) [m], 0 for no return."""

    scanner: Scanner
    frame: IntArray
    ranges: Array

    def of(self, frame: int) -> Array | None:
        """The scan (B,) of a frame, or None."""
        row = int(np.searchsorted(self.frame, frame))
        return self.ranges[row] if row < len(self.frame) and self.frame[row] == frame else None


@njit
def row_of(ids: IntArray, number: int) -> int:
    """Row of a number in `ids` (L,), ascending; -1 where it has none."""
    row, end = 0, len(ids)
    while row < end:
        middle = (row + end) // 2
        if ids[middle] < number:
            row = middle + 1
        else:
            end = middle
    return row if row < len(ids) and ids[row] == number else -1


@dataclass(frozen=True, eq=False)
class LandmarkMap(Locked):
    """Known landmarks: id (L,) ascending and >= 0, xy (L, 2) in the world frame.

    kind: (L,) names of kinds, where not every sensor sees all (`Sensor.sees`); None: one kind.
    appearance: (L,) known descriptors and classes; None: they are learned.
    sigma: (L, 2) standard deviations [m] of x and y, independent of each other and of other landmarks, 0 where exact;
        None: all are exact.
    """

    id: IntArray
    xy: Array
    kind: tuple[str, ...] | None = None
    appearance: Appearance | None = None
    sigma: Array | None = None

    def __post_init__(self) -> None:
        if self.sigma is not None and not (self.sigma.shape == self.xy.shape and (self.sigma >= 0.0).all()):
            raise ValueError("sigma of landmarks: two numbers >= 0 for each are needed")
        read_only(self)

    @property
    def exact(self) -> LandmarkMap:
        """The same places without an error."""
        return replace(self, sigma=None)

    def rows(self, ids: IntArray) -> IntArray:
        """Row (m,) of each landmark id (m,), -1 where the map has none."""
        if not len(self.id):
            return np.full(len(ids), -1, np.int64)
        rows = np.minimum(np.searchsorted(self.id, ids), len(self.id) - 1)  # of the next id, if it is not there
        return np.where(self.id[rows] == ids, rows, -1)

    def positions(self, ids: IntArray) -> Array:
        """Positions (m, 2) by landmark id (m,), NaN where the map has none."""
        rows = self.rows(ids)
        xy = np.full((len(rows), 2), np.nan)
        xy[rows >= 0] = self.xy[rows[rows >= 0]]
        return xy


def not_estimable(systematic: Systematic | None, known: LandmarkMap | None, sensor: Sensor) -> str | None:
    """Why these errors, and those of a map's landmarks, cannot be estimated with a sensor; None: they can be."""
    if systematic is not None and {"range", "bearing"} & set(systematic.names) and not sensor.errors:
        return "errors of range and bearing need a sensor of points; with walls only odometry's errors can be estimated"
    beside_range = systematic is not None and "range" in systematic.names
    if known is not None and known.sigma is not None and (beside_range or not sensor.errors):
        return "an uncertain map needs a sensor of points, without a range error to estimate"
    return None


NEGLIGIBLE = 0.03
"""Largest effect of a map's errors on a NEES, a hundredth of a pose's, that is not worth the time: iSAM2 takes 1.4
times as long on UTIAS Dataset 9 robot 3, whose effect is 0.01, and no pose moves by a ten-thousandth of its sigma."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """The estimator's side of a log."""

    prior: Prior  # belief about the pose at frame 0
    time: Array  # (N,) s, strictly increasing (frame numbers if `time_is_index`)
    increments: Increments  # motion into each frame
    observations: Observations  # ascending by frame; `LabelledObservations` if labels were granted
    sensor: Sensor  # the measurement model
    map: LandmarkMap | None = None  # known landmarks, or None (SLAM)
    time_is_index: bool = False  # the log has no stamps
    covariance_floor: float = 1e-10  # smallest eigenvalue allowed in an increment's covariance
    floored: int = 0  # number of increments raised to the floor
    scans: Scans | None = None  # of a laser log
    systematic: Systematic | None = None  # systematic errors to estimate (None: none)
    fixes: Fixes | None = None  # absolute measurements of the pose, such as GPS (None: none)
    closures: Closures | None = None  # measured relative poses between frames (None: none)
    sensors: tuple[Sensor, ...] = ()  # of a log with several, of which `sensor` is the first; empty: there is one
    start: IntArray = field(init=False)  # (N + 1,) offsets; the observations of frame k are rows start[k]:start[k + 1]

    def __post_init__(self) -> None:
        starts = np.searchsorted(self.observations.frame, np.arange(len(self.time) + 1))
        object.__setattr__(self, "start", starts.astype(np.int64))
        read_only(self)

    def __len__(self) -> int:
        return len(self.time)

    def increment(self, frame: int) -> Increment:
        """Motion into a frame."""
        return Increment(self.increments.mean[frame], self.increments.covariance[frame])

    def frame_observations(self, frame: int) -> FrameObservations:
        """Observations of a frame."""
        rows = slice(self.start[frame], self.start[frame + 1])
        return FrameObservations(self.observations.z[rows], self.observations.R[rows])

    def frame(self, number: int) -> Frame:
        """Everything about one frame."""
        o, (first, end) = self.observations, self.start[number : number + 2].tolist()
        rows = slice(first, end)
        label = o.label[rows] if isinstance(o, LabelledObservations) else None
        increment = self.increment(number) if number else None
        fixes = None if self.fixes is None else self.fixes.of(number)
        closures = None if self.closures is None else self.closures.of(number)
        observations = FrameObservations(o.z[rows], o.R[rows])
        sensor = None if o.sensor is None else o.sensor[rows]
        looks = None if o.appearance is None else o.appearance.only(rows)
        time = float(self.time[number])
        return Frame(number, time, increment, observations, label, first, fixes, closures, sensor, looks)

    def sensor_of(self, rows: IntArray | slice | None = None) -> Sensor | EachSensor:
        """The sensor of observations, by rows of the log (None: all): one for all, or one for each row."""
        which = self.observations.sensor
        if which is None:
            return self.sensor
        return EachSensor(self.sensors, which if rows is None else which[rows])

    @property
    def looks(self) -> tuple[int, int]:
        """Numbers that a descriptor adds to an observation (0 or 1), and number of classes."""
        looks = self.observations.appearance
        return (0, 0) if looks is None else (int(looks.measures), len(looks.names))

    @property
    def labels_are_sensed(self) -> bool:
        """Whether granted labels come from a sensor, so that some may be wrong."""
        return isinstance(self.observations, LabelledObservations) and self.observations.sensed

    def sensor_at(self, row: int) -> Sensor:
        """The sensor of one observation."""
        which = self.observations.sensor
        return self.sensor if which is None else self.sensors[int(which[row])]

    def measured(self, rows: IntArray | None = None) -> BoolArray:
        """Which of the two numbers of observations are measured (m, 2), by rows of the log (None: all)."""
        every = np.array([[q in s.measures for q in (0, 1)] for s in self.sensors or (self.sensor,)])
        which = self.observations.sensor
        if which is None:
            which = np.zeros(len(self.observations.frame), np.int64)
        return np.asarray(every[which if rows is None else which[rows]])

    @property
    def map_effect(self) -> float:
        """Upper bound of what the map's errors would add to any NEES, on average, if estimators took it as exact.

        With errors d of covariance C, observations z = H x + L d + v of covariance R, and P the covariance of the
        estimate, ignoring d adds tr(C L' R^-1 H P H' R^-1 L) to the NEES of x. R^-1/2 H P H' R^-1/2 has no eigenvalue
        above 1, so this is at most tr(C L' R^-1 L): a sum over observations, here with the largest sigma of the map.
        It is infinite for bearings or ranges alone, which do not say how far away their landmarks are.
        """
        known, o = self.map, self.observations
        if known is None or known.sigma is None or not len(o.frame):
            return 0.0
        if not all(s.locates for s in self.sensors or (self.sensor,)):
            return math.inf
        sensor, origin = self.sensor_of(), np.zeros(3)
        L = sensor.jacobians(origin, sensor.inverse(origin, o.z)[0])[1]
        return float(known.sigma.max() ** 2 * np.sum(L * np.linalg.solve(o.R, L)))

    @property
    def map_is_uncertain(self) -> bool:
        """Whether there is a map whose errors matter to estimates."""
        return self.map_effect >= NEGLIGIBLE

    @property
    def several_or_partial(self) -> bool:
        """Whether the log has several sensors, or one that does not locate its landmarks."""
        return self.observations.sensor is not None or not self.sensor.locates

    @property
    def locates_points(self) -> bool:
        """Whether the log has one sensor, whose observations locate landmarks that are points."""
        return self.sensor.sees_points and not self.several_or_partial

    @property
    def known_points(self) -> LandmarkMap | None:
        """The map, if its landmarks are points."""
        return self.map if self.sensor.sees_points else None

    def without_map(self) -> Inputs:
        """The same inputs without the map, for SLAM."""
        return replace(self, map=None)

    def without_labels(self) -> Inputs:
        """The same inputs without labels, for unknown association."""
        o = self.observations
        return replace(self, observations=Observations(o.frame, o.z, o.R, sensor=o.sensor, appearance=o.appearance))

    def without_appearance(self) -> Inputs:
        """The same inputs without descriptors and classes."""
        if self.observations.appearance is None:
            return self
        known = None if self.map is None else replace(self.map, appearance=None)
        return replace(self, observations=replace(self.observations, appearance=None), map=known)
