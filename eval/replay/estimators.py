"""Step-by-step estimators: their common methods, their capabilities, and a factory by name."""

import time
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Protocol, TypeVar, cast

import numpy as np

from association.expectation import Expectation
from data.errors import UsageError, did_you_mean
from data.inputs import FrameObservations, Increment, Inputs, IntArray
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated
from data.result import DISCARD, Finished, MapState, PoseEstimate, Run, Trajectory, Updated
from data.se2 import Array
from data.sensors import Sensor
from ekf.filter import FilterOptions, lack
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from ekf.whole_run import run_filter
from eval.replay.external.adapter import CannotError, call, estimator as foreign_estimator
from eval.replay.external.spec import is_foreign
from eval.replay.settings import ESTIMATOR_TABLE, FILTERS, HINDSIGHT, INCREMENTAL, STEPPING, Given, Setup

OPTIONS = {name: FilterOptions(**ESTIMATOR_TABLE[name].options) for name in FILTERS}
"""Filters by name: one filter with different corrections."""


class Estimator(Protocol):
    """Methods of every step-by-step estimator; any association method works with any of them. All others (`Able`) are
    optional: a front end asks for them once, before the first frame.
    """

    @property
    def smooths(self) -> bool:
        """Whether it revises its past, as a smoother does."""

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""

    def expect(self, observations: FrameObservations) -> Expectation:
        """Expected observations."""

    def update(
        self, observations: FrameObservations, decisions: IntArray, *, threshold: float = np.inf,
        at: Array | None = None, innovations: bool = False,
    ) -> Updated:  # fmt: skip
        """Use the pairings below `threshold`, initialize new landmarks. `at` (3,): first linearization point, if not
        the prediction, for estimators that support it; `innovations`: form them even at extra cost.
        """

    def estimate(self) -> PoseEstimate:
        """The newest pose."""

    def landmarks(self) -> MapState:
        """The current map; a given one without covariance."""

    def finish(self) -> Finished:
        """End the run."""


class Fixable(Protocol):
    """It can use absolute measurements of the pose."""

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """Update with those inside the gate (a chi-square probability, None: all), one after another. Called between
        `predict` (with `stamp`) and `expect`, before the closures.
        """


class Closable(Protocol):
    """It can use measured relative poses of two frames; frames count from 0, and each `predict` begins one."""

    def keep(self, last_use: dict[int, int]) -> None:
        """Before the first frame: the frames that later closures name, each with the frame of its last use."""

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """Update with those inside the gate, one after another; not used: those of a frame that is no longer known."""


class Able(Estimator, Fixable, Closable, Protocol):
    """What an estimator may have besides the methods of every one."""

    @property
    def size(self) -> int:
        """Length of a state that every frame updates as a whole."""

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """The current systematic errors (p,) and their covariance (p, p); None: none are estimated."""

    def stamp(self, time: float) -> None:
        """The present frame's time [s], to keep poses for a span of time."""

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of landmarks in the map but not in the state, ascending."""

    def parked_xy(self) -> Array:
        """Positions (b, 2) of the parked landmarks, ordered as `parked`."""

    def park(self, numbers: IntArray) -> None:
        """Move landmarks out of the state; they stay in the map."""

    def restore(self, numbers: IntArray) -> None:
        """Move parked landmarks into the state."""

    def remove(self, numbers: IntArray) -> None:
        """SLAM: drop landmarks from the map."""

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """SLAM: merge landmarks `merged` into `kept`."""

    def amend(self, frames: IntArray, observations: FrameObservations, decisions: IntArray) -> None:
        """Change the landmarks (m,) of what frames (m,) saw (m), negative: none; of a smoother. In SLAM this is called
        once, for all observations, after the last frame and before `finish`.
        """

    def inflate(self, covariance: Array) -> None:
        """Add a covariance (3, 3), equal in all directions, to the last motion."""

    def reset(self, mean: Array, covariance: Array) -> None:
        """Localization: restart at a pose (3,) with covariance (3, 3)."""

    def look(self, sensor: Sensor) -> None:
        """Expect and use observations of this sensor, one of several, from now on."""

    def hold(self, frame: int) -> None:
        """SLAM: keep the present frame's pose for `initialize`, until `release`."""

    def release(self, frame: int) -> None:
        """Keep it no longer."""

    def held(self, frames: IntArray) -> tuple[Array, Array]:
        """Poses (n, 3) of frames that are kept, or the present one, and their joint covariance (3n, 3n)."""

    def initialize(
        self, frames: IntArray, sensors: Sequence[Sensor], observations: FrameObservations, xy: Array
    ) -> tuple[int, float, int, float]:
        """A landmark near xy (2,) from all its observations (m): its number; NIS, dof and log-likelihood, or NaN."""


OPTIONAL: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("stamp", "size", "errors", "remove", "amend", "inflate", "reset", "look", "fix"), ()),
    "park": ("restore", "parked", "parked_xy"),
    "merge": ("remove",),
    "initialize": ("hold", "release", "held"),
    "close_loops": ("keep",),
}  # capabilities by their principal methods, each with those that it needs besides


