"""The referee's side of a log: true poses, true landmarks, and the true landmark of each observation."""

from dataclasses import dataclass

import numpy as np

from data.inputs import IntArray, LandmarkMap
from data.locked import Locked
from data.result import Systematics
from data.se2 import Array

UNKNOWN_ID = -2  # True id of an observation whose id is unknown (blank in the file)


@dataclass(frozen=True, eq=False)
class Relations(Locked):
    """Reference relations (K): relative poses between frames, known without a true path."""

    row1: IntArray  # frames
    row2: IntArray
    relative: Array  # (K, 3), pose of row2 in the frame of row1 [m, m, rad]
    exact: IntArray | None = None  # 1 where both rows are certain, else 0; None: not stated
    stamp: Array | None = None  # (K, 2) s, the reference's own stamps; None: rows only
    frame_stamp: Array | None = None  # (N,) s, the frames' recorded stamps, not made monotone; None: the log's time
    covariance: Array | None = None  # (K, 3, 3) of the relative pose, in the frame of row1; None: not stated

    def __len__(self) -> int:
        return len(self.row1)


@dataclass(frozen=True)
class BadTruth:
    """A window of bad ground truth (`data.truth_windows`)."""

    first: int  # first, last: frames
    last: int
    start: float  # start, end: s of the log's recording (`Log.clock`), rounded outwards to ms
    end: float
    off: float  # median distance of observations from what the truth predicts, in robust sigmas; NaN: there are none
    carried: float  # the same from what the odometry predicts; NaN: it was not needed


@dataclass(frozen=True, eq=False)
class Truth(Locked):
    """Ground truth; any part may be None, and metrics that need it are then blank."""

    # (N, 3), NaN rows where missing or marked bad; a heading alone may be NaN: only the position is known
    pose: Array | None = None
    landmarks: LandmarkMap | None = None  # true landmark positions by id
    landmark_of: IntArray | None = None  # (M,) true id per observation, `CLUTTER` for false alarms, `UNKNOWN_ID`
    relations: Relations | None = None  # reference relations of a laser log
    errors: Systematics | None = None  # true systematic errors of a simulated robot, by frame (sigma is zero)
    left_out: tuple[BadTruth, ...] = ()  # windows of bad ground truth, whose poses are NaN
    # stretches (from, to) [s of the log's recording], whose poses are NaN on request
    excluded: tuple[tuple[float, float], ...] = ()
    # windows of bad ground truth were looked for, or are scored on request (`data.truth_windows.scored`)
    screened: bool = False
    fix_inlier: IntArray | None = None  # (F,) 1 where a fix is right, 0 an outlier, -1 unknown; None: not stated
    closure_inlier: IntArray | None = None  # (K,) the same of each closure

    @property
    def known_poses(self) -> int:
        """Number of frames with a true position, and mostly a heading."""
        return 0 if self.pose is None else int(np.isfinite(self.pose[:, :2]).all(axis=1).sum())

    @property
    def has_headings(self) -> bool:
        """Whether some true pose has a heading."""
        return self.pose is not None and bool(np.isfinite(self.pose[:, 2]).any())
