"""Tables of an open log as parts of its inputs and truth: motion, observations, fixes, closures, and their frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from data.appearance import Appearance
from data.columns import appearance as looks
from data.columns.closures import ClosureTable
from data.columns.fixes import POSE, FixTable
from data.columns.header import HEADER, Header
from data.columns.named import COVARIANCE
from data.columns.sensors import observed
from data.csv_table import FIRST_ROW, Table
from data.errors import DataError
from data.inputs import UNLABELLED, Increments, Inputs, IntArray, LandmarkMap, Observations
from data.motion.motion_prior import MotionPrior
from data.motion.velocity import VelocityModel, floor_covariances, preintegrate
from data.se2 import Array
from data.sensors import RangeBearing
from data.timeline import frame_times, truth_at
from data.truth import CLUTTER, UNKNOWN_ID

MEAN = ("dx", "dy", "dtheta")
STAMP = "stamp"
IDS = ("true_id", "label")
LONGEST = 1e6
"""s, longest odometry log; keyframes up to a broken stamp would fill the memory."""


class Motion(NamedTuple):
    """Time (N,), increments, and recorded stamps (N,) of the frames."""

    time: Array
    increments: Increments
    stamp: Array | None = None


class PoseTables(NamedTuple):
    """Fixes and closures without frames; None: there are none."""

    fixes: FixTable | None = None
    closures: ClosureTable | None = None

    def __bool__(self) -> bool:
        return self.fixes is not None or self.closures is not None


class FrameTable(NamedTuple):
    """Observations without frames: z (M, 2), R (M, 2, 2), row of the sensor, true_id, label and appearance (M,) or
    None.
    """

    table: Table
    z: Array
    R: Array
    sensor: IntArray | None
    true_id: IntArray | None
    label: IntArray | None
    appearance: Appearance | None = None

    def by_sensor(self, sensor: IntArray, key: str) -> FrameTable:
        """Sorted by sensor (M,) within each frame; DataError unless `key` ascends."""
        self.table.require_ascending(key, strictly=False)
        by = np.lexsort((sensor, self.table.columns[key]))
        line = by + FIRST_ROW if self.table.line is None else self.table.line[by]
        return FrameTable(
            replace(self.table.part(by), line=line),
            self.z[by],
            self.R[by],
            sensor[by],
            None if self.true_id is None else self.true_id[by],
            None if self.label is None else self.label[by],
            None if self.appearance is None else self.appearance.only(by),
        )


def frames_of(table: Table, prior: MotionPrior | None = None) -> Motion:
    """Time (N,) and increments of a table with the columns of frames.csv, or those of a motion prior."""
    path, motion = table.path, (*MEAN, *COVARIANCE)
    columns = ("t", *motion) if prior is None else ("t",)
    if len(table) == 0:
        raise DataError.at(path, "no rows; at least one frame is needed", line=1)
    table.require_finite([name for name in (*columns, STAMP) if name in table])
    stamp = table.columns.get(STAMP)
    table.require_ascending("t", strictly=True)
    if prior is not None:
        for name in motion:
            if name in table:
                what = f"[motion] prior in {HEADER} states the increments; remove one of them"
                raise DataError.at(path, what, line=1, column=name)
        return Motion(table.columns["t"], prior.increments(table.columns["t"]), stamp)
    later = np.arange(len(table)) > 0
    for name in motion:
        what = "{} in row 0; the first frame has no motion, so 0 is needed"
        table.require((table.columns[name] == 0.0) | later, name, what)
    covariance = table.symmetric(COVARIANCE)
    require_semidefinite(table, covariance)
    return Motion(table.columns["t"], Increments(table.stack(MEAN), covariance), stamp)


def odometry_of(table: Table, model: VelocityModel, seen: Sequence[tuple[Table, str]]) -> tuple[Motion, int]:
    """Odometry t, v, omega preintegrated between the frames, the stamps of other tables among them; number of gaps."""
    if len(table) == 0:
        raise DataError.at(table.path, "no rows; at least one sample is needed", line=1)
    table.require_finite(("t", "v", "omega"))
    table.require_ascending("t", strictly=True)
    for part, key in seen:
        if key == "t":
            part.require_ascending("t", strictly=False)
    stamps = table.columns["t"]
    far = f"{{}} s is more than {LONGEST:g} s from the first odometry; stamps are in seconds"
    for part, key in ((table, "t"), *seen):
        part.require(np.abs(part.columns[key] - stamps[0]) <= LONGEST, key, far)
    at = np.concatenate([part.columns[key] for part, key in seen])
    both = np.concatenate([stamps, at])
    time = frame_times(at, both.min(), both.max())
    increments, gaps = preintegrate(model, stamps, table.columns["v"], table.columns["omega"], time)
    return Motion(time, increments), gaps


def observations_of(table: Table, header: Header, key: str) -> FrameTable:
    """Observations of a table with the columns of observations.csv, checked except for range and order of `key`."""
    table.require_finite((key,))
    table.require_finite([n for n in IDS if n in table], blank=True)
    z, R, sensor = observed(table, header.sensors)
    found = FrameTable(
        table,
        z,
        R,
        sensor,
        table.integers("true_id", CLUTTER, blank=UNKNOWN_ID) if "true_id" in table else None,
        table.integers("label", CLUTTER, blank=UNLABELLED) if "label" in table else None,
        looks.of_observations(table, sensor, [(s.sensor.label, s.looks) for s in header.sensors]),
    )
    return found if sensor is None else found.by_sensor(sensor, key)


def frames_in(table: Table, key: str, time: Array, *, by_stamp: bool | None = None) -> IntArray:
    """The frame (K,) of each row by a column: frame numbers or, of t, stamps among `time` (N,).

    `by_stamp`: that of an end of closures, which need not ascend.
    """
    if by_stamp or (by_stamp is None and key == "t"):
        return np.searchsorted(time, table.columns[key]).astype(np.int64)
    frame = table.integers(key, 0)
    table.require(frame < len(time), key, f"{{}} is out of range; there are frames 0 to {len(time) - 1}")
    if by_stamp is None:
        table.require_ascending(key, strictly=False)
    return frame


def instants(observations: Table, measured: PoseTables) -> list[tuple[Table, str]]:
    """Tables and their columns of stamps, whose instants are frames of a log with odometry.csv."""
    found = [(observations, "t")]
    if measured.fixes is not None:
        found.append((measured.fixes.table, "t"))
    if measured.closures is not None:
        found += [(measured.closures.table, end) for end in measured.closures.ends]
    return found


def inputs_of(
    header: Header, motion: Motion, frame: IntArray, observations: FrameTable, landmarks: LandmarkMap | None
) -> Inputs:
    """What estimators get; the covariance floor is applied."""
    seen, known = looks.together(observations.appearance, None if landmarks is None else landmarks.appearance)
    if landmarks is not None and known is not None:
        landmarks = replace(landmarks, appearance=known)
    covariance, floored = floor_covariances(motion.increments.covariance, header.covariance_floor)
    return Inputs(
        prior=header.prior,
        time=motion.time,
        increments=Increments(motion.increments.mean, covariance),
        observations=Observations(frame, observations.z, observations.R, sensor=observations.sensor, appearance=seen),
        sensor=header.sensors[0].sensor if header.sensors else RangeBearing(),
        sensors=tuple(s.sensor for s in header.sensors) if len(header.sensors) > 1 else (),
        map=landmarks,
        time_is_index=header.time_is_index,
        covariance_floor=header.covariance_floor,
        floored=header.floored + floored,
    )


def with_measured(
    inputs: Inputs, measured: PoseTables, key: str
) -> tuple[Inputs, tuple[IntArray | None, IntArray | None]]:
    """The inputs with fixes and closures, and the true inliers of both."""
    fixes, closures, time = measured.fixes, measured.closures, inputs.time
    inlier = None
    if fixes is not None:
        inputs = replace(inputs, fixes=fixes.at(frames_in(fixes.table, key, time)))
    if closures is not None:
        end1, end2 = (frames_in(closures.table, end, time, by_stamp=key == "t") for end in closures.ends)
        between, inlier = closures.between(end1, end2)
        inputs = replace(inputs, closures=between)
    return inputs, (None if fixes is None else fixes.inlier, inlier)


def truth_per_frame(table: Table | None, frames: int) -> Array | None:
    """True poses (N, 3) of each frame, NaN where unknown."""
    if table is None:
        return None
    if len(table) != frames:
        what = f"{len(table)} rows for {frames} frames; one row per frame is needed"
        raise table.error(min(len(table), frames + 1) - 1, None, what)
    return table.stack(POSE)


def stamped_truth(table: Table | None, at: Array) -> Array | None:
    """Stamped true poses interpolated at the frames; NaN where unknown."""
    if table is None:
        return None
    table.require_finite(("t",))
    table.require_ascending("t", strictly=True)
    return truth_at(table.columns["t"], table.stack(POSE), at)


def require_semidefinite(table: Table, matrices: Array) -> None:
    """Raise unless each covariance (K, 3, 3) is positive semidefinite, to 1e-12 of its trace."""
    eigenvalues = np.linalg.eigvalsh(matrices)
    fine = eigenvalues[:, 0] >= -1e-12 * eigenvalues.sum(axis=1)
    if not fine.all():
        row = int(np.argmin(fine))
        low, trace = eigenvalues[row, 0], eigenvalues[row].sum()
        what = f"the covariance is not positive semidefinite: smallest eigenvalue {low:.6g}, trace {trace:.6g}"
        raise table.error(row, f"{COVARIANCE[0]} to {COVARIANCE[-1]}", what)
