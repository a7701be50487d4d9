"""What was asked of a table's conversion, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from data.motion.velocity import VelocityNoise
from data.recordings.wheel_odometry import TravelNoise
from data.se2 import Array
from data.tables.columns import Columns
from data.tables.motion import Wheels

FROM_TRUTH = "truth"
"""The prior's mean is the first true pose."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What was asked for, in SI units.

    Attributes:
        files: path by role (odometry, observations, map, truth).
        columns: which column holds what, and units.
        kind: of odometry; None: found by its columns.
        wheels: of wheel ticks.
        noise: of the odometry.
        sigma: (2,) of a reading.
        prior: mean (3,), "truth", or None: the frame of the log starts at the robot; prior_sigma (3,) or None.
        map_pose: (3,) pose of the map's frame in the world; truth_pose: of the truth's.
        every_row: every odometry row is a frame, not only those with readings.
        max_range: m, view: rad, least and largest bearing; None: what is seen.
        sensor_pose: (3,) of the sensor in the body frame.
        sensed: a sensor read the labels.
    """

    files: Mapping[str, Path]
    columns: Columns
    kind: str | None
    wheels: Wheels | None
    noise: VelocityNoise | TravelNoise
    sigma: Array
    prior: Array | str | None
    prior_sigma: Array | None
    map_pose: Array
    truth_pose: Array
    every_row: bool
    max_range: float | None
    view: tuple[float, float] | None
    sensor_pose: Array
    sensed: bool
