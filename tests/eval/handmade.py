"""A log and runs made by hand, whose errors are known on paper: a robot on a circle among four landmarks."""

import numpy as np

from data.inputs import LandmarkMap
from data.log import Log
from data.result import NEW, Failure, MapEstimate, Run, Trajectory
from data.se2 import Array
from data.sensors import RangeBearing
from data.truth import Truth
from tests.builders.logs import along, inputs_of, observations_of

FRAMES = 40
SIGMA = np.array([0.1, 0.2, 0.05])
LANDMARKS = LandmarkMap(np.array([3, 4, 7, 9]), np.array([[6.0, 0.0], [0.0, 6.0], [-6.0, 0.0], [0.0, -6.0]]))


def true_path() -> Array:
    angle = np.linspace(0.0, 2.0 * np.pi, FRAMES)
    return np.stack([4.0 * np.cos(angle), 4.0 * np.sin(angle), np.arctan2(np.cos(angle), -np.sin(angle))], axis=-1)


def circle_log(*, truth: bool = True, landmarks: bool = True, known_map: bool = False, name: str = "circle") -> Log:
    """One observation of landmark 3 in each of the first four frames; time in steps of half a second."""
    path = true_path()
    sensor = RangeBearing(max_range=8.0)
    z = np.stack([sensor.predict(path[k], LANDMARKS.xy[:1])[0] for k in range(4)])
    inputs = inputs_of(
        along(path, np.diag([1e-4, 1e-4, 1e-6])), observations_of(np.arange(4), z), sensor,
        LANDMARKS if known_map else None, start=path[0], spread=np.diag(SIGMA**2), time=0.5 * np.arange(FRAMES),
    )  # fmt: skip
    known = Truth(path if truth else None, LANDMARKS if landmarks else None, np.full(4, 3))
    return Log(name, inputs, known)


def run_with_error(
    error: Array, *, estimator: str = "ekf", association: str = "known", task: str = "slam",
    phases: tuple[str, ...] = ("online",), mapped: bool = True, failure: Failure | None = None,
) -> Run:  # fmt: skip
    """A run that is off by `error` (3,) or (N, 3) at every frame and claims `SIGMA`; NaN from a failure's frame on."""
    pose = true_path() + error
    covariance = np.tile(np.diag(SIGMA**2), (FRAMES, 1, 1))
    if failure is not None:
        pose[failure.frame :], covariance[failure.frame :] = np.nan, np.nan
    path = Trajectory(pose, covariance)
    landmarks = None
    if mapped:
        landmarks = MapEstimate(
            np.array([0]), LANDMARKS.xy[:1] + 0.1, 0.04 * np.eye(2)[None], np.array([0]), np.array([4])
        )
    decisions = np.array([NEW, 0, 0, 0])
    return Run(
        estimator, association, task, path if "online" in phases else None, path if "final" in phases else None,
        landmarks, decisions, decisions, np.array([0, -1, -1, -1]), failure=failure,
    )  # fmt: skip
