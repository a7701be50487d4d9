"""Faults of a foreign world: how strong each is, where it can be seen, and which causes name it rightly.

`strength` 1 is the strong one of the table; factors go from 1, all others from 0 in proportion to it. Where nothing
is `right`, the list has no such cause, and that is to be said.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from data import se2
from data.inputs import IntArray, LandmarkMap
from data.se2 import Array
from tests.research.foreign.shapes import Drive, Generator, Shape

FACTOR, AMOUNT = "factor", "amount"


@dataclass(frozen=True)
class Fault:
    size: float  # size: the strong one. kind: `FACTOR` of something that is 1 where sound, or `AMOUNT` that is 0
    right: tuple[str, ...]  # patterns of `kind name` of findings that name it rightly, alone or in an "or"
    kind: str = AMOUNT
    tasks: tuple[str, ...] = ("localization", "slam")  # where it makes a difference
    labels: bool = False  # it makes none unless labels are granted
    about: str = field(default="", compare=False)

    def of(self, strength: float) -> float:
        """The size at a strength."""
        return 1.0 + (self.size - 1.0) * strength if self.kind == FACTOR else self.size * strength


TURNED = ("systematic z?_turn_rate", "latency *", "systematic latency*", "input clock", "systematic odometry_latency")
LATE = ("systematic z?_speed", *TURNED)
"""Odometry that is early and readings that are late are one thing."""
MOUNT = ("systematic odometry_?_turn", "mount *", "systematic mount*")
MAP = ("localization",)
MAPPED = ("input strange", "map *", "landmark *", "displaced *", "systematic map*")
JUMP = ("jump *", "burst *", "bursts *")

FAULTS: Mapping[str, Fault] = {
    "odometry-sigma": Fault(3.0, ("sigma odometry*",), FACTOR, about="true noise of odometry, of the stated"),
    "gyro-bias": Fault(0.5 * math.pi / 180.0, ("systematic odometry_theta_time",), about="rad/s"),
    "wheel-radius": Fault(1.03, ("systematic odometry_[xy]_distance", "systematic odometry_theta_turn",
                                 "systematic odometry_scale"), FACTOR),
    "wheel-base": Fault(1.05, ("systematic odometry_theta_turn",), FACTOR, about="turns as read, of the true"),
    "stride": Fault(1.05, ("systematic odometry_x_distance",), FACTOR, about="ways as read; turns are right"),
    "current": Fault(0.06, ("systematic odometry_current*",),
                     about="units/s in which all drifts to one side of the world, unseen by odometry"),
    "lateral-slip": Fault(0.02, ("systematic odometry_y_distance",), about="sideways, of the way forward"),
    "range-sigma": Fault(2.0, ("sigma z1",), FACTOR, about="true noise of z1, of the stated"),
    "sensor-sigma": Fault(2.0, ("sigma z",), FACTOR, about="true noise of both coordinates, of the stated"),
    "sensor-sigma-half": Fault(0.5, ("sigma z",), FACTOR),
    "range-scale": Fault(1.02, ("systematic z1_range",), FACTOR),
    "focal-length": Fault(1.06, ("systematic z2_scale",), FACTOR, about="bearings, or the points' y, of the true ones"),
    "bearing-offset": Fault(1.9 * math.pi / 180.0, ("systematic z2_constant", "systematic z2_range"), about="rad"),
    "mount-0.1": Fault(0.1, MOUNT, about="units ahead or aside that are not stated"),
    "mount-0.5": Fault(0.5, MOUNT),
    "latency": Fault(0.08, LATE, about="s that readings are late"),
    "latency-growing": Fault(0.25, LATE, about="s of lateness at the end, none at the start"),
    "ar1": Fault(0.9, ("correlation *", "correlated *"), about="correlation of a landmark's successive readings"),
    "noisy-stretch": Fault(3.0, ("change *", "stretch *"), FACTOR, about="noise of readings in a fifth of the frames"),
    "tails": Fault(1.0, ("tails *",), about="share of readings with Student's t of 3, of the stated variance"),
    "outliers": Fault(0.05, ("tails *", "outliers *"), about="share of readings off by up to 20 sigma"),
    "kidnapping": Fault(1.5, JUMP, about="units sideways, and as many thirds of a radian, in one frame"),
    "wheel-slip": Fault(0.6, JUMP, about="of the way as read is not driven, in three bursts of 1 s"),
    "map-swapped": Fault(2.0, (*MAPPED, "pairings *"), tasks=MAP, about="rows of the map exchanged, among those seen"),
    "map-moved": Fault(0.5, MAPPED, tasks=MAP, about="units that one landmark stands off"),
    "map-scale": Fault(1.02, MAPPED, FACTOR, tasks=MAP),
    "shared-label": Fault(1.0, ("label *", "landmark *", "pairings *"), labels=True, about="pairs of one label"),
    "turn-first": Fault(1.0, ("systematic odometry_y_turn", "systematic odometry_integration", *TURNED),
                        about="share of the turn"),
    "interval-end": Fault(1.0, (*LATE, "integration *", "stamp *"), about="frames that odometry is stamped late"),
    "mirrored": Fault(1.0, ("mirrored *", "input side"), about="bearings to the other side"),
}  # fmt: skip
"""By name. What the diagnosis calls them may change: then `right` does, and nothing else here."""


def on_path(fault: str | None, size: float, driven: Array, shape: Shape, rng: Generator) -> Array:
    """True poses (n, 3) of a robot on whose motion something acts that odometry does not see."""
    if fault == "lateral-slip":
        return se2.compose(driven, np.array([0.0, 0.0, -math.atan(size)]))
    if fault == "current":
        angle = rng.uniform(0.0, 2.0 * math.pi)
        drift = size * shape.unit / shape.rate * np.array([math.cos(angle), math.sin(angle), 0.0])
        return driven + np.arange(len(driven))[:, None] * drift
    if fault == "kidnapping":
        k = int(rng.integers(int(0.3 * len(driven)), int(0.7 * len(driven))))
        side, way = rng.choice((-1.0, 1.0)), rng.uniform(0.0, 2.0 * math.pi)
        move = np.array([size * shape.unit * math.cos(way), size * shape.unit * math.sin(way), side * size / 3.0])
        # a jump in the robot's own frame: all later motion is as before
        jump = se2.compose(se2.compose(driven[k], move), se2.inverse(driven[k]))
        return np.concatenate([driven[:k], se2.compose(jump, driven[k:])])
    return driven


def on_motion(fault: str | None, size: float, drive: Drive, time: Array, rng: Generator) -> Array:
    """Increments (n, 3) that odometry would read without noise, row 0 zero."""
    shift = size * (time[1] - time[0]) if fault == "interval-end" else 0.0
    poses = drive.at(time - shift)
    read = np.zeros_like(poses)
    read[1:] = se2.between(poses[:-1], poses[1:])
    dt, turn = np.diff(time, prepend=time[0]), read[:, 2].copy()
    extra = np.zeros(len(time))
    if fault == "gyro-bias":
        extra = size * dt
    elif fault in ("wheel-radius", "wheel-base"):
        extra = (size - 1.0) * turn
    if fault in ("wheel-radius", "stride"):
        read[:, :2] *= size
    elif fault == "wheel-slip":
        for begin in rng.uniform(0.1, 0.9, 3) * time[-1]:
            inside = (time >= begin) & (time < begin + 1.0)
            read[inside, :2] /= 1.0 - size
    # a chord lies half the turn beside the heading it began with
    half = 0.5 * (size * turn if fault == "turn-first" else extra)
    c, s = np.cos(half), np.sin(half)
    x, y = read[:, 0].copy(), read[:, 1].copy()
    read[:, 0], read[:, 1], read[:, 2] = c * x - s * y, s * x + c * y, turn + extra
    return read


def lateness(fault: str | None, size: float, time: Array) -> Array:
    """How late readings are in each frame [s]."""
    if fault == "latency":
        return np.full(len(time), size)
    return size * time / time[-1] if fault == "latency-growing" else np.zeros(len(time))


def sensor_at(fault: str | None, size: float, shape: Shape, rng: Generator) -> Array:
    """Where the sensor is on the robot, beside where it is stated (2,) m: ahead, behind or aside."""
    if fault in ("mount-0.1", "mount-0.5"):
        angle = 0.5 * math.pi * float(rng.integers(4))
        return size * shape.unit * np.array([math.cos(angle), math.sin(angle)])
    return np.zeros(2)


def on_exact(fault: str | None, size: float, z: Array, polar: bool) -> Array:
    """Readings (m, 2) without noise, as a wrong sensor has them."""
    z = z.copy()
    if fault == "range-scale":
        z[:, : 1 if polar else 2] *= size
    elif fault == "focal-length":
        z[:, 1] *= size
    elif fault == "bearing-offset" and polar:
        z[:, 1] += size
    elif fault == "bearing-offset":
        z = z @ se2.rotation(size).T
    elif fault == "mirrored":
        z[:, 1] *= -1.0
    return z


def noise(fault: str | None, size: float, frame: IntArray, who: IntArray, frames: int, rng: Generator) -> Array:
    """Noise of readings (m, 2) in stated sigmas."""
    m = len(frame)
    if fault == "tails":
        heavy = rng.random(m) < size
        return np.where(heavy[:, None], rng.standard_t(3.0, (m, 2)) / math.sqrt(3.0), rng.standard_normal((m, 2)))
    plain = rng.standard_normal((m, 2))
    if fault in ("sensor-sigma", "sensor-sigma-half"):
        plain *= size
    elif fault == "range-sigma":
        plain[:, 0] *= size
    elif fault == "noisy-stretch":
        begin = int(rng.uniform(0.15, 0.65) * frames)
        plain[(frame >= begin) & (frame < begin + frames // 5)] *= size
    elif fault == "outliers":
        off = rng.random(m) < size
        plain[off] += rng.uniform(-20.0, 20.0, (int(off.sum()), 2))
    elif fault == "ar1":
        for landmark in np.unique(who):
            for before, now in pairwise(np.flatnonzero(who == landmark)):
                a = size ** float(frame[now] - frame[before])
                plain[now] = a * plain[before] + math.sqrt(1.0 - a * a) * plain[now]
    return plain


def on_map(
    fault: str | None, size: float, known: LandmarkMap, who: IntArray, shape: Shape, rng: Generator
) -> LandmarkMap:
    """The map as it is given; `who`: ids as read, whose landmarks are those that a fault is about."""
    seen, count = np.unique(who, return_counts=True)
    often = known.rows(seen[np.argsort(-count, kind="stable")[: max(len(seen) // 2, 2)]])
    xy = known.xy.copy()
    if fault == "map-swapped":
        for _ in range(max(int(size) // 2, 1)):
            a, b = rng.choice(often, 2, replace=False)
            xy[[a, b]] = xy[[b, a]]
    elif fault == "map-moved":
        angle = rng.uniform(0.0, 2.0 * math.pi)
        xy[rng.choice(often)] += size * shape.unit * np.array([math.cos(angle), math.sin(angle)])
    elif fault == "map-scale":
        xy = xy.mean(axis=0) + size * (xy - xy.mean(axis=0))
    return replace(known, xy=xy)


def labels(fault: str | None, size: float, who: IntArray, rng: Generator) -> IntArray | None:
    """Labels that differ from the true ids, or None: the label of one landmark stands on another, too."""
    if fault != "shared-label":
        return None
    seen, count = np.unique(who, return_counts=True)
    often = seen[np.argsort(-count, kind="stable")[: max(len(seen) // 2, 2)]]
    label = who.copy()
    for _ in range(max(int(size), 1)):
        a, b = rng.choice(often, 2, replace=False)
        label[label == a] = b
    return label
