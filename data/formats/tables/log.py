"""A log from the tables of another program: frames, increments, observations, fixes, closures, map, truth and prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from data import se2
from data.columns import appearance
from data.columns.appearance import of_observations
from data.columns.parts import IDS, KIND, landmarks_of
from data.columns.poses import RELATIVE
from data.csv_table import Table, is_name, is_number
from data.digest import file_sha256
from data.errors import DataError, UsageError, unknown
from data.formats.messages import parts_of
from data.formats.open_log import Recording, Samples
from data.formats.recordings.laser import FLOOR, unknown_motion
from data.formats.recordings.ros import file_and_topic
from data.formats.results.path import ABSENT, COARSE, in_order, unturned
from data.formats.second_odometry import together
from data.formats.tables.files import QUATERNION, SCANS, SECOND, STARRED, described, headings, nothing_there
from data.formats.tables.motion import Odometry, other_rate, pose_columns, read_odometry, read_second, second_closures
from data.formats.tables.request import LOOKS, OBSERVATIONS, SENSOR, TableSensor, Wanted
from data.formats.tables.scans import read_scans
from data.formats.text import TextTable
from data.formats.wrapped import file_and_word
from data.inputs import CLUTTER, Increments, Inputs, IntArray, LandmarkMap, Observations, Prior, Scans
from data.log import INTEGRATION, ODOMETRY_KIND, ODOMETRY_PERIOD, TRUTH_POSE, Log
from data.motion.velocity import VelocityModel, VelocityNoise, floor_covariances, gaps_said
from data.origin import Origin, Origins
from data.pose_measurements import FAR, LOOSE, Closures, Fixes, FixKind, FixSource, Start, onto_fixes
from data.questions.witnesses import way_share
from data.se2 import Array, BoolArray
from data.sensors import RangeBearing, Sensor
from data.terminal import counted
from data.timeline import frame_times, truth_at, usual_gap
from data.truth import Truth

SIGMAS = ("sx", "sy", "stheta")
FIX_SIGMA = (1.0, 1.0, math.radians(5.0))  # m and rad, of fixes whose noise nobody states
MANY = 50  # Most observations that may have the stamp of another one
LONGEST = 1e6  # s, longest log; stamps in another unit would fill the memory with keyframes


@dataclass(frozen=True, eq=False)
class Rows:
    """Observations of a sensor, fixes or closures in the order of their (later) instants."""

    what: str  # what, one: all, and one of them, in a message
    one: str
    table: Table  # what they measure
    at: Array  # (K, 1) s, as the odometry's; of closures (K, 2)
    stamped: bool  # at their own stamps, not at rows of the odometry
    z: Array  # z, sigma: (K, 3) of fixes and closures, NaN where not measured; (K, 2) of observations
    sigma: Array
    source: IntArray  # (K,) row in `names` of fixes and closures
    names: tuple[str, ...] = ()

    def part(self, rows: IntArray) -> Rows:
        """Some of them, in this order."""
        return replace(
            self, table=self.table.part(rows), at=self.at[rows], z=self.z[rows], sigma=self.sigma[rows],
            source=self.source[rows],
        )  # fmt: skip

    def frames(self, time: Array) -> IntArray:
        """Their frames, of shape of `at`, among `time` (N,)."""
        return np.searchsorted(time, self.at).astype(np.int64)

    @property
    def covariance(self) -> Array:
        """Of z (K, 3, 3), zero where not measured."""
        return np.asarray(np.where(np.isnan(self.z), 0.0, self.sigma**2)[:, :, None] * np.eye(3))


def _instants(
    file: TextTable, wanted: Wanted, role: str, odometry: Odometry, stamps: Sequence[str], rows: Sequence[str]
) -> tuple[Sequence[str], bool]:
    """The columns of instants, stamps or rows of the odometry, and whether they are stamps."""
    t, of = (wanted.columns.find(file, role, q) for q in (stamps[0], rows[0]))
    unstamped = t is not None and of is not None and any(row[of] and not row[t] for row in file.rows)
    stamped = odometry.stamped and t is not None and not unstamped
    own, poses = file is wanted.texts["odometry"], len(odometry.rows)
    if t is None and of is None and role == "fixes" and (own or _in_order(file, wanted, poses)):
        told = f"{file.path.name}: inferred: its rows are those of the odometry in order, {len(file)} of {poses}"
        wanted.columns.notes += [told] * (not own)
        return (), False
    if not stamped and of is None:
        wanted.columns.require(file, role, (stamps if odometry.stamped else rows)[:1])
    return (stamps, True) if stamped else (rows, False)


ANEW = 5.0  # s, by which one step back is no delay of a message


def _at(table: Table, keys: Sequence[str], stamped: bool, odometry: Odometry, notes: list[str]) -> Array:
    """Instants (K, keys) [s] of stamps, or of row numbers of the odometry, from 1 where the last one says so."""
    if stamped:
        return table.stack(keys)
    last, found = len(odometry.rows) - 1, []
    numbers = table.stack(keys)
    if one := 2 * len(np.unique(numbers)) > last and numbers.min() >= 1.0 and numbers.max() == last + 1.0:
        notes.append(f"{Path(table.path).name}: inferred: {keys[0]} counts from 1, as {last + 1} is its last")
    for key in keys:
        rows = table.integers(key, 0) - one
        table.require(rows <= last, key, f"{{}} is out of range; the odometry has rows 0 to {last}")
        at = odometry.rows[rows]
        table.require(~np.isnan(at), key, "{}: that row of the odometry is blank; a row with odometry is needed")
        found.append(at)
    return np.stack(found, axis=-1)


def read_fixes(file: TextTable, wanted: Wanted, odometry: Odometry, notes: list[str]) -> Rows:
    """The fixes of a file: of each row the position (x, y), the heading, or both."""
    columns, role = wanted.columns, "fixes"
    keys, stamped = _instants(file, wanted, role, odometry, ("t",), ("frame",))
    position = [q for q in ("x", "y") if columns.find(file, role, q) is not None]
    heading = [q for q in pose_columns(file, columns, role)[2:] if columns.find(file, role, q) is not None]
    if columns.stated(role, ("theta",)) and not columns.stated(role, ("x", "lat")) and "x" not in columns.given:
        position = []  # of a column that is something else
    if len(position) == 1 or not (position or heading):
        what = f"no fixes: {described(file)}; x and y, or a heading theta, or both are needed"
        raise DataError.at(file.path, f"{what}; name them as in --columns fixes.x=EAST,fixes.y=NORTH")
    default, typed = wanted.fix_sigma, {key.removeprefix("fixes.") for key in columns.given}
    alone = ({"x", "y"} <= typed or {"lat", "lon"} <= typed) and not typed & {"theta", *QUATERNION}
    known = (default is not None and not np.isnan(default[2])) or columns.find(file, role, "stheta") is not None
    if heading and alone and not known:
        named = ",".join(file.names[columns.find(file, role, q) or 0] for q in heading)
        why = "as --columns names x and y alone, and --fix-sigma their noise (SX,SY,STHETA reads it, too)"
        notes.append(f"{file.path.name}: the heading of fixes, {named}, is left out, {why}")
        heading = []
    values, blank = (*position, *heading), (*position, *heading, *SIGMAS)
    table, _ = columns.table(file, role, (*keys, *values), optional=SIGMAS, texts=("source",), may_be_blank=blank)
    z = np.full((len(table), 3), np.nan)
    z[:, :2] = table.stack(position) if position else np.nan
    if heading:
        z[:, 2] = headings(table.columns)
    half = np.isnan(z[:, 0]) != np.isnan(z[:, 1])
    if half.any():
        row = int(np.argmax(half))
        raise table.error(row, "y" if np.isnan(z[row, 1]) else "x", "blank; both x and y, or neither, are needed")
    if default is None and not table.together(SIGMAS[:2]) and "stheta" not in table:
        default, columns.origins["fix_noise"] = np.array(FIX_SIGMA), Origin.ASSUMED
        notes.append("assumed: --fix-sigma 1m,1m,5deg")
    of_file = np.searchsorted(file.line, table.line)
    at = _at(table, keys, stamped, odometry, notes) if keys else odometry.rows[of_file][:, None]
    if len({*map(tuple, z[np.isfinite(z[:, 0]), :2].tolist())}) > 2 and not np.ptp(at):
        raise table.error(1, keys[0], f"the same of {len(z)} fixes at different places, so no instant; leave it out")
    found = _measured(role, table, file.path, at, stamped, z, default)
    filled = ~np.isnan(z).all(axis=1)
    if not filled.all():
        notes.append(f"{file.path.name}: {counted(int((~filled).sum()), 'row')} without a fix")
    return found.part(np.flatnonzero(filled)[np.argsort(found.at[filled, 0], kind="stable")])


def read_closures(file: TextTable, wanted: Wanted, odometry: Odometry) -> Rows:
    """The closures of a file, by their later end."""
    role = "closures"
    if wanted.columns.find(file, role, "dx") is None and wanted.columns.find(file, role, "range") is not None:
        what = "ranges between poses or robots are not read, as they tell no motion; dx, dy, dtheta are needed"
        raise DataError.at(file.path, what)
    keys, stamped = _instants(file, wanted, role, odometry, ("t1", "t2"), ("frame1", "frame2"))
    table, _ = wanted.columns.table(
        file, role, (*keys, *RELATIVE), optional=SIGMAS, texts=("source",), may_be_blank=SIGMAS
    )
    at = _at(table, keys, stamped, odometry, wanted.columns.notes)
    table.require(at[:, 0] != at[:, 1], keys[1], f"{{}} is {keys[0]}, too; two frames are needed")
    found = _measured(role, table, file.path, at, stamped, table.stack(RELATIVE), wanted.closure_sigma)
    return found.part(np.argsort(at.max(axis=1), kind="stable"))


def _measured(role: str, table: Table, path: Path, at: Array, stamped: bool, z: Array, default: Array | None) -> Rows:
    """With the sigma of each row, else the stated one, and the sources by name: that of the column, else the file."""
    sigma = np.tile(np.full(3, np.nan) if default is None else default, (len(z), 1))
    for k, name in enumerate(SIGMAS):
        own = table.get(name)
        table.require(np.isnan(own) | (own > 0.0), name, "{} is no standard deviation > 0")
        sigma[:, k] = np.where(np.isnan(own), sigma[:, k], own)
    lacking: BoolArray = np.asarray((np.isnan(sigma) & ~np.isnan(z)).any(axis=1))
    one, needed = ("fix", "SX,SY (m), STHETA (rad), or all three") if role == "fixes" else ("closure", "SX,SY,STHETA")
    if lacking.any():
        first = table.error(int(np.argmax(lacking)), None, f"unknown noise of this {one}")
        raise UsageError(f"{first}; --{one}-sigma {needed}, or columns {', '.join(SIGMAS)} are needed")
    table.require_names("source")
    stem = path.stem if is_name(path.stem) else role
    given = [name or stem for name in table.texts.get("source", [""] * len(z))]
    names = tuple(dict.fromkeys(given)) or (stem,)
    number = {name: k for k, name in enumerate(names)}
    return Rows(role, one, table, at, stamped, z, sigma, np.array([number[n] for n in given], np.int64), names)


def read_observations(file: TextTable, of: TableSensor, wanted: Wanted, odometry: Odometry, notes: list[str]) -> Rows:
    """The observations of a sensor's file: range and bearing, one of them alone, or x and y in the sensor's frame."""
    columns, role, name = wanted.columns, of.role, of.sensor.label
    own, values = f"{name}." if name else "", of.measured
    if values == ("range", "bearing") and columns.find(file, role, "range") is None:
        what = f"bearings without a range: {described(file)}; name its column, as in --columns {own}range=DIST"
        raise DataError.at(file.path, f"{what}; if there are only bearings, --observation-sigma has one number")
    in_turn = odometry.rows[np.isfinite(odometry.rows)]
    each, steps = _rows_a_step(file, of, wanted, len(in_turn))
    keys, stamped = ((), False) if each else _instants(file, wanted, role, odometry, ("t",), ("frame",))
    numbers = (*IDS, *(q for q in of.looked if q == appearance.DESCRIPTOR))
    table, left = columns.table(file, role, (*values, *keys), optional=numbers, texts=of.looked, may_be_blank=numbers)
    if left and list(wanted.files.values()).count(file.path) == 1:  # no other role has the file
        notes.append(f"{file.path.name}: {left} rows without an observation")
    for quantity, flag in LOOKS.items():
        if quantity not in of.looked and (column := columns.find(file, role, quantity)) is not None:
            columns.read.add((file.path, file.names[column]))
            notes.append(f"{file.path.name}: column {quantity} is not used; --{flag} uses it")
    z = np.zeros((len(table), 2))
    z[:, [1] if values == ("bearing",) else list(range(len(values)))] = table.stack(values)
    if "range" in values:
        hint, below, some = "", z[z[:, 0] < 0.0, 0], np.count_nonzero(z[:, 0])
        if values[-1] == "bearing" and (z[:, 1] >= 0.0).all():
            name_of = {v: file.names[columns.find(file, role, v) or 0] for v in values}
            other = f"{own}range={name_of['bearing']},{own}bearing={name_of['range']}"
            hint = f", and no bearing is: if they are exchanged, --columns {other}"
        mark = MARK <= len(below) < some and not np.ptp(below)  # one number, such as -1
        if len(below) > FEW * some and not mark:
            table.require(z[:, 0] >= 0.0, "range", "{} is a negative range" + hint)
    there: BoolArray = np.asarray(z[:, 0] > 0.0 if "range" in values else z.any(axis=1))
    if values != ("bearing",) and not there.all():
        notes.append(f"{file.path.name}: {nothing_there(int((~there).sum()), int(there.sum()))}")
        table, z = table.part(there), z[there]
    if "frame" in table and 0 < file.steps < len(odometry.rows):  # a row for each step, which leads to the next pose
        table.columns["frame"] += 1.0
    at = np.zeros((len(z), 1)) if each else _at(table, keys, stamped, odometry, notes)
    if each:
        step, i = np.divmod(np.searchsorted(file.line, table.line), each)
        at, seen, (far, turn) = in_turn[-steps:][step, None], np.full((steps, each, 2), np.nan), of.sensor.polar(z).T
        seen[step, i] = np.column_stack([far * np.cos(turn), far * np.sin(turn)])
        ids, said = _landmarks_in_turn(seen, of, wanted)
        if len(ids) and not {*IDS} & {*table.columns}:
            table = replace(table, columns={**table.columns, "label": ids[i].astype(float)})
        notes.append(f"{file.path.name}: inferred: {counted(each, 'observation')} in each of {steps} rows{said}")
    what = f"{OBSERVATIONS} of {name}" if name else OBSERVATIONS
    found = Rows(what, "observation", table, at, stamped, z, np.tile(of.sigma, (len(z), 1)), 0 * table.line)
    if back := int((np.diff(at[:, 0]) < 0.0).sum()):
        far = -float(np.diff(at[:, 0]).min())
        anew = f", one by {far:.6g} s: did the clock begin anew there?" * (back == 1 and stamped and far > ANEW)
        notes.append(f"{file.path.name}: {back} observations were stamped before the one above{anew}; sorted")
        found = found.part(np.argsort(at[:, 0], kind="stable"))
    return found


FEW, MARK = 0.1, 3  # Largest share of negative ranges, and least number of equal ones, that are left out


def _in_order(file: TextTable, wanted: Wanted, poses: int) -> bool:
    """Whether fixes without stamps in a file of their own are of the poses, or the first of steps, in their order."""
    few = wanted.kind == "steps" and len(file) < poses < 2 * len(file)
    return (few or len(file) == poses) and _unstamped(file, "fixes", wanted)


def _unstamped(file: TextTable, role: str, wanted: Wanted) -> bool:
    """Whether a role has neither stamps nor frames, nor in a file of its own a column that ascends as these do."""
    found = {q: wanted.columns.quiet.find(file, role, q) for q in ("t", "frame", *STARRED, "theta", *SIGMAS)}
    own = [*wanted.texts.values()].count(file) == 1
    others = [v for k, v in enumerate(zip(*file.rows, strict=True)) if own and k not in found.values()]
    stamps = [v for v in others if all(map(is_number, v)) and (np.diff(np.array(v, float)) >= 0.0).all()]
    return found["t"] is None and found["frame"] is None and all(v[0] == v[-1] for v in stamps)


def _rows_a_step(file: TextTable, of: TableSensor, wanted: Wanted, poses: int) -> tuple[int, int]:
    """Of observations without stamp and frame: how many each step (or pose) has, and the number of steps; else 0, 0."""
    c = wanted.columns.find(file, of.role, of.measured[0])
    rows = max((k + 1 for k, row in enumerate(file.rows) if row[c or 0]), default=1)
    found = [n for n in (poses, poses - 1) if n and rows % n == 0 and (n == poses or wanted.kind == "steps")]
    return (rows // found[0], found[0]) if found and _unstamped(file, of.role, wanted) else (0, 0)


def _landmarks_in_turn(seen: Array, of: TableSensor, wanted: Wanted) -> tuple[IntArray, str]:
    """Ids (n,) of landmarks seen (K, n, 2) in the same order each time, and a note; no ids where not so."""
    texts, apart = wanted.texts, np.hypot(*np.moveaxis(seen - np.roll(seen, 1, axis=1), -1, 0))
    known = _map(texts["map"], replace(wanted, columns=wanted.columns.quiet)) if "map" in texts else None
    ids = np.arange(seen.shape[1]) if known is None else known.id
    right = np.nanmedian(apart, axis=0)
    if known is not None and len(ids) == seen.shape[1]:
        if len(of.measured) == 1:
            return ids, "; assumed: the i-th of a row is landmark i of the map"
        right = np.hypot(*(known.xy - np.roll(known.xy, 1, axis=0)).T)
    beams = known is None and np.nanstd(np.arctan2(*seen[:, 0].T)) < TURNED_BY  # of a scan, which show no landmarks
    if not 1 < len(ids) == seen.shape[1] or beams or np.nanmean(np.abs(apart - right)) >= FIT * np.mean(right):
        return np.zeros(0, np.int64), ""
    return ids, f"; inferred: the i-th of a row is landmark i{' of the map' * (known is not None)}, as distances fit"


FIT, TURNED_BY = 0.2, 1e-6  # Largest share by which distances differ; rad, least deviation of bearings of landmarks


def joined(
    parts: Sequence[Rows], sensors: Sequence[TableSensor], time: Array
) -> tuple[Observations, dict[str, IntArray]]:
    """Observations of all sensors by frame, then sensor, and their ids by column; frames are at `time` (N,)."""
    frame = np.concatenate([np.empty(0, np.int64), *(p.frames(time)[:, 0] for p in parts)])
    number = np.repeat(np.arange(len(parts)), [len(p.at) for p in parts])
    by = np.lexsort((number, frame))
    z = np.concatenate([np.empty((0, 2)), *(p.z for p in parts)])[by]
    sigma = np.concatenate([np.empty((0, 2)), *(p.sigma for p in parts)])[by]
    ids: dict[str, IntArray] = {}
    for name, blank in IDS.items():
        if any(name in p.table for p in parts):
            ids[name] = np.concatenate([p.table.integers(name, CLUTTER, blank=blank) for p in parts])[by]
    each = [of_observations(p.table, None, [(of.sensor.label, of.looks)]) for p, of in zip(parts, sensors, strict=True)]
    looks = appearance.every(each, [len(p.at) for p in parts])
    sensor = number[by] if len(parts) > 1 else None
    R, seen = (sigma**2)[:, :, None] * np.eye(2), None if looks is None else looks.only(by)
    return Observations(frame[by], z, R, sensor=sensor, appearance=seen), ids


def sensor_of(seen: Rows, of: TableSensor) -> Sensor:
    """The sensor, with the given or observed reach."""
    if of.origins.get("max_range") is not Origin.INFERRED:
        return of.sensor
    # a little more, so that the farthest observation is inside whatever the rounding
    return replace(of.sensor, max_range=1.001 * float(of.sensor.polar(seen.z)[:, 0].max(initial=0.0)) or np.inf)


@dataclass(frozen=True, eq=False)
class TruePoses:
    """True poses (K, 3) in the world frame, NaN where unknown, at stamps (K,) [s]; None: one for each frame."""

    time: Array | None
    pose: Array

    @property
    def begin(self) -> float | None:
        """Stamp of the first known pose; None without one."""
        known = np.isfinite(self.pose[:, :2]).all(axis=1)
        return None if self.time is None or not known.any() else float(self.time[np.argmax(known)])


def _between(wanted: Wanted) -> bool:
    """Whether steps without stamps lead from pose to pose: columns say so, or there is a true pose or a frame more."""
    columns, texts, file = wanted.columns, wanted.texts, wanted.texts["odometry"]
    if columns.find(file, "odometry", "t") is not None:
        return False
    ends = [c for q in ("frame1", "frame2") if (c := columns.find(file, "odometry", q)) is not None]
    if len(ends) == 2:
        columns.read |= {(file.path, file.names[c]) for c in ends}
        first, last = (n[np.isfinite(n)] for n in (file.numbers(c, np.ones(len(file), bool)) for c in ends))
        return bool((last == first + 1.0).all() and (np.diff(first) == 1.0).all())
    places = [(file, columns.find(file, "odometry", "dx"))]
    places += [(texts[role], columns.find(texts[role], role, "x")) for role in ("truth", "fixes") if role in texts]
    steps, *others = (sum(row[c or 0] != "" for row in of.rows) for of, c in places)
    moved = (
        file.numbers(c, np.arange(len(file)) == 0)
        for q in RELATIVE
        if (c := columns.find(file, "odometry", q)) is not None
    )
    few = "fixes" in texts and others[-1] < steps and _in_order(texts["fixes"], wanted, steps + 1)
    frames = [of.numbers(c, np.ones(len(of), bool)).max(initial=0.0) for role, of in texts.items()
              if of is not file and (c := columns.find(of, role, "frame")) is not None]  # fmt: skip
    turns = [_rows_a_step(texts[s.role], s, wanted, steps + 1) for s in wanted.sensors]
    more = any(n > steps and each * n % steps for each, n in turns)
    few &= any(step.any() for step in moved)  # the first fix is before it
    return steps + 1 in others or few or max(frames, default=0.0) == steps or more


def read_log(name: str, wanted: Wanted) -> Recording:
    """The log of the tables; DataError or UsageError for invalid parts, stamps without overlap, or a missing prior."""
    columns, texts, notes = wanted.columns, wanted.texts, wanted.columns.notes
    between = wanted.kind == "steps" and _between(wanted)
    odometry = read_odometry(texts["odometry"], columns, wanted.kind, wanted.wheels, between=between)
    other_rate(texts["odometry"], columns, odometry, wanted.wheels if wanted.kind == "ticks" else None)
    if wanted.backward and odometry.velocities:
        odometry = odometry.held_backward()
    parts = [read_observations(texts[sensor.role], sensor, wanted, odometry, notes) for sensor in wanted.sensors]
    if odometry.velocities:
        way = "since the row before" if wanted.backward else "until the next row"
        other = "forward: until the next row" if wanted.backward else "backward: since the row before"
        notes.append(f"v and omega are taken to hold {way} (--hold {other})")
    if "fixes" in texts:
        parts.append(read_fixes(texts["fixes"], wanted, odometry, notes))
    if "closures" in texts:
        parts.append(read_closures(texts["closures"], wanted, odometry))
    scanned = None
    if SCANS in texts:
        scanned, stamps = read_scans(texts[SCANS], columns, wanted.scanner, odometry, wanted.mount)
        once = np.flatnonzero(np.diff(scanned.stamp, prepend=-np.inf) > 0.0)
        z = scanned.ranges
        parts.append(Rows(SCANS, "scan", stamps, scanned.stamp[:, None], True, z, z, 0 * stamps.line).part(once))
        notes += scanned.notes
        columns.asked += scanned.asked
    second = None if wanted.second is None else read_second(texts[SECOND], wanted.second, columns, odometry)
    wanted = replace(wanted, every_row=wanted.every_row or not (parts or second))  # a truth alone is at every row
    true = _true_poses(texts["truth"], wanted, odometry) if "truth" in texts else None
    if isinstance(wanted.prior, str) and true is not None:
        odometry, parts = _from_truth_on(odometry, parts, true, notes)
    time, parts = _frames(odometry, parts, wanted, notes)
    seen, found = parts[: len(wanted.sensors)], {part.what: part for part in parts[len(wanted.sensors) :]}
    measured, fixes = [], None
    if (f := found.get("fixes")) is not None:
        there = ~np.isnan(f.z)
        kind = np.where(there[:, 2], np.where(there[:, 0], FixKind.POSE, FixKind.HEADING), FixKind.POSITION)
        sources = tuple(FixSource(name, wanted.fix_lever, wanted.fix_rotation) for name in f.names)
        fixes = Fixes(f.frames(time)[:, 0], kind, f.source, np.nan_to_num(f.z), f.covariance, sources)
    if (c := found.get("closures")) is not None:
        first, last = c.frames(time).T
        measured.append(Closures(first, last, c.z, c.covariance, c.source, c.names))
    scans = None if scanned is None else Scans(scanned.scanner, found[SCANS].frames(time)[:, 0], found[SCANS].z)
    if second is not None and wanted.second is not None:
        taken = [name for closures in measured for name in closures.sources]
        measured.append(second_closures(texts[SECOND], second, wanted.second, time, taken, notes))
    increments, gaps = odometry.increments(time, wanted.noise, wanted.model)
    increments, gaps = (unknown_motion(time, wanted.blind), 0) if wanted.blind else (increments, gaps)
    fixes = None if fixes is None else _counter_clockwise(_fresh(fixes, increments, notes), increments, wanted)
    covariance, floored = floor_covariances(increments.covariance, FLOOR)
    if not odometry.velocities:
        floored += gaps  # of poses it counts floored covariances
    as_recorded = odometry.velocities and all(p.stamped for p in parts) and not wanted.every_row and scans is None
    if odometry.velocities and gaps and not as_recorded:  # of odometry.csv loading says it
        notes.append(f"odometry: {gaps_said(odometry.time, time)}")
    known = _map(texts["map"], wanted) if "map" in texts else None
    pose = None if true is None else _at_frames(true, texts["truth"], wanted, time)
    columns.check_used(list(dict.fromkeys(texts.values())))
    columns.say_unused(texts)
    observed, labels = joined(seen, wanted.sensors, time)
    named = np.concatenate([np.empty(0, np.int64), *labels.values()])
    last = 0 if known is None or columns.find(texts["map"], "map", "id") is not None else len(known.id)
    if known is not None and last and named.max(initial=0) == last and not (named == 0).any():
        known = replace(known, id=known.id + 1)
        notes.append(f"inferred: landmarks of the map count from 1, as {last} is the last label")
    if known is not None and "label" in labels and "true_id" not in labels:
        scored = "not scored: a sensor read the labels" if wanted.sensed else "scored under their labels"
        notes.append(f"landmarks of a map are {scored}; a column true_id tells pairings right from wrong, too")
    looks, known_looks = appearance.together([observed.appearance, None if known is None else known.appearance])
    observed = replace(observed, appearance=looks)
    known = None if known is None else replace(known, appearance=known_looks)
    sensors = tuple(sensor_of(part, of) for part, of in zip(seen, wanted.sensors, strict=True))
    sensors = sensors or (RangeBearing(np.inf if scans is None else scans.scanner.max_range),)
    kinds = set((known.kind or ()) if known is not None else ()) - {""}
    for sensor in (of.sensor for of in wanted.sensors if known is not None):
        if sensor.sees and sensor.sees not in kinds:  # landmarks that the map has none of
            have = unknown(sensor.sees, sorted(kinds)) if kinds else "not in the map, which has no kinds"
            text = f"{sensor.label}={sensor.sees}" if sensor.label else sensor.sees
            raise UsageError(f"--sees {text}: {have}; column {KIND} of the map names them (--columns map.{KIND}=NAME)")
    free = wanted.prior is None and pose is None and known is not None and "label" in labels
    onto = _onto_map(known, sensors, observed, labels["label"], increments) if free and known is not None else None
    inputs = Inputs(
        prior=_prior(wanted, pose, known, increments, fixes, onto, odometry), time=time,
        increments=replace(increments, covariance=covariance), observations=observed, sensor=sensors[0],
        sensors=sensors if len(sensors) > 1 else (), map=known, time_is_index=not odometry.stamped,
        covariance_floor=FLOOR, floored=floored, fixes=fixes, closures=together(measured), scans=scans,
    )  # fmt: skip
    several = [of.sensor.label for of in wanted.sensors if of.sensor.label]
    files = {role: path.name for role, path in wanted.files.items() if role not in several}
    each = {role: [path] if path.is_dir() else parts_of(path) for role, path in wanted.files.items()}
    digested = {role: [file_and_word(file_and_topic(str(p))[0])[0] for p in some] for role, some in each.items()}
    digest = {role: " ".join(map(file_sha256, some)) for role, some in digested.items()}
    files |= {f"{role}_sha256": digest[role] for role in wanted.files if role not in several}
    moved = "none" if wanted.blind else "velocities" if odometry.velocities else wanted.kind
    more: dict[str, object] = {ODOMETRY_KIND: moved}
    if several:
        more[SENSOR] = {name: {"file": wanted.files[name].name, "sha256": digest[name]} for name in several}
    if odometry.velocities and len(odometry.time) > 1:
        more |= {ODOMETRY_PERIOD: float(np.median(np.diff(odometry.time))), INTEGRATION: wanted.model}
    more |= {"wheels": vars(wanted.wheels)} if wanted.kind == "ticks" else {}
    more |= {"hold": "backward"} if wanted.backward else {}
    more |= {TRUTH_POSE: wanted.truth_pose.tolist()} if wanted.truth_pose.any() else {}
    more |= {"time_offset": dict(columns.offsets)} if columns.offsets else {}
    more |= {"datum": columns.datum} if columns.datum else {}
    log = Log(
        name, inputs, Truth(pose, known, labels.get("true_id")), label=labels.get("label"),
        labels_are_sensed=wanted.sensed,
        source={"kind": "table", **files, **more, "columns": dict(columns.given), "unit": dict(columns.units.given)},
        notes=tuple(notes), asked=tuple(columns.asked), origins=_origins(wanted),
    )  # fmt: skip
    if not as_recorded or not isinstance(wanted.noise, VelocityNoise):
        return Recording(log)
    stamped = None if true is None else (time if true.time is None else true.time, true.pose)
    return Recording(log, Samples(odometry.time, odometry.motion, VelocityModel(wanted.noise, wanted.model), stamped))


def _origins(wanted: Wanted) -> Origins:
    """Where all that no file states comes from."""
    given = {"fix_noise": wanted.fix_sigma, "closure_noise": wanted.closure_sigma, "prior": wanted.prior}
    flags = {"units": wanted.columns.units.given, "time_offset": wanted.columns.offsets}
    found = {"odometry_noise": Origin.GIVEN} | {q: Origin.GIVEN for q, value in given.items() if value is not None}
    found |= {q: Origin.GIVEN for q, values in flags.items() if values}
    if SCANS in wanted.files:
        found["sensor_pose"] = Origin.ASSUMED if wanted.mount is None else Origin.GIVEN
        found["range_noise"] = Origin.ASSUMED
    for of in wanted.sensors:
        found |= {f"{q}.{of.sensor.label}" if of.sensor.label else q: origin for q, origin in of.origins.items()}
    return found | dict.fromkeys(wanted.assumed, Origin.ASSUMED) | wanted.columns.origins


def _from_truth_on(
    odometry: Odometry, parts: list[Rows], true: TruePoses, notes: list[str]
) -> tuple[Odometry, list[Rows]]:
    """Odometry and the rest since the first true pose, where a log with that prior begins."""
    begin = true.begin
    if begin is None or not odometry.time[0] < begin < odometry.time[-1]:
        return odometry, parts
    if not all(part.stamped for part in parts):
        begin = float(odometry.time[np.searchsorted(odometry.time, begin)])
    later: list[BoolArray] = [np.asarray((part.at >= begin).all(axis=1)) for part in parts]
    left = [counted(int((~kept).sum()), part.one, part.what) for kept, part in zip(later, parts, strict=True)]
    late = f"{begin - odometry.time[0]:.6g} s after the odometry"
    notes.append(f"the truth begins {late}; so does the log" + f", without {' and '.join(left)} before" * bool(left))
    kept = [part.part(np.flatnonzero(fine)) for fine, part in zip(later, parts, strict=True)]
    return odometry.since(begin), kept


def _frames(odometry: Odometry, parts: Sequence[Rows], wanted: Wanted, notes: list[str]) -> tuple[Array, list[Rows]]:
    """Time (N,) of the frames, and the parts that have odometry."""
    first, last = odometry.span
    kept: list[Rows] = []
    for part in parts:
        inside: BoolArray = np.asarray(((part.at >= first) & (part.at <= last)).all(axis=1))
        flag = "" if inside.all() else _unit(part.what.rpartition(" of ")[2], part.at.ravel(), odometry.time)
        if len(inside) and (not inside.any() or (flag and inside.mean() < 0.5)):
            apart = f"{part.what} from {_span(np.sort(part.at.ravel()))} s, odometry from {_span(odometry.time)} s"
            apart += " hardly overlap" if inside.any() else " do not overlap"
            raise DataError.at(
                part.table.path, f"{apart}; {flag or _clocks(part.at, odometry.time, part.what.rpartition(' of ')[2])}"
            )
        if part.stamped and len(part.at) and (odometry.time % 1.0).any():
            _require_digits(part)
        if not inside.all():
            some = f"{(~inside).sum()} of {len(inside)} {part.what}"
            notes.append(f"{some} before or after all odometry, {_span(odometry.time)} s, dropped")
        kept.append(part.part(np.flatnonzero(inside)))
    at = np.concatenate([np.empty(0), *(part.at.ravel() for part in kept)])
    if not any(part.stamped for part in parts):
        return np.union1d(odometry.time, at), kept
    last = max(float(odometry.time[-1]), at.max(initial=first))
    if last - first > LONGEST:
        span = f"the stamps span {last - first:.6g} s, {(last - first) / 86400.0:.3g} days"
        unit = "us" if last - first < 1e7 * len(odometry.time) else "ns"  # steps below 10 s
        raise DataError.at(odometry.table.path, f"{span}; state the unit as in --unit time={unit}")
    if wanted.every_row or not all(part.stamped for part in kept):
        at = np.concatenate([at, odometry.time])
    return frame_times(at, first, last), kept


def _span(time: Array) -> str:
    return f"{time[0]:.15g} to {time[-1]:.15g}"


def _map(file: TextTable, wanted: Wanted) -> LandmarkMap:
    """Landmarks in the world, numbered from 0 without ids; DataError for sigmas that a turned map would correlate."""
    columns = wanted.columns
    # a column of that name is something else where no sensor sees a kind
    kind = (KIND,) * (any(of.sensor.sees for of in wanted.sensors) or columns.stated("map", (KIND,)))
    looks = dict.fromkeys(q for sensor in wanted.sensors for q in sensor.looked)
    numbers = ("id", "sx", "sy", *(q for q in looks if q == appearance.DESCRIPTOR))
    table, _ = columns.table(file, "map", ("x", "y"), optional=numbers, texts=(*kind, *looks), may_be_blank=numbers[1:])
    x, y = se2.transform_points(wanted.map_pose, table.stack(("x", "y"))).T
    placed = {"id": np.arange(len(table), dtype=float), **table.columns, "x": x, "y": y}
    quarters = float(wanted.map_pose[2]) / (0.5 * np.pi)
    if table.together(SIGMAS[:2]):
        sx, sy = (np.nan_to_num(table.columns[q]) for q in SIGMAS[:2])
        if abs(quarters - round(quarters)) > 1e-9:
            table.require(sx == sy, SIGMAS[0], "{} differs from sy; a map turned by --map-transform needs both equal")
        elif round(quarters) % 2:
            placed |= {"sx": sy, "sy": sx}
    return landmarks_of(replace(table, columns=placed))[0]


def _true_poses(file: TextTable, wanted: Wanted, odometry: Odometry) -> TruePoses:
    """The poses of a truth file; without stamps one for each row of the odometry, or for each frame."""
    columns = wanted.columns
    pose = pose_columns(file, columns, "truth")
    by_stamp = odometry.stamped and columns.find(file, "truth", "t") is not None
    frame = columns.find(file, "truth", "frame") if not by_stamp and file is not wanted.texts["odometry"] else None
    by_frame = frame is not None and (columns.stated("truth", ("frame",)) or "." not in file.names[frame])
    wants = (*(("t",) if by_stamp else ("frame",) if by_frame else ()), *pose)
    table, _ = columns.table(file, "truth", wants, may_be_blank=pose)
    values = table.columns
    turn = headings(values, columns.units.factor("truth", "theta")) if len(pose) > 2 else np.full(len(table), np.nan)
    read = np.stack([values["x"], values["y"], turn], axis=-1)
    level = unturned(table.stack(QUATERNION) if QUATERNION[0] in values else turn, read[:, :2])
    if level or not np.isfinite(turn).any():
        read[:, 2] = np.nan
        columns.notes.append(f"{file.path.name}: {ABSENT}")
    read = columns.turned(file, "truth", values["t"] if by_stamp else np.arange(len(read), dtype=float), read)
    read[~np.isfinite(read[:, :2]).all(axis=1)] = np.nan
    world = se2.compose(wanted.truth_pose, read) if wanted.truth_pose.any() else read
    if by_stamp:
        table.require_ascending("t", strictly=False)
        keep = _once(table, world)
        if more := len(world) - len(keep):
            some = f"{more} of {len(world)} true poses share their stamp with the next one, which is used"
            columns.notes.append(f"{file.path.name}: {some}")
        return TruePoses(values["t"][keep], world[keep])
    if by_frame:
        at = _at(table, ("frame",), False, odometry, columns.notes)[:, 0]
        by = np.argsort(at, kind="stable")
        return TruePoses(at[by], world[by])
    if len(world) != len(odometry.rows):
        known = np.flatnonzero(np.isfinite(world[:, 0]))
        world = world[: known[-1] + 1] if len(known) else world  # columns of other lengths beside it
    if len(world) != len(odometry.rows):
        return TruePoses(None, world)
    own = np.flatnonzero(np.append(np.diff(odometry.rows) != 0.0, True) & ~np.isnan(odometry.rows))
    return TruePoses(odometry.rows[own], world[own])


def _once(table: Table, pose: Array) -> IntArray:
    """The last of the rows at each stamp of poses (K, 3); DataError where these are farther apart than `SAME` steps."""
    step = np.hypot(*np.diff(pose[:, :2], axis=0).T)
    again = np.diff(table.columns["t"]) == 0.0
    moves = step[~again & (step > 0.0)]
    far = again & (step > SAME * (np.median(moves) if len(moves) else 0.0))
    if far.any():
        row = int(np.argmax(far))
        what = f"the stamp of the row before, whose true place is {step[row]:.3g} m off; stamps that tell them apart"
        raise table.error(row + 1, "t", f"{what} are needed")
    return in_order(str(table.path), table.columns["t"], np.nan_to_num(pose)).astype(np.int64)


SAME = 3.0  # Usual steps between stamps, within which true poses at one stamp are the same


def _require_digits(part: Rows) -> None:
    """DataError for observations whose stamps of whole seconds are those of others of their landmarks, or all alike."""
    if np.ptp(part.at) and (part.at % 1.0).any():
        return
    ids = next((part.table.columns[name] for name in IDS if name in part.table), np.full(len(part.at), CLUTTER))
    named = np.column_stack([part.at[:, 0], ids])[ids >= 0]
    twice = len(named) - len(np.unique(named, axis=0))
    if twice > max(COARSE * len(named), MANY) or (len(part.at) > MANY and not np.ptp(part.at)):
        some = f"{twice or len(part.at)} of {len(part.at)} {part.what} have the stamp of another one"
        raise DataError.at(part.table.path, f"{some}; stamps with more digits than {part.at[0, 0]:.15g} are needed")


def _unit(role: str, time: Array, other: Array) -> str:
    """What makes two parts span alike, if one of them spans a thousand, a million, ... times the other."""
    spans = float(np.ptp(time)), float(np.ptp(other))
    digits = float(np.log10(spans[0] / spans[1])) if min(spans) > 0.0 else 0.0
    unit = {3: "ms", 6: "us", 9: "ns"}.get(abs(round(digits))) if abs(digits - round(digits)) < 0.1 else None
    return f"state the unit as in --unit {role if digits > 0.0 else 'odometry'}.t={unit}" if unit else ""


def _clocks(time: Array, other: Array, role: str) -> str:
    """What to type where two parts have nothing in common: they begin together, or have other units."""
    shift = f"--time-offset {role}={float(other[0] - time.min()):.13g}, if both begin together"
    return f"state the units as in --unit {role}.t=ms, or the clocks as in {shift}"


def _at_frames(true: TruePoses, file: TextTable, wanted: Wanted, time: Array) -> Array:
    """True poses (N, 3) at the frames, NaN where unknown."""
    if true.time is None:
        if len(true.pose) != len(time):
            what = f"{len(true.pose)} true poses, {len(time)} frames: which belong together?"
            more = "stamps t of odometry and truth, or a true pose for each row of the odometry, are needed"
            raise DataError.at(file.path, f"{what} {more} (--columns odometry.t=NAME,truth.t=NAME)")
        return true.pose
    result = truth_at(true.time, true.pose, time)
    if outside := int(((true.time < time[0]) | (true.time > time[-1])).sum()):
        some = f"{outside} of {counted(len(true.time), 'true pose')}"
        wanted.columns.notes.append(f"{some} before or after all odometry, {_span(time)} s, dropped")
    flag = _unit("truth", true.time, time)
    if true.begin is not None and (flag or not np.isfinite(result).any()):
        apart = f"truth from {_span(true.time)} s, frames from {_span(time)} s: no frame has one within"
        apart += f" {usual_gap(true.time):g} s"
        raise DataError.at(file.path, f"{apart}; {flag or _clocks(true.time, time, 'truth')}")
    return result


def _ahead(pose: Array, moved: Array) -> tuple[float, float] | None:
    """Heading at the start, with its deviation, that takes increments (N, 3) to true places (N, 3); None: no way."""
    path = se2.dead_reckoned(np.zeros(3), moved)
    way, driven = ((p[:, :2] - p[0, :2]) @ np.array([1.0, 1j]) for p in (pose, path))
    far = np.flatnonzero((np.abs(way) > FAR) & (np.abs(driven) > FAR))
    if not len(far):
        return None
    along = np.hypot(*moved[:, :2].T).cumsum()[far]
    turn = (way * driven.conj())[far[along <= along[0] + FITTED]]
    off = float(np.sqrt(np.mean(np.angle(turn / turn[0]) ** 2)))
    if off > LOOSE and not moved[:, 2].any():  # axes that never turn: all of the way tells
        turn = (way * driven.conj())[far]
    return float(np.angle(turn[0] if off <= LOOSE else turn.sum())), max(off, LOOSE)


def _agree(fixes: Fixes, moved: Increments, start: Array) -> bool:
    """Whether headings of fixes at the odometry's turns from a start point ahead, rather than elsewhere."""
    rows = np.flatnonzero(fixes.kind != FixKind.POSITION)
    turned = se2.dead_reckoned(start, moved.mean)[fixes.frame[rows], 2]
    return not len(rows) or float(np.cos(turned - fixes.z[rows, 2]).mean()) > ODD


