"""A laser log replayed frame by frame: key poses by scan matching, loop closures, and the pose graph they feed."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from association.scans.constraints import Chain, Loops
from association.scans.points import Points, beams_of, scan_points
from data.inputs import Inputs
from data.se2 import Array, compose
from eval.replay.laser.parameters import LaserParameters
from eval.replay.laser.tracker import Tracker


@dataclass(frozen=True, eq=False)
class FrontEndResult:
    """What a replayed laser log came to.

    Attributes:
        chain, loops: the constraints for every back end.
        points: per key pose, its scan's surface points in the body frame.
        online: (N, 3) world pose of each frame as it was known then.
        seconds: (N,) wall time of each frame, matching, loops and graph.
    """

    chain: Chain
    loops: Loops
    points: list[Points]
    online: Array
    seconds: Array
