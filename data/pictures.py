"""Recordings of a stereo camera that observes pictures on walls, in SI units: setup, frames, detections.

Frames: world w; body b (x ahead, y left); camera c (x right, y down, z ahead). In plan a point of the camera is (x, z),
and p_c = R p_b + T with a 2x2 rotation R: a camera that looks ahead has R = [[0, -1], [1, 0]].
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data.inputs import IntArray, Prior
from data.se2 import Array

CORNERS = 4  # corners of a picture: upper left, upper right, lower right, lower left, seen from in front
COMMAND_SIGMA = (0.01, math.radians(4.0))  # m/s and rad/s, of a command
SAME_PLACE = 0.25  # largest distance of a true detection's corners, over the picture's width in the image


@dataclass(frozen=True, eq=False)
class VisualSetup:
    """The survey before the robot starts."""

    rotation: float  # rad, of R in p_c = R p_b + T, in plan
    translation: tuple[float, float]  # m, T
    corners: Array  # (L, 4, 2) m, corners of each picture in the world's plan; upper and lower ones coincide
    prior: Prior  # of the first pose

    @property
    def width(self) -> Array:
        """Widths (L,) of the pictures [m]."""
        return np.asarray(np.linalg.norm(self.corners[:, 1] - self.corners[:, 0], axis=1))


@dataclass(frozen=True, eq=False)
class VisualFrame:
    """One instant: time [s], commands v [m/s] and omega [rad/s] that hold until the next, image and stereo points.
    `rgb` (H, W, 3); `xyz` (H, W, 3) m, the point of each pixel in the camera's frame, NaN where stereo found none.
    """

    time: float
    v: float
    omega: float
    rgb: NDArray[np.uint8]
    xyz: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Detection:
    """A picture detected in an image."""

    picture: int  # row of `VisualSetup.corners`
    pixels: Array  # (4, 2) its corners in the image, u right and v down, pixel centres at whole numbers
    points: Array  # (4, 3) m, the corners in the camera's frame, from the stereo points
    inliers: int  # matched features consistent with one homography
    reprojection: float = float("nan")  # px, RMS distance of the inliers from the homography; NaN: unknown
    corner_sigma: float = float("nan")  # px, largest standard deviation of a corner in any direction; NaN: unknown


class VisualRecording(Protocol):
    """A recording: reference images, setup, and frames one at a time (they may exceed the memory)."""

    setup: VisualSetup
    references: list[NDArray[np.uint8]]

    def __len__(self) -> int:
        """Number of frames."""
        ...

    def frames(self) -> Iterator[VisualFrame]:
        """Every frame in order; may be called again."""
        ...


@dataclass(frozen=True, eq=False)
class Found:
    """Detections in a recording of N frames: D detections, ascending by frame."""

    time: Array  # time, v, omega: (N,) of the frames
    v: Array
    omega: Array
    frame: IntArray  # frame, picture, inliers: (D,); pixels (D, 4, 2), points (D, 4, 3) as in `Detection`
    picture: IntArray
    inliers: IntArray
    pixels: Array
    points: Array
    refused: tuple[Mapping[str, int], ...]  # by picture, number of frames in which each reason rejected it
    tiles: tuple[tuple[int, bytes], ...]  # a few frames as encoded images, with their numbers
    focal: float  # px, focal length implied by the stereo points
    # pixel_noise: px, sigma of a corner in the image. depth_noise: 1/m, k in its sigma_z = k z^2; NaN: unknown
    pixel_noise: float
    depth_noise: float
    # frames, all or every so many, as small encoded images with their numbers, for the player
    small: tuple[tuple[int, bytes], ...] = ()

    @property
    def rejected(self) -> dict[str, int]:
        """Rejections by reason, over all pictures."""
        reasons = sorted({reason for each in self.refused for reason in each})
        return {reason: sum(each.get(reason, 0) for each in self.refused) for reason in reasons}


@dataclass(frozen=True, eq=False)
class InView:
    """True opportunities (E,): pictures fully in view, near, not too oblique; pixels (E, 4, 2) of their corners."""

    frame: IntArray
    picture: IntArray
    pixels: Array


@dataclass(frozen=True, eq=False)
class Evidence:
    """Setup and detections of a log made from images, for the report; `in_view` where the truth is known."""

    setup: VisualSetup
    found: Found
    in_view: InView | None = None


def true_pictures(found: Found, in_view: InView) -> IntArray:
    """True picture of each detection (D,): the one whose true corners are near its own; -1: none."""
    result = np.full(len(found.frame), -1, np.int64)
    for d in range(len(result)):
        there = np.flatnonzero(in_view.frame == found.frame[d])
        if len(there):
            off = np.linalg.norm(in_view.pixels[there] - found.pixels[d], axis=2).mean(axis=1)
            side = np.linalg.norm(in_view.pixels[there, 1] - in_view.pixels[there, 0], axis=1)
            best = int(np.argmin(off / side))
            if off[best] < SAME_PLACE * side[best]:
                result[d] = in_view.picture[there[best]]
    return result
