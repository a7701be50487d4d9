"""Pose graphs that grow key by key: iSAM2 over everything, and over a window."""

import numpy as np
import pytest

from data.errors import DataError
from data.inputs import Prior
from data.se2 import compose, dead_reckoned, pose_error
from tests.graph.poses.worlds import corridors
from wings.laser import pose_graph
from wings.laser.pose_graph import FixedLagPoseGraph, PoseGraph


def driven(graph, world):
    """Online poses (K, 3) and covariances (K, 3, 3) of a graph that is given a world, each key with its loops."""
    newest = []
    for k in range(len(world.truth)):
        if k:
            graph.add_key(world.motion[k], world.covariance[k])
        graph.add_loops(*world.of(k))
        graph.update()
        newest.append(graph.newest())
    return [np.array(each) for each in zip(*newest)]


def sigmas_between(pose, other, covariance):
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 1e-18))
    return np.abs(pose_error(pose, other)) / sigma


def correlation_change(covariance, other):
    """Difference of covariances (n, 3, 3) in units of the other's standard deviations."""
    sigma = np.sqrt(np.diagonal(other, axis1=1, axis2=2))
    return np.abs(covariance - other) / (sigma[:, :, None] * sigma[:, None, :])


@pytest.mark.parametrize("prior", [np.zeros((3, 3)), np.diag([0.1, 0.2, 0.05]) ** 2])
@pytest.mark.parametrize(("threshold", "sigmas"), [(1e-5, 1e-3), (pose_graph.THRESHOLD, 0.05)])
def test_the_graph_ends_at_the_batch_optimum_of_the_same_constraints(prior, threshold, sigmas, monkeypatch):
    monkeypatch.setattr(pose_graph, "THRESHOLD", threshold)
    world = corridors(1, 120, loops=50, blocks=2)
    graph = PoseGraph(world.prior(prior))
    for k in range(1, 120):
        graph.add_key(world.motion[k], world.covariance[k])
    graph.add_loops(*world[3:])
    graph.update()
    for _ in range(5):
        graph._engine.update()
    best = world.optimum(graph.poses(), prior).trajectory
    assert sigmas_between(graph.poses(), best.pose, best.covariance)[1:].max() < sigmas
    assert correlation_change(graph.covariances()[1:], best.covariance[1:]).max() < 0.03


def test_online_the_newest_pose_is_that_of_a_batch_over_what_was_known_then():
    world = corridors(1, 120, loops=60, drift=2.0, blocks=2)
    pose, covariance = driven(PoseGraph(world.prior()), world)
    for k in (60, 90, 119):
        known = world.key2 <= k
        past = world._replace(**{n: getattr(world, n)[: k + 1] for n in ("truth", "motion", "covariance")})
        past = past._replace(**{n: getattr(world, n)[known] for n in world._fields[3:]})
        best = past.optimum(world.truth[: k + 1]).trajectory
        assert sigmas_between(pose[k : k + 1], best.pose[k:], best.covariance[k:]).max() < 0.1
        assert correlation_change(covariance[k : k + 1], best.covariance[k:]).max() < 0.03


def test_what_makes_no_sense_is_refused():
    graph = PoseGraph(Prior(np.zeros(3), np.zeros((3, 3))))
    graph.update()
    assert (graph.newest()[1] == 0.0).all()
    with pytest.raises(DataError, match="motion into key pose 1: its covariance is singular"):
        graph.add_key(np.ones(3), np.diag([1.0, 1.0, 0.0]))
    with pytest.raises(ValueError, match="lag -1"):
        FixedLagPoseGraph(graph.prior, np.zeros(1), lag=-1.0)


def test_within_a_window_a_loop_to_a_key_that_left_is_a_fix_from_where_it_left():
    """Two keys a metre on, the first one left: a fix of equal covariance halves the way between the two."""
    C = 0.01 * np.eye(3)
    graph = FixedLagPoseGraph(Prior(np.zeros(3), np.zeros((3, 3))), np.arange(5.0), lag=1.0)
    graph.update()
    for _ in range(4):
        graph.add_key(np.array([1.0, 0.0, 0.0]), np.diag([0.01, 1e-8, 1e-8]))
        graph.update()
    assert graph.size == 2
    before, P = graph.newest()
    np.testing.assert_allclose(before, [4.0, 0.0, 0.0], atol=1e-6)
    place = graph.poses()[2]
    graph.add_loops(np.array([2]), np.array([4]), np.array([[3.0, 0.0, 0.0]]), C[None])
    graph.update()
    there, fixed = compose(place, np.array([3.0, 0.0, 0.0]))[0], 0.02 + 0.01  # two steps of the chain, and the loop
    expected = (4.0 / P[0, 0] + there / fixed) / (1.0 / P[0, 0] + 1.0 / fixed)
    assert graph.newest()[0][0] == pytest.approx(expected, abs=1e-5)
    assert graph.newest()[1][0, 0] == pytest.approx(1.0 / (1.0 / P[0, 0] + 1.0 / fixed), rel=1e-4)


def test_a_window_bounds_the_graph_and_still_comes_back_from_drift():
    world = corridors(2, 250, loops=100, drift=4.0, blocks=2)
    graph = FixedLagPoseGraph(world.prior(), np.arange(250.0), lag=20.0)
    pose, covariance = driven(graph, world)
    assert graph.size <= 23
    assert graph.poses().shape == (250, 3)
    assert graph.covariances().shape == covariance.shape == (250, 3, 3)
    assert world.rmse(pose) < 0.5 * world.rmse(dead_reckoned(world.truth[0], world.motion))
