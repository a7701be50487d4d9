"""A smoothing problem: a log as factors, under given decisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import IntArray, Prior
from data.se2 import Array
from graph.factors import Sighted, graph_of, noise, pose2, prior_factor, root_information


@dataclass(frozen=True)
class Problem:
    """A log as factors.

    Attributes:
        prior: on the pose of frame 0.
        motion: [k - 1] leads into frame k.
        sighted: the observations in use, ascending by frame.
        known_map: the landmarks are known, so that none is estimated.
    """

    prior: Prior
    motion: Sequence[gtsam.BetweenFactorPose2]
    sighted: Sequence[Sighted]
    known_map: bool

    def graph(self) -> gtsam.NonlinearFactorGraph:
        """Everything, as gtsam takes it."""
        return graph_of([prior_factor(self.prior), *self.motion, *(f for s in self.sighted for f in s.factors)])

    @property
    def numbers(self) -> IntArray:
        """Landmarks that are estimated, ascending."""
        return np.unique([s.number for s in self.sighted if not self.known_map]).astype(np.int64)

    @property
    def dof(self) -> int:
        """Degrees of freedom of the chi-square: two for each observation, less two for each landmark."""
        return 2 * len(self.sighted) - 2 * len(self.numbers)

    def values(self, pose: Array, landmark: dict[int, Array]) -> gtsam.Values:
        """Start values from poses (N, 3) and landmark positions (2,) by number."""
        values = gtsam.Values()
        for k, row in enumerate(pose):
            values.insert(X(k), pose2(row))
        for n in self.numbers.tolist():
            values.insert(L(n), landmark[n])
        for s in self.sighted:
            if s.xy is not None and s.key is not None:
                values.insert(s.key, s.xy)
        return values

    def loosened(self, share: float) -> Problem:
        """The same with increments known nowhere better than to a `share` of the sigma of their worst direction."""
        root = np.array([_gaussian(f).R() for f in self.motion])
        inverse = np.linalg.inv(root)
        covariance = inverse @ inverse.transpose(0, 2, 1)
        worst = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
        covariance[:, :2, :2] += share**2 * worst[:, None, None] * np.eye(2)
        roots, _ = root_information(covariance)
        motion = [
            gtsam.BetweenFactorPose2(X(k), X(k + 1), f.measured(), noise.Gaussian.SqrtInformation(R))
            for k, (f, R) in enumerate(zip(self.motion, roots, strict=True))
        ]
        return replace(self, motion=motion)


def _gaussian(factor: gtsam.NoiseModelFactor) -> gtsam.noiseModel.Gaussian:
    model = factor.noiseModel()
    assert isinstance(model, gtsam.noiseModel.Gaussian)
    return model
