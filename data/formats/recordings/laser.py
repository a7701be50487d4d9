"""What the estimators get of a recorded laser robot: increments of its odometry, its scans, and no observations."""

from __future__ import annotations

import numpy as np

from data.inputs import Inputs, Observations, Prior, Scans
from data.recordings.wheel_odometry import FLOOR, increments_of, made_increasing
from data.se2 import Array
from data.sensors import RangeBearing


def laser_inputs(pose: Array, stamp: Array, scans: Scans) -> Inputs:
    """Inputs from odometry poses (N, 3) and stamps (N,) [s] in the order they were recorded, and scans.

    The first pose is that of the odometry, exactly: nothing else fixes the frame of the map. Times are the stamps made
    strictly increasing.
    """
    increments, floored = increments_of(pose)
    return Inputs(
        prior=Prior(pose[0], np.zeros((3, 3))),
        time=made_increasing(stamp),
        increments=increments,
        observations=Observations(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2))),
        sensor=RangeBearing(scans.scanner.max_range),
        covariance_floor=FLOOR,
        floored=floored,
        scans=scans,
    )