def _fresh(fixes: Fixes, moved: Increments, notes: list[str]) -> Fixes:
    """The positions that do not repeat the one before while the odometry moves: a source may hold its last one."""
    rows = np.flatnonzero(fixes.kind != FixKind.HEADING)
    rows = rows[np.argsort(fixes.source[rows], kind="stable")]
    stated = np.column_stack([fixes.source, fixes.z])[rows]
    way = np.hypot(*moved.mean[:, :2].T).cumsum()[fixes.frame[rows]]
    digit = np.abs(np.diff(stated[:, 1:3], axis=0))  # rounded places may repeat within two of their last digits
    least = max(MOVED, 2.0 * digit[digit > 0].min(initial=np.inf))
    again = (stated[1:] == stated[:-1]).all(axis=1)
    if not (again & (np.diff(way) > least)).any():
        return fixes
    held = rows[1:][again]
    notes.append(
        f"{len(held)} of {len(fixes)} fixes repeat the one before, also while the odometry moves: left out as held"
    )
    return replace(fixes.only(np.setdiff1d(np.arange(len(fixes)), held)), row=np.arange(len(fixes) - len(held)))


def _counter_clockwise(fixes: Fixes, moved: Increments, wanted: Wanted) -> Fixes:
    """With headings of a compass, or in degrees, from east in rad, where the odometry turns as they do only then."""
    rows = np.flatnonzero(fixes.kind != FixKind.POSITION)
    if {"theta", "angle", "fixes.theta"} & wanted.columns.units.typed or wanted.fix_rotation or len(rows) < MANY:
        return fixes
    turned = se2.dead_reckoned(np.zeros(3), moved.mean)[fixes.frame[rows], 2]
    mean = {unit: complex(np.exp(1j * (turned - unit * fixes.z[rows, 2])).mean()) for unit in (1.0, *TURNED)}
    fit = [unit for unit in TURNED if abs(mean[unit]) > CONCENTRATED]
    start = None if abs(mean[1.0]) > ODD or len(fit) != 1 else onto_fixes(fixes, moved.mean, moved.covariance)
    if start is None:
        return fixes
    quarters = float(np.angle(mean[fit[0]]) + start[0][2]) / (0.5 * np.pi)
    if abs(quarters - round(quarters)) * 0.5 * np.pi > 2.0 * LOOSE:
        return fixes
    z = fixes.z.copy()
    z[rows, 2] = se2.wrap_angle(0.5 * np.pi * round(quarters) + fit[0] * z[rows, 2])
    since = ("east", "north", "west", "south")[round(quarters) % 4]
    wanted.columns.origins["units"] = Origin.INFERRED
    text = f"inferred: headings of fixes are {TURNED[fit[0]]} from {since}, as the odometry turns so only"
    wanted.columns.notes.append(f"{text} (--unit fixes.theta=rad reads them as written)")
    return replace(fixes, z=z)


