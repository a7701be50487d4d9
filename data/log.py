"""A robot log: the estimator's inputs and the referee's truth, with the firewall between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from data.inputs import UNLABELLED, Inputs, IntArray, LabelledObservations, Observations, Scans
from data.pictures import Evidence
from data.se2 import dead_reckoned
from data.truth import UNKNOWN_ID, Relations, Truth


@dataclass(frozen=True, eq=False)
class Log:
    """One log. `recorded` holds everything an estimator could be given; ask for it through `inputs()`.

    Attributes:
        name: unique in a run; names its folder in the results.
        recorded: inputs without labels.
        truth: what the referee compares with.
        label: (M,) what the sensor claims each observation shows, where that can differ from the truth; None: the
            true ids serve as labels.
        labels_are_sensed: the ids come from the sensor (e.g. barcodes), so granting them grants no truth, and some may
            be misread: pairings by them are gated unless somebody says otherwise.
        source: how the log was made (for convert, inspect and provenance); free keys.
        notes: what a reader should know (spans skipped, readings dropped), one sentence each.
        evidence: of a log made from images, what was found in them.
    """

    name: str
    recorded: Inputs
    truth: Truth
    label: IntArray | None = None
    labels_are_sensed: bool = False
    source: Mapping[str, object] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    evidence: Evidence | None = None

    @property
    def has_labels(self) -> bool:
        """Whether known association can be granted."""
        return self.label is not None or self.truth.landmark_of is not None

    @property
    def granted(self) -> IntArray | None:
        """The labels (M,) that known association is granted: the sensor's, else the true ids; None: there are none."""
        if self.label is None and self.truth.landmark_of is not None:
            return np.where(self.truth.landmark_of == UNKNOWN_ID, UNLABELLED, self.truth.landmark_of)
        return self.label

    def inputs(self, *, labels: bool = False) -> Inputs:
        """The estimator's view. Labels are part of it only if the experiment grants known association."""
        if not labels:
            return self.recorded
        label = self.granted
        if label is None:
            raise ValueError(f"log {self.name!r} has no labels to grant")
        o: Observations = self.recorded.observations
        return replace(
            self.recorded, observations=LabelledObservations(o.frame, o.z, o.R, label, self.labels_are_sensed)
        )

    def _repr_html_(self) -> str:
        """What a notebook shows: what the log holds, and the true path or else dead reckoning."""
        from data import card

        r, truth = self.recorded, self.truth
        if truth.pose is not None:
            paths = [card.Path("true path", truth.pose[:, :2], card.BLACK)]
        else:
            reckoned = dead_reckoned(r.prior.mean, r.increments.mean)
            paths = [card.Path("dead reckoning", reckoned[:, :2], card.GREY)]
        known = truth.landmarks if truth.landmarks is not None else r.map
        points = [] if known is None or not r.sensor.sees_points else [card.Points("landmarks", known.xy, card.GREY)]
        span = "no stamps" if r.time_is_index else f"{r.time[-1] - r.time[0]:.1f} s"
        facts = [
            ("frames", f"{len(r)} ({span})"),
            ("observations", str(len(r.observations.frame))),
            ("sensor", r.sensor.name),
            ("map", "none" if r.map is None else f"{len(r.map.id)} landmarks"),
            ("truth", f"in {truth.known_poses} frames" if truth.known_poses else "none"),
            ("labels", "yes" if self.has_labels else "none"),
        ]
        return card.card(f"Log {self.name}", facts, paths, points)


def shortened(log: Log, n: int) -> Log:
    """The first n frames of a log, for a quick look; a shorter log as it is."""
    r = log.recorded
    if len(r) <= n:
        return log
    o = r.observations
    m = int(r.start[n])
    recorded = replace(
        r,
        time=r.time[:n],
        increments=replace(r.increments, mean=r.increments.mean[:n], covariance=r.increments.covariance[:n]),
        observations=replace(o, frame=o.frame[:m], z=o.z[:m], R=o.R[:m]),
        scans=_first_scans(r.scans, n),
    )
    t = log.truth
    truth = replace(
        t,
        pose=None if t.pose is None else t.pose[:n],
        landmark_of=None if t.landmark_of is None else t.landmark_of[:m],
        relations=_first_relations(t.relations, n),
        errors=None if t.errors is None else t.errors._replace(mean=t.errors.mean[:n], sigma=t.errors.sigma[:n]),
    )
    label = None if log.label is None else log.label[:m]
    return replace(
        log, recorded=recorded, truth=truth, label=label, notes=(*log.notes, f"Only the first {n} frames (quick).")
    )


def _first_scans(scans: Scans | None, n: int) -> Scans | None:
    """Those of the first n frames."""
    if scans is None:
        return None
    k = int(np.searchsorted(scans.frame, n))
    return replace(scans, frame=scans.frame[:k], ranges=scans.ranges[:k])


def _first_relations(relations: Relations | None, n: int) -> Relations | None:
    """Those within the first n frames."""
    if relations is None:
        return None
    r = relations
    inside = (r.row1 < n) & (r.row2 < n)
    return Relations(
        row1=r.row1[inside],
        row2=r.row2[inside],
        relative=r.relative[inside],
        exact=None if r.exact is None else r.exact[inside],
        stamp=None if r.stamp is None else r.stamp[inside],
        frame_stamp=None if r.frame_stamp is None else r.frame_stamp[:n],
    )


def folder_name(log_name: str) -> str:
    """A log's name as a folder: `:` and `+` become `_`."""
    return log_name.replace(":", "_").replace("+", "_").replace("/", "_")
