"""A second odometry topic of a ROS bag (`--second-odom`): closures between successive frames."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from data import se2
from data.errors import DataError, UsageError
from data.formats.bags.reading import Collected
from data.formats.bags.topics import Topic
from data.formats.recordings.laser import TravelNoise, increments_of
from data.formats.second_odometry import closures_between, covered, of_twists, own_name
from data.pose_measurements import Closures
from data.se2 import Array

STATED = "the twist covariances of its messages, whose errors are taken as independent of each other"


def second_closures(
    topic: Topic,
    name: str,
    found: Collected,
    noise: TravelNoise | None,
    robot: str,
    time: Array,
    taken: Collection[str],
) -> tuple[Closures, str]:  # fmt: skip
    """Closures between successive frames at `time` (N,) that the topic covers, of source `name`, and a sentence.

    `noise`: as stated; None: that of the twists in the messages. `robot`: the frame of the other odometry, on which tf
    mounts that of this one; `taken`: names of other sources.

    Raises:
        DataError: no message, or fewer than two frames covered, or a frame that tf does not mount.
        UsageError: noise that is stated nowhere.
    """
    rows = sorted(found.poses.get(topic.name, []), key=lambda r: r.stamp)
    if not rows:
        raise DataError(f"{topic.name}: no message; some are needed")
    stamp, first = np.unique([r.stamp for r in rows], return_index=True)
    pose, C = (np.array([r[k] for r in rows])[first] for k in (1, 2))
    body = found.frames[topic.name][1]
    if body and body != robot:
        placed = found.tree.between(body, robot, np.zeros(1))
        if placed is None:
            raise DataError(f"{topic.name}: poses of {body!r}, which tf does not mount on {robot!r}; one is needed")
        R, t = placed[0][0], placed[1][0]
        mounted = np.array([t[0], t[1], np.arctan2(R[1, 0], R[0, 0])])
        pose, C = se2.compose(pose, mounted), _moved(C, mounted)
    frames = np.flatnonzero(covered(stamp, time))
    if len(frames) < 2:
        what = f"its messages at {stamp[0]:.3f} to {stamp[-1]:.3f} s cover {len(frames)} of {len(time)} frames"
        raise DataError(f"{topic.name}: {what}; two are needed")
    at = time[frames]
    if noise is not None:
        motion, how = increments_of(se2.interpolate(stamp, pose, at), noise)[0], "--second-odom-sigma"
    elif not (np.isfinite(C).all() and (np.linalg.eigvalsh(np.where(np.isfinite(C), C, 0.0)) > 0.0).all()):
        what = "messages whose twist has no positive definite covariance of vx, vy and the turn"
        raise UsageError(f"{topic.name}: {what}; --second-odom-sigma S,S,S,S is needed")
    else:
        motion, how = of_twists(stamp, pose, C, at), STATED
    closures = closures_between(frames, motion, own_name(name, taken))
    pairs = f"{len(closures)} of {len(time) - 1} pairs of successive frames"
    return closures, f"{topic.name} is a second odometry: closures between {pairs}; noise by {how}."


def _moved(C: Array, mounted: Array) -> Array:
    """Covariances (K, 3, 3) of the velocity of a body as those of another one, at a pose (3,) in its frame."""
    x, y, theta = mounted.tolist()
    c, s = np.cos(theta), np.sin(theta)
    J = np.array([[c, s, -y * c + x * s], [-s, c, y * s + x * c], [0.0, 0.0, 1.0]])
    return np.asarray(J @ C @ J.T)