TURNED = {-1.0: "clockwise", math.radians(1.0): "in degrees", -math.radians(1.0): "in degrees clockwise"}
MOVED = 1e-3  # m between two fixes from which equal ones are held
CONCENTRATED, ODD = 0.9, 0.5  # Length of the mean unit vector of angles that agree, at least, and of others, at most


NEAR, SURE, FITTED, SEVERAL = 2.0, 3.0, 10.0, 500
"""m, way from the start within which observations tell it; largest deviation of these, in sigma; m, of true places;
most ranges that tell it."""


def _onto_map(
    known: LandmarkMap, sensors: Sequence[Sensor], seen: Observations, label: IntArray, moved: Increments
) -> Start | None:
    """The first pose, along whose increments the first labelled observations (M,) fit the map; None: they do not."""
    path, right = se2.dead_reckoned(np.zeros(3), moved.mean), known.positions(label)
    which = np.zeros(len(label), np.int64) if seen.sensor is None else seen.sensor
    locates = np.array([sensor.locates for sensor in sensors])[which]
    early = np.hypot(*np.diff(path[:, :2], axis=0, prepend=0.0).T).cumsum()[seen.frame] <= NEAR
    rows = np.flatnonzero(early & locates & np.isfinite(right[:, 0]))
    if len(np.unique(label[rows])) < 2:
        return _onto_ranges(sensors[0], seen, right, moved) if len(sensors) == 1 else None
    each = [sensors[which[k]].body_points(seen.z[k : k + 1], seen.R[k : k + 1]) for k in rows.tolist()]
    place, right = se2.transform_points(path[seen.frame[rows]], np.concatenate([p for p, _ in each])), right[rows]
    pose = se2.rigid_fit(place, right)
    off = se2.transform_points(np.tile(pose, (len(rows), 1)), place) - right
    sigma = math.sqrt(0.5 * float(np.mean([np.trace(P[0]) for _, P in each])))
    spread = math.sqrt(float(np.var(right, axis=0).sum()))
    loose = SURE * sigma  # the same observations count again, then
    if math.sqrt(0.5 * float((off**2).sum(axis=1).mean())) > loose or spread < loose:
        return None
    return Start(pose, np.array([loose, loose, loose / spread]), "observations to the map")


