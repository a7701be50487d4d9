"""Other ways to read a log: every mistake that can be made in writing one is a change of its arrays. Their flags."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from data import se2
from data.columns.named import LENGTH
from data.inputs import IntArray
from data.log import ODOMETRY_KIND, TRUTH_POSE, Log
from data.questions import witnesses
from data.questions.witnesses import FEWEST, Case, Samples, changes
from data.se2 import Array, between, compose, inverse, rigid_fit, transform_points, wrap_angle
from data.sensors import RELATIVE_POINT

Change = Callable[[Case], Case]
Numbered = Callable[[float], Change]  # a change by a number


class Kind(StrEnum):
    """What a reading does otherwise."""

    UNIT = "unit"
    SIDE = "side"
    EXCHANGED = "exchanged"
    CLOCK = "clock"
    TURNED = "turned"
    WORLD = "world"
    COMPASS = "compass"
    FRAME = "frame"  # place of a part in the world
    SHIFTED = "shifted"  # ids
    STRANGE = "strange"  # ids of other landmarks
    STILL = "still"  # headings that never change
    ORDER = "order"
    SCALE = "scale"
    DOUBLED = "doubled"
    HOLD = "hold"
    PLACED = "placed"
    SUMMED = "summed"
    UNKNOWN = "unknown"


class Part(StrEnum):
    """A part of a log."""

    ODOMETRY = "odometry"
    OBSERVATIONS = "observations"
    MAP = "map"
    TRUTH = "truth"


@dataclass(frozen=True, eq=False)
class Reading:
    """Another way to read a log."""

    kind: Kind
    of: str  # the quantity, or the part of the log
    change: Change  # the case as it is read then
    unit: str = ""  # of a `UNIT`; of other kinds empty
    # s of a `CLOCK`, deg of `TURNED`, difference of `SHIFTED`; of a `UNIT` of all lengths, how many times as large as
    # the stated noise errors are
    number: float = math.nan
    carry: tuple[float, ...] = ()  # of a `FRAME` the pose by which it is moved, of `PLACED` where it is on the body

    @property
    def part(self) -> Part:
        """The part of the log that is read otherwise."""
        return PARTS.get(self.of, Part.OBSERVATIONS)


PARTS: Mapping[str, Part] = {
    **dict.fromkeys(("v", "omega", "v and omega", "bearing and omega", Part.ODOMETRY), Part.ODOMETRY),
    **dict.fromkeys((Part.MAP, "map.x", "map.y", "x and y of the map"), Part.MAP),
    **dict.fromkeys((Part.TRUTH, "point of the truth", "truth.x", "truth.y", "truth.theta"), Part.TRUTH),
    **dict.fromkeys(("truth and map", "x and y of the truth", "truth's mirror"), Part.TRUTH),
}
HEARD = {
    Part.ODOMETRY: (witnesses.BY_TRUTH, "observations and odometry", "observations and map"),
    Part.OBSERVATIONS: ("observations and odometry", "observations and truth", "observations and map"),
    Part.MAP: ("observations and truth", "observations and map"),
    Part.TRUTH: (witnesses.BY_TRUTH, "observations and truth"),
}  # Witnesses that speak of a part
METRES = {unit: metres for unit, metres in LENGTH.items() if unit != "m"}
SPEEDS = {"mm/s": 1e-3, "cm/s": 1e-2, "ft/s": 0.3048, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0}
DEG = math.pi / 180.0
TURNING = {"deg/s": DEG, "mrad/s": 1e-3, "rpm": math.pi / 30.0}
SIZES = SPEEDS | METRES | TURNING | {"min": 60.0}
BEARINGS = {"deg": DEG, "-deg": -DEG, "mrad": 1e-3}
TINY = 1e-6  # Least m, rad or s that is divided by
SMALL_NOISE = 30.0  # Largest multiple of the stated noise that errors of logs in metres have
ABOUT, MIRROR = np.array([0.0, 0.0, 1.0]), np.diag([1.0, -1.0, -1.0])


def _arcs(c: Case) -> tuple[Array, Array]:
    """Lengths (N,), negative backwards, and turns of the increments' arcs."""
    half = 0.5 * c.u[:, 2]
    sinc = np.sinc(half / np.pi)
    chord = c.u[:, 0] * np.cos(half) + c.u[:, 1] * np.sin(half)
    return chord / np.where(np.abs(sinc) < 1e-3, 1e-3, sinc), c.u[:, 2]


def faster(factor: float) -> Change:
    """Lengths of the odometry times a factor."""
    return lambda c: replace(c, u=c.u * [factor, factor, 1.0])


def turning(factor: float) -> Change:
    """Turns of the odometry times a factor; of poses the headings, with the positions as they are."""

    def change(c: Case) -> Case:
        if c.kind == "steps":
            return replace(c, u=c.u * [1.0, 1.0, factor])
        way, turn = _arcs(c)
        if c.kind != "poses":
            return replace(c, u=se2.along_arcs(way, factor * turn))
        path = c.odometry
        heading, step = factor * (path[:, 2] - path[0, 2]), np.diff(path[:, :2], axis=0)
        # the first heading is as wrong as the others: robots drive ahead
        ahead = np.sum((step[:, 0] + 1j * step[:, 1]) * np.exp(-0.5j * (heading[1:] + heading[:-1])))
        pose = np.column_stack([path[:, :2], heading + np.angle(ahead)])
        return replace(c, u=np.vstack([c.u[:1], between(pose[:-1], pose[1:])]))

    return change


