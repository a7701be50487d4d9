"""What only the referee may see of a log: true poses, true landmarks, and which landmark each observation shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data.inputs import CLUTTER, IntArray, LandmarkMap, read_only
from data.se2 import Array

UNKNOWN_ID = -2
"""True id of an observation about which nothing is known (blank in the file)."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth; any part may be absent (None), and metrics that need it are then left blank.

    Attributes:
        pose: (N, 3), NaN rows where the truth is missing or marked bad.
        landmarks: true landmark positions by id.
        landmark_of: (M,) true id per observation, `CLUTTER` for none, `UNKNOWN_ID` where not known.
    """

    pose: Array | None = None
    landmarks: LandmarkMap | None = None
    landmark_of: IntArray | None = None

    def __post_init__(self) -> None:
        read_only(self)

    @property
    def known_poses(self) -> int:
        """Number of frames with a true pose."""
        return 0 if self.pose is None else int(np.isfinite(self.pose).all(axis=1).sum())


__all__ = ["CLUTTER", "UNKNOWN_ID", "Truth"]
