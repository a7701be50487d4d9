"""The chain's exact covariances against gtsam's Marginals, and where gtsam gives up."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from data.inputs import Increments
from data.motion.velocity import floor_covariances
from data.sensors import RelativePoint
from ekf.whole_run import run_filter
from graph.batch import build, smooth
from graph.optimum import in_world
from graph.problem import Start
from tests.graph.driving import every_sensor, solved
from tests.graph.worlds import circle


@every_sensor
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("loss", ["gaussian", "cauchy"])
def test_all_marginals_equal_gtsams(sensor, task, loss):
    inputs, _, _ = circle(sensor)
    if task == "slam":
        inputs = inputs.without_map()
    result, plan = solved(inputs, loss)
    problem = build(inputs, *plan, loss)
    landmark = np.zeros((0, 2)) if result.map is None else result.map.xy
    marginals = gtsam.Marginals(problem.graph(), problem.values(Start(result.trajectory.pose, landmark)))
    body = np.array([marginals.marginalCovariance(X(k)) for k in range(len(inputs))])
    expected = in_world(result.trajectory.pose, body)
    np.testing.assert_allclose(result.trajectory.covariance, expected, atol=1e-7 * np.abs(expected).max())
    if result.map is not None:
        expected = np.array([marginals.marginalCovariance(L(n)) for n in result.map.number.tolist()])
        np.testing.assert_allclose(result.map.covariance, expected, atol=1e-9 * np.abs(expected).max())


def test_a_robot_that_rests_for_long_is_no_trouble():
    """gtsam's Marginals fail here. The last pose of a linear smoother is the filter's."""
    inputs, _, _ = circle(RelativePoint(), noise=0.0, frames=400)
    mean, covariance = inputs.increments.mean.copy(), inputs.increments.covariance.copy()
    mean[:], covariance[:] = 0.0, 0.0
    covariance[200:] = np.outer([0.02, 0.0, 0.03], [0.02, 0.0, 0.03])
    covariance, floored = floor_covariances(covariance, 1e-10)
    assert floored == len(inputs) - 1
    o = inputs.observations
    rows = np.flatnonzero(o.frame % 100 == 0)
    at_rest = inputs.sensor.predict(inputs.prior.mean, inputs.map.xy[o.label[rows]])
    inputs = replace(
        inputs,
        increments=Increments(mean, covariance),
        observations=type(o)(o.frame[rows], at_rest, o.R[rows], o.label[rows]),
    )
    result, plan = solved(inputs)
    run = run_filter(inputs, plan[0])
    np.testing.assert_allclose(result.trajectory.covariance[-1], run.covariance[-1], rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(result.trajectory.pose, np.tile(inputs.prior.mean, (400, 1)), atol=1e-9)
    problem = build(inputs, *plan)
    with pytest.raises(RuntimeError, match="Indeterminate"):
        gtsam.Marginals(problem.graph(), problem.values(Start(result.trajectory.pose, np.zeros((0, 2)))))


@pytest.mark.parametrize(
    "P0",
    [
        np.zeros((3, 3)),
        np.diag([0.01, 0.01, 0.0]),
        0.01 * np.ones((3, 3)),
        np.diag([0.0, 0.02, 0.01]),
        1e-9 * np.eye(3),
    ],
    ids=["zero", "heading exact", "rank one", "x exact", "tiny"],
)
def test_without_sightings_the_first_pose_keeps_its_prior_covariance_however_singular(P0):
    inputs, _, _ = circle(RelativePoint(), P0=P0, heading=2.2, noise=0.0)
    nothing = np.full(len(inputs.observations.frame), -2)
    run = run_filter(inputs, nothing)
    result = smooth(inputs, nothing, np.full(len(nothing), -1), Start(run.pose, np.empty((0, 2))))
    np.testing.assert_allclose(result.trajectory.pose, run.pose, atol=1e-9)
    np.testing.assert_allclose(result.trajectory.covariance, run.covariance, atol=1e-11)
