"""Small worlds for the smoothers' tests: a robot circles among landmarks, with any sensor, noise on or off; and drives
through them: frame by frame, with a lag, all at once.
"""

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.inputs import Increments, Inputs, LabelledObservations, LandmarkMap, Prior
from data.log import Log, shortened
from data.result import NEW
from data.sensors import RangeBearing, RelativePoint
from data.truth import Truth
from ekf.whole_run import run_filter
from graph.batch import smooth
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from graph.problem import Start
from tests.builders import estimators

OFF_CENTRE = {"rotation": 0.6, "translation": (0.3, -0.2)}
SENSORS = {
    "range-bearing": RangeBearing(max_range=8.0),
    "relative point": RelativePoint(max_range=8.0),
    "range-bearing, off centre": RangeBearing(max_range=8.0, **OFF_CENTRE),
    "relative point, off centre": RelativePoint(max_range=8.0, **OFF_CENTRE),
}
MOTION_SIGMA = np.array([0.04, 0.02, 0.015])
R_POLAR, R_POINT = np.array([[0.01, 0.001], [0.001, 0.0009]]), np.array([[0.02, 0.006], [0.006, 0.01]])


def circle(sensor, *, frames=60, landmarks=8, noise=1.0, seed=0, see=0.7, R=None, P0=None, heading=0.4):
    """(Inputs with a map and labels, true poses, true landmarks); `noise` scales what is drawn, not what is stated;
    landmarks: how many, or where; R: covariance of a reading.
    """
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-5.0, 5.0, (landmarks, 2)) if isinstance(landmarks, int) else landmarks
    truth = np.zeros((frames, 3))
    truth[0] = 2.0, -1.0, heading
    step = np.array([0.4, 0.03, 0.17])
    for k in range(1, frames):
        truth[k] = se2.compose(truth[k - 1], step)
    M = np.diag(MOTION_SIGMA**2)  # neither diagonal nor aligned with anything: a wrong frame or order shows
    M[0, 2] = M[2, 0] = 0.4 * MOTION_SIGMA[0] * MOTION_SIGMA[2]
    mean = np.vstack([np.zeros(3), step + noise * rng.multivariate_normal(np.zeros(3), M, frames - 1)])
    covariance = np.vstack([np.zeros((1, 3, 3)), np.tile(M, (frames - 1, 1, 1))])
    frame, label = np.nonzero(rng.random((frames, len(xy))) < see)
    z = sensor.predict(truth[frame], xy[label])
    near = sensor.polar(z)[:, 0] < (sensor.max_range if sensor.sees_points else np.inf)
    frame, label, z = frame[near], label[near], z[near]
    if R is None:
        R = R_POLAR if isinstance(sensor, RangeBearing) else R_POINT
    z = z + noise * rng.multivariate_normal(np.zeros(2), R, len(z))
    if not isinstance(sensor, RelativePoint):
        z[:, 1] = se2.wrap_angle(z[:, 1])
    if P0 is None:
        P0 = np.array([[0.02, 0.004, 0.001], [0.004, 0.01, 0.0], [0.001, 0.0, 0.005]])
    start = truth[0] + noise * rng.multivariate_normal(np.zeros(3), P0)
    inputs = Inputs(
        Prior(start, P0), np.arange(frames, dtype=float), Increments(mean, covariance),
        LabelledObservations(frame, z, np.tile(R, (len(z), 1, 1)), label), sensor, LandmarkMap(np.arange(len(xy)), xy),
    )  # fmt: skip
    return inputs, truth, xy


def truncated(inputs, frames):
    return shortened(Log("cut", inputs, Truth()), frames).recorded


def order_of_creation(inputs, decisions, created):
    initializing = created >= 0
    ids = np.empty(initializing.sum(), int)
    ids[created[initializing]] = inputs.observations.label[initializing]
    return ids


QUICK = ("range-bearing", "relative point, off centre")
"""Both kinds of sensor, on and off the centre; the others are for the slow tests."""
every_sensor = pytest.mark.parametrize(
    "sensor", [pytest.param(s, marks=[] if name in QUICK else pytest.mark.slow, id=name) for name, s in SENSORS.items()]
)
two_sensors = pytest.mark.parametrize("sensor", [*SENSORS.values()][:2], ids=[*SENSORS][:2])
both_tasks = pytest.mark.parametrize("task", ["localization", "slam"])
TIGHT = {"threshold": 1e-7, "skip": 1}


def for_task(inputs, task):
    return inputs if task == "localization" else inputs.without_map()


def drive(inputs, decisions, *, gate=np.inf, until=None, smoother=None, **options):
    """The smoother after frames [0, until), with its poses and covariances and what the updates said."""
    s = smoother or Isam2Smoother(inputs.prior, inputs.sensor, inputs.map, **options)
    return s, *estimators.drive(s, inputs, decisions, threshold=gate, until=until)


def parted(inputs, decisions, created, landmark, later):
    """Decisions that initialize a landmark again at its first observation after frame `later`, with that number."""
    o, number = inputs.observations, np.where(created >= 0, created, decisions)
    again = np.flatnonzero((number == landmark) & (o.frame > later))
    apart = decisions.copy()
    apart[again[0]] = NEW
    apart[again[1:]] = created.max() + 1
    return apart, int(created.max() + 1)


def resting(sensor):
    """Noise-free SLAM of a robot that hardly moves: increments are known to 1e-5 m, which Cholesky does not survive."""
    inputs, _, _ = circle(sensor, noise=0.0)
    inputs = inputs.without_map()
    covariance = np.tile(1e-10 * np.eye(3), (len(inputs), 1, 1))
    covariance[::2] += np.outer([0.02, 0.0, 0.03], [0.02, 0.0, 0.03])
    covariance[0] = 0.0
    return replace(inputs, increments=Increments(inputs.increments.mean, covariance))


def solved(inputs, loss="gaussian"):
    decisions, created = known_decisions(inputs)
    run = run_filter(inputs, decisions)
    landmark = np.empty((0, 2)) if run.map is None else run.map.xy
    return smooth(inputs, decisions, created, Start(run.pose, landmark), loss=loss), (decisions, created)


def lagged(inputs, lag, **options):
    return FixedLagSmoother(inputs.prior, inputs.sensor, inputs.map, lag=lag, **options)
