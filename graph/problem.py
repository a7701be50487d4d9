"""A smoothing problem: a log as factors, under given decisions.

Landmarks of an uncertain map are variables, with their places in the map as priors. A landmark's error is the same in
all its observations, so one variable stands for it, however often it is observed. Landmarks without an error in an
uncertain map are held to a micrometre.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.errors import UsageError
from data.inputs import IntArray, LandmarkMap, Prior, Systematic, not_estimable
from data.se2 import Array
from data.sensors import Sensor, about
from graph.factors import EXACT, Factor, ObservationFactors, graph_of, noise, pose2, pose_array, prior_factor
from graph.pose_factors import PoseFactor
from graph.systematic import Motion


@dataclass(frozen=True)
class LandmarkPrior:
    """A landmark's place in the map, `row` there, as a factor on its variable."""

    number: int
    row: int
    xy: Array
    factor: Factor


def is_uncertain(known: LandmarkMap | None) -> bool:
    """Whether there is a map whose landmarks have errors."""
    return known is not None and known.sigma is not None


def landmark_priors(known: LandmarkMap | None, numbers: IntArray) -> list[LandmarkPrior]:
    """Priors of landmarks (k,) of an uncertain map, by id; none without one."""
    if known is None or known.sigma is None:
        return []
    found = []
    for number, row in zip(numbers.tolist(), known.rows(numbers).tolist(), strict=True):
        model = noise.Diagonal.Sigmas(np.maximum(known.sigma[row], EXACT))
        xy = known.xy[row]
        found.append(LandmarkPrior(number, row, xy, gtsam.PriorFactorPoint2(L(number), xy, model)))
    return found


def refuse(systematic: Systematic | None, known: LandmarkMap | None, sensor: Sensor) -> None:
    """Raise UsageError for what cannot be estimated with a sensor."""
    if why := not_estimable(systematic, known, sensor):
        raise UsageError(why)


class Start(NamedTuple):
    """An estimate, of the robot in the world."""

    pose: Array  # (N, 3)
    landmark: Array  # (L, 2) points or walls, row = landmark number, or that of an uncertain map
    errors: Array | None = None  # (N, p) systematic errors by frame, where some are estimated; None: zero


@dataclass(frozen=True)
class Problem:
    """A log as factors; observations, and the motion's errors, are in the sensor's frame."""

    prior: Prior  # on the robot's pose of frame 0
    motion: Motion  # with the systematic errors to estimate
    observations: Sequence[ObservationFactors]  # the observations in use, ascending by frame
    known_map: bool  # the landmarks are known exactly, so that none is estimated
    about: Array | None = None  # (2,) where the landmarks are walls: origin of their distances in the graph
    pose_factors: Sequence[PoseFactor] = ()  # fixes and closures, in the world
    priors: Sequence[LandmarkPrior] = ()  # of an uncertain map, one for each of its landmarks in use, ascending

    def graph(self) -> gtsam.NonlinearFactorGraph:
        """The whole problem as a gtsam graph; systematic errors as zero."""
        seen = (f for s in self.observations for f in s.factors)
        motion = self.motion.factors()
        return graph_of([prior_factor(self.prior), *motion, *seen, *self.of_poses, *(p.factor for p in self.priors)])

    @property
    def of_poses(self) -> list[Factor]:
        """The factors of the fixes and closures in use."""
        return [p.factor for p in self.pose_factors if p.used]

    @property
    def numbers(self) -> IntArray:
        """Landmarks that are estimated, ascending."""
        return np.unique([s.number for s in self.observations if not self.known_map]).astype(np.int64)

    @property
    def rows(self) -> IntArray:
        """Rows (L,) of these landmarks in a start: their numbers, or rows of an uncertain map."""
        return np.array([p.row for p in self.priors], np.int64) if self.priors else self.numbers

    @property
    def dof(self) -> int:
        """Degrees of freedom of the chi-square: what is measured, minus two for each landmark without a prior, and
        those of fixes and closures. A systematic error does not count: it has a residual of its own, that of its prior.
        """
        own = sum(s.dims for s in self.observations) - 2 * len(self.numbers) + 2 * len(self.priors)
        return own + sum(f.dim() for f in self.of_poses)

    def values(self, start: Start) -> gtsam.Values:
        """A start as values; raises ValueError if a variable has none, or none that is finite."""
        size, motion = len(self.motion.increments.mean), self.motion
        rows, xy = self.rows, start.landmark
        missing = [r for r in rows.tolist() if r >= len(xy) or not np.isfinite(xy[r]).all()]
        if missing or start.pose.shape != (size, 3) or not np.isfinite(start.pose).all():
            number = self.numbers[rows == missing[0]][0] if missing else 0
            what = f"no position for landmark {number}" if missing else "not a finite pose for every frame"
            raise ValueError(f"start: {what}")
        errors = np.zeros((size, len(motion.names))) if start.errors is None else start.errors
        values = gtsam.Values()
        motion.insert(values, errors)
        for k, pose in enumerate(motion.frame.poses_in(start.pose, errors)):
            values.insert(X(k), pose2(pose))
        keys = [L(n) for n in self.numbers.tolist()]
        places = [*xy[rows]] if self.about is None else [*about(xy[rows], self.about)]
        known = {s.key: s.xy for s in self.observations if s.xy is not None and s.key is not None}
        for key, at in zip([*keys, *known], [*places, *known.values()], strict=True):
            there = motion.frame.points_in(at[None], errors[-1])[0][0] if motion.frame.range_at >= 0 else at
            values.insert(key, there)
        return values

    def start_of(self, values: gtsam.Values, others: Array) -> Start:
        """Values as a start; landmarks that are not in the problem as in `others` (L, 2)."""
        frame, errors = self.motion.frame, self.motion.errors(values)
        pose = np.array([pose_array(values.atPose2(X(k))) for k in range(len(errors))])
        landmark, xy = others.copy(), np.array([values.atPoint2(L(n)) for n in self.numbers.tolist()]).reshape(-1, 2)
        xy = frame.points_out(xy, errors[-1])[0] if self.about is None else about(xy, -self.about)
        landmark[self.rows] = xy
        return Start(frame.poses_out(pose, errors)[0], landmark, errors)

    def loosened(self, share: float) -> "Problem":
        """The same with increments whose positions are no better than to a `share` of the worst sigma."""
        covariance = self.motion.increments.covariance.copy()
        covariance[:, :2, :2] += share**2 * np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1][:, None, None] * np.eye(2)
        increments = replace(self.motion.increments, covariance=covariance)
        return replace(self, motion=replace(self.motion, increments=increments))
