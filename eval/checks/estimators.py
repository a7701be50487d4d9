"""Checks of an estimator for a task, one function each; of `fix` and `close_loops`, if it has them, against our EKF."""

import math
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from data.inputs import FrameObservations, Increment, Increments, Inputs, LandmarkMap, Prior
from data.log import Log
from data.pose_measurements import MEASURED, Closures, Fixes, FixKind, FixSource, PoseUpdated, expected_fix
from data.result import DISCARD, Run, Trajectory
from data.se2 import Array, between, wrap_angle
from eval.checks import worlds
from eval.checks.finding import APPROXIMATE, EXACT, FailedError, Finding, check, graded
from eval.replay.external.adapter import ForeignError
from eval.replay.frontend import FrontEnd
from eval.replay.run import front_end, step_by_step, through
from eval.replay.settings import Beginning, Setup

SETUP = Setup()
TURNS = (math.pi, -2.0, 3.1)  # rad; of first headings from 0 to 0.2, which cross the seam at once or soon
STRADDLED = ((2, math.pi), (7, 0.0), (12, math.pi))
"""Frames whose predicted heading is put on a seam [rad], and so, in another world, is the updated one after; some wrap
headings to 0 to 2 pi. What they add counts from `CHANCE` times the others on: samples differ from turn to turn."""
CHANCE = 3.0


def inputs_for(log: Log, task: str) -> Inputs:
    """A log's inputs with labels, for a task."""
    inputs = log.inputs(labels=True)
    return inputs if task == "localization" else inputs.without_map()


def off(poses: Array, right: Array, covariance: Array) -> float:
    """Largest difference of any coordinate, in standard deviations of the right estimate; infinite if not finite."""
    difference = poses - right
    difference[:, 2] = wrap_angle(difference[:, 2])
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    share = np.abs(difference) / np.where(sigma > 0.0, sigma, np.inf)
    return float(share.max()) if np.isfinite(difference).all() else math.inf


def completed(text: str, inputs: Inputs, task: str, where: str = "", setup: Setup = SETUP) -> tuple[Run, Trajectory]:
    """A run and its online path. Raises FailedError if it stopped; `where` begins the message."""
    run = step_by_step(text, inputs, task, setup=setup)
    if run.failure is not None:
        raise FailedError(f"{where}stopped at {run.failure.text}")
    assert run.online is not None
    return run, run.online


@check("runs")
def runs(text: str, task: str) -> Iterator[Finding]:
    """It completes an ordinary log."""
    inputs = inputs_for(worlds.arena_log(), task)
    path, ours = (completed(name, inputs, task)[1] for name in (text, "ekf"))
    far = off(path.pose, ours.pose, ours.covariance)
    yield graded("runs", far, "our EKF's path of an ordinary log, in which bearings cross pi,")


@check("noise-free input")
def without_noise(text: str, task: str) -> Iterator[Finding]:
    """With exact prior, motion and observations it stays on the true path, also in steps without turn or motion."""
    log = worlds.noise_free(worlds.straight(worlds.arena_log()))
    path, ours = (completed(name, inputs_for(log, task), task)[1] for name in (text, "ekf"))
    assert log.truth.pose is not None
    far = off(path.pose, log.truth.pose, ours.covariance)
    yield graded("noise-free input", far, "the true path from exact observations")


@check("angle seams")
def seams(text: str, task: str) -> Iterator[Finding]:
    """A rotated world gives the same path, rotated: headings cross the seams elsewhere, and some lie on them.

    Those are the estimator's own, so that even narrow spreads (sigma points) are on both sides of a seam.
    """
    inputs = inputs_for(worlds.arena_log(), task)
    path, ours = (completed(name, inputs, task)[1] for name in (text, "ekf"))
    heading = np.where(np.isfinite(path.pose), path.pose, ours.pose)[:, 2]
    predicted = heading[:-1] + inputs.increments.mean[1:, 2]  # of frame 1 first
    on = [(float(wrap_angle(at - a)), at) for k, at in STRADDLED for a in (predicted[k - 1], heading[k + 1])]
    worst, where, usual = 0.0, "", 0.0
    for angle, at in [*((a, None) for a in TURNS), *on]:
        turned = f"turned by {angle:.3g} rad" + ("" if at is None else f" (a heading is {at:.3g})")
        other = completed(text, worlds.turned(inputs, angle), task, f"the world {turned}: ")[1]
        far = off(worlds.turned_back(other.pose, angle), path.pose, ours.covariance)
        usual = max(usual, far) if at is None else usual
        if at is None or not far <= CHANCE * usual:
            worst, where = max((worst, where), (far, turned))
    yield graded("angle seams", worst, f"the same path in a world {where}")


