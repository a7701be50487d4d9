"""Walls in batch problems: the optimum and its covariance, outliers, systematic errors, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from association.decide import known_decisions
from data import se2
from data.errors import DataError, UsageError
from data.inputs import LandmarkMap, Systematic
from graph.bare_loop import bare_isam2
from graph.batch import smooth
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from graph.problem import Start
from graph.robust import gnc
from tests.graph.driving import both_tasks, for_task
from tests.graph.walls.worlds import (
    SENSORS,
    WALLS,
    differ,
    exactly,
    in_order,
    solved,
    walled,
)
from tests.quick import slow

ODOMETRY = Systematic(("scale", "curvature"), np.array([0.05, 0.05]))


@pytest.mark.parametrize("name", SENSORS)
@both_tasks
def test_the_optimum_and_its_covariance_are_those_of_dense_least_squares(name, task):
    inputs, result, decisions, (pose, lines, C, cost) = exactly(name, task)
    n = len(inputs)
    assert np.abs(se2.pose_error(result.trajectory.pose, pose)).max() < 1e-6
    assert differ(result.trajectory.covariance, [C[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)]) < 1e-4
    assert result.cost == pytest.approx(cost, abs=1e-6)
    assert result.dof == 2 * len(decisions) - (0 if task == "localization" else 2 * len(lines))
    if task == "slam":
        np.testing.assert_allclose(result.map.xy, lines, atol=1e-6)
        of_walls = [C[k : k + 2, k : k + 2] for k in range(3 * n, len(C), 2)]
        assert differ(result.map.covariance, of_walls) < 1e-4


def test_the_other_name_of_a_known_wall_changes_nothing():
    inputs, truth = walled(SENSORS["off centre"])
    other = WALLS.copy()
    other[::2] = np.column_stack([-other[::2, 0], se2.wrap_angle(other[::2, 1] + np.pi)])
    renamed = replace(inputs, map=LandmarkMap(inputs.map.id, other))
    a, b = solved(inputs, truth)[0], solved(renamed, truth)[0]
    np.testing.assert_allclose(a.trajectory.pose, b.trajectory.pose, atol=1e-9)
    assert a.cost == pytest.approx(b.cost, abs=1e-9)


def test_a_run_far_from_the_origin_is_the_same_run():
    """Where rho depends on alpha by kilometres: covariances of the same lines about a distant origin."""
    inputs, truth = walled(SENSORS["centred"])
    inputs = inputs.without_map()
    away = np.array([3000.0, -2000.0, 0.0])
    moved = replace(inputs, prior=replace(inputs.prior, mean=inputs.prior.mean + away))
    result, (decisions, created, walls) = solved(inputs, truth)
    normal = np.stack([np.cos(walls[:, 1]), np.sin(walls[:, 1])], 1)
    there = np.column_stack([walls[:, 0] + normal @ away[:2], walls[:, 1]])
    far = smooth(moved, decisions, created, Start(truth + away, there))
    np.testing.assert_allclose(far.trajectory.pose, result.trajectory.pose + away, atol=1e-6)
    assert differ(far.trajectory.covariance, result.trajectory.covariance) < 1e-6
    alpha = result.map.xy[:, 1]
    J = np.tile(np.eye(2), (len(walls), 1, 1))
    J[:, 0, 1] = np.cos(alpha) * away[1] - np.sin(alpha) * away[0]
    assert differ(far.map.covariance, J @ result.map.covariance @ J.transpose(0, 2, 1)) < 1e-6
    np.testing.assert_allclose(far.map.xy[:, 0], result.map.xy[:, 0] + np.cos(alpha) * 3000 - np.sin(alpha) * 2000)


@pytest.mark.parametrize(("task", "systematic"), [
    ("localization", None), slow("slam", None), slow("slam", ODOMETRY),
])  # fmt: skip
def test_wrong_readings_are_told_from_right_ones(task, systematic):
    inputs, truth = walled(SENSORS["off centre"], frames=30, seed=3)
    o, rng = inputs.observations, np.random.default_rng(0)
    bad = np.zeros(len(o.z), np.bool_)
    bad[20::12] = True
    z = o.z.copy()
    z[bad] += rng.choice([-1.0, 1.0], (bad.sum(), 2)) * rng.uniform([0.3, 0.2], [1.0, 0.6], (bad.sum(), 2))
    z[:, 0] = np.abs(z[:, 0])
    inputs = for_task(replace(inputs, observations=replace(o, z=z), systematic=systematic), task)
    clean = for_task(replace(inputs, observations=replace(o, z=z, label=np.where(bad, -1, o.label))), task)
    decisions, created = known_decisions(inputs)
    assert (created[bad] < 0).all()
    walls = in_order(inputs, created) if task == "slam" else np.empty((0, 2))
    result, accepted = gnc(inputs, decisions, created, Start(truth, walls))
    assert not accepted[bad].any()
    assert accepted[~bad].mean() > 0.95
    without, _ = solved(clean, truth)
    plain = smooth(inputs, decisions, created, Start(truth, walls))
    robust = smooth(inputs, decisions, created, Start(truth, walls), loss="huber")
    assert plain.cost > 10.0 * plain.dof
    gap = [np.abs(r.trajectory.pose - without.trajectory.pose).max() for r in (result, robust, plain)]
    assert gap[0] < 0.05
    assert gap[1] < 0.1 < gap[2]


@both_tasks
def test_errors_of_odometry_are_estimated_along(task):
    inputs, truth = walled(SENSORS["off centre"], noise=0.0)
    increments = inputs.increments
    inputs = for_task(replace(inputs, systematic=ODOMETRY), task)
    mean = increments.mean.copy()
    mean[:, :2] *= 1.03
    off, _ = solved(replace(inputs, increments=replace(increments, mean=mean)), truth)
    sigma = off.systematic.sigma[-1, 0]
    assert sigma < 0.02
    assert off.systematic.mean[-1, 0] == pytest.approx(1.0 / 1.03 - 1.0, abs=0.3 * sigma)


@pytest.mark.parametrize("names", [("range",), ("scale", "bearing")])
def test_errors_of_the_sensor_are_refused(names):
    inputs, truth = walled(SENSORS["centred"])
    systematic = Systematic(names, np.full(len(names), 0.1))
    with pytest.raises(UsageError, match="sensor of points"):
        solved(replace(inputs, systematic=systematic), truth)
    with pytest.raises(UsageError, match="sensor of points"):
        Isam2Smoother(inputs.prior, inputs.sensor, systematic=systematic)
    with pytest.raises(UsageError, match="sensor of points"):
        FixedLagSmoother(inputs.prior, inputs.sensor, lag=3.0, systematic=systematic)


def test_a_reading_without_information_is_refused():
    inputs, truth = walled(SENSORS["centred"], frames=10)
    R = inputs.observations.R.copy()
    R[3] = [[1e-4, 2e-4], [2e-4, 4e-4]]
    bad = replace(inputs, observations=replace(inputs.observations, R=R))
    with pytest.raises(DataError, match="not positive definite"):
        solved(bad, truth)
    decisions, created = known_decisions(bad.without_map())
    with pytest.raises(ValueError, match="points"):
        bare_isam2(inputs.without_map(), decisions, created)
