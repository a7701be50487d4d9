"""A log from arrays in memory, checked as a log folder is."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from data.columns import appearance as looks
from data.columns import parts
from data.columns.header import FORMAT, LATEST, header_of
from data.columns.named import COVARIANCE, UPPER
from data.columns.poses import CLOSURE, FIX, POSE, RELATIVE, SOURCE
from data.columns.sensors import FIRST, NOISE, SENSOR
from data.csv_table import Columns, Table
from data.errors import DataError, unknown
from data.se2 import Array

MORE = (parts.OBSERVATIONS, parts.LANDMARKS)
COLUMNS = {
    "true_id": (parts.OBSERVATIONS, "true_id"), "label": (parts.OBSERVATIONS, "label"),
    "observed_by": (parts.OBSERVATIONS, SENSOR), "descriptor": (parts.OBSERVATIONS, looks.DESCRIPTOR),
    "classes": (parts.OBSERVATIONS, looks.CLASS), "kinds": (parts.LANDMARKS, parts.KIND),
    "landmark_descriptor": (parts.LANDMARKS, looks.DESCRIPTOR), "landmark_classes": (parts.LANDMARKS, looks.CLASS),
}  # fmt: skip
"""Arguments that are further columns of a table."""
WORDS = (SENSOR, parts.KIND, SOURCE, looks.CLASS)  # Columns of words
SOURCES = "sources"  # Key of fixes and closures: the tables [[fix]], [[closure]] of log.toml


def parts_of_arrays(
    name: str, prior: tuple[ArrayLike, ArrayLike], sensor: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    observations: ArrayLike, *, increments: ArrayLike | None = None, covariance: ArrayLike | None = None,
    time: ArrayLike | None = None, odometry: ArrayLike | None = None, motion: Mapping[str, Any] | None = None,
    R: ArrayLike | None = None, landmarks: ArrayLike | None = None, truth: ArrayLike | None = None,
    labels_are_sensed: bool = False, fixes: Mapping[str, Any] | None = None,
    closures: Mapping[str, Any] | None = None, **columns: ArrayLike | None,
) -> parts.Parts:  # fmt: skip
    """See `data.log.Log.from_arrays`; `columns`: of `COLUMNS`."""
    if other := columns.keys() - COLUMNS.keys():
        raise TypeError(f"{', '.join(sorted(other))}: {unknown(min(other), COLUMNS)}")

    def fault(what: str) -> DataError:
        return DataError(f"{name}: {what}")

    mean, spread = (np.asarray(p, float) for p in prior)
    stated = {"sigma" if spread.ndim == 1 else "covariance": spread.tolist(), "mean": mean.tolist()}
    more = [fixes, closures, *(columns.get(argument) for argument in COLUMNS if argument not in ("true_id", "label"))]
    latest = any(part is not None for part in more) or not isinstance(sensor, Mapping) or _is_latest(sensor)
    keys: dict[str, Any] = {"format": LATEST if latest else FORMAT, "name": name, "prior": stated}
    keys["sensor"] = _plain(sensor) if isinstance(sensor, Mapping) else [_plain(each) for each in sensor]
    keys |= {"labels_are_sensed": labels_are_sensed, "time_is_index": increments is not None and time is None}
    if motion is not None:
        keys["motion"] = _plain(motion)
    for kind, part in ((FIX, fixes), (CLOSURE, closures)):
        if part is not None and SOURCES in part:
            keys[kind] = [_plain(source) for source in part[SOURCES]]
    header = header_of(keys, fault)
    if (increments is None) == (odometry is None):
        raise fault("either increments or odometry is needed")
    if odometry is not None and header.motion is None:
        raise fault('odometry needs motion, as in motion={"noise": "velocity", "sigma": [0.1, 0.05]}')

    key = "frame" if odometry is None else "t"
    seen = _table(f"{name}: observations", observations, (key, "z1", "z2"))
    if R is not None:
        own = _covariances(f"{name}: R", R, len(seen), 2)[:, [0, 0, 1], [0, 1, 1]]
        seen = replace(seen, columns={**seen.columns, **dict(zip(NOISE, own.T, strict=True))})
    given = {file: {a: (column, columns.get(a)) for a, (of, column) in COLUMNS.items() if of == file} for file in MORE}
    tables = {parts.OBSERVATIONS: _with(seen, name, given[parts.OBSERVATIONS])}
    if odometry is not None:
        tables[parts.ODOMETRY] = _table(f"{name}: odometry", odometry, ("t", *parts.VELOCITIES))
    else:
        steps = _table(f"{name}: increments", [] if increments is None else increments, RELATIVE)
        if covariance is None:
            raise fault("increments need a covariance: (N, 3, 3), (3, 3), or sigmas (3,)")
        P = _covariances(f"{name}: covariance", covariance, len(steps), 3)
        if np.ndim(covariance) < 3:  # one for all but the first frame, which has no motion
            P[0] = 0.0
        steps = replace(steps, columns={**steps.columns, **dict(zip(COVARIANCE, P[:, *UPPER].T, strict=True))})
        tables[parts.FRAMES] = _with(steps, name, {"time": ("t", np.arange(len(steps)) if time is None else time)})
    if truth is not None:
        tables[parts.TRUTH] = _table(f"{name}: truth", truth, POSE if odometry is None else ("t", *POSE))
    if landmarks is not None:
        wide = np.ndim(landmarks) == 2 and np.shape(landmarks)[1] == 3 + len(parts.SIGMAS)
        places = _table(f"{name}: landmarks", landmarks, ("id", "x", "y", *(parts.SIGMAS if wide else ())))
        tables[parts.LANDMARKS] = _with(places, name, given[parts.LANDMARKS])
    for file, what, measured in ((parts.FIXES, "fixes", fixes), (parts.CLOSURES, "closures", closures)):
        if measured is not None:
            tables[file] = _columns(f"{name}: {what}", measured, parts.columns_of(header, key)[file])
    return parts.parts_of(header, tables)


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


def _with(table: Table, place: str, given: Mapping[str, tuple[str, ArrayLike | None]]) -> Table:
    """The table with more columns by argument, where they are not None; one value stands for all rows."""
    columns, texts = dict(table.columns), dict(table.texts)
    for argument, (column, values) in given.items():
        if values is None:
            continue
        array = np.asarray(values, str if column in WORDS else float)
        if array.shape not in ((), (len(table),)):
            what = f"({len(table)},) is needed, one for each row"
            raise DataError(f"{place}: {argument} has shape {array.shape}; {what}")
        if column in WORDS:
            texts[column] = np.broadcast_to(array, len(table)).tolist()
        else:
            columns[column] = np.array(np.broadcast_to(array, len(table)))
    return replace(table, columns=columns, texts=texts)


def _columns(place: str, values: Mapping[str, Any], known: Columns) -> Table:
    names = (*known.required, *known.optional, SOURCES)
    for key in values:
        if key not in names:
            raise DataError(f"{place}: {key!r} is {unknown(key, names)}")
    for key in known.required:
        if key not in values:
            raise DataError(f"{place}: no {key}; {', '.join(known.required)} are needed")
    length = len(np.atleast_1d(np.asarray(values[known.required[0]])))
    given = {key: (key, column) for key, column in values.items() if key != SOURCES}
    return _with(Table(place, {}, line=np.arange(length)), place, given)


def _is_latest(sensor: Mapping[str, Any]) -> bool:
    """Whether a sensor is of format 2 alone."""
    return any(key in sensor for key in ("name", "sees", *looks.KEYS)) or sensor.get("kind") not in (None, *FIRST)


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