def capabilities(estimator: Estimator) -> dict[str, Able]:
    """The capabilities (`OPTIONAL`) of an estimator, each with the estimator itself."""
    inner, who = getattr(estimator, "inner", estimator), f"{getattr(estimator, 'name', '')}()"
    able = cast(Able, estimator)  # the check may run foreign code
    return {v: able for v, also in OPTIONAL.items() if all(call(who, hasattr, inner, each) for each in (v, *also))}


C = TypeVar("C")


def needed(capability: C | None, verbs: str, why: str) -> C:
    """A required capability. Raises CannotError where it is lacking."""
    if capability is None:
        raise CannotError(f"the estimator has no {verbs}, which {why} needs")
    return capability


def make_estimator(
    name: str, given: Given, options: FilterOptions | None = None, *, lag: float = Setup.lag
) -> Estimator:
    """Make a step-by-step estimator, for localization if a map is given, else for SLAM.

    Args:
        name: `ekf`, `isam2`, ..., or the text `FILE.py:NAME` of a foreign one.
        given: prior, sensor and map, for instance `Inputs`.
        options: of a filter, instead of those of its name.
        lag: of `fixed-lag` [s], in frames for logs without stamps.

    Returns:
        An estimator with `predict`, `expect`, `update`, `estimate`, `landmarks` and `finish` (`Estimator`).

    Raises:
        UsageError: the name works on whole logs only (batch), or is unknown.

    Example:
        >>> ekf = slamref.make_estimator("ekf", log.inputs(labels=False).without_map())
        >>> ekf.estimate().covariance.shape  # (3, 3)
    """
    if is_foreign(name):
        return foreign_estimator(name, given, options)
    if name in OPTIONS:
        options = options or OPTIONS[name]
        if given.map is not None:
            return EkfLocalizer(given.prior, given.sensor, given.map, options, systematic=given.systematic)
        return EkfSlam(given.prior, given.sensor, options, systematic=given.systematic)
    if name in INCREMENTAL:
        module, _, made = ESTIMATOR_TABLE[name].options["class"].rpartition(".")
        more = {"lag": lag} if ESTIMATOR_TABLE[name].options.get("lag") else {}
        make = getattr(import_module(module), made)
        smoother: Estimator = make(given.prior, given.sensor, given.map, systematic=given.systematic, **more)
        return smoother
    names = f"{', '.join(STEPPING[:-1])} and {STEPPING[-1]} do"
    raise UsageError(f"{name!r} does not work step by step{did_you_mean(name, STEPPING)}; {names}")


FOR_WALLS = "jcbb"  # default association method for walls without labels
NO_HINDSIGHT_OF_WALLS = f"{HINDSIGHT} knows landmarks as points, walls can be paired by {FOR_WALLS}"
FOR_SEVERAL = "jcbb"  # default for several sensors, or one of bearings or ranges alone, without labels
NO_HINDSIGHT_OF_SEVERAL = (
    f"{HINDSIGHT} knows one sensor that locates its landmarks; with several, or with bearings or ranges alone, "
    f"observations can be paired by {FOR_SEVERAL}"
)
NO_NEW_LANDMARKS = (
    "a bearing or a range alone does not locate a new landmark, so in SLAM its observations need labels; "
    "use --association known"
)


NO_RANGE_ERROR = (
    "a range error and the landmarks of an uncertain map are not estimated together: leave range out of --calibrate, "
    "or the sigmas out of the map"
)


def lack_with_sensor(
    name: str, task: str, association: str, given: Given, options: FilterOptions | None = None
) -> str | None:
    """Why an estimator cannot use these sensors or their map, or None; `options` replace those of a filter's name."""
    sensors = given.sensors or (given.sensor,)
    if association == HINDSIGHT and (len(sensors) > 1 or not given.sensor.locates):
        return NO_HINDSIGHT_OF_SEVERAL
    if task == "slam" and association != "known" and not all(s.locates for s in sensors):
        return NO_NEW_LANDMARKS
    uncertain = task == "localization" and given.map is not None and given.map.sigma is not None
    if uncertain and given.systematic is not None and "range" in given.systematic.names:
        return NO_RANGE_ERROR
    if given.sensor.sees_points:
        return None
    if association == HINDSIGHT:
        return NO_HINDSIGHT_OF_WALLS
    own = options or OPTIONS.get(name)
    return None if own is None else lack(own, given.sensor, given.systematic, slam=task == "slam")


def dead_reckoning(inputs: Inputs, task: str) -> Run:
    """Prediction alone: the path composed from the increments."""
    begin = time.perf_counter()
    nothing = np.full(len(inputs.observations.frame), DISCARD, np.int64)
    run = run_filter(inputs if inputs.systematic is None else replace(inputs, systematic=None), nothing)
    return Run(
        "dead-reckoning", "none", task, Trajectory(run.pose, run.covariance), None, None, nothing, nothing,
        np.full(len(nothing), -1, np.int64), state_size=run.state_size, seconds=time.perf_counter() - begin,
    )  # fmt: skip
