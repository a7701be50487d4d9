"""The gallery's surfaces: distinct pictures full of features, and the bare room as its camera sees it.

Everything is drawn from a generator, reproducibly. The camera is level, so the depth z at which a pixel's ray meets a
wall depends on its column alone, and that of floor and ceiling on its row alone; the nearest of them is seen, since the
room is convex.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from data.se2 import Array
from wings.camera.gallery import NORMALS, Gallery

Image = NDArray[np.uint8]
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijkmnopqrstuvwxyz0123456789&?!%"


def picture(number: int, width: int, height: int, rng: np.random.Generator) -> Image:
    """A picture (height, width, 3), RGB; its number chooses the style."""
    style = (_shapes, _mosaic, _poster, _strata, _blocks, _strokes)[number % 6]
    canvas = _ground(width, height, rng)
    style(canvas, rng)
    _confetti(canvas, rng)
    grain = rng.normal(0.0, 4.0, (height, width, 1))
    return _image(canvas + grain)


def surface(width: int, height: int, colour: tuple[int, int, int], contrast: float, rng: np.random.Generator) -> Image:
    """A surface (height, width, 3) of one colour with noise of `contrast` grey levels (standard deviation)."""
    mottle = contrast * _fractal(width, height, 3, rng, 1.1)
    return _image(np.array(colour) + mottle[:, :, None])


def _image(values: Array) -> Image:
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)


def _fractal(
    width: int, height: int, finest: int, rng: np.random.Generator, growth: float = 1.4
) -> NDArray[np.float32]:
    """Noise (height, width) of mean 0 and variance 1: octaves from `finest` px up, each `growth` times as strong."""
    total = np.zeros((height, width), np.float32)
    scale, weight = finest, 1.0
    while scale < max(width, height):
        coarse = rng.standard_normal((height // scale + 2, width // scale + 2)).astype(np.float32)
        total += weight * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        scale, weight = 2 * scale, growth * weight
    return np.asarray((total - total.mean()) / total.std(), np.float32)


def _palette(n: int, rng: np.random.Generator) -> Array:
    """Colours (n, 3), of every brightness."""
    grey = rng.permutation(np.linspace(15.0, 240.0, n))
    tint = rng.normal(0.0, 55.0, (n, 3))
    return np.asarray(np.clip(grey[:, None] + tint - tint.mean(axis=1, keepdims=True), 0, 255))


def _ground(width: int, height: int, rng: np.random.Generator) -> Array:
    """Background (height, width, 3): clouds between two colours."""
    low, high = _palette(2, rng)
    mix = 1.0 / (1.0 + np.exp(-1.5 * _fractal(width, height, 16, rng)))[:, :, None]
    return np.ascontiguousarray(low + (high - low) * mix)


def _shapes(canvas: Array, rng: np.random.Generator) -> None:
    """Discs, rings, triangles and quadrilaterals, large ones first."""
    h, w = canvas.shape[:2]
    for colour, size in zip(_palette(170, rng), np.geomspace(0.22 * w, 0.012 * w, 170), strict=True):
        x, y = rng.uniform(0, w), rng.uniform(0, h)
        kind = rng.integers(4)
        if kind < 2:
            thick = -1 if kind == 0 else max(int(0.25 * size), 2)
            cv2.circle(canvas, (int(x), int(y)), int(0.5 * size), colour, thick, cv2.LINE_8)
            continue
        angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, kind + 1))
        corners = np.array([x, y]) + 0.7 * size * np.column_stack([np.cos(angle), np.sin(angle)])
        cv2.fillPoly(canvas, [np.rint(corners).astype(np.int32)], colour)


def _mosaic(canvas: Array, rng: np.random.Generator) -> None:
    """Cells about random centres, with grout between them."""
    h, w = canvas.shape[:2]
    centres = rng.uniform(0.0, 1.0, (320, 2)) * np.array([w, h])
    x, y = np.meshgrid(np.arange(w), np.arange(h))
    distance, cell = (
        np.asarray(found) for found in scipy.spatial.cKDTree(centres).query(np.stack([x, y], axis=-1), k=2)
    )
    canvas[:] = _palette(len(centres), rng)[cell[:, :, 0]]
    canvas[distance[:, :, 1] - distance[:, :, 0] < 2.0] = 25.0


def _poster(canvas: Array, rng: np.random.Generator) -> None:
    """Lines of letters in many sizes."""
    h, w = canvas.shape[:2]
    y = 0.0
    while y < h:
        size = rng.uniform(0.03, 0.14) * h
        y += 1.25 * size
        font = (cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_SIMPLEX)[rng.integers(3)]
        words = "".join(rng.choice(list(LETTERS + "    "), 60))
        ink = _palette(2, rng)[0] * np.array(0.5)
        page = np.zeros((h, w), np.uint8)
        cv2.putText(page, words, (int(rng.uniform(-30, 10)), int(y)), font, size / 22.0, 255, max(int(size / 9), 1))
        canvas[page > 0] = ink if canvas.mean() > 110 else 255.0 - ink


def _strata(canvas: Array, rng: np.random.Generator) -> None:
    """Layers of a map: one colour for each height of a random relief."""
    h, w = canvas.shape[:2]
    relief = _fractal(w, h, 9, rng)
    level = np.digitize(relief, np.linspace(-2.0, 2.0, 15))
    canvas[:] = _palette(16, rng)[level]


def _blocks(canvas: Array, rng: np.random.Generator) -> None:
    """Rectangles within rectangles, with bars between them."""
    h, w = canvas.shape[:2]
    todo = [(0, 0, w, h)]
    while todo:
        x, y, a, b = todo.pop()
        if max(a, b) > 0.25 * w or (max(a, b) > 24 and rng.random() < 0.85):
            cut = rng.uniform(0.3, 0.7)
            if a > b:
                first = int(cut * a)
                todo += [(x, y, first, b), (x + first, y, a - first, b)]
            else:
                first = int(cut * b)
                todo += [(x, y, a, first), (x, y + first, a, b - first)]
            continue
        cv2.rectangle(canvas, (x, y), (x + a, y + b), _palette(3, rng)[0], -1)
        cv2.rectangle(canvas, (x, y), (x + a, y + b), (20.0, 20.0, 20.0), 2)


def _strokes(canvas: Array, rng: np.random.Generator) -> None:
    """Brush strokes that wander."""
    h, w = canvas.shape[:2]
    for colour in _palette(130, rng):
        heading = rng.uniform(0.0, 2.0 * np.pi) + np.cumsum(rng.normal(0.0, 0.35, 12))
        step = rng.uniform(4.0, 18.0) * np.column_stack([np.cos(heading), np.sin(heading)])
        path = rng.uniform(0.0, 1.0, 2) * np.array([w, h]) + np.cumsum(step, axis=0)
        cv2.polylines(canvas, [np.rint(path).astype(np.int32)], False, colour, int(rng.integers(3, 16)))


def _confetti(canvas: Array, rng: np.random.Generator) -> None:
    """Small discs and squares everywhere: features for views from near."""
    h, w = canvas.shape[:2]
    for colour in _palette(220, rng):
        x, y = int(rng.uniform(0, w)), int(rng.uniform(0, h))
        r = int(rng.integers(2, 9))
        if rng.random() < 0.5:
            cv2.circle(canvas, (x, y), r, colour, -1)
        else:
            cv2.rectangle(canvas, (x - r, y - r), (x + r, y + r), colour, -1)


DENSITY = 100.0  # px per metre of the painted surfaces, unless they would exceed `WIDEST`
WIDEST = 30_000
FRAME = 0.03  # m, width of the wooden frame around a picture


class View(NamedTuple):
    """The camera's view of the bare room: rgb (H, W, 3), depth z (H, W) m, and the wall (W,) of each column."""

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
        scale, half = np.float32(self.density), np.float32(0.5)
        x, y = scale * map_x - half, scale * map_y - half
        rgb = cv2.remap(self.painted, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return View(np.asarray(rgb, np.uint8), depth, wall)

    def _plan(self, axis: int, eye: Array, ray: Array, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Coordinate `axis` (H, W) of the seen points, from the room's corner [m]."""
        return np.asarray(depth * ray[:, axis].astype(np.float32) + np.float32(eye[axis] + self.half[axis]))
