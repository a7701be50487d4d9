"""Readings of a corridor log, true and measured, for its tests."""

from __future__ import annotations

import math

import numpy as np

from data.inputs import CLUTTER
from data.log import Log

ALL_ROUND = {"range": 1000.0, "min_angle": -math.pi, "max_angle": math.pi}


def points_seen(log: Log) -> set[tuple[int, int]]:
    """(frame, id) of every reading of a point."""
    ids = log.truth.landmark_of
    assert ids is not None
    return {(f, i) for f, i in zip(log.recorded.observations.frame.tolist(), ids.tolist()) if i != CLUTTER}


def exact_polar(log: Log) -> np.ndarray:
    """True range and bearing (M, 2) of the readings of points, by complex numbers."""
    frame, ids = log.recorded.observations.frame, log.truth.landmark_of
    assert ids is not None
    assert log.truth.pose is not None
    assert log.truth.landmarks is not None
    frame, ids = frame[ids != CLUTTER], ids[ids != CLUTTER]
    pose, point = log.truth.pose[frame], log.truth.landmarks.xy[ids - 1]
    seen = ((point - pose[:, :2]) @ [1, 1j]) * np.exp(-1j * pose[:, 2])
    return np.column_stack([np.abs(seen), np.angle(seen)])


def measured_polar(log: Log) -> np.ndarray:
    """The readings of points (M, 2) as range and bearing."""
    seen = log.recorded.observations.z[log.truth.landmark_of != CLUTTER] @ [1, 1j]
    return np.column_stack([np.abs(seen), np.angle(seen)])
