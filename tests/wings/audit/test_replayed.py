"""The audit of the graph that a batch smoother of the replay ends with is that of its factors in gtsam."""

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Systematic
from data.worlds.registry import named_log
from eval.referee.score import Trial
from eval.replay.run import compare
from graph.batch import build
from tests.quick import slow
from wings.audit.audit import examined
from wings.audit.worst_factors import end_of, graph_at_end

OF = Systematic(("scale", "curvature", "drift", "range"), np.array([0.02, 2e-3, 1e-3, 0.02]))


def ended(name, task, systematic=None, frames=""):
    log = named_log(f"{name}{frames}")
    log = replace(log, recorded=replace(log.recorded, systematic=systematic))
    run = compare(log.inputs(labels=True), task, ["ekf", "batch"])[-1]
    return log, run, graph_at_end(Trial(log, task, (run,)), run)


@pytest.mark.parametrize("task", ["slam", slow("localization")])
def test_statistics_are_those_of_its_factors_in_gtsam(task):
    log, run, graph = ended("arena:0:frames=40", task)
    inputs = log.recorded if task == "localization" else log.recorded.without_map()
    problem = build(inputs, run.final_decisions, run.initialized)
    a = examined(problem.graph(), problem.values(end_of(run)), draws=0)
    pinned = task == "localization"  # a known landmark is a variable with a constraint behind it
    rows = np.arange(40, a.factors.dim.size, 2) if pinned else np.arange(40, a.factors.dim.size)
    t = graph.statistics.factors
    for mine, theirs in ((t.deleted, a.factors.deleted), (t.redundancy, a.factors.redundancy)):
        assert mine[1:40] == pytest.approx(theirs[1:40], rel=1e-5, abs=1e-5)
        assert mine[40:] == pytest.approx(theirs[rows], rel=1e-5, abs=1e-5)
    assert graph.frame[40:].tolist() == inputs.observations.frame[graph.observation[40:]].tolist()


@pytest.mark.parametrize(
    ("name", "task", "systematic"),
    [
        ("arena:1:frames=40+sensor=relative_point", "slam", None),
        ("arena:2:frames=40", "slam", OF),
        ("arena:2:frames=40", "localization", OF),
        ("walls:0:frames=60", "slam", None),
    ],
)
def test_its_sum_of_squares_is_the_cost_of_the_smoother(name, task, systematic):
    _, run, graph = ended(name, task, systematic)
    cost, dof = run.total_nis
    s = graph.statistics
    assert np.nansum(s.factors.chi2) == pytest.approx(cost, rel=1e-6)
    assert s.freedom == dof
    assert np.nansum(s.factors.redundancy) == pytest.approx(dof, rel=1e-6)


def test_noise_that_is_wrong_is_put_down_to_its_kind():
    log = named_log("arena:0:frames=120")
    o = log.recorded.observations
    wider = np.einsum("i,nij,j->nij", [2.0, 1.0], o.R, [2.0, 1.0])  # range before bearing
    loud = replace(log, recorded=replace(log.recorded, observations=replace(o, R=wider)))
    run = compare(loud.inputs(labels=True), "slam", ["ekf", "batch"])[-1]
    s = graph_at_end(Trial(loud, "slam", (run,)), run).statistics
    by = {(s.kinds.names[k], s.kinds.axes[k][x]): i for i, (k, x) in enumerate(s.axis.tolist()) if x >= 0}
    assert s.by_axis.component[by["observations", "range"]] == pytest.approx(0.25, rel=0.25)
    assert s.by_axis.component[by["observations", "bearing"]] == pytest.approx(1.0, rel=0.25)
    assert s.log_p_axis[by["observations", "range"]] < np.log(0.01)
