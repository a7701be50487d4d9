"""Systematic errors: the effect of each on odometry and observations, and its estimated size.

Each is the slope of one component against a regressor: distance and turn of an increment, time, range of an
observation, speed and turn rate of the robot. The slope is estimated jointly with path and map (`graph.qr.score_test`);
its standard error is that of the stated noise.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from data import se2
from data.inputs import Inputs, IntArray
from data.result import Systematics
from data.se2 import Array
from data.sensors import RELATIVE_POINT
from eval.referee.residuals import Used, rate_of
from eval.referee.sources import columns
from graph.qr.score_test import OfPoses, Score, systematic

DELAYS, MOUNT = ("latency", "latency_growth"), ("mount_x", "mount_y")


class Effect(NamedTuple):
    """Derivatives of increments (N, 3), observations (M, 2), fixes (F, 3), closures (K, 3) by a systematic error."""

    name: str
    motion: Array | None = None
    observations: Array | None = None
    fixes: Array | None = None
    closures: Array | None = None


def effects(inputs: Inputs, path: Array, used: Used) -> list[Effect]:
    """The systematic errors that the log can show, by name `<component>_<regressor>`.

    `odometry_x_distance` is a share of the distance, `odometry_y_distance` an angle between motion and heading,
    `odometry_theta_distance` a curvature [rad/m], `odometry_theta_turn` a share of the turn, `odometry_theta_time` a
    drift [rad/s], `odometry_latency` its delay [s]; `odometry_{x,y}_turn` m/rad; `odometry_integration` the share of a
    step's turn that was driven before its way; `odometry_current_{x,y}` a drift in the world [m/s] that odometry does
    not see. For observations, `constant` is a bias in the component's unit and
    `range` grows with the range; for points, z1 is then along the ray (a share) and z2 across it (an angle). `latency`
    is the delay [s] of both coordinates, `latency_growth` its growth [s/s], `mount_{x,y}` a displacement of the sensor
    [m], `z2_scale` a share of the second coordinate; in a known map, `map_scale` is a share. Those of fixes and
    closures are in `sources.residuals.columns`.
    """
    found = [Effect(f"odometry_{name}", motion=column) for name, column in _motion(inputs, path).items()]
    found += [Effect(name, observations=column) for name, column in _observations(inputs, path, used).items()]
    found += [Effect(name, fixes=fixes, closures=closures) for name, fixes, closures in columns(inputs, path)]
    return [e for e in found if any(column is not None and np.any(column != 0.0) for column in e[1:])]


def _motion(inputs: Inputs, path: Array) -> dict[str, Array]:
    """Derivatives (N, 3) of the increments, with distance and turn of the smoothed path."""
    step = np.zeros((len(inputs), 3))
    step[1:] = se2.between(path[:-1], path[1:])
    dx, dy, turn = step.T
    distance, zero = np.copysign(np.hypot(dx, dy), dx), np.zeros(len(step))
    time = np.concatenate([[0.0], np.diff(inputs.time)])
    columns = {
        "x_distance": (dx, dy, zero), "x_turn": (turn, zero, zero), "y_distance": (-dy, dx, zero),
        "y_turn": (zero, turn, zero), "theta_distance": (zero, zero, distance), "theta_turn": (zero, zero, turn),
        "theta_time": (zero, zero, time), "integration": (-0.5 * turn * dy, 0.5 * turn * dx, zero),
    }  # fmt: skip
    body = -time[:, None, None] * se2.worlds_from_bodies(np.concatenate([[0.0], path[:-1, 2]]))[:, :2, :2]
    columns |= {"current_x": (*body[:, 0].T, zero), "current_y": (*body[:, 1].T, zero)}
    return {name: np.stack(parts, axis=1) for name, parts in columns.items()} | {"latency": -rate_of(step, inputs.time)}


def _observations(inputs: Inputs, path: Array, used: Used) -> dict[str, Array]:
    """Derivatives (M, 2) of the observations; zero where not paired."""
    o, sensor = inputs.observations, inputs.sensor
    rows = np.flatnonzero(used.number >= 0)
    if not len(rows) or inputs.several_or_partial:
        return {}
    pose, landmark = path[o.frame[rows]], used.landmarks[used.number[rows]]
    z, Hx, Hm = sensor.linearize(pose, landmark)
    reach, one, zero = sensor.polar(z)[:, 0], np.ones(len(rows)), np.zeros(len(rows))
    columns = {"z1_constant": np.stack([one, zero], 1), "z2_constant": np.stack([zero, one], 1)}
    columns["z2_scale"] = np.stack([zero, z[:, 1]], 1)
    if sensor.kind != RELATIVE_POINT:
        columns |= {"z1_range": np.stack([reach, zero], 1), "z2_range": np.stack([zero, reach], 1)}
    else:
        columns |= {"z1_range": z.copy(), "z2_range": np.stack([-z[:, 1], z[:, 0]], 1)}
    late = -np.einsum("mij,mj->mi", Hx, rate_of(path, inputs.time)[o.frame[rows]])
    columns |= {"latency": late, "latency_growth": late * (inputs.time[o.frame[rows], None] - inputs.time[0])}
    # a displacement of the sensor is one of the pose in its own frame
    aside = Hx[:, :, :2] @ se2.worlds_from_bodies(pose[:, 2])[:, :2, :2]
    columns |= {"mount_x": aside[:, :, 0], "mount_y": aside[:, :, 1]}
    if inputs.known_points is not None:
        columns["map_scale"] = -np.einsum("mij,mj->mi", Hm, landmark - used.landmarks.mean(axis=0))
    result = {}
    for name, column in columns.items():
        result[name] = np.zeros((len(o.frame), 2))
        result[name][rows] = column
    return result


@dataclass(frozen=True, eq=False)
class Scored:
    """Names (p) of systematic errors and their scores at size zero."""

    names: tuple[str, ...]
    score: Score

    def slopes(self) -> Mapping[str, tuple[float, float]]:
        """Efficient estimate and standard error of each by itself, where the data have information."""
        score, information = self.score.score, np.diag(self.score.information)
        known = np.flatnonzero(information > 0.0).tolist()
        return {self.names[i]: (float(score[i] / information[i]), 1.0 / math.sqrt(information[i])) for i in known}

    def together(self, chosen: IntArray) -> tuple[Array, Array]:
        """Joint estimates (q,) and standard errors (q,) of the errors `chosen` (q,)."""
        covariance = np.linalg.pinv(self.score.information[np.ix_(chosen, chosen)], rcond=1e-12, hermitian=True)
        return covariance @ self.score.score[chosen], np.sqrt(np.diag(covariance))


def scored(inputs: Inputs, path: Array, used: Used, along: Systematics | None = None) -> Scored:
    """Scores of all systematic errors at a smoothed path (N, 3), jointly with errors estimated `along`."""
    return score_of(inputs, path, used, effects(inputs, path, used), along)


def score_of(
    inputs: Inputs, path: Array, used: Used, hypotheses: Sequence[Effect], along: Systematics | None = None
) -> Scored:
    """Scores of given systematic errors."""
    motion, observed = _columns(inputs, hypotheses)
    of_poses = poses_of(inputs, used, hypotheses)
    score = systematic(inputs, used.number, path, used.landmarks, motion, observed, along, of_poses)
    return Scored(tuple(e.name for e in hypotheses), score)


def poses_of(inputs: Inputs, used: Used, hypotheses: Sequence[Effect] = ()) -> OfPoses | None:
    """The used fixes and closures with the effect of hypotheses on them; None: the log has none."""
    if inputs.fixes is None and inputs.closures is None:
        return None
    f, k = (0 if each is None else len(each) for each in (inputs.fixes, inputs.closures))
    by_fixes = _stacked(f, 3, [e.fixes for e in hypotheses])
    by_closures = _stacked(k, 3, [e.closures for e in hypotheses])
    fixes = np.zeros(f, bool) if used.fixes is None else used.fixes
    return OfPoses(fixes, by_fixes, np.zeros(k, bool) if used.closures is None else used.closures, by_closures)


def without(inputs: Inputs, path: Array, used: Used, sizes: Mapping[str, float]) -> Inputs:
    """The inputs without errors of these sizes, linear about a path (N, 3); delays and displaced sensors exactly."""
    exact = (*DELAYS, *MOUNT) if inputs.sensor.sees_points else ()
    found = [e for e in effects(inputs, path, used) if e.name in sizes and e.name not in exact]
    motion, observations = _columns(inputs, found)
    size = np.array([sizes[e.name] for e in found])
    increments, o, sensor = inputs.increments, inputs.observations, inputs.sensor
    delay, growth, *mount = (sizes.get(name, 0.0) if exact else 0.0 for name in (*DELAYS, *MOUNT))
    z = o.z - observations @ size - _delayed(inputs, delay, growth)
    if sensor.kind != RELATIVE_POINT:
        z = np.column_stack([np.abs(z[:, 0]), se2.wrap_angle(z[:, 1])])
    found_in = poses_of(inputs, used, found)
    fixes, closures = inputs.fixes, inputs.closures
    if found_in is not None and fixes is not None:
        fixes = replace(fixes, z=_less(fixes.z, found_in.by_fixes @ size))
    if found_in is not None and closures is not None:
        closures = replace(closures, relative=_less(closures.relative, found_in.by_closures @ size))
    if any(mount):
        x, y = np.array(sensor.translation) - se2.rotation(sensor.rotation) @ mount
        sensor = replace(sensor, translation=(float(x), float(y)))
    return replace(
        inputs, sensor=sensor, increments=replace(increments, mean=_less(increments.mean, motion @ size)),
        observations=replace(o, z=z), fixes=fixes, closures=closures,
    )  # fmt: skip


def _less(poses: Array, off: Array) -> Array:
    """Poses (n, 3) minus errors `off` (n, 3)."""
    less = poses - off
    less[:, 2] = se2.wrap_angle(less[:, 2])
    return less


def _delayed(inputs: Inputs, delay: float, growth: float) -> Array:
    """What a delay [s] that grows [s/s] does to observations (M, 2) of points: they are of an earlier pose."""
    o, sensor = inputs.observations, inputs.sensor
    if not len(o.frame) or (delay == 0.0 and growth == 0.0):
        return np.zeros((len(o.frame), 2))
    at = inputs.time[o.frame]
    driven = se2.dead_reckoned(np.zeros(3), inputs.increments.mean)
    earlier = se2.interpolate(inputs.time, driven, at - delay - growth * (at - inputs.time[0]))
    body, _ = sensor.body_points(o.z, o.R)
    return np.asarray(sensor.residual(o.z, sensor.predict(driven[o.frame], se2.transform_points(earlier, body))))


def _columns(inputs: Inputs, found: Sequence[Effect]) -> tuple[Array, Array]:
    """Derivatives of all increments (N, 3, p) and observations (M, 2, p)."""
    motion = _stacked(len(inputs), 3, [e.motion for e in found])
    return motion, _stacked(len(inputs.observations.frame), 2, [e.observations for e in found])


def _stacked(n: int, d: int, columns: Sequence[Array | None]) -> Array:
    """Derivatives (n, d, p) by p errors, zero by those without a column."""
    return np.stack([np.zeros((n, d)) if c is None else c for c in columns], axis=2) if columns else np.zeros((n, d, 0))
