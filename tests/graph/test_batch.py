"""The batch smoother: right answers, its chi-square, its covariance, outliers, and what it refuses."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t

from association.decide import known_decisions
from data import se2
from data.errors import SlamrefError
from data.inputs import LabelledObservations
from data.result import DISCARD
from data.sensors import RangeBearing
from ekf.whole_run import run_filter
from graph.batch import smooth
from graph.factors import UnderConstrained
from graph.problem import Start
from tests.graph.worlds import SENSORS, circle, every_sensor, order_of_creation, solved


@every_sensor
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("P0", [None, np.zeros((3, 3)), np.diag([0.01, 0.01, 0.0])], ids=["P0", "zero", "singular"])
def test_noise_free_input_returns_the_truth(sensor, task, P0):
    inputs, truth, xy = circle(sensor, noise=0.0, P0=P0)
    inputs = inputs if task == "localization" else inputs.without_map()
    decisions, created = known_decisions(inputs)
    rng = np.random.default_rng(1)
    wrong = truth + rng.normal(0.0, 0.05, truth.shape)  # the search must find its way back
    ids = order_of_creation(inputs, decisions, created)
    result = smooth(inputs, decisions, created, Start(wrong, xy[ids] + rng.normal(0.0, 0.1, (len(ids), 2))))
    assert np.abs(se2.pose_error(result.trajectory.pose, truth)).max() < 1e-6
    assert result.cost == pytest.approx(0.0, abs=1e-6)
    assert result.last_step < 1e-4
    if task == "slam":
        np.testing.assert_allclose(result.map.xy, xy[ids[result.map.number]], atol=1e-6)
    else:
        assert result.map is None


@pytest.mark.slow
def test_chi_square_has_the_degrees_of_freedom_stated():
    """Its mean over runs, within Student's 99.9 % interval; the count is two a reading, less two a landmark."""
    for task in ("localization", "slam"):
        values = []
        for seed in range(30):
            inputs, _, _ = circle(SENSORS["range-bearing"], frames=20, seed=seed)
            inputs = inputs if task == "localization" else inputs.without_map()
            result, (_, created) = solved(inputs)
            assert result.dof == 2 * len(inputs.observations.frame) - 2 * (created >= 0).sum()
            assert result.total_nis == (result.cost, result.dof)
            values.append(result.cost - result.dof)
        half = t.ppf(0.9995, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values))
        assert abs(np.mean(values)) < half, task


def test_a_robust_loss_costs_no_certainty_where_all_is_well():
    inputs, _, _ = circle(SENSORS["range-bearing"], noise=0.0)
    plain, _ = solved(inputs)
    for loss in ("huber", "cauchy"):
        np.testing.assert_allclose(
            solved(inputs, loss)[0].trajectory.covariance, plain.trajectory.covariance, rtol=1e-6
        )


def test_a_landmark_that_nothing_determines_is_named():
    """A landmark seen once, with a bearing that says nothing."""
    inputs, _, _ = circle(RangeBearing(), noise=0.0)
    inputs = inputs.without_map()
    o = inputs.observations
    R = o.R.copy()
    R[o.label == o.label[3], 1, 1] = 1e30
    inputs = replace(inputs, observations=LabelledObservations(o.frame, o.z, R, o.label))
    decisions, created = known_decisions(inputs)
    once = np.flatnonzero((o.label == o.label[3]) & (created < 0))
    decisions[once] = DISCARD
    number = int(created[(o.label == o.label[3]) & (created >= 0)][0])
    run = run_filter(inputs, decisions)
    with pytest.raises(UnderConstrained, match=rf"landmark {number} is not determined"):
        smooth(inputs, decisions, created, Start(run.pose, run.map.xy))


def test_a_pose_of_infinite_variance_is_named():
    inputs, _, _ = circle(SENSORS["relative point"])
    covariance = inputs.increments.covariance.copy()
    covariance[17] = 1e308 * np.eye(3)
    nothing = np.full(len(inputs.observations.frame), DISCARD)
    start = Start(run_filter(inputs, nothing).pose, np.empty((0, 2)))
    inputs = replace(inputs, increments=replace(inputs.increments, covariance=covariance))
    with pytest.raises(UnderConstrained, match="pose of frame 17 is not determined"):
        smooth(inputs, nothing, np.full(len(nothing), -1), start)


def test_senseless_requests_are_refused():
    inputs, _, _ = circle(SENSORS["range-bearing"])
    decisions, created = known_decisions(inputs)
    pose = np.zeros((len(inputs), 3))
    with pytest.raises(ValueError, match="loss 'tukey'"):
        smooth(inputs, decisions, created, Start(pose, np.empty((0, 2))), loss="tukey")
    with pytest.raises(ValueError, match="finite pose"):
        smooth(inputs, decisions, created, Start(pose * np.nan, np.empty((0, 2))))
    slam = inputs.without_map()
    with pytest.raises(ValueError, match="no position for landmark"):
        smooth(slam, *known_decisions(slam), Start(pose, np.empty((0, 2))))
    decisions = np.full_like(decisions, 77)
    with pytest.raises(SlamrefError, match="no landmark of this id"):
        smooth(inputs, decisions, created, Start(pose, np.empty((0, 2))))
