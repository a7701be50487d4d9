"""Contents and oddities of a log in words, printed by `eval.inspect`."""

from __future__ import annotations

import json

import numpy as np
import scipy

from data.appearance import misread, spread
from data.inputs import CLUTTER, UNLABELLED, IntArray, Scanner
from data.log import Log
from data.origin import listed
from data.pose_measurements import MEASURED, FixKind
from data.se2 import Array, BoolArray
from data.sensors import Sensor
from data.terminal import counted
from data.timeline import MAX_GAP
from data.truth import UNKNOWN_ID

JUMP = 10.0
"""Speed of a jump over the median speed while moving."""
SHOWN = 5
"""Number of places of an oddity that are named."""

Line = tuple[str, str]


def summarize(log: Log) -> list[Line]:
    """Name and sentence, in printed order; `check` lines deserve attention."""
    return [
        ("name", log.name),
        *(("source", f"{key} = {_plain(value)}") for key, value in log.source.items()),
        *((origin.value, quantities) for origin, quantities in listed(log.origins)),
        *(("note", note) for note in log.notes),
        *_frames(log),
        *_increments(log),
        *_observations(log),
        *_fixes(log),
        *_closures(log),
        *_scans(log),
        *_labels(log),
        *_truth(log),
        *_relations(log),
        *_landmarks(log),
        *(("check", oddity) for oddity in _oddities(log)),
    ]


def _plain(value: object) -> str:
    """A value of the source as text."""
    value = value.tolist() if isinstance(value, np.generic | np.ndarray) else value
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole}" + (f" ({100.0 * part / whole:.1f} %)" if whole else "")


def _unit(log: Log) -> str:
    return "steps" if log.recorded.time_is_index else "s"


def longest_run(mask: BoolArray) -> tuple[int, int]:
    """First index and length of the longest run of true values; length 0 if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    if len(edges) == 0:
        return 0, 0
    lengths = edges[1::2] - edges[::2]
    k = int(np.argmax(lengths))
    return int(edges[2 * k]), int(lengths[k])


def _frames(log: Log) -> list[Line]:
    time = log.recorded.time
    n, span, unit = len(time), float(time[-1] - time[0]), _unit(log)
    lines = [("frames", str(n) + (", without stamps (t is a frame number)" if unit == "steps" else ""))]
    text = f"{span:.6g} {unit}, from {time[0]:.15g} to {time[-1]:.15g}"
    lines.append(("span", text + (f"; rate {(n - 1) / span:.4g} per s" if n > 1 and unit == "s" else "")))
    if n > 1:
        gap = np.diff(time)
        k = int(np.argmax(gap))
        text = f"largest {gap[k]:.4g} {unit}, before frame {k + 1}; median {np.median(gap):.4g} {unit}"
        # stamps are rounded, so a gap of 1 s may seem longer
        over = int((gap > MAX_GAP + 1e-6).sum())
        lines.append(("gaps", text + (f"; {over} longer than {MAX_GAP:g} s" if unit == "s" else "")))
    return lines


def _increments(log: Log) -> list[Line]:
    inputs = log.recorded
    mean, covariance = inputs.increments.mean[1:], inputs.increments.covariance[1:]
    if len(mean) == 0:
        return []
    still = int((~mean.any(axis=1)).sum())
    turned = np.degrees(np.abs(mean[:, 2]).sum())
    path = np.hypot(mean[:, 0], mean[:, 1]).sum()
    lines = [("increments", f"path {path:.6g} m, turned {turned:.0f} deg in all; {_share(still, len(mean))} at rest")]
    sigma = np.sqrt(np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    text = f"median σ forward {sigma[0]:.3g} m, sideways {sigma[1]:.3g} m, heading {np.degrees(sigma[2]):.3g} deg"
    if inputs.covariance_floor > 0.0:
        text += f"; covariance raised to the minimum {inputs.covariance_floor:g} in {_share(inputs.floored, len(mean))}"
    else:
        singular = int((np.linalg.eigvalsh(covariance)[:, 0] <= 0.0).sum())
        text += f"; no covariance floor, {singular} singular"
    lines.append(("noise", text))
    return lines


def _mounted(point: str, sensor: Sensor | Scanner) -> str:
    """Pose of a sensor on the body, where it is not the body's own."""
    if not sensor.rotation and not any(sensor.translation):
        return ""
    tx, ty = sensor.translation
    return f"; {point} = R({np.degrees(sensor.rotation):.4g} deg) p_body + ({tx:g}, {ty:g}) m"


