"""Measurement models of a landmark: a point by range and bearing or by its place in the sensor's frame, or a wall.

A point landmark is (x, y); a wall is the straight line n(alpha) . x = rho, n = (cos alpha, sin alpha), by its signed
distance rho [m] from the origin and the direction alpha [rad] of its normal; (-rho, alpha + pi) is the same line. Both
are two numbers and so is every measurement.

The formulas stand once, compiled, for one observation (`measure`, `invert`, `residual`); the filters' kernels call
them and the sensor classes of the package loop them over arrays. Frames: w world, b body, s sensor, p_s = R p_b + T.
"""

from __future__ import annotations

import math

import numba

from data import se2

RANGE_BEARING = 0
RELATIVE_POINT = 1
LINE = 2

MIN_RANGE = 1e-6
"""m. A landmark closer to the sensor has no direction: its Jacobians are zero, so it carries no information."""

wrap_angle = numba.njit(cache=True)(se2.wrap_angle)


@numba.njit(cache=True)
def _measure_line(extrinsic, pose, line, z_hat, Hx, Hl):  # type: ignore[no-untyped-def]
    """`measure` for a wall: z = (distance, direction of the normal towards the wall).

    phi = alpha - theta + rotation, d = rho - n(alpha) . p + n(phi) . T. Beyond the wall d is negative, and the normal
    towards it is the other one: z = (-d, phi + pi).
    """
    c, s = math.cos(line[1]), math.sin(line[1])
    phi = line[1] - pose[2] + extrinsic[0]
    arm = math.cos(phi) * extrinsic[2] - math.sin(phi) * extrinsic[1]  # d (n(phi) . T) / d phi
    d = line[0] - c * pose[0] - s * pose[1] + math.cos(phi) * extrinsic[1] + math.sin(phi) * extrinsic[2]
    side = 1.0 if d >= 0.0 else -1.0
    z_hat[0] = side * d
    z_hat[1] = wrap_angle(phi if d >= 0.0 else phi + math.pi)
    Hx[0, 0], Hx[0, 1], Hx[0, 2] = -side * c, -side * s, -side * arm
    Hx[1, 0], Hx[1, 1], Hx[1, 2] = 0.0, 0.0, -1.0
    Hl[0, 0], Hl[0, 1] = side, side * (s * pose[0] - c * pose[1] + arm)
    Hl[1, 0], Hl[1, 1] = 0.0, 1.0


@numba.njit(cache=True)
def _invert_line(extrinsic, pose, z, line, Gx, Gz):  # type: ignore[no-untyped-def]
    """`invert` for a wall: alpha = phi + theta - rotation, rho = d + n(alpha) . p - n(phi) . T."""
    alpha = z[1] + pose[2] - extrinsic[0]
    c, s = math.cos(alpha), math.sin(alpha)
    turn = c * pose[1] - s * pose[0]  # d (n(alpha) . p) / d alpha
    arm = math.cos(z[1]) * extrinsic[2] - math.sin(z[1]) * extrinsic[1]
    line[0] = z[0] + c * pose[0] + s * pose[1] - math.cos(z[1]) * extrinsic[1] - math.sin(z[1]) * extrinsic[2]
    line[1] = wrap_angle(alpha)
    Gx[0, 0], Gx[0, 1], Gx[0, 2] = c, s, turn
    Gx[1, 0], Gx[1, 1], Gx[1, 2] = 0.0, 0.0, 1.0
    Gz[0, 0], Gz[0, 1] = 1.0, turn - arm
    Gz[1, 0], Gz[1, 1] = 0.0, 1.0


@numba.njit(cache=True)
def measure(kind, extrinsic, pose, landmark, z_hat, Hx, Hl):  # type: ignore[no-untyped-def]
    """Expected measurement z_hat (2,), Jacobians Hx (2, 3) to the world-frame pose and Hl (2, 2) to the landmark.

    Probabilistic Robotics, section 6.6 and Table 7.2; `extrinsic` is (rotation, Tx, Ty) of p_s = R p_b + T.
    """
    if kind == LINE:
        _measure_line(extrinsic, pose, landmark, z_hat, Hx, Hl)
        return
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ce, se = math.cos(extrinsic[0]), math.sin(extrinsic[0])
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    bx, by = c * dx + s * dy, -s * dx + c * dy
    px, py = ce * bx - se * by + extrinsic[1], se * bx + ce * by + extrinsic[2]
    # A: d z / d p_s, then through the extrinsic to d z / d p_b
    if kind == RANGE_BEARING:
        r = math.sqrt(px * px + py * py)
        z_hat[0] = r
        z_hat[1] = math.atan2(py, px)
        if r < MIN_RANGE:
            Hx[:, :] = 0.0
            Hl[:, :] = 0.0
            return
        a00, a01, a10, a11 = px / r, py / r, -py / (r * r), px / (r * r)
    else:
        z_hat[0] = px
        z_hat[1] = py
        a00, a01, a10, a11 = 1.0, 0.0, 0.0, 1.0
    b00, b01 = a00 * ce + a01 * se, -a00 * se + a01 * ce
    b10, b11 = a10 * ce + a11 * se, -a10 * se + a11 * ce
    # d p_b / d l = R(theta)^T = -d p_b / d p;  d p_b / d theta = (b_y, -b_x)
    Hl[0, 0] = b00 * c - b01 * s
    Hl[0, 1] = b00 * s + b01 * c
    Hl[1, 0] = b10 * c - b11 * s
    Hl[1, 1] = b10 * s + b11 * c
    for i in range(2):
        Hx[i, 0] = -Hl[i, 0]
        Hx[i, 1] = -Hl[i, 1]
    Hx[0, 2] = b00 * by - b01 * bx
    Hx[1, 2] = b10 * by - b11 * bx


