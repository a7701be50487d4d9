"""Write a log as an open log folder, format 1 or, with fixes or closures, 2; every number loads again bit for bit."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from data.columns import appearance as looks
from data.columns import closures as closures_file
from data.columns import fixes as fixes_file
from data.columns import sensors as sensors_file
from data.columns.fixes import POSE
from data.columns.header import FORMAT, HEADER, LATEST
from data.columns.landmarks import SIGMAS, TRUE_PLACE
from data.columns.named import COVARIANCE
from data.columns.parts import MEAN, STAMP
from data.columns.scans import scans_content
from data.errors import DataError
from data.formats.open_log.reader import (
    CLOSURES,
    FILES,
    FIXES,
    FRAMES,
    LANDMARKS,
    OBSERVATIONS,
    ODOMETRY,
    RELATIONS,
    SCANS,
    TRUTH,
    load_folder,
    relations_columns,
)
from data.inputs import UNLABELLED, IntArray, LandmarkMap
from data.log import Log
from data.motion.velocity import WITH_ALPHAS, VelocityModel
from data.se2 import Array
from data.truth import UNKNOWN_ID
from data.whole import whole_folder

VELOCITIES = ("v", "omega")


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
    observations = inputs.observations
    files = {HEADER: tomli_w.dumps(_header(log, name, samples))}
    if truth.relations is not None:
        files[RELATIONS] = _csv(*relations_columns(truth.relations))
    if samples is None:
        files[FRAMES] = _frames(log)
        columns: dict[str, Sequence[object]] = {"frame": observations.frame.tolist()}
    else:
        files[ODOMETRY] = _csv(("t", *VELOCITIES), np.column_stack([samples.time, samples.velocity]).tolist())
        columns = {"t": inputs.time[observations.frame].tolist()}
    sensors = inputs.sensors or (inputs.sensor,)
    columns |= sensors_file.columns_of(sensors, observations.z, observations.R, observations.sensor)
    if observations.appearance is not None:
        columns |= looks.columns_of(observations.appearance)
    if truth.landmark_of is not None:
        columns["true_id"] = _or_blank(truth.landmark_of, UNKNOWN_ID)
    if log.label is not None:
        columns["label"] = _or_blank(log.label, UNLABELLED)
    nothing_else = inputs.scans is None and inputs.fixes is None and inputs.closures is None
    if nothing_else or len(observations.frame) or truth.landmark_of is not None or log.label is not None:
        files[OBSERVATIONS] = _csv(columns, zip(*columns.values(), strict=True))
    key = "frame" if samples is None else "t"
    at = np.arange(len(inputs)) if samples is None else inputs.time
    if inputs.fixes is not None:
        when = at[inputs.fixes.frame].tolist()
        fixes = fixes_file.fixes_columns(inputs.fixes, truth.fix_inlier, key, when)
        files[FIXES] = _csv(fixes, zip(*fixes.values(), strict=True))
    if inputs.closures is not None:
        ends = at[inputs.closures.frame1].tolist(), at[inputs.closures.frame2].tolist()
        closures = closures_file.closures_columns(inputs.closures, truth.closure_inlier, key, ends)
        files[CLOSURES] = _csv(closures, zip(*closures.values(), strict=True))
    if samples is not None and samples.truth is not None:
        files[TRUTH] = _csv(("t", *POSE), np.column_stack(samples.truth).tolist())
    elif truth.pose is not None:
        files[TRUTH] = _csv(POSE, truth.pose.tolist())
    landmarks = _landmarks(log)
    if landmarks is not None:
        x, y = landmarks.xy.reshape(-1, 2).T.tolist()
        places: dict[str, Sequence[object]] = {"id": landmarks.id.tolist(), "x": x, "y": y}
        if landmarks.sigma is not None:
            places |= dict(zip(SIGMAS, landmarks.sigma.T.tolist(), strict=True))
        if (true := truth.landmarks) is not None and not _same(landmarks, true):
            at = true.positions(landmarks.id).T.tolist()
            places |= {n: ["" if math.isnan(v) else v for v in c] for n, c in zip(TRUE_PLACE, at, strict=True)}
        if landmarks.kind is not None:
            places["kind"] = landmarks.kind
        if landmarks.appearance is not None:
            places |= looks.columns_of(landmarks.appearance, known=True)
        files[LANDMARKS] = _csv(places, zip(*places.values(), strict=True))
    return files


def _frames(log: Log) -> str:
    """frames.csv."""
    increments, relations = log.recorded.increments, log.truth.relations
    upper = np.triu_indices(3)
    frames = np.column_stack([log.recorded.time, increments.mean, increments.covariance[:, upper[0], upper[1]]])
    frame_names = ["t", *MEAN, *COVARIANCE]
    if relations is not None and relations.frame_stamp is not None:
        frame_names.append(STAMP)
        frames = np.column_stack([frames, relations.frame_stamp])
    return _csv(frame_names, frames.tolist())


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
    if inputs.scans is not None:
        plain["scanner"] = asdict(inputs.scans.scanner)
    if inputs.fixes is not None:
        plain[fixes_file.TABLE] = fixes_file.tables_to_write(inputs.fixes)
    if inputs.closures is not None:
        plain[closures_file.TABLE] = closures_file.tables_to_write(inputs.closures)
    if samples is not None:
        noise = samples.model.noise
        numbers = {"alphas": noise.alphas} if noise.kind in WITH_ALPHAS else {"sigma": noise.sigma}
        # loading floors anew
        plain |= {"motion": {"model": samples.model.model, "noise": noise.kind, **numbers}, "floored": 0}
    return {key: _plain(value) for key, value in plain.items()}


def _or_blank(ids: IntArray, blank: int) -> list[object]:
    return ["" if i == blank else i for i in ids.tolist()]


def _csv(names: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Header and rows; floats by `repr`, the shortest text that reads back as the same bits."""
    lines = [",".join(names)]
    lines += [",".join([v if isinstance(v, str) else repr(v) for v in row]) for row in rows]
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
