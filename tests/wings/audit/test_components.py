"""Variance components, draws and kinds."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X
from scipy.stats import kstest

from tests.quick import slow
from tests.wings.audit import graphs
from wings.audit.audit import examined
from wings.audit.factors import PARTS

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
