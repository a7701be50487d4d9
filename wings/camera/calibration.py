"""The camera's calibration K as a variable of the graph, estimated with the path from pixels of surveyed corners.

A level pinhole camera with square pixels: u = f x / z + c_u, v = f y / z + c_v, with the corner at (x, z) in the
camera's plan, p_c = R p_b + T, and y below the camera. The map has no heights, so those of each picture's upper and
lower edge are estimated. Variables: the poses, K = (f, c_u, c_v) in px, and two heights per picture.

Source: the calibration factor of structure from motion (Dellaert and Kaess, Factor Graphs for Robot Perception, 2017,
section 5.4), with the poses in the plane.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import Inputs, IntArray
from data.se2 import Array, world_from_body
from data.sensors import Sensor
from graph.factors import UnderConstrained, between_factors, graph_of, noise, pose2, pose_array, prior_factor
from graph.optimum import in_world, poses_of

K = gtsam.symbol("k", 0)
EDGE = np.array([0, 0, 1, 1])  # edge of each corner, in their order: upper left, upper right, lower right, lower left
NEAREST = 0.05  # m, least depth of a corner: a step of the optimizer may take one behind the camera
HEIGHT = 3.0  # m, standard deviation of an edge's height about the camera's: nearly no knowledge
ENOUGH = 1e-10  # predicted decrease of half the sum of squares (1 is a sigma) below which the search has ended
STEPS = 30  # most Gauss-Newton steps after the search by Levenberg and Marquardt


class Sightings(NamedTuple):
    """Pictures in images: frame (D,), picture (D,), and pixels (D, 4, 2) of the corners, with their sigma [px]."""

    frame: IntArray
    picture: IntArray
    pixels: Array
    sigma: float


class Belief(NamedTuple):
    """K before the recording: mean (3,) of f, c_u, c_v and standard deviations (3,) [px]."""

    mean: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """K and the path from the same graph."""

    mean: Array  # (3,) f, c_u, c_v [px]
    covariance: Array  # (3, 3)
    pose: Array  # pose: (N, 3); pose_covariance: (N, 3, 3), world frame
    pose_covariance: Array
    heights: Array  # (L, 2) m, upper and lower edge below the camera; NaN of a picture that was never found
    residual: float  # RMS of the pixels over their sigma


def _height(picture: int) -> int:
    return int(gtsam.symbol("h", picture))


def project(sensor: Sensor, pose: Array, camera: Array, heights: Array, corners: Array) -> tuple[Array, ...]:
    """Pixels (4, 2) of corners (4, 2) in the plan, and Jacobians (4, 2, .) to pose, K and the two heights. The pose's
    is to world-frame errors. A corner nearer than `NEAREST` is taken there.
    """
    x, z = sensor.predict(pose, corners).T
    z = np.maximum(z, NEAREST)
    y, f = heights[EDGE], float(camera[0])
    pixels = np.stack([f * x / z, f * y / z], axis=-1) + camera[1:]
    Hx, _ = sensor.jacobians(pose, corners)
    to_plan = np.zeros((4, 2, 2))
    to_plan[:, 0, 0], to_plan[:, 0, 1], to_plan[:, 1, 1] = f / z, -f * x / z**2, -f * y / z**2
    to_camera = np.zeros((4, 2, 3))
    to_camera[:, 0, 0], to_camera[:, 1, 0], to_camera[:, 0, 1], to_camera[:, 1, 2] = x / z, y / z, 1.0, 1.0
    to_heights = np.zeros((4, 2, 2))
    to_heights[np.arange(4), 1, EDGE] = f / z
    return pixels, to_plan @ Hx, to_camera, to_heights


def pixel_factor(
    sensor: Sensor, frame: int, picture: int, pixels: Array, corners: Array, sigma: float
) -> gtsam.CustomFactor:
    """The factor of one picture's corners: pixels (4, 2), surveyed at corners (4, 2)."""

    def error(this: gtsam.CustomFactor, values: gtsam.Values, H: list[Array] | None) -> Array:
        pose = pose_array(values.atPose2(X(frame)))
        at = project(sensor, pose, values.atVector(K), values.atVector(_height(picture)), corners)
        if H is not None:
            H[0] = at[1].reshape(8, 3) @ world_from_body(float(pose[2]))  # gtsam's error of a pose is in its body frame
            H[1], H[2] = at[2].reshape(8, 3), at[3].reshape(8, 2)
        return np.asarray((at[0] - pixels).ravel())

    call: Callable[..., Array] = error
    return gtsam.CustomFactor(noise.Isotropic.Sigma(8, sigma), [X(frame), K, _height(picture)], call)


