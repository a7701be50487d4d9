"""A smoothing problem: a log as factors, under given decisions.

Landmarks of an uncertain map are variables, with their places in the map as priors. A landmark's error is the same in
all its observations, so one variable stands for it, however often it is observed. Landmarks without an error in an
uncertain map are held to a micrometre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.errors import UsageError
from data.inputs import IntArray, LandmarkMap, Prior, Systematic, not_estimable
from data.se2 import Array
from data.sensors import Sensor
from graph.factors import EXACT, Factor, ObservationFactors, graph_of, noise, pose2, prior_factor, root_information
from graph.pose_factors import PoseFactor
from graph.systematic import Calibrated
from graph.walls import about


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


@dataclass(frozen=True)
class Problem:
    """A log as factors; with systematic errors all of it in their frame, `motion` without errors."""

    prior: Prior  # on the robot's pose of frame 0
    motion: Sequence[gtsam.BetweenFactorPose2]  # [k - 1] leads into frame k
    observations: Sequence[ObservationFactors]  # the observations in use, ascending by frame
    known_map: bool  # the landmarks are known exactly, so that none is estimated
    calibrated: Calibrated | None = None  # systematic errors to estimate
    about: Array | None = None  # (2,) where the landmarks are walls: origin of their distances in the graph
    pose_factors: Sequence[PoseFactor] = ()  # fixes and closures; with systematic errors in the world
    priors: Sequence[LandmarkPrior] = ()  # of an uncertain map, one for each of its landmarks in use, ascending

    def graph(self) -> gtsam.NonlinearFactorGraph:
        """The whole problem as a gtsam graph; systematic errors as zero."""
        seen = (f for s in self.observations for f in s.factors)
        return graph_of(
            [prior_factor(self.prior), *self.motion, *seen, *self.of_poses, *(p.factor for p in self.priors)]
        )

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

    def values(self, pose: Array, landmark: dict[int, Array], errors: Array | None = None) -> gtsam.Values:
        """Start values from poses (N, 3) and landmarks (2,) by number, of the robot in the world. `errors` (N, p):
        start of systematic errors; without, zero.
        """
        values = gtsam.Values()
        known = {s.key: s.xy for s in self.observations if s.xy is not None and s.key is not None}
        if self.calibrated is not None:
            if errors is None:
                errors = np.zeros((len(pose), len(self.calibrated.place)))
            frame = self.calibrated.frame
            pose = frame.poses_in(pose, errors)
            landmark = {n: frame.points_in(xy[None], errors[-1])[0][0] for n, xy in landmark.items()}
            known = {key: frame.points_in(xy[None], errors[-1])[0][0] for key, xy in known.items()}
            self.calibrated.insert(values, errors)
        if self.about is not None:
            landmark = {n: about(line, self.about)[0] for n, line in landmark.items()}
        for k, row in enumerate(pose):
            values.insert(X(k), pose2(row))
        for n in self.numbers.tolist():
            values.insert(L(n), landmark[n])
        for key, xy in known.items():
            values.insert(key, xy)
        return values

    def loosened(self, share: float) -> Problem:
        """The same with increments whose sigmas are at least a `share` of their worst direction's."""
        if self.calibrated is not None:
            covariance = _loosened(self.calibrated.increments.covariance, share)
            calibrated = replace(self.calibrated, increments=replace(self.calibrated.increments, covariance=covariance))
            return replace(self, motion=calibrated.motion(), calibrated=calibrated)
        root = np.array([_gaussian(f).R() for f in self.motion])
        inverse = np.linalg.inv(root)
        roots, _ = root_information(_loosened(inverse @ inverse.transpose(0, 2, 1), share))
        motion = [
            gtsam.BetweenFactorPose2(X(k), X(k + 1), f.measured(), noise.Gaussian.SqrtInformation(R))
            for k, (f, R) in enumerate(zip(self.motion, roots, strict=True))
        ]
        return replace(self, motion=motion)

    def held(self, errors: Array) -> Problem:
        """The same in its frame with the systematic errors fixed at `errors` (N, p)."""
        c = self.calibrated
        assert c is not None
        there = c.frame.poses_in(self.prior.mean[None], errors[:1])
        back = np.linalg.inv(c.frame.poses_out(there, errors[:1])[1][0, :, :3])
        prior = Prior(there[0], back @ self.prior.covariance @ back.T)
        observations = self.observations
        if self.known_map and c.frame.range_at >= 0:
            xy = c.frame.points_in(np.array([s.xy for s in observations]).reshape(-1, 2), errors[-1])[0]
            observations = [displaced(s, at) for s, at in zip(observations, xy, strict=True)]
        motion = c.motion(errors)
        return replace(self, prior=prior, motion=motion, observations=observations, calibrated=None)


def displaced(observations: ObservationFactors, xy: Array) -> ObservationFactors:
    """An observation of a known landmark moved to xy (2,)."""
    if observations.key is not None:
        return replace(observations, xy=xy, pin=gtsam.PriorFactorPoint2(observations.key, xy, noise.Constrained.All(2)))
    (factor,) = observations.measured
    assert isinstance(factor, gtsam.KnownLandmarkFactorPose2)
    assert observations.xy is not None
    point = observations.xy - factor.evaluateError(gtsam.Pose2())
    moved = gtsam.KnownLandmarkFactorPose2(X(observations.frame), xy, point, factor.noiseModel())
    return replace(observations, xy=xy, measured=[moved])


def _loosened(covariance: Array, share: float) -> Array:
    """Covariances (n, 3, 3) of increments, their positions no better than to a `share` of the worst sigma."""
    covariance = covariance.copy()
    worst = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    covariance[:, :2, :2] += share**2 * worst[:, None, None] * np.eye(2)
    return covariance


def _gaussian(factor: gtsam.NoiseModelFactor) -> gtsam.noiseModel.Gaussian:
    model = factor.noiseModel()
    assert isinstance(model, gtsam.noiseModel.Gaussian)
    return model
