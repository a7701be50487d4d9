"""Which systematic errors a log's battery of trust names, in the words of `data.inputs.ERRORS`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from data import se2
from data.inputs import ERRORS, Inputs, Systematic
from data.motion.systematic import BETWEEN_KNOTS
from data.se2 import Array
from data.sensors import RangeBearing
from eval.referee.attribution import Finding

WANDERS = 3.0
"""Standard errors by which successive stretches must err alike: 1 in 700 logs that do not drift has as much."""
FEWEST = 10
"""Stretches, below which their correlation is nobody's witness."""
OF_MOTION = {
    "odometry_x_distance": ("scale",),
    "odometry_theta_distance": ("curvature",),
    "odometry_theta_turn": ("left", "right"),
    "odometry_y_distance": ("bearing",),
    "z1_range": ("range",),
}
"""By the battery's name `<component>_<regressor>`. Odometry askew to the way driven is a sensor that is."""


def named(found: Sequence[Finding], *, wandering: bool, inputs: Inputs) -> tuple[str, ...]:
    """Errors of a log, in their order, for what the battery found; none where it found nothing that has a name here.

    Of errors that the log cannot tell apart, the battery's own choice, or if that has no name here the first that has.
    `wandering`: whether the odometry's curvature comes and goes. In SLAM nobody can tell the scale of the odometry from
    that of the ranges; the odometry's is taken, as sensors are mostly the better rulers.
    """
    bearing = "z2_constant" if isinstance(inputs.sensor, RangeBearing) else "z2_range"
    of = {**OF_MOTION, bearing: ("bearing",)}
    said = [next((n for n in (f.name, *f.other) if n in of), "") for f in found if f.kind == "systematic"]
    names = {name for f in said for name in of.get(f, ())} | ({"drift"} if wandering else set())
    if inputs.map is None and "range" in names:
        names = names - {"range"} | {"scale"}
    return tuple(name for name in ERRORS if name in names)


def every(inputs: Inputs) -> tuple[str, ...]:
    """All errors that a log may have; in SLAM without the ranges' scale, of which only the odometry's share is seen."""
    return tuple(name for name in ERRORS if inputs.map is not None or name != "range")


def wanders(inputs: Inputs, path: Array) -> bool:
    """Whether the heading's residuals at a smoothed path (N, 3) say that a curvature comes and goes.

    In stretches as long as the knots of the drift are apart, each says how much the odometry curves more than it does
    on the whole, in sigmas; neighbours say it alike if that is more than noise.
    """
    off = inputs.increments.mean[1:] - se2.between(path[:-1], path[1:])
    variance = inputs.increments.covariance[1:, 2, 2]
    step = inputs.increments.mean[1:]
    distance = np.copysign(np.hypot(step[:, 0], step[:, 1]), step[:, 0])
    weight = np.divide(distance, variance, out=np.zeros(len(step)), where=variance > 0.0)
    stretch = (np.cumsum(np.abs(distance)) / (BETWEEN_KNOTS * Systematic.length)).astype(np.int64)
    score = np.bincount(stretch, weight * se2.wrap_angle(off[:, 2]))
    information = np.bincount(stretch, weight * distance)
    told = information > 0.0
    if told.sum() < FEWEST or not score.any():
        return False
    score, information = score[told], information[told]
    left = (score - score.sum() / information.sum() * information) / np.sqrt(information)
    alike = float(left[1:] @ left[:-1]) / float(left @ left)
    return alike * math.sqrt(len(left)) > WANDERS
