"""Sightings of walls for batch problems: exact factors, in Python, of a wall as a vector of two.

gtsam's Python API has no line in the plane. A custom factor is exact and cheap where the values are our own, as in
`graph.linear`; gtsam's own optimizers would copy all values in every call, see `graph.walls.poses`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.errors import DataError, UsageError
from data.inputs import IntArray, Systematic
from data.se2 import Array, wrap_angle
from data.sensors import Sensor
from graph.factors import Sighted, noise, root_information, with_loss


def refuse(systematic: Systematic | None, sensor: Sensor) -> None:
    """Raises UsageError where errors of a sensor of walls are to be estimated."""
    if systematic is not None and systematic.of_sensor and not sensor.sees_points:
        raise UsageError(
            "errors of range and bearing are those of a sensor of points; of a sensor of walls only odometry's errors "
            "can be estimated"
        )


def about(lines: Array, point: Array) -> Array:
    """Lines (n, 2), [rho, alpha] about the origin, as [rho, alpha] about a point (2,)."""
    out = np.array(lines, float).reshape(-1, 2)
    out[:, 0] -= np.cos(out[:, 1]) * point[0] + np.sin(out[:, 1]) * point[1]
    out[:, 1] = wrap_angle(out[:, 1])
    return out


def about_origin(lines: Array, covariance: Array, point: Array) -> tuple[Array, Array]:
    """Lines (n, 2) about a point (2,), and their covariances (n, 2, 2), as those about the origin."""
    J = np.tile(np.eye(2), (len(lines), 1, 1))
    J[:, 0, 1] = np.cos(lines[:, 1]) * point[1] - np.sin(lines[:, 1]) * point[0]
    return about(lines, -point), J @ covariance @ J.transpose(0, 2, 1)


def roots(R: Array, frame: IntArray) -> Array:
    """Root information (m, 2, 2) of covariances (m, 2, 2) of readings from frames (m,), or a DataError."""
    found, pivot = root_information(R)
    bad = np.flatnonzero(~(pivot > 0.0))
    if len(bad):
        i = bad[0]
        raise DataError(f"frame {frame[i]}: measurement covariance {R[i].tolist()} is not positive definite")
    return np.asarray(found, float)


def sight_lines(
    sensor: Sensor,
    z: Array,
    R: Array,
    frame: IntArray,
    number: IntArray,
    point: Array,
    loss: str = "gaussian",
    known: Array | None = None,
) -> list[Sighted]:
    """Observations z (m, 2), R (m, 2, 2) of walls `number` (m,) from frames (m,), each one factor.

    SLAM: of poses and walls, vectors [rho, alpha] about a point (2,); `known` (m, 2): where the walls are, about the
    origin. A loss acts on each observation as a whole.
    """
    result = []
    for i, (f, n, root) in enumerate(zip(frame.tolist(), number.tolist(), roots(R, frame), strict=True)):
        model = with_loss(noise.Gaussian.SqrtInformation(root), loss)
        if known is None:
            keys = [X(f), L(n)]
            factor = gtsam.CustomFactor(model, keys, _error(sensor, z[i], keys, point, None))
            result.append(Sighted(f, n, L(n), [factor]))
        else:
            line = about(known[i], point)[0]
            factor = gtsam.CustomFactor(model, [X(f)], _error(sensor, z[i], [X(f)], point, line))
            result.append(Sighted(f, n, None, [factor], xy=known[i]))
    return result


def _error(
    sensor: Sensor, z: Array, keys: list[int], point: Array, line: Array | None
) -> Callable[[gtsam.CustomFactor, gtsam.Values, Any], Array]:
    """Expected less measured (2,), of the two names of the wall the one whose normal is nearer, with Jacobians.

    Nothing changes side where the robot comes to be beyond the wall: its distance is negative there.
    """
    rotation, tx, ty = sensor.extrinsic.tolist()
    ax, ay = point.tolist()
    distance, direction = z.tolist()

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, H: Any) -> Array:
        pose = values.atPose2(keys[0])
        rho, alpha = values.atPoint2(keys[1]) if line is None else line
        x, y = pose.x() - ax, pose.y() - ay
        c, s = math.cos(alpha), math.sin(alpha)
        across = alpha - pose.theta()
        cp, sp = math.cos(across + rotation), math.sin(across + rotation)
        d, arm = rho - c * x - s * y + cp * tx + sp * ty, cp * ty - sp * tx
        turn = math.remainder(across + rotation - direction, math.tau)
        side = 1.0
        if abs(turn) > 0.5 * math.pi:
            side, turn = -1.0, math.remainder(turn - math.pi, math.tau)
        if H is not None:
            ca, sa = math.cos(across), math.sin(across)
            H[0] = np.array([[-side * ca, -side * sa, -side * arm], [0.0, 0.0, -1.0]])
            if line is None:
                H[1] = np.array([[side, side * (s * x - c * y + arm)], [0.0, 1.0]])
        return np.array([side * d - distance, turn])

    return error
