"""Planar poses [x m, y m, theta rad] as plain arrays: wrap, compose, invert, relate.

Functions broadcast over all but the last axis, which is 3. `T_ab` is the pose of frame b in frame a.
"""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Angle = TypeVar("Angle", float, Array)

TWO_PI = 2.0 * math.pi


def wrap_angle(angle: Angle) -> Angle:
    """Angle [rad] wrapped to (-pi, pi]; a value inside is returned bit for bit."""
    wrapped: Angle = angle - TWO_PI * np.ceil((angle - math.pi) / TWO_PI)
    return wrapped


def rotation(theta: float) -> Array:
    """Rotation matrix (2, 2) of an angle [rad]."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s], [s, c]])


def world_from_body(theta: float) -> Array:
    """blockdiag(R(theta), 1), (3, 3): turns body-frame errors of a pose into world-frame ones."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def worlds_from_bodies(theta: Array) -> Array:
    """`world_from_body` of headings (N,): (N, 3, 3)."""
    B = np.zeros((len(theta), 3, 3))
    c, s = np.cos(theta), np.sin(theta)
    B[:, 0, 0], B[:, 0, 1], B[:, 1, 0], B[:, 1, 1], B[:, 2, 2] = c, -s, s, c, 1.0
    return B


def covariances_in_world(theta: Array, covariance: Array) -> Array:
    """World-frame covariances B C B' (N, 3, 3) from body-frame ones of poses with headings (N,)."""
    B = worlds_from_bodies(theta)
    return np.asarray(B @ covariance @ B.transpose(0, 2, 1))


def covariances_in_body(theta: Array, covariance: Array) -> Array:
    """Body-frame covariances B' C B (N, 3, 3) from world-frame ones of poses with headings (N,)."""
    B = worlds_from_bodies(theta)
    return np.asarray(B.transpose(0, 2, 1) @ covariance @ B)


def compose(T_ab: Array, T_bc: Array) -> Array:
    """Pose of c in a, heading wrapped; (..., 3) each."""
    a, b = np.asarray(T_ab, float), np.asarray(T_bc, float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x, y = a[..., 0] + c * b[..., 0] - s * b[..., 1], a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack([x, y, wrap_angle(a[..., 2] + b[..., 2])], axis=-1)


def inverse(T_ab: Array) -> Array:
    """Pose of a in b; (..., 3)."""
    a = np.asarray(T_ab, float)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], wrap_angle(-a[..., 2])], axis=-1)


def between(T_wa: Array, T_wb: Array) -> Array:
    """Pose of b in a from the poses of both in w; (..., 3) each."""
    return compose(inverse(T_wa), T_wb)


def pose_error(estimate: Array, truth: Array) -> Array:
    """World-frame additive error `estimate - truth`, heading wrapped to (-pi, pi]; (..., 3)."""
    error: Array = np.asarray(estimate, float) - np.asarray(truth, float)
    error[..., 2] = wrap_angle(error[..., 2])
    return error


def transform_points(T_wb: Array, points_b: Array) -> Array:
    """Points (..., 2) of frame b in w, for one pose (3,) or a pose per point."""
    at, p = np.asarray(T_wb, float), np.asarray(points_b, float)
    c, s = np.cos(at[..., 2]), np.sin(at[..., 2])
    return np.stack([at[..., 0] + c * p[..., 0] - s * p[..., 1], at[..., 1] + s * p[..., 0] + c * p[..., 1]], axis=-1)


def rigid_fit(body: Array, world: Array) -> Array:
    """Pose (3,) of the frame of points `body` (M, 2) at `world` (M, 2), by least squares (Umeyama 1991, no scale)."""
    body_mean, world_mean = body.mean(axis=0), world.mean(axis=0)
    b, w = body - body_mean, world - world_mean
    theta = math.atan2(float(np.sum(b[:, 0] * w[:, 1] - b[:, 1] * w[:, 0])), float(np.sum(b * w)))
    xy = world_mean - rotation(theta) @ body_mean
    return np.array([xy[0], xy[1], theta])


def along_arcs(way: Array, turn: Array) -> Array:
    """Increments (N, 3) along arcs of lengths and turns (N,)."""
    chord = way * np.sinc(0.5 * turn / np.pi)
    return np.stack([chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn], axis=-1)


def dead_reckoned(start: Array, increments: Array) -> Array:
    """Poses (N, 3) from `start` (3,) along increments (N, 3), the first row included; headings not wrapped."""
    heading = start[2] + np.cumsum(increments[:, 2])
    before = np.concatenate([start[2:], heading[:-1]])
    c, s = np.cos(before), np.sin(before)
    dx, dy = increments[:, 0], increments[:, 1]
    return np.stack([start[0] + np.cumsum(c * dx - s * dy), start[1] + np.cumsum(s * dx + c * dy), heading], axis=-1)


def interpolate(times: Array, poses: Array, at: Array) -> Array:
    """Poses (K, 3) at stamps `at` [s]: linear, headings along the shorter arc; outside of `times` the nearest pose."""
    heading = np.unwrap(poses[:, 2])
    x, y = np.interp(at, times, poses[:, 0]), np.interp(at, times, poses[:, 1])
    return np.stack([x, y, wrap_angle(np.interp(at, times, heading))], axis=-1)
