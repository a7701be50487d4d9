"""Two models of odometry side by side: the innovations tell which of them the log was driven with."""

import numpy as np
import pytest

from association.decide import known_decisions
from data.inputs import FrameObservations, Increment, Prior, Systematic
from data.result import NEW
from data.sensors import RangeBearing
from data.worlds.park import Park, simulate
from ekf.slam import EkfSlam
from eval.replay.hindsight.mapper import DECIDED, TwoModels

LOG = simulate(Park(frames=400, sigma_omega=0.001), 1).inputs(labels=True).without_map()
R = np.diag([0.1**2, 0.02**2])
ERRORS = Systematic(("curvature", "left", "right", "drift"), np.array([0.01, 0.1, 0.1, 1e-3]), 50.0)


@pytest.mark.parametrize(("error", "model"), [(0.0, None), (0.01, ERRORS)])
def test_the_model_that_the_log_was_driven_with_stays_alone(error, model):
    """`error`: rad per metre to the left, which the odometry does not tell of."""
    both = TwoModels(LOG.prior, LOG.sensor, ERRORS)
    alone = EkfSlam(LOG.prior, LOG.sensor, systematic=model)
    decisions, _ = known_decisions(LOG)
    for k in range(len(LOG)):
        frame = LOG.frame(k)
        for each in (both, alone):
            if frame.increment is not None:
                mean, covariance = frame.increment
                each.predict(Increment(mean - np.array([0.0, 0.0, error * np.hypot(*mean[:2])]), covariance))
            if len(frame.observations.z):
                each.update(frame.observations, decisions[frame.first : frame.first + len(frame.observations.z)])
    assert (both.believed.errors is None) == (model is None)
    assert abs(both.log_odds) > DECIDED
    np.testing.assert_array_equal(both.believed.mean, alone.mean)
    np.testing.assert_array_equal(both.believed.covariance, alone.covariance)


def test_what_is_taken_back_leaves_both():
    both = TwoModels(Prior(np.zeros(3), np.zeros((3, 3))), RangeBearing(), ERRORS)
    points = np.array([[5.0, 0.0], [6.0, 0.1], [7.0, 0.5]])
    both.update(FrameObservations(points, np.tile(R, (3, 1, 1))), np.full(3, NEW))
    both.each(lambda slam: slam.merge(np.array([1]), np.array([0])))
    both.each(lambda slam: slam.remove(np.array([2])))
    both.each(lambda slam: slam.inflate(3.0 * np.eye(3)))
    for odds in (-6.0, 0.0):
        both.log_odds = odds
        assert len(both.believed.xy) == 1
        assert np.trace(both.believed.covariance[:3, :3]) >= 9.0
