"""A log from the tables of another program: frames, increments, observations, map, truth and prior in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data import se2
from data.columns.appearance import of_landmarks, together
from data.csv_table import Table, is_name
from data.digest import file_sha256
from data.errors import DataError, UsageError, unknown
from data.formats.open_log.writer import Recording, Samples
from data.formats.recordings.laser import FLOOR
from data.formats.second_odometry import together as together_closures
from data.formats.tables.files import SECOND, TextTable, headings, read_text
from data.formats.tables.flags import Wanted
from data.formats.tables.motion import Odometry, kind_of, pose_columns, read_odometry, suspicious
from data.formats.tables.observations import (
    FrameObservations,
    joined,
    read_observations,
    sensor_of,
    whole,
    with_looks,
)
from data.formats.tables.second import read_second, second_closures
from data.formats.tables.sensors import SENSOR, TableSensor
from data.inputs import Inputs, IntArray, LandmarkMap, Prior
from data.log import INTEGRATION, ODOMETRY_KIND, ODOMETRY_PERIOD, TRUTH_POSE, Log
from data.motion.velocity import VelocityModel, VelocityNoise, floor_covariances
from data.pose_measurements import Closures, Fixes, FixKind, FixSource
from data.se2 import Array, BoolArray
from data.sensors import RangeBearing
from data.terminal import counted
from data.timeline import MAX_GAP, frame_times, truth_at
from data.truth import Truth

# Fixes and closures in tables of another program, in SI units: what they measure is in the fields that are filled.

SIGMAS = ("sx", "sy", "stheta")
RELATIVE = ("dx", "dy", "dtheta")
FORBIDDEN = set(',"')
"""Characters that a field of fixes.csv cannot hold."""


@dataclass(frozen=True, eq=False)
class PoseRows:
    """Fixes or closures in the order of their (later) stamps.

    Attributes:
        what: "fixes" or "closures".
        table: their rows, for messages.
        at: (F,) s, as the odometry's; of closures (F, 2).
        stamped: at their own stamps, not at rows of the odometry.
        z, sigma: (F, 3), NaN where not measured.
        source: (F,) row in `names`.
    """

    what: str
    table: Table
    at: Array
    stamped: bool
    z: Array
    sigma: Array
    source: IntArray
    names: tuple[str, ...]

    @property
    def one(self) -> str:
        """One of them, in a message."""
        return "fix" if self.what == "fixes" else "closure"

    def part(self, rows: IntArray) -> PoseRows:
        """Some of them, in this order."""
        return replace(
            self, table=self.table.part(rows), at=self.at[rows], z=self.z[rows], sigma=self.sigma[rows],
            source=self.source[rows],
        )  # fmt: skip

    @property
    def covariance(self) -> Array:
        """Of z (F, 3, 3), zero where not measured."""
        variance = np.where(np.isnan(self.z), 0.0, self.sigma**2)
        return np.asarray(variance[:, :, None] * np.eye(3))

    def fixes(self, time: Array, lever: tuple[float, float], rotation: float) -> Fixes:
        """As fixes of a log with frames at `time` (N,)."""
        there = ~np.isnan(self.z)
        kind = np.where(there[:, 2], np.where(there[:, 0], FixKind.POSE, FixKind.HEADING), FixKind.POSITION)
        sources = tuple(FixSource(name, lever, rotation) for name in self.names)
        frame = np.searchsorted(time, self.at).astype(np.int64)
        return Fixes(frame, kind, self.source, np.where(there, self.z, 0.0), self.covariance, sources)

    def closures(self, time: Array) -> Closures:
        """As closures of a log with frames at `time` (N,)."""
        frame = np.searchsorted(time, self.at).astype(np.int64)
        return Closures(frame[:, 0], frame[:, 1], self.z, self.covariance, self.source, self.names)


def read_fixes(file: TextTable, wanted: Wanted, odometry: Odometry, notes: list[str]) -> PoseRows:
    """The fixes of a file: of each row the position (x, y), the heading, or both."""
    columns, role = wanted.columns, "fixes"
    key = "t" if odometry.stamped and columns.find(file, role, "t") is not None else "frame"
    if key == "frame" and columns.find(file, role, "frame") is None:
        columns.require(file, role, ("t" if odometry.stamped else "frame",))
    pose = pose_columns(file, columns, role)
    position = [q for q in ("x", "y") if columns.find(file, role, q) is not None]
    heading = [q for q in pose[2:] if columns.find(file, role, q) is not None]
    if len(position) == 1 or not (position or heading):
        what = f"no fixes: {file.described()}; x and y, or a heading theta, or both are needed"
        raise DataError.at(file.path, f"{what}; name them as in --columns fixes.x=EAST,fixes.y=NORTH")
    sigmas = [q for q in SIGMAS if columns.find(file, role, q) is not None]
    values = (*position, *heading)
    table, texts, _ = columns.table(
        file, role, (key, *values), optional=sigmas, texts=("source",), may_be_blank=(*values, *sigmas)
    )
    z = np.full((len(table), 3), np.nan)
    z[:, :2] = table.stack(position) if position else np.nan
    if heading:
        z[:, 2] = headings(table.columns)
    half = np.isnan(z[:, 0]) != np.isnan(z[:, 1])
    if half.any():
        row = int(np.argmax(half))
        raise table.error(row, "y" if np.isnan(z[row, 1]) else "x", "blank; both x and y, or neither, are needed")
    at = table.columns["t"] if key == "t" else odometry.time[_rows(table, key, odometry)]
    found = _measured(role, table, texts.get("source"), file.path, at, key == "t", z, wanted.fix_sigma)
    filled = ~np.isnan(z).all(axis=1)
    if not filled.all():
        notes.append(f"{file.path.name}: {counted(int((~filled).sum()), 'row')} without a fix")
    order = np.argsort(at, kind="stable")
    return found.part(order[filled[order]].astype(np.int64))


def read_closures(file: TextTable, wanted: Wanted, odometry: Odometry) -> PoseRows:
    """The closures of a file, by their later end."""
    columns, role = wanted.columns, "closures"
    stamped = odometry.stamped and columns.find(file, role, "t1") is not None
    ends = ("t1", "t2") if stamped else ("frame1", "frame2")
    if odometry.stamped and not stamped and columns.find(file, role, "frame1") is None:
        columns.require(file, role, ("t1",))
    sigmas = [q for q in SIGMAS if columns.find(file, role, q) is not None]
    table, texts, _ = columns.table(
        file, role, (*ends, *RELATIVE), optional=sigmas, texts=("source",), may_be_blank=sigmas
    )
    at = np.stack([table.columns[e] if stamped else odometry.time[_rows(table, e, odometry)] for e in ends], axis=-1)
    table.require(at[:, 0] != at[:, 1], ends[1], f"{{}} is {ends[0]}, too; two frames are needed")
    z = table.stack(RELATIVE)
    found = _measured(role, table, texts.get("source"), file.path, at, stamped, z, wanted.closure_sigma)
    return found.part(np.argsort(at.max(axis=1), kind="stable").astype(np.int64))


def _rows(table: Table, key: str, odometry: Odometry) -> IntArray:
    """Rows of the odometry."""
    rows, last = table.integers(key, 0), len(odometry.time) - 1
    table.require(rows <= last, key, f"{{}} is out of range; the odometry has rows 0 to {last}")
    return rows


def _measured(
    role: str, table: Table, source: Sequence[str] | None, path: Path, at: Array, stamped: bool, z: Array,
    default: Array | None,
) -> PoseRows:  # fmt: skip
    """With the sigma of each row, else the stated one, and the sources by name: that of the column, else the file."""
    sigma = np.tile(np.full(3, np.nan) if default is None else default, (len(z), 1))
    for k, name in enumerate(SIGMAS):
        if name in table:
            own = table.columns[name]
            table.require(np.isnan(own) | (own > 0.0), name, "{} is no standard deviation > 0")
            sigma[:, k] = np.where(np.isnan(own), sigma[:, k], own)
    lacking: BoolArray = np.asarray((np.isnan(sigma) & ~np.isnan(z)).any(axis=1))
    if lacking.any():
        flag, what = (
            ("fix", "SX,SY (m), STHETA (rad), or all three") if role == "fixes" else ("closure", "SX,SY,STHETA")
        )
        first = table.error(int(np.argmax(lacking)), None, f"unknown noise of this {flag}")
        raise UsageError(f"{first}; --{flag}-sigma {what}, or columns {', '.join(SIGMAS)} are needed")
    stem = path.stem if path.stem and path.stem.isprintable() and not FORBIDDEN & set(path.stem) else role
    given = [name or stem for name in source] if source is not None else [stem] * len(z)
    names = tuple(dict.fromkeys(given)) or (stem,)
    for row, name in enumerate(given):
        if FORBIDDEN & set(name) or not name.isprintable():
            raise table.error(row, "source", f"{name!r} holds a comma or a quote; a plain name is needed")
    number = {name: k for k, name in enumerate(names)}
    return PoseRows(role, table, at, stamped, z, sigma, np.array([number[n] for n in given], np.int64), names)


Part = FrameObservations | PoseRows
KIND = "kind"
"""Column of the map."""

LONGEST = 1e6
"""s, longest log; stamps in another unit would fill the memory with keyframes."""


def open_files(files: Mapping[str, Path]) -> dict[str, TextTable]:
    """The text of each file, by role; a file with several roles is read once."""
    read = {path: read_text(path) for path in dict.fromkeys(files.values())}
    return {role: read[path] for role, path in files.items()}


@dataclass(frozen=True, eq=False)
class TruePoses:
    """True poses (K, 3) in the world frame, NaN where unknown, at stamps (K,) [s]; None: one for each frame."""

    path: Path
    time: Array | None
    pose: Array

    @property
    def begin(self) -> float | None:
        """Stamp of the first known pose; None without one."""
        known = np.isfinite(self.pose).all(axis=1)
        return None if self.time is None or not known.any() else float(self.time[np.argmax(known)])


def read_log(name: str, wanted: Wanted, texts: Mapping[str, TextTable]) -> Recording:
    """The log of the tables, with velocities as recorded; DataError or UsageError for invalid parts, stamps without
    overlap, or a missing prior.
    """
    columns = wanted.columns
    kind = kind_of(texts["odometry"], columns, wanted.kind)
    odometry = read_odometry(texts["odometry"], columns, kind, wanted.wheels)
    if wanted.backward:
        odometry = odometry.held_backward()
    seen = [read_observations(texts[sensor.role], sensor, wanted, odometry) for sensor in wanted.sensors]
    notes = [*odometry.notes, *(note for part in seen for note in part.notes)]
    if odometry.velocity is not None:
        way = "since the row before" if wanted.backward else "until the next row"
        other = "forward: until the next row" if wanted.backward else "backward: since the row before"
        notes.append(f"v and omega are taken to hold {way} (--hold {other})")
    parts: list[Part] = [*seen]
    if "fixes" in texts:
        parts.append(read_fixes(texts["fixes"], wanted, odometry, notes))
    if "closures" in texts:
        parts.append(read_closures(texts["closures"], wanted, odometry))
    second = None
    if wanted.second is not None:
        second = read_second(texts[SECOND], wanted.second, columns, odometry)
    true = _true_poses(texts["truth"], wanted, notes, stamped=odometry.stamped) if "truth" in texts else None
    if isinstance(wanted.prior, str) and true is not None:
        odometry, parts = _from_truth_on(odometry, parts, true, notes)
    time, parts = _frames(odometry, parts, wanted, notes)
    seen = [part for part in parts if isinstance(part, FrameObservations)]
    found = {part.what: part for part in parts if isinstance(part, PoseRows)}
    measured = [found["closures"].closures(time)] if "closures" in found else []
    if second is not None and wanted.second is not None:
        taken = [name for closures in measured for name in closures.sources]
        measured.append(second_closures(texts[SECOND], second, wanted.second, time, taken, notes))
    increments, gaps = odometry.increments(time, wanted.noise, wanted.model)
    covariance, floored = floor_covariances(increments.covariance, FLOOR)
    if odometry.velocity is None:
        floored += gaps  # of poses it counts floored covariances
    as_recorded = odometry.velocity is not None and all(p.stamped for p in parts) and not wanted.every_row
    if odometry.velocity is not None and gaps and not as_recorded:  # of odometry.csv loading says it
        many = counted(gaps, "gap")
        notes.append(f"odometry: {many} longer than {MAX_GAP:g} s, where the robot may have moved unseen")
    known = _map(texts["map"], wanted) if "map" in texts else None
    pose = None if true is None else _at_frames(true, texts["truth"], wanted, time)
    columns.check_used(list(dict.fromkeys(texts.values())))
    observed, labels = joined(seen, time)
    looks, known_looks = together([observed.appearance, None if known is None else known.appearance])
    observed = replace(observed, appearance=looks)
    known = None if known is None else replace(known, appearance=known_looks)
    sensors = tuple(sensor_of(part, notes) for part in seen) or (RangeBearing(),)
    _check_kinds(wanted.sensors, known)
    inputs = Inputs(
        prior=_prior(wanted, pose, known, absolute="fixes" in found),
        time=time,
        increments=replace(increments, covariance=covariance),
        observations=observed,
        sensor=sensors[0],
        sensors=sensors if len(sensors) > 1 else (),
        map=known,
        time_is_index=not odometry.stamped,
        covariance_floor=FLOOR,
        floored=floored,
        fixes=found["fixes"].fixes(time, wanted.fix_lever, wanted.fix_rotation) if "fixes" in found else None,
        closures=together_closures(measured),
    )
    several = [sensor.name for sensor in wanted.sensors if sensor.name]
    files = {role: path.name for role, path in wanted.files.items() if role not in several}
    files |= {f"{role}_sha256": file_sha256(path) for role, path in wanted.files.items() if role not in several}
    more: dict[str, object] = {ODOMETRY_KIND: kind}
    if several:
        of = {name: wanted.files[name] for name in several}
        more[SENSOR] = {name: {"file": path.name, "sha256": file_sha256(path)} for name, path in of.items()}
    if kind == "velocities" and len(odometry.time) > 1:
        more |= {ODOMETRY_PERIOD: float(np.median(np.diff(odometry.time))), INTEGRATION: wanted.model}
    more |= {"hold": "backward"} if wanted.backward else {}
    more |= {TRUTH_POSE: wanted.truth_pose.tolist()} if wanted.truth_pose.any() else {}
    more |= {"time_offset": dict(columns.offsets)} if columns.offsets else {}
    log = Log(
        name,
        inputs,
        Truth(pose, known, labels.get("true_id")),
        label=labels.get("label"),
        labels_are_sensed=wanted.sensed,
        source={"kind": "table", **files, **more, "columns": dict(columns.given), "unit": dict(columns.units.given)},
        notes=tuple(notes),
    )
    if not as_recorded or odometry.velocity is None or not isinstance(wanted.noise, VelocityNoise):
        return Recording(log)
    stamped = None
    if true is not None:
        stamped = (time if true.time is None else true.time, true.pose)
    return Recording(log, Samples(odometry.time, odometry.velocity, VelocityModel(wanted.noise, wanted.model), stamped))


def _from_truth_on(
    odometry: Odometry, parts: list[Part], true: TruePoses, notes: list[str]
) -> tuple[Odometry, list[Part]]:
    """Odometry and the rest since the first true pose, where a log with that prior begins."""
    begin = true.begin
    if begin is None or not odometry.time[0] < begin < odometry.time[-1]:
        return odometry, parts
    if not all(part.stamped for part in parts):
        begin = float(odometry.time[np.searchsorted(odometry.time, begin)])
    later: list[BoolArray] = [np.asarray((_ends(part) >= begin).all(axis=1)) for part in parts]
    left = [counted(int((~kept).sum()), part.one, part.what) for kept, part in zip(later, parts, strict=True)]
    late = f"{begin - odometry.time[0]:.6g} s after the odometry"
    notes.append(f"the truth begins {late}; so does the log, without {' and '.join(left)} before")
    kept = [part.part(np.flatnonzero(fine)) for fine, part in zip(later, parts, strict=True)]
    return odometry.since(begin), kept


def _ends(part: Part) -> Array:
    """Stamps (M, 1), or of both ends (M, 2)."""
    return part.at if part.at.ndim == 2 else part.at[:, None]


def _frames(odometry: Odometry, parts: Sequence[Part], wanted: Wanted, notes: list[str]) -> tuple[Array, list[Part]]:
    """Time (N,) of the frames, and the parts that have odometry."""
    if not any(part.stamped for part in parts):
        return odometry.time, list(parts)
    first, last = float(odometry.time[0]), float(odometry.time[-1])
    kept: list[Part] = []
    for part in parts:
        inside: BoolArray = np.asarray(((_ends(part) >= first) & (_ends(part) <= last)).all(axis=1))
        if len(inside) and not inside.any():
            apart = f"{part.what} from {_span(np.sort(part.at.ravel()))} s, odometry from {_span(odometry.time)} s"
            raise DataError.at(part.table.path, f"{apart} do not overlap; state the units as in --unit odometry.t=ms")
        if odometry.velocity is None and not inside.all():
            some = f"{(~inside).sum()} of {len(inside)} {part.what}"
            notes.append(f"{some} before or after all odometry, {_span(odometry.time)} s, dropped")
        kept.append(part if odometry.velocity is not None else part.part(np.flatnonzero(inside)))
    at = np.concatenate([part.at.ravel() for part in kept])
    if odometry.velocity is not None:  # without samples the covariance grows, as on loading
        first, last = min(first, at.min(initial=first)), max(last, at.max(initial=last))
    if last - first > LONGEST:
        span = f"the stamps span {last - first:.6g} s, {(last - first) / 86400.0:.3g} days"
        raise DataError.at(odometry.table.path, f"{span}; state the unit as in --unit time=ns")
    if wanted.every_row or not all(part.stamped for part in kept):
        at = np.concatenate([at, odometry.time])
    return frame_times(at, first, last), kept


def _span(time: Array) -> str:
    return f"{time[0]:.15g} to {time[-1]:.15g}"


def _map(file: TextTable, wanted: Wanted) -> LandmarkMap:
    """Landmarks in the world frame; without ids they are numbered from 0 in the order of the file. Blank sigmas are 0.

    DataError for sigmas that the map's rotation would correlate.
    """
    columns = wanted.columns
    # a column of that name is something else where no sensor sees a kind
    kind = (KIND,) * (any(sensor.sees for sensor in wanted.sensors) or columns.stated("map", (KIND,)))
    looked = dict.fromkeys(q for sensor in wanted.sensors for q in sensor.looked)
    stated = [q for q in ("sx", "sy") if columns.find(file, "map", q) is not None]
    words = ("id", *kind, *looked)
    table, texts, _ = columns.table(file, "map", ("x", "y"), optional=stated, texts=words, may_be_blank=stated)
    table = with_looks(file, table, texts)
    for row, word in enumerate(texts.get(KIND, ())):
        if word and not is_name(word):
            raise table.error(row, KIND, f"{word!r} holds a comma or a quote; a plain name is needed")
    ids = whole(table, texts["id"], "id") if "id" in texts else np.arange(len(table), dtype=np.int64)
    order = np.argsort(ids, kind="stable")
    twice = np.flatnonzero(ids[order][1:] == ids[order][:-1])
    if len(twice):
        row = int(order[twice[0] + 1])
        raise table.error(row, "id", f"{ids[row]} is repeated; each landmark needs an id of its own")
    if len(ids) and ids.min() < 0:
        raise table.error(int(np.argmin(ids)), "id", f"{ids.min()} is negative; ids are whole numbers from 0 up")
    kinds = None if KIND not in texts else tuple(texts[KIND][row] for row in order.tolist())
    sigma = _map_sigmas(table, stated, float(wanted.map_pose[2]))
    xy, looks = se2.transform_points(wanted.map_pose, table.stack(("x", "y"))), of_landmarks(table)
    return LandmarkMap(
        ids[order], xy[order], kinds, appearance=None if looks is None else looks.only(order),
        sigma=None if sigma is None else sigma[order],
    )  # fmt: skip


def _map_sigmas(table: Table, stated: Sequence[str], turn: float) -> Array | None:
    """Standard deviations (L, 2) of the turned map, or None where there are none."""
    if not stated:
        return None
    if len(stated) == 1:
        raise table.error(-1, stated[0], "sx and sy come together")
    sigma = np.nan_to_num(table.stack(stated))
    for k, q in enumerate(stated):
        table.require(sigma[:, k] >= 0.0, q, "{} is a negative standard deviation; 0 or blank is an exact landmark")
    quarters = turn / (0.5 * np.pi)
    if abs(quarters - round(quarters)) > 1e-9:
        different = "{} differs from sy; a map turned by --map-transform needs both equal"
        table.require(sigma[:, 0] == sigma[:, 1], stated[0], different)
    return (sigma[:, ::-1] if round(quarters) % 2 else sigma) if sigma.any() else None


def _check_kinds(sensors: Sequence[TableSensor], known: LandmarkMap | None) -> None:
    """UsageError for a sensor of landmarks that the map has none of."""
    for sensor in sensors if known is not None else ():
        kinds = set(known.kind or ()) if known is not None else set()
        if sensor.sees and sensor.sees not in kinds:
            have = unknown(sensor.sees, sorted(kinds - {""})) if kinds - {""} else "not in the map, which has no kinds"
            text = f"{sensor.name}={sensor.sees}" if sensor.name else sensor.sees
            raise UsageError(f"--sees {text}: {have}; column {KIND} of the map names them (--columns map.{KIND}=NAME)")


def _true_poses(file: TextTable, wanted: Wanted, notes: list[str], *, stamped: bool) -> TruePoses:
    """The poses of a truth file."""
    columns = wanted.columns
    pose = pose_columns(file, columns, "truth")
    by_stamp = stamped and columns.find(file, "truth", "t") is not None
    wants = (*(("t",) if by_stamp else ()), *pose)
    table, _, _ = columns.table(file, "truth", wants, may_be_blank=pose)
    values = table.columns
    read = np.stack([values["x"], values["y"], headings(values)], axis=-1)
    notes += suspicious(file, columns, read[:, 2], values["t"] if by_stamp else None, "truth")
    read[~np.isfinite(read).all(axis=1)] = np.nan
    world = se2.compose(wanted.truth_pose, read) if wanted.truth_pose.any() else read
    if by_stamp:
        table.require_ascending("t", strictly=True)
    return TruePoses(file.path, values["t"] if by_stamp else None, world)


def _at_frames(true: TruePoses, file: TextTable, wanted: Wanted, time: Array) -> Array:
    """True poses (N, 3) at the frames, NaN where unknown."""
    if true.time is None:
        if len(true.pose) != len(time):
            wanted.columns.require(file, "truth", ("t",))
        return true.pose
    result = truth_at(true.time, true.pose, time)
    if true.begin is not None and not np.isfinite(result).any():
        apart = f"truth from {_span(true.time)} s, frames from {_span(time)} s: no frame has one within {MAX_GAP:g} s"
        raise DataError.at(true.path, f"{apart}; state the unit as in --unit truth.t=ms")
    return result


def _prior(wanted: Wanted, pose: Array | None, known: LandmarkMap | None, *, absolute: bool) -> Prior:
    """Belief about the first pose; `absolute`: there are fixes."""
    if wanted.prior is None:
        if pose is not None or known is not None or absolute:
            frame = "truth" if pose is not None else "fixes" if known is None else "map"
            what = f"unknown start in the frame of the {frame}"
            right = "--prior X,Y,THETA (m, rad; or as in 90deg), or --prior truth for the first true pose, is needed"
            raise UsageError(f"{what}; {right}")
        return Prior(np.zeros(3), np.zeros((3, 3)))
    if wanted.prior_sigma is None:
        raise UsageError("--prior: --prior-sigma SX,SY,STHETA (m, m, rad; 0,0,0: exact) is needed")
    mean = wanted.prior
    if isinstance(mean, str):
        if pose is None:
            raise UsageError("--prior truth: --truth FILE is needed")
        if not np.isfinite(pose[0]).all():
            raise UsageError("--prior truth: the first frame has no true pose; state it with --prior X,Y,THETA")
        mean = pose[0]
    return Prior(mean, np.diag(wanted.prior_sigma**2))
