"""Open log folder (docs/log-folder.md): strict checks, and a writer whose numbers load again bit for bit."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import tomli_w

from data.columns import appearance as looks, parts, poses, sensors as sensors_file
from data.columns.header import FORMAT, HEADER, LATEST, Header, read_header
from data.columns.named import COVARIANCE, UPPER, or_blank, require_semidefinite
from data.columns.parts import CLOSURES, FIXES, FRAMES, LANDMARKS, OBSERVATIONS, ODOMETRY
from data.columns.poses import CLOSURE, ENDS, FIX, POSE, RELATIVE, by_name
from data.columns.scans import read_scans, scans_content
from data.csv_table import bytes_of, is_number, lines_of, read_table
from data.errors import DataError
from data.inputs import LandmarkMap
from data.log import Log
from data.motion.motion_prior import note_of
from data.motion.velocity import WITH_ALPHAS, VelocityModel
from data.notice import Code, Notice
from data.se2 import Array
from data.truth import Relations
from data.whole import whole_folder

ROWS, STAMPS, EXACT = ("row1", "row2"), ("stamp1", "stamp2"), "exact"
SCANS, RELATIONS = "scans.npz", "relations.csv"
FILES = (HEADER, FRAMES, ODOMETRY, OBSERVATIONS, parts.TRUTH, LANDMARKS, SCANS, RELATIONS, FIXES, CLOSURES)


def read_relations(path: Path, frames: int, frame_stamp: Array | None = None) -> Relations:
    """Relations between the frames of a log of so many; `frame_stamp` (N,): its recorded stamps.

    Also as the SLAM benchmark of Kuemmerle et al. (2009) publishes them, without a header: two stamps, then x y z roll
    pitch yaw. Rows are then those of the nearest stamps; of none within `NEAR` the relation is left out.
    """
    if (published := _published(path)) is not None:
        if frame_stamp is None:
            raise DataError.at(path, "relations by stamps; a log whose frames have recorded stamps is needed")
        order = np.argsort(frame_stamp, kind="stable")
        known = frame_stamp[order]
        after = np.clip(np.searchsorted(known, published[:, :2]), 1, max(len(known) - 1, 1))
        place = after - (published[:, :2] - known[after - 1] <= known[after] - published[:, :2])
        off = np.abs(known[place] - published[:, :2]).max(axis=1)
        near = off <= NEAR
        if not near.any():
            spans = [f"{a.min():.15g} to {a.max():.15g} s" for a in (published[:, :2], known)]
            raise DataError.at(path, f"stamps {spans[0]}, of the log {spans[1]}: no relation lies within it")
        rows = order[place[near]].astype(np.int64)
        found, exact = published[near], (off[near] <= SAME).astype(np.int64)
        return Relations(rows[:, 0], rows[:, 1], found[:, [2, 3, 7]], exact, found[:, :2], frame_stamp)
    table = read_table(path, (*ROWS, *POSE), (EXACT, *STAMPS, *COVARIANCE))
    row1, row2 = (table.integers(name, 0) for name in ROWS)
    for name, rows in zip(ROWS, (row1, row2), strict=True):
        table.require(rows < frames, name, f"{{}} is not a row of the log; it has frames 0 to {frames - 1}")
    table.require_finite(POSE)
    exact = stamp = covariance = None
    if EXACT in table:
        values = table.columns[EXACT]
        table.require((values == 0.0) | (values == 1.0), EXACT, "{} is neither 0 nor 1")
        exact = values.astype(np.int64)
    if table.together(STAMPS):
        table.require_finite(STAMPS)
        stamp = table.stack(STAMPS)
    if table.together(COVARIANCE):
        table.require_finite(COVARIANCE)
        covariance = table.symmetric(COVARIANCE)
        require_semidefinite(table, covariance)
    return Relations(row1, row2, table.stack(POSE), exact, stamp, frame_stamp, covariance)


NEAR, SAME = 0.1, 1e-6  # s, largest distance of a relation's stamps from those of its frames, and of one that is exact


def _published(path: Path) -> Array | None:
    """Rows (K, 8) of a file of numbers alone, eight a line; None: it is none."""
    fields = [line.split() for line in lines_of(bytes_of(path, missing="no such file")) if line.strip()]
    if not fields or any(len(f) != 8 or not all(map(is_number, f)) for f in fields):
        return None
    rows = np.array([list(map(float, f)) for f in fields])
    return rows if np.isfinite(rows).all() else None


def load_folder(path: str | PathLike[str], relations: Path | None = None) -> Log:
    """Read an open log folder; `relations`: a file instead of its relations.csv.

    Observations outside the sensor's stated field of view are kept. The covariance floor is applied here.

    Raises DataError with file, line, column and value.
    """
    folder = Path(path)
    if not os.path.isdir(folder):  # unlike Path.is_dir, also false for a name the system refuses
        raise DataError.at(folder, "not a folder" if os.path.exists(folder) else "no such folder")
    header = read_header(folder / HEADER)
    there = {name for name in FILES if (folder / name).exists()}
    _check(folder, header, there)
    columns = parts.columns_of(header, "t" if ODOMETRY in there else "frame")
    if not there & {FIXES, CLOSURES} and header.scanner is None:
        there.add(OBSERVATIONS)  # it is needed then
    tables = {name: read_table(folder / name, *of) for name, of in columns.items() if name in there}
    made = parts.parts_of(header, tables)
    scans = None if header.scanner is None else read_scans(folder / SCANS, header.scanner, len(made.recorded))
    truth, reference = made.truth, folder / RELATIONS if relations is None else relations
    if relations is not None or RELATIONS in there:
        stamp = tables[FRAMES].columns.get(parts.STAMP) if FRAMES in tables else None
        truth = replace(truth, relations=read_relations(reference, len(made.recorded), stamp))
    prior = () if header.motion_prior is None else (note_of(header.motion_prior),)
    source = dict(header.source)
    asked = [(q.pop("code", ""), q) for q in cast("dict[str, dict[str, Any]]", source.pop(ASKED, {})).values()]
    return Log(
        header.name, replace(made.recorded, scans=scans), truth, label=made.label, source=source,
        labels_are_sensed=header.labels_are_sensed, notes=(*header.notes, *prior, *made.notes), origins=header.origins,
        asked=tuple(Notice(code, tuple((k, tuple(v) if isinstance(v, list) else v) for k, v in sorted(q.items())))
                    for name, q in asked for code in Code if code == name),
    )  # fmt: skip


ASKED = "asked"  # table in [source] of the questions that only the recording raised


def _check(folder: Path, header: Header, there: set[str]) -> None:
    """DataError unless the files that are there, and the header, go together."""
    if ODOMETRY in there and FRAMES in there:
        raise DataError.at(folder / ODOMETRY, f"there is {FRAMES} as well; remove one of them")
    if ODOMETRY not in there and FRAMES not in there:
        raise DataError.at(folder / FRAMES, f"no such file; {FRAMES} or {ODOMETRY} is needed")
    if ODOMETRY in there and header.motion_prior is not None:
        raise DataError.at(folder / ODOMETRY, f"{HEADER} states a [motion] prior instead; remove one of them")
    if ODOMETRY in there and header.motion is None:
        raise DataError.at(folder / HEADER, f"no [motion] table; {ODOMETRY} needs one")
    for name, table, sources in ((FIXES, FIX, header.fixes), (CLOSURES, CLOSURE, header.closures)):
        if name in there and header.format == FORMAT:
            what = f"in a folder of format {header.format}; format = {LATEST} in {HEADER} is needed"
            raise DataError.at(folder / name, what)
        if sources and name not in there:
            raise DataError.at(folder / name, f"no such file; [[{table}]] of {HEADER} needs it")
    if not header.sensors and (OBSERVATIONS in there or not there & {FIXES, CLOSURES}):
        needed = f"{OBSERVATIONS} needs one" if OBSERVATIONS in there else f"one, {FIXES} or {CLOSURES} is needed"
        raise DataError.at(folder / HEADER, f"no [sensor] table; {needed}")
    if header.scanner is None and SCANS in there:
        raise DataError.at(folder / HEADER, f"no [scanner] table; {SCANS} needs one")
    if header.scanner is not None and ODOMETRY in there:
        raise DataError.at(folder / SCANS, f"scans belong to frames; {FRAMES} is needed instead of {ODOMETRY}")


Table = dict[str, Sequence[Any]]  # Columns by name


@dataclass(frozen=True, eq=False)
class Samples:
    """Velocities as recorded, from which a log's increments were preintegrated."""

    time: Array  # time, velocity: (K,) s, (K, 2) m/s and rad/s
    velocity: Array
    model: VelocityModel  # of the increments
    truth: tuple[Array, Array] | None  # stamps [s], poses (L, 3) of the truth as recorded, NaN where unknown; or None


