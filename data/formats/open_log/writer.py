"""Write a log as an open log folder, format 1 or, with fixes or closures, 2; every number loads again bit for bit."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from data.columns import appearance as looks
from data.columns import poses
from data.columns import sensors as sensors_file
from data.columns.header import FORMAT, HEADER, LATEST
from data.columns.named import COVARIANCE, UPPER, or_blank
from data.columns.parts import (
    CLOSURES,
    FIXES,
    FRAMES,
    IDS,
    KIND,
    LANDMARKS,
    OBSERVATIONS,
    ODOMETRY,
    SIGMAS,
    STAMP,
    TRUE_PLACE,
    TRUTH,
    VELOCITIES,
)
from data.columns.poses import ENDS, POSE, RELATIVE, by_name
from data.columns.scans import scans_content
from data.errors import DataError
from data.formats.open_log.reader import FILES, RELATIONS, SCANS, load_folder, relations_to_write
from data.inputs import LandmarkMap
from data.log import Log
from data.motion.velocity import WITH_ALPHAS, VelocityModel
from data.se2 import Array
from data.whole import whole_folder

Table = dict[str, Sequence[Any]]
"""Columns by name."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Velocities as recorded, from which a log's increments were preintegrated.

    Attributes:
        time, velocity: (K,) s, (K, 2) m/s and rad/s.
        model: of the increments.
        truth: stamps [s] and poses (L, 3) of the truth as recorded, NaN where unknown; None: none.
    """

    time: Array
    velocity: Array
    model: VelocityModel
    truth: tuple[Array, Array] | None


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
    other = [name for name in inside if name not in FILES]
    if other:
        raise DataError.at(target, f"holds {other[0]!r}, which is no part of a log; move it or name another folder")


def contents(log: Log, name: str, samples: Samples | None = None) -> dict[str, str]:
    """Contents by file name, except scans, of a log under a name."""
    inputs, truth = log.recorded, log.truth
    observations, fixes, closures = inputs.observations, inputs.fixes, inputs.closures
    tables: dict[str, Table] = {}
    if truth.relations is not None:
        tables[RELATIONS] = relations_to_write(truth.relations)
    at: list[Any]
    if samples is None:
        key, at = "frame", list(range(len(inputs)))
        tables[FRAMES] = {"t": inputs.time.tolist(), **by_name(RELATIVE, inputs.increments.mean)}
        tables[FRAMES] |= by_name(COVARIANCE, inputs.increments.covariance[:, *UPPER])
        if truth.relations is not None and truth.relations.frame_stamp is not None:
            tables[FRAMES][STAMP] = truth.relations.frame_stamp.tolist()
    else:
        key, at = "t", inputs.time.tolist()
        tables[ODOMETRY] = {"t": samples.time.tolist(), **by_name(VELOCITIES, samples.velocity)}
    ids = {"true_id": truth.landmark_of, "label": log.label}
    given = [values for values in ids.values() if values is not None]
    if given or len(observations.frame) or (inputs.scans is None and fixes is None and closures is None):
        sensors = inputs.sensors or (inputs.sensor,)
        seen: Table = {key: [at[k] for k in observations.frame.tolist()]}
        seen |= sensors_file.columns_of(sensors, observations.z, observations.R, observations.sensor)
        seen |= {} if observations.appearance is None else looks.columns_of(observations.appearance)
        for column, values in ids.items():
            if values is not None:
                seen[column] = or_blank(values, values != IDS[column])
        tables[OBSERVATIONS] = seen
    if fixes is not None:
        tables[FIXES] = {key: [at[k] for k in fixes.frame.tolist()], **poses.fixes_to_write(fixes, truth.fix_inlier)}
    if closures is not None:
        ends = ([at[k] for k in frame.tolist()] for frame in (closures.frame1, closures.frame2))
        measured = poses.closures_to_write(closures, truth.closure_inlier)
        tables[CLOSURES] = {**dict(zip(ENDS[key], ends, strict=True)), **measured}
    if samples is not None and samples.truth is not None:
        tables[TRUTH] = {"t": samples.truth[0].tolist(), **by_name(POSE, samples.truth[1])}
    elif truth.pose is not None:
        tables[TRUTH] = by_name(POSE, truth.pose)
    landmarks = _landmarks(log)
    if landmarks is not None:
        places: Table = {"id": landmarks.id.tolist(), **by_name(("x", "y"), landmarks.xy.reshape(-1, 2))}
        places |= {} if landmarks.sigma is None else by_name(SIGMAS, landmarks.sigma)
        if (true := truth.landmarks) is not None and not _same(landmarks, true):
            there = true.positions(landmarks.id).T
            places |= dict(zip(TRUE_PLACE, or_blank(there, np.isfinite(there)), strict=True))
        places |= {} if landmarks.kind is None else {KIND: landmarks.kind}
        places |= {} if landmarks.appearance is None else looks.columns_of(landmarks.appearance, known=True)
        tables[LANDMARKS] = places
    files = {HEADER: tomli_w.dumps(_header(log, name, samples))}
    return files | {file: _csv(table) for file, table in tables.items()}


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
    return np.array_equal(known.id, true.id) and np.array_equal(known.xy, true.xy)


def _is_latest(log: Log) -> bool:
    """Whether a log has parts that format 1 has not."""
    inputs, sensor, known = log.recorded, log.recorded.sensor, _landmarks(log)
    named = bool(sensor.label or sensor.sees) or (known is not None and known.kind is not None)
    measured = inputs.fixes is not None or inputs.closures is not None
    described = inputs.observations.appearance is not None or (known is not None and known.appearance is not None)
    return measured or named or described or bool(inputs.sensors) or not sensor.locates


def _header(log: Log, name: str, samples: Samples | None) -> dict[str, Any]:
    """Contents of log.toml."""
    inputs = log.recorded
    plain: dict[str, object] = {
        "format": LATEST if _is_latest(log) else FORMAT,
        "name": name,
        "time_is_index": inputs.time_is_index,
        "covariance_floor": inputs.covariance_floor,
        "floored": inputs.floored,
        "labels_are_sensed": log.labels_are_sensed,
        "notes": log.notes,
        "prior": {"mean": inputs.prior.mean, "covariance": inputs.prior.covariance},
        "sensor": [sensors_file.table_of(s) for s in inputs.sensors] or sensors_file.table_of(inputs.sensor),
        "source": log.source,
    }
    plain |= {"origin": log.origins} if log.origins else {}
    if inputs.scans is not None:
        plain["scanner"] = asdict(inputs.scans.scanner)
    plain |= poses.tables_to_write(inputs.fixes, inputs.closures)
    if samples is not None:
        noise = samples.model.noise
        numbers = {"alphas": noise.alphas} if noise.kind in WITH_ALPHAS else {"sigma": noise.sigma}
        # loading floors anew
        plain |= {"motion": {"model": samples.model.model, "noise": noise.kind, **numbers}, "floored": 0}
    return {key: _plain(value) for key, value in plain.items()}


def _csv(table: Table) -> str:
    """Header and rows; floats by `repr`, the shortest text that reads back as the same bits."""
    rows = zip(*table.values(), strict=True)
    lines = [",".join(table), *(",".join([v if isinstance(v, str) else repr(v) for v in row]) for row in rows)]
    return "\n".join(lines) + "\n"


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
