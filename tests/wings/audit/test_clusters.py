"""Loops that agree with each other are tested together."""

import gtsam
import numpy as np
import pytest

from tests.research import audit as research
from tests.wings.audit import oracle
from tests.wings.audit.test_components import SIGMAS, ring
from wings.audit.audit import examined
from wings.audit.files import optimized

N = gtsam.noiseModel


def with_false_place(seed, count=10):
    """A ring, with `count` loops between two places that say the same wrong thing."""
    rng = np.random.default_rng(seed)
    graph, values = ring(rng, 80, 50)
    wrong = gtsam.Pose2(0.3, -0.2, 0.1)
    first = graph.size()
    for k in range(count):
        a, b = 10 + k % 4, 50 + k % 5
        z = values.atPose2(a_(a)).between(wrong.compose(values.atPose2(a_(b)))).retract(rng.normal(0, SIGMAS))
        graph.add(gtsam.BetweenFactorPose2(a_(a), a_(b), z, N.Diagonal.Sigmas(SIGMAS)))
    return graph, optimized(graph, values), set(range(first, first + count))


def a_(k):
    return gtsam.symbol("x", k)


@pytest.mark.slow
def test_ten_wrong_loops_that_agree_are_a_cluster():
    found = 0
    for seed in range(5):
        graph, values, wrong = with_false_place(seed)
        a = examined(graph, values, draws=0)
        best = int(np.argmin(a.log_p_cluster))
        assert a.log_p_cluster[best] < np.log(0.01)
        found += len(wrong & set(a.clusters[best].factors)) >= 9
        assert a.rejected
    assert found == 5


def test_the_test_of_a_cluster_is_that_of_one_error_of_the_later_place():
    graph, values, _ = with_false_place(3)
    a = examined(graph, values, draws=0)
    c = a.clusters[int(np.argmin(a.log_p_cluster))]
    parts = oracle.rows(graph, values)
    A = np.vstack([parts[i][0] for i in c.factors])
    r = np.concatenate([parts[i][1] for i in c.factors])
    x, C, _, _ = oracle.solve([p for i, p in enumerate(parts) if i not in c.factors])
    e, S = r + A @ x, np.eye(len(r)) + A @ C @ A.T
    later, place = [max(a.keys[i]) for i in c.factors], sorted(graph.keyVector())
    B = np.vstack([parts[i][0][:, 3 * place.index(b) :][:, :3] @ values.atPose2(b).inverse().AdjointMap()
                   for i, b in zip(c.factors, later)])  # fmt: skip
    v = B.T @ np.linalg.solve(S, e)
    assert c.rank == 3
    assert pytest.approx(float(v @ np.linalg.solve(B.T @ np.linalg.solve(S, B), v)), rel=0.01) == c.T
    assert c.moved > 0.05


@pytest.mark.slow
def test_clean_graphs_have_no_cluster():
    rejected = 0
    for seed in range(20):
        a = examined(*ring(np.random.default_rng(seed), 80, 80), draws=0)
        rejected += bool((a.log_p_cluster < np.log(0.05)).any())
    assert rejected <= 3


@pytest.mark.parametrize(
    ("structure", "strength", "seed"), [("Manhattan", np.inf, 1), ("Intel-like", 10.0, 0), ("Intel-like", 10.0, 4)]
)
def test_loops_that_agree_are_wrong_rather_than_odometry_and_where_no_single_one_is_rejected(structure, strength, seed):
    """Seen: steps of odometry named, twice; nothing named, as a cluster alone was rejected."""
    s = research.STRUCTURES[structure](150, 0)
    drawn = research.spoilt(s, research.Case(research.AGREE, 3, strength), np.random.default_rng([seed, 3]))
    assert examined(drawn.graph, optimized(drawn.graph, drawn.path), draws=0).wrong.tolist() == drawn.false