def rates(factor: float) -> Change:
    """Velocities times a factor."""
    return lambda c: replace(c, u=se2.along_arcs(*(factor * np.array(_arcs(c)))))


def _since(*summed: int) -> Change:
    """Speeds (0) that are distances since the start, turn rates (1) that are headings."""

    def change(c: Case) -> Case:
        motion = list(_arcs(c))
        for k in summed if c.kind == "velocities" else ():
            total = motion[k][1:] / np.maximum(np.diff(c.time), TINY)
            step = np.append(0.0, np.diff(total, append=total[-1:]))
            motion[k] = np.asarray(wrap_angle(step)) if k else step
        return replace(c, u=se2.along_arcs(*motion))

    return change


def seen_as(*factors: float) -> Change:
    """Observations times a factor for each component."""
    return lambda c: replace(c, z=c.z * factors, R=c.R * np.square(factors))


def _swapped(c: Case) -> Case:
    return replace(c, z=c.z[:, ::-1], R=c.R[:, ::-1])


def on_map(M: Array) -> Change:
    """Landmarks of the map, times a matrix (2, 2)."""
    return lambda c: c if c.places is None else replace(c, places=c.places @ M.T)


def truly(change: Callable[[Array], Array]) -> Change:
    """Another truth."""
    return lambda c: c if c.truth is None else replace(c, truth=change(c.truth))


def shifted(by: int) -> Change:
    """Ids of which each is another number."""
    return lambda c: c if c.id is None else replace(c, id=np.where(c.id >= 0, c.id + by, c.id))


def late_by(part: str, seconds: float) -> Change:
    """A part whose stamps are so much later than what they are of."""

    def change(c: Case) -> Case:
        if part == Part.OBSERVATIONS:
            return replace(c, at=c.at - seconds)
        if part == Part.TRUTH:
            return replace(c, truth_time=c.truth_time - seconds)
        return replace(c, at=c.at + seconds, truth_time=c.truth_time + seconds)

    return change


def turned_by(degrees: float) -> Change:
    """A sensor that is turned counter-clockwise."""
    return lambda c: replace(c, mount=c.mount + DEG * degrees * ABOUT)


def heading_off(degrees: float) -> Change:
    """Headings of the truth, turned counter-clockwise."""
    return truly(lambda pose: pose + DEG * degrees * ABOUT)


def _from_places(c: Case) -> Case:
    """Observations that are places in the world, from the robot's pose."""
    path = c.seen_from or c.along
    if path is None or not c.cartesian:
        return c
    x, y = transform_points(inverse(path[0]), (c.z[:, :1] * np.stack([np.cos(c.z[:, 1]), np.sin(c.z[:, 1])], axis=1))).T
    return replace(c, z=np.stack([np.hypot(x, y), np.arctan2(y, x)], axis=1))


def mounted(c: Case, s: Samples) -> Reading | None:
    """The sensor at another place of the robot: by the map from the true path, else by what is seen as it turns."""
    if c.id is None or (path := c.seen_from or c.along) is None:
        return None
    pose, inside = path
    if c.names is not None and c.seen_from is not None:
        rows = s.some[inside[s.some]]
        off = transform_points(inverse(pose[rows]), witnesses.place_of(c, c.id[rows])) - c.points(rows, pose[rows, 2])
        off = off[np.isfinite(off).all(axis=1)]
        by = np.broadcast_to(np.eye(2), (len(off), 2, 2))
    elif (found := changes(c, s, path, c.spread)) is not None:
        off, by = found[0], found[3]
    else:
        return None
    mount = c.mount + _solved(by, off)
    moved = _at(mount - c.mount, mount)
    return Reading(Kind.PLACED, "place of the sensor", lambda c: replace(c, mount=mount), "", *moved)


def lever_arm(c: Case, s: Samples) -> Reading | None:
    """Truth of another point of the robot, by the odometry as it turns."""
    if c.truth is None or not c.u.any() or c.truth_time is not c.time:
        return None
    i, j = (np.concatenate(rows) for rows in zip(*s.spans, strict=True))
    a, b = between(c.truth[i], c.truth[j]), between(c.odometry[i], c.odometry[j])
    fine = np.isfinite(a).all(axis=1)
    at = _solved(se2.worlds_from_bodies(b[fine, 2])[:, :2, :2] - np.eye(2), (a - b)[fine, :2])
    return Reading(Kind.PLACED, "point of the truth", truly(lambda pose: compose(pose, -at)), "", *_at(at, at))


def _at(moved: Array, place: Array) -> tuple[float, tuple[float, ...]]:
    """How far a point is moved, and where it is then."""
    return float(np.hypot(*moved[:2])), tuple(place.tolist())