class Recording(NamedTuple):
    """A log, and the samples to write instead of its increments; None: none."""

    log: Log
    samples: Samples | None = None


def write_folder(log: Log, path: str | PathLike[str], samples: Samples | None = None) -> Log:
    """Write `log` into the folder `path`, whose last component becomes the log's name; an older log there is replaced.

    Increments are written (frames.csv), with calibration, preintegration and covariance floor applied; with `samples`,
    these (odometry.csv). The folder is written beside its final name, read back as a check, and moved into place;
    returned is what was read. A log with true landmarks but without a map gets them as its map.

    Raises DataError if `path` holds something else, cannot be written, or the format cannot hold the log.
    """
    target = Path(os.path.abspath(path))
    _require_replaceable(target)
    try:
        with whole_folder(target) as partial:
            for name, text in contents(log, target.name, samples).items():
                (partial / name).write_text(text, encoding="utf-8", newline="")
            if log.recorded.scans is not None:
                (partial / SCANS).write_bytes(scans_content(log.recorded.scans))
            return load_folder(partial)
    except OSError as error:
        raise DataError.at(target, f"cannot be written: {error.strerror}") from error


def _require_replaceable(target: Path) -> None:
    """Raise unless `target` is free, an empty folder, or a log folder with nothing else in it."""
    if not target.exists() and not target.is_symlink():
        return
    if target.is_symlink() or not target.is_dir():
        raise DataError.at(target, "exists and is not a folder; name another one")
    inside = sorted(p.name for p in target.iterdir())
    if inside and HEADER not in inside:
        raise DataError.at(target, f"exists and is not a log folder (no {HEADER}); name another one")
    if other := [name for name in inside if name not in FILES]:
        raise DataError.at(target, f"holds {other[0]!r}, which is no part of a log; move it or name another folder")