@check("empty frames")
def empty_frames(text: str, task: str) -> Iterator[Finding]:
    """Frames without observations, updates with none, and observations that are all discarded."""
    inputs = inputs_for(worlds.silent(worlds.arena_log(), worlds.SILENT), task)
    silent = f"frames {worlds.SILENT.start} to {worlds.SILENT.stop - 1}: "
    path, ours = completed(text, inputs, task, silent)[1], completed("ekf", inputs, task)[1]
    far = off(path.pose, ours.pose, ours.covariance)
    front = driven(text, inputs, task, 5)
    before = front.estimator.estimate()
    nothing, worst = FrameObservations(np.empty((0, 2)), np.empty((0, 2, 2))), (0.0, "no observation")
    for what, observations in (("no observation", nothing), ("DISCARD alone", inputs.frame(5).observations)):
        front.estimator.update(observations, np.full(len(observations.z), DISCARD, np.int64))
        worst = max(worst, (off(front.estimator.estimate().mean[None], before.mean[None], ours.covariance[4:5]), what))
    found = graded("empty frames", worst[0], f"an update with {worst[1]} leaves the pose where it is")
    bridged = f"; frames without observations are bridged, at most {far:.2g} sigma from our EKF"
    yield found._replace(sentence=found.sentence + bridged)


@check("determinism")
def determinism(text: str, task: str) -> Iterator[str]:
    """Constructed again, the same input gives the same bytes."""
    inputs = inputs_for(worlds.arena_log(), task)
    a, b = (completed(text, inputs, task)[1].pose for _ in range(2))
    if not np.array_equal(a, b, equal_nan=True):
        far = float(np.nanmax(np.abs(a - b)[:, :2], initial=0.0))
        why = "random numbers without a seed, or state shared by all objects of the class"
        raise FailedError(f"two objects end up {far:.3g} m apart on the same input: {why}")
    yield "the same bytes from two objects"


def unrecorded(*result: Any) -> None:
    """Forget the result of an update."""


def driven(text: str, inputs: Inputs, task: str, frames: int) -> FrontEnd:
    """A front end after some frames, under known association."""
    front = front_end(text, "known", inputs, SETUP)
    for k in range(frames):
        through(front, inputs.frame(k), unrecorded)
    return front


HALF = worlds.FRAMES // 2


@check("removal")
def removal(text: str, task: str) -> Iterator[str]:
    """A removed landmark is in no map, and its number is not given again."""
    if task != "slam":
        return
    inputs = inputs_for(worlds.noise_free(worlds.arena_log()), task)
    front = driven(text, inputs, task, HALF)
    if "remove" not in front.can:
        yield "it has no `remove`, so it works without --maintain and jcbb-hindsight"
        return
    removed = np.array([0])
    try:
        front.can["remove"].remove(removed)
        assert front.known is not None
        front.known.removed(removed)
        made = list[int]()
        for k in range(HALF, worlds.FRAMES):
            through(front, inputs.frame(k), lambda frame, decisions, done: made.extend(done.created[done.created >= 0]))
        held = front.estimator.landmarks().number.tolist()
    except ForeignError as stop:
        raise FailedError(f"landmark 0 removed: {stop}") from None
    if 0 in held or 0 in made:
        raise FailedError("landmark 0 was removed and is in the map again: numbers are not given twice")
    yield f"landmark 0 left the map, seen again it is number {made[0] if made else 'none'}"


@check("purity")
def purity(text: str, task: str) -> Iterator[str]:
    """It changes none of its inputs, which are writable here; in a run they are locked, and writing raises."""
    inputs = inputs_for(worlds.arena_log(), task)
    prior: Prior = _writable(inputs.prior)
    known: LandmarkMap | None = None if inputs.map is None else _writable(inputs.map)
    handed: list[tuple[str, Any]] = [("prior.mean", prior.mean), ("prior.covariance", prior.covariance)]
    if known is not None:
        handed += [("map.id", known.id), ("map.xy", known.xy)]
    kept = [(name, a, a.copy()) for name, a in handed]
    front = FrontEnd(text, "known", Beginning(prior, inputs.sensor, known), SETUP)
    for k in range(len(inputs)):
        frame, parts = inputs.frame(k), list[tuple[str, Any]]()
        if frame.increment is not None:
            increment = Increment(*(np.array(a) for a in frame.increment))
            parts += [(f"increment.{n}", a) for n, a in increment._asdict().items()]
            frame = frame._replace(increment=increment)
        observations = FrameObservations(*(np.array(a) for a in frame.observations))
        parts += [(f"observations.{n}", a) for n, a in observations._asdict().items()]
        kept += [(f"{name} of frame {k}", a, a.copy()) for name, a in parts]
        through(front, frame._replace(observations=observations), unrecorded)
        front.estimator.estimate()
    for name, now, before in kept:
        if not np.array_equal(now, before):
            what = f"{name} was changed by up to {float(np.abs(now - before).max()):.3g}: copy what is kept"
            raise FailedError(f"{what} (in a run inputs are locked, so that writing raises ValueError)")
    yield f"{len(kept)} arrays that it was handed are as they were"


