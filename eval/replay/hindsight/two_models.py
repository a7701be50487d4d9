"""EKF-SLAM under two models of the odometry, as stated and with systematic errors: the one that predicts better counts.

Whether odometry errs in system (`ekf.systematic`) is not known beforehand. Where it does, taking it at its word closes
no loop; where it does not, five errors that may be there widen every gate, and loops are closed at wrong places. Both
filters get the same decisions, and the likelihood of their innovations is the evidence for each, as in a sequential
probability ratio test (Wald, "Sequential tests of statistical hypotheses", Annals of Mathematical Statistics 16, 1945).
"""

from __future__ import annotations

from data.inputs import FrameObservations, Increment, IntArray, Prior, Systematic
from data.result import Updated
from data.se2 import Array
from data.sensors import Sensor
from ekf.slam import EkfSlam

STRONG = 5.0
"""Logarithm of the odds that are very strong evidence, 150 to 1 (Kass and Raftery, "Bayes factors", Journal of the
American Statistical Association 90, 1995)."""
DECIDED = 14.0
"""Logarithm of the odds at which the less likely model is dropped: by Wald's inequality the right one is, in one log of
exp(DECIDED)."""


class TwoModels:
    """Both filters side by side, with the same numbers of landmarks, until the evidence leaves one.

    Attributes:
        log_odds: of systematic errors against odometry as stated, by the innovations so far.
    """

    def __init__(self, prior: Prior, sensor: Sensor, systematic: Systematic, *, doubted: bool = True) -> None:
        """Start at the prior with empty maps. `doubted`: whether there are errors is not known; else they are."""
        self._stated, self._erring = EkfSlam(prior, sensor), EkfSlam(prior, sensor, systematic=systematic)
        self._kept = [self._stated, self._erring] if doubted else [self._erring]
        self.log_odds = 0.0

    @property
    def believed(self) -> EkfSlam:
        """The filter with systematic errors, which odometry mostly has, until there is strong evidence against them."""
        return self._erring if self.errs else self._stated

    @property
    def errs(self) -> bool:
        """Whether odometry is believed to err in system."""
        return self.log_odds >= -STRONG

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        for each in self._kept:
            each.predict(increment)

    def update(self, observations: FrameObservations, decisions: IntArray, *, at: Array | None = None) -> Updated:
        """As `EkfSlam.update`; what the filter did that was believed before the frame."""
        before, done = self.believed, {each: each.update(observations, decisions, at=at) for each in self._kept}
        if len(done) > 1 and done[before].dof:
            self.log_odds += done[self._erring].log_likelihood - done[self._stated].log_likelihood
            if abs(self.log_odds) > DECIDED:
                self._kept = [self.believed]
        return done[before]

    def inflate(self, covariance: Array) -> None:
        """Believe the last motion so much less: add (3, 3) to the covariance of the pose."""
        for each in self._kept:
            each.inflate(covariance)

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Landmarks (j,) are one with others (j,)."""
        for each in self._kept:
            each.merge(merged, kept)

    def remove(self, numbers: IntArray) -> None:
        """Landmarks (r,) leave the map."""
        for each in self._kept:
            each.remove(numbers)
