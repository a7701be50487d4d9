"""The bare room of the gallery as its camera sees it: colour of walls, floor and ceiling, and the exact depth.

The camera is level, so the depth z at which a pixel's ray meets a wall depends on its column alone, and that of floor
and ceiling on its row alone; the nearest of them is what is seen, for the room is convex.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from data.se2 import Array
from data.visual.rendering.textures import Image, surface
from data.worlds.gallery import NORMALS, Gallery

DENSITY = 100.0
"""px per metre of the painted surfaces, less where they would become wider than `WIDEST`."""
WIDEST = 30_000
FRAME = 0.03
"""m, width of the wooden frame around a picture."""


class View(NamedTuple):
    """What the camera sees of the bare room: rgb (H, W, 3), depth z (H, W) m, and the wall (W,) of each column."""

    rgb: Image
    depth: NDArray[np.float32]
    wall: NDArray[np.int64]


class Room:
    """Painted surfaces of a gallery with the frames of its pictures, corners (L, 4, 3); `owner` (L,): their walls."""

    def __init__(self, g: Gallery, corners: Array, rng: np.random.Generator) -> None:
        self.g = g
        self.density = min(DENSITY, WIDEST / sum(g.wall_lengths))
        self.right = np.column_stack([-NORMALS[:, 1], NORMALS[:, 0]])
        self.half = 0.5 * np.array([g.room_length, g.room_width])
        starts = np.concatenate([[0.0], np.cumsum(g.wall_lengths)[:-1]])
        # m along the unrolled walls = shift + point . right
        self.shift = starts + 0.5 * np.array(g.wall_lengths)
        # the walls unrolled, and below them floor and ceiling side by side
        wide, high, long, deep = (
            int(np.ceil(m * self.density)) for m in (sum(g.wall_lengths), g.room_height, g.room_length, g.room_width)
        )
        self.painted = np.zeros((high + deep, max(wide, 2 * long), 3), np.uint8)
        self.painted[:high, :wide] = surface(wide, high, (196, 189, 172), 6.0, rng)
        self.painted[high:, :long] = surface(long, deep, (122, 98, 76), 14.0, rng)
        self.painted[high:, long : 2 * long] = surface(long, deep, (226, 226, 222), 2.0, rng)
        self.owner = np.repeat(np.arange(len(NORMALS)), g.shares)
        self._panel(self.painted[:high], corners)
        self.below, self.beside = high / self.density, long / self.density
        columns, rows = np.arange(g.image_width), np.arange(g.image_height)
        self.across = (columns - 0.5 * (g.image_width - 1)) / g.focal
        self.down = (rows - 0.5 * (g.image_height - 1)) / g.focal

    def _panel(self, walls: Image, corners: Array) -> None:
        """Paint the skirting board and the frames of the pictures."""
        g, d = self.g, self.density
        walls[round((g.room_height - 0.1) * d) :] = (88, 74, 62)
        for wall, c in zip(self.owner, corners, strict=True):
            along = self.shift[wall] + c[:2, :2] @ self.right[wall]
            top, bottom = g.room_height - c[0, 2], g.room_height - c[2, 2]
            first = round((along[0] - FRAME) * d), round((top - FRAME) * d)
            last = round((along[1] + FRAME) * d), round((bottom + FRAME) * d)
            cv2.rectangle(walls, first, last, (74, 52, 34), -1)

    def look(self, pose: Array) -> View:
        """The view of the robot's camera at pose (3,)."""
        g = self.g
        heading = pose[2] + g.camera_yaw
        c, s = np.cos(pose[2]), np.sin(pose[2])
        eye = pose[:2] + np.array([c * g.camera_x - s * g.camera_y, s * g.camera_x + c * g.camera_y])
        ahead = np.array([np.cos(heading), np.sin(heading)])
        # rays with z = 1: ahead + across * (to the right)
        ray = ahead + self.across[:, None] * np.array([ahead[1], -ahead[0]])
        with np.errstate(divide="ignore"):
            to_wall = np.where(ray > 0, self.half - eye, self.half + eye) / np.abs(ray)
            to_row = np.where(self.down > 0, g.camera_height, g.room_height - g.camera_height) / np.abs(self.down)
        on_x = to_wall[:, 0] < to_wall[:, 1]
        near = np.where(on_x, to_wall[:, 0], to_wall[:, 1])
        wall = np.where(on_x, np.where(ray[:, 0] > 0, 1, 3), np.where(ray[:, 1] > 0, 2, 0))
        depth = np.minimum(near, to_row[:, None]).astype(np.float32)

        point = eye + near[:, None] * ray
        along = self.shift[wall] + np.einsum("wi,wi->w", point, self.right[wall])
        hits_wall = near <= to_row[:, None]
        beside = np.where(self.down > 0, 0.0, self.beside).astype(np.float32)
        flat_x = self._plan(0, eye, ray, depth) + beside[:, None]
        map_x = np.where(hits_wall, along.astype(np.float32), flat_x)
        wall_y = np.float32(g.room_height - g.camera_height) + self.down.astype(np.float32)[:, None] * depth
        flat_y = self._plan(1, eye, ray, depth) + np.float32(self.below)
        map_y = np.where(hits_wall, wall_y, flat_y)
        scale = np.float32(self.density)
        rgb = cv2.remap(
            self.painted, scale * map_x - np.float32(0.5), scale * map_y - np.float32(0.5), cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        return View(np.asarray(rgb, np.uint8), depth, wall)

    def _plan(self, axis: int, eye: Array, ray: Array, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Coordinate `axis` (H, W) of the points seen, counted from the room's corner [m]."""
        place: NDArray[np.float32] = depth * ray[:, axis].astype(np.float32) + np.float32(eye[axis] + self.half[axis])
        return place
