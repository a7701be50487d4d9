"""Checks of a detected picture's quadrilateral: its shape in the image, and its corners in the stereo points.

Each check returns the reason for rejection, or None. Pixels are (u right, v down), centres at whole numbers; points are
in the camera's frame (x right, y down, z ahead), m.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from data.se2 import Array

Points = NDArray[np.float32]

MIRRORED = "mirrored"
NOT_CONVEX = "not convex"
IMPLAUSIBLE_SHAPE = "implausible shape"
OUTSIDE = "outside the image"
NO_DEPTH = "no depth"
NOT_PLANAR = "not planar"
WRONG_SIZE = "wrong size"

MIN_SIDE = 16.0  # px, shortest side of a picture with usable corners
MAX_TAPER = 3.0  # ratio of opposite sides, of a picture much nearer than its size
MAX_SQUEEZE = 4.0  # ratio of foreshortened to other side: obliquity of about 75 degrees
MIN_ANGLE = 20.0  # degrees, of a corner in the image
MAX_SIZE_ERROR = 0.15  # relative error of sides and diagonals against the survey
MAX_OFF_PLANE = 0.06
"""Relative error of depths against the fitted plane: three standard deviations of stereo at a few metres."""
MIN_VALID = 0.2  # share of the picture's pixels with depth
MIN_ON_PLANE = 0.6  # share of those on the plane
WINDOW = (2, 4, 7, 12)  # px, half widths of the window of depths at a corner, widened until enough points are valid
MAX_SAMPLES = 2000  # most points of the plane's fit


def shape_fault(pixels: Array, size: tuple[int, int], aspect: float) -> str | None:
    """The fault of corners (4, 2) in an image of `size` (height, width); `aspect` is the picture's height/width.

    All corners turn alike if and only if no line within the picture is mapped to infinity: the sign of each turn is
    that of det H w_i w_j w_k.
    """
    side = np.roll(pixels, -1, axis=0) - pixels
    turn = side[:, 0] * np.roll(side[:, 1], -1) - side[:, 1] * np.roll(side[:, 0], -1)
    if np.all(turn < 0):
        return MIRRORED
    if not np.all(turn > 0):
        return NOT_CONVEX
    length = np.linalg.norm(side, axis=1)
    sine = turn / (length * np.roll(length, -1))
    width, height = np.sqrt(length[0] * length[2]), np.sqrt(length[1] * length[3])
    squeeze = height / width / aspect
    taper = max(max(length[i], length[i + 2]) / min(length[i], length[i + 2]) for i in (0, 1))
    if (
        length.min() < MIN_SIDE
        or taper > MAX_TAPER
        or not 1 / MAX_SQUEEZE < squeeze < MAX_SQUEEZE
        or sine.min() < np.sin(np.radians(MIN_ANGLE))
    ):
        return IMPLAUSIBLE_SHAPE
    # a pixel extends half a pixel beyond its centre
    if np.any(pixels < -0.5) or np.any(pixels > np.array([size[1], size[0]]) - 0.5):
        return OUTSIDE
    return None


def pinhole(xyz: Points, step: int = 8) -> Array | None:
    """The camera of stereo points (H, W, 3): x/z = a u + b and y/z = a v + b, rows (2, 2) of a and b, by least squares
    over every `step`-th pixel; None: too few.
    """
    sample = xyz[::step, ::step].astype(np.float64)
    v, u = np.mgrid[0 : xyz.shape[0] : step, 0 : xyz.shape[1] : step]
    valid = np.isfinite(sample).all(axis=2) & (sample[..., 2] > 0)
    if len(np.unique(u[valid])) < 3 or len(np.unique(v[valid])) < 3:
        return None
    x, y, z = sample[valid].T
    return np.array([np.polyfit(u[valid], x / z, 1), np.polyfit(v[valid], y / z, 1)])


def inside(pixels: Array, shape: tuple[int, int]) -> NDArray[np.intp]:
    """Pixels (n, 2) as (row, column) within a convex quadrilateral (4, 2)."""
    start = np.maximum(np.floor(pixels.min(axis=0)).astype(int), 0)
    stop = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 1, (shape[1], shape[0]))
    mask = np.zeros((stop[1] - start[1], stop[0] - start[0]), np.uint8)
    cv2.fillConvexPoly(mask, np.rint((pixels - start) * 16).astype(np.int32), 1, shift=4)
    return np.asarray(np.argwhere(mask) + start[::-1])


def fit_plane(pixels: Array, depth: Array) -> Array:
    """Plane through points at pixels (n, 2) with depth (n,) m, as 1/z = a u + b v + c: (3,).

    1/z of a plane is linear in the pixel, with nearly constant stereo noise. Reweighted least absolute deviations, then
    Tukey's biweight tolerate a third of wrong depths.
    """
    centre = pixels.mean(axis=0)
    A = np.column_stack([pixels - centre, np.ones(len(pixels))])
    inverse = 1.0 / depth
    plane = np.array([0.0, 0.0, np.median(inverse)])
    for round_ in range(15):
        r = inverse - A @ plane
        scale = max(1.4826 * float(np.median(np.abs(r))), 1e-9)
        if round_ < 10:
            weight = 1.0 / np.maximum(np.abs(r), 0.1 * scale)
        else:
            weight = np.maximum(1.0 - (r / (4.685 * scale)) ** 2, 0.0) ** 2
        weighted = A * weight[:, None]
        plane = np.linalg.lstsq(weighted.T @ A, weighted.T @ inverse, rcond=None)[0]
    return np.array([plane[0], plane[1], plane[2] - plane[:2] @ centre])


def corner_windows(pixels: Array, xyz: Points) -> tuple[Array, Array] | None:
    """Centre (4, 2) px and median depth (4,) m of a small window near each corner, inside the picture; None: too few
    points.
    """
    middle = pixels.mean(axis=0)
    towards = middle - pixels
    distance = np.linalg.norm(towards, axis=1)
    centres, depths = np.empty((4, 2)), np.empty(4)
    for i in range(4):
        for half in WINDOW:
            shift = min(1.5 * half + 1.0, 0.4 * distance[i])
            centre = np.rint(pixels[i] + towards[i] / distance[i] * shift)
            column, row = (int(c) for c in centre)
            z = xyz[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1, 2]
            z = z[np.isfinite(z) & (z > 0)]
            if z.size >= (2 * WINDOW[0] + 1) ** 2 // 2:
                break
        else:
            return None
        centres[i], depths[i] = centre, np.median(z.astype(np.float64))
    return centres, depths


def corner_points(pixels: Array, xyz: Points, camera: Array | None) -> Array | str:
    """Corners (4, 3) m of the picture with corners (4, 2) px by a `pinhole`, or the reason for rejection.

    The corner's ray is intersected with the plane fitted to all valid points. The median depth at a corner
    (`corner_windows`) is several times noisier and, on an oblique picture, biased; it serves as a check that each
    corner has depth, on the plane.
    """
    windows = corner_windows(pixels, xyz)
    if camera is None or windows is None:
        return NO_DEPTH
    middle = pixels.mean(axis=0)
    rows = inside(middle + 0.95 * (pixels - middle), xyz.shape[:2])
    rows = rows[:: max(1, len(rows) // MAX_SAMPLES)]
    z = xyz[rows[:, 0], rows[:, 1], 2].astype(np.float64)
    valid = np.isfinite(z) & (z > 0)
    if valid.sum() < max(MIN_VALID * len(z), 20):
        return NO_DEPTH
    places, z = rows[valid][:, ::-1].astype(np.float64), z[valid]
    plane = fit_plane(places, z)
    near = np.abs((places @ plane[:2] + plane[2]) * z - 1.0) < MAX_OFF_PLANE
    centres, depths = windows
    off = np.abs((centres @ plane[:2] + plane[2]) * depths - 1.0)
    inverse = pixels @ plane[:2] + plane[2]
    if near.mean() < MIN_ON_PLANE or off.max() > MAX_OFF_PLANE or inverse.min() <= 0:
        return NOT_PLANAR
    rays = np.column_stack([camera[:, 0] * pixels + camera[:, 1], np.ones(len(pixels))])
    return np.asarray(rays / inverse[:, None])


def size_fault(points: Array, width: float, aspect: float) -> str | None:
    """Whether corners (4, 3) m are those of a rectangle of `width` m and height `aspect` x width."""
    side = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    diagonal = np.linalg.norm(points[2:] - points[:2], axis=1)
    height = aspect * width
    expected = np.array([width, height, width, height, np.hypot(width, height), np.hypot(width, height)])
    wrong = np.abs(np.concatenate([side, diagonal]) / expected - 1.0) > MAX_SIZE_ERROR
    return WRONG_SIZE if wrong.any() else None


def overlap(first: Array, second: Array) -> float:
    """Shared area of two convex quadrilaterals (4, 2), over the smaller one."""
    area, _ = cv2.intersectConvexConvex(first.astype(np.float32), second.astype(np.float32))
    smaller = min(cv2.contourArea(first.astype(np.float32)), cv2.contourArea(second.astype(np.float32)))
    return float(area / max(smaller, 1e-9))
