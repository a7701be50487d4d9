"""A log from arrays in memory, checked as a log folder is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from data.columns import appearance as looks
from data.columns import closures as closures_file
from data.columns import fixes as fixes_file
from data.columns.closures import closures_of
from data.columns.fixes import POSE, fixes_of
from data.columns.header import FORMAT, LATEST, header_of
from data.columns.landmarks import KIND, SIGMAS, landmarks_of, usable_sigmas
from data.columns.named import COVARIANCE, INLIER, SOURCE
from data.columns.parts import (
    IDS,
    MEAN,
    PoseTables,
    frames_in,
    frames_of,
    inputs_of,
    instants,
    observations_of,
    odometry_of,
    stamped_truth,
    truth_per_frame,
    with_measured,
)
from data.columns.sensors import FIRST, NOISE
from data.columns.sensors import TABLE as SENSOR
from data.csv_table import Table
from data.errors import DataError, unknown
from data.inputs import Inputs, IntArray
from data.se2 import Array
from data.truth import Truth

UPPER = np.triu_indices(3)
SOURCES = "sources"
"""Key of fixes and closures: the tables [[fix]], [[closure]] of log.toml."""


class Parts(NamedTuple):
    """Inputs, truth, labels (M,) or None, and notes of a log."""

    recorded: Inputs
    truth: Truth
    label: IntArray | None
    labels_are_sensed: bool
    notes: tuple[str, ...]


def parts_of_arrays(
    name: str,
    prior: tuple[ArrayLike, ArrayLike],
    sensor: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    observations: ArrayLike,
    *,
    increments: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
    time: ArrayLike | None = None,
    odometry: ArrayLike | None = None,
    motion: Mapping[str, Any] | None = None,
    R: ArrayLike | None = None,
    landmarks: ArrayLike | None = None,
    truth: ArrayLike | None = None,
    true_id: ArrayLike | None = None,
    label: ArrayLike | None = None,
    labels_are_sensed: bool = False,
    observed_by: ArrayLike | None = None,
    kinds: ArrayLike | None = None,
    descriptor: ArrayLike | None = None,
    classes: ArrayLike | None = None,
    landmark_descriptor: ArrayLike | None = None,
    landmark_classes: ArrayLike | None = None,
    fixes: Mapping[str, Any] | None = None,
    closures: Mapping[str, Any] | None = None,
) -> Parts:
    """See `data.log.Log.from_arrays`."""

    def fault(what: str) -> DataError:
        return DataError(f"{name}: {what}")

    def table(part: str, values: ArrayLike, columns: tuple[str, ...]) -> Table:
        return _table(f"{name}: {part}", values, columns)

    mean, spread = (np.asarray(p, float) for p in prior)
    stated = {"sigma" if spread.ndim == 1 else "covariance": spread.tolist(), "mean": mean.tolist()}
    parts = (fixes, closures, observed_by, kinds, descriptor, classes, landmark_descriptor, landmark_classes)
    latest = any(part is not None for part in parts) or not isinstance(sensor, Mapping) or _is_latest(sensor)
    tables: dict[str, Any] = {"format": LATEST if latest else FORMAT, "name": name, "prior": stated}
    tables["sensor"] = _plain(sensor) if isinstance(sensor, Mapping) else [_plain(each) for each in sensor]
    tables |= {"labels_are_sensed": labels_are_sensed, "time_is_index": increments is not None and time is None}
    if motion is not None:
        tables["motion"] = _plain(motion)
    for kind, part in ((fixes_file.TABLE, fixes), (closures_file.TABLE, closures)):
        if part is not None and SOURCES in part:
            tables[kind] = [_plain(source) for source in part[SOURCES]]
    header = header_of(tables, fault)

    by_stamp = odometry is not None
    key = "t" if by_stamp else "frame"
    seen = table("observations", observations, (key, "z1", "z2"))
    extra = {n: np.asarray(v, float) for n, v in zip(IDS, (true_id, label), strict=True) if v is not None}
    if R is not None:
        extra |= dict(zip(NOISE, _covariances(f"{name}: R", R, len(seen), 2)[:, [0, 0, 1], [0, 1, 1]].T, strict=True))
    for column, values in extra.items():
        if values.shape != (len(seen),):
            raise fault(f"{column} has shape {values.shape}; ({len(seen)},) is needed, one for each observation")
    if descriptor is not None:
        extra[looks.DESCRIPTOR] = _numbers(f"{name}: descriptor", descriptor, len(seen))
    seen = _joined(seen, extra)
    for column, words in ((SENSOR, observed_by), (looks.CLASS, classes)):
        if words is not None:
            called = f"{name}: {'observed_by' if column == SENSOR else 'classes'}"
            seen = replace(seen, texts={**seen.texts, column: _words(called, words, len(seen))})
    found = observations_of(seen, header, key)
    fixed = closed = None
    if fixes is not None:
        known_columns = (key, *POSE, *COVARIANCE, INLIER)
        fixed = fixes_of(
            _columns(f"{name}: fixes", fixes, known_columns, (fixes_file.KIND, SOURCE), (key, fixes_file.KIND)),
            header.fixes,
            key,
        )
    if closures is not None:
        ends = closures_file.ENDS[key]
        needed = (*ends, *closures_file.RELATIVE)
        closed = closures_of(
            _columns(f"{name}: closures", closures, (*needed, *COVARIANCE, INLIER), (SOURCE,), needed),
            header.closures,
            key,
        )
    measured = PoseTables(fixed, closed)
    if (increments is None) == (odometry is None):
        raise fault("either increments or odometry is needed")
    if odometry is not None:
        if header.motion is None:
            raise fault('odometry needs motion, as in motion={"noise": "velocity", "sigma": [0.1, 0.05]}')
        samples = table("odometry", odometry, ("t", "v", "omega"))
        moved, _ = odometry_of(samples, header.motion, instants(seen, measured))
    else:
        assert increments is not None
        steps = table("increments", increments, MEAN)
        if covariance is None:
            raise fault("increments need a covariance: (N, 3, 3), (3, 3), or sigmas (3,)")
        P = _covariances(f"{name}: covariance", covariance, len(steps), 3)
        if np.ndim(covariance) < 3:  # one for all but the first frame, which has no motion
            P[0] = 0.0
        stamps = np.arange(len(steps), dtype=float) if time is None else np.asarray(time, float)
        if stamps.shape != (len(steps),):
            raise fault(f"time has shape {stamps.shape}; ({len(steps)},) is needed, one for each increment")
        columns = dict(zip(COVARIANCE, P[:, UPPER[0], UPPER[1]].T, strict=True))
        moved = frames_of(_joined(steps, {"t": stamps, **columns}))
    frame = frames_in(seen, key, moved.time)
    pose = None
    if truth is not None:
        true = table("truth", truth, ("t", *POSE) if by_stamp else POSE)
        true.require_finite(POSE, blank=True)
        pose = stamped_truth(true, moved.time) if by_stamp else truth_per_frame(true, len(moved.time))
    known, notes = None, list[str]()
    if landmarks is not None:
        wide = np.ndim(landmarks) == 2 and np.shape(landmarks)[1] == 3 + len(SIGMAS)
        places = table("landmarks", landmarks, ("id", "x", "y", *(SIGMAS if wide else ())))
        if landmark_descriptor is not None:
            given = _numbers(f"{name}: landmark_descriptor", landmark_descriptor, len(places))
            places = _joined(places, {looks.DESCRIPTOR: given})
        for column, called, words in (
            (KIND, "kinds", kinds),
            (looks.CLASS, "landmark_classes", landmark_classes),
        ):
            if words is not None:
                there = _words(f"{name}: {called}", words, len(places))
                places = replace(places, texts={**places.texts, column: there})
        known = landmarks_of(places)[0]
        known, notes = usable_sigmas(known, header)
    recorded, inliers = with_measured(inputs_of(header, moved, frame, found, known), measured, key)
    reference = Truth(pose, recorded.map, found.true_id, fix_inlier=inliers[0], closure_inlier=inliers[1])
    return Parts(recorded, reference, found.label, labels_are_sensed, tuple(notes))


def _plain(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a log.toml, arrays as lists."""
    return {k: np.asarray(v).tolist() if isinstance(v, (np.ndarray, tuple)) else v for k, v in table.items()}


