"""A robot log: the estimator's inputs and the referee's truth, kept apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data.columns.parts import parts_of_arrays
from data.inputs import UNLABELLED, Inputs, IntArray, LabelledObservations
from data.notice import Notice
from data.origin import Origins, assumed
from data.pictures import Evidence
from data.truth import UNKNOWN_ID, Truth
from data.words import table_html

ODOMETRY_KIND = "odometry_kind"
ODOMETRY_PERIOD, INTEGRATION = "odometry_period", "integration"
"""Keys of the source of a log from tables: velocities, poses, steps or ticks; of velocities their interval [s] and the
motion model by which they became increments."""
TRUTH_POSE = "truth_transform"  # Key of the same: pose of the truth's frame in the world
T = TypeVar("T", bound=NDArray[Any])


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """One log. `recorded` holds all that an estimator may be given; use `inputs()` to get it.

    Example:
        >>> print(log)
        >>> log.truth.pose.shape  # (N, 3)
    """

    name: str  # unique in a run; names its folder in the results
    recorded: Inputs  # inputs without labels
    truth: Truth  # the referee's reference
    label: IntArray | None = None  # (M,) the sensor's label of each observation; None: the true ids are the labels
    labels_are_sensed: bool = False  # they are read (e.g. barcodes): granting them grants no truth; gated by default
    source: Mapping[str, object] = field(default_factory=dict)  # provenance; free keys
    notes: tuple[str, ...] = ()  # what a reader should know (spans skipped, observations dropped), one sentence each
    evidence: Evidence | None = None  # of a log made from images, its detections
    asked: tuple[Notice, ...] = ()  # questions that only the recording raises (`data.questions.asked` has the others)
    origins: Origins = field(default_factory=dict)  # of noise, prior and so on, unless the recording states them

    @property
    def assumed_noise(self) -> tuple[str, ...]:
        """Noises that nobody stated, in words: covariances, NEES and NIS are relative to them."""
        return assumed(self.origins)

    @property
    def has_labels(self) -> bool:
        """Whether known association can be granted."""
        return self.granted is not None

    @property
    def clock(self) -> float:
        """Seconds from the start of the recording to `Inputs.time` 0; `slamref convert` counts from that start."""
        return float(cast("float", self.source.get("clock", 0.0)))

    @property
    def granted(self) -> IntArray | None:
        """The labels (M,) of known association: the sensor's, else the true ids; None: there are none."""
        if self.label is None and self.truth.landmark_of is not None:
            return np.where(self.truth.landmark_of == UNKNOWN_ID, UNLABELLED, self.truth.landmark_of)
        r = self.recorded
        if self.label is None and not len(r.observations.frame) and not (r.fixes is None and r.closures is None):
            return np.zeros(0, np.int64) if r.scans is None else None  # nothing is to be paired
        return self.label

    def inputs(self, *, labels: bool = False) -> Inputs:
        """The estimator's view, with labels only where the experiment grants known association."""
        if not labels:
            return self.recorded
        label = self.granted
        if label is None:
            raise ValueError(f"log {self.name!r} has no labels to grant")
        o = self.recorded.observations
        labelled = LabelledObservations(
            o.frame, o.z, o.R, label, self.labels_are_sensed, sensor=o.sensor, appearance=o.appearance
        )
        return replace(self.recorded, observations=labelled)

    @staticmethod
    def from_arrays(
        name: str, prior: tuple[ArrayLike, ArrayLike], sensor: Mapping[str, Any] | Sequence[Mapping[str, Any]],
        observations: ArrayLike, **more: Any,
    ) -> Log:  # fmt: skip
        """A log from arrays, checked as a log folder is (docs/log-folder.md); errors name array and row, from 0.

        Args:
            name: unique in a run.
            prior: mean (3,) of the first pose, and its covariance (3, 3) or sigmas (3,).
            sensor: the keys of [sensor] in log.toml, as in `{"kind": "range_bearing", "sigma": [0.1, 0.02]}`; or those
                of several sensors, each with a name.
            observations: (M, 3): frame from 0 (with `odometry`: time [s]), z1, z2, ascending.
            more: increments (N, 3), row 0 zero, with covariance (N, 3, 3), (3, 3) or sigmas (3,), and time (N,) [s]
                (None: frames without stamps); or odometry (K, 3): t, v, omega, with motion: the keys of [motion].
                R (M, 2, 2) or (2, 2) instead of the sensor's sigma. landmarks (L, 3): id, x, y, or (L, 5) with the
                standard deviations sx, sy. truth (N, 3), NaN where
                unknown (with odometry (K, 4): t, x, y, theta). true_id (M,): -1 false alarm, NaN unknown. label (M,),
                NaN unknown. labels_are_sensed: bool. observed_by (M,): names of sensors. kinds (L,) of landmarks.
                descriptor (M,), NaN not measured, and classes (M,), blank not read, with sensor's descriptor_sigma and
                class_error; landmark_descriptor (L,), landmark_classes (L,) where known.
                fixes, closures: columns of fixes.csv or closures.csv by name,
                each (K,) or one value for all rows, NaN blank, and sources, tables as [[fix]] or [[closure]], as in
                `{"frame": [0, 9], "kind": "position", "x": [0.0, 4.1], "y": [0.1, 3.9], "sources": [{"name": "gps",
                "sigma": [0.5, 0.5]}]}`.

        Raises:
            DataError: a wrong shape or value.

        Example:
            >>> log = slamref.Log.from_arrays(
            ...     "mine", (np.zeros(3), np.zeros(3)), {"kind": "relative_point", "sigma": [0.1, 0.1]},
            ...     [[0, 4.0, 1.0], [1, 3.0, 1.0]], increments=[[0, 0, 0], [1.0, 0, 0]], covariance=[0.1, 0.1, 0.02],
            ... )
            >>> len(log.recorded)
            2
        """
        return Log(name, **parts_of_arrays(name, prior, sensor, observations, **more)._asdict())

    def _facts(self) -> list[tuple[str, str]]:
        r, truth = self.recorded, self.truth
        span = "no stamps" if r.time_is_index else f"{r.time[-1] - r.time[0]:.1f} s"
        measured = []
        if r.fixes is not None:
            measured.append(("fixes", f"{len(r.fixes)} ({', '.join(s.name for s in r.fixes.sources)})"))
        if r.closures is not None:
            measured.append(("closures", f"{len(r.closures)} ({', '.join(r.closures.sources)})"))
        if r.scans is not None:
            measured.append(("scans", f"{len(r.scans.frame)} of {r.scans.ranges.shape[1]} beams"))
        if truth.relations is not None:
            measured.append(("reference relations", str(len(truth.relations))))
        return [
            ("frames", f"{len(r)} ({span})"), ("observations", str(len(r.observations.frame))), *measured,
            ("sensor", ", ".join(f"{s.label} ({s.name})" for s in r.sensors) or r.sensor.name),
            ("map", "none" if r.map is None else f"{len(r.map.id)} landmarks"),
            ("truth", f"in {truth.known_poses} frames" if truth.known_poses else "none"),
            ("labels", "yes" if self.has_labels and len(r.observations.frame) else "none"),
        ]  # fmt: skip

    def __repr__(self) -> str:
        return "\n".join([f"Log {self.name}", *(f"  {what}: {value}" for what, value in self._facts())])

    def _repr_html_(self) -> str:
        return table_html(f"Log {self.name}", self._facts())


