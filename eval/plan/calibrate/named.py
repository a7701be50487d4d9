"""Which systematic errors a log names under plain estimators, by the score test of its residuals; no twins are needed.

An error of `data.inputs.ERRORS` is named if the data ask for it beyond what chance makes the largest of all hypotheses
ask for (Bonferroni). Hypotheses that are none of these errors, as delays, stand beside them and may explain it all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from data import se2
from data.inputs import ERRORS, Inputs, Systematic
from data.motion.stated import stated_all
from data.motion.systematic import BETWEEN_KNOTS
from data.result import Run
from data.se2 import Array
from data.sensors import RangeBearing
from eval.referee import effects, residuals
from eval.referee.attribution import Finding, systematic_errors
from eval.referee.effects import Effect
from eval.referee.residuals import Used

WANDERS = 3.0
"""Standard errors by which successive stretches must err alike: 1 in 700 logs that do not drift has as much."""
FEWEST = 10
"""Stretches, below which their correlation is nobody's witness."""
WRONGLY = 0.01
"""Of logs without errors, the share at most in which an error is named."""
OF_MOTION = {
    "odometry_x_scale": "scale",
    "odometry_theta_curvature": "curvature",
    "odometry_theta_left": "left",
    "odometry_theta_right": "right",
    "odometry_y_distance": "bearing",
    "z1_range": "range",
}
"""By the hypothesis' name `<component>_<regressor>`. Odometry askew to the way driven is a sensor that is."""
ACTING = ("scale", "curvature", "left", "right")
"""Errors that do more to an increment than one of the battery's effects."""
TURNED = 2.0
"""Mean square of a log's turns to one side, in variances of their noise, if there are any: of noise alone it is 1."""
OF_SENSOR = {"range", "bearing"}
"""Errors that points tell, walls not."""
LESS_WELL = ("odometry_x_distance", "odometry_theta_distance", "odometry_theta_turn")
"""Of the battery's effects, those whose place is taken by errors that act as `data.motion.systematic` has it."""


def names_of(inputs: Inputs, smoother: Run) -> tuple[str, ...]:
    """Errors of a log, in their order, that a plain batch smoother's residuals name; none where they name none."""
    if smoother.flaw is not None or smoother.final is None:
        return ()
    path, used = smoother.final.pose, residuals.used_by(smoother, inputs)
    scored = effects.score_of(inputs, path, used, hypotheses(inputs, path, used))
    threshold = -float(special.ndtri(0.5 * WRONGLY / max(len(scored.names), 1)))
    # a noise that is larger than stated makes every score larger
    spread = residuals.typical(residuals.smoothed_residuals(inputs, path, used))
    found = systematic_errors(scored, spread, threshold, len(ERRORS))
    # in SLAM a filter's heading would become too uncertain to linearize about: the smoother gains by it, filters lose
    wandering = inputs.map is not None and wanders(inputs, path)
    return tuple(n for n in named(found, wandering=wandering, inputs=inputs) if turned(inputs, n))


def hypotheses(inputs: Inputs, path: Array, used: Used) -> list[Effect]:
    """The battery's effects, with the odometry's errors exactly as they act (left and right turns apart)."""
    found = [e for e in effects.effects(inputs, path, used) if e.name not in LESS_WELL]
    way = se2.between(path[:-1], path[1:])
    column = np.zeros((len(path), 3, len(ERRORS)))
    # of the way as smoothed: as measured, its noise is that of the residuals
    column[1:] = stated_all(way, np.zeros((len(way), len(ERRORS))), way[:, 2] > 0.0)[2]
    own = [(name, column[:, :, list(ERRORS).index(error)]) for name, error in OF_MOTION.items() if error in ACTING]
    return [Effect(name, motion=c) for name, c in own if c.any()] + found


def named(found: Sequence[Finding], *, wandering: bool, inputs: Inputs) -> tuple[str, ...]:
    """Errors, in their order, for what was found; none where nothing was found that has a name here.

    Of errors that the log cannot tell apart, the one chosen, or if that has no name here the first that has.
    `wandering`: whether the odometry's curvature comes and goes. In SLAM nobody can tell the scale of the odometry from
    that of the ranges; the odometry's is taken, as sensors are mostly the better rulers. A wheelbase that is off spoils
    turns to both sides, so one of them names both.
    """
    bearing = "z2_constant" if isinstance(inputs.sensor, RangeBearing) else "z2_range"
    of = {**OF_MOTION, bearing: "bearing"}
    said = [next((n for n in (f.name, *f.other) if n in of), "") for f in found if f.kind == "systematic"]
    names = {of[f] for f in said if f} | ({"drift"} if wandering else set())
    names |= {"left", "right"} if names & {"left", "right"} else set()
    if inputs.map is None and "range" in names:
        names = names - {"range"} | {"scale"}
    if not inputs.sensor.sees_points:
        names -= OF_SENSOR
    return tuple(name for name in ERRORS if name in names)


def every(inputs: Inputs) -> tuple[str, ...]:
    """All errors that a log may have; in SLAM without the ranges' scale, of which only the odometry's share is seen.

    Of turns, only to sides to which the robot turned; with walls, of the odometry only.
    """
    left_out = OF_SENSOR if not inputs.sensor.sees_points else {"range"} if inputs.map is None else set()
    return tuple(name for name in ERRORS if name not in left_out and turned(inputs, name))


def turned(inputs: Inputs, name: str) -> bool:
    """Whether the robot turned to the side that an error is of (True for others), by more than noise makes of straight.

    The sign of noise chooses the side, so that an error of -1 would explain all of it: nothing is to be asked of it.
    """
    if name not in ("left", "right"):
        return True
    turn, variance = inputs.increments.mean[1:, 2], inputs.increments.covariance[1:, 2, 2]
    side = turn > 0.0 if name == "left" else turn < 0.0
    return bool(np.sum(turn[side] ** 2) > TURNED * np.sum(variance[side]))


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
