"""The corridor lab in numbers: its logs by condition (people, odometry), and each of its runs in detail."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import scipy

from data.inputs import CLUTTER
from data.log import Log
from data.result import NEW, Run
from data.se2 import Array, between, compose, wrap_angle
from data.truth_windows import unscored
from eval.judgement.judgement import judge
from eval.referee.confusion import OUTCOMES
from eval.referee.errors import landmark_true_ids, position_distance, rms
from eval.referee.result_files import rows_of, value_of
from eval.referee.score import Scores, Trial, confusion_of
from wings.labs.plan import switched_on

ODOMETRY, PEOPLE, BLIND, BLIND_PEOPLE = (False, True), (True, True), (False, False), (True, False)
"""(people, odometry) of the lab's logs."""
NAMES = {
    "nn": "NN", "singles": "SINGLES", "jcbb": "JCBB", "jcbb-first": "JCBB", "known": "known association",
    "jcbb-hindsight": "JCBB in hindsight",
}  # fmt: skip
JCBB = ("jcbb-first", "jcbb")  # the lab's JCBB, and what stands for it where that was not run
METHODS = ("known", "nn", "singles", "jcbb-first", "jcbb", "jcbb-hindsight")
OWN_DECISIONS = ("ekf", "isam2")  # Estimators whose decisions answer the questions, the first that reached its end


@dataclass(frozen=True)
class Lab:
    """Trials of one corridor, by what was switched on: (people, odometry); and those with map maintenance."""

    trials: dict[tuple[bool, bool], Trial]
    maintained: dict[tuple[bool, bool], Trial]

    def find(self, switches: tuple[bool, bool], *names: str, maintained: bool = False) -> "Shown | None":
        """The first finished run with one of these associations: the filter's, or else iSAM2's."""
        trial = (self.maintained if maintained else self.trials).get(switches)
        if trial is not None:
            for name, estimator in itertools.product(names, OWN_DECISIONS):
                run = trial.find(estimator, name)
                if run is not None and run.failure is None:
                    return Shown(trial, run)
        return None


class Shown(NamedTuple):
    """A run and the trial it belongs to."""

    trial: Trial
    run: Run

    @property
    def log(self) -> Log:
        """Its log."""
        return self.trial.log


@dataclass(frozen=True)
class Pairings:
    """A run's decisions (online) looked at more closely; distances in m, NaN where there is nothing to measure."""

    observations: int  # their number
    tp: int  # tp to missed: the referee's counts of them
    tn: int
    fp: int
    fn: int
    spurious: int
    duplicate: int
    missed: int
    recall: float  # of all that could be paired
    neighbour: int  # pairings with the landmark of another point, though the right one was in the map
    copy: int  # pairings with a second landmark of the right point
    ghost: int  # points paired with a landmark that was initialized on a person
    clutter: int  # observations of people
    clutter_paired: int
    clutter_initializing: int  # a landmark
    clutter_again: int  # paired with a landmark that was initialized on a person
    first_wrong: int | None  # frame of the first FP, None if there is none
    before: float  # before, after: RMS position error in the frames before it, and from it on
    after: float
    apart: float  # median distance of the points confused
    off: float  # median distance of those observations, placed from the predicted pose, from their own point

    @property
    def wrong(self) -> int:
        """Decisions that are wrong."""
        return self.fp + self.fn