def shortened(log: Log, n: int) -> Log:
    """The first n frames of a log; a shorter log unchanged."""
    r = log.recorded
    if len(r) <= n:
        return log
    m = int(r.start[n])
    fixes = None if r.fixes is None else r.fixes.before(n)
    closures = None if r.closures is None else r.closures.before(n)
    recorded = replace(
        r, time=r.time[:n], increments=r.increments.only(slice(n)), observations=r.observations.only(slice(m)),
        scans=None if r.scans is None else r.scans.only(r.scans.frame < n), fixes=fixes, closures=closures,
    )  # fmt: skip
    t = log.truth
    kept = t.relations
    if kept is not None:
        stamps = _rows(kept.frame_stamp, slice(n))
        kept = replace(replace(kept, frame_stamp=None).only((kept.row1 < n) & (kept.row2 < n)), frame_stamp=stamps)
    truth = replace(
        t, pose=_rows(t.pose, slice(n)), landmark_of=_rows(t.landmark_of, slice(m)), relations=kept,
        errors=None if t.errors is None else t.errors._replace(mean=t.errors.mean[:n], sigma=t.errors.sigma[:n]),
        left_out=tuple(w for w in t.left_out if w.first < n),
        fix_inlier=None if fixes is None else _rows(t.fix_inlier, slice(len(fixes))),
        closure_inlier=None if closures is None else _rows(t.closure_inlier, slice(len(closures))),
    )  # fmt: skip
    notes = (*log.notes, f"Only the first {n} frames (quick).")
    return replace(log, recorded=recorded, truth=truth, label=_rows(log.label, slice(m)), notes=notes)


def _rows(values: T | None, rows: slice) -> T | None:
    return None if values is None else cast("T", values[rows])


def folder_name(log_name: str) -> str:
    """A log's name as a folder: `:`, `+` and `/` become `_`."""
    return log_name.replace(":", "_").replace("+", "_").replace("/", "_")
