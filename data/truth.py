"""What only the referee may see of a log: true poses, true landmarks, and which landmark each observation shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data.inputs import CLUTTER, IntArray, LandmarkMap, Locked
from data.result import Systematics
from data.se2 import Array

UNKNOWN_ID = -2
"""True id of an observation about which nothing is known (blank in the file)."""


@dataclass(frozen=True, eq=False)
class Relations(Locked):
    """Reference relations: the pose at one frame in the frame of the pose at another, known without a true path.

    Attributes:
        row1, row2: (K,) frames.
        relative: (K, 3), the pose of row2 in the frame of row1 [m, m, rad].
        exact: (K,) 1 where both rows are sure, 0 where they are not; None: not said.
        stamp: (K, 2) s, what the reference's author tied the relations to; None: rows only.
        frame_stamp: (N,) s, the frames' stamps as recorded, not made monotone; None: the log's time.
    """

    row1: IntArray
    row2: IntArray
    relative: Array
    exact: IntArray | None = None
    stamp: Array | None = None
    frame_stamp: Array | None = None

    def __len__(self) -> int:
        return len(self.row1)


@dataclass(frozen=True, eq=False)
class Truth(Locked):
    """Ground truth; any part may be absent (None), and metrics that need it are then left blank.

    Attributes:
        pose: (N, 3), NaN rows where the truth is missing or marked bad.
        landmarks: true landmark positions by id.
        landmark_of: (M,) true id per observation, `CLUTTER` for none, `UNKNOWN_ID` where not known.
        relations: reference relations of a laser log.
        errors: systematic errors that a simulated robot has, by frame (sigma is zero).
    """

    pose: Array | None = None
    landmarks: LandmarkMap | None = None
    landmark_of: IntArray | None = None
    relations: Relations | None = None
    errors: Systematics | None = None

    @property
    def known_poses(self) -> int:
        """Number of frames with a true pose."""
        return 0 if self.pose is None else int(np.isfinite(self.pose).all(axis=1).sum())


__all__ = ["CLUTTER", "UNKNOWN_ID", "Relations", "Truth"]
