"""What a robot with a stereo camera records of pictures on walls, in SI units: setup, frames, detections.

Frames: world w; body b (x forward, y left); camera c (x right, y down, z forward). In plan a point of the camera is
(x, z), and p_c = R p_b + T with the camera's 2x2 rotation R: a camera that looks ahead has R = [[0, -1], [1, 0]].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data.inputs import Prior
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
    """

    picture: int
    pixels: Array
    points: Array
    inliers: int


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
