"""`python -m ekf.warm`: compile every kernel once, so that no first run has to wait for it."""

from __future__ import annotations

import numpy as np

from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior, Sightings
from data.motion import VelocityModel, VelocityNoise, preintegrate
from data.sensors import RangeBearing
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from ekf.whole_run import run_filter


def main() -> None:
    """Run each kernel on a world of one landmark."""
    time = np.arange(3.0)
    increments, _ = preintegrate(VelocityModel(VelocityNoise("density", (0.1, 0.1))), time, time, 0.1 * time, time)
    sensor, prior = RangeBearing(), Prior(np.zeros(3), 0.01 * np.eye(3))
    z, R = np.array([[2.0, 0.1], [1.5, 0.1], [1.0, 0.1]]), np.tile(0.01 * np.eye(2), (3, 1, 1))
    landmark = LandmarkMap(np.array([0]), np.array([[2.0, 0.2]]))
    inputs = Inputs(
        prior,
        time,
        Increments(increments.mean, increments.covariance),
        Observations(np.arange(3), z, R),
        sensor,
        landmark,
    )
    run_filter(inputs, np.zeros(3, np.int64))
    run_filter(inputs.without_map(), np.array([-1, 0, 0]))
    sensor.inverse(prior.mean, z)
    for model in (EkfLocalizer(prior, sensor, landmark), EkfSlam(prior, sensor)):
        model.predict(inputs.increment(1))
        first = np.array([0]) if isinstance(model, EkfLocalizer) else np.array([-1])
        model.update(Sightings(*inputs.sightings(1)), first)
        expectation = model.expect(inputs.sightings(1))
        expectation.joint(np.array([0]))
        model.update(inputs.sightings(1), np.array([0]), threshold=9.0)


if __name__ == "__main__":
    main()