def _observations(log: Log) -> list[Line]:
    inputs, o = log.recorded, log.recorded.observations
    lines = []
    for sensor in inputs.sensors or (inputs.sensor,):
        low, high = np.degrees([sensor.min_angle, sensor.max_angle])
        reach = f"up to {sensor.max_range:g} m" if np.isfinite(sensor.max_range) else "any range"
        text = f"{sensor.label}: {sensor.name}" if sensor.label else sensor.name
        text += f", {reach}, {low:.4g} to {high:.4g} deg{_mounted('p_sensor', sensor)}"
        lines.append(("sensor", text + (f"; sees each {sensor.sees}" if sensor.sees else "")))
    m, per_frame = len(o.frame), np.diff(inputs.start)
    if m == 0:
        return [*lines, ("observations", "none")]
    span = float(inputs.time[-1] - inputs.time[0])
    rate = f"; {m / span:.4g} per s" if span > 0.0 and not inputs.time_is_index else ""
    counts = f"per frame {per_frame.min()} to {per_frame.max()}, mean {per_frame.mean():.3g}"
    lines.append(("observations", f"{m}, {counts}{rate}"))
    first, blind = longest_run(per_frame == 0)
    without = _share(int((per_frame == 0).sum()), len(per_frame))
    where = f"; longest stretch {counted(blind, 'frame')} from frame {first}" if blind else ""
    lines.append(("blind frames", f"{without} without observation{where}"))
    outside = np.isin(np.arange(m), _out_of_view(log))
    for i, sensor in enumerate(inputs.sensors or (inputs.sensor,)):
        rows = np.arange(m) if o.sensor is None else np.flatnonzero(o.sensor == i)
        if len(rows):
            lines.append(("measured", _measured(sensor, o.z[rows], int(outside[rows].sum()))))
    return [*lines, *(("appearance", text) for text in _appearance(log))]


def _appearance(log: Log) -> list[str]:
    """Spans of descriptors, and classes with their counts; their errors, where landmarks are known."""
    looks, label = log.recorded.observations.appearance, log.granted
    if looks is None:
        return []
    there, read = looks.descriptor[np.isfinite(looks.descriptor)], looks.category[looks.category >= 0]
    texts = []
    if len(there):
        sigma = np.median(looks.sigma[np.isfinite(looks.descriptor)])
        texts.append(f"descriptor {there.min():.4g} to {there.max():.4g}, sigma {sigma:.4g}: {len(there)}")
        if label is not None and np.isfinite((found := spread(looks, label)).within):
            within = f"{found.within:.3g} about a landmark's mean, {found.successive:.3g} from reading to reading"
            texts[-1] += f"; by label {within}, {found.between:.3g} between landmarks"
    if len(read):
        counts = np.bincount(read, minlength=len(looks.names))
        each = ", ".join(f"{n} {c}" for n, c in zip(looks.names[:8], counts.tolist(), strict=False))
        texts.append(f"{counted(len(looks.names), 'class', 'classes')}: {each}{', ...' * (len(looks.names) > 8)}")
        if label is not None and np.isfinite(share := misread(looks, label)):
            texts[-1] += f"; by label {100.0 * share:.2g} % unlike the others of their landmark"
    return texts


def _measured(sensor: Sensor, z: Array, outside: int) -> str:
    """Spans of what a sensor measured (m, 2)."""
    polar = sensor.polar(z)
    bearing = np.degrees(polar[:, 1])
    spans = (
        f"range {polar[:, 0].min():.4g} to {polar[:, 0].max():.4g} m",
        f"bearing {bearing.min():.4g} to {bearing.max():.4g} deg",
    )
    name = f"{sensor.label}: {len(z)}, " if sensor.label else ""
    text = name + ", ".join(spans[q] for q in sensor.measures)
    return f"{text}; {_share(outside, len(z))} outside the stated range or field of view"


