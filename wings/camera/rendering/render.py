"""Rendering of the gallery: images and stereo points with their noise, exact to the pixel.

A picture is warped into the image by its exact homography. Its surveyed corners are the outer corners of its own image:
half a pixel outside the centres of the corner pixels.

Stereo: a disparity d = f b / z has an error of sigma_d px, partly shared by neighbouring pixels, and is rounded;
z = f b / d then has a standard deviation of z^2 sigma_d / (f b), x and y follow the ray, and some pixels are holes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from data.errors import UsageError
from data.pictures import VisualFrame
from data.se2 import Array
from wings.camera.gallery import Gallery, Projection, Scene, gallery, in_view, projections
from wings.camera.rendering.textures import Image, Room, View, picture

WINDOW = 11  # px, side of the square over which texture is averaged
HOLE_SIZE = (4.0, 30.0)  # px, half axes of a random hole


def stereo_points(
    g: Gallery,
    depth: NDArray[np.float32],
    rgb: Image,
    outlines: Sequence[Array],
    noise: np.random.Generator,
    holes: np.random.Generator,
) -> NDArray[np.float32]:
    """Points (H, W, 3) m in the camera's frame, NaN where stereo finds none, from the exact depth (H, W) m.

    Texture is matched in `rgb` (H, W, 3); `outlines` (4, 2) px are those of pictures; `noise` is of disparities.
    """
    disparity = np.float32(g.focal * g.baseline) / depth
    if g.disparity_noise > 0:
        disparity += np.float32(g.disparity_noise) * smeared_noise(depth.shape, g.smear, noise)
    if g.disparity_step > 0:
        step = np.float32(g.disparity_step)
        disparity = step * np.rint(disparity / step)
    lost = _lost(g, rgb, outlines, holes) | (disparity <= 0)
    disparity[lost] = np.nan
    h, w = depth.shape
    xyz = np.empty((h, w, 3), np.float32)
    z = np.float32(g.focal * g.baseline) / disparity
    across = (np.arange(w, dtype=np.float32) - np.float32(0.5 * (w - 1))) / np.float32(g.focal)
    down = (np.arange(h, dtype=np.float32) - np.float32(0.5 * (h - 1))) / np.float32(g.focal)
    xyz[:, :, 0] = across * z
    xyz[:, :, 1] = down[:, None] * z
    xyz[:, :, 2] = z
    return xyz


def smeared_noise(shape: tuple[int, ...], smear: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Normal noise (H, W) of variance 1, smoothed by a Gaussian of `smear` px (0: white)."""
    reach = int(np.ceil(3.0 * smear))
    white = rng.standard_normal((shape[0] + 2 * reach, shape[1] + 2 * reach), dtype=np.float32)
    if reach == 0:
        return white
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / smear) ** 2)
    kernel /= np.linalg.norm(kernel)  # a sum of independent values keeps the variance
    smooth = cv2.sepFilter2D(white, cv2.CV_32F, kernel, kernel)
    # the padded rim mixes values twice, and is cut off
    return np.asarray(smooth[reach:-reach, reach:-reach], np.float32)


