"""The log of a ROS bag: odometry, and whatever of detections, fixes, scans and truth it holds.

Frames are the instants of scans, detections and fixes, and every second, within the span of the odometry, whose poses
are interpolated. The body is the odometry's child frame; tf places cameras and antennas on it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data import se2
from data.digest import source_file
from data.errors import DataError, UsageError
from data.formats.bags.reading import FIXES, Collected, Pose, Role, Topic
from data.formats.recordings.laser import FLOOR, TravelNoise, increments_of
from data.formats.recordings.ros import ODOM_FRAME, TF, log_of, read_bag
from data.formats.results.path import ABSENT, unturned
from data.formats.second_odometry import closures_between, covered, of_twists, own_name
from data.inputs import UNLABELLED, Inputs, IntArray, Observations, Prior, Scans
from data.log import Log
from data.origin import Origin
from data.pose_measurements import Closures, Fixes, FixKind, FixSource
from data.se2 import Array
from data.sensors import Bearing, RangeBearing, RelativePoint, Sensor
from data.terminal import counted
from data.timeline import frame_times, truth_at
from data.truth import Truth

# A second odometry topic of a ROS bag (`--second-odom`): closures between successive frames.

STATED = "the twist covariances of its messages, whose errors are taken as independent of each other"


def _poses(topic: Topic, found: Collected, robot: str) -> tuple[Array, Array, Array, Array | None]:
    """Stamps (K,), ascending, poses (K, 3) and covariances (K, 3, 3) of a topic, and the pose (3,) of the robot's frame
    in that of these poses; None: unknown.
    """
    rows = sorted(found.poses[topic.name], key=lambda r: r.stamp)
    stamp, first = np.unique([r.stamp for r in rows], return_index=True)
    pose, C = (np.array([r[k] for r in rows])[first] for k in (1, 2))
    body = found.frames[topic.name][1]
    if not body or body == robot:
        return stamp, pose, C, np.zeros(3)
    placed = found.tree.between(body, robot, np.zeros(1))
    if placed is None:
        return stamp, pose, C, None
    R, t = placed[0][0], placed[1][0]
    return stamp, pose, C, np.array([t[0], t[1], np.arctan2(R[1, 0], R[0, 0])])


def second_closures(
    topic: Topic, found: Collected, noise: TravelNoise | None, robot: str, time: Array, taken: Collection[str]
) -> tuple[Closures, str]:
    """Closures between successive frames at `time` (N,) that the topic covers, and a sentence.

    `noise`: as stated; None: that of the twists in the messages. `robot`: the frame of the other odometry, on which tf
    mounts that of this one; `taken`: names of other sources.

    Raises:
        DataError: no message, or fewer than two frames covered, or a frame that tf does not mount.
        UsageError: noise that is stated nowhere.
    """
    if not found.poses.get(topic.name):
        raise DataError(f"{topic.name}: no message; some are needed")
    stamp, pose, C, mounted = _poses(topic, found, robot)
    if mounted is None:
        body = found.frames[topic.name][1]
        raise DataError(f"{topic.name}: poses of {body!r}, which tf does not mount on {robot!r}; one is needed")
    if mounted.any():
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
    closures = closures_between(frames, motion, own_name(_named(topic.name), taken))
    pairs = f"{len(closures)} of {len(time) - 1} pairs of successive frames"
    return closures, f"{topic.name} is a second odometry: closures between {pairs}; noise by {how}."


def _moved(C: Array, mounted: Array) -> Array:
    """Covariances (K, 3, 3) of the velocity of a body as those of another one, at a pose (3,) in its frame."""
    x, y, theta = mounted.tolist()
    c, s = np.cos(theta), np.sin(theta)
    J = np.array([[c, s, -y * c + x * s], [-s, c, y * s + x * c], [0.0, 0.0, 1.0]])
    return np.asarray(J @ C @ J.T)


# Latitude and longitude (WGS 84) as metres east and north of a place.
#
# A tangent plane: within 10 km of its origin distances are true to 1e-6 of themselves (Groves 2013, section 2.4).

RADIUS, ECCENTRICITY_SQUARED = 6378137.0, 6.69437999014e-3
"""m, 1; of the ellipsoid."""


def centred(place: Array) -> Array:
    """Cartesian coordinates (..., 3) [m], with the origin at the Earth's centre, of latitude, longitude [deg], height
    [m] (..., 3).
    """
    latitude, longitude, height = np.radians(place[..., 0]), np.radians(place[..., 1]), place[..., 2]
    normal = RADIUS / np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    level = (normal + height) * np.cos(latitude)
    up = ((1.0 - ECCENTRICITY_SQUARED) * normal + height) * np.sin(latitude)
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), up], axis=-1)


def east_north(place: Array, origin: Array) -> Array:
    """Metres east and north (N, 2) of an origin (3,), both as latitude, longitude [deg], height [m]; places (N, 3)."""
    off = centred(place) - centred(origin)
    (s_lat, c_lat), (s_lon, c_lon) = ((np.sin(a), np.cos(a)) for a in np.radians(origin[:2]))
    east = np.array([-s_lon, c_lon, 0.0])
    north = np.array([-s_lat * c_lon, -s_lat * s_lon, c_lat])
    return np.asarray(np.stack([off @ east, off @ north], axis=-1))


EVERY = 1.0
"""s between headings that are used: those of one second have one common error, of the magnetic field and the filter."""
LONGEST = 1e6
"""s, longest log."""
FIRST = (0.1, 0.1, 0.05)
"""m, m, rad; standard deviations of the first true pose as the prior."""


@dataclass(frozen=True)
class Wanted:
    """What messages do not state: prior mean and sigma (3,); sigma of points [m], bearings [rad], positions [m] and
    headings [rad] without covariance; second: noise of a second odometry. None: not stated.
    """

    prior: Array | None = None
    prior_sigma: Array | None = None
    points: float | None = None
    bearings: float | None = None
    positions: float | None = None
    headings: float | None = None
    second: TravelNoise | None = None


@dataclass(frozen=True, eq=False)
class _Seen:
    """Observations of one topic: its sensor, stamps (m,) [s], z (m, 2), R (m, 2, 2), ids (m,), -1 for none."""

    sensor: Sensor
    at: Array
    z: Array
    R: Array
    id: IntArray


@dataclass(frozen=True, eq=False)
class _Fixed:
    """Fixes of one topic: their source, kind, stamps (f,) [s], z (f, 3), covariance (f, 3, 3)."""

    source: FixSource
    kind: FixKind
    at: Array
    z: Array
    covariance: Array


def log_of_bag(path: Path, name: str, topics: Sequence[Topic], found: Collected, wanted: Wanted) -> Log:
    """The log. DataError or UsageError where odometry, noise or prior are missing."""
    notes: list[str] = []
    odometry, robot, stamp, pose = _odometry(path, topics, found)
    seen, left = _observed(topics, found, wanted, robot, stamp)
    fixed, datum = _fixed(topics, found, wanted, robot)
    scan = next((t.name for t in topics if t.role is Role.SCANS), None)
    scans = None
    if scan is not None:
        laser = log_of(path, read_bag(path, scan, odometry))
        scans = laser.recorded.scans
        notes += [note for note in laser.notes if note.startswith(("The laser", "No return"))]
    second = next((t for t in topics if t.role is Role.SECOND), None)
    if not seen and not fixed and scans is None and second is None:
        reasons = "; ".join(left) or "no topic of scans, detections or fixes"
        raise DataError.at(path, f"nothing beside the odometry: {reasons}; --list names what each topic becomes")
    notes = [f"Odometry: {odometry}, poses of {robot or 'the robot'} interpolated at the frames.", *notes, *left]
    first, last = float(stamp[0]), float(stamp[-1])
    if last - first > LONGEST:
        raise DataError.at(path, f"the odometry spans {last - first:.6g} s; stamps in seconds are needed")
    at = [s.at for s in seen] + [f.at for f in fixed]
    at += [laser.recorded.time] if scans is not None else []
    every = np.concatenate([np.empty(0), *at])
    inside = (every >= first) & (every <= last)
    if at and not inside.any():
        what = f"messages at {every.min():.3f} to {every.max():.3f} s, odometry at {first:.3f} to {last:.3f} s"
        raise DataError.at(path, f"{what}; some within the odometry are needed")
    if not inside.all():
        notes.append(f"{int((~inside).sum())} of {len(inside)} messages before or after all odometry: left out.")
    time = frame_times(every[inside], first, last)
    increments, floored = increments_of(se2.interpolate(stamp, pose, time))
    closures = None
    if second is not None:
        taken = [f.source.name for f in fixed]
        closures, note = second_closures(second, found, wanted.second, robot, time, taken)
        notes.append(note)
    observations, sensors, label = _joined(seen, time)
    true = _truth(topics, found, robot, time)
    notes += [f"Truth: {ABSENT}."] if true is not None and not np.isfinite(true[:, 2]).any() else []
    if datum is not None:
        notes.append(f"The world's x and y point east and north; its origin is at {datum[0]:.9g}, {datum[1]:.9g} deg.")
    prior, note = _prior(wanted, pose[0], true, fixed, first)
    recorded = Inputs(
        prior=prior,
        time=time - first,
        increments=increments,
        observations=observations,
        sensor=sensors[0] if sensors else RangeBearing(),
        covariance_floor=FLOOR,
        floored=floored,
        scans=None if scans is None else Scans(scans.scanner, _at(laser.recorded.time, time), scans.ranges),
        fixes=_all_fixes(fixed, time) if fixed else None,
        closures=closures,
        sensors=sensors if len(sensors) > 1 else (),
    )
    origins = {} if scan is None else {**laser.origins}
    origins |= {"odometry_noise": Origin.ASSUMED} | ({"observation_noise": Origin.GIVEN} if seen else {})
    given = {"fix_noise": wanted.positions or wanted.headings, "closure_noise": wanted.second}
    origins |= {quantity: Origin.GIVEN for quantity, value in given.items() if value is not None}
    origins |= {f"max_range.{s.sensor.label}": Origin.INFERRED for s in seen if isinstance(s.sensor, RelativePoint)}
    if wanted.prior_sigma is not None or true is not None:
        origins["prior"] = Origin.ASSUMED if wanted.prior_sigma is None else Origin.GIVEN
    roles = {t.name: t.role.value for t in topics if t.role not in (Role.NOTHING, Role.TRANSFORMS, Role.CAMERA)}
    source: dict[str, object] = {"kind": "bag", **source_file(path), "topics": roles, "clock": first}
    if datum is not None:
        source["datum"] = datum.tolist()
    return Log(
        name, recorded, Truth(true), label=label, labels_are_sensed=label is not None, source=source,
        notes=(*notes, note), origins=origins,
    )  # fmt: skip


def _at(stamp: Array, time: Array) -> IntArray:
    return np.searchsorted(time, stamp).astype(np.int64)


def _named(topic: str) -> str:
    """A topic as the name of a source."""
    return "".join("_" if c in ',"' or not c.isprintable() else c for c in topic.strip("/ ")) or "topic"


def _odometry(path: Path, topics: Sequence[Topic], found: Collected) -> tuple[str, str, Array, Array]:
    """Topic (or tf), the robot's frame, stamps (K,), and poses (K, 3)."""
    topic = next((t.name for t in topics if t.role is Role.ODOMETRY), None)
    if topic is not None:
        rows = found.poses.get(topic, [])
        if not rows:
            raise DataError.at(path, f"no message of {topic}; at least one is needed")
        stamp, pose = np.array([r.stamp for r in rows]), np.array([r.pose for r in rows])
        robot = found.frames[topic][1]
    else:
        moving = {c: m for c, m in found.tree.moving.items() if not m.static and m.parent.endswith(ODOM_FRAME)}
        if not moving:
            what = f"neither a topic of odometry nor a transform from {ODOM_FRAME!r}; one is needed: --odom TOPIC"
            raise DataError.at(path, what)
        topic, robot = TF, max(moving, key=lambda child: len(moving[child].stamp))
        stamp = np.array(moving[robot].stamp)
        R, t = moving[robot].at(stamp)
        pose = np.column_stack([t[:, :2], np.arctan2(R[:, 1, 0], R[:, 0, 0])])
    time, first = np.unique(stamp, return_index=True)
    return topic, robot, time, pose[first]