def _onto_ranges(sensor: Sensor, seen: Observations, place: Array, moved: Increments) -> Start | None:
    """The first pose, along whose increments the first ranges to landmarks at `place` (M, 2) fit, if only one does."""
    path, P = se2.dead_reckoned(np.zeros(3), moved.mean), moved.covariance
    step = 0.5 * (P[:, 0, 0] + P[:, 1, 1])
    drift = step.cumsum() if path.any() else np.sqrt(step).cumsum() ** 2  # an unknown motion goes on as it is
    drift += P[:, 2, 2].cumsum() * (path[:, :2] ** 2).sum(axis=1)
    near = drift[seen.frame] <= SURE**2 * seen.R[:, 0, 0]
    rows = np.flatnonzero(near & np.isfinite(place[:, 0]))[:SEVERAL]
    place, way, sigma = place[rows], path[seen.frame[rows]], np.sqrt(seen.R[:, 0, 0] + drift[seen.frame])[rows]
    if sensor.measures != (0,) or len(np.unique(place, axis=0)) < 3:
        return None

    def off(pose: Array) -> Array:
        return np.asarray((sensor.predict(se2.compose(pose, way), place) - seen.z[rows])[:, 0] / sigma)

    corners = np.stack([place.min(axis=0), place.max(axis=0)]).T
    starts = product(*corners, np.arange(8) * 0.25 * np.pi)
    fits = sorted((least_squares(off, start, loss="soft_l1") for start in starts), key=lambda fit: float(fit.cost))
    pose, J, larger = se2.compose(np.zeros(3), fits[0].x), np.asarray(fits[0].jac), 2.0 * fits[0].cost / len(rows)
    reach = np.append(np.ptp(corners, axis=1).max().repeat(2), np.pi)
    loose = SURE * np.sqrt(max(1.0, larger) * np.linalg.inv(J.T @ J + np.diag(1.0 / reach**2)).diagonal())
    equal = [se2.compose(se2.inverse(pose), f.x) for f in fits if f.cost < fits[0].cost + max(1.0, larger) * SURE**2]
    most = [*reach[:2], SURE * LOOSE if path.any() else np.inf]
    if larger > SURE**2 or (loose > most).any() or (np.abs(equal) > 2.0 * loose).any():
        return None
    return Start(pose, np.minimum(loose, [np.inf, np.inf, 0.25 * np.pi]), "ranges to the map")


