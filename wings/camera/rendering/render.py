"""Rendering of the gallery: images and stereo points with their noise, exact to the pixel.

A picture is warped into the image by its exact homography. Its surveyed corners are the outer corners of its own image:
half a pixel outside the centres of the corner pixels.

Stereo: a disparity d = f b / z has an error of sigma_d px, partly shared by neighbouring pixels, and is rounded;
z = f b / d then has a standard deviation of z^2 sigma_d / (f b), x and y follow the ray, and some pixels are holes.

The gallery's surfaces: distinct pictures full of features, and the bare room as its camera sees it.

Everything is drawn from a generator, reproducibly. The camera is level, so the depth z at which a pixel's ray meets a
wall depends on its column alone, and that of floor and ceiling on its row alone; the nearest of them is seen, since the
room is convex.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.special import ndtri

from data.errors import UsageError
from data.pictures import VisualFrame
from data.se2 import Array
from wings.camera.gallery import NORMALS, Gallery, Projection, Scene, gallery, in_view, projections

Image = NDArray[np.uint8]
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijkmnopqrstuvwxyz0123456789&?!%"


def picture(number: int, width: int, height: int, rng: np.random.Generator) -> Image:
    """A picture (height, width, 3), RGB; its number chooses the style."""
    style = (_shapes, _mosaic, _poster, _strata, _blocks, _strokes)[number % 6]
    low, high = _palette(2, rng)  # Background (height, width, 3): clouds between two colours
    mix = 1.0 / (1.0 + np.exp(-1.5 * _fractal(width, height, 16, rng)))[:, :, None]
    canvas = np.ascontiguousarray(low + (high - low) * mix)
    style(canvas, rng)
    h, w = canvas.shape[:2]
    for colour in _palette(220, rng):
        x, y = int(rng.uniform(0, w)), int(rng.uniform(0, h))
        r = int(rng.integers(2, 9))
        if rng.random() < 0.5:
            cv2.circle(canvas, (x, y), r, colour, -1)
        else:
            cv2.rectangle(canvas, (x - r, y - r), (x + r, y + r), colour, -1)
    return _image(canvas + rng.normal(0.0, 4.0, (height, width, 1)))


def surface(width: int, height: int, colour: tuple[int, int, int], contrast: float, rng: np.random.Generator) -> Image:
    """A surface (height, width, 3) of one colour with noise of `contrast` grey levels (standard deviation)."""
    return _image(np.array(colour) + (contrast * _fractal(width, height, 3, rng, 1.1))[:, :, None])


def _image(values: Array) -> Image:
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)


def _fractal(width: int, height: int, fine: int, rng: np.random.Generator, growth: float = 1.4) -> NDArray[np.float32]:
    """Noise (height, width) of mean 0 and variance 1: octaves from `finest` px up, each `growth` times as strong."""
    total = np.zeros((height, width), np.float32)
    scale, weight = fine, 1.0
    while scale < max(width, height):
        coarse = rng.standard_normal((height // scale + 2, width // scale + 2)).astype(np.float32)
        total += weight * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        scale, weight = 2 * scale, growth * weight
    return np.asarray((total - total.mean()) / total.std(), np.float32)


def _palette(n: int, rng: np.random.Generator) -> Array:
    grey = rng.permutation(np.linspace(15.0, 240.0, n))
    tint = rng.normal(0.0, 55.0, (n, 3))
    return np.asarray(np.clip(grey[:, None] + tint - tint.mean(axis=1, keepdims=True), 0, 255))


def _shapes(canvas: Array, rng: np.random.Generator) -> None:
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
    distance, cell = (np.asarray(a) for a in scipy.spatial.cKDTree(centres).query(np.stack([x, y], axis=-1), k=2))
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
    canvas[:] = _palette(16, rng)[np.digitize(_fractal(w, h, 9, rng), np.linspace(-2.0, 2.0, 15))]


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
        self.shift = starts + 0.5 * np.array(g.wall_lengths)  # m along the unrolled walls = shift + point . right
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
            cv2.rectangle(walls, first, (round((along[1] + FRAME) * d), round((bottom + FRAME) * d)), (74, 52, 34), -1)

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

        along = self.shift[wall] + np.einsum("wi,wi->w", eye + near[:, None] * ray, self.right[wall])
        hits_wall = near <= to_row[:, None]
        beside = np.where(self.down > 0, 0.0, self.beside).astype(np.float32)
        flat_x = self._plan(0, eye, ray, depth) + beside[:, None]
        map_x = np.where(hits_wall, along.astype(np.float32), flat_x)
        wall_y = np.float32(g.room_height - g.camera_height) + self.down.astype(np.float32)[:, None] * depth
        map_y = np.where(hits_wall, wall_y, self._plan(1, eye, ray, depth) + np.float32(self.below))
        scale, half = np.float32(self.density), np.float32(0.5)
        x, y = scale * map_x - half, scale * map_y - half
        rgb = cv2.remap(self.painted, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return View(np.asarray(rgb, np.uint8), depth, wall)

    def _plan(self, axis: int, eye: Array, ray: Array, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Coordinate `axis` (H, W) of the seen points, from the room's corner [m]."""
        return np.asarray(depth * ray[:, axis].astype(np.float32) + np.float32(eye[axis] + self.half[axis]))