def _table(place: str, values: ArrayLike, columns: tuple[str, ...]) -> Table:
    """Columns of an array (K, columns); errors name its rows from 0."""
    array = np.asarray(values, float)
    if not array.size:
        array = array.reshape(0, len(columns))
    if array.ndim != 2 or array.shape[1] != len(columns):
        raise DataError(f"{place}: shape {array.shape}; (rows, {len(columns)}) is needed: {', '.join(columns)}")
    return Table(place, dict(zip(columns, array.T, strict=True)), line=np.arange(len(array)))


def _columns(
    place: str, values: Mapping[str, Any], numbers: tuple[str, ...], words: tuple[str, ...], needed: tuple[str, ...]
) -> Table:
    """Columns (K,) by name; one value stands for all rows."""
    for key in values:
        if key not in (*numbers, *words, SOURCES):
            raise DataError(f"{place}: {key!r} is {unknown(key, (*numbers, *words, SOURCES))}")
    for key in needed:
        if key not in values:
            raise DataError(f"{place}: no {key}; {', '.join(needed)} are needed")
    length = len(np.atleast_1d(np.asarray(values[needed[0]])))
    columns: dict[str, Array] = {}
    texts: dict[str, list[str]] = {}
    for key, given in values.items():
        if key == SOURCES:
            continue
        array = np.asarray(given, str if key in words else float)
        if array.shape not in ((), (length,)):
            raise DataError(f"{place}: {key} has shape {array.shape}; ({length},) is needed, one for each row")
        if key in words:
            texts[key] = np.broadcast_to(array, length).tolist()
        else:
            columns[key] = np.array(np.broadcast_to(array, length))
    return Table(place, columns, line=np.arange(length), texts=texts)


