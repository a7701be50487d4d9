"""Motion priors: increments stated before the run, for a robot without odometry.

A prior gives every frame an increment with a wide covariance, independent of the run's data, so filter and smoother get
the same numbers. The wider it is, the worse the first linearization of a frame: estimators that linearize once at the
prediction fail where iterating ones work.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from data.errors import UsageError
from data.inputs import Increments
from data.motion.velocity import ARC, step
from data.se2 import Array


class _Stated:
    """Checked numbers of a prior."""

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if not math.isfinite(value) or ("sigma" in f.name and value < 0.0):
                kind = "a number from 0 up" if "sigma" in f.name else "a finite number"
                raise UsageError(f"motion prior: {f.name} = {value!r}; {kind} is needed")


@dataclass(frozen=True)
class ForwardPrior(_Stated):
    """The robot goes forward by about a step per frame, or turns.

    Step, sideways motion and turn are independent; turns to both sides are equally likely. A step of 0.5 +- 0.4 m
    covers moves of 1 m and turns in place, and excludes a metre backwards (3.75 sigma).
    """

    step_mean: float  # step_mean, step_sigma: m, along the heading of the frame before
    step_sigma: float
    lateral_sigma: float  # m, across it
    turn_sigma: float  # rad

    def increments(self, time: Array) -> Increments:
        """Increments of frames at `time` (N,); row 0 is zero."""
        sigma = np.array([self.step_sigma, self.lateral_sigma, self.turn_sigma])
        mean, covariance = np.zeros((len(time), 3)), np.zeros((len(time), 3, 3))
        mean[1:, 0], covariance[1:] = self.step_mean, np.diag(sigma**2)
        return Increments(mean, covariance)


@dataclass(frozen=True)
class ConstantVelocityPrior(_Stated):
    """The robot keeps a stated velocity, with an independent error in every interval.

    The mean is the arc of `velocity` and `turn_rate` between two frames; all sigmas grow in proportion to the time (in
    frames, without stamps). The velocity is stated, not estimated: as an estimate it would be a state that ties three
    poses together, and increments would differ between estimators.
    """

    velocity: float  # velocity, velocity_sigma: m/s, along the heading
    velocity_sigma: float
    lateral_sigma: float  # m/s, across it
    turn_rate: float  # turn_rate, turn_rate_sigma: rad/s
    turn_rate_sigma: float

    def increments(self, time: Array) -> Increments:
        """Increments of frames at `time` (N,) s; row 0 is zero."""
        mean, covariance = np.zeros((len(time), 3)), np.zeros((len(time), 3, 3))
        G = np.empty((3, 2))
        variance = np.diag([self.velocity_sigma**2, self.turn_rate_sigma**2])
        for k, dt in enumerate(np.diff(time).tolist(), 1):
            step(ARC, self.velocity * dt, self.turn_rate * dt, mean[k], G)
            middle = 0.5 * self.turn_rate * dt
            across = dt * np.array([-math.sin(middle), math.cos(middle), 0.0])
            covariance[k] = dt**2 * (G @ variance @ G.T) + self.lateral_sigma**2 * np.outer(across, across)
        return Increments(mean, covariance)


MotionPrior = ForwardPrior | ConstantVelocityPrior
PRIORS: Mapping[str, type[MotionPrior]] = {"forward": ForwardPrior, "constant_velocity": ConstantVelocityPrior}
"""Priors by their names in logs."""


def note_of(prior: MotionPrior) -> str:
    """The note of a log with this prior."""
    name = next(n for n, kind in PRIORS.items() if isinstance(prior, kind))
    stated = ", ".join(f"{f.name} = {getattr(prior, f.name):.4g}" for f in fields(prior))
    return f"No odometry: every increment is the motion prior `{name}` ({stated})."
