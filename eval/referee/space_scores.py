"""Consistency and proper scores of a result in space: NEES of named errors, bounds per axis, intervals.

With T the true pose and M the stated mean, the errors are Log(M^-1 T) (left-invariant), Log(T M^-1) (right-invariant),
and position in the world beside Log(R_T R_M') (decoupled). The covariance is taken from the file's convention to each
to first order at M; the three agree where errors are small. NEES of a consistent estimator is 6, of position or
rotation 3.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data import se3
from data.formats.results.path import LEFT, LOCAL, MIXED, WORLD
from data.formats.results.space import in_world
from data.se2 import Array
from eval.referee.consistency import crps, log_score, mean_or_nan, squared_distance
from eval.referee.given import in_space
from eval.referee.intervals import SEED, intervals

CONVENTIONS = {LOCAL: "left-invariant", LEFT: "right-invariant", WORLD: "decoupled", MIXED: "decoupled"}
"""Error whose covariance a file states, by the frame of the covariance."""
ERRORS = ("left_invariant", "right_invariant", "decoupled")
AXES = ("x", "y", "z", "rx", "ry", "rz")  # position and rotation about the world's axes


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors (n, 6), translation first, and their covariances (n, 6, 6); NaN where unknown."""

    value: Array
    covariance: Array


def errors_of(both: in_space.InSpace) -> Mapping[str, Errors]:
    """The named errors of an estimate with covariance, and the covariance of each; empty without one."""
    e = both.estimate
    if e.covariance is None:
        return {}
    known = both.truth.known
    R, p = e.rotation, e.position
    T_R, T_p = both.truth.rotation[known], both.truth.position[known]
    M_R, M_p = R[known], p[known]
    back = np.swapaxes(M_R, -1, -2)
    value = {name: np.full((len(e), 6), np.nan) for name in ERRORS}
    value["left_invariant"][known] = se3.log_motion(back @ T_R, np.einsum("nij,nj->ni", back, T_p - M_p))
    turn = T_R @ back
    value["right_invariant"][known] = se3.log_motion(turn, T_p - np.einsum("nij,nj->ni", turn, M_p))
    value["decoupled"][known] = np.concatenate([T_p - M_p, se3.log_rotation(turn)], axis=1)
    world = in_world(e)
    J = np.zeros((len(e), 6, 6))
    J[:] = np.eye(6)
    J[:, :3, 3:] = se3.skew(p)  # rho = dp + p x w
    right = e.covariance if e.frame == LEFT else J @ world @ np.swapaxes(J, -1, -2)
    B = np.zeros((len(e), 6, 6))
    B[:, :3, :3] = B[:, 3:, 3:] = np.swapaxes(R, -1, -2)
    left = e.covariance if e.frame == LOCAL else B @ world @ np.swapaxes(B, -1, -2)
    return {n: Errors(value[n], C) for n, C in zip(ERRORS, (left, right, world), strict=True)}


def columns_in_space(both: in_space.InSpace) -> dict[str, float]:
    """Every number in space by its name; NaN ones are left out."""
    estimate, truth = in_space.poses(both.estimate), both.truth
    found: dict[str, float | None] = dict(in_space.absolute_columns(estimate, truth))
    found |= in_space.aligned_columns(both.original, truth)
    found |= in_space.relative_columns(estimate, truth, both.estimate.time, both.pairs)
    errors = errors_of(both)
    squared = in_space.distances(estimate, truth) ** 2
    pose_nees = np.full(len(squared), np.nan)
    if errors:
        each = {name: squared_distance(e.value, e.covariance) for name, e in errors.items()}
        found |= {f"nees_3d_{name}": mean_or_nan(values) for name, values in each.items()}
        world = errors["decoupled"]
        for name, part in (("position", slice(0, 3)), ("rotation", slice(3, 6))):
            squares = squared_distance(world.value[:, part], world.covariance[:, part, part])
            found[f"nees_3d_{name}"] = mean_or_nan(squares)
        pose_nees = each["decoupled"]
        found |= _parts(world)
    rmse, nees = intervals(squared, pose_nees, np.random.default_rng(SEED))
    for name, interval in (("rmse_position_3d", rmse), ("nees_3d_decoupled", nees)):
        found |= {f"{name}_lower": interval.lower, f"{name}_upper": interval.upper}
    return {name: value for name, value in found.items() if value is not None and math.isfinite(value)}


def _parts(world: Errors) -> dict[str, float]:
    """By axis: RMS error and sigma, share inside 3 sigma (0.9973 expected), CRPS; log score of the pose [nats]."""
    axes, each = dict[str, float](), dict[str, float]()
    variance = np.einsum("nii->ni", world.covariance)
    for k, axis in enumerate(AXES):
        known = np.isfinite(world.value[:, k]) & (variance[:, k] > 0.0)
        error, var = world.value[known, k], variance[known, k]
        if known.any():
            unit = "m" if k < 3 else "rad"
            axes[f"rms_{axis}_3d_{unit}"] = math.sqrt(float(np.mean(error**2)))
            axes[f"sigma_{axis}_3d_{unit}"] = math.sqrt(float(np.mean(var)))
            axes[f"inside_3sigma_{axis}_3d"] = float(np.mean(error**2 <= 9.0 * var))
            each[f"crps_{axis}_3d_{unit}"] = float(crps(error, np.sqrt(var)).mean())
    whole = np.isfinite(squared_distance(world.value, world.covariance))
    if whole.any():
        axes["log_score_3d"] = float(log_score(world.value[whole], world.covariance[whole]).mean())
    return axes | each