def contents(log: Log, name: str, samples: Samples | None = None) -> dict[str, str]:
    """Contents by file name, except scans, of a log under a name."""
    inputs, truth = log.recorded, log.truth
    observations, fixes, closures = inputs.observations, inputs.fixes, inputs.closures
    tables: dict[str, Table] = {}
    if (r := truth.relations) is not None:  # as `read_relations` reads them
        tables[RELATIONS] = {"row1": r.row1.tolist(), "row2": r.row2.tolist()} | by_name(POSE, r.relative)
        tables[RELATIONS] |= {} if r.exact is None else {EXACT: r.exact.tolist()}
        tables[RELATIONS] |= {} if r.stamp is None else by_name(STAMPS, r.stamp)
        tables[RELATIONS] |= {} if r.covariance is None else by_name(COVARIANCE, r.covariance[:, *UPPER])
    at: list[Any]
    if samples is None:
        key, at = "frame", list(range(len(inputs)))
        tables[FRAMES] = {"t": inputs.time.tolist(), **by_name(RELATIVE, inputs.increments.mean)}
        tables[FRAMES] |= by_name(COVARIANCE, inputs.increments.covariance[:, *UPPER])
        if truth.relations is not None and truth.relations.frame_stamp is not None:
            tables[FRAMES][parts.STAMP] = truth.relations.frame_stamp.tolist()
    else:
        key, at = "t", inputs.time.tolist()
        tables[ODOMETRY] = {"t": samples.time.tolist(), **by_name(parts.VELOCITIES, samples.velocity)}
    ids = {"true_id": truth.landmark_of, "label": log.label}
    given = [values for values in ids.values() if values is not None]
    if given or len(observations.frame) or (inputs.scans is None and fixes is None and closures is None):
        sensors = inputs.sensors or (inputs.sensor,)
        seen: Table = {key: [at[k] for k in observations.frame.tolist()]}
        seen |= sensors_file.columns_of(sensors, observations.z, observations.R, observations.sensor)
        seen |= {} if observations.appearance is None else looks.columns_of(observations.appearance)
        for column, values in ids.items():
            if values is not None:
                seen[column] = or_blank(values, values != parts.IDS[column])
        tables[OBSERVATIONS] = seen
    if fixes is not None:
        tables[FIXES] = {key: [at[k] for k in fixes.frame.tolist()], **poses.fixes_to_write(fixes, truth.fix_inlier)}
    if closures is not None:
        ends = ([at[k] for k in frame.tolist()] for frame in (closures.frame1, closures.frame2))
        tables[CLOSURES] = dict(zip(ENDS[key], ends, strict=True)) | by_name(poses.RELATIVE, closures.relative)
        tables[CLOSURES] |= by_name(COVARIANCE, closures.covariance[:, *UPPER])
        if len(closures.sources) > 1:
            tables[CLOSURES] |= {poses.SOURCE: [closures.sources[k] for k in closures.source.tolist()]}
        tables[CLOSURES] |= poses.inliers_to_write(truth.closure_inlier)
    if samples is not None and samples.truth is not None:
        tables[parts.TRUTH] = {"t": samples.truth[0].tolist(), **by_name(POSE, samples.truth[1])}
    elif truth.pose is not None:
        tables[parts.TRUTH] = by_name(POSE, truth.pose)
    if (landmarks := _landmarks(log)) is not None:
        places: Table = {"id": landmarks.id.tolist(), **by_name(("x", "y"), landmarks.xy.reshape(-1, 2))}
        places |= {} if landmarks.sigma is None else by_name(parts.SIGMAS, landmarks.sigma)
        if (true := truth.landmarks) is not None and not _same(landmarks, true):
            there = true.positions(landmarks.id).T
            places |= dict(zip(parts.TRUE_PLACE, or_blank(there, np.isfinite(there)), strict=True))
        places |= {} if landmarks.kind is None else {parts.KIND: landmarks.kind}
        places |= {} if landmarks.appearance is None else looks.columns_of(landmarks.appearance, known=True)
        tables[LANDMARKS] = places
    files = {HEADER: tomli_w.dumps(_header(log, name, samples))}
    for file, table in tables.items():  # floats by `repr`, the shortest text that reads back as the same bits
        rows = zip(*table.values(), strict=True)
        lines = [",".join(table), *(",".join([v if isinstance(v, str) else repr(v) for v in row]) for row in rows)]
        files[file] = "\n".join(lines) + "\n"
    return files


