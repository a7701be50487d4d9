"""Systematic errors that are estimated along: which ones, and what the battery says before and after.

Without names from a person, a log names its errors under plain estimators, by the score test of its residuals; no twins
are needed. An error of `data.inputs.ERRORS` is named if the data ask for it beyond what chance makes the largest of all
hypotheses ask for (Bonferroni). Hypotheses that are none of these errors, as delays, stand beside them and may explain
it all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special
from threadpoolctl import threadpool_limits

from association.scans.constraints import SCAN
from data import se2
from data.errors import UsageError
from data.inputs import ERRORS, Inputs, Systematic
from data.log import Log
from data.motion.priors import AUTO, systematic, written
from data.motion.systematic import BETWEEN_KNOTS, stated_all
from data.notice import Code, Notice, notice
from data.result import Run
from data.se2 import Array
from data.sensors import RangeBearing
from eval.compare import compare
from eval.plan.experiment import Experiment
from eval.plan.flags.table import Execution
from eval.plan.unfinished import MISSING_RUN, Unfinished
from eval.plan.work import Job, work
from eval.referee import effects, residuals
from eval.referee.attribution import Finding, systematic_errors
from eval.referee.effects import Effect
from eval.referee.residuals import Used
from eval.referee.score import Trial
from eval.replay.external.spec import name_of
from eval.replay.settings import Setup
from eval.studies.sampled import Sample, sample_of, smoother_of, twin_sample
from eval.studies.trusted import FEWEST, Trust, judged
from eval.studies.twins import Source, inputs_of, source_of, twin

WANDERS = 3.0
"""Standard errors by which successive stretches must err alike: 1 in 700 logs that do not drift has as much."""
FEWEST_DISTINGUISHED = 10
"""Stretches, below which their correlation is nobody's witness."""
WRONGLY = 0.01
"""Of logs without errors, the share at most in which an error is named."""
OF_MOTION = {
    "odometry_x_scale": "scale",
    "odometry_theta_curvature": "curvature",
    "odometry_theta_left": "left",
    "odometry_theta_right": "right",
    "odometry_y_distance": "bearing",
    "z1_range": "range",
}
"""By the hypothesis' name `<component>_<regressor>`. Odometry askew to the way driven is a sensor that is."""
ACTING = ("scale", "curvature", "left", "right")
"""Errors that do more to an increment than one of the battery's effects."""
TURNED = 2.0
"""Mean square of a log's turns to one side, in variances of their noise, if there are any: of noise alone it is 1."""
OF_SENSOR = {"range", "bearing"}
"""Errors that points tell, walls not."""
LESS_WELL = ("odometry_x_distance", "odometry_theta_distance", "odometry_theta_turn")
"""Of the battery's effects, those whose place is taken by errors that act as `data.motion.systematic` has it."""


def names_of(inputs: Inputs, smoother: Run) -> tuple[str, ...]:
    """Errors of a log, in their order, that a plain batch smoother's residuals name; none where they name none."""
    if smoother.flaw is not None or smoother.final is None:
        return ()
    path, used = smoother.final.pose, residuals.used_by(smoother, inputs)
    scored = effects.score_of(inputs, path, used, hypotheses(inputs, path, used))
    threshold = -float(special.ndtri(0.5 * WRONGLY / max(len(scored.names), 1)))
    # a noise that is larger than stated makes every score larger
    spread = residuals.typical(residuals.smoothed_residuals(inputs, path, used))
    found = systematic_errors(scored, spread, threshold, len(ERRORS))
    # in SLAM a filter's heading would become too uncertain to linearize about: the smoother gains by it, filters lose
    wandering = inputs.map is not None and wanders(inputs, path)
    return tuple(n for n in named(found, wandering=wandering, inputs=inputs) if turned(inputs, n))


def hypotheses(inputs: Inputs, path: Array, used: Used) -> list[Effect]:
    """The battery's effects, with the odometry's errors exactly as they act (left and right turns apart)."""
    found = [e for e in effects.effects(inputs, path, used) if e.name not in LESS_WELL]
    way = se2.between(path[:-1], path[1:])
    column = np.zeros((len(path), 3, len(ERRORS)))
    # of the way as smoothed: as measured, its noise is that of the residuals
    column[1:] = stated_all(way, np.zeros((len(way), len(ERRORS))), way[:, 2] > 0.0)[2]
    own = [(name, column[:, :, list(ERRORS).index(error)]) for name, error in OF_MOTION.items() if error in ACTING]
    return [Effect(name, motion=c) for name, c in own if c.any()] + found


