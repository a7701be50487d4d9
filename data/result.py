"""An estimator's result: trajectories, map, decisions, and whether it finished."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data.inputs import IntArray, LandmarkMap
from data.locked import Locked
from data.notice import Notice
from data.pose_measurements import PoseUpdated
from data.se2 import Array
from data.words import sentence, table_html

NEW = -1  # Decision about an observation: it initializes a new landmark (SLAM)
DISCARD = -2  # Decision about an observation: it is rejected, and neither updates nor initializes a landmark


class PoseEstimate(NamedTuple):
    """The newest pose: mean (3,), covariance (3, 3) of its additive error in the world frame."""

    mean: Array
    covariance: Array


class MapState(NamedTuple):
    """An estimator's landmarks: number (L,), xy (L, 2), covariance (L, 2, 2)."""

    number: IntArray
    xy: Array
    covariance: Array


class Updated(NamedTuple):
    """Result of an update with the observations of a frame.

    used: (m,) accepted observations; created: (m,) number of the landmark initialized, -1 for none;
    nis, dof, log_likelihood: of the innovations used (NaN where the estimator forms none);
    white: (m, 2) innovations over their standard deviations, NaN where not used (None: not formed);
    moments: mean and variance of `nis` expected behind the gates (None: no gate, dof and 2 dof).
    """

    used: NDArray[np.bool_]
    created: IntArray
    nis: float
    dof: int
    log_likelihood: float
    white: Array | None = None
    moments: tuple[float, float] | None = None


class Systematics(NamedTuple):
    """Estimated systematic errors by frame: names (p,), mean (N, p), standard deviation sigma (N, p)."""

    names: tuple[str, ...]
    mean: Array
    sigma: Array


class Finished(NamedTuple):
    """The end of a run."""

    final: Trajectory | None  # None for a filter
    map: MapState | None  # None in an exact map
    total_nis: tuple[float, int] | None = None
    iterations: int | None = None
    last_step_sigma: float | None = None
    systematic: Systematics | None = None
    fixes: PoseUpdated | None = None  # `fixes_final` and `closures_final` of the `Run`; all others as there
    closures: PoseUpdated | None = None


@dataclass(frozen=True, eq=False)
class Trajectory(Locked):
    """Poses (N, 3) and covariances (N, 3, 3): world frame, error additive in [x, y, theta]."""

    pose: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class MapEstimate(Locked):
    """Landmarks of a run: number (L,), xy (L, 2), covariance (L, 2, 2), first_frame (L,), times_seen (L,). A landmark's
    number is its order of creation in SLAM, and the map's id in localization.
    """

    number: IntArray
    xy: Array
    covariance: Array
    first_frame: IntArray
    times_seen: IntArray

    def __len__(self) -> int:
        return len(self.number)


def map_with(known: LandmarkMap, estimated: MapState) -> MapState:
    """An uncertain map with those of its landmarks that were estimated, by id; the others as in the map."""
    sigma = np.zeros((len(known.id), 2)) if known.sigma is None else known.sigma
    xy, covariance, rows = known.xy.copy(), sigma[:, :, None] ** 2 * np.eye(2), known.rows(estimated.number)
    xy[rows], covariance[rows] = estimated.xy, estimated.covariance
    return MapState(known.id, xy, covariance)


def map_estimate(state: MapState, frame: IntArray, decisions: IntArray, created: IntArray) -> MapEstimate:
    """The map, with first frame and number of observations of each landmark by the given decisions; `frame` (M,)."""
    ids, row, times = np.unique(np.where(created >= 0, created, decisions), return_index=True, return_counts=True)
    of = dict(zip(ids.tolist(), zip(frame[row].tolist(), times.tolist(), strict=True), strict=True))
    n = np.asarray(state.number, np.int64)
    seen = [of.get(i, (-1, 0)) for i in n.tolist()]
    return MapEstimate(n, state.xy, state.covariance, *np.array(seen, np.int64).reshape(-1, 2).T)


@dataclass(frozen=True, eq=False)
class Innovations(Locked):
    """Per frame (N,): NIS, its degrees of freedom, and log-likelihood of the accepted innovations; NaN: not formed.
    `white` (M, 2): each innovation over its standard deviation; NaN: not used, or not formed.
    """

    nis: Array
    dof: IntArray
    log_likelihood: Array
    white: Array


class Event(NamedTuple):
    """A revised decision."""

    frame: int
    observation: int  # row of the log
    old: int
    new: int  # `NEW` after a landmark: that begins with this observation in the end
    why: str


def revised(decisions: IntArray, events: Sequence[Event]) -> IntArray:
    """Final decisions (M,): the online ones with all revisions in their order."""
    final = decisions.copy()
    for e in events:
        final[e.observation] = e.new
    return final


def surviving(final: IntArray, created: IntArray) -> IntArray:
    """Landmark (M,) that each observation initialized by the final decisions, -1 for none."""
    return np.where(final == NEW, created, -1)


class Failure(NamedTuple):
    """Where and why an estimator stopped (`diverged`, `incomplete`) or is `implausible`; `trace`: of foreign code."""

    status: str
    frame: int
    notice: Notice
    trace: str = ""

    @property
    def why(self) -> str:
        """The reason in words."""
        return sentence(self.notice)

    @property
    def text(self) -> str:
        """Frame and reason in words, marked if the run was only implausible."""
        return f"frame {self.frame}: {'' if self.status != 'implausible' else 'implausible, '}{self.why}"


