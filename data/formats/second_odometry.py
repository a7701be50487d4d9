"""A second odometry of a recording (of a camera, beside the wheels): its motion between successive frames, as closures.

The first one is the motion of the log. Both move the same robot with errors of their own, so the second enters as
measured relative poses of the frames that it covers, each with the next such frame. Increments of either have
independent errors; a drift that both share, or that lasts, is in neither covariance.
"""

from collections.abc import Collection, Sequence

import numpy as np

from data.formats.recordings.laser import FLOOR
from data.inputs import Increments, IntArray
from data.motion.velocity import compose_in_place, floor_covariances
from data.pose_measurements import Closures
from data.se2 import Array, BoolArray, between, interpolate
from data.timeline import usual_gap


def covered(stamp: Array, time: Array) -> BoolArray:
    """Which frames at `time` (N,) lie between stamps (K,) at most `usual_gap` apart, or at one."""
    after = np.clip(np.searchsorted(stamp, time), 0, len(stamp) - 1)
    before = np.maximum(after - 1, 0)
    exact = stamp[after] == time
    inside = (stamp[before] < time) & (time < stamp[after]) & (stamp[after] - stamp[before] <= usual_gap(stamp) + 1e-6)
    return np.asarray(exact | inside)


def closures_between(frames: IntArray, motion: Increments, name: str, left_out: BoolArray | None = None) -> Closures:
    """Closures between successive frames (F,) from the motion into each; `left_out` (F - 1,): pairs without one."""
    kept = np.ones(len(frames) - 1, np.bool_) if left_out is None else ~left_out
    covariance, _ = floor_covariances(motion.covariance, FLOOR)
    return Closures(
        frames[:-1][kept], frames[1:][kept], motion.mean[1:][kept], covariance[1:][kept],
        np.zeros(int(kept.sum()), np.int64), (name,),
    )  # fmt: skip


def of_twists(stamp: Array, pose: Array, covariance: Array, at: Array) -> Increments:
    """Motion between instants `at` (F,) by poses (K, 3) with stamps (K,); `covariance` (K, 3, 3): of velocity and turn
    since the stamp before. Messages are independent: over d s of an interval the error has C d^2, over a part its
    share.
    """
    points = np.union1d(stamp[(stamp > at[0]) & (stamp < at[-1])], at)
    path = interpolate(stamp, pose, points)
    step = between(path[:-1], path[1:])
    row = np.clip(np.searchsorted(stamp, points[1:]), 1, len(stamp) - 1)
    spread = covariance[row] * ((stamp[row] - stamp[row - 1]) * np.diff(points))[:, None, None]
    ends = np.searchsorted(points, at)
    mean, P = np.zeros((len(at), 3)), np.zeros((len(at), 3, 3))
    for k in range(1, len(at)):
        for i in range(ends[k - 1], ends[k]):
            compose_in_place(mean[k], P[k], step[i], spread[i], mean[k], P[k])
        mean[k] = between(path[ends[k - 1]], path[ends[k]])
    return Increments(mean, 0.5 * (P + P.transpose(0, 2, 1)))


def together(parts: Sequence[Closures]) -> Closures | None:
    """All closures by their later frame; None: there are no parts."""
    if len(parts) < 2:
        return parts[0] if parts else None
    sources = tuple(name for part in parts for name in part.sources)
    first = np.cumsum([0, *(len(part.sources) for part in parts[:-1])])
    source = [part.source + n for part, n in zip(parts, first, strict=True)]
    frame1, frame2 = (np.concatenate([getattr(p, name) for p in parts]) for name in ("frame1", "frame2"))
    by = np.argsort(np.maximum(frame1, frame2), kind="stable")
    relative, covariance = (np.concatenate([getattr(p, n) for p in parts])[by] for n in ("relative", "covariance"))
    return Closures(frame1[by], frame2[by], relative, covariance, np.concatenate(source)[by], sources)


def own_name(name: str, taken: Collection[str]) -> str:
    """The name of the source, different from others."""
    return name if name not in taken else own_name(f"{name} odometry", taken)
