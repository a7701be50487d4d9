"""A filter that carries the odometry's errors behind its landmarks cannot carry parked ones there, and says so."""

from __future__ import annotations

import numpy as np
import pytest

from data.inputs import Increment, Prior, Sightings
from data.result import NEW
from data.sensors import RelativePoint
from ekf.calibrating import CalibratingSlam


def mapped():
    """The filter after a frame with three landmarks, and the frame."""
    f = CalibratingSlam(Prior(np.zeros(3), 0.01 * np.eye(3)), RelativePoint())
    seen = Sightings(np.array([[3.0, 1.0], [4.0, -1.0], [5.0, 2.0]]), np.tile(0.01 * np.eye(2), (3, 1, 1)))
    f.update(seen, np.full(3, NEW))
    return f, seen


def test_a_landmark_cannot_be_parked():
    f, _ = mapped()
    with pytest.raises(ValueError, match="none can be parked"):
        f.park(np.array([1]))
    assert not len(f.parked)


def test_after_the_refusal_the_filter_goes_on_as_if_it_had_not_been_asked():
    (asked, seen), (twin, _) = mapped(), mapped()
    with pytest.raises(ValueError, match="none can be parked"):
        asked.park(np.array([0, 2]))
    for f in (asked, twin):
        f.predict(Increment(np.array([1.0, 0.0, 0.1]), 1e-4 * np.eye(3)))
        f.update(seen, np.arange(3))
    assert np.array_equal(asked.mean, twin.mean)
    assert np.array_equal(asked.covariance, twin.covariance)
