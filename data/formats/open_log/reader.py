"""Open log folder, formats 1 and 2: reader with strict checks.

    log.toml            see `data.columns.header`; a motion prior there replaces increments and odometry
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
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from data.columns import appearance as looks
from data.columns import closures as closures_file
from data.columns import fixes as fixes_file
from data.columns import landmarks as landmarks_file
from data.columns.closures import read_closures
from data.columns.fixes import POSE, read_fixes
from data.columns.header import FORMAT, HEADER, LATEST, Header, read_header
from data.columns.landmarks import read_landmarks, usable_sigmas
from data.columns.named import COVARIANCE
from data.columns.parts import (
    IDS,
    MEAN,
    STAMP,
    FrameTable,
    Motion,
    PoseTables,
    frames_in,
    frames_of,
    inputs_of,
    instants,
    observations_of,
    odometry_of,
    require_semidefinite,
    stamped_truth,
    truth_per_frame,
    with_measured,
)
from data.columns.scans import read_scans
from data.columns.sensors import NOISE, may_be_blank
from data.columns.sensors import TABLE as SENSOR
from data.csv_table import Table, read_table
from data.errors import DataError
from data.inputs import Scans
from data.log import Log
from data.motion.motion_prior import MotionPrior, note_of
from data.se2 import Array
from data.terminal import counted
from data.timeline import MAX_GAP
from data.truth import Relations, Truth

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
        require_semidefinite(table, covariance)
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


FRAMES, ODOMETRY, OBSERVATIONS = "frames.csv", "odometry.csv", "observations.csv"
TRUTH, LANDMARKS = "truth.csv", landmarks_file.FILE
SCANS, RELATIONS = "scans.npz", "relations.csv"
FIXES, CLOSURES = fixes_file.FILE, closures_file.FILE
FILES = (HEADER, FRAMES, ODOMETRY, OBSERVATIONS, TRUTH, LANDMARKS, SCANS, RELATIONS, FIXES, CLOSURES)


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


def _measured(folder: Path, header: Header, key: str) -> PoseTables:
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
    return PoseTables(
        read_fixes(folder / FIXES, header.fixes, key) if (folder / FIXES).exists() else None,
        read_closures(folder / CLOSURES, header.closures, key) if (folder / CLOSURES).exists() else None,
    )


def _frames(path: Path, prior: MotionPrior | None) -> Motion:
    """frames.csv: time (N,) and increments, or those of a motion prior."""
    motion = (*MEAN, *COVARIANCE)
    columns = ("t", *motion) if prior is None else ("t",)
    return frames_of(read_table(path, columns, (*motion, STAMP)), prior)


def _observations(path: Path, header: Header, key: str, measured: PoseTables) -> FrameTable:
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


def _truth_table(path: Path, columns: tuple[str, ...]) -> Table | None:
    if not path.exists():
        return None
    table = read_table(path, columns, may_be_blank=POSE)
    table.require_finite(POSE, blank=True)
    return table
