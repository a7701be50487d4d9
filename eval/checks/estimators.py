"""Checks of an estimator for a task, one function each."""

import math
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np

from data.inputs import FrameObservations, Increment, Inputs, LandmarkMap, Prior
from data.log import Log
from data.result import DISCARD, Run, Trajectory
from data.se2 import Array, wrap_angle
from eval.checks import worlds
from eval.checks.finding import FailedError, Finding, check, graded
from eval.replay.external.adapter import ForeignError
from eval.replay.frontend import FrontEnd
from eval.replay.run import front_end, step_by_step, through
from eval.replay.settings import Beginning, Setup

SETUP = Setup()
TURNS = (math.pi, -2.0, 3.1)
"""rad; the arena's first headings are 0 to 0.2: rotated by these, they cross the seam at once, or soon."""


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
def runs(text: str, task: str) -> Iterator[str]:
    """It completes an ordinary log."""
    inputs = inputs_for(worlds.arena_log(), task)
    path, ours = (completed(name, inputs, task)[1] for name in (text, "ekf"))
    far = off(path.pose, ours.pose, ours.covariance)
    yield f"{worlds.FRAMES} frames of an ordinary log, at most {far:.2g} sigma from our EKF"


@check("noise-free input")
def without_noise(text: str, task: str) -> Iterator[Finding]:
    """With exact prior, motion and observations it stays on the true path."""
    log = worlds.noise_free(worlds.arena_log())
    path, ours = (completed(name, inputs_for(log, task), task)[1] for name in (text, "ekf"))
    assert log.truth.pose is not None
    far = off(path.pose, log.truth.pose, ours.covariance)
    yield graded("noise-free input", far, "the true path from exact observations")


@check("angle seams")
def seams(text: str, task: str) -> Iterator[Finding]:
    """A rotated world gives the same path, rotated: headings cross +-pi elsewhere."""
    inputs = inputs_for(worlds.arena_log(), task)
    path, ours = (completed(name, inputs, task)[1] for name in (text, "ekf"))
    worst, where = 0.0, 0.0
    for angle in TURNS:
        turned = f"the world turned by {angle:.3g} rad: "
        other = completed(text, worlds.turned(inputs, angle), task, turned)[1]
        far = off(worlds.turned_back(other.pose, angle), path.pose, ours.covariance)
        worst, where = max((worst, where), (far, angle))
    yield graded("angle seams", worst, f"the same path in a world turned by {where:.3g} rad")


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
        after = front.estimator.estimate()
        worst = max(worst, (off(after.mean[None], before.mean[None], ours.covariance[4:5]), what))
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
