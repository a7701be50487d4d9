"""Variance components, draws and kinds; loops that agree with each other are tested together; a graph solved again
without a factor is that of an optimizer.
"""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X
from scipy.stats import kstest

import slamref
from tests.quick import slow
from tests.research import audit as research
from tests.wings.audit import graphs, oracle
from tests.wings.audit.test_factors import chain
from wings.audit.audit import examined, left_out, places
from wings.audit.factors import PARTS
from wings.audit.files import optimized

N = gtsam.noiseModel
SIGMAS = np.array([0.1, 0.05, 0.02])


def ring(rng, poses=60, loops=60, odometry=1.0, axes=(1.0, 1.0, 1.0)):
    """A walk in a small area with many loops; true values, the noise of odometry multiplied."""
    model = N.Diagonal.Sigmas(SIGMAS)
    true = [gtsam.Pose2()]
    for _ in range(poses - 1):
        true.append(true[-1].compose(gtsam.Pose2(1, 0, rng.choice([0, np.pi / 2]))))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(true):
        values.insert(X(k), pose)
        if k:
            z = true[k - 1].between(pose).retract(rng.normal(0, SIGMAS) * odometry * np.array(axes))
            graph.add(gtsam.BetweenFactorPose2(X(k - 1), X(k), z, model))
    for _ in range(loops):
        a, b = sorted(rng.choice(poses, 2, replace=False).tolist())
        if b - a > 1:
            z = true[a].between(true[b]).retract(rng.normal(0, SIGMAS))
            graph.add(gtsam.BetweenFactorPose2(X(a), X(b), z, model))
    return graph, gtsam.GaussNewtonOptimizer(anchored(graph, values), values).optimize()


def anchored(graph, values):
    out = gtsam.NonlinearFactorGraph(graph)
    out.add(gtsam.PriorFactorPose2(X(0), values.atPose2(X(0)), N.Isotropic.Sigma(3, 1e-3)))
    return out


@pytest.mark.slow
def test_the_noise_of_odometry_is_put_down_to_odometry():
    found = []
    for seed in range(12):
        a = examined(*ring(np.random.default_rng(seed), odometry=1.3), draws=0)
        assert a.kinds.names == ("odometry", "loop")
        found.append(a.by_kind.component)
        assert np.all(np.abs(a.by_kind.component - [1.69, 1.0]) < 4 * a.by_kind.error)
    assert np.abs(np.mean(found, 0) - [1.69, 1.0]).max() < 0.15


def test_components_of_axes_are_apart():
    a = examined(*ring(np.random.default_rng(5), 200, 200, axes=(1.0, 1.0, 3.0)), draws=0)
    by = {(a.kinds.names[k], a.kinds.axes[k][x]): a.by_axis.component[i] for i, (k, x) in enumerate(a.axis.tolist())}
    assert a.by_axis.redundancy.sum() == pytest.approx(a.freedom, abs=1e-8)
    assert by["odometry", "theta"] == pytest.approx(9.0, rel=0.4)
    assert by["odometry", "x"] == pytest.approx(1.0, rel=0.4)
    assert by["loop", "theta"] == pytest.approx(1.0, rel=0.4)


@pytest.mark.parametrize("many", [12, slow(40)])
def test_standard_errors_are_those_of_many_graphs(many):
    found = [examined(*ring(np.random.default_rng(seed)), draws=0).by_kind for seed in range(many)]
    z = (np.array([c.component for c in found]) - 1.0) / np.array([c.error for c in found])
    assert 0.75 < z.std() < 1.3
    assert kstest(np.concatenate([np.exp(c.log_p) for c in found]), "uniform").pvalue > 1e-3


def test_p_values_of_draws_and_of_holm_agree_on_the_least():
    graph, values = ring(np.random.default_rng(3))
    a = examined(graph, values, draws=400)
    i = int(np.nanargmin(a.factors.log_p))
    assert a.p_drawn[i] == pytest.approx(1.0 - (1.0 - np.exp(a.log_p_family[i])) ** PARTS[0], abs=0.2)  # factors alone
    assert a.log_p_family[i] <= examined(graph, values, draws=0).log_p_family[i]
    assert sum(PARTS) == 1.0, "what one class has of the level, the others have not"


def test_kinds_by_role_and_by_the_user():
    graph, values = graphs.planar(1)
    a = examined(graph, values, draws=0)
    assert {"odometry", "loop", "CustomFactor"} <= {name.split()[0] for name in a.kinds.names}
    b = examined(graph, values, by=lambda i, f: "even" if i % 2 == 0 else "odd", draws=0)
    assert b.kinds.names == ("even", "odd")


def test_a_kind_that_nothing_checks_has_no_component():
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(L(0), np.zeros(2))
    graph.add(gtsam.PriorFactorPoint2(L(0), np.ones(2), N.Unit.Create(2)))
    a = examined(graph, values, draws=10)
    assert np.isnan(a.by_kind.component).all()
    assert np.isnan(a.log_p_family).all()


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


def solved_without(graph, values, some):
    rest = gtsam.NonlinearFactorGraph(graph)
    for i in some:
        rest.remove(i)
    end = gtsam.LevenbergMarquardtOptimizer(held(rest, values), values).optimize()
    keys = sorted(graph.keyVector())
    apart = np.linalg.norm(places(end, keys) - places(values, keys), axis=1)
    return apart.max(), 2.0 * (graph.error(values) - rest.error(end))


def held(graph, values):
    out = gtsam.NonlinearFactorGraph(graph)
    key = min(graph.keyVector())
    out.add(gtsam.PriorFactorPose2(key, values.atPose2(key), gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)))
    return out


def test_motion_and_cost_are_those_of_an_optimizer():
    graph, values, wrong = with_false_place(1)
    values = optimized(graph, values)
    a = examined(graph, values, draws=0)
    sets = [[int(np.argmax(a.factors.moved))], [0], sorted(wrong)]
    for some, (metres, cost) in zip(sets, left_out(graph, values, a, sets)):
        by_gtsam = solved_without(graph, values, some)
        assert cost == pytest.approx(by_gtsam[1], rel=1e-3, abs=1e-3)
        assert metres == pytest.approx(by_gtsam[0], rel=0.05, abs=1e-3)


def test_both_values_stand_in_the_table():
    graph, values = chain()
    report = slamref.audit(graph, values, draws=0, resolve=3)
    some = report.factors.dropna(subset="resolved_m")
    assert len(some) == 3
    assert set(some.index) == set(report.factors["influence_m"].nlargest(3).index)
    assert some["resolved_m"].to_numpy() == pytest.approx(some["influence_m"].to_numpy(), rel=0.05)
    assert some["resolved_cost"].to_numpy() == pytest.approx(some["cost"].to_numpy(), rel=0.05)
