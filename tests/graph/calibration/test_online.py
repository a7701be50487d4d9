"""iSAM2 and the fixed-lag smoother estimate systematic errors of odometry and sensor along with path and map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from association.known import known_decisions
from data import se2
from data.inputs import Increment
from data.result import DISCARD
from ekf.whole_run import run_filter
from graph.batch import Start, smooth
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from tests.graph.calibration.least_squares import solve
from tests.graph.calibration.worlds import (
    ALL,
    CARTESIAN,
    CARTESIAN_OFF,
    ODOMETRY,
    POLAR,
    POLAR_OFF,
    erring,
    to_estimate,
    truncated,
)
from tests.graph.driving import drive, for_task

WHAT = {"odometry": ODOMETRY, "drift": ("scale", "curvature", "drift"), "bearing": ("bearing",), "all": ALL}
SENSORS = {"polar": POLAR, "points": CARTESIAN, "polar, off": POLAR_OFF, "points, off": CARTESIAN_OFF}
CASES = [
    pytest.param(names, sensor, task, id=f"{what}, {kind}, {task}", marks=() if fast else pytest.mark.slow)
    for what, names in WHAT.items()
    for kind, sensor in SENSORS.items()
    for task in ("slam", "localization")
    for fast in [(what, kind, task) in {("drift", "polar", "slam"), ("all", "points, off", "localization")}]
]


def calibrated(inputs, **options):
    return Isam2Smoother(inputs.prior, inputs.sensor, inputs.map, systematic=inputs.systematic, **options)


def true_map(inputs, created, xy):
    return xy[inputs.observations.label[np.argsort(created)[np.count_nonzero(created < 0) :]]]


def in_sigmas(difference, covariance):
    return np.abs(difference) / np.sqrt(np.diag(covariance))


@pytest.mark.parametrize(("names", "sensor", "task"), CASES)
def test_newest_pose_errors_and_map_are_those_of_dense_least_squares(names, sensor, task):
    """To 0.03 sigma, 3 % of covariance: gtsam's residual of an increment is a logarithm, here it is additive."""
    inputs, path, xy = erring(to_estimate(*names), sensor, frames=24)
    inputs = for_task(inputs, task)
    decisions, created = known_decisions(inputs)
    start = true_map(inputs, created, xy) if task == "slam" else inputs.map.xy
    number = np.where(created >= 0, created, decisions)
    oracle = solve(inputs, number, path, start)
    s, *_ = drive(inputs, decisions, smoother=calibrated(inputs, threshold=1e-6, skip=1))
    s.refine()
    pose, covariance = s.estimate()
    b, B = s.errors
    assert in_sigmas(se2.pose_error(pose, oracle.pose), oracle.pose_covariance).max() < 0.03
    assert in_sigmas(b - oracle.errors, oracle.errors_covariance).max() < 0.03
    scale = np.sqrt(np.diag(oracle.pose_covariance))
    np.testing.assert_allclose(covariance / np.outer(scale, scale), oracle.pose_covariance / np.outer(scale, scale), atol=0.03)
    scale = np.sqrt(np.diag(oracle.errors_covariance))
    np.testing.assert_allclose(B / np.outer(scale, scale), oracle.errors_covariance / np.outer(scale, scale), atol=0.03)
    if task == "slam":
        state = s.landmarks()
        for xy, C, theirs, D in zip(state.xy, state.covariance, oracle.xy, oracle.xy_covariance, strict=True):
            assert in_sigmas(xy - theirs, D).max() < 0.03
            np.testing.assert_allclose(C / np.trace(D), D / np.trace(D), atol=0.03)