WINDOW = 11  # px, side of the square over which texture is averaged
HOLE_SIZE = (4.0, 30.0)  # px, half axes of a random hole


def stereo_points(
    g: Gallery, depth: NDArray[np.float32], rgb: Image, outlines: Sequence[Array], noise: np.random.Generator,
    holes: np.random.Generator,
) -> NDArray[np.float32]:  # fmt: skip
    """Points (H, W, 3) m in the camera's frame, NaN where stereo finds none, from the exact depth (H, W) m. Texture is
    matched in `rgb` (H, W, 3); `outlines` (4, 2) px are those of pictures; `noise` is of disparities.
    """
    disparity = np.float32(g.focal * g.baseline) / depth
    if g.disparity_noise > 0:
        disparity += np.float32(g.disparity_noise) * smeared_noise(depth.shape, g.smear, noise)
    if g.disparity_step > 0:
        step = np.float32(g.disparity_step)
        disparity = step * np.rint(disparity / step)
    disparity[_lost(g, rgb, outlines, holes) | (disparity <= 0)] = np.nan
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
    return np.asarray(smooth[reach:-reach, reach:-reach], np.float32)  # the padded rim mixes values twice; it is cut


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
        mean = cv2.boxFilter(cv2.absdiff(grey[:, 1:], grey[:, :-1]), cv2.CV_32F, (WINDOW, WINDOW))
        lost[:, 1:] |= (mean < g.least_texture).astype(np.uint8)
    return lost.astype(bool)


FINER = 2  # oversampling of pictures (anti-aliasing)
_WALLS, _PICTURES, _FRAMES = 10, 11, 12  # streams of the seed, besides those of `wings.camera.gallery`
Level = TypeVar("Level", np.uint8, np.int16)


class Rendered:
    """A recording of the gallery, rendered frame by frame on demand; reproducible to the byte."""

    def __init__(self, g: Gallery, seed: int, *, frames: int | None = None) -> None:
        """Draw the world; `frames` takes only the first ones. UsageError for an impossible number."""
        if frames is not None and not 1 <= frames <= g.frames:
            raise UsageError(f"gallery: frames = {frames}; from 1 to {g.frames} is possible")
        self.gallery, self.seed, self.name = g, seed, f"visual:{seed}"
        self.scene: Scene = gallery(g, seed)  # the truth
        self.setup = self.scene.setup  # as surveyed
        height = max(round(g.reference_width * g.picture_height / g.picture_width), 1)
        motif = (np.arange(g.pictures) % (g.motifs or g.pictures)).tolist()
        self.references = [picture(i, g.reference_width, height, _rng(seed, _PICTURES, i)) for i in motif]
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
        # The image under this frame's light, with the sensor's noise.
        offset, gain = light.standard_normal(2) * np.array([g.brightness, g.contrast])
        taken = cv2.LUT(sharp, _levels(np.exp(gain) * (np.arange(256) - 127.5) + 127.5 + offset, np.uint8))
        if g.image_noise > 0:
            # inverse normal distribution by table: much faster than drawing normal numbers
            table = _levels(g.image_noise * ndtri((np.arange(2**16) + 0.5) / 2**16), np.int16)
            taken = cv2.add(taken, table[sensor.integers(0, 2**16, sharp.shape, np.uint16)], dtype=cv2.CV_8U)
        return VisualFrame(float(self.scene.time[k]), float(v), float(omega), np.asarray(taken, np.uint8), xyz)

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
        level = 0  # pyramid level with as many pixels as will be drawn, or up to 1.4 times that
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
    half = 0.5 * abs(length)
    if half <= 0.5:
        return image
    reach = int(np.ceil(half - 0.5))
    kernel = np.diff(np.clip(np.arange(-reach, reach + 2) - 0.5, -half, half)) / (2.0 * half)
    return np.asarray(cv2.filter2D(image, -1, kernel[None], borderType=cv2.BORDER_REPLICATE), np.uint8)


def _levels(values: Array, kind: type[Level]) -> NDArray[Level]:
    """Grey levels rounded to whole numbers that the type holds."""
    limits = np.iinfo(kind)
    return np.clip(np.rint(values), limits.min, limits.max).astype(kind)