def estimate_camera(inputs: Inputs, corners: Array, seen: Sightings, before: Belief, start: Array) -> CameraEstimate:
    """K, path and heights that fit commands, prior and pixels best, not the observations of `inputs`; `corners` (L, 4,
    2) [m]: surveyed, in the plan, `before`: prior of K, `start` (N, 3): poses to search from, as a filter's.
    UnderConstrained: no convergence, or a variable is undetermined.
    """
    steps, _ = between_factors(1, inputs.increments.mean[1:], inputs.increments.covariance[1:])
    found = np.unique(seen.picture).tolist()
    factors = [prior_factor(inputs.prior), *steps]
    factors.append(gtsam.PriorFactorVector(K, before.mean, noise.Diagonal.Sigmas(before.sigma)))
    factors += [gtsam.PriorFactorVector(_height(i), np.zeros(2), noise.Isotropic.Sigma(2, HEIGHT)) for i in found]
    values = gtsam.Values()
    for k, pose in enumerate(start):
        values.insert(X(k), pose2(pose))
    values.insert(K, np.array(before.mean, float))
    heights = _start_heights(inputs.sensor, corners, seen, before.mean, start)
    for i in found:
        values.insert(_height(i), heights[i])
    for frame, picture, pixels in zip(seen.frame.tolist(), seen.picture.tolist(), seen.pixels, strict=True):
        factors.append(pixel_factor(inputs.sensor, frame, picture, pixels, corners[picture], seen.sigma))
    graph = graph_of(factors)
    try:
        values = _optimum(graph, values)
        covariance, *spread = _covariances(graph.linearize(values), [K, *(X(k) for k in range(len(start)))])
    except RuntimeError as error:
        raise UnderConstrained("K: commands, map and pixels leave a variable undetermined") from error
    pose = poses_of(values, len(start))
    edges = np.full((len(corners), 2), np.nan)
    for i in found:
        edges[i] = values.atVector(_height(i))
    residual = [
        (project(inputs.sensor, pose[k], values.atVector(K), edges[i], corners[i])[0] - pixels) / seen.sigma
        for k, i, pixels in zip(seen.frame.tolist(), seen.picture.tolist(), seen.pixels, strict=True)
    ]
    return CameraEstimate(
        np.array(values.atVector(K)), covariance, pose, in_world(pose, np.array(spread)), edges,
        float(np.sqrt(np.mean(np.square(residual)))) if residual else float("nan"),
    )  # fmt: skip


def _optimum(graph: gtsam.NonlinearFactorGraph, start: gtsam.Values) -> gtsam.Values:
    """The values of least cost. Raises UnderConstrained if the search does not end there."""
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("MULTIFRONTAL_QR")  # a robot cannot move sideways: weights differ by 1e10
    values = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
    for _ in range(STEPS):
        linear = graph.linearize(values)
        step = linear.optimize(gtsam.EliminateQR)
        if graph.error(values) - linear.error(step) < ENOUGH:
            return values
        values = values.retract(step)
    raise UnderConstrained(f"K: the search has not converged after {STEPS} steps")


def _covariances(linear: gtsam.GaussianFactorGraph, keys: list[int]) -> list[Array]:
    """Covariance of each variable, by QR as gtsam's `Marginals` cannot."""
    tree = linear.eliminateMultifrontal(gtsam.Ordering.OrderingType.COLAMD, gtsam.EliminateQR)
    found = []
    for key in keys:
        alone = tree.marginalFactor(key, gtsam.EliminateQR)  # R() is a view of its memory
        root = np.linalg.inv(np.triu(alone.R()))
        found.append(root @ root.T)
    return found


def _start_heights(sensor: Sensor, corners: Array, seen: Sightings, camera: Array, start: Array) -> Array:
    """Heights (L, 2) by the median of what each image says with the start's poses and K."""
    said: list[list[Array]] = [[] for _ in corners]
    for k, i, pixels in zip(seen.frame.tolist(), seen.picture.tolist(), seen.pixels, strict=True):
        y = (pixels[:, 1] - camera[2]) * sensor.predict(start[k], corners[i])[:, 1] / camera[0]
        said[i].append(0.5 * (y[[0, 3]] + y[[1, 2]]))
    return np.array([np.median(each, axis=0) if each else np.zeros(2) for each in said])
