"""A pinhole camera by homogeneous matrices: the oracle of the gallery's tests."""

import math

import numpy as np

from wings.camera.gallery import Gallery

PLAIN = Gallery()


def pinhole(g: Gallery, pose: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera points and pixels by homogeneous matrices: world <- body <- camera, then K."""
    x, y, t = pose
    body = np.array([[np.cos(t), -np.sin(t), 0, x], [np.sin(t), np.cos(t), 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
    a = g.camera_yaw
    # columns: the camera's right, down and forward in the body's frame, and where it is mounted
    mount = np.array([
        [np.sin(a), 0, np.cos(a), g.camera_x],
        [-np.cos(a), 0, np.sin(a), g.camera_y],
        [0, -1, 0, g.camera_height],
        [0, 0, 0, 1],
    ])  # fmt: skip
    homogeneous = np.concatenate([points.reshape(-1, 3), np.ones((points.size // 3, 1))], axis=1)
    camera = np.linalg.solve(body @ mount, homogeneous.T)[:3]
    f = (g.image_width / 2) / math.tan(g.field_of_view / 2)
    K = np.array([[f, 0, (g.image_width - 1) / 2], [0, f, (g.image_height - 1) / 2], [0, 0, 1]])
    image = K @ camera
    return camera.T.reshape(points.shape), (image[:2] / image[2]).T.reshape(*points.shape[:-1], 2)