def named(found: Sequence[Finding], *, wandering: bool, inputs: Inputs) -> tuple[str, ...]:
    """Errors, in their order, for what was found; none where nothing was found that has a name here.

    Of errors that the log cannot tell apart, the one chosen, or if that has no name here the first that has.
    `wandering`: whether the odometry's curvature comes and goes. In SLAM nobody can tell the scale of the odometry from
    that of the ranges; the odometry's is taken, as sensors are mostly the better rulers. A wheelbase that is off spoils
    turns to both sides, so one of them names both.
    """
    bearing = "z2_constant" if isinstance(inputs.sensor, RangeBearing) else "z2_range"
    of = {**OF_MOTION, bearing: "bearing"}
    said = [next((n for n in (f.name, *f.other) if n in of), "") for f in found if f.kind == "systematic"]
    names = {of[f] for f in said if f} | ({"drift"} if wandering else set())
    names |= {"left", "right"} if names & {"left", "right"} else set()
    if inputs.map is None and "range" in names:
        names = names - {"range"} | {"scale"}
    if not inputs.sensor.sees_points:
        names -= OF_SENSOR
    return tuple(name for name in ERRORS if name in names)


def every(inputs: Inputs) -> tuple[str, ...]:
    """All errors that a log may have; in SLAM without the ranges' scale, of which only the odometry's share is seen.

    Of turns, only to sides to which the robot turned; with walls, of the odometry only.
    """
    left_out = OF_SENSOR if not inputs.sensor.sees_points else {"range"} if inputs.map is None else set()
    return tuple(name for name in ERRORS if name not in left_out and turned(inputs, name))


def turned(inputs: Inputs, name: str) -> bool:
    """Whether the robot turned to the side that an error is of (True for others), by more than noise makes of straight.

    The sign of noise chooses the side, so that an error of -1 would explain all of it: nothing is to be asked of it.
    """
    if name not in ("left", "right"):
        return True
    turn, variance = inputs.increments.mean[1:, 2], inputs.increments.covariance[1:, 2, 2]
    side = turn > 0.0 if name == "left" else turn < 0.0
    return bool(np.sum(turn[side] ** 2) > TURNED * np.sum(variance[side]))


def wanders(inputs: Inputs, path: Array) -> bool:
    """Whether the heading's residuals at a smoothed path (N, 3) say that a curvature comes and goes.

    In stretches as long as the knots of the drift are apart, each says how much the odometry curves more than it does
    on the whole, in sigmas; neighbours say it alike if that is more than noise.
    """
    off = inputs.increments.mean[1:] - se2.between(path[:-1], path[1:])
    variance = inputs.increments.covariance[1:, 2, 2]
    step = inputs.increments.mean[1:]
    distance = np.copysign(np.hypot(step[:, 0], step[:, 1]), step[:, 0])
    weight = np.divide(distance, variance, out=np.zeros(len(step)), where=variance > 0.0)
    stretch = (np.cumsum(np.abs(distance)) / (BETWEEN_KNOTS * Systematic.length)).astype(np.int64)
    score = np.bincount(stretch, weight * se2.wrap_angle(off[:, 2]))
    information = np.bincount(stretch, weight * distance)
    told = information > 0.0
    if told.sum() < FEWEST_DISTINGUISHED or not score.any():
        return False
    score, information = score[told], information[told]
    left = (score - score.sum() / information.sum() * information) / np.sqrt(information)
    alike = float(left[1:] @ left[:-1]) / float(left @ left)
    return alike * math.sqrt(len(left)) > WANDERS


FRONT = ("ekf", "batch")
"""What decides where labels are withheld, and the smoother whose residuals are looked at."""


def with_systematic(log: Log, systematic: Systematic | None) -> Log:
    """The log whose estimators estimate these errors along (None: none)."""
    return replace(log, recorded=replace(log.recorded, systematic=systematic))


def plainly(log: Log, task: str, association: str, setup: Setup) -> tuple[tuple[Run, ...], tuple[str, ...]]:
    """A log under plain estimators, and the errors that it names."""
    with threadpool_limits(1):
        inputs = inputs_of(with_systematic(log, None), task, association)
        runs = compare(inputs, task, FRONT, association, setup)
        smoother = smoother_of(runs, inputs)
        return tuple(runs), () if smoother is None else names_of(inputs, smoother)


def examined(log: Log, task: str, association: str, setup: Setup, runs: Sequence[Run]) -> Trust:
    """The battery of a log, less the errors that its estimators estimate along; `runs`: those there are already.

    Residuals of batch and as many twins as a verdict needs, of batch alone under its own decisions. Twins have no
    errors, and estimate them all the same with the same priors.
    """
    with threadpool_limits(1):
        inputs = inputs_of(log, task, association)
        smoother = smoother_of(runs or compare(inputs, task, FRONT, association, setup), inputs)
        real = sample_of(log, task, association, (), smoother)
        twins: list[Sample] = []
        none: tuple[Notice, ...] = ()
        if smoother is not None:
            try:
                source = source_of(log, smoother, (), setup, "known")
            except UsageError as fault:
                none = (notice(Code.NO_TWINS, why=str(fault)),)
            else:
                twins = [_twin(source, seed) for seed in range(FEWEST)]
        trust = judged(log, task, name_of(association), real, twins, smoother)
        return replace(trust, notices=(*trust.notices, *none))


def _twin(source: Source, seed: int) -> Sample:
    """What a twin's smoother says, under the twin's own labels."""
    log = twin(source, seed)
    inputs = inputs_of(log, source.task, source.association)
    (smoother,) = compare(inputs, source.task, ("batch",), source.association, source.setup)
    return twin_sample(source, log, (smoother,), smoother)