def _writable(locked: Any) -> Any:
    """A copy of a frozen dataclass with writable arrays."""
    copy = replace(locked)
    for f in fields(copy):
        if isinstance(value := getattr(copy, f.name), np.ndarray):
            object.__setattr__(copy, f.name, np.array(value))
    return copy


@check("symmetric covariance")
def covariances(text: str, task: str) -> Iterator[str]:
    """Every covariance is symmetric and positive semidefinite, except for rounding."""
    inputs = inputs_for(worlds.arena_log(), task)
    front = FrontEnd(text, "known", inputs, SETUP)
    asymmetry, least, blank = 0.0, np.inf, False
    for k in range(len(inputs)):
        try:
            through(front, inputs.frame(k), unrecorded)
            P = front.estimator.estimate().covariance
        except ForeignError as stop:
            raise FailedError(f"frame {k}: {stop}") from None
        blank |= not np.isfinite(P).all()
        if not blank:
            asymmetry = max(asymmetry, float(np.abs(P - P.T).max()) / max(float(np.trace(P)), 1e-300))
            least = min(least, float(np.linalg.eigvalsh(P)[0]))
    yield "it gives none" if blank else f"asymmetry at most {asymmetry:.1g} of the trace, least eigenvalue {least:.2g}"


SOURCES = (FixSource("gps", (0.6, -0.4)), FixSource("compass", rotation=2.0), FixSource("tracker", (-0.3, 0.5), -1.0))
FIXED = ((3, FixKind.POSITION, 0), (4, FixKind.HEADING, 1), (6, FixKind.POSITION, 0), (6, FixKind.HEADING, 1),
         (8, FixKind.POSE, 2), (10, FixKind.POSITION, 0), (13, FixKind.POSE, 2))  # fmt: skip
"""Frame, kind and source of each fix."""
TIED = ((0, 5), (8, 2), (7, 9), (11, 4), (5, 13), (14, 12))  # frames of each closure, in either order
FAR = 20.0  # m, of what the gate has to reject
SCALE = 0.1  # of the arena's noise, so that sound approximations agree
SIGMA = np.array([0.006, 0.003, 0.001])
"""m, m, rad: as uncertain as the pose is there, so that each counts; along x and y differently, so that frames do."""
COVARIANCE = np.diag(SIGMA**2)
COVARIANCE[0, 1] = COVARIANCE[1, 0] = 0.5 * SIGMA[0] * SIGMA[1]
COVARIANCE.setflags(write=False)
PROBABILITY = 0.99  # of the gate
SPREAD = 0.5  # largest relative difference of a variance: samples and approximations are below
RELATIVE = 0.05  # largest relative difference of a stated NIS


class Part(NamedTuple):
    """Fixes or closures: the estimator's method, their name in inputs and runs, and the field with their values."""

    verb: str
    name: str
    values: str


def measured(task: str) -> Inputs:
    """A log whose robot sees nothing most of the time, with fixes and closures drawn from its path."""
    log = worlds.noise_free(worlds.silent(worlds.arena_log(), slice(2, worlds.FRAMES - 1)))
    truth, inputs = log.truth.pose, inputs_for(log, task)
    assert truth is not None
    rng = np.random.default_rng(worlds.SEED)
    L = np.linalg.cholesky(COVARIANCE)
    M, R = (SCALE**2 * C for C in (inputs.increments.covariance, inputs.observations.R))
    moved = inputs.increments.mean.copy()
    moved[1:] += worlds.drawn(rng, M[1:])
    seen = inputs.observations.z + worlds.drawn(rng, R)
    z, C = np.zeros((len(FIXED), 3)), np.zeros((len(FIXED), 3, 3))
    for i, (k, kind, source) in enumerate(FIXED):
        rows = list(MEASURED[kind])
        z[i, rows] = expected_fix(truth[k], kind, SOURCES[source])[0] + (L @ rng.standard_normal(3))[rows]
        C[i][np.ix_(rows, rows)] = COVARIANCE[np.ix_(rows, rows)]
        z[i, 2] = wrap_angle(float(z[i, 2]))
    frame, kinds, of = (np.array(each, np.int64) for each in zip(*FIXED, strict=True))
    first, second = np.array(sorted(TIED, key=max), np.int64).T
    relative = between(truth[first], truth[second]) + rng.standard_normal((len(first), 3)) @ L.T
    each = np.tile(COVARIANCE, (len(first), 1, 1))
    closures = Closures(first, second, relative, each, np.zeros(len(first), np.int64), ("loops",))
    return replace(
        inputs, prior=Prior(truth[0] + L @ rng.standard_normal(3), COVARIANCE), increments=Increments(moved, M),
        observations=replace(inputs.observations, z=seen, R=R), fixes=Fixes(frame, kinds, of, z, C, SOURCES),
        closures=closures,
    )  # fmt: skip