def _mirrored(moved: Increments, frame: IntArray, place: Array) -> bool:
    """Whether the odometry's path fits places (F, 2) at frames far better turned over."""
    path = se2.dead_reckoned(np.zeros(3), moved.mean)[frame, :2]
    if not len(frame):
        return False
    sides = [(p, se2.rigid_fit(p, place)) for p in (path, path * [1.0, -1.0])]
    off = [np.sum((se2.transform_points(np.tile(pose, (len(p), 1)), p) - place) ** 2) for p, pose in sides]
    return bool(off[1] * MIRRORED < off[0])


MIRRORED = 9.0  # Ratio of squares by which a path turned over fits better


def _as_written(own: Array, fixes: Fixes, moved: Increments) -> Start | None:
    """The first pose of an odometry whose coordinates may be those of the fixes, as these lie along it; else None."""
    frame, place, sigma = fixes.placed
    off = se2.dead_reckoned(own, moved.mean)[frame, :2] - place
    if not len(place) or float(np.sqrt((off**2).sum(axis=1).mean())) > SURE * sigma:
        return None
    reach = max(float(np.hypot(*(place - place[0]).T).max()), sigma)
    turn = min(max(SURE * sigma / reach, LOOSE), 0.25 * math.pi)
    return Start(own, np.array([sigma, sigma, turn]), "odometry as it is written to the fixes")