ASKED, NAMED, ALL = "asked", "named", "all"
"""Why these errors: a person named them, the log did, or nobody, so that all are looked for with tight priors."""
SCANNED = "--calibrate: log {!r} is a laser log, whose scans are matched; it has no landmarks to calibrate by"


@dataclass(frozen=True, eq=False)
class Calibration:
    """A log and task whose systematic errors are estimated along.

    Attributes:
        log, task, association: which, and the way of association whose decisions the battery is about.
        systematic: the errors, and how well they are known before.
        why: `ASKED`, `NAMED` or `ALL`.
        plain: runs of plain estimators, as far as the log was asked for names.
        before, after: the battery under plain estimators and under these (None: not enough memory).
    """

    log: str
    task: str
    association: str
    systematic: Systematic
    why: str
    plain: tuple[Run, ...] = ()
    before: Trust | None = None
    after: Trust | None = None


def check_calibrated(log: Log, asked: tuple[str, ...], associations: Sequence[str]) -> None:
    """Refuse to calibrate by scans, and the sensor by walls; `asked`: as `Setup.calibrate`."""
    if asked and SCAN in associations:
        raise UsageError(f"--calibrate and --association {SCAN} exclude each other: errors are told by landmarks")
    if asked and log.recorded.scans is not None and not len(log.recorded.observations.frame):
        raise UsageError(SCANNED.format(log.name))
    named = asked and asked != (AUTO,)
    if named and not log.recorded.sensor.sees_points and systematic(asked).of_sensor:
        raise UsageError(f"--calibrate: log {log.name!r} has walls; range and bearing are errors of points")


def settle(
    experiments: Sequence[Experiment], execution: Execution, lost: Unfinished
) -> tuple[tuple[Experiment, ...], tuple[Calibration, ...]]:
    """The experiments on logs whose errors are estimated along, and which errors those are.

    Logs without landmarks stay as they are, and all do without `--calibrate`.
    """
    wanted = [i for i, e in enumerate(experiments) if e.setup.calibrate and len(e.log.recorded.observations.frame)]
    if not wanted:
        return tuple(experiments), ()
    first = {i: experiments[i].work[0].association for i in wanted if experiments[i].work}
    asked = [(i, experiments[i]) for i in first if experiments[i].setup.calibrate == (AUTO,)]
    jobs = [Job(i, plainly, (e.log, e.task, first[i], _plain(e.setup))) for i, e in asked]
    found = dict(work(jobs, execution, lost=_missing(experiments, lost)))
    settled, made = list(experiments), []
    for i, association in first.items():
        e = experiments[i]
        plain, names = found.get(i, ((), ()))
        stated, why = e.setup.calibrate, ASKED
        if stated == (AUTO,):
            inputs = inputs_of(e.log, e.task, association)
            stated, why = (written(names), NAMED) if names else (written(every(inputs), tight=True), ALL)
        errors = systematic(stated)
        settled[i] = replace(e, log=with_systematic(e.log, errors), setup=replace(e.setup, calibrate=stated))
        if e.variant_of is None:
            made.append(Calibration(e.log.name, e.task, association, errors, why, plain))
    return tuple(settled), tuple(made)


def examine(
    calibrations: Sequence[Calibration],
    experiments: Sequence[Experiment],
    trials: Sequence[Trial],
    execution: Execution,
    lost: Unfinished,
) -> tuple[Calibration, ...]:
    """The same with what the battery says of each log, and of the log less its errors."""
    place = {(e.log.name, e.task): i for i, e in enumerate(experiments) if e.variant_of is None}
    jobs: list[Job[tuple[int, str]]] = []
    for k, c in enumerate(calibrations):
        e, trial = experiments[place[c.log, c.task]], trials[place[c.log, c.task]]
        runs = [r for r in trial.runs if r.association == name_of(c.association) and r.flaw is None]
        ready = runs if any(r.estimator == "batch" for r in runs) else []
        plain = with_systematic(e.log, None), c.task, c.association, _plain(e.setup), c.plain
        jobs.append(Job((k, "before"), examined, plain))
        jobs.append(Job((k, "after"), examined, (e.log, c.task, c.association, e.setup, ready)))
    at = [place[c.log, c.task] for c in calibrations]
    missing = _missing(experiments, lost)
    found = dict(work(jobs, execution, lost=lambda owner, why: missing(at[owner[0]], why)))
    both = [(found.get((k, "before")), found.get((k, "after"))) for k in range(len(calibrations))]
    return tuple(replace(c, before=b, after=a, plain=()) for c, (b, a) in zip(calibrations, both, strict=True))


def _plain(setup: Setup) -> Setup:
    return replace(setup, calibrate=())


def _missing(experiments: Sequence[Experiment], lost: Unfinished) -> Callable[[int, Notice], None]:
    def missing(i: int, why: Notice) -> None:
        lost.say("battery", why, MISSING_RUN.about(log=experiments[i].log.name, task=experiments[i].task))

    return missing