def _lost(g: Gallery, rgb: Image, outlines: Sequence[Array], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Pixels (H, W) without depth: random patches, borders between surfaces, and surfaces without texture."""
    h, w = rgb.shape[:2]
    lost = np.zeros((h, w), np.uint8)
    for _ in range(g.patches):
        middle = rng.uniform(0.0, 1.0, 2) * np.array([w, h])
        axes, angle = rng.uniform(*HOLE_SIZE, 2), rng.uniform(0.0, 180.0)
        cv2.ellipse(lost, (int(middle[0]), int(middle[1])), (int(axes[0]), int(axes[1])), angle, 0.0, 360.0, 1, -1)
    if g.edge_hole > 0:
        for corners in outlines:
            cv2.polylines(lost, [np.rint(corners).astype(np.int32)], True, 1, 2 * g.edge_hole)
    if g.least_texture > 0:
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        slope = cv2.absdiff(grey[:, 1:], grey[:, :-1])
        mean = cv2.boxFilter(slope, cv2.CV_32F, (WINDOW, WINDOW))
        lost[:, 1:] |= (mean < g.least_texture).astype(np.uint8)
    return lost.astype(bool)


FINER = 2  # oversampling of pictures (anti-aliasing)
_WALLS, _PICTURES, _FRAMES = 10, 11, 12  # streams of the seed, besides those of `wings.camera.gallery`
Level = TypeVar("Level", np.uint8, np.int16)


class Rendered:
    """A recording of the gallery, rendered frame by frame on demand; reproducible to the byte.

    Attributes:
        gallery: the parameters; seed: of the run; name: `visual:SEED`.
        scene: the truth.
        setup: as surveyed.
        references: image of each picture, (H, W, 3) RGB uint8.
    """

    def __init__(self, g: Gallery, seed: int, *, frames: int | None = None) -> None:
        """Draw the world; `frames` takes only the first ones. UsageError for an impossible number."""
        if frames is not None and not 1 <= frames <= g.frames:
            raise UsageError(f"gallery: frames = {frames}; from 1 to {g.frames} is possible")
        self.gallery, self.seed, self.name = g, seed, f"visual:{seed}"
        self.scene: Scene = gallery(g, seed)
        self.setup = self.scene.setup
        height = max(round(g.reference_width * g.picture_height / g.picture_width), 1)
        self.references: list[Image] = [
            picture(i, g.reference_width, height, _rng(seed, _PICTURES, i)) for i in range(g.pictures)
        ]
        self._frames = g.frames if frames is None else frames
        self._room = Room(g, self.scene.corners, _rng(seed, _WALLS))
        self._pyramids = [_pyramid(reference) for reference in self.references]

    def __len__(self) -> int:
        return self._frames

    def frames(self) -> Iterator[VisualFrame]:
        """Every frame in order; may be called again."""
        return (self.frame(k) for k in range(len(self)))

    def frame(self, k: int) -> VisualFrame:
        """Frame k, independent of earlier calls."""
        g = self.gallery
        light, sensor, disparity, holes = _rng(self.seed, _FRAMES, k).spawn(4)
        view = self._room.look(self.scene.pose[k])
        seen = self.projections(k)
        for projection in seen:
            self._hang(view, projection)
        # the exposure is centred on the stamp: half of it under the last command, half under the new one
        motion = self.scene.command[max(k - 1, 0) : k + 1].mean(axis=0)
        depth = float(np.median(view.depth[g.image_height // 2]))
        sharp = _blurred(view.rgb, g.exposure * sideways_motion(g, motion[0], motion[1], depth))
        outlines = [s.pixels for s in seen if np.isfinite(s.pixels).all()]
        xyz = stereo_points(g, view.depth, sharp, outlines, disparity, holes)
        v, omega = self.scene.recorded[k]
        return VisualFrame(float(self.scene.time[k]), float(v), float(omega), _exposed(g, sharp, light, sensor), xyz)

    def projections(self, k: int) -> list[Projection]:
        """Every picture as seen in frame k, in view or not."""
        return projections(self.gallery, self.scene.corners, self.scene.pose[k])

    def in_view(self, k: int) -> list[Projection]:
        """The pictures in view in frame k, within the gallery's limits of distance and obliquity."""
        return in_view(self.gallery, self.scene.corners, self.scene.pose[k])

    def _hang(self, view: View, projection: Projection) -> None:
        """Draw a picture into the view, in the columns of its wall."""
        g = self.gallery
        columns = np.flatnonzero(view.wall == self._room.owner[projection.picture])
        if not len(columns):
            return
        left, right, top, bottom = columns[0], columns[-1] + 1, 0, g.image_height
        # pyramid level with as many pixels as will be drawn, or up to 1.4 times that
        level = 0
        pyramid = self._pyramids[projection.picture]
        if np.isfinite(projection.pixels).all():
            low, high = np.floor(projection.pixels.min(axis=0)) - 1, np.ceil(projection.pixels.max(axis=0)) + 2
            left, right = int(max(left, low[0])), int(min(right, high[0]))
            top, bottom = int(max(top, low[1])), int(min(bottom, high[1]))
            sides = np.linalg.norm(np.roll(projection.pixels, -1, axis=0) - projection.pixels, axis=1)
            h, w = pyramid[0].shape[:2]
            ratio = min(w / max(sides[0], sides[2]), h / max(sides[1], sides[3])) / FINER
            level = int(np.clip(np.rint(np.log2(ratio)), 0, len(pyramid) - 1))
        if right <= left or bottom <= top:
            return
        image = pyramid[level]
        # to the pixels of an oversampled part that begins at (left, top)
        x, y = 0.5 * (FINER - 1) - FINER * left, 0.5 * (FINER - 1) - FINER * top
        finer = np.array([[FINER, 0, x], [0, FINER, y], [0, 0, 1.0]])
        H = finer @ image_homography(g, projection.points, image.shape[1], image.shape[0])
        size = (FINER * (right - left), FINER * (bottom - top))
        fine = cv2.warpPerspective(image, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        drawn = cv2.resize(fine, (right - left, bottom - top), interpolation=cv2.INTER_AREA).astype(np.float32)
        place = view.rgb[top:bottom, left:right]
        # the fourth channel is the picture's coverage of a pixel; colours are already scaled by it
        place[:] = np.rint(drawn[:, :, :3] + place * (1.0 - drawn[:, :, 3:] / np.float32(255.0)))


def sideways_motion(g: Gallery, v: float, omega: float, depth: float) -> float:
    """Image speed [px/s] to the right of a point straight ahead of the camera at `depth` m."""
    velocity = np.array([v - omega * g.camera_y, omega * g.camera_x])
    rightwards = np.array([np.cos(g.rotation), -np.sin(g.rotation)]) @ velocity
    return float(g.focal * (omega - rightwards / depth))


def image_homography(g: Gallery, points: Array, width: int, height: int) -> Array:
    """Homography (3, 3) from an image's pixels to the camera's; `points` (4, 3) m are its outer corners."""
    right, down = (points[1] - points[0]) / width, (points[3] - points[0]) / height
    K = np.array([[g.focal, 0, 0.5 * (g.image_width - 1)], [0, g.focal, 0.5 * (g.image_height - 1)], [0, 0, 1]])
    return np.asarray(K @ np.column_stack([right, down, points[0] + 0.5 * (right + down)]))


def _rng(seed: int, *stream: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=stream))


def _pyramid(image: Image) -> list[Image]:
    """The image with full coverage as fourth channel, and its halves, quarters, ..., averaged."""
    h, w = image.shape[:2]
    levels = [np.dstack([image, np.full((h, w), 255, np.uint8)])]
    while min(levels[-1].shape[:2]) >= 16:
        size = (levels[-1].shape[1] // 2, levels[-1].shape[0] // 2)
        levels.append(np.asarray(cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA), np.uint8))
    return levels


def _blurred(image: Image, length: float) -> Image:
    """The image averaged sideways over `length` px about each pixel."""
    half = 0.5 * abs(length)
    if half <= 0.5:
        return image
    reach = int(np.ceil(half - 0.5))
    edges = np.clip(np.arange(-reach, reach + 2) - 0.5, -half, half)
    kernel = np.diff(edges) / (2.0 * half)
    return np.asarray(cv2.filter2D(image, -1, kernel[None], borderType=cv2.BORDER_REPLICATE), np.uint8)


def _exposed(g: Gallery, image: Image, light: np.random.Generator, sensor: np.random.Generator) -> NDArray[np.uint8]:
    """The image under this frame's light, with the sensor's noise."""
    offset, gain = light.standard_normal(2) * np.array([g.brightness, g.contrast])
    level = np.arange(256) - 127.5
    taken = cv2.LUT(image, _levels(np.exp(gain) * level + 127.5 + offset, np.uint8))
    if g.image_noise > 0:
        # inverse normal distribution by table: much faster than drawing normal numbers
        table = _levels(g.image_noise * ndtri((np.arange(2**16) + 0.5) / 2**16), np.int16)
        noise = table[sensor.integers(0, 2**16, image.shape, np.uint16)]
        taken = cv2.add(taken, noise, dtype=cv2.CV_8U)
    return np.asarray(taken, np.uint8)


def _levels(values: Array, kind: type[Level]) -> NDArray[Level]:
    """Grey levels rounded to whole numbers that the type holds."""
    limits = np.iinfo(kind)
    return np.clip(np.rint(values), limits.min, limits.max).astype(kind)
