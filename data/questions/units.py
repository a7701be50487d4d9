"""Questions about units: bearings and turn rates that look like degrees, stamps that are no seconds."""

from __future__ import annotations

import numpy as np

from data.log import Log
from data.questions.question import Question
from data.se2 import Array
from data.sensors import RangeBearing

TURN = 2.0 * np.pi
FASTEST = TURN
"""rad/s. A revolution a second; the fastest second of all recordings and worlds this was tried on turns 1.7 rad."""
SHARE = 0.01
"""Of the seconds in which it turns, how many must be that fast: a single slip or jump asks nothing."""
RATIO = (180.0 / np.pi) ** 0.5
"""Half-way (in logarithms) between two headings in one unit and one of them in degrees."""
TURNING = 0.05
"""rad/s. Root mean square below which a ratio of turn rates is one of noises."""
SLOW_FRAMES, FAST_FRAMES = 5.0, 1e-4
"""s. Frames are at most 1 s apart by the rules of the format; 10 Hz in ms gives 100 s, ms taken for ns 1e-7 s."""


def bearings(log: Log) -> list[Question]:
    """Bearings beyond one half turn."""
    sensor, z = log.recorded.sensor, log.recorded.observations.z
    if not isinstance(sensor, RangeBearing) or len(z) == 0:
        return []
    beyond = np.abs(z[:, 1]) > np.pi * (1.0 + 1e-6)
    if not beyond.any():
        return []
    low, high = z[:, 1].min(), z[:, 1].max()
    text = f"{int(beyond.sum())} of {len(z)} bearings lie beyond pi rad ({low:.4g} to {high:.4g}): "
    if max(abs(low), abs(high)) <= TURN * (1.0 + 1e-6):
        text += (
            "right if they are counted from 0 to 2 pi, otherwise state their unit in z2 of observations.csv as radians"
        )
    else:
        text += "are they degrees? Write radians (`data.convert table --unit bearing=deg` does)"
    return [Question("bearing unit", text)]


def turn_rates(log: Log) -> list[Question]:
    """Odometry or truth that turns faster than a robot does, or one of them many times faster than the other."""
    inputs, pose = log.recorded, log.truth.pose
    if len(inputs) < 2:
        return []
    advice = "write radians (`data.convert table --unit angle=deg` reads degrees)"
    odometry = _per_second(inputs.time, inputs.increments.mean[1:, 2])
    truth = None if pose is None else _per_second(inputs.time, _changes(pose[:, 2]))
    found = []
    for what, where, rate in (("odometry", "omega or dtheta", odometry), ("truth", "theta in truth.csv", truth)):
        if rate is not None and (np.abs(rate) > FASTEST).sum() > max(2.0, SHARE * np.count_nonzero(rate)):
            fast = int((np.abs(rate) > FASTEST).sum())
            found.append(
                Question(
                    f"{what} turn rate",
                    f"the {what} turns by more than 2 pi rad in {fast} of {len(rate)} seconds, up to "
                    f"{np.abs(rate).max():.4g} rad/s: is {where} in degrees? If so, {advice}",
                )
            )
    if found or truth is None:
        return found
    one, two = (float(np.sqrt(np.mean(rate**2))) for rate in (odometry, truth))
    if min(one, two) > 0.0 and max(one, two) > TURNING and max(one / two, two / one) > RATIO:
        larger = "odometry" if one > two else "truth"
        found.append(
            Question(
                f"{larger} turn rate",
                f"the odometry turns by {one:.3g} rad/s (root mean square), the truth by {two:.3g}: is the {larger} in "
                f"degrees? If so, {advice}",
            )
        )
    return found


def _changes(heading: Array) -> Array:
    """Changes of heading from frame to frame as they are written, without the jumps by 2 pi; 0 where one is unknown."""
    change = np.nan_to_num(np.diff(heading))
    change[np.abs(np.abs(change) - TURN) < 1.0] = 0.0
    return change


def _per_second(time: Array, turn: Array) -> Array:
    """Rates [rad/s] over the stretches of at least 1 s (or 1 step) that frames make up, which end together."""
    second = np.floor(time - time[0])
    edges = np.unique(np.concatenate([[0], 1 + np.flatnonzero(second[1:] > second[:-1]), [len(time) - 1]]))
    total = np.concatenate([[0.0], np.cumsum(turn)])
    rate: Array = np.diff(total[edges]) / np.maximum(np.diff(time[edges]), 1.0)
    return rate


def stamps(log: Log) -> list[Question]:
    """Frames so far apart, or so close together, that the stamps are not seconds."""
    inputs = log.recorded
    if inputs.time_is_index or len(inputs) < 3:
        return []
    gap = float(np.median(np.diff(inputs.time)))
    span = float(inputs.time[-1] - inputs.time[0])
    text = f"frames are {gap:.4g} s apart (median), {span:.6g} s in all"
    way = (
        "`data.convert table --unit time=` converts, and `time_is_index = true` in log.toml is for logs without stamps"
    )
    if gap > SLOW_FRAMES:
        unit = next(name for name, limit in (("ms", 1e4), ("us", 1e7), ("ns", np.inf)) if gap < limit)
        return [Question("time unit", f"{text}: are the stamps in {unit}? Write seconds ({way})")]
    if gap < FAST_FRAMES:
        return [Question("time unit", f"{text}: are the stamps larger units than s? Write seconds ({way})")]
    blind = _blind(log)
    if blind > 0.5:
        return [
            Question(
                "time unit",
                f"in {100.0 * blind:.0f} % of {span:.6g} s there is no odometry within 1 s: are the stamps in ms? "
                f"Write seconds ({way})",
            )
        ]
    return []


def _blind(log: Log) -> float:
    """Share of increments that bridge a gap in the odometry: no motion, and doubt that is the same along and across."""
    increments = log.recorded.increments
    mean, P = increments.mean[1:], increments.covariance[1:]
    still = ~mean.any(axis=1)
    return float((still & (P[:, 0, 0] == P[:, 1, 1]) & (P[:, 0, 0] > 1e-6)).mean())
