"""A result moved onto the truth as a whole, if that is asked for: poses, landmarks and covariances alike."""

from __future__ import annotations

import math

import numpy as np

from data import se2
from data.result import MapEstimate, Trajectory
from data.se2 import Array
from eval.referee.errors import align

NONE, FIRST, SE2 = "none", "first", "se2"
ALIGNMENTS = (NONE, FIRST, SE2)
ABOUT = {
    FIRST: "moved so that its first matched pose is the true one",
    SE2: "moved by the best rigid fit of its positions onto the truth (Umeyama 1991, without scale)",
}


def alignment(pose: Array, truth: Array, how: str) -> Array | None:
    """The motion (3,) T of `how`, to be put in front of every pose (n, 3); None for `none` or where nothing matches.

    Rows NaN are left out; a fit needs two matched poses, or else it is that of the first.
    """
    known = np.flatnonzero(np.isfinite(pose).all(axis=1) & np.isfinite(truth).all(axis=1))
    if how == NONE or not len(known):
        return None
    if how == FIRST or len(known) < 2:
        return se2.compose(truth[known[0]], se2.inverse(pose[known[0]]))
    R, t = align(pose[known, :2], truth[known, :2])
    return np.array([*t, math.atan2(R[1, 0], R[0, 0])])


def moved(T: Array, path: Trajectory) -> Trajectory:
    """The trajectory with T in front of every pose.

    World-frame errors turn with the poses: P becomes J P J', J = blockdiag(R, 1). The fit is taken as known: NEES
    after an alignment is not that of a consistent estimator. `se2` takes out of the error what P still holds of a
    common shift and turn, so it is smaller; `first` adds the first pose's error to all others, at a lever arm.
    """
    J = se2.world_from_body(float(T[2]))
    return Trajectory(se2.compose(T, path.pose), J @ path.covariance @ J.T)


def moved_map(T: Array, m: MapEstimate) -> MapEstimate:
    """The map likewise."""
    R = se2.rotation(float(T[2]))
    return MapEstimate(m.number, se2.transform_points(T, m.xy), R @ m.covariance @ R.T, m.first_frame, m.times_seen)


def moved_walls(T: Array, m: MapEstimate) -> MapEstimate:
    """The same of walls: alpha turns with the map, rho changes by the way along the normal."""
    alpha = m.xy[:, 1] + T[2]
    c, s = np.cos(alpha), np.sin(alpha)
    walls = np.stack([m.xy[:, 0] + c * T[0] + s * T[1], se2.wrap_angle(alpha)], axis=1)
    J = np.tile(np.eye(2), (len(walls), 1, 1))
    J[:, 0, 1] = c * T[1] - s * T[0]
    return MapEstimate(m.number, walls, J @ m.covariance @ J.transpose(0, 2, 1), m.first_frame, m.times_seen)
