"""The tables of an open log (docs/log-folder.md), and its inputs and truth, from files or from arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from data.columns import appearance as looks, poses
from data.columns.header import FORMAT, HEADER, LATEST, Header, header_of
from data.columns.named import COVARIANCE, UPPER, require_semidefinite, unused
from data.columns.sensors import FIRST, NOISE, SENSOR, may_be_blank, observed
from data.csv_table import Columns, Table
from data.errors import DataError, unknown
from data.inputs import CLUTTER, UNLABELLED, Increments, Inputs, IntArray, LandmarkMap, Observations
from data.motion.motion_prior import MotionPrior
from data.motion.velocity import floor_covariances, gaps_said, preintegrate, told
from data.se2 import Array
from data.sensors import RangeBearing
from data.terminal import counted
from data.timeline import frame_times, truth_at
from data.truth import UNKNOWN_ID, Truth

FRAMES, ODOMETRY, OBSERVATIONS, TRUTH = "frames.csv", "odometry.csv", "observations.csv", "truth.csv"
LANDMARKS, FIXES, CLOSURES = "landmarks.csv", "fixes.csv", "closures.csv"
STAMP, VELOCITIES = "stamp", ("v", "omega")
IDS = {"true_id": UNKNOWN_ID, "label": UNLABELLED}  # Columns of ids, and the id of a blank field
KIND, SIGMAS, TRUE_PLACE = "kind", ("sx", "sy"), ("true_x", "true_y")
LONGEST = 1e6  # s, longest odometry log; keyframes up to a broken stamp would fill the memory


def columns_of(header: Header, key: str) -> dict[str, Columns]:
    """The columns of each file; `key`: t with odometry.csv, else frame."""
    latest, blank = header.format == LATEST, may_be_blank(header.sensors)
    second = ("z2",) if any(s.sensor.locates for s in header.sensors) else ()
    seen = (*looks.NUMBERS, looks.CLASS) if latest else ()
    known = (KIND, looks.DESCRIPTOR, looks.CLASS) if latest else ()
    closed, fixed = (poses.SOURCE, poses.INLIER), (poses.SOURCE, *poses.POSE, *COVARIANCE, poses.INLIER)
    motion, other = (*poses.RELATIVE, *COVARIANCE), "t" if key == "frame" else "frame"
    return {
        FRAMES: Columns(("t", *(motion if header.motion_prior is None else ())), (*motion, STAMP)),
        ODOMETRY: Columns(("t", *VELOCITIES)),
        OBSERVATIONS: Columns(
            (key, "z1", *second), (*NOISE, *IDS, other, *seen, *(("z2", SENSOR) if blank else ())),
            (*IDS, other, *looks.NUMBERS, *blank), (SENSOR, looks.CLASS),
        ),
        TRUTH: Columns(poses.POSE if key == "frame" else ("t", *poses.POSE), (), poses.POSE),
        LANDMARKS: Columns(
            ("id", "x", "y"), (*SIGMAS, *TRUE_PLACE, *known),
            (*SIGMAS, *TRUE_PLACE, looks.DESCRIPTOR), (KIND, looks.CLASS),
        ),
        FIXES: Columns((key, poses.KIND), fixed, fixed, (poses.KIND, poses.SOURCE)),
        CLOSURES: Columns((*poses.ENDS[key], *poses.RELATIVE), (*COVARIANCE, *closed), closed, (poses.SOURCE,)),
    }  # fmt: skip


class Parts(NamedTuple):
    """Inputs, truth, labels (M,) or None, and notes of a log."""

    recorded: Inputs
    truth: Truth
    label: IntArray | None
    labels_are_sensed: bool
    notes: tuple[str, ...]


def parts_of(header: Header, tables: Mapping[str, Table]) -> Parts:
    """A log from its tables by file name, with the covariance floor. DataError with file, line, column and value."""
    key, gaps = "frame" if FRAMES in tables else "t", 0
    keyed = {OBSERVATIONS: (key,), FIXES: (key,), CLOSURES: poses.ENDS[key]}
    keyed = {name: columns for name, columns in keyed.items() if name in tables}
    for name, columns in keyed.items():
        tables[name].require_finite(columns)
    notes: list[str] = []
    if FRAMES in tables:
        time, increments = _frames(tables[FRAMES], header.motion_prior)
    else:
        assert header.motion is not None  # the caller asked
        tables, notes = _within_odometry(tables, keyed)
        at = [tables[name].columns[column] for name, columns in keyed.items() for column in columns]
        stamps, v, omega = (tables[ODOMETRY].columns[name] for name in ("t", "v", "omega"))
        instants = np.concatenate([np.empty(0), *at])
        time = frame_times(instants, float(stamps[0]), max(float(stamps[-1]), instants.max(initial=stamps[0])))
        increments, gaps = preintegrate(header.motion, stamps, v, omega, time)
    frames = {name: [_frames_in(tables[name], column, time) for column in columns] for name, columns in keyed.items()}
    for name, table in tables.items():
        if table.unknown:
            free = {OBSERVATIONS: [q for q in IDS if q not in table]}.get(name, [])
            notes.append(f"{name}: {unused(table.unknown, free)}")
    if gaps:
        notes.append(f"{ODOMETRY}: {gaps_said(tables[ODOMETRY].columns['t'], time)}")
    observations, ids = _observations(tables.get(OBSERVATIONS), header, *frames.get(OBSERVATIONS, ()))
    known, landmarks = landmarks_of(tables[LANDMARKS]) if LANDMARKS in tables else (None, None)
    if known is not None and known.sigma is not None and not all(s.sensor.sees_points for s in header.sensors):
        known = known.exact
        notes.append(f"{LANDMARKS}: sigmas of walls are not used; estimators take the map as exact")
    seen, looking = looks.together([observations.appearance, None if known is None else known.appearance])
    if known is not None and looking is not None:
        known = replace(known, appearance=looking)
    fixes = closures = fix_inlier = loop_inlier = None
    if FIXES in tables:
        fixes, fix_inlier = poses.fixes_of(tables[FIXES], header.fixes, frames[FIXES][0])
    if CLOSURES in tables:
        closures, loop_inlier = poses.closures_of(tables[CLOSURES], header.closures, frames[CLOSURES], poses.ENDS[key])
    covariance, floored = floor_covariances(increments.covariance, header.covariance_floor)
    inputs = Inputs(
        prior=header.prior, time=time, increments=Increments(increments.mean, covariance),
        observations=replace(observations, appearance=seen),
        sensor=header.sensors[0].sensor if header.sensors else RangeBearing(),
        sensors=tuple(s.sensor for s in header.sensors) if len(header.sensors) > 1 else (), map=known,
        time_is_index=header.time_is_index, covariance_floor=header.covariance_floor,
        floored=header.floored + floored, fixes=fixes, closures=closures,
    )  # fmt: skip
    truth = Truth(
        None if TRUTH not in tables else _truth(tables[TRUTH], time, key), known if landmarks is None else landmarks,
        ids.get("true_id"), fix_inlier=fix_inlier, closure_inlier=loop_inlier,
    )  # fmt: skip
    return Parts(inputs, truth, ids.get("label"), header.labels_are_sensed, tuple(notes))


def _frames(table: Table, prior: MotionPrior | None) -> tuple[Array, Increments]:
    """Time (N,) and increments of frames.csv, or those of a motion prior."""
    motion = (*poses.RELATIVE, *COVARIANCE)
    if len(table) == 0:
        raise DataError.at(table.path, "no rows; at least one frame is needed", line=1)
    table.require_finite([name for name in ("t", *(motion if prior is None else ()), STAMP) if name in table])
    table.require_ascending("t", strictly=True)
    time = table.columns["t"]
    if prior is not None:
        for name in motion:
            if name in table:
                what = f"[motion] prior in {HEADER} states the increments; remove one of them"
                raise DataError.at(table.path, what, line=1, column=name)
        return time, prior.increments(time)
    for name in motion:
        what = "{} in row 0; the first frame has no motion, so 0 is needed"
        table.require((table.columns[name] == 0.0) | (np.arange(len(table)) > 0), name, what)
    covariance = table.symmetric(COVARIANCE)
    require_semidefinite(table, covariance)
    return time, Increments(table.stack(poses.RELATIVE), covariance)


def _within_odometry(
    tables: Mapping[str, Table], keyed: Mapping[str, Sequence[str]]
) -> tuple[Mapping[str, Table], list[str]]:
    """The tables without rows at stamps (`keyed`: their columns) whose motion no odometry tells, and notes of these."""
    odometry, notes, kept = tables[ODOMETRY], list[str](), dict(tables)
    if len(odometry) == 0:
        raise DataError.at(odometry.path, "no rows; at least one sample is needed", line=1)
    odometry.require_finite(("t", *VELOCITIES))
    odometry.require_ascending("t", strictly=True)
    first, last = told(odometry.columns["t"])
    for name, columns in {ODOMETRY: ("t",), **keyed}.items():
        part = tables[name]
        if columns == ("t",):
            part.require_ascending("t", strictly=False)
        for column in columns:
            far = f"{{}} s is more than {LONGEST:g} s from the first odometry; stamps are in seconds"
            part.require(np.abs(part.columns[column] - first) <= LONGEST, column, far)
        at = part.stack(columns)
        inside = np.asarray(((at >= first) & (at <= last)).all(axis=1))
        if not inside.all():
            kept[name] = part.part(inside)
            some = f"{int((~inside).sum())} of {counted(len(part), 'row')}"
            notes.append(f"{name}: {some} before or after all odometry, {first:.15g} to {last:.15g} s, dropped")
    return kept, notes


def _frames_in(table: Table, column: str, time: Array) -> IntArray:
    """The frame (K,) of each row by a column of stamps among `time` (N,), or of frame numbers."""
    if column.startswith("t"):
        return np.searchsorted(time, table.columns[column]).astype(np.int64)
    frame = table.integers(column, 0)
    table.require(frame < len(time), column, f"{{}} is out of range; there are frames 0 to {len(time) - 1}")
    if column == "frame":
        table.require_ascending(column, strictly=False)
    return frame


def _observations(
    table: Table | None, header: Header, frame: IntArray | None = None
) -> tuple[Observations, dict[str, IntArray]]:
    """Observations by frame (M,), then sensor, and their columns of ids."""
    if table is None or frame is None:
        sensor = np.zeros(0, np.int64) if len(header.sensors) > 1 else None
        return Observations(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)), sensor=sensor), {}
    table.require_finite([n for n in IDS if n in table], blank=True)
    z, R, sensor = observed(table, header.sensors)
    ids = {name: table.integers(name, CLUTTER, blank=blank) for name, blank in IDS.items() if name in table}
    seen = looks.of_observations(table, sensor, [(s.sensor.label, s.looks) for s in header.sensors])
    if sensor is not None:
        by = np.lexsort((sensor, frame))
        frame, z, R, sensor, ids = frame[by], z[by], R[by], sensor[by], {name: ids[name][by] for name in ids}
        seen = None if seen is None else seen.only(by)
    return Observations(frame, z, R, sensor=sensor, appearance=seen), ids


def landmarks_of(table: Table) -> tuple[LandmarkMap, LandmarkMap | None]:
    """The map, ascending by id, and the true landmarks; None: they are the map."""
    table.require_finite(("x", "y"))
    sigmas, placed = table.together(SIGMAS), table.together(TRUE_PLACE)
    table.require_finite([n for n in (*SIGMAS, *TRUE_PLACE) if n in table], blank=True)
    for name in SIGMAS if sigmas else ():
        fine = ~(table.columns[name] < 0.0)
        table.require(fine, name, "{} is a negative standard deviation; 0 or blank is an exact landmark")
    table.require_distinct("id", table.integers("id", 0), "{} is the id of two landmarks")
    table.require_names(KIND)
    table = table.part(np.argsort(table.columns["id"], kind="stable"))
    number, kind = table.integers("id", 0), table.texts.get(KIND)
    sigma = np.nan_to_num(table.stack(SIGMAS)) if sigmas else np.zeros(0)
    known = LandmarkMap(
        number, table.stack(("x", "y")), None if kind is None else tuple(kind), looks.of_landmarks(table),
        sigma if sigma.any() else None,
    )  # fmt: skip
    if not placed:
        return known, None
    place = table.stack(TRUE_PLACE)
    there = np.flatnonzero(np.isfinite(place).all(axis=1))
    kinds = None if kind is None else tuple(kind[k] for k in there.tolist())
    return known, LandmarkMap(number[there], place[there], kinds)


def _truth(table: Table, time: Array, key: str) -> Array:
    """True poses (N, 3) at the frames, NaN where unknown: a row for each, or stamped and interpolated."""
    table.require_finite(poses.POSE, blank=True)
    if key == "t":
        table.require_finite(("t",))
        table.require_ascending("t", strictly=True)
        return truth_at(table.columns["t"], table.stack(poses.POSE), time)
    if len(table) != len(time):
        what = f"{len(table)} rows for {len(time)} frames; one row per frame is needed"
        last = int(table.line[min(len(table), len(time) + 1) - 1]) if len(table) else 1
        raise DataError.at(table.path, what, line=last)
    return table.stack(poses.POSE)


MORE = (OBSERVATIONS, LANDMARKS)
COLUMNS = {
    "true_id": (OBSERVATIONS, "true_id"), "label": (OBSERVATIONS, "label"),
    "observed_by": (OBSERVATIONS, SENSOR), "descriptor": (OBSERVATIONS, looks.DESCRIPTOR),
    "classes": (OBSERVATIONS, looks.CLASS), "kinds": (LANDMARKS, KIND),
    "landmark_descriptor": (LANDMARKS, looks.DESCRIPTOR), "landmark_classes": (LANDMARKS, looks.CLASS),
}  # fmt: skip
"""Arguments that are further columns of a table."""
WORDS = (SENSOR, KIND, poses.SOURCE, looks.CLASS)  # Columns of words
SOURCES = "sources"  # Key of fixes and closures: the tables [[fix]], [[closure]] of log.toml


def parts_of_arrays(
    name: str, prior: tuple[ArrayLike, ArrayLike], sensor: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    observations: ArrayLike, *, increments: ArrayLike | None = None, covariance: ArrayLike | None = None,
    time: ArrayLike | None = None, odometry: ArrayLike | None = None, motion: Mapping[str, Any] | None = None,
    R: ArrayLike | None = None, landmarks: ArrayLike | None = None, truth: ArrayLike | None = None,
    labels_are_sensed: bool = False, fixes: Mapping[str, Any] | None = None,
    closures: Mapping[str, Any] | None = None, **columns: ArrayLike | None,
) -> Parts:  # fmt: skip
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
    for kind, part in ((poses.FIX, fixes), (poses.CLOSURE, closures)):
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
    tables = {OBSERVATIONS: _with(seen, name, given[OBSERVATIONS])}
    if odometry is not None:
        tables[ODOMETRY] = _table(f"{name}: odometry", odometry, ("t", *VELOCITIES))
    else:
        steps = _table(f"{name}: increments", [] if increments is None else increments, poses.RELATIVE)
        if covariance is None:
            raise fault("increments need a covariance: (N, 3, 3), (3, 3), or sigmas (3,)")
        P = _covariances(f"{name}: covariance", covariance, len(steps), 3)
        if np.ndim(covariance) < 3:  # one for all but the first frame, which has no motion
            P[0] = 0.0
        steps = replace(steps, columns={**steps.columns, **dict(zip(COVARIANCE, P[:, *UPPER].T, strict=True))})
        tables[FRAMES] = _with(steps, name, {"time": ("t", np.arange(len(steps)) if time is None else time)})
    if truth is not None:
        tables[TRUTH] = _table(f"{name}: truth", truth, poses.POSE if odometry is None else ("t", *poses.POSE))
    if landmarks is not None:
        wide = np.ndim(landmarks) == 2 and np.shape(landmarks)[1] == 3 + len(SIGMAS)
        places = _table(f"{name}: landmarks", landmarks, ("id", "x", "y", *(SIGMAS if wide else ())))
        tables[LANDMARKS] = _with(places, name, given[LANDMARKS])
    for file, what, measured in ((FIXES, "fixes", fixes), (CLOSURES, "closures", closures)):
        if measured is not None:
            tables[file] = _columns(f"{name}: {what}", measured, columns_of(header, key)[file])
    return parts_of(header, tables)


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