def _prior(
    wanted: Wanted, pose: Array | None, known: LandmarkMap | None, moved: Increments, fixes: Fixes | None,
    onto: Start | None, odometry: Odometry,
) -> Prior:  # fmt: skip
    """Belief about the first pose; `onto`: that which takes observations onto the map."""
    if onto is not None:
        wanted.columns.origins["prior"] = Origin.INFERRED
        wanted.columns.notes.append(onto.said())
        return Prior(onto.pose, np.diag(onto.sigma**2))
    free = wanted.prior is None and pose is None and known is None
    start = onto_fixes(fixes, moved.mean, moved.covariance) if free and fixes is not None else None
    hidden = fixes is not None and (start is None or bool((fixes.kind != FixKind.POSITION).any()))  # of other questions
    turned = hidden and fixes is not None and _mirrored(moved, *fixes.placed[:2])
    if free and start is None and fixes is not None and wanted.kind == "poses" and not wanted.blind:
        start = _as_written(odometry.motion[0], fixes, moved)
    start = None if turned else start
    if start is not None and fixes is not None and _agree(fixes, moved, start.pose):
        fits = way_share(moved, *fixes.placed) is None
        wanted.columns.origins["prior"] = Origin.INFERRED if fits else Origin.ASSUMED
        wanted.columns.notes.append(start.said(fits=fits))
        return Prior(start.pose, np.diag(start.sigma**2))
    if wanted.prior is None:
        if pose is not None or known is not None or fixes is not None:
            frame = "truth" if pose is not None else "fixes" if known is None else "map"
            what = f"unknown start in the frame of the {frame}"
            right = "--prior X,Y,THETA (m, rad; or as in 90deg), or --prior truth for the first true pose, is needed"
            if turned:
                units = {"velocities": "omega=-rad/s", "poses": "odometry.y=-m,odometry.theta=-rad"}
                unit = units.get(wanted.kind, "odometry.dtheta=-rad")
                right = f"the odometry leads to them if it turns the other way (--unit {unit}, or in deg); else {right}"
            raise UsageError(f"{what}; {right}")
        return Prior(np.zeros(3), np.zeros((3, 3)))
    mean = wanted.prior
    assert wanted.prior_sigma is not None  # stated, or assumed beside a mean
    if isinstance(mean, str):
        if pose is None:
            raise UsageError("--prior truth: --truth FILE is needed")
        ahead = _ahead(pose, moved.mean) if np.isfinite(pose[0, :2]).all() and np.isnan(pose[0, 2]) else None
        ahead = (0.0, 0.25 * math.pi) if wanted.blind and np.isnan(pose[0, 2]) else ahead  # of an unknown motion any
        if ahead is not None:
            told = "{:.3g} deg within {:.3g} deg".format(*np.degrees(ahead))
            there = np.flatnonzero(np.isfinite(pose[:, 0]))
            fits = not wanted.blind and way_share(moved, there, pose[there, :2], 1.0) is None
            told += ", which takes odometry to truth" * fits
            wanted.columns.notes.append(f"the truth has no heading; that of the prior is {told}")
            sigma = np.maximum(wanted.prior_sigma, [0.0, 0.0, ahead[1]])
            return Prior(np.append(pose[0, :2], ahead[0]), np.diag(sigma**2))
        if not np.isfinite(pose[0]).all():
            what = "heading" if np.isfinite(pose[0, :2]).all() else "pose"
            if np.isfinite(pose[:, 0]).mean() < 0.5:
                what += ", and few others have (are stamps in ms? --unit time=ms)"
            raise UsageError(f"--prior truth: the first frame has no true {what}; state it with --prior X,Y,THETA")
        mean = pose[0]
    return Prior(mean, np.diag(wanted.prior_sigma**2))
