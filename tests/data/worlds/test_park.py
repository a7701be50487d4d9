"""The park world: loops of kilometres on an exact grid, readings with the noise they state, trees in proportion."""

from __future__ import annotations

import numpy as np
import pytest

from data.errors import UsageError
from data.se2 import compose, pose_error, wrap_angle
from data.worlds.park import Park
from data.worlds.registry import named_log


@pytest.fixture(scope="module")
def log():
    return named_log("park:3:frames=3000")


def test_the_robot_stays_on_the_grid_and_comes_back_to_every_way(log):
    park, p = Park(frames=3000), log.truth.pose
    across = np.minimum(*(np.abs(p[:, c] - park.side * np.round(p[:, c] / park.side)) for c in (0, 1)))
    assert across.max() < 5.0  # nearer than a turn's radius to a way
    straight = np.abs(wrap_angle(4.0 * p[:, 2])) < 1e-9
    assert across[straight].max() < 1e-9
    _, visits = np.unique(np.round(p[straight, :2], 3), axis=0, return_counts=True)
    assert 2.0 < visits.mean() < 5.0
    assert (np.ptp(p[:, :2], axis=0) > (park.crossings - 1.5) * park.side).all()


def test_stated_noise_is_the_noise(log):
    inputs, truth = log.inputs(), log.truth
    o, park = inputs.observations, Park()
    nu = inputs.sensor.residual(o.z, inputs.sensor.predict(truth.pose[o.frame], inputs.map.xy[truth.landmark_of]))
    far = o.z[:, 0] > 1.0
    np.testing.assert_allclose(nu[far].std(0), [park.sigma_range, park.sigma_bearing], rtol=0.03)
    step = pose_error(compose(truth.pose[:-1], inputs.increments.mean[1:]), truth.pose[1:])
    np.testing.assert_allclose(step[:, 2].std(), park.sigma_omega, rtol=0.05)
    np.testing.assert_allclose(np.hypot(step[:, 0], step[:, 1]).std(), park.sigma_v, atol=0.03)
    # one sample of speed and turn rate: two directions of three are known to the floor or not at all
    assert np.linalg.matrix_rank(inputs.increments.covariance[1], tol=1e-7, hermitian=True) == 2


@pytest.mark.parametrize("key", ["block=19", "detection=1.5", "spacing=0", "frames=0"])
def test_parameters_out_of_range_are_refused(key):
    with pytest.raises(UsageError, match=key.partition("=")[0]):
        named_log(f"park:0:{key}")
