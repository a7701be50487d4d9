"""What went wrong in a run of the corridor lab, in numbers: counts beyond the referee's, from decisions and truth.

Words and constants that the answers to the lab's questions share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from data.inputs import CLUTTER
from data.log import Log
from data.result import NEW, Run
from data.se2 import Array, between, compose, wrap_angle
from eval.plan.lab import switched_on
from eval.referee.confusion import Confusion
from eval.referee.errors import landmark_true_ids, position_distance, rms
from eval.referee.score import Scores, Trial, confusion_of
from eval.report.page.tables import number

TURN = 0.5
"""rad. A true motion that turns by more is called a turn, else a move."""
DOF = 3


@dataclass(frozen=True)
class Lab:
    """Trials of one corridor, by what was switched on: (people, odometry); and those with map maintenance.

    `primed`: by people, without odometry, but with a motion prior in its place.
    """

    trials: dict[tuple[bool, bool], Trial]
    maintained: dict[tuple[bool, bool], Trial]
    primed: dict[bool, Trial] = field(default_factory=dict)


@dataclass(frozen=True)
class Pairings:
    """A run's decisions (online) looked at more closely; distances in m, NaN where there is nothing to measure.

    Attributes:
        counts: the referee's.
        neighbour: pairings with the landmark of another point, though the right one was in the map.
        copy: pairings with a second landmark of the right point.
        ghost: points paired with a landmark that was initialized on a person.
        clutter: observations of people; of them paired, initializing a landmark, and paired with a landmark that was
            initialized on a person.
        first_wrong: frame of the first FP, None if there is none.
        before, after: RMS position error in the frames before it, and from it on.
        apart: median distance of the points confused.
        off: median distance of those observations, placed in the world from the predicted pose, from their own point.
    """

    counts: Confusion
    neighbour: int
    copy: int
    ghost: int
    clutter: int
    clutter_paired: int
    clutter_initializing: int
    clutter_again: int
    first_wrong: int | None
    before: float
    after: float
    apart: float
    off: float


def is_corridor(trial: Trial, *, named: bool = True) -> bool:
    """Whether a trial is SLAM on a log of the lab, simulated or recorded, with the truth that its questions need.

    `named`: only if the log says that it is of the corridor.
    """
    t = trial.log.truth
    named = not named or trial.log.source.get("kind") == "corridor" or trial.log.name.startswith("corridor")
    return named and trial.task == "slam" and t.landmark_of is not None and t.known_poses == len(trial.log.recorded)


def has_prior(log: Log) -> bool:
    """Whether a motion is stated though the wheels were not read."""
    return not switched_on(log)[1] and bool(np.any(log.recorded.increments.mean))


SWITCHES = ("people", "odometry", "forward", "constant_velocity")
PRIOR = ("step_mean", "step_sigma", "velocity", "velocity_sigma", "lateral_sigma", "turn_sigma")
"""Constants of the corridor that do not make it another one: what is switched on, and what is stated of the motion."""


def find_lab(trials: Sequence[Trial], *, named: bool = True) -> Lab | None:
    """The corridor that was run with most of its switches; of several the first. None if there is no corridor.

    `named` as of `is_corridor`; where it is not asked for, all logs are of one corridor.
    """
    groups: dict[str, Lab] = {}
    for trial in trials:
        if not is_corridor(trial, named=named):
            continue
        made = trial.log.source.get("corridor")
        left_out = (*SWITCHES, *PRIOR)
        constants = {k: v for k, v in made.items() if k not in left_out} if isinstance(made, Mapping) else {}
        own = f"{trial.log.source.get('seed')} {sorted(constants.items())}" if named else ""
        lab = groups.setdefault(own, Lab({}, {}))
        if trial.beside is None and has_prior(trial.log):
            lab.primed.setdefault(switched_on(trial.log)[0], trial)
        elif trial.beside is None:
            lab.trials.setdefault(switched_on(trial.log), trial)
        elif any(r.removed is not None for r in trial.runs):
            lab.maintained.setdefault(switched_on(trial.log), trial)
    found = [lab for lab in groups.values() if lab.trials or lab.primed]
    return max(found, key=lambda lab: len(lab.trials), default=None)


THE_LABS = {"jcbb": ("jcbb-first", "jcbb")}
"""What the lab calls JCBB keeps the first of equal solutions (`jcbb-first`); where that was not run, `jcbb` is it."""


def run_of(trial: Trial | None, association: str) -> Run | None:
    """The finished run with that association, or what the lab calls so: the filter's, or else iSAM2's."""
    for name in THE_LABS.get(association, (association,)):
        for estimator in ("ekf", "isam2"):
            run = None if trial is None else trial.find(estimator, name)
            if run is not None and run.failure is None:
                return run
    return None


def pair_of(a: Trial | None, b: Trial | None, association: str) -> tuple[Run, Run] | None:
    """The same for two trials, both runs with the very same way of association."""
    for name in THE_LABS.get(association, (association,)):
        for estimator in ("ekf", "isam2"):
            runs = [None if t is None else t.find(estimator, name) for t in (a, b)]
            found = [r for r in runs if r is not None and r.failure is None]
            if len(found) == 2:
                return found[0], found[1]
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
        placed = log.recorded.sensor.inverse(predicted(log, path)[o.frame[confused]], o.z[confused])[0]
        apart, off = np.hypot(*(own_xy - taken_xy).T), np.hypot(*(placed - own_xy).T)
    return Pairings(
        counts,
        neighbour=int((wrong & had & (taken >= 0) & (taken != own)).sum()),
        copy=int((wrong & had & (taken == own)).sum()),
        ghost=int((wrong & ~clutter & (taken == CLUTTER)).sum()),
        clutter=int(clutter.sum()),
        clutter_paired=int((clutter & paired).sum()),
        clutter_initializing=int((clutter & (run.decisions == NEW)).sum()),
        clutter_again=int((clutter & paired & (taken == CLUTTER)).sum()),
        first_wrong=first,
        before=rms(error[:split]) if split else float("nan"),
        after=rms(error[split:]) if split < len(error) else float("nan"),
        apart=_median(apart),
        off=_median(off),
    )


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def predicted(log: Log, path: Array) -> Array:
    """Poses (N, 3) that a filter with this online path (N, 3) expected before it saw anything in the frame."""
    ahead = np.asarray(compose(path[:-1], log.recorded.increments.mean[1:]))
    return np.concatenate([log.recorded.prior.mean[None], ahead])


@dataclass(frozen=True)
class Motion:
    """True against stated motions, the first frame aside: Mahalanobis distances and share within 99 %.

    moves, turns: mean distance [-] of each, NaN if there is none; step, step_sigma: m, largest true motion along x and
    the standard deviation claimed for it; within: number of motions inside the 99 % ellipsoid of `count`.
    """

    moves: float
    turns: float
    step_off: float
    step_sigma: float
    within: int
    count: int


def true_against_stated(log: Log) -> Motion:
    """How far the motions that happened are from those that the inputs state, measured by the covariances stated."""
    assert log.truth.pose is not None
    if len(log.recorded) < 2:
        return Motion(*4 * (float("nan"),), 0, 0)
    happened = between(log.truth.pose[:-1], log.truth.pose[1:])
    stated, Q = log.recorded.increments.mean[1:], log.recorded.increments.covariance[1:]
    off = happened - stated
    off[:, 2] = wrap_angle(off[:, 2])
    distance = np.sqrt(np.einsum("ni,ni->n", off, np.linalg.solve(Q, off[:, :, None])[:, :, 0]))
    turned = np.abs(happened[:, 2]) > TURN
    furthest = int(np.argmax(np.abs(off[:, 0]) / np.sqrt(Q[:, 0, 0])))
    return Motion(
        float(distance[~turned].mean()) if np.any(~turned) else float("nan"),
        float(distance[turned].mean()) if np.any(turned) else float("nan"),
        float(abs(off[furthest, 0])),
        float(np.sqrt(Q[furthest, 0, 0])),
        int((distance**2 < chi2.ppf(0.99, DOF)).sum()),
        len(distance),
    )


def furthest_from_start(path: Array) -> float:
    """Largest distance [m] of a path (N, 3) from its first position."""
    return float(np.nanmax(np.hypot(*(path[:, :2] - path[0, :2]).T)))


WORSE = 1.5
"""An error this many times another one is called worse, below it comparable."""
NAMES = {
    "nn": "NN",
    "singles": "SINGLES",
    "jcbb": "JCBB",
    "jcbb-first": "JCBB",
    "known": "known association",
    "jcbb-hindsight": "JCBB in hindsight",
}
ODOMETRY, PEOPLE, BLIND = (False, True), (True, True), (False, False)
"""(people, odometry) of the logs that the questions are about."""


def missing(lab: Lab, switches: tuple[bool, bool], *names: str, maintained: bool = False) -> str:
    """Why a question cannot be answered."""
    people, odometry = switches
    what = f"{'with' if people else 'without'} people, {'with' if odometry else 'without'} odometry"
    runs = ", ".join(NAMES[n] for n in names)
    extra = " and once more with map maintenance" if maintained else ""
    state = "such a log was run, but not with all of these" if switches in lab.trials else "no such log was run"
    return f"Not answered: this needs a corridor {what}, run with {runs}{extra}; {state}."


def rmse(scores: Scores, trial: Trial, run: Run, phase: str = "online") -> float:
    """Position RMSE [m] of a run by the referee."""
    m = scores.metrics
    row = m[
        (m["log"] == trial.log.name) & (m["task"] == trial.task) & (m["estimator"] == run.estimator)
        & (m["association"] == run.association) & (m["phase"] == phase)
    ]  # fmt: skip
    value = row["rmse_position_m"].tolist()
    return math.nan if not value or value[0] is None else float(value[0])


def plural(count: int, what: str) -> str:
    """A number and its noun."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def share(value: float) -> str:
    """A share in percent."""
    return "none" if math.isnan(value) else f"{100.0 * value:.1f} %"


def move(before: float, after: float) -> str:
    """A change of a number, in words."""
    if number(before) == number(after):
        return f"stays at {number(after)}"
    return f"{'rises' if after > before else 'falls'} from {number(before)} to {number(after)}"


def count_move(before: int, after: int) -> str:
    """A count beside what it was."""
    return f"{before} as before" if before == after else f"{after} instead of {before}"


def count_change(before: int, after: int) -> str:
    """A change of a plural subject, in words."""
    return f"stay {after}" if before == after else f"go from {before} to {after}"
