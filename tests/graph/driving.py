"""Drives through the small worlds: frame by frame, with a lag, all at once; and marks for every sensor and task."""

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data.inputs import Increments
from data.result import NEW
from ekf.whole_run import run_filter
from graph.batch import smooth
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from graph.problem import Start
from tests.builders import estimators
from tests.graph.worlds import SENSORS, circle

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
