"""A graph solved again without a factor is that of an optimizer."""

import gtsam
import numpy as np
import pytest

import slamref
from tests.wings.audit.test_clusters import with_false_place
from tests.wings.audit.test_factors import chain
from wings.audit.audit import examined, left_out, places
from wings.audit.files import optimized


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
