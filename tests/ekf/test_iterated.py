"""The iterated update: the Gauss-Newton optimum of one frame, and the plain update where everything is linear."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from data.inputs import FrameObservations, LandmarkMap, Prior
from data.se2 import wrap_angle
from data.sensors import RangeBearing
from ekf.filter import FilterOptions
from ekf.localizer import EkfLocalizer

LANDMARKS = LandmarkMap(np.arange(3), np.array([[2.0, 1.0], [-1.0, 2.5], [1.0, -3.0]]))
PRIOR = Prior(np.array([0.4, -0.3, 0.5]), np.diag([0.5, 0.5, 0.3]))
R = np.tile(np.diag([0.01, 0.001]), (3, 1, 1))


def observations():
    z = RangeBearing().predict(np.array([-0.2, 0.3, 0.1]), LANDMARKS.xy)
    return FrameObservations(z, R)


def test_the_update_ends_at_the_least_cost_and_its_covariance_is_the_inverse_information_there():
    f = EkfLocalizer(PRIOR, RangeBearing(), LANDMARKS, FilterOptions(iterations=50))
    f.update(observations(), np.arange(3))
    pose, P = f.estimate()
    W = np.linalg.inv(np.linalg.cholesky(R))
    W0 = np.linalg.inv(np.linalg.cholesky(PRIOR.covariance))

    def residuals(x):
        d = LANDMARKS.xy - x[:2]
        bearing = np.arctan2(d[:, 1], d[:, 0]) - x[2]
        nu = observations().z - np.stack([np.hypot(d[:, 0], d[:, 1]), bearing], axis=1)
        nu[:, 1] = wrap_angle(nu[:, 1])
        return np.concatenate([W0 @ (x - PRIOR.mean), np.einsum("nij,nj->ni", W, nu).ravel()])

    best = least_squares(residuals, PRIOR.mean, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(pose, best.x, atol=1e-6)
    np.testing.assert_allclose(P, np.linalg.inv(best.jac.T @ best.jac), rtol=1e-4, atol=1e-8)
    plain = EkfLocalizer(PRIOR, RangeBearing(), LANDMARKS)
    plain.update(observations(), np.arange(3))
    cost = [np.sum(residuals(x) ** 2) for x in (plain.estimate().mean, pose)]
    assert cost[1] < 0.5 * cost[0]


def test_innovation_statistics_are_those_at_the_prediction():
    plain, iterated = (EkfLocalizer(PRIOR, RangeBearing(), LANDMARKS, FilterOptions(iterations=n)) for n in (1, 9))
    a, b = (f.update(observations(), np.arange(3)) for f in (plain, iterated))
    assert (a.nis, a.dof) == pytest.approx((b.nis, b.dof), rel=1e-12)
    assert a.log_likelihood == pytest.approx(b.log_likelihood, rel=1e-12)