def _landmarks(log: Log) -> LandmarkMap | None:
    """The map as the format can hold it: with the true landmarks beside those of the map."""
    known, true = log.recorded.map, log.truth.landmarks
    if known is None or true is None:
        return known if known is not None else true
    if not _same(known, true) and (known.rows(true.id) < 0).any():
        what = f"log {log.name!r}: its map lacks some of its true landmarks"
        raise DataError(f"{what}; {LANDMARKS} can hold only landmarks of the map")
    return known


def _same(known: LandmarkMap, true: LandmarkMap) -> bool:
    exact = (known.sigma is None) == (true.sigma is None)
    return exact and np.array_equal(known.id, true.id) and np.array_equal(known.xy, true.xy)


def _is_latest(log: Log) -> bool:
    """Whether a log has parts that format 1 has not."""
    inputs, sensor, known = log.recorded, log.recorded.sensor, _landmarks(log)
    named = bool(sensor.label or sensor.sees) or (known is not None and known.kind is not None)
    measured = inputs.fixes is not None or inputs.closures is not None
    described = inputs.observations.appearance is not None or (known is not None and known.appearance is not None)
    return measured or named or described or bool(inputs.sensors) or not sensor.locates


def _header(log: Log, name: str, samples: Samples | None) -> dict[str, Any]:
    inputs = log.recorded
    plain: dict[str, object] = {
        "format": LATEST if _is_latest(log) else FORMAT, "name": name, "time_is_index": inputs.time_is_index,
        "covariance_floor": inputs.covariance_floor, "floored": inputs.floored,
        "labels_are_sensed": log.labels_are_sensed, "notes": log.notes,
        "prior": {"mean": inputs.prior.mean, "covariance": inputs.prior.covariance},
        "sensor": [sensors_file.table_of(s) for s in inputs.sensors] or sensors_file.table_of(inputs.sensor),
        "source": log.source,
    }  # fmt: skip
    if log.asked:
        asked = {str(k): {"code": q.code.value, **q.named} for k, q in enumerate(log.asked)}
        plain["source"] = {**log.source, ASKED: asked}
    plain |= {"origin": log.origins} if log.origins else {}
    if inputs.scans is not None:
        plain["scanner"] = asdict(inputs.scans.scanner)
    if (fixes := inputs.fixes) is not None:  # covariances are in the files
        plain[poses.FIX] = [{"name": s.name, "lever": s.lever, "rotation": s.rotation} for s in fixes.sources]
    if inputs.closures is not None:
        plain[poses.CLOSURE] = [{"name": name} for name in inputs.closures.sources]
    if samples is not None:
        noise = samples.model.noise
        numbers = {"alphas": noise.alphas} if noise.kind in WITH_ALPHAS else {"sigma": noise.sigma}
        # loading floors anew
        plain |= {"motion": {"model": samples.model.model, "noise": noise.kind, **numbers}, "floored": 0}
    return {key: _plain(value) for key, value in plain.items()}


def _plain(value: object) -> object:
    """A value in TOML's types: None in a table is dropped, others (paths) become text."""
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return str(value)
