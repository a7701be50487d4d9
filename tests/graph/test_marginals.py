"""The chain's exact covariances against gtsam's Marginals, and where gtsam gives up."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

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
