"""An optimum turned out of the sensor's frame: path and map of the robot in the world, and the errors."""

from __future__ import annotations

import numpy as np

from data.result import MapState, Systematics, Trajectory
from data.se2 import Array
from graph.linear.solution import Solution
from graph.problem import Calibrated


def turned_out(
    calibrated: Calibrated, errors: Array, solution: Solution, pose: Array, covariance: Array, state: MapState | None
) -> tuple[Trajectory, MapState | None, Systematics]:
    """Path, map (None where it was known) and systematic errors.

    Args:
        calibrated: what is estimated.
        errors: (N, p) at the optimum.
        solution: there.
        pose: (N, 3) in the frame.
        covariance: (V, 3, 3) of all variables: poses in body frames, the first one that of the robot itself; landmarks
            in the frame; drifts in squared sigmas.
        state: landmarks in the frame.
    """
    n = len(errors)
    sigma, at = calibrated.systematic.sigma, calibrated.constant
    of_errors = solution.covariance * np.outer(sigma[at], sigma[at])
    across = -solution.columns @ (solution.covariance * sigma[at])
    out, J = calibrated.frame.poses_out(pose, errors)
    of_path = _joint(covariance[:n], across[:n], of_errors)
    # from the body frame there to the world, and from there to the robot's own world
    J = J[:, :, np.concatenate([np.arange(3), 3 + at])]
    J[:, :, :3] = J[:, :, :3] @ _world_from_body(pose[:, 2])
    world = J @ of_path @ J.transpose(0, 2, 1)
    B = _world_from_body(out[:1, 2])[0]
    world[0] = B @ covariance[0] @ B.T
    path = Trajectory(out, 0.5 * (world + world.transpose(0, 2, 1)))
    if state is not None:
        rows = slice(n, n + len(state.number))
        xy, scale, by_errors = calibrated.frame.points_out(state.xy, errors[-1])
        joint = _joint(covariance[rows, :2, :2], across[rows, :2], of_errors)
        J = np.concatenate([np.tile(scale * np.eye(2), (len(xy), 1, 1)), by_errors[:, :, at]], axis=2)
        state = MapState(state.number, xy, J @ joint @ J.transpose(0, 2, 1))
    deviation = np.empty_like(errors)
    deviation[:, at] = np.sqrt(np.diag(of_errors))
    if calibrated.knots:
        deviation[:, calibrated.drift_at] = (
            np.sqrt(covariance[-calibrated.knots :, 0, 0])[calibrated.of] * sigma[calibrated.drift_at]
        )
    return path, state, Systematics(calibrated.systematic.names, errors, deviation)


def _joint(own: Array, across: Array, of_errors: Array) -> Array:
    """Covariances (n, d + q, d + q) of each of n and the constant errors."""
    n, d, q = across.shape
    joint = np.empty((n, d + q, d + q))
    joint[:, :d, :d], joint[:, d:, d:] = own, of_errors
    joint[:, :d, d:], joint[:, d:, :d] = across, across.transpose(0, 2, 1)
    return joint


def _world_from_body(heading: Array) -> Array:
    """blockdiag(R(heading), 1), (n, 3, 3)."""
    B = np.zeros((len(heading), 3, 3))
    c, s = np.cos(heading), np.sin(heading)
    B[:, 0, 0], B[:, 0, 1], B[:, 1, 0], B[:, 1, 1], B[:, 2, 2] = c, -s, s, c, 1.0
    return B
