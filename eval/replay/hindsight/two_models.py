"""EKF-SLAM under two odometry models, with and without systematic errors; the better predictor counts.

Whether odometry has systematic errors (`ekf.systematic`) is unknown beforehand. Without the errors in the state, no
loop is closed where they exist; with them, every gate is wider and wrong loops are closed where they do not. Both
filters get the same decisions. The likelihood ratio of their innovations is a sequential probability ratio test (Wald,
"Sequential tests of statistical hypotheses", Annals of Mathematical Statistics 16, 1945).
"""

from collections.abc import Callable
from typing import TypeVar

from data.inputs import FrameObservations, Increment, IntArray, Prior, Systematic
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated
from data.result import Updated
from data.se2 import Array
from data.sensors import Sensor
from ekf.slam import EkfSlam

Result = TypeVar("Result")
STRONG = 5.0
"""Log odds of very strong evidence, 150 to 1 (Kass and Raftery, "Bayes factors", Journal of the American Statistical
Association 90, 1995)."""
DECIDED = 14.0
"""Log odds at which the less likely model is dropped; it is the right one in one of exp(DECIDED) logs (Wald's
inequality)."""


class TwoModels:
    """Both filters with the same landmark numbers, until the evidence leaves one."""

    def __init__(self, prior: Prior, sensor: Sensor, systematic: Systematic, *, undecided: bool = True) -> None:
        """Start at the prior with empty maps. `undecided`: test whether there are errors; else they are assumed."""
        self._stated, self._erring = EkfSlam(prior, sensor), EkfSlam(prior, sensor, systematic=systematic)
        self._kept = [self._stated, self._erring] if undecided else [self._erring]
        self.log_odds = 0.0  # of systematic errors against odometry as stated, from the innovations so far

    @property
    def believed(self) -> EkfSlam:
        """The filter with systematic errors, unless there is strong evidence against them."""
        return self._erring if self.has_errors else self._stated

    @property
    def has_errors(self) -> bool:
        """Whether systematic odometry errors are assumed."""
        return self.log_odds >= -STRONG

    def each(self, step: Callable[[EkfSlam], Result]) -> Result:
        """Let all filters do a step; returns the result of the believed one."""
        done = {each: step(each) for each in self._kept}
        return done[self.believed]

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        self.each(lambda slam: slam.predict(increment))

    def update(self, observations: FrameObservations, decisions: IntArray, *, at: Array | None = None) -> Updated:
        """See `EkfSlam.update`; returns the result of the filter that was believed before the frame."""
        before, done = self.believed, {each: each.update(observations, decisions, at=at) for each in self._kept}
        if len(done) > 1 and done[before].dof:
            self.log_odds += done[self._erring].log_likelihood - done[self._stated].log_likelihood
            if abs(self.log_odds) > DECIDED:
                self._kept = [self.believed]
        return done[before]

    def keep(self, last_use: dict[int, int]) -> None:
        """See `Filter.keep`."""
        self.each(lambda slam: slam.keep(last_use))

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """See `Filter.fix`."""
        return self.each(lambda slam: slam.fix(fixes, sources, gate))

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """See `Filter.close_loops`."""
        return self.each(lambda slam: slam.close_loops(closures, gate))
