"""How the gallery's camera sees its pictures: points in the camera's frame, pixels, and what counts as in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data.se2 import Array
from data.worlds.gallery_parameters import Gallery


@dataclass(frozen=True, eq=False)
class Projection:
    """A picture as a camera sees it: number, distance of its middle [m], obliquity [rad], pixels (4, 2), points (4, 3).

    The obliquity is the angle between the picture's normal and the line of sight to its middle; above 90 degrees the
    picture is seen from behind. `pixels` are NaN for corners that are not in front of the camera.
    """

    picture: int
    distance: float
    obliquity: float
    pixels: Array
    points: Array


def in_camera(g: Gallery, pose: Array, points: Array) -> Array:
    """Points (..., 3) m of the world in the camera's frame (x right, y down, z forward), the robot at pose (3,)."""
    sensor = g.sensor()
    plan = sensor.predict(pose, points[..., :2].reshape(-1, 2)).reshape(*points.shape[:-1], 2)
    return np.stack([plan[..., 0], g.camera_height - points[..., 2], plan[..., 1]], axis=-1)


def to_pixels(g: Gallery, points: Array) -> Array:
    """Pixels (..., 2) of points (..., 3) m in the camera's frame; NaN for those not in front of the camera."""
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    middle = 0.5 * np.array([g.image_width - 1, g.image_height - 1])
    pixels: Array = g.focal * points[..., :2] / z[..., None] + middle
    return pixels


def projections(g: Gallery, corners: Array, pose: Array) -> list[Projection]:
    """Every picture as seen from a pose, in view or not."""
    points = in_camera(g, pose, corners)
    pixels = to_pixels(g, points)
    middle = points.mean(axis=1)
    distance = np.linalg.norm(middle, axis=1)
    # downwards x rightwards points out of the wall
    normal = np.cross(points[:, 3] - points[:, 0], points[:, 1] - points[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    obliquity = np.arccos(np.clip(-np.einsum("li,li->l", normal, middle) / distance, -1.0, 1.0))
    return [Projection(i, float(distance[i]), float(obliquity[i]), pixels[i], points[i]) for i in range(len(corners))]


def in_view(g: Gallery, corners: Array, pose: Array) -> list[Projection]:
    """The pictures wholly inside the image, near enough and not too oblique."""
    size = np.array([g.image_width - 1, g.image_height - 1])
    return [
        s
        for s in projections(g, corners, pose)
        if s.distance <= g.max_distance
        and s.obliquity <= g.max_obliquity
        and bool(((s.pixels >= 0) & (s.pixels <= size)).all())
    ]
