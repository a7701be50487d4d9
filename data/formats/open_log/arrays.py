"""A log from arrays in memory, checked as a log folder is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from data.errors import DataError
from data.formats.csv_table import Table
from data.formats.open_log.header import FORMAT, header_of
from data.formats.open_log.reader import (
    COVARIANCE,
    IDS,
    MEAN,
    NOISE,
    POSE,
    frame_of,
    frames_of,
    inputs_of,
    landmarks_of,
    observations_of,
    odometry_of,
    stamped_truth,
    truth_per_frame,
)
from data.log import Log
from data.se2 import Array
from data.truth import Truth

UPPER = np.triu_indices(3)


def log_of_arrays(
    name: str,
    prior: tuple[ArrayLike, ArrayLike],
    sensor: Mapping[str, Any],
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
) -> Log:
    """See `Log.from_arrays`."""

    def fault(what: str) -> DataError:
        return DataError(f"{name}: {what}")

    def table(part: str, values: ArrayLike, columns: tuple[str, ...]) -> Table:
        return _table(f"{name}: {part}", values, columns)

    mean, spread = (np.asarray(p, float) for p in prior)
    stated = {"sigma" if spread.ndim == 1 else "covariance": spread.tolist(), "mean": mean.tolist()}
    tables: dict[str, Any] = {"format": FORMAT, "name": name, "prior": stated, "sensor": _plain(sensor)}
    tables |= {"labels_are_sensed": labels_are_sensed, "time_is_index": increments is not None and time is None}
    if motion is not None:
        tables["motion"] = _plain(motion)
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
    seen = _joined(seen, extra)
    found = observations_of(seen, header, key)
    if (increments is None) == (odometry is None):
        raise fault("either increments or odometry is needed")
    if odometry is not None:
        if header.motion is None:
            raise fault('odometry needs motion, as in motion={"noise": "velocity", "sigma": [0.1, 0.05]}')
        samples = table("odometry", odometry, ("t", "v", "omega"))
        moved, frame, _ = odometry_of(samples, header.motion, seen)
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
        frame = frame_of(seen, len(steps))
    pose = None
    if truth is not None:
        true = table("truth", truth, ("t", *POSE) if by_stamp else POSE)
        true.require_finite(POSE, blank=True)
        pose = stamped_truth(true, moved.time) if by_stamp else truth_per_frame(true, len(moved.time))
    known = None if landmarks is None else landmarks_of(table("landmarks", landmarks, ("id", "x", "y")))[0]
    return Log(
        name=name,
        recorded=inputs_of(header, moved, frame, found, known),
        truth=Truth(pose, known, found.true_id),
        label=found.label,
        labels_are_sensed=labels_are_sensed,
    )


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
