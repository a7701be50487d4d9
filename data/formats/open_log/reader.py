"""Open log folder, formats 1 and 2: reader with strict checks.

    log.toml            see `header`; a motion prior there replaces increments and odometry
    frames.csv          t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt        row 0: zero increment
    or odometry.csv     t,v,omega                                           preintegrated on loading
    observations.csv    frame,z1,z2[,r11,r12,r22][,true_id][,label]         with odometry.csv: t instead of frame;
                        in format 2 also sensor, and blank fields (see `sensors`), and descriptor, class (see
                        `appearance`)
    truth.csv           x,y,theta per frame, blank or nan where unknown     with odometry.csv: t,x,y,theta; optional
    landmarks.csv       the map (see `landmarks`)                           optional
    scans.npz           range scans (see `scans`); then observations.csv and [sensor] may be missing
    relations.csv       row1,row2,x,y,theta[,exact][,stamp1,stamp2][,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt]         optional
    fixes.csv           absolute measurements of the pose (see `fixes`)     format 2; then observations.csv and
    closures.csv        relative poses of two frames (see `closures`)       [sensor] may be missing

Columns may have any order; unknown ones are ignored. frames.csv of a log with relations may have a column stamp: the
recorded stamps, which need not increase. true_id: -1 false alarm, blank unknown. label: the sensor's, where it may
differ from true_id. With odometry.csv the frames are the instants with observations, fixes or ends of closures, and
keyframes where those are more than 1 s apart. relations.csv: reference relations for scoring without a true path.
x,y,theta: pose of frame row2 in that of frame row1 [m, m, rad], rows from 0; exact: 1 where both rows are certain, else
0; stamps [s] of the reference.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data.appearance import Appearance
from data.errors import DataError
from data.formats.csv_table import FIRST_ROW, Table, read_table
from data.formats.open_log import appearance as looks
from data.formats.open_log import closures as closures_file
from data.formats.open_log import fixes as fixes_file
from data.formats.open_log import landmarks as landmarks_file
from data.formats.open_log.closures import ClosureTable, read_closures
from data.formats.open_log.fixes import POSE, FixTable, read_fixes
from data.formats.open_log.header import FORMAT, LATEST, Header, read_header
from data.formats.open_log.landmarks import read_landmarks, usable_sigmas
from data.formats.open_log.named import COVARIANCE
from data.formats.open_log.scans import read_scans
from data.formats.open_log.sensors import NOISE, may_be_blank, observed
from data.formats.open_log.sensors import TABLE as SENSOR
from data.inputs import UNLABELLED, Increments, Inputs, IntArray, LandmarkMap, Observations, Scans
from data.log import Log
from data.motion.motion_prior import MotionPrior, note_of
from data.motion.velocity import VelocityModel, floor_covariances, preintegrate
from data.se2 import Array
from data.sensors import RangeBearing
from data.terminal import counted
from data.timeline import MAX_GAP, frame_times, truth_at
from data.truth import CLUTTER, UNKNOWN_ID, Relations, Truth

RELATIVE = ("x", "y", "theta")
STAMPS = ("stamp1", "stamp2")
EXACT = "exact"


def read_relations(path: Path, frames: int, frame_stamp: Array | None = None) -> Relations:
    """Relations between the frames of a log of so many; `frame_stamp` (N,): its recorded stamps."""
    table = read_table(path, ("row1", "row2", *RELATIVE), (EXACT, *STAMPS, *COVARIANCE))
    for name in ("row1", "row2"):
        table.integers(name, 0)
        there = table.columns[name] < frames
        table.require(there, name, f"{{}} is not a row of the log; it has frames 0 to {frames - 1}")
    table.require_finite(RELATIVE)
    exact = stamp = None
    if EXACT in table:
        values = table.columns[EXACT]
        table.require((values == 0.0) | (values == 1.0), EXACT, "{} is neither 0 nor 1")
        exact = values.astype(np.int64)
    for names in (STAMPS, COVARIANCE):
        missing = [name for name in names if name not in table]
        if 0 < len(missing) < len(names):
            together = "stamp1 and stamp2" if names == STAMPS else ",".join(names)
            raise table.error(-1, missing[0], f"no such column; {together} come together")
    if STAMPS[0] in table:
        table.require_finite(STAMPS)
        stamp = table.stack(STAMPS)
    covariance = None
    if COVARIANCE[0] in table:
        table.require_finite(COVARIANCE)
        covariance = table.symmetric(COVARIANCE)
        _require_semidefinite(table, covariance)
    row1, row2 = (table.columns[name].astype(np.int64) for name in ("row1", "row2"))
    return Relations(row1, row2, table.stack(RELATIVE), exact, stamp, frame_stamp, covariance)


def relations_columns(relations: Relations) -> tuple[list[str], list[list[object]]]:
    """Names of the columns, and the rows, as `read_relations` reads them."""
    r = relations
    columns = {
        "row1": r.row1.tolist(),
        "row2": r.row2.tolist(),
        **dict(zip(RELATIVE, r.relative.T.tolist(), strict=True)),
    }
    if r.exact is not None:
        columns[EXACT] = r.exact.tolist()
    if r.stamp is not None:
        columns |= dict(zip(STAMPS, r.stamp.T.tolist(), strict=True))
    if r.covariance is not None:
        upper = np.triu_indices(3)
        columns |= dict(zip(COVARIANCE, r.covariance[:, upper[0], upper[1]].T.tolist(), strict=True))
    return list(columns), [list(row) for row in zip(*columns.values(), strict=True)]


HEADER = "log.toml"
FRAMES, ODOMETRY, OBSERVATIONS = "frames.csv", "odometry.csv", "observations.csv"
TRUTH, LANDMARKS = "truth.csv", landmarks_file.FILE
SCANS, RELATIONS = "scans.npz", "relations.csv"
FIXES, CLOSURES = fixes_file.FILE, closures_file.FILE
FILES = (HEADER, FRAMES, ODOMETRY, OBSERVATIONS, TRUTH, LANDMARKS, SCANS, RELATIONS, FIXES, CLOSURES)

MEAN = ("dx", "dy", "dtheta")
STAMP = "stamp"
IDS = ("true_id", "label")

LONGEST = 1e6
"""s, longest odometry log; keyframes up to a broken stamp would fill the memory."""


def load_folder(path: str | PathLike[str], relations: Path | None = None) -> Log:
    """Read an open log folder; `relations`: a file instead of its relations.csv.

    Observations outside the sensor's stated field of view are kept. The covariance floor is applied here.

    Raises DataError with file, line, column and value.
    """
    folder = Path(path)
    if not os.path.isdir(folder):  # unlike Path.is_dir, also false for a name the system refuses
        raise DataError.at(folder, "not a folder" if os.path.exists(folder) else "no such folder")
    header = read_header(folder / HEADER)
    by_stamp = (folder / ODOMETRY).exists()
    if (folder / FRAMES).exists() == by_stamp:
        if by_stamp:
            raise DataError.at(folder / ODOMETRY, f"there is {FRAMES} as well; remove one of them")
        raise DataError.at(folder / FRAMES, f"no such file; {FRAMES} or {ODOMETRY} is needed")
    if by_stamp:
        if header.motion_prior is not None:
            raise DataError.at(folder / ODOMETRY, f"{HEADER} states a [motion] prior instead; remove one of them")
        if header.motion is None:
            raise DataError.at(folder / HEADER, f"no [motion] table; {ODOMETRY} needs one")
    key = "t" if by_stamp else "frame"
    measured = _measured(folder, header, key)
    observations = _observations(folder / OBSERVATIONS, header, key, measured)
    if by_stamp:
        assert header.motion is not None
        samples = read_table(folder / ODOMETRY, ("t", "v", "omega"))
        motion, gaps = odometry_of(samples, header.motion, instants(observations.table, measured))
        pose = stamped_truth(_truth_table(folder / TRUTH, ("t", *POSE)), motion.time)
    else:
        motion, gaps = _frames(folder / FRAMES, header.motion_prior), 0
        pose = truth_per_frame(_truth_table(folder / TRUTH, POSE), len(motion.time))
    frame = frames_in(observations.table, key, motion.time)
    stated, true_landmarks = read_landmarks(folder / LANDMARKS, latest=header.format == LATEST)
    known, unusable = usable_sigmas(stated, header)
    scans = _scans(folder, header, len(motion.time), by_stamp=by_stamp)
    reference = folder / RELATIONS if relations is None else relations
    related = None
    if relations is not None or reference.exists():
        related = read_relations(reference, len(motion.time), motion.stamp)
    inputs = inputs_of(header, motion, frame, observations, known)
    recorded, inliers = with_measured(inputs, measured, key)
    notes = list(header.notes) + ([note_of(header.motion_prior)] if header.motion_prior is not None else [])
    for name, part in ((OBSERVATIONS, observations), (FIXES, measured.fixes), (CLOSURES, measured.closures)):
        if part is not None:
            notes += [f"{name}: unknown column {column!r} ignored" for column in part.table.unknown]
    if gaps:
        many = counted(gaps, "gap")
        notes.append(f"{ODOMETRY}: {many} longer than {MAX_GAP:g} s, where the robot may have moved unseen")
    notes += unusable
    return Log(
        name=header.name,
        recorded=replace(recorded, scans=scans),
        truth=Truth(
            pose,
            recorded.map if true_landmarks is stated else true_landmarks,
            observations.true_id,
            related,
            fix_inlier=inliers[0],
            closure_inlier=inliers[1],
        ),
        label=observations.label,
        labels_are_sensed=header.labels_are_sensed,
        source=header.source,
        notes=tuple(notes),
    )


def inputs_of(
    header: Header, motion: Motion, frame: IntArray, observations: FrameTable, landmarks: LandmarkMap | None
) -> Inputs:
    """What estimators get; the covariance floor is applied."""
    seen, known = looks.together(observations.appearance, None if landmarks is None else landmarks.appearance)
    if landmarks is not None and known is not None:
        landmarks = replace(landmarks, appearance=known)
    covariance, floored = floor_covariances(motion.increments.covariance, header.covariance_floor)
    return Inputs(
        prior=header.prior,
        time=motion.time,
        increments=Increments(motion.increments.mean, covariance),
        observations=Observations(frame, observations.z, observations.R, sensor=observations.sensor, appearance=seen),
        sensor=header.sensors[0].sensor if header.sensors else RangeBearing(),
        sensors=tuple(s.sensor for s in header.sensors) if len(header.sensors) > 1 else (),
        map=landmarks,
        time_is_index=header.time_is_index,
        covariance_floor=header.covariance_floor,
        floored=header.floored + floored,
    )


class Motion(NamedTuple):
    """Time (N,), increments, and recorded stamps (N,) of the frames."""

    time: Array
    increments: Increments
    stamp: Array | None = None


class Measured(NamedTuple):
    """Fixes and closures without frames; None: there are none."""

    fixes: FixTable | None = None
    closures: ClosureTable | None = None

    def __bool__(self) -> bool:
        return self.fixes is not None or self.closures is not None


def _measured(folder: Path, header: Header, key: str) -> Measured:
    """fixes.csv and closures.csv, checked except for range and order of `key` (frame or t)."""
    for name, table, sources in (
        (FIXES, fixes_file.TABLE, header.fixes),
        (CLOSURES, closures_file.TABLE, header.closures),
    ):
        there = (folder / name).exists()
        if there and header.format == FORMAT:
            what = f"in a folder of format {header.format}; format = {LATEST} in {HEADER} is needed"
            raise DataError.at(folder / name, what)
        if sources and not there:
            raise DataError.at(folder / name, f"no such file; [[{table}]] of {HEADER} needs it")
    return Measured(
        read_fixes(folder / FIXES, header.fixes, key) if (folder / FIXES).exists() else None,
        read_closures(folder / CLOSURES, header.closures, key) if (folder / CLOSURES).exists() else None,
    )


def instants(observations: Table, measured: Measured) -> list[tuple[Table, str]]:
    """Tables and their columns of stamps, whose instants are frames of a log with odometry.csv."""
    found = [(observations, "t")]
    if measured.fixes is not None:
        found.append((measured.fixes.table, "t"))
    if measured.closures is not None:
        found += [(measured.closures.table, end) for end in measured.closures.ends]
    return found


def with_measured(
    inputs: Inputs, measured: Measured, key: str
) -> tuple[Inputs, tuple[IntArray | None, IntArray | None]]:
    """The inputs with fixes and closures, and the true inliers of both."""
    fixes, closures, time = measured.fixes, measured.closures, inputs.time
    inlier = None
    if fixes is not None:
        inputs = replace(inputs, fixes=fixes.at(frames_in(fixes.table, key, time)))
    if closures is not None:
        end1, end2 = (frames_in(closures.table, end, time, by_stamp=key == "t") for end in closures.ends)
        between, inlier = closures.between(end1, end2)
        inputs = replace(inputs, closures=between)
    return inputs, (None if fixes is None else fixes.inlier, inlier)


class FrameTable(NamedTuple):
    """Observations without frames: z (M, 2), R (M, 2, 2), row of the sensor, true_id, label and appearance (M,) or
    None.
    """

    table: Table
    z: Array
    R: Array
    sensor: IntArray | None
    true_id: IntArray | None
    label: IntArray | None
    appearance: Appearance | None = None

    def by_sensor(self, sensor: IntArray, key: str) -> FrameTable:
        """Sorted by sensor (M,) within each frame; DataError unless `key` ascends."""
        self.table.require_ascending(key, strictly=False)
        by = np.lexsort((sensor, self.table.columns[key]))
        line = by + FIRST_ROW if self.table.line is None else self.table.line[by]
        return FrameTable(
            replace(self.table.part(by), line=line),
            self.z[by],
            self.R[by],
            sensor[by],
            None if self.true_id is None else self.true_id[by],
            None if self.label is None else self.label[by],
            None if self.appearance is None else self.appearance.only(by),
        )


def _require_semidefinite(table: Table, matrices: Array) -> None:
    """Raise unless each covariance (K, 3, 3) is positive semidefinite, to 1e-12 of its trace."""
    eigenvalues = np.linalg.eigvalsh(matrices)
    fine = eigenvalues[:, 0] >= -1e-12 * eigenvalues.sum(axis=1)
    if not fine.all():
        row = int(np.argmin(fine))
        low, trace = eigenvalues[row, 0], eigenvalues[row].sum()
        what = f"the covariance is not positive semidefinite: smallest eigenvalue {low:.6g}, trace {trace:.6g}"
        raise table.error(row, f"{COVARIANCE[0]} to {COVARIANCE[-1]}", what)


def _frames(path: Path, prior: MotionPrior | None) -> Motion:
    """frames.csv: time (N,) and increments, or those of a motion prior."""
    motion = (*MEAN, *COVARIANCE)
    columns = ("t", *motion) if prior is None else ("t",)
    return frames_of(read_table(path, columns, (*motion, STAMP)), prior)


def frames_of(table: Table, prior: MotionPrior | None = None) -> Motion:
    """Time (N,) and increments of a table with the columns of frames.csv, or those of a motion prior."""
    path, motion = table.path, (*MEAN, *COVARIANCE)
    columns = ("t", *motion) if prior is None else ("t",)
    if len(table) == 0:
        raise DataError.at(path, "no rows; at least one frame is needed", line=1)
    table.require_finite([name for name in (*columns, STAMP) if name in table])
    stamp = table.columns.get(STAMP)
    table.require_ascending("t", strictly=True)
    if prior is not None:
        for name in motion:
            if name in table:
                what = f"[motion] prior in {HEADER} states the increments; remove one of them"
                raise DataError.at(path, what, line=1, column=name)
        return Motion(table.columns["t"], prior.increments(table.columns["t"]), stamp)
    later = np.arange(len(table)) > 0
    for name in motion:
        what = "{} in row 0; the first frame has no motion, so 0 is needed"
        table.require((table.columns[name] == 0.0) | later, name, what)
    covariance = table.symmetric(COVARIANCE)
    _require_semidefinite(table, covariance)
    return Motion(table.columns["t"], Increments(table.stack(MEAN), covariance), stamp)


def _observations(path: Path, header: Header, key: str, measured: Measured) -> FrameTable:
    """observations.csv, checked except for range and order of `key` (frame or t)."""
    if not header.sensors and (path.exists() or not measured):
        needed = f"{OBSERVATIONS} needs one" if path.exists() else f"one, {FIXES} or {CLOSURES} is needed"
        raise DataError.at(path.with_name(HEADER), f"no [sensor] table; {needed}")
    if (header.scanner is not None or measured) and not path.exists():
        nothing = Table(path, dict.fromkeys((key, "z1", "z2"), np.zeros(0)))
        which = np.zeros(0, np.int64) if len(header.sensors) > 1 else None
        return FrameTable(nothing, np.zeros((0, 2)), np.zeros((0, 2, 2)), which, None, None)
    other = "t" if key == "frame" else "frame"
    second = ("z2",) if any(s.sensor.locates for s in header.sensors) else ()
    blank = may_be_blank(header.sensors)
    more = (*looks.NUMBERS, looks.CLASS) if header.format == LATEST else ()
    optional = (*NOISE, *IDS, other, *more, *(("z2", SENSOR) if blank else ()))
    may = (*IDS, other, *looks.NUMBERS, *blank)
    table = read_table(path, (key, "z1", *second), optional, may_be_blank=may, words=(SENSOR, looks.CLASS))
    return observations_of(table, header, key)


def observations_of(table: Table, header: Header, key: str) -> FrameTable:
    """Observations of a table with the columns of observations.csv, checked except for range and order of `key`."""
    table.require_finite((key,))
    table.require_finite([n for n in IDS if n in table], blank=True)
    z, R, sensor = observed(table, header.sensors)
    found = FrameTable(
        table,
        z,
        R,
        sensor,
        table.integers("true_id", CLUTTER, blank=UNKNOWN_ID) if "true_id" in table else None,
        table.integers("label", CLUTTER, blank=UNLABELLED) if "label" in table else None,
        looks.of_observations(table, sensor, [(s.sensor.label, s.looks) for s in header.sensors]),
    )
    return found if sensor is None else found.by_sensor(sensor, key)


def _scans(folder: Path, header: Header, frames: int, *, by_stamp: bool) -> Scans | None:
    """scans.npz, which needs [scanner] and frames.csv."""
    path = folder / SCANS
    if header.scanner is None:
        if path.exists():
            raise DataError.at(folder / HEADER, f"no [scanner] table; {SCANS} needs one")
        return None
    if by_stamp:
        raise DataError.at(path, f"scans belong to frames; {FRAMES} is needed instead of {ODOMETRY}")
    return read_scans(path, header.scanner, frames)


def frames_in(table: Table, key: str, time: Array, *, by_stamp: bool | None = None) -> IntArray:
    """The frame (K,) of each row by a column: frame numbers or, of t, stamps among `time` (N,).

    `by_stamp`: that of an end of closures, which need not ascend.
    """
    if by_stamp or (by_stamp is None and key == "t"):
        return np.searchsorted(time, table.columns[key]).astype(np.int64)
    frame = table.integers(key, 0)
    table.require(frame < len(time), key, f"{{}} is out of range; there are frames 0 to {len(time) - 1}")
    if by_stamp is None:
        table.require_ascending(key, strictly=False)
    return frame


def odometry_of(table: Table, model: VelocityModel, seen: Sequence[tuple[Table, str]]) -> tuple[Motion, int]:
    """Odometry t, v, omega preintegrated between the frames, the stamps of other tables among them; number of gaps."""
    if len(table) == 0:
        raise DataError.at(table.path, "no rows; at least one sample is needed", line=1)
    table.require_finite(("t", "v", "omega"))
    table.require_ascending("t", strictly=True)
    for part, key in seen:
        if key == "t":
            part.require_ascending("t", strictly=False)
    stamps = table.columns["t"]
    far = f"{{}} s is more than {LONGEST:g} s from the first odometry; stamps are in seconds"
    for part, key in ((table, "t"), *seen):
        part.require(np.abs(part.columns[key] - stamps[0]) <= LONGEST, key, far)
    at = np.concatenate([part.columns[key] for part, key in seen])
    both = np.concatenate([stamps, at])
    time = frame_times(at, both.min(), both.max())
    increments, gaps = preintegrate(model, stamps, table.columns["v"], table.columns["omega"], time)
    return Motion(time, increments), gaps


def _truth_table(path: Path, columns: tuple[str, ...]) -> Table | None:
    if not path.exists():
        return None
    table = read_table(path, columns, may_be_blank=POSE)
    table.require_finite(POSE, blank=True)
    return table


def truth_per_frame(table: Table | None, frames: int) -> Array | None:
    """True poses (N, 3) of each frame, NaN where unknown."""
    if table is None:
        return None
    if len(table) != frames:
        what = f"{len(table)} rows for {frames} frames; one row per frame is needed"
        raise table.error(min(len(table), frames + 1) - 1, None, what)
    return table.stack(POSE)


def stamped_truth(table: Table | None, at: Array) -> Array | None:
    """Stamped true poses interpolated at the frames; NaN where unknown."""
    if table is None:
        return None
    table.require_finite(("t",))
    table.require_ascending("t", strictly=True)
    return truth_at(table.columns["t"], table.stack(POSE), at)
