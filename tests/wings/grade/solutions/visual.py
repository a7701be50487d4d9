"""Model solution of the assignment `visual`."""

import numpy as np


def turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def to_camera(pose, corners, rotation, translation):
    body = (corners - pose[:2]) @ turn(pose[2])
    return body @ turn(rotation).T + translation


def jacobian(pose, corners, rotation, translation):
    R = turn(rotation) @ turn(pose[2]).T
    body = (corners - pose[:2]) @ turn(pose[2])
    to_heading = np.stack([body[:, 1], -body[:, 0]], axis=1) @ turn(rotation).T
    return np.concatenate([np.tile(-R, (len(corners), 1, 1)), to_heading[:, :, None]], axis=2)


def to_pixels(points, camera):
    return camera[0] * points[:, :2] / points[:, 2:] + camera[1:]


def to_points(pixels, depths, camera):
    return np.column_stack([(pixels - camera[1:]) / camera[0] * depths[:, None], depths])


def noise(points, focal, sigma, k):
    x, z = points[:, 0], points[:, 2]
    R = np.empty((len(points), 2, 2))
    for i in range(len(points)):
        J = np.array([[z[i] / focal, x[i] / z[i]], [0.0, 1.0]])
        R[i] = J @ np.diag([sigma**2, (k * z[i] ** 2) ** 2]) @ J.T
    return R