@numba.njit(cache=True)
def invert(kind, extrinsic, pose, z, landmark, Gx, Gz):  # type: ignore[no-untyped-def]
    """Landmark (2,) that would give z, Jacobians Gx (2, 3) to the pose and Gz (2, 2) to the measurement."""
    if kind == LINE:
        _invert_line(extrinsic, pose, z, landmark, Gx, Gz)
        return
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ce, se = math.cos(extrinsic[0]), math.sin(extrinsic[0])
    if kind == RANGE_BEARING:
        cz, sz = math.cos(z[1]), math.sin(z[1])
        px, py = z[0] * cz, z[0] * sz
        a00, a01, a10, a11 = cz, -z[0] * sz, sz, z[0] * cz
    else:
        px, py = z[0], z[1]
        a00, a01, a10, a11 = 1.0, 0.0, 0.0, 1.0
    qx, qy = px - extrinsic[1], py - extrinsic[2]
    bx, by = ce * qx + se * qy, -se * qx + ce * qy
    wx, wy = c * bx - s * by, s * bx + c * by
    landmark[0] = pose[0] + wx
    landmark[1] = pose[1] + wy
    Gx[0, 0], Gx[0, 1], Gx[0, 2] = 1.0, 0.0, -wy
    Gx[1, 0], Gx[1, 1], Gx[1, 2] = 0.0, 1.0, wx
    # R(theta) Re^T A
    m00, m01 = c * ce + s * se, c * se - s * ce
    m10, m11 = s * ce - c * se, s * se + c * ce
    Gz[0, 0] = m00 * a00 + m01 * a10
    Gz[0, 1] = m00 * a01 + m01 * a11
    Gz[1, 0] = m10 * a00 + m11 * a10
    Gz[1, 1] = m10 * a01 + m11 * a11


@numba.njit(cache=True)
def residual(kind, z, z_hat, out):  # type: ignore[no-untyped-def]
    """Innovation z - z_hat (2,); the only place that wraps a measured angle.

    Of a wall, (d, phi) and (-d, phi + pi) are one measurement: the one whose normal is nearer counts.
    """
    out[0] = z[0] - z_hat[0]
    out[1] = z[1] - z_hat[1] if kind == RELATIVE_POINT else wrap_angle(z[1] - z_hat[1])
    if kind == LINE and abs(out[1]) > 0.5 * math.pi:
        out[0] = -z[0] - z_hat[0]
        out[1] = wrap_angle(out[1] - math.pi)


@numba.njit(cache=True)
def name_as_read(kind, z, z_hat, Hx, Hl):  # type: ignore[no-untyped-def]
    """Give a wall's expectation and its Jacobians the name that the reading z has, in place.

    Where it is not sure on which side of a wall the robot is, `measure` may name the other one; the noise of z is that
    of its own name, in which the error of the distance has its own sign.
    """
    if kind == LINE and abs(wrap_angle(z[1] - z_hat[1])) > 0.5 * math.pi:
        z_hat[0] = -z_hat[0]
        z_hat[1] = wrap_angle(z_hat[1] + math.pi)
        for j in range(3):
            Hx[0, j] = -Hx[0, j]
        for j in range(2):
            Hl[0, j] = -Hl[0, j]


@numba.njit(cache=True)
def measure_all(kind, extrinsic, pose, landmarks, z_hat, Hx, Hl):  # type: ignore[no-untyped-def]
    """`measure` landmarks (n, 2), each from its own pose (n, 3)."""
    for i in range(len(landmarks)):
        measure(kind, extrinsic, pose[i], landmarks[i], z_hat[i], Hx[i], Hl[i])


@numba.njit(cache=True)
def invert_all(kind, extrinsic, pose, z, landmark, Gx, Gz):  # type: ignore[no-untyped-def]
    """`invert` measurements (n, 2), each from its own pose (n, 3)."""
    for i in range(len(z)):
        invert(kind, extrinsic, pose[i], z[i], landmark[i], Gx[i], Gz[i])