def _is_latest(sensor: Mapping[str, Any]) -> bool:
    """Whether a sensor is of format 2 alone."""
    return any(key in sensor for key in ("name", "sees", *looks.KEYS)) or sensor.get("kind") not in (None, *FIRST)


def _words(place: str, values: ArrayLike, count: int) -> list[str]:
    words = np.asarray(values, str)
    if words.shape != (count,):
        raise DataError(f"{place} has shape {words.shape}; ({count},) is needed, one for each row")
    found: list[str] = words.tolist()
    return found


def _numbers(place: str, values: ArrayLike, count: int) -> Array:
    found = np.asarray(values, float)
    if found.shape != (count,):
        raise DataError(f"{place} has shape {found.shape}; ({count},) is needed, one for each row")
    return found


def _joined(table: Table, more: Mapping[str, Array]) -> Table:
    return Table(table.path, {**table.columns, **more}, line=table.line)


def _covariances(place: str, values: ArrayLike, n: int, d: int) -> Array:
    """Covariances (n, d, d) from as many, from one, or from sigmas (d,)."""
    array = np.asarray(values, float)
    if array.shape == (d,):
        array = np.diag(array**2)
    if array.shape not in ((d, d), (n, d, d)):
        raise DataError(f"{place}: shape {array.shape}; ({n}, {d}, {d}), ({d}, {d}) or sigmas ({d},) are needed")
    if not np.allclose(array, np.swapaxes(array, -1, -2), rtol=1e-9, atol=0.0, equal_nan=True):
        raise DataError(f"{place}: not symmetric")
    return np.array(np.broadcast_to(array, (n, d, d)))