CHI_SQUARE = (1.0, 2.0)  # Mean and variance per degree of freedom of ungated innovations


@dataclass(frozen=True, eq=False)
class Run(Locked):
    """One estimator over one log."""

    estimator: str  # as in the result files, like the next two
    association: str
    task: str
    online: Trajectory | None  # estimates at each instant (None for a batch smoother)
    final: Trajectory | None  # after all data (None for a filter)
    map: MapEstimate | None  # the last map; in localization that of an uncertain map as estimated, in an exact one None
    decisions: IntArray  # (M,) landmark number, `NEW` or `DISCARD`, as made online
    final_decisions: IntArray  # (M,) after all revisions; observations of a retracted landmark are discarded
    created: IntArray  # (M,) number of the landmark an observation initialized, -1 for none
    innovations: Innovations | None = None  # per-frame statistics (None: not formed)
    total_nis: tuple[float, int] | None = None  # sum, dof; of a smoother: its least cost, equal in linear models
    state_size: IntArray | None = None  # (N,) length of the state vector after each frame (None for a batch smoother)
    seconds: float = float("nan")  # wall time of the estimation alone
    failure: Failure | None = None  # None if it finished; its arrays are then complete
    notes: tuple[Notice, ...] = ()  # notices for readers of its results
    removed: IntArray | None = None  # (L,) by landmark number, last frame in the map, -1: not removed (None: none was)
    events: tuple[Event, ...] = ()  # revised decisions, in the order of revision
    gated: tuple[float, float] = CHI_SQUARE  # mean and variance per degree of freedom of what the gates let pass
    iterations: int | None = None  # of a smoother's last optimization, over all phases (None: none)
    last_step_sigma: float | None = None  # largest component of the last Newton step, in sigmas; near 0 at an optimum
    implausible: Failure | None = None  # it finished, but with a physically impossible value: from which frame, and why
    errors_online: Systematics | None = None  # systematic errors by frame (None: not estimated)
    errors_final: Systematics | None = None  # the same after all data
    watched: object | None = None  # record of an observer of the replay; no part of the result
    walls: bool = False  # landmarks are walls (rho, alpha) instead of points
    begun: IntArray | None = None  # (M,) as `created`, by the final decisions, where these changed it (else None)
    gated_final: tuple[float, float] | None = None  # as `gated`, of the final decisions, where all were revised
    left: IntArray | None = None  # (l,) numbers of landmarks in the map that left the world earlier (None: not known)
    fixes: PoseUpdated | None = None  # what became of the log's fixes online (None: it has none, or they were not used)
    closures: PoseUpdated | None = None  # and of its closures
    fixes_final: PoseUpdated | None = None  # after all data, where that differs (`gnc`, or a smoother's residuals)
    closures_final: PoseUpdated | None = None
    handed_in: ClassVar[bool] = False  # Whether it is another program's result

    @property
    def decides(self) -> bool:
        """Whether it makes association decisions."""
        return self.association != "none"

    def counts(self, phase: str) -> dict[str, int]:
        """Numbers of accepted and rejected observations by a phase's decisions, and others as in metrics.csv."""
        if not self.decides:
            return {}
        decisions = self.decisions if phase == "online" else self.final_decisions
        return {"accepted": int((decisions >= 0).sum()), "rejected": int((decisions == DISCARD).sum())}

    @property
    def initialized(self) -> IntArray:
        """Landmark (M,) that each observation initialized by the final decisions, -1 for none."""
        return surviving(self.final_decisions, self.created) if self.begun is None else self.begun

    @property
    def flaw(self) -> Failure | None:
        """Why its numbers enter no average, comparison or headline: `failure`, or else `implausible`."""
        return self.failure if self.failure is not None else self.implausible

    @property
    def status(self) -> str:
        """`ok`, or the status of its flaw: `diverged`, `incomplete` or `implausible`."""
        return "ok" if self.flaw is None else self.flaw.status

    @property
    def errors(self) -> Systematics | None:
        """Systematic errors after all data, else online; None: not estimated."""
        return self.errors_final if self.errors_final is not None else self.errors_online

    @property
    def phases(self) -> tuple[str, ...]:
        """Phases that have a trajectory."""
        return tuple(p for p in ("online", "final") if getattr(self, p) is not None)

    def trajectory(self, phase: str) -> Trajectory:
        """The trajectory of a phase."""
        found = {"online": self.online, "final": self.final}[phase]
        if found is None:
            raise ValueError(f"{self.estimator} has no {phase} trajectory")
        return found

    def _repr_html_(self) -> str:
        """Notebook view: settings, status, and numbers of things."""
        facts = [
            ("task", self.task), ("association", self.association), ("status", self.status),
            ("frames", str(len(self.trajectory(self.phases[0]).pose)) if self.phases else "0"),
            ("phases", ", ".join(self.phases)),
            ("observations used", f"{int((self.final_decisions >= 0).sum())} of {len(self.final_decisions)}"),
        ]  # fmt: skip
        if self.map is not None:
            facts.append(("landmarks", str(len(self.map))))
        if self.flaw is not None:
            facts.append(("why", self.flaw.text))
        return table_html(f"Run of {self.estimator}", facts)