def _observed(
    topics: Sequence[Topic], found: Collected, wanted: Wanted, robot: str, stamp: Array
) -> tuple[list[_Seen], list[str]]:
    """Observations by topic, and a sentence for each that is left out."""
    seen, left = [], []
    for t in topics:
        every = found.detections.get(t.name, [])
        rows = [d for d in every if stamp[0] <= d.stamp <= stamp[-1]]
        if t.role not in (Role.POINTS, Role.BEARINGS) or not every:
            continue
        if len(rows) < len(every):
            lost = f"{len(every) - len(rows)} of {counted(len(every), 'detection')}"
            left.append(f"{t.name}: {lost} before or after all odometry: left out.")
        made = []
        for frame in dict.fromkeys(d.frame for d in rows):
            some = [d for d in rows if d.frame == frame]
            at = np.array([d.stamp for d in some])
            placed = found.tree.between(robot, frame, at) if found.tree.carries(robot, frame) else None
            if placed is None:
                left.append(f"{t.name}: {counted(len(some), 'detection')} in {frame!r}, which tf does not mount on "
                            f"{robot!r}: left out.")  # fmt: skip
                continue
            where = np.array([d.at for d in some])
            if t.role is Role.BEARINGS:
                if frame not in found.cameras:
                    left.append(f"{t.name}: no CameraInfo of {frame!r}, so pixels tell no direction: left out.")
                    continue
                where = _rays(where, found.cameras[frame])
            made.append((at, *placed, where, np.array([d.id for d in some], np.int64)))
        if made:
            seen.append(_by_sensor(t, [np.concatenate(part) for part in zip(*made, strict=True)], wanted))
    return seen, left


