"""A graph without some of its key poses: what dense marginalization leaves, or a tree near it where that is none."""

from __future__ import annotations

import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from hypothesis import given
from hypothesis import strategies as st

from data.inputs import Prior
from data.se2 import between, dead_reckoned
from tests.graph.poses.worlds import corridors
from wings.laser.poses.online import PoseGraph
from wings.laser.poses.thinned import ThinnedPoseGraph

EXACT = Prior(np.zeros(3), np.zeros((3, 3)))


def both(world, keys, upto=10**9):
    """The whole graph, and one to be thinned."""
    graphs = PoseGraph(world.prior()), ThinnedPoseGraph(world.prior())
    for graph in graphs:
        for k in range(1, keys):
            graph.add_key(world.motion[k], world.covariance[k])
            rows = (world.key2 == k) & (world.key1 < upto)
            graph.add_loops(world.key1[rows], world.key2[rows], world.relative[rows], world.loop_covariance[rows])
        for _ in range(3):
            graph.update()
            graph._engine.update()
    return graphs


def test_untouched_it_is_the_same_graph():
    world = corridors(1, 30, loops=8)
    whole, thin = both(world, 30)
    np.testing.assert_allclose(thin.poses(), whole.poses(), atol=1e-6)
    np.testing.assert_allclose(thin.newest()[1], whole.newest()[1], rtol=1e-4, atol=1e-12)


def test_of_a_chain_with_a_closure_over_it_any_removal_between_changes_nothing_of_the_rest():
    """Of a key pose with two neighbours the marginal is one constraint; up to how headings turn covariances."""
    rng = np.random.default_rng(3)
    motion = np.column_stack([np.full(12, 0.4), 0.01 * rng.standard_normal((12, 2))])
    P = np.diag([1e-4, 1e-4, 1e-6])
    graphs = (PoseGraph(EXACT), ThinnedPoseGraph(EXACT))
    end = dead_reckoned(np.zeros(3), motion)[-1] + [0.02, -0.01, 0.002]
    for graph in graphs:
        for k in range(1, 12):
            graph.add_key(motion[k], P)
        graph.add_loops(np.array([0]), np.array([11]), end[None], P[None])
        graph.update()
    whole, thin = graphs
    for k in (3, 4, 7, 5):
        thin.remove(k)
    thin.update()
    for graph in graphs:
        for _ in range(20):
            graph._engine.update()
    kept = [0, 1, 2, 6, 8, 9, 10, 11]
    found = thin.poses()
    assert np.flatnonzero(np.isfinite(found[:, 0])).tolist() == kept
    assert thin.size == len(kept)
    np.testing.assert_allclose(found[kept], whole.poses()[kept], atol=2e-5)
    np.testing.assert_allclose(thin.newest()[1], whole.newest()[1], rtol=1e-3, atol=1e-9)


def test_two_constraints_between_the_same_key_poses_are_one_with_the_information_of_both():
    P, Q = np.diag([1e-2, 2e-2, 1e-3]), np.diag([3e-2, 1e-2, 2e-3])
    a, b = np.array([1.0, 0.2, 0.3]), np.array([1.1, 0.1, 0.35])
    thin = ThinnedPoseGraph(EXACT)
    thin.add_key(a, P)
    thin.add_loops(np.array([0]), np.array([1]), b[None], Q[None])
    thin.update()
    C = np.linalg.inv(np.linalg.inv(P) + np.linalg.inv(Q))
    mean = C @ (np.linalg.solve(P, a) + np.linalg.solve(Q, b))
    np.testing.assert_allclose(thin.newest()[0], mean, atol=1e-9)
    np.testing.assert_allclose(thin.newest()[1], C, atol=5e-5)  # linearized at the first of them
    assert len(thin.links[0]) == 1


@given(st.integers(0, 10**6))
def test_what_is_left_of_a_star_claims_no_more_than_its_marginal_and_not_much_less(seed):
    rng = np.random.default_rng(seed)
    legs = [np.diag(rng.uniform(0.2, 2.0, 3) * [1e-4, 1e-4, 1e-8]) for _ in range(3)]  # almost linear
    thin, nothing = ThinnedPoseGraph(EXACT), np.diag([1e4, 1e4, 1e2])
    steps = np.array([[1.0, 0.3, 0.0], [0.5, -1.0, 0.0], [-0.7, 0.4, 0.0]])
    thin.add_key(steps[0], legs[0])
    thin.add_key(steps[1], legs[1])
    thin.add_key(steps[2] - steps[1], nothing)
    thin.add_loops(np.array([1]), np.array([3]), steps[2:], legs[2][None])
    thin.update()
    before, count = thin._engine.covariance([X(2), X(3)]), sum(map(len, thin.links.values()))
    thin.remove(1)
    thin.update()
    now = thin._engine.covariance([X(2), X(3)])
    assert np.linalg.eigvalsh(now - before).min() > -1e-3 * np.abs(before).max()
    assert np.trace(now) < 2.5 * np.trace(before)
    assert sum(map(len, thin.links.values())) < count


def test_of_a_walk_half_of_whose_key_poses_leave_as_it_proceeds_little_is_lost():
    world = corridors(0, 300, loops=120)
    whole, thin = both(world, 2)
    count = []
    for k in range(2, 300):
        for graph in (whole, thin):
            graph.add_key(world.motion[k], world.covariance[k])
            rows = world.key2 == k
            if graph is thin:
                rows &= np.isin(world.key1, list(thin.links))
            graph.add_loops(world.key1[rows], world.key2[rows], world.relative[rows], world.loop_covariance[rows])
        if k % 2 and k > 20:
            thin.remove(k - 20)
            thin.update()
        count.append(sum(map(len, thin.links.values())) // 2)
        whole.update()
    thin.update()
    kept = sorted(thin.links)
    assert len(kept) == thin.size < 165
    assert count[-1] < 165 + 120
    off = [np.hypot(*(g.poses()[kept] - world.truth[kept])[:, :2].T) for g in (whole, thin)]
    assert np.sqrt((off[1] ** 2).mean()) < 2.0 * np.sqrt((off[0] ** 2).mean())


def test_what_cannot_be_removed_is_said():
    thin = ThinnedPoseGraph(EXACT)
    for _ in range(3):
        thin.add_key(np.array([1.0, 0.0, 0.0]), np.eye(3))
    thin.remove(1)
    for key in (0, 1, 3, 9):
        with pytest.raises(ValueError, match=f"key pose {key} cannot be removed"):
            thin.remove(key)
    with pytest.raises(ValueError, match="not in the graph"):
        thin.add_loops(np.array([1]), np.array([3]), np.zeros((1, 3)), np.eye(3)[None])
    with pytest.raises(ValueError, match="update"):
        thin.poses()
    thin.update()
    np.testing.assert_allclose(between(thin.poses()[0], thin.poses()[2]), [2.0, 0.0, 0.0], atol=1e-9)