def _fixes(log: Log) -> list[Line]:
    """A line for each source and kind."""
    fixes = log.recorded.fixes
    if fixes is None:
        return []
    lines = []
    for k, source in enumerate(fixes.sources):
        for kind in FixKind:
            rows = np.flatnonzero((fixes.source == k) & (fixes.kind == kind))
            if not len(rows):
                continue
            text = f"{source.name}, {kind.name.lower()}: {len(rows)}"
            text += f" in {_share(len(np.unique(fixes.frame[rows])), len(log.recorded))} frames"
            sigma = np.sqrt(np.median(np.diagonal(fixes.covariance[rows], axis1=1, axis2=2), axis=0))
            measured = MEASURED[kind]
            if 0 in measured:
                text += f"; median σ {sigma[0]:.3g} m, {sigma[1]:.3g} m"
                text += f"; lever ({source.lever[0]:g}, {source.lever[1]:g}) m" if any(source.lever) else ""
            if 2 in measured:
                text += f"; heading σ {np.degrees(sigma[2]):.3g} deg"
                text += f", rotation {np.degrees(source.rotation):.4g} deg" if source.rotation else ""
            lines.append(("fixes", text + _outliers(log.truth.fix_inlier, rows)))
    return lines or [("fixes", "none")]


def _closures(log: Log) -> list[Line]:
    """A line for each source."""
    closures = log.recorded.closures
    if closures is None:
        return []
    lines = []
    for k, name in enumerate(closures.sources):
        rows = np.flatnonzero(closures.source == k)
        if not len(rows):
            continue
        sigma = np.sqrt(np.median(np.diagonal(closures.covariance[rows], axis1=1, axis2=2), axis=0))
        apart = (closures.later - closures.earlier)[rows]
        text = f"{name}: {len(rows)}, over {apart.min()} to {counted(int(apart.max()), 'frame')}, median "
        text += f"{np.median(apart):g}; median σ {sigma[0]:.3g} m, {sigma[1]:.3g} m, {np.degrees(sigma[2]):.3g} deg"
        lines.append(("closures", text + _outliers(log.truth.closure_inlier, rows)))
    return lines or [("closures", "none")]


def _outliers(inlier: IntArray | None, rows: IntArray) -> str:
    return "" if inlier is None else f"; {counted(int((inlier[rows] == 0).sum()), 'outlier')} by the truth"


def _scans(log: Log) -> list[Line]:
    scans = log.recorded.scans
    if scans is None:
        return []
    s, (count, beams) = scans.scanner, scans.ranges.shape
    last = s.angle_min + (beams - 1) * s.angle_step
    text = f"{counted(beams, 'beam')} from {np.degrees(s.angle_min):.4g} to {np.degrees(last):.4g} deg, "
    text += f"up to {s.max_range:g} m, sigma {s.sigma:g} m"
    text += _mounted("p_scanner", s)
    seen = scans.ranges[scans.ranges > 0.0]
    held = f"in {_share(count, len(log.recorded))} frames; {_share(scans.ranges.size - len(seen), scans.ranges.size)} "
    held += "ranges are no return"
    if len(seen):
        held += f", the others {seen.min():.4g} to {seen.max():.4g} m, median {np.median(seen):.4g} m"
    return [("scanner", text), ("scans", held)]


def _relations(log: Log) -> list[Line]:
    relations = log.truth.relations
    if relations is None:
        return []
    text = f"{counted(len(relations), 'relation')} between {len(np.union1d(relations.row1, relations.row2))} frames"
    if relations.exact is not None:
        text += f", {int(relations.exact.sum())} exact"
    text += ", with stamps" if relations.stamp is not None else ", by row only"
    if len(relations):
        text += f"; up to {np.hypot(*relations.relative[:, :2].T).max():.4g} m apart"
    return [("relations", text)]


def _out_of_view(log: Log) -> IntArray:
    """Observations (indices) outside the sensor's stated range or angles."""
    return np.flatnonzero(~log.recorded.sensor_of().in_view(log.recorded.observations.z))


def _labels(log: Log) -> list[Line]:
    label, truth = log.granted, log.truth.landmark_of
    if label is None:
        return [("labels", "none")]
    origin = "sensed" if log.labels_are_sensed else ("claimed" if log.label is not None else "from the true ids")
    _, times = np.unique(label[label >= 0], return_counts=True)
    text = f"{origin}; {len(times)} distinct"
    if len(times):
        text += f", seen {times.min()} to {times.max()} times, median {np.median(times):g}"
    text += f"; {_share(int((label == UNLABELLED).sum()), len(label))} unlabelled, {(label == CLUTTER).sum()} clutter"
    if log.label is not None and truth is not None:
        comparable = (truth != UNKNOWN_ID) & (label != UNLABELLED)
        wrong = int((comparable & (truth != label)).sum())
        text += f"; {_share(wrong, int(comparable.sum()))} differ from the true id"
    return [("labels", text)]


