"""The flags of `slamref convert table` by which a log is read otherwise."""

import math
from collections.abc import Mapping

import numpy as np

from data.log import ODOMETRY_KIND, TRUTH_POSE, Log
from data.questions.readings import DEG, SMALL_NOISE, Kind, Part, Reading
from data.se2 import Array, compose, inverse, wrap_angle
from data.sensors import RELATIVE_POINT

QUANTITIES = {
    "velocities": ("odometry.v", "odometry.omega"), "poses": ("odometry.x,odometry.y", "odometry.theta"),
    "steps": ("odometry.dx,odometry.dy", "odometry.dtheta"), "sideways": ("odometry.v,odometry.vy", "odometry.omega"),
    "course": ("odometry.v", "odometry.theta"),
}  # fmt: skip
"""Columns of lengths and of angles of each kind of odometry in tables."""


def as_pose(pose: Array, metres: str = "") -> str:
    """A pose (3,) as flags read it; `metres`: unit of lengths."""
    return f"{pose[0]:.6g}{metres},{pose[1]:.6g}{metres},{math.degrees(pose[2]):.6g}deg"


def metres_of(log: Log) -> str:
    """The unit that lengths of flags need: m, where the command that converted a log states another one."""
    return "m" if _given(log, "unit").get("length", "m") != "m" else ""


def flags_of(r: Reading, log: Log) -> tuple[str, ...]:
    """The flags of `slamref convert table` by which a log is read that way; none where no flag does."""
    lengths, angles = QUANTITIES.get(str(log.source.get(ODOMETRY_KIND, "velocities")), QUANTITIES["velocities"])
    cartesian = log.recorded.sensor.kind == RELATIVE_POINT
    ranges = "observations.x,observations.y" if cartesian else "observations.range"
    bearings = "observations.y" if cartesian else "observations.bearing"
    columns = {
        "v": lengths, "omega": angles, "range": ranges, "bearing": bearings,
        Part.MAP: "map.x,map.y", Part.TRUTH: "truth.x,truth.y", "fixes": "fixes.x,fixes.y",
        "stamps of observations": "observations.t",
        **{key: key for key in ("map.x", "map.y", "truth.x", "truth.y", "truth.theta")},
        "bearing and omega": f"{angles},{bearings}", "truth and map": "truth.y,truth.theta,map.y",
        "truth's mirror": "truth.y,truth.theta", "v and omega": "odometry.v,odometry.omega",
        "range and bearing": "observations.range,observations.bearing", "x and y of the map": "map.x,map.y",
        "x and y of the truth": "truth.x,truth.y", "left and right": "odometry.left,odometry.right",
        "odometry's mirror": ",".join([*lengths.split(",")[1:], angles]),
    }  # fmt: skip
    if r.of == "everything" and r.unit == "min":
        return ("--unit time=min",)
    if r.of == "everything" and 1.0 / SMALL_NOISE < r.number <= SMALL_NOISE:
        return (f"--unit length={r.unit}",)
    if r.of == "everything":  # but the lengths of flags, which `length` is of, too
        placed = cartesian or log.recorded.map is not None or log.truth.pose is not None
        way = [key.partition(".")[2] for key in lengths.split(",")]
        keyed = dict.fromkeys([*way, *["range"] * (not cartesian), *["x", "y"] * placed])
        return ("--unit " + ",".join(f"{key}={r.unit}{'/s' * (key == 'v')}" for key in keyed),)
    if r.unit == "rad":
        return ("--unit lat=rad,lon=rad",)
    keys = ["time"] if r.unit == "min" and r.of == "v and omega" else columns.get(r.of, "").split(",")
    if r.kind in (Kind.UNIT, Kind.SIDE) or r.unit == "row" or (r.kind == Kind.STRANGE and r.unit):
        return ("--unit " + ",".join([f"{key}={_unit(log, key, r)}" for key in keys]),)
    if r.kind == Kind.FRAME:
        before = np.array(log.source.get(TRUTH_POSE, np.zeros(3)), float)
        return (f"--truth-transform={as_pose(compose(np.array(r.carry), before), metres_of(log))}",)
    given = _given(log, "columns")
    if r.kind == Kind.STILL:
        named = [given.get(f"truth.{k}", given.get(k, k)) for k in ("qx", "qy", "qz", "qw")]
        rolled = zip(("qw", "qx", "qy", "qz"), named, strict=True)
        return ("--columns " + ",".join(f"truth.{k}={name}" for k, name in rolled),)
    if r.kind == Kind.EXCHANGED:
        a, b = keys
        names = [given.get(key, given.get(key.partition(".")[2], key.partition(".")[2])) for key in (a, b)]
        return (f"--columns {a}={names[1]},{b}={names[0]}", *[f"--unit {b}={r.unit}"] * bool(r.unit))
    if r.kind in (Kind.ORDER, Kind.HOLD):
        return (f"--{'integrate' if r.kind == Kind.ORDER else 'hold'} {r.unit}",)
    if r.kind == Kind.CLOCK:
        added = float(_given(log, "time_offset").get(r.of, 0.0))
        return (f"--time-offset {r.of}={added - r.number:.6g}",)
    if r.of == "place of the sensor":
        return (f"--sensor-pose={as_pose(np.array(r.carry), metres_of(log))}",)
    if r.kind == Kind.TURNED and r.of == "sensor":
        s = log.recorded.sensor
        pose = inverse(np.array([*s.translation, s.rotation])) + 0.0
        pose[2] = wrap_angle(float(pose[2]) + DEG * r.number)
        return (f"--sensor-pose={as_pose(pose, metres_of(log))}",)
    return ()


def _given(log: Log, key: str) -> Mapping[str, str]:
    """Pairs that were stated when the log was made, by key."""
    found = log.source.get(key)
    return {str(k): str(v) for k, v in found.items()} if isinstance(found, Mapping) else {}


def _unit(log: Log, key: str, r: Reading) -> str:
    """The unit of a column as it is read otherwise."""
    given, name = _given(log, "unit"), key.partition(".")[2]
    angle = name in ("omega", "bearing", "theta", "dtheta")
    plain = ("rad" if angle else "m") + ("/s" if name in ("v", "omega") else "")
    unit = given.get(key, given.get(name, given.get("angle" if angle else "length", plain)))
    unit += "/s" if name in ("v", "omega") and "/" not in unit else ""
    if r.kind == Kind.SUMMED:
        return f"{unit.partition('/')[0]}/{r.number:.6g}s"
    if r.kind == Kind.SIDE:
        return unit.removeprefix("-") if unit.startswith("-") else f"-{unit}"
    return r.unit.removesuffix("/s") + ("/s" if r.unit.endswith("/s") and name in ("v", "omega") else "")