FIXES = Part("fix", "fixes", "z")
CLOSURES = Part("close_loops", "closures", "relative")


@check("fixes")
def fixes(text: str, task: str) -> Iterator[Finding | str]:
    """Positions on a lever, headings of a turned compass, and poses, if it has `fix`; to localize by these alone."""
    inputs, o = replace(measured(task), closures=None), measured(task).observations
    seen = o if task == "slam" else o.only(np.zeros(len(o.frame), bool))
    yield from _checked(text, replace(inputs, observations=seen), task, FIXES)


@check("closures")
def closures(text: str, task: str) -> Iterator[Finding | str]:
    """Relative poses to earlier frames, in both directions, if it has `close_loops`."""
    yield from _checked(text, replace(measured(task), fixes=None), task, CLOSURES)


def _checked(text: str, inputs: Inputs, task: str, part: Part) -> Iterator[Finding | str]:
    can = front_end(text, "known", inputs, SETUP).can
    if (can.get("fix") if part is FIXES else can.get("close_loops")) is None:
        yield f"it has no `{part.verb}`, so it works without a log's {part.name}"
        return
    where = f"with {part.name}: "
    setup = replace(SETUP, gate_poses=None)
    (run, path), (ours, right) = (completed(name, inputs, task, where, setup=setup) for name in (text, "ekf"))
    done, known = (getattr(r, part.name) for r in (run, ours))
    count, used = len(done.used), int(done.used.sum())
    if used < count and part is CLOSURES and not np.isfinite(done.nis[~done.used]).any():
        yield f"{used} of {count} closures used; it no longer knows the earlier frame of the others"
        return
    if used < count:
        raise FailedError(f"{used} of {count} {part.name} used without a gate; all are right")
    far = off(path.pose.copy(), right.pose, right.covariance)
    spread = _spread(path.covariance, right.covariance)
    yield graded(part.name, far, f"the path with {count} {part.name}")
    if np.isfinite(path.covariance).all():
        said = f"variances with {count} {part.name} within {100.0 * spread:.2g} % of those of our EKF"
        yield Finding(f"{part.name}, covariance", spread <= SPREAD, said)
    yield from _stated(part, done, known, far)
    yield from _gated(text, inputs, task, part, path.pose)


def _spread(P: Array, right: Array) -> float:
    """Largest relative difference of a variance; 0 where none is given."""
    mine, exact = (np.diagonal(C, axis1=1, axis2=2) for C in (P, right))
    return float(np.nanmax(np.abs(mine - exact) / exact, initial=0.0))


def _stated(part: Part, done: PoseUpdated, known: PoseUpdated, far: float) -> Iterator[Finding]:
    """The NIS that it states, which is not needed."""
    name, stated = f"{part.name}, NIS", np.isfinite(done.nis)
    if not stated.any():
        return
    apart = np.where(stated, np.abs(done.nis - known.nis) / np.maximum(known.nis, known.dof), 0.0)
    row = int(np.argmax(apart))
    if apart[row] > (RELATIVE if far <= EXACT else APPROXIMATE):
        right = f"{known.nis[row]:.3g} is that of its innovation before it is used, nu' S^-1 nu"
        which = f"{part.name[: -2 if part is FIXES else -1]} {row}"
        yield Finding(name, False, f"{which}: NIS {done.nis[row]:.3g}; {right}")
    else:
        yield Finding(name, True, f"stated of {int(stated.sum())}, within {100.0 * apart[row]:.2g} %")


def _gated(text: str, inputs: Inputs, task: str, part: Part, right: Array) -> Iterator[Finding]:
    """One of them is metres off; a gate is there to reject it. What is used need not be stated; the path tells it."""
    setup, row, name = replace(SETUP, gate_poses=PROBABILITY), 2, f"{part.name}, gate"
    values = np.array(getattr(getattr(inputs, part.name), part.values))
    values[row, 0] += FAR
    changed: dict[str, Any] = {part.name: replace(getattr(inputs, part.name), **{part.values: values})}
    where = f"with {part.name}, one of them wrong: "
    run, path = completed(text, replace(inputs, **changed), task, where, setup=setup)
    if getattr(run, part.name).used[row] and np.hypot(*(path.pose - right)[:, :2].T).max() > 0.05 * FAR:
        yield Finding(name, False, f"one that is {FAR:.0f} m off was used; `gate` is {PROBABILITY}, of chi-square")
    else:
        yield Finding(name, True, f"one that is {FAR:.0f} m off was rejected")