ROBUST = 4  # Fits, each without those that the one before left farthest


def _solved(A: Array, off: Array) -> Array:
    """The place (3,) that explains differences (n, 2) by A (n, 2, 2) best, without the largest that are left."""
    found, left = np.zeros(2), np.zeros(len(off))
    for _ in range(ROBUST if len(off) >= FEWEST else 0):
        near = left <= np.quantile(left, witnesses.KEPT[0])
        found[:] = np.linalg.lstsq(A[near].reshape(-1, 2), off[near].ravel())[0]
        left = np.hypot(*(A @ found - off).T)
    return np.array([*found, 0.0])


def frame_of(c: Case, rows: IntArray) -> Array | None:
    """The pose (3,) that carries what is observed from the true path onto the map."""
    if c.seen_from is None or c.id is None:
        return None
    pose, inside = c.seen_from
    place = witnesses.place_of(c, c.id[rows])
    fine = inside[rows] & np.isfinite(place).all(axis=1)
    if fine.sum() < FEWEST:
        return None
    rows = rows[fine]
    return rigid_fit(pose[rows, :2] + witnesses.rotated(pose[rows, 2], c.points(rows, pose[rows, 2])), place[fine])


READINGS: tuple[Reading, ...] = (
    *(Reading(Kind.UNIT, "v", faster(k), unit) for unit, k in SPEEDS.items()),
    Reading(Kind.SIDE, "v", lambda c: c if c.kind == "poses" else faster(-1.0)(c)),
    *(Reading(Kind.UNIT, "omega", turning(k), unit) for unit, k in TURNING.items()),
    Reading(Kind.SIDE, "omega", turning(-1.0)), Reading(Kind.SUMMED, "omega", _since(1)),
    Reading(Kind.SUMMED, "v", _since(0)), Reading(Kind.SUMMED, "v and omega", _since(0, 1)),
    Reading(Kind.UNIT, "v and omega", lambda c: rates(60.0)(c) if c.kind == "velocities" else c, "min"),
    Reading(Kind.EXCHANGED, "v and omega", lambda c: replace(c, u=se2.along_arcs(*_arcs(c)[::-1]))),
    *(Reading(Kind.UNIT, "range", seen_as(k, 1.0), unit) for unit, k in METRES.items() if unit != "km"),
    *(Reading(Kind.UNIT, "bearing", seen_as(1.0, k), unit) for unit, k in BEARINGS.items()),
    Reading(Kind.SIDE, "bearing", seen_as(1.0, -1.0)),
    Reading(Kind.SIDE, "bearing and omega", lambda c: turning(-1.0)(seen_as(1.0, -1.0)(c))),
    Reading(Kind.EXCHANGED, "range and bearing", _swapped),
    Reading(Kind.EXCHANGED, "range and bearing", lambda c: seen_as(1.0, DEG)(_swapped(c)), "deg"),
    Reading(Kind.WORLD, "bearing", lambda c: replace(c, world=True)), Reading(Kind.WORLD, "places", _from_places),
    Reading(Kind.UNIT, "stamps of observations", lambda c: replace(c, at=60.0 * c.at), "min"),
    # of two parts alone the same as v to the other side
    Reading(Kind.TURNED, "sensor", turned_by(180.0), number=180.0),
    *(Reading(Kind.UNIT, Part.MAP, on_map(k * np.eye(2)), unit) for unit, k in METRES.items()),
    Reading(Kind.EXCHANGED, "x and y of the map", on_map(np.eye(2)[::-1])),
    *(Reading(Kind.SIDE, f"map.{axis}", on_map(np.diag(m))) for axis, m in (("x", [-1.0, 1.0]), ("y", [1.0, -1.0]))),
    Reading(Kind.SIDE, "truth and map", lambda c: on_map(MIRROR[:2, :2])(truly(lambda p: p @ MIRROR)(c))),
    *(Reading(Kind.UNIT, Part.TRUTH, truly(lambda p, k=k: p * [k, k, 1.0]), unit) for unit, k in METRES.items()),  # type: ignore[misc]
    Reading(Kind.UNIT, "truth.theta", truly(lambda p: p * [1.0, 1.0, DEG]), "deg"),
    Reading(Kind.SIDE, "truth.theta", truly(lambda p: p * [1.0, 1.0, -1.0])),
    Reading(Kind.SIDE, "truth.x", truly(lambda p: p * [-1.0, 1.0, 1.0])),
    Reading(Kind.SIDE, "truth.y", truly(lambda p: p * [1.0, -1.0, 1.0])),
    Reading(Kind.SIDE, "truth's mirror", truly(lambda p: p * [1.0, -1.0, -1.0])),
    Reading(Kind.COMPASS, "truth.theta", truly(lambda p: p * [1.0, 1.0, -1.0] + 0.5 * np.pi * ABOUT)),
    Reading(Kind.EXCHANGED, "x and y of the truth", truly(lambda p: p[:, [1, 0, 2]])),
)  # fmt: skip

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
