"""Contents and oddities of a log, printed by `eval.inspect`; `templates/log.j2` has the words."""

import json
from itertools import product

import numpy as np

from data.appearance import Appearance
from data.inputs import CLUTTER, UNLABELLED, IntArray
from data.log import Log
from data.origin import listed
from data.pose_measurements import Closures, Fixes, FixKind, FixSource
from data.se2 import Array, BoolArray
from data.sensors import Sensor
from data.timeline import MAX_GAP
from data.truth import UNKNOWN_ID
from data.words import environment

JUMP = 10.0  # Speed of a jump over the median speed while moving
SHOWN = 5  # Number of places of an oddity that are named

Line = tuple[str, str]


def summarize(log: Log) -> list[Line]:
    """Name and sentence, in printed order; `check` lines deserve attention."""
    inputs, truth = log.recorded, log.truth
    outside = np.flatnonzero(~inputs.sensor_of().in_view(inputs.observations.z))
    made = environment("data").get_template("log.j2").render(
        log=log, inputs=inputs, truth=truth, unit="steps" if inputs.time_is_index else "s", np=np, sigmas=sigmas,
        longest_run=longest_run, max_gap=MAX_GAP, unknown_id=UNKNOWN_ID, unlabelled=UNLABELLED, clutter=CLUTTER,
        shown=SHOWN, source={key: _plain(value) for key, value in log.source.items()}, origins=listed(log.origins),
        known=None if truth.pose is None else _known(truth.pose), measured=_measured(log, outside),
        appearance=_appearance(log), fixes=_fixes(log), closures=_closures(log),
        oddities=_oddities(log, outside),
    )  # fmt: skip
    return [(name, text) for name, _, text in (line.partition("\t") for line in made.splitlines())]


def _plain(value: object) -> str:
    """A value of the source as text."""
    value = value.tolist() if isinstance(value, np.generic | np.ndarray) else value
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)


def longest_run(mask: BoolArray) -> tuple[int, int]:
    """First index and length of the longest run of true values; length 0 if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    if len(edges) == 0:
        return 0, 0
    lengths = edges[1::2] - edges[::2]
    k = int(np.argmax(lengths))
    return int(edges[2 * k]), int(lengths[k])


def sigmas(covariance: Array) -> Array:
    """Median standard deviations (3,) of covariances (K, 3, 3) of poses: m, m, deg."""
    return np.sqrt(np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0)) * [1.0, 1.0, 180.0 / np.pi]


def _measured(log: Log, outside: IntArray) -> list[tuple[Sensor, Array, int]]:
    """Each sensor that measured something, with range [m] and bearing [deg] (m, 2), and how many are `outside`."""
    inputs, o = log.recorded, log.recorded.observations
    found = []
    for i, sensor in enumerate(inputs.sensors or (inputs.sensor,)):
        rows = np.arange(len(o.z)) if o.sensor is None else np.flatnonzero(o.sensor == i)
        if len(rows):
            found.append((sensor, (sensor.polar(o.z[rows]) * [1.0, 180.0 / np.pi]), int(np.isin(rows, outside).sum())))
    return found


def _appearance(log: Log) -> tuple[Appearance, Appearance, float] | None:
    """Readings of descriptors and of classes, and the standard deviation of the former about each landmark's mean."""
    looks, label = log.recorded.observations.appearance, log.granted
    if looks is None:
        return None
    read = np.isfinite(looks.descriptor)
    known = read & (label >= 0) if label is not None else np.zeros(len(read), bool)
    z = looks.descriptor[known]
    _, of, times = np.unique(np.zeros(0) if label is None else label[known], return_inverse=True, return_counts=True)
    rest = ((z - np.bincount(of, z)[of] / times[of]) ** 2).sum() if len(z) > len(times) else np.nan
    return looks.only(read), looks.only(looks.category >= 0), float(np.sqrt(rest / max(len(z) - len(times), 1)))


def _fixes(log: Log) -> list[tuple[FixSource, FixKind, Fixes, int | None]]:
    """Those of each source and kind, and the number of outliers."""
    if (f := log.recorded.fixes) is None:
        return []
    pairs = product(enumerate(f.sources), FixKind)
    each = [(source, kind, np.flatnonzero((f.source == k) & (f.kind == kind))) for (k, source), kind in pairs]
    return [(s, kind, f.only(rows), _outliers(log.truth.fix_inlier, rows)) for s, kind, rows in each if len(rows)]


def _closures(log: Log) -> list[tuple[str, Closures, int | None]]:
    """Those of each source, and the number of outliers."""
    if (c := log.recorded.closures) is None:
        return []
    each = [(name, np.flatnonzero(c.source == k)) for k, name in enumerate(c.sources)]
    return [(name, c.only(rows), _outliers(log.truth.closure_inlier, rows)) for name, rows in each if len(rows)]


def _outliers(inlier: IntArray | None, rows: IntArray) -> int | None:
    return None if inlier is None else int((inlier[rows] == 0).sum())


def _known(pose: Array) -> BoolArray:
    return np.asarray(np.isfinite(pose[:, :2]).all(axis=1))


def repeated_in_frame(frame: IntArray, label: IntArray) -> IntArray:
    """Observations (indices, ascending) whose label >= 0 occurs earlier in the same frame."""
    order = np.lexsort((np.arange(len(frame)), label, frame))
    f, i = frame[order], label[order]
    return np.sort(order[1:][(f[1:] == f[:-1]) & (i[1:] == i[:-1]) & (i[1:] >= 0)])


def _oddities(log: Log, outside: IntArray) -> list[tuple[str, str, list[int]]]:
    """Valid rows that deserve attention: what about them, what they are, and where."""
    inputs, label = log.recorded, log.granted
    odd: list[tuple[str, str, IntArray]] = []
    if log.truth.pose is not None:
        odd.append(("without a true pose", "frame", np.flatnonzero(~_known(log.truth.pose))))
    odd.append(("outside the stated range or field of view", "observation", outside))
    if len(inputs.time) > 1:
        speed = np.hypot(*inputs.increments.mean[1:, :2].T) / np.diff(inputs.time)
        moving = speed[speed > 0.0]
        usual = float(np.median(moving)) if len(moving) else np.inf
        per = "m per step" if inputs.time_is_index else "m/s"
        about = f"moved more than {JUMP:g} times faster than the usual {usual:.3g} {per}"
        odd.append((about, "frame", 1 + np.flatnonzero(speed > JUMP * usual)))
    if label is not None:
        o = inputs.observations  # several sensors may see one landmark
        by = o.frame if o.sensor is None else o.frame * len(inputs.sensors) + o.sensor
        odd.append(("label repeated in the same frame", "observation", repeated_in_frame(by, label)))
        if inputs.map is not None:
            odd.append(("not in the map", "label", np.setdiff1d(label[label >= 0], inputs.map.id)))
    return [(about, thing, where.tolist()) for about, thing, where in odd if len(where)]
