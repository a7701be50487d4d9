"""However gross an error is, the factor that has it is named first: nothing ties where p values underflow."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2

import slamref
from wings.audit.audit import examined
from wings.audit.factors import log_tail
from wings.audit.page import rejected_factors

SIGMA = np.array([0.01, 0.01, 0.01, 0.05, 0.05, 0.05])
PLANAR = np.array([0.05, 0.05, 0.01])


def in_space(false: float, seed: int, poses: int = 120, loops: int = 30):
    """A chain of `Pose3` on three rounds, loops between them, the last one off by `false` sigmas of its translation."""
    rng = np.random.default_rng(seed)
    angle = 6.0 * np.pi * np.arange(poses) / poses
    true = [gtsam.Pose3(gtsam.Rot3.Yaw(a), np.array([5 * np.cos(a), 5 * np.sin(a), 0.1 * a])) for a in angle]
    noise = gtsam.noiseModel.Diagonal.Sigmas(SIGMA)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose3(0, true[0], noise))

    def measured(i: int, j: int, off: float = 0.0) -> gtsam.Pose3:
        error = rng.normal(0.0, SIGMA)
        error[3] += off * SIGMA[3]
        return true[i].between(true[j]).compose(gtsam.Pose3.Expmap(error))

    at = true[0]
    values.insert(0, at)
    for i in range(poses - 1):
        step = measured(i, i + 1)
        graph.add(gtsam.BetweenFactorPose3(i, i + 1, step, noise))
        at = at.compose(step)
        values.insert(i + 1, at)
    for n in range(loops):
        i = int(rng.integers(0, poses - 45))
        graph.add(gtsam.BetweenFactorPose3(i, i + 40, measured(i, i + 40, false * (n == loops - 1)), noise))
    return graph, gtsam.LevenbergMarquardtOptimizer(graph, values).optimize(), graph.size() - 1


@pytest.mark.parametrize("sigmas", [10.0, 100.0, 1e3, 1e4])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_false_loop_is_first_at_the_optimum_that_it_bent(sigmas, seed):
    """Seen: factor 11 with T = 6982 named, while the false loop had T = 23 670; both p values were 0."""
    graph, values, loop = in_space(sigmas, seed)
    found = examined(graph, values, draws=0)
    assert int(np.nanargmax(found.factors.deleted)) == loop
    assert loop in found.wrong
    report = slamref.audit(graph, values, draws=0)
    assert report.worst().index[0] == loop
    words = report.words()  # far off, gtsam's search stops before the optimum
    assert f"Factor {loop} " in words or words.startswith("These values are not the optimum")
    assert loop in rejected_factors(found, graph.size())
    if sigmas <= 100.0:
        assert found.wrong.tolist() == [loop]


def test_the_logarithm_of_a_tail_never_ties():
    x = np.array([1.0, 50.0, 600.0, 1300.0])
    for dof in (1, 2, 3, 6, 12):
        np.testing.assert_allclose(log_tail(x, dof), chi2.logsf(x, dof), rtol=1e-6)
        far = log_tail(np.geomspace(1300.0, 1e15, 200), dof)
        assert (np.diff(far) < 0.0).all()
        assert np.isfinite(far).all()
    near = log_tail(np.linspace(1320.0, 1345.0, 400), 6)  # where the probability underflows
    assert (np.diff(near) < 0.0).all()
    np.testing.assert_allclose(np.diff(near), np.diff(near).mean(), rtol=0.02)