def _known(pose: Array) -> BoolArray:
    return np.asarray(np.isfinite(pose[:, :2]).all(axis=1))


def _truth(log: Log) -> list[Line]:
    pose, ids = log.truth.pose, log.truth.landmark_of
    if pose is None:
        text = "no poses"
    else:
        first, missing = longest_run(~_known(pose))
        known = "pose" if log.truth.has_headings else "position alone"
        text = f"{_share(log.truth.known_poses, len(pose))} frames with a {known}"
        if missing:
            text += f"; longest stretch without {counted(missing, 'frame')} from frame {first}"
    if ids is None:
        return [("truth", text + "; no ids")]
    return [("truth", f"{text}; {_share(int((ids != UNKNOWN_ID).sum()), len(ids))} observations with an id")]


def _landmarks(log: Log) -> list[Line]:
    known, true = log.recorded.map, log.truth.landmarks
    landmarks = known if known is not None else true
    if landmarks is None or len(landmarks.id) == 0:
        return [("landmarks", "none known")]
    xy = landmarks.xy
    (x0, y0), (x1, y1) = xy.min(axis=0), xy.max(axis=0)
    use = "given map" if true is None else ("map and truth" if known is not None else "truth only")
    text = f"{len(xy)} ({use}), ids {landmarks.id.min()} to {landmarks.id.max()}, "
    if not log.recorded.sensor.sees_points:
        return [("landmarks", f"{text}walls, rho {x0:.4g} to {x1:.4g} m")]
    text += f"x {x0:.4g} to {x1:.4g} m, y {y0:.4g} to {y1:.4g} m"
    if landmarks.sigma is not None:
        low, high = landmarks.sigma.min(), landmarks.sigma.max()
        text += f"; sigma {low:.3g} to {high:.3g} m"
    if len(xy) > 1:
        distance = np.asarray(scipy.spatial.cKDTree(xy).query(xy, k=2)[0])
        text += f"; closest two {distance[:, 1].min():.3g} m apart"
    return [("landmarks", text)]


def _places(what: str, where: IntArray) -> list[str]:
    """The number of places of `what`, and the first of them; nothing without any."""
    if len(where) == 0:
        return []
    shown = ", ".join(str(i) for i in where[:SHOWN].tolist()) + (", ..." if len(where) > SHOWN else "")
    return [f"{counted(len(where), what)} {shown}"]


def repeated_in_frame(frame: IntArray, label: IntArray) -> IntArray:
    """Observations (indices, ascending) whose label >= 0 occurs earlier in the same frame."""
    order = np.lexsort((np.arange(len(frame)), label, frame))
    f, i = frame[order], label[order]
    again = (f[1:] == f[:-1]) & (i[1:] == i[:-1]) & (i[1:] >= 0)
    return np.sort(order[1:][again])


def _oddities(log: Log) -> list[str]:
    """Valid rows that deserve attention."""
    inputs, label = log.recorded, log.granted
    odd: list[str] = []

    def add(about: str, thing: str, where: IntArray) -> None:
        odd.extend(f"{about}: {text}" for text in _places(thing, where))

    if log.truth.pose is not None:
        add("without a true pose", "frame", np.flatnonzero(~_known(log.truth.pose)))
    add("outside the stated range or field of view", "observation", _out_of_view(log))
    if len(inputs.time) > 1:
        speed = np.hypot(*inputs.increments.mean[1:, :2].T) / np.diff(inputs.time)
        moving = speed[speed > 0.0]
        usual = float(np.median(moving)) if len(moving) else 0.0
        per = "m per step" if inputs.time_is_index else "m/s"
        about = f"moved more than {JUMP:g} times faster than the usual {usual:.3g} {per}"
        add(about, "frame", 1 + np.flatnonzero(speed > JUMP * usual) if usual else np.zeros(0, np.int64))
    if label is not None:
        o = inputs.observations  # several sensors may see one landmark
        by = o.frame if o.sensor is None else o.frame * len(inputs.sensors) + o.sensor
        add("label repeated in the same frame", "observation", repeated_in_frame(by, label))
        if inputs.map is not None:
            add("not in the map", "label", np.setdiff1d(label[label >= 0], inputs.map.id))
    return odd