def _rays(pixels: Array, camera: tuple[float, float, float, float]) -> Array:
    """Directions (n, 3) of pixels in an optical frame: x to the right, y down, z ahead."""
    fx, fy, cx, cy = camera
    return np.column_stack([(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, np.ones(len(pixels))])


def _by_sensor(topic: Topic, parts: Sequence[Array], wanted: Wanted) -> _Seen:
    """Points in the body frame, or directions from the camera's mean place, turned as the body is."""
    at, R, t, where, ids = parts
    order = np.argsort(at, kind="stable")
    turned = np.einsum("nij,nj->ni", R, where)
    if topic.role is Role.POINTS:
        z = (turned + t)[:, :2]
        sigma = _stated(wanted.points, topic, "--point-sigma M")
        reach = 1.001 * float(np.hypot(*z.T).max())
        sensor: Sensor = RelativePoint(max_range=reach if reach > 0.0 else np.inf, label=_named(topic.name))
        covariance = np.tile(sigma**2 * np.eye(2), (len(z), 1, 1))
    else:
        z = np.column_stack([np.zeros(len(at)), np.arctan2(turned[:, 1], turned[:, 0])])
        sigma = _stated(wanted.bearings, topic, "--bearing-sigma ANGLE")
        x, y = (-t[:, :2].mean(axis=0)).tolist()
        sensor = Bearing(translation=(x + 0.0, y + 0.0), label=_named(topic.name))
        covariance = np.tile(np.diag([1.0, sigma**2]), (len(z), 1, 1))
    return _Seen(sensor, at[order], z[order], covariance[order], ids[order].astype(np.int64))


def _stated(sigma: float | None, topic: Topic, flag: str) -> float:
    if sigma is None:
        raise UsageError(f"{topic.name}: unknown noise of its {topic.role}; {flag}, or --skip {topic.name}, is needed")
    return sigma


def _joined(seen: Sequence[_Seen], time: Array) -> tuple[Observations, tuple[Sensor, ...], IntArray | None]:
    """The observations by frame and sensor, the sensors, and labels; None: nothing has an id."""
    which = np.repeat(np.arange(len(seen)), [len(s.at) for s in seen])
    frame = _at(np.concatenate([np.empty(0), *(s.at for s in seen)]), time)
    z = np.concatenate([np.empty((0, 2)), *(s.z for s in seen)])
    R = np.concatenate([np.empty((0, 2, 2)), *(s.R for s in seen)])
    ids = np.concatenate([np.empty(0, np.int64), *(s.id for s in seen)])
    by = np.lexsort((which, frame))
    several = which[by] if len(seen) > 1 else None
    label = np.where(ids[by] >= 0, ids[by], UNLABELLED) if (ids >= 0).any() else None
    return Observations(frame[by], z[by], R[by], sensor=several), tuple(s.sensor for s in seen), label


def _fixed(topics: Sequence[Topic], found: Collected, wanted: Wanted, robot: str) -> tuple[list[_Fixed], Array | None]:
    """Fixes by topic, and the place (latitude, longitude [deg], height [m]) of the origin of positions."""
    made: list[_Fixed] = []
    origin: Array | None = None
    for t in topics:
        rows = sorted(found.poses.get(t.name, []), key=lambda r: r.stamp)
        if t.role not in FIXES or not rows:
            continue
        mounted = found.tree.between(robot, found.frames[t.name][1], np.zeros(1))
        if t.role is Role.POSITIONS:
            at, place, C = (np.array([r[k] for r in rows]) for k in range(3))
            origin = place[0] if origin is None else origin
            P = np.zeros((len(rows), 3, 3))
            P[:, :2, :2] = _filled(C, wanted.positions, t, "--position-sigma M")
            z = np.column_stack([east_north(place, origin), np.zeros(len(rows))])
            x, y = (0.0, 0.0) if mounted is None else mounted[1][0, :2].tolist()
            made.append(_Fixed(FixSource(_named(t.name), (x, y)), FixKind.POSITION, at, z, P))
        else:
            made.append(_of_poses(t, rows, mounted, wanted))
    return made, origin


def _of_poses(topic: Topic, rows: Sequence[Pose], mounted: tuple[Array, Array] | None, wanted: Wanted) -> _Fixed:
    """Headings, one in `EVERY` s, or poses of the robot."""
    at, z, P = (np.array([r[k] for r in rows]) for k in range(3))
    if topic.role is Role.POSES:
        if np.isnan(P).any():
            what = "messages without a covariance"
            raise UsageError(f"{topic.name}: {what}; --truth {topic.name} or --skip {topic.name} is needed")
        return _Fixed(FixSource(_named(topic.name)), FixKind.POSE, at, z, P)
    kept = np.unique(np.floor((at - at.min()) / EVERY), return_index=True)[1]
    at, z = at[kept], z[kept]
    C = np.zeros((len(kept), 3, 3))
    C[:, 2, 2] = _filled(P[kept][:, 2:, 2:], wanted.headings, topic, "--heading-sigma ANGLE")[:, 0, 0]
    R = np.eye(3) if mounted is None else mounted[0][0]
    turned = float(np.arctan2(R[1, 0], R[0, 0]))
    return _Fixed(FixSource(_named(topic.name), rotation=turned), FixKind.HEADING, at, z, C)


def _filled(covariance: Array, sigma: float | None, topic: Topic, flag: str) -> Array:
    """Covariances (n, d, d), those that are not stated from a sigma."""
    low = np.linalg.eigvalsh(np.where(np.isfinite(covariance), covariance, 0.0))[:, 0]
    lacking = ~(low > 0.0)
    if lacking.any():
        covariance = covariance.copy()
        covariance[lacking] = _stated(sigma, topic, flag) ** 2 * np.eye(covariance.shape[-1])
    return np.asarray(0.5 * (covariance + covariance.transpose(0, 2, 1)))


def _all_fixes(fixed: Sequence[_Fixed], time: Array) -> Fixes:
    inside = [(f.at >= time[0]) & (f.at <= time[-1]) for f in fixed]
    frame = np.concatenate([_at(f.at[k], time) for f, k in zip(fixed, inside, strict=True)])
    source = np.concatenate([np.full(int(k.sum()), i) for i, k in enumerate(inside)]).astype(np.int64)
    kind = np.array([f.kind for f in fixed], np.int64)[source]
    z = np.concatenate([f.z[k] for f, k in zip(fixed, inside, strict=True)])
    P = np.concatenate([f.covariance[k] for f, k in zip(fixed, inside, strict=True)])
    by = np.lexsort((source, frame))
    return Fixes(frame[by], kind[by], source[by], z[by], P[by], tuple(f.source for f in fixed))


def _truth(topics: Sequence[Topic], found: Collected, robot: str, time: Array) -> Array | None:
    """True poses (N, 3) of the robot at the frames, NaN where unknown."""
    topic = next((t for t in topics if t.role is Role.TRUTH), None)
    if topic is None or not found.poses.get(topic.name):
        return None
    stamp, pose, _, mounted = _poses(topic, found, robot)
    q = np.where(pose[:, 2:] == 0.0, [0.0, 0.0, 0.0, 1.0], np.nan)  # of a turn there is no need to know it
    if not np.isnan(q).any() and unturned(q, pose[:, :2]):
        pose[:, 2] = np.nan
    return truth_at(stamp, pose if mounted is None or not mounted.any() else se2.compose(pose, mounted), time)


def _prior(
    wanted: Wanted, first: Array, true: Array | None, fixed: Sequence[_Fixed], begin: float
) -> tuple[Prior, str]:
    """Belief about the first pose, and a sentence about it."""
    if wanted.prior is not None:
        if wanted.prior_sigma is None:
            raise UsageError("--prior: --prior-sigma SX,SY,STHETA (m, m, rad; 0,0,0: exact) is needed")
        return Prior(wanted.prior, np.diag(wanted.prior_sigma**2)), "The prior is as --prior states."
    if true is not None:
        if not np.isfinite(true[0]).all():
            what = "heading" if np.isfinite(true[0, :2]).all() else "pose"
            raise UsageError(f"the first frame has no true {what}; --prior X,Y,THETA and --prior-sigma are needed")
        sigma = np.array(FIRST) if wanted.prior_sigma is None else wanted.prior_sigma
        text = ", ".join(f"{s:g}" for s in sigma)
        return Prior(true[0], np.diag(sigma**2)), f"The prior is the first true pose, with standard deviations {text}."
    whole = next((f for f in fixed if f.kind is FixKind.POSE), None)
    if whole is not None:
        return Prior(whole.z[0], whole.covariance[0]), f"The prior is the first pose of {whole.source.name}."
    place = next((f for f in fixed if f.kind is FixKind.POSITION), None)
    turn = next((f for f in fixed if f.kind is FixKind.HEADING), None)
    if place is None and turn is None:
        return Prior(first, np.zeros((3, 3))), "The prior is the first pose of the odometry, exactly."
    if place is None or turn is None:
        what = "heading" if turn is None else "position"
        raise UsageError(f"the first {what} in the frame of the fixes is unknown; --prior X,Y,THETA and --prior-sigma "
                         "SX,SY,STHETA are needed")  # fmt: skip
    theta = float(turn.z[0, 2]) - turn.source.rotation
    arm = se2.rotation(theta) @ np.array(place.source.lever)
    mean = np.array([*(place.z[0, :2] - arm), theta])
    P = np.zeros((3, 3))
    P[:2, :2], P[2, 2] = place.covariance[0, :2, :2], turn.covariance[0, 2, 2]
    late = max(place.at[0], turn.at[0]) - begin
    text = f"The prior is the first fix of {place.source.name} with the first heading of {turn.source.name}"
    return Prior(mean, P), f"{text}, {late:.3g} s after the first frame."
