"""Choice of the systematic errors to estimate (`--calibrate`).

Without names from the user, a score test of the residuals of plain estimators selects errors of `data.inputs.ERRORS`:
those that are significant among all hypotheses (Bonferroni). Other hypotheses, such as delays, compete with them.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special
from threadpoolctl import threadpool_limits

from association.names import SCAN
from data import se2
from data.errors import UsageError
from data.inputs import ERRORS, Inputs, Systematic
from data.log import Log
from data.motion.priors import AUTO, systematic, written
from data.motion.systematic import BETWEEN_KNOTS, stated_all
from data.notice import Notice
from data.origin import Origin
from data.result import Run
from data.se2 import Array
from data.sensors import RangeBearing
from eval.compare import compare
from eval.plan.experiment import MISSING_RUN, Experiment, Unfinished
from eval.plan.flags.table import Execution
from eval.plan.work import Job, work
from eval.referee import effects, residuals
from eval.referee.attribution import Finding, systematic_errors
from eval.referee.effects import Effect
from eval.referee.residuals import Used
from eval.replay.settings import Setup
from eval.studies.twins import inputs_of, smoother_of

WANDERS = 3.0  # standard errors of the correlation of neighbouring stretches; 1 in 700 logs without drift exceeds it
FEWEST_DISTINGUISHED = 10  # fewest stretches for a correlation
WRONGLY = 0.01  # largest share of logs without errors in which an error is named
OF_MOTION = {
    "odometry_x_scale": "scale", "odometry_theta_curvature": "curvature", "odometry_theta_left": "left",
    "odometry_theta_right": "right", "odometry_y_distance": "bearing", "z1_range": "range",
}  # fmt: skip
"""Errors by hypothesis, `<component>_<regressor>`; oblique odometry is a bearing bias of the sensor."""
ACTING = ("scale", "curvature", "left", "right")  # errors of the odometry, modelled exactly as they act
TURNED = 2.0  # least mean square of the turns to one side, in noise variances, if the robot turned; 1 for noise alone
OF_SENSOR = {"range", "bearing"}  # errors that are observable with points, not with walls
LESS_WELL = ("odometry_x_distance", "odometry_theta_distance", "odometry_theta_turn")
"""Effects of the battery that the exact errors of `data.motion.systematic` replace."""


def names_of(inputs: Inputs, smoother: Run) -> tuple[str, ...]:
    """Errors, ordered as `ERRORS`, that are significant in the residuals of a plain batch smoother."""
    if smoother.flaw is not None or smoother.final is None:
        return ()
    path, used = smoother.final.pose, residuals.used_by(smoother, inputs)
    scored = effects.score_of(inputs, path, used, hypotheses(inputs, path, used))
    threshold = -float(special.ndtri(0.5 * WRONGLY / max(len(scored.names), 1)))
    # larger noise than stated enlarges every score
    spread = residuals.typical(residuals.smoothed_residuals(inputs, path, used))
    found = systematic_errors(scored, spread, threshold, len(ERRORS))
    # no drift in SLAM: a smoother gains by it, but a filter's heading becomes too uncertain for linearization
    wandering = inputs.map is not None and wanders(inputs, path)
    return tuple(n for n in named(found, wandering=wandering, inputs=inputs) if turned(inputs, n))


def hypotheses(inputs: Inputs, path: Array, used: Used) -> list[Effect]:
    """Effects of the battery, with the exact errors of odometry (left and right turns separate)."""
    of_sources = ("fixes", "closures")  # nothing here estimates their errors
    plain = (e for e in effects.effects(inputs, path, used) if all(getattr(e, part) is None for part in of_sources))
    found = [e for e in plain if e.name not in LESS_WELL]
    step = se2.between(path[:-1], path[1:])
    column = np.zeros((len(path), 3, len(ERRORS)))
    # of the smoothed steps: the noise of measured ones is correlated with the residuals
    column[1:] = stated_all(step, np.zeros((len(step), len(ERRORS))), step[:, 2] > 0.0)[2]
    own = [(name, column[:, :, list(ERRORS).index(error)]) for name, error in OF_MOTION.items() if error in ACTING]
    return [Effect(name, motion=c) for name, c in own if c.any()] + found


def named(found: Sequence[Finding], *, wandering: bool, inputs: Inputs) -> tuple[str, ...]:
    """Errors, ordered as `ERRORS`, for findings of the battery.

    Of indistinguishable hypotheses the first that is such an error counts. `wandering` adds the drift. In SLAM the
    scales of odometry and ranges are indistinguishable, and the odometry's is estimated. A wrong wheelbase affects
    turns to both sides, so one of them names both.
    """
    of = {**OF_MOTION, "z2_constant" if isinstance(inputs.sensor, RangeBearing) else "z2_range": "bearing"}
    known = [next((n for n in (f.name, *f.other) if n in of), "") for f in found if f.kind == "systematic"]
    names = {of[f] for f in known if f} | ({"drift"} if wandering else set())
    names |= {"left", "right"} if names & {"left", "right"} else set()
    if "range" in names and (inputs.map is None or inputs.map_is_uncertain):
        names = names - {"range"} | ({"scale"} if inputs.map is None else set())
    names -= OF_SENSOR - _of_sensor(inputs)
    return tuple(name for name in ERRORS if name in names)


def every(inputs: Inputs) -> tuple[str, ...]:
    """All observable errors of a log: no sensor errors for walls, no turns that never occur. A range scale only in an
    exact map; estimators do not estimate it beside landmarks.
    """
    free = inputs.map is None or inputs.map_is_uncertain
    left_out = (OF_SENSOR - _of_sensor(inputs)) | ({"range"} if free else set())
    return tuple(name for name in ERRORS if name not in left_out and turned(inputs, name))


def turned(inputs: Inputs, name: str) -> bool:
    """Whether the robot turned, by more than noise, to the side of an error of turns; True for other errors. Otherwise
    the sign of the noise selects the side, and an error of -1 would explain it all.
    """
    if name not in ("left", "right"):
        return True
    turn, variance = inputs.increments.mean[1:, 2], inputs.increments.covariance[1:, 2, 2]
    side = turn > 0.0 if name == "left" else turn < 0.0
    return bool(np.sum(turn[side] ** 2) > TURNED * np.sum(variance[side]))


def wanders(inputs: Inputs, path: Array) -> bool:
    """Whether the curvature of the odometry drifts, by its heading residuals at a smoothed path (N, 3).

    Each stretch, as long as the spacing of the drift's knots, has an excess curvature in sigmas; the test is the
    correlation of neighbouring stretches.
    """
    off = inputs.increments.mean[1:] - se2.between(path[:-1], path[1:])
    variance = inputs.increments.covariance[1:, 2, 2]
    step = inputs.increments.mean[1:]
    distance = np.copysign(np.hypot(step[:, 0], step[:, 1]), step[:, 0])
    weight = np.divide(distance, variance, out=np.zeros(len(step)), where=variance > 0.0)
    stretch = (np.cumsum(np.abs(distance)) / (BETWEEN_KNOTS * Systematic.length)).astype(np.int64)
    score = np.bincount(stretch, weight * se2.wrap_angle(off[:, 2]))
    information = np.bincount(stretch, weight * distance)
    moved = information > 0.0
    if moved.sum() < FEWEST_DISTINGUISHED or not score.any():
        return False
    score, information = score[moved], information[moved]
    excess = (score - score.sum() / information.sum() * information) / np.sqrt(information)
    correlation = float(excess[1:] @ excess[:-1]) / float(excess @ excess)
    return correlation * math.sqrt(len(excess)) > WANDERS


FRONT = ("ekf", "batch")  # the front end without labels, and the smoother of the residuals


def with_systematic(log: Log, systematic: Systematic | None, origin: Origin = Origin.GIVEN) -> Log:
    """The log with systematic errors to estimate, or None."""
    origins = {q: o for q, o in log.origins.items() if q != "systematic_errors"}
    origins |= {} if systematic is None else {"systematic_errors": origin}
    return replace(log, recorded=replace(log.recorded, systematic=systematic), origins=origins)


def plainly(log: Log, task: str, association: str, setup: Setup) -> tuple[str, ...]:
    """The errors that the residuals of plain estimators on a log name."""
    with threadpool_limits(1):
        inputs = inputs_of(with_systematic(log, None), task, association)
        smoother = smoother_of(compare(inputs, task, FRONT, association, setup), inputs)
        return () if smoother is None else names_of(inputs, smoother)


def _of_sensor(inputs: Inputs) -> set[str]:
    """Errors of the sensor that its observations can tell."""
    return set(inputs.sensor.errors) if len(inputs.observations.frame) else set()


def witnessed(inputs: Inputs) -> bool:
    """Whether something beside the odometry tells the motion: landmarks, fixes or closures."""
    return any(part is not None and len(part) for part in (inputs.observations.frame, inputs.fixes, inputs.closures))


def check_calibrated(log: Log, asked: tuple[str, ...], associations: Sequence[str]) -> None:
    """Refuse to calibrate by scans or by nothing, and the sensor without points; `asked` as `Setup.calibrate`."""
    if not asked:
        return
    if SCAN in associations:
        both = f"--calibrate and --association {SCAN}"
        raise UsageError(f"{both} exclude each other: errors are estimated from landmarks")
    if log.recorded.scans is not None and not len(log.recorded.observations.frame):
        raise UsageError(f"--calibrate: log {log.name!r} is a laser log; it has no landmarks to calibrate by")
    if not witnessed(log.recorded):
        what = "landmarks, fixes or closures are needed, which tell the motion beside the odometry"
        raise UsageError(f"--calibrate: log {log.name!r} has none of them; {what}")
    if asked != (AUTO,) and set(systematic(asked).names) & OF_SENSOR - _of_sensor(log.recorded):
        of = "walls" if len(log.recorded.observations.frame) else "no landmarks"
        raise UsageError(f"--calibrate: log {log.name!r} has {of}; range and bearing need points")


def settle(experiments: Sequence[Experiment], execution: Execution, lost: Unfinished) -> tuple[Experiment, ...]:
    """The experiments, with errors to estimate where `--calibrate` is given and something beside odometry exists; their
    origin says who named them: the user (given), the log's residuals (inferred), or neither (assumed: all).
    """
    asking = ((i, e) for i, e in enumerate(experiments) if e.setup.calibrate and e.work)
    wanted = {i: e.work[0].association for i, e in asking if witnessed(e.log.recorded)}
    asked = [(i, experiments[i]) for i in wanted if experiments[i].setup.calibrate == (AUTO,)]

    def missing(i: int, why: Notice) -> None:
        lost.say("battery", why, MISSING_RUN.about(log=experiments[i].log.name, task=experiments[i].task))

    jobs = [Job(i, plainly, (e.log, e.task, wanted[i], replace(e.setup, calibrate=()))) for i, e in asked]
    found = dict(work(jobs, execution, lost=missing))
    settled = list(experiments)
    for i, association in wanted.items():
        e = experiments[i]
        stated, origin = e.setup.calibrate, Origin.GIVEN
        if found.get(i):
            stated, origin = written(found[i]), Origin.INFERRED
        elif stated == (AUTO,):
            stated, origin = written(every(inputs_of(e.log, e.task, association)), tight=True), Origin.ASSUMED
        log = with_systematic(e.log, systematic(stated), origin)
        settled[i] = replace(e, log=log, setup=replace(e.setup, calibrate=stated))
    return tuple(settled)
