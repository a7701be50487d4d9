"""Sensors, errors and a prior for smoothers that estimate systematic errors."""

import numpy as np

from data.inputs import Systematic
from data.sensors import RangeBearing, RelativePoint

OFF_CENTRE = {"rotation": 0.6, "translation": (0.3, -0.2)}
ODOMETRY = ("scale", "curvature", "left", "right")
ALL = ("scale", "curvature", "left", "right", "drift", "range", "bearing")
SIGMA = {"scale": 0.05, "curvature": 0.05, "left": 0.05, "right": 0.05, "drift": 0.02, "range": 0.05, "bearing": 0.05}
POLAR, CARTESIAN = RangeBearing(max_range=8.0), RelativePoint(max_range=8.0)
POLAR_OFF, CARTESIAN_OFF = RangeBearing(max_range=8.0, **OFF_CENTRE), RelativePoint(max_range=8.0, **OFF_CENTRE)
P0 = np.array([[0.0004, 0.0001, 0.0], [0.0001, 0.0002, 0.0], [0.0, 0.0, 0.0001]])


def to_estimate(*names):
    """Errors with the world's sigmas; a drift with knots every 1.6 m."""
    return Systematic(names, np.array([SIGMA[n] for n in names]), 8.0)
