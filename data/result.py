"""What an estimator hands to the referee: trajectories, map, decisions, and whether it got to the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from data.inputs import IntArray, Locked
from data.notice import Notice
from data.se2 import Array

NEW = -1
"""Decision: the observation initializes a new landmark (SLAM)."""
DISCARD = -2
"""Decision: the observation is not used."""


class PoseEstimate(NamedTuple):
    """Mean (3,) and world-frame additive covariance (3, 3) of the newest pose."""

    mean: Array
    covariance: Array


class MapState(NamedTuple):
    """Landmarks as an estimator holds them: number (L,), xy (L, 2), covariance (L, 2, 2)."""

    number: IntArray
    xy: Array
    covariance: Array


class Updated(NamedTuple):
    """What an update did with the observations of a frame.

    used: (m,) bool, entered the update; created: (m,) number of the landmark initialized, -1 for none;
    nis, dof, log_likelihood: of the innovations used (NaN where the estimator forms none);
    white: (m, 2) each of them in units of its own standard deviation, NaN where not used (None: not formed);
    moments: mean and variance that the gates let expect of `nis` (None: nothing was gated, dof and 2 dof).
    """

    used: NDArray[np.bool_]
    created: IntArray
    nis: float
    dof: int
    log_likelihood: float
    white: Array | None = None
    moments: tuple[float, float] | None = None


class Systematics(NamedTuple):
    """Systematic errors as estimated, by frame: names (p,), mean (N, p) and standard deviation sigma (N, p)."""

    names: tuple[str, ...]
    mean: Array
    sigma: Array


class Finished(NamedTuple):
    """The end of a run: final trajectory (None for a filter), last map (None in localization), and (sum of NIS, dof).

    A smoother's sum is the minimum of its cost, see `Run.total_nis`; None where it has none to offer. `iterations` and
    `last_step_sigma` as of `Run`. `systematic`: a smoother's last word on the systematic errors, if it estimates any.
    """

    final: Trajectory | None
    map: MapState | None
    total_nis: tuple[float, int] | None = None
    iterations: int | None = None
    last_step_sigma: float | None = None
    systematic: Systematics | None = None


@dataclass(frozen=True, eq=False)
class Trajectory(Locked):
    """Poses (N, 3) and covariances (N, 3, 3): world frame, error additive in [x, y, theta]."""

    pose: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class MapEstimate(Locked):
    """Landmarks of a run: number (L,), xy (L, 2), covariance (L, 2, 2), first_frame (L,), times_seen (L,).

    A landmark number is its order of creation in SLAM and the map's own id in localization.
    """

    number: IntArray
    xy: Array
    covariance: Array
    first_frame: IntArray
    times_seen: IntArray

    def __len__(self) -> int:
        return len(self.number)


def map_estimate(state: MapState, frame: IntArray, decisions: IntArray, created: IntArray) -> MapEstimate:
    """The map, with when and how often each landmark was seen by the given decisions; `frame` (M,)."""
    number = np.where(created >= 0, created, decisions)
    seen = number >= 0
    size = int(max(number.max(initial=-1), np.max(state.number, initial=-1))) + 1
    times = np.bincount(number[seen], minlength=size).astype(np.int64)
    first = np.full(size, -1, np.int64)
    np.maximum.at(first, number[created >= 0], frame[created >= 0])
    n = np.asarray(state.number, np.int64)
    return MapEstimate(n, state.xy, state.covariance, first[n], times[n])


@dataclass(frozen=True, eq=False)
class Innovations(Locked):
    """Per frame (N,): NIS, its degrees of freedom, log-likelihood of the accepted innovations; NaN: not formed.

    `white` (M, 2): each observation's innovation in units of its own standard deviation; NaN: not used, or not formed.
    """

    nis: Array
    dof: IntArray
    log_likelihood: Array
    white: Array


class Event(NamedTuple):
    """A decision that was revised: in which frame, about which observation (row of the log), from what to what, why.

    From a landmark to `NEW`: in the end the landmark begins with this observation.
    """

    frame: int
    observation: int
    old: int
    new: int
    why: str


def revised(decisions: IntArray, events: Sequence[Event]) -> IntArray:
    """Final decisions (M,): those made online, with all revisions applied in their order."""
    final = decisions.copy()
    for e in events:
        final[e.observation] = e.new
    return final


def surviving(final: IntArray, created: IntArray) -> IntArray:
    """Which landmark (M,) each observation initialized by the final decisions, -1 where none of it is left."""
    return np.where(final == NEW, created, -1)


class Failure(NamedTuple):
    """Where and why an estimator stopped: `status` is `diverged` or `incomplete`; or is not believed: `implausible`.

    `trace`: the traceback, where foreign code crashed.
    """

    status: str
    frame: int
    notice: Notice
    trace: str = ""

    @property
    def why(self) -> str:
        """The reason in words."""
        from data.words import sentence

        return sentence(self.notice)

    @property
    def text(self) -> str:
        """Frame and reason in words; a run that was not stopped says so."""
        return f"frame {self.frame}: {'' if self.status != 'implausible' else 'implausible, '}{self.why}"


CHI_SQUARE = (1.0, 2.0)
"""Mean and variance per degree of freedom of innovations that nothing was left out of."""


@dataclass(frozen=True, eq=False)
class Run(Locked):
    """One estimator over one log.

    Attributes:
        estimator, association, task: names as in the result files.
        online: what was known at each instant (None for a batch smoother).
        final: after all data (None for a filter).
        map: the last map (None in localization).
        decisions: (M,) landmark number, `NEW` or `DISCARD`, as made online.
        final_decisions: (M,) after all revisions.
        created: (M,) number of the landmark an observation initialized, -1 where it initialized none.
        innovations: per-frame innovation statistics (None: not formed).
        total_nis: (sum of NIS, degrees of freedom) over the run, or None; for a smoother the minimum of its
            cost, which for linear models is the same number (the innovations are the whitened residuals).
        gated: mean and variance, per degree of freedom, of the squared innovations that the gates of the association
            let a right filter use; (1, 2) where nothing was gated.
        state_size: (N,) length of the state vector after each frame (None for a batch smoother).
        seconds: wall time of the estimation alone.
        failure: None when it got to the end; its arrays are then complete.
        notes: what a reader of its results should know.
        removed: (L,) by landmark number, frame after which it was no longer in the map, -1: it stayed (None: nothing
            was ever removed). If it was retracted, its observations are discarded in `final_decisions`.
        events: decisions that were revised later, in the order of revision.
        iterations: of a smoother's last optimization, in all its phases (None: there was none).
        last_step_sigma: largest component of the Newton step that it left, in standard deviations of that component;
            next to nothing at an optimum.
        doubt: it got to the end, but with a number that no honest run gives (`implausible`): from which frame, and why.
        errors_online, errors_final: systematic errors as each frame knew them, and after all data (None: none were
            estimated).
        watched: what an observer of the replay wrote down, for those who know its kind; no part of the result.
        walls: the landmarks are no points (x, y) but walls (rho, alpha).
        begun: (M,) as `created`, by the final decisions, where these changed what a landmark begins with (else None).
        gated_final: as `gated`, of the final decisions, where all were made anew (None: there is no difference).
    """

    estimator: str
    association: str
    task: str
    online: Trajectory | None
    final: Trajectory | None
    map: MapEstimate | None
    decisions: IntArray
    final_decisions: IntArray
    created: IntArray
    innovations: Innovations | None = None
    total_nis: tuple[float, int] | None = None
    state_size: IntArray | None = None
    seconds: float = float("nan")
    failure: Failure | None = None
    notes: tuple[Notice, ...] = ()
    removed: IntArray | None = None
    events: tuple[Event, ...] = ()
    gated: tuple[float, float] = CHI_SQUARE
    iterations: int | None = None
    last_step_sigma: float | None = None
    implausible: Failure | None = None
    errors_online: Systematics | None = None
    errors_final: Systematics | None = None
    watched: object | None = None
    walls: bool = False
    begun: IntArray | None = None
    gated_final: tuple[float, float] | None = None
    handed_in: ClassVar[bool] = False
    """Whether another program made it."""

    @property
    def decides(self) -> bool:
        """Whether it decided about the observations of its log."""
        return self.association != "none"

    @property
    def initialized(self) -> IntArray:
        """Which landmark (M,) each observation initialized by the final decisions, -1 for none."""
        return surviving(self.final_decisions, self.created) if self.begun is None else self.begun

    @property
    def flaw(self) -> Failure | None:
        """Why none of its numbers may enter an average, a comparison or a headline: `failure`, or else `doubt`."""
        return self.failure if self.failure is not None else self.implausible

    @property
    def status(self) -> str:
        """`ok`, or that of its flaw: `diverged`, `incomplete` or `implausible`."""
        return "ok" if self.flaw is None else self.flaw.status

    @property
    def errors(self) -> Systematics | None:
        """The last word on the systematic errors: after all data, else online; None: none were estimated."""
        return self.errors_final if self.errors_final is not None else self.errors_online

    @property
    def phases(self) -> tuple[str, ...]:
        """The phases this run has a trajectory for."""
        return tuple(p for p in ("online", "final") if getattr(self, p) is not None)

    def trajectory(self, phase: str) -> Trajectory:
        """The trajectory of a phase the run has."""
        found = {"online": self.online, "final": self.final}[phase]
        if found is None:
            raise ValueError(f"{self.estimator} has no {phase} trajectory")
        return found

    def _repr_html_(self) -> str:
        """What a notebook shows: who, how far, what was decided, paths and map."""
        from data import card

        drawn = {"online": card.WARM, "final": card.COOL}
        paths = [card.Path(p, self.trajectory(p).pose[:, :2], drawn[p]) for p in self.phases]
        points = [] if self.map is None or self.walls else [card.Points("map", self.map.xy, card.BLACK)]
        facts = [
            ("task", self.task),
            ("association", self.association),
            ("status", self.status),
            ("frames", str(len(self.trajectory(self.phases[0]).pose)) if self.phases else "0"),
            ("phases", ", ".join(self.phases)),
            ("observations used", f"{int((self.final_decisions >= 0).sum())} of {len(self.final_decisions)}"),
        ]
        if self.map is not None:
            facts.append(("landmarks", str(len(self.map))))
        if self.flaw is not None:
            facts.append(("why", self.flaw.text))
        return card.card(f"Run of {self.estimator}", facts, paths, points)