@dataclass(frozen=True)
class Judged:
    """A run that reached its end as the answers tell of it; NaN: not known."""

    log: str  # log to status: as in metrics.csv; name: as the lab calls the association
    estimator: str
    association: str
    status: str
    usable: bool  # by the judgement of the log
    people: bool  # with odometry and maintained: its condition
    odometry: bool
    maintained: bool
    implausible_from: int | None  # frame, None if it is plausible
    rmse: float  # of the position [m], as the next two in the first phase
    inside: float  # share of the frames with the position inside 3 sigma
    nees: float  # mean of the pose
    largest: float  # largest, last: m, position error at most and in the last frame
    last: float
    reach: float  # m from its start, at most
    pairings: Pairings | None  # None of a batch smoother, which decides nothing itself
    landmarks: int  # in the map at the end
    removed: int  # before, seen only once
    removed_people: int  # of these, on people
    state: float  # mean length of the state
    entries: float  # of its covariance, summed over the frames
    # counts of TP, TN, FP and FN of the final decisions; empty where no outcome was revised
    revised: Mapping[str, int] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What the lab calls its association method."""
        return NAMES.get(self.association, self.association)

    @property
    def condition(self) -> str:
        """What was switched on, in words."""
        return condition(self.people, self.odometry, self.maintained)

    @property
    def p(self) -> Pairings:
        """Its pairings, of a run that decided."""
        assert self.pairings is not None
        return self.pairings


def condition(people: bool, odometry: bool, maintained: bool) -> str:
    """A condition of the lab in words."""
    switches = (("people", people), ("no odometry", not odometry), ("maintained", maintained))
    return ", ".join(what for what, on in switches if on) or "no people"


def find_lab(trials: Sequence[Trial]) -> Lab | None:
    """Trials of SLAM on logs with true ids, and true poses of all frames that are scored, as one lab; None: none."""
    lab = Lab({}, {})
    for trial in trials:
        t = trial.log.truth
        if trial.task != "slam" or t.landmark_of is None or t.pose is None:
            continue
        known = np.isfinite(t.pose).all(axis=1)
        if not known.any() or not (known | unscored(trial.log, trial.log.recorded.time)).all():
            continue
        if trial.variant_of is None:
            lab.trials.setdefault(switched_on(trial.log), trial)
        elif any(r.removed is not None for r in trial.runs):
            lab.maintained.setdefault(switched_on(trial.log), trial)
    return lab if lab.trials else None


def maintained_pair(lab: Lab) -> tuple[Shown, Shown] | None:
    """Runs without and with map maintenance: JCBB where there are people, other methods if it was not run."""
    for switches in (PEOPLE, *lab.maintained):
        for names in (JCBB, ("nn",), ("singles",)):
            plain, kept = lab.find(switches, *names), lab.find(switches, *names, maintained=True)
            if plain is not None and kept is not None and plain.run.estimator == kept.run.estimator:
                return plain, kept
    return None


def look(run: Run, log: Log) -> Pairings:
    """The closer look at a run that has an online trajectory, on a log with true poses and ids."""
    counts, truth = confusion_of(run, log, "online"), log.truth
    assert counts is not None
    assert truth.landmark_of is not None
    assert truth.pose is not None
    own, o = truth.landmark_of, log.recorded.observations
    paired = run.decisions >= 0
    taken = np.full(len(own), CLUTTER - 1, np.int64)
    taken[paired] = landmark_true_ids(run.created, truth, run.decisions[paired])
    wrong = paired & (counts.ground_truth != run.decisions)
    had = counts.ground_truth >= 0
    clutter = own == CLUTTER
    confused = np.flatnonzero(wrong & (own >= 0) & (taken >= 0) & (taken != own))
    frames = o.frame[wrong]
    first = int(frames.min()) if len(frames) else None
    path = run.trajectory("online").pose
    error = position_distance(path, truth.pose)
    split = len(error) if first is None else first
    apart, off = np.full(len(confused), np.nan), np.full(len(confused), np.nan)
    if truth.landmarks is not None and len(confused):
        own_xy, taken_xy = (truth.landmarks.positions(ids[confused]) for ids in (own, taken))
        # poses that a filter with this path expected before it saw anything in the frame
        ahead = np.asarray(compose(path[:-1], log.recorded.increments.mean[1:]))
        expected = np.concatenate([log.recorded.prior.mean[None], ahead])
        placed = log.recorded.sensor.inverse(expected[o.frame[confused]], o.z[confused])[0]
        apart, off = np.hypot(*(own_xy - taken_xy).T), np.hypot(*(placed - own_xy).T)
    return Pairings(
        len(own),
        **{c: getattr(counts, c) for c in ("tp", "tn", "fp", "fn", "spurious", "duplicate", "missed", "recall")},
        neighbour=int((wrong & had & (taken >= 0) & (taken != own)).sum()),
        copy=int((wrong & had & (taken == own)).sum()), ghost=int((wrong & ~clutter & (taken == CLUTTER)).sum()),
        clutter=int(clutter.sum()), clutter_paired=int((clutter & paired).sum()),
        clutter_initializing=int((clutter & (run.decisions == NEW)).sum()),
        clutter_again=int((clutter & paired & (taken == CLUTTER)).sum()), first_wrong=first,
        before=rms(error[:split]) if split else math.nan,
        after=rms(error[split:]) if split < len(error) else math.nan,
        apart=float(np.median(apart[np.isfinite(apart)])) if np.isfinite(apart).any() else math.nan,
        off=float(np.median(off[np.isfinite(off)])) if np.isfinite(off).any() else math.nan,
    )  # fmt: skip


def reach(path: Array) -> float:
    """Largest distance [m] of a path (N, 3) from its first known position."""
    xy = path[np.isfinite(path).all(axis=1), :2]
    return float(np.max(np.hypot(*(xy - xy[:1]).T)))


def true_against_stated(log: Log) -> dict[str, Any]:
    """True motions against those that the inputs state, the first frame aside.

    `distance` is their mean Mahalanobis distance by the covariances stated, `within` of `count` are inside the 99 %
    ellipsoid, and `reasonable` says whether most are.
    """
    assert log.truth.pose is not None
    happened = between(log.truth.pose[:-1], log.truth.pose[1:])
    known = np.isfinite(happened).all(axis=1)
    off = happened[known] - log.recorded.increments.mean[1:][known]
    off[:, 2] = wrap_angle(off[:, 2])
    Q = log.recorded.increments.covariance[1:][known]
    square = np.einsum("ni,ni->n", off, np.linalg.solve(Q, off[:, :, None])[:, :, 0])
    within, count = int((square < scipy.stats.chi2.ppf(0.99, 3)).sum()), len(square)
    distance = float(np.sqrt(square).mean()) if count else math.nan
    return {"distance": distance, "within": within, "count": count, "reasonable": within >= 0.5 * count}


def judged(trial: Trial, runs: Iterable[Run], scores: Scores) -> dict[str, Judged]:
    """Runs of a trial that reached their end, on a log with true poses and ids, by association."""
    log, truth = trial.log, trial.log.truth
    own = (log.name, trial.task)
    rows = {(r["estimator"], r["association"], r["phase"]): r for r in rows_of(scores.metrics)
            if (r["log"], r["task"]) == own}  # fmt: skip
    usable = {(r.estimator, r.association, r.phase): r.usable for r in judge(trial, scores).runs}
    people, odometry = switched_on(log)
    found = {}
    for run in runs:
        key = run.estimator, run.association, run.phases[0]
        path = run.trajectory(run.phases[0]).pose
        assert truth.pose is not None
        off = position_distance(path, truth.pose)
        removed = np.empty(0, np.int64) if run.removed is None else np.flatnonzero(run.removed >= 0)
        size = np.empty(0) if run.state_size is None else np.asarray(run.state_size, float)
        counts, revised = ({o: getattr(confusion_of(run, log, q), o) for o in OUTCOMES} for q in ("online", "final"))
        found[run.association] = Judged(
            log.name, run.estimator, run.association, run.status, usable.get(key, True), people, odometry,
            maintained=trial.variant_of is not None,
            implausible_from=None if run.implausible is None else run.implausible.frame,
            rmse=value_of(rows[key], "rmse_position_m"), inside=value_of(rows[key], "inside_3sigma"),
            nees=value_of(rows[key], "nees_pose"), largest=float(np.nanmax(off)),
            last=float(off[np.isfinite(off)][-1]), reach=reach(path),
            pairings=look(run, log) if run.phases[0] == "online" else None,
            landmarks=0 if run.map is None else len(run.map), removed=len(removed),
            removed_people=int((landmark_true_ids(run.created, truth, removed) == CLUTTER).sum()),
            state=float(size.mean()) if len(size) else math.nan,
            entries=float((size**2).sum()) if len(size) else math.nan, revised=revised if revised != counts else {},
        )  # fmt: skip
    return found
