"""Deliberately broken EKFs, to test whether a log's own data detect them.

The log is right, and labels are granted. At the size without fault each is the sound filter, bit for bit. Misstated
noise runs in the compiled loop; a wrong step overrides the step-by-step filter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from data.errors import UsageError
from data.inputs import FrameObservations, Increment, Increments, Inputs, IntArray
from data.motion.velocity import carried
from data.result import Run, Trajectory, Updated
from ekf.filter import Filter
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from eval.replay.frontend import FrontEnd
from eval.replay.run import PLAIN, driven, filter_known


@dataclass(frozen=True)
class Broken:
    """A broken filter."""

    run: Callable[[Inputs, str, float], Run]  # (inputs with labels, task, size) -> run
    sizes: tuple[float, float, float]  # three, from small to large
    none: float  # the size without fault
    called: str  # its fault in words
    tasks: tuple[str, ...] = ("localization", "slam")  # in which it exists


def motion_noise(inputs: Inputs, task: str, size: float) -> Run:
    """EKF with its process noise scaled by `size`."""
    given, u = for_task(inputs, task), inputs.increments
    return filter_known(replace(given, increments=Increments(u.mean, size * u.covariance)), task)


def measurement_noise(inputs: Inputs, task: str, size: float) -> Run:
    """EKF with its measurement noise scaled by `size`."""
    given, o = for_task(inputs, task), inputs.observations
    return filter_known(replace(given, observations=replace(o, R=size * o.R)), task)


def reported(inputs: Inputs, task: str, size: float) -> Run:
    """EKF that reports its covariances of poses and map scaled by `size`."""
    run = filter_known(for_task(inputs, task), task)
    assert run.online is not None  # a filter's path is online
    online = Trajectory(run.online.pose, size * run.online.covariance)
    state = None if run.map is None else replace(run.map, covariance=size * run.map.covariance)
    return replace(run, online=online, map=state)


def cross_covariance(inputs: Inputs, task: str, size: float) -> Run:
    """SLAM: a new landmark's cross-covariances lose the share `size`."""
    if task != "slam":
        raise UsageError("cross-covariances of new landmarks are lost in slam only")
    given = for_task(inputs, task)
    return stepped(given, task, Forgetful(size, given))


def heading_jacobian(inputs: Inputs, task: str, size: float) -> Run:
    """The prediction's Jacobian with respect to the heading lacks the share `size`."""
    given = for_task(inputs, task)
    if given.map is None:
        return stepped(given, task, TurnlessSlam(size, given))
    return stepped(given, task, TurnlessLocalizer(size, given))


BROKEN: Mapping[str, Broken] = {
    "motion-noise": Broken(motion_noise, (0.5, 0.25, 0.1), 1.0, "assumes too little odometry noise"),
    "reading-noise": Broken(measurement_noise, (0.5, 0.25, 0.1), 1.0, "assumes too little measurement noise"),
    "reported": Broken(reported, (0.8, 0.5, 0.25), 1.0, "reports too small a covariance"),
    "cross-covariance": Broken(
        cross_covariance, (0.3, 0.6, 1.0), 0.0, "loses cross-covariances of new landmarks", ("slam",)
    ),
    "heading-jacobian": Broken(
        heading_jacobian, (0.3, 0.6, 1.0), 0.0, "omits the heading in the Jacobian of the motion"
    ),
}
"""Broken filters by name. Sizes of the first three are factors of a covariance, of the others lost shares."""


class Forgetful(EkfSlam):
    """Loses a share of the cross-covariance of new landmarks."""

    def __init__(self, share: float, given: Inputs) -> None:
        super().__init__(given.prior, given.sensor)
        self._share = share

    def update(self, observations: FrameObservations, decisions: IntArray, **options: Any) -> Updated:
        """Update, then shrink the blocks beside those of the new landmarks: (1 - s) P + s diag(P) is a covariance."""
        begin = self.size
        done = super().update(observations, decisions, **options)
        for new in range(begin, self.size, 2):
            self._P[new : new + 2, :new] *= 1.0 - self._share
            self._P[:new, new : new + 2] *= 1.0 - self._share
        return done


class _Turnless(Filter):
    """Predicts with F whose heading column lacks a share.

    F = I + f e' with e the unit vector of the heading, and e'f = 0. So I + (1 - s) f e' = F (I - s f e'): the
    covariance is sheared back by s, then predicted as usual.
    """

    share = 0.0

    def predict(self, increment: Increment) -> None:
        """Shear back, then predict."""
        _, _, F, _ = carried(self._mean[2], increment.mean)
        P = self._P[: self._used, : self._used]
        for r in range(2):
            P[r] -= self.share * F[r, 2] * P[2]
        for r in range(2):
            P[:, r] -= self.share * F[r, 2] * P[:, 2]
        super().predict(increment)


class TurnlessLocalizer(_Turnless, EkfLocalizer):
    """Localization with a reduced heading column."""

    def __init__(self, share: float, given: Inputs) -> None:
        assert given.map is not None  # localization
        EkfLocalizer.__init__(self, given.prior, given.sensor, given.map)
        self.share = share


class TurnlessSlam(_Turnless, EkfSlam):
    """SLAM with a reduced heading column."""

    def __init__(self, share: float, given: Inputs) -> None:
        EkfSlam.__init__(self, given.prior, given.sensor)
        self.share = share


def for_task(inputs: Inputs, task: str) -> Inputs:
    """The inputs, in SLAM without the map."""
    return inputs.without_map() if task == "slam" else inputs


def stepped(inputs: Inputs, task: str, estimator: EkfLocalizer | EkfSlam) -> Run:
    """Run a filter through a whole log, step by step, by labels."""
    front = FrontEnd("ekf", "known", inputs, PLAIN)
    front.use(estimator)
    front.parking = None  # it would park landmarks of the other estimator
    return driven("ekf", front, inputs, task)
