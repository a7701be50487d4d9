"""What a robot with a stereo camera records of pictures on walls, in SI units: setup, frames, detections.

Frames: world w; body b (x forward, y left); camera c (x right, y down, z forward). In plan a point of the camera is
(x, z), and p_c = R p_b + T with the camera's 2x2 rotation R: a camera that looks ahead has R = [[0, -1], [1, 0]].
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data.inputs import IntArray, Prior
from data.se2 import Array

CORNERS = 4
"""Of a picture: upper left, upper right, lower right, lower left, seen from in front."""


@dataclass(frozen=True, eq=False)
class VisualSetup:
    """What is surveyed and known before the robot starts.

    Attributes:
        rotation: rad, of R in p_c = R p_b + T, in plan.
        translation: (2,) m, T.
        corners: (L, 4, 2) m, corners of each picture in the world's plan; upper and lower ones share their place.
        prior: of the first pose.
    """

    rotation: float
    translation: tuple[float, float]
    corners: Array
    prior: Prior

    @property
    def width(self) -> Array:
        """Widths (L,) of the pictures [m]."""
        side: Array = np.linalg.norm(self.corners[:, 1] - self.corners[:, 0], axis=1)
        return side


@dataclass(frozen=True, eq=False)
class VisualFrame:
    """One instant: time [s], commands v [m/s] and omega [rad/s] that hold until the next, image and stereo points.

    Attributes:
        rgb: (H, W, 3) uint8.
        xyz: (H, W, 3) m, the point of each pixel in the camera's frame, NaN where stereo found none.
    """

    time: float
    v: float
    omega: float
    rgb: NDArray[np.uint8]
    xyz: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Detection:
    """A picture found in an image.

    Attributes:
        picture: its number, row of `VisualSetup.corners`.
        pixels: (4, 2) its corners in the image, u to the right and v downwards, pixel centres at whole numbers.
        points: (4, 3) m, the same corners in the camera's frame, read off the stereo points.
        inliers: matched features that agree with one another.
        reprojection: px, RMS distance of these from where the homography puts them; NaN: not kept.
        corner_sigma: px, standard deviation of the least certain corner along its worst direction; NaN: not kept.
    """

    picture: int
    pixels: Array
    points: Array
    inliers: int
    reprojection: float = float("nan")
    corner_sigma: float = float("nan")


class VisualRecording(Protocol):
    """A recording: reference images, setup, and frames that come one by one (they may not fit into memory together)."""

    setup: VisualSetup
    references: list[NDArray[np.uint8]]

    def __len__(self) -> int:
        """Number of frames."""
        ...

    def frames(self) -> Iterator[VisualFrame]:
        """Every frame in order; may be asked for again."""
        ...


@dataclass(frozen=True, eq=False)
class Found:
    """What was found in the images of a recording of N frames: D detections, ascending by frame.

    Attributes:
        time, v, omega: (N,) of the frames.
        frame, picture, inliers: (D,); pixels (D, 4, 2), points (D, 4, 3) as in `Detection`.
        refused: by picture, in how many frames each reason kept it from being found.
        tiles: a few frames as encoded images, with their numbers, to look at.
        focal: px, focal length that the stereo points imply.
        pixel_noise: px, sigma of a corner in the image. depth_noise: 1/m, k in its sigma_z = k z^2; NaN: unknown.
        small: frames, all or every so many, as small encoded images with their numbers, to play.
    """

    time: Array
    v: Array
    omega: Array
    frame: IntArray
    picture: IntArray
    inliers: IntArray
    pixels: Array
    points: Array
    refused: tuple[Mapping[str, int], ...]
    tiles: tuple[tuple[int, bytes], ...]
    focal: float
    pixel_noise: float
    depth_noise: float
    small: tuple[tuple[int, bytes], ...] = ()

    @property
    def rejected(self) -> dict[str, int]:
        """The same of all pictures together."""
        reasons = sorted({reason for each in self.refused for reason in each})
        return {reason: sum(each.get(reason, 0) for each in self.refused) for reason in reasons}


@dataclass(frozen=True, eq=False)
class InView:
    """The truth about E observations that could have been: pictures fully in view, near enough and not too oblique.

    frame, picture (E,); pixels (E, 4, 2) of the corners.
    """

    frame: IntArray
    picture: IntArray
    pixels: Array


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a log made from images keeps of them, for the report; `in_view` where the truth is known."""

    setup: VisualSetup
    found: Found
    in_view: InView | None = None
