"""Checks of an estimator: one function each, which yields what it finds for a task."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from data.inputs import Frame, FrameObservations, Increment, Inputs, LandmarkMap, Prior
from data.result import DISCARD, Run
from data.se2 import Array, world_from_body, wrap_angle
from eval.checks import worlds
from eval.checks.finding import Finding, graded
from eval.compare import compare
from eval.referee.errors import named
from eval.replay.external.guard import ForeignError
from eval.replay.frontend import FrontEnd
from eval.replay.run import dead_reckoning, front_end, step_by_step
from eval.replay.settings import Beginning, Setup

SETUP = Setup()
TURNS = (math.pi, -2.0, 3.1)
"""rad. The headings of the arena's first second are 0 to 0.2: turned so, they cross the seam at once, or soon."""
LONG = np.diag([0.3, 0.03, 0.03]) ** 2
"""Prior covariance [m^2, rad^2] that is ten times as long as wide, so that its direction shows."""
LONG.setflags(write=False)
BODY = 0.3
"""Relative difference (Frobenius) from which two position covariances are not the same; a few hundred samples have
0.1."""


def inputs_for(log: Any, task: str) -> Inputs:
    """A log's inputs with labels, for a task."""
    inputs: Inputs = log.inputs(labels=True)
    return inputs if task == "localization" else inputs.without_map()


def off(poses: Array, right: Array, covariance: Array) -> float:
    """Largest difference of any coordinate, in standard deviations of the right estimate; infinite if not finite."""
    difference = poses - right
    difference[:, 2] = wrap_angle(difference[:, 2])
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    share = np.abs(difference) / np.where(sigma > 0.0, sigma, np.inf)
    return float(share.max()) if np.isfinite(difference).all() else math.inf


def ours(inputs: Inputs, task: str) -> Run:
    """Our EKF, whose standard deviations are the unit."""
    return step_by_step("ekf", inputs, task)


def newest(run: Run) -> Array:
    """Poses (N, 3) as known at their instants."""
    assert run.online is not None
    return run.online.pose


def runs(text: str, task: str) -> Iterator[Finding]:
    """It gets through an ordinary log."""
    inputs = inputs_for(worlds.arena_log(), task)
    run = step_by_step(text, inputs, task)
    if run.failure is not None:
        yield Finding("runs", False, f"stopped at {run.failure.text}")
        return
    r = ours(inputs, task)
    assert r.online is not None
    far = off(newest(run), newest(r), r.online.covariance)
    yield Finding("runs", True, f"{worlds.FRAMES} frames of an ordinary log, at most {far:.2g} sigma from our EKF")


def linear_world(text: str, task: str) -> Iterator[Finding]:
    """In a linear world the exact estimate is known: least squares over all data up to the last frame."""
    name = "linear world"
    inputs = inputs_for(worlds.linear_log(), task)
    run, (exact,) = step_by_step(text, inputs, task), compare(inputs, task, ("batch",))
    if run.failure is not None:
        yield Finding(name, False, f"stopped at {run.failure.text}")
        return
    assert exact.final is not None
    assert run.online is not None
    right, P = exact.final.pose[-1:], exact.final.covariance[-1:]
    yield graded(name, off(run.online.pose[-1:], right, P), "the exact solution (least squares) at the last frame")
    claimed = run.online.covariance[-1]
    if np.isfinite(claimed).all():
        share = np.sqrt(np.diag(claimed) / np.diag(P[0]))
        far = float(np.abs(np.log2(share)).max())
        said = f"sigmas are {', '.join(f'{s:.3g}' for s in share)} times the exact ones (x, y, theta)"
        yield Finding(
            "linear world, sigmas", far <= 1.0, said if far <= 1.0 else f"{said}; a factor of 2 at most is right"
        )


def without_noise(text: str, task: str) -> Iterator[Finding]:
    """With exact prior, motion and readings it stays on the true path."""
    log = worlds.noise_free(worlds.arena_log())
    inputs = inputs_for(log, task)
    run, r = step_by_step(text, inputs, task), ours(inputs, task)
    if run.failure is not None:
        yield Finding("noise-free input", False, f"stopped at {run.failure.text}")
        return
    assert log.truth.pose is not None
    assert r.online is not None
    far = off(newest(run), log.truth.pose, r.online.covariance)
    yield graded("noise-free input", far, "the true path from exact readings")


def seams(text: str, task: str) -> Iterator[Finding]:
    """A world that is turned gives the same path, turned: headings cross +-pi elsewhere."""
    inputs = inputs_for(worlds.arena_log(), task)
    run, r = step_by_step(text, inputs, task), ours(inputs, task)
    if run.failure is not None:
        return  # said before
    assert r.online is not None
    worst, where = 0.0, 0.0
    for angle in TURNS:
        other = step_by_step(text, worlds.turned(inputs, angle), task)
        if other.failure is not None:
            yield Finding("angle seams", False, f"the world turned by {angle:.3g} rad: stopped at {other.failure.text}")
            return
        far = off(worlds.turned_back(newest(other), angle), newest(run), r.online.covariance)
        worst, where = max((worst, where), (far, angle))
    yield graded("angle seams", worst, f"the same path in a world turned by {where:.3g} rad")


def empty_frames(text: str, task: str) -> Iterator[Finding]:
    """Frames without readings, updates with none, and readings that are all discarded."""
    name = "empty frames"
    inputs = inputs_for(worlds.silent(worlds.arena_log(), worlds.SILENT), task)
    run, r = step_by_step(text, inputs, task), ours(inputs, task)
    if run.failure is not None:
        yield Finding(name, False, f"frames {worlds.SILENT.start} to {worlds.SILENT.stop - 1}: {run.failure.why}")
        return
    assert r.online is not None
    far = off(newest(run), newest(r), r.online.covariance)
    yield Finding(name, True, f"frames without readings are bridged, at most {far:.2g} sigma from our EKF")
    front = driven(text, inputs, task, 5)
    before = front.estimator.estimate()
    seen = inputs.frame(5).observations
    for what, observations in (
        ("no reading", FrameObservations(np.empty((0, 2)), np.empty((0, 2, 2)))),
        ("DISCARD alone", seen),
    ):
        front.estimator.update(observations, np.full(len(observations.z), DISCARD, np.int64))
        after = front.estimator.estimate()
        moved = off(after.mean[None], before.mean[None], r.online.covariance[4:5])
        yield graded(f"{name}, {what}", moved, f"an update with {what} leaves the pose where it is")


def determinism(text: str, task: str) -> Iterator[Finding]:
    """Constructed again, the same input gives the same bytes."""
    inputs = inputs_for(worlds.arena_log(), task)
    first, second = (step_by_step(text, inputs, task) for _ in range(2))
    a, b = newest(first), newest(second)
    same = np.array_equal(a, b, equal_nan=True)
    far = float(np.nanmax(np.abs(a - b)[:, :2], initial=0.0))
    why = "random numbers without a seed, or state shared by all objects of the class"
    yield Finding(
        "determinism", same,
        "the same bytes from two objects" if same else f"two objects end up {far:.3g} m apart on the same input: {why}",
    )  # fmt: skip


def covariance(text: str, task: str) -> Iterator[Finding]:
    """The covariance is in the world frame: that of a path without readings is known."""
    log = worlds.silent(worlds.arena_log(), slice(0, worlds.FRAMES))
    inputs = inputs_for(log, task)
    inputs = worlds.turned(replace(inputs, prior=Prior(inputs.prior.mean, LONG)), 1.0)
    run, right = step_by_step(text, inputs, task), dead_reckoning(inputs, task)
    name = "covariance in the world frame"
    if run.failure is not None:
        yield Finding(name, False, f"without readings: stopped at {run.failure.text}")
        return
    assert run.online is not None
    assert right.online is not None
    P, exact = run.online.covariance[-1], right.online.covariance[-1]
    if not np.isfinite(P).all():
        yield Finding(name, True, "it gives none, so NEES and shares inside 3 sigma stay blank")
        return
    body = world_from_body(float(right.online.pose[-1, 2]))[:2, :2]
    apart = _relative(P[:2, :2], exact[:2, :2])
    rotated = _relative(P[:2, :2], body.T @ exact[:2, :2] @ body)
    if apart <= BODY:
        yield Finding(name, True, f"{100 * apart:.2g} % from the exact one of {worlds.FRAMES} frames without readings")
    elif rotated < 0.5 * apart:
        yield Finding(
            name, False, f"{100 * apart:.2g} % from the exact one after {worlds.FRAMES} frames without readings, but "
            f"{100 * rotated:.2g} % from that in the body frame: turn it by the heading",
        )  # fmt: skip
    else:
        yield Finding(
            name, False, f"{100 * apart:.2g} % from the exact one after {worlds.FRAMES} frames without readings"
        )


def _relative(P: Array, exact: Array) -> float:
    return float(np.linalg.norm(P - exact) / np.linalg.norm(exact))


def driven(text: str, inputs: Inputs, task: str, frames: int) -> FrontEnd:
    """A front end that has gone through so many frames, under known association."""
    front = front_end(text, "known", inputs, SETUP)
    for k in range(frames):
        _through(front, inputs.frame(k))
    return front


def _through(front: FrontEnd, frame: Frame) -> None:
    front.move(frame)
    if len(frame.observations.z):
        front.update(frame, front.associate(frame))
    front.tidy()


def numbers(text: str, task: str) -> Iterator[Finding]:
    """Landmarks are numbered in the order of their creation, and stand where they were seen."""
    if task != "slam":
        return
    log = worlds.noise_free(worlds.arena_log())
    run = step_by_step(text, inputs_for(log, task), task)
    name = "landmark numbers"
    if run.failure is not None:
        return  # said before
    if run.map is None or not len(run.map):
        yield Finding(name, True, "it gives no map, so there are no landmark errors")
        return
    t = log.truth
    assert t.landmarks is not None
    assert t.landmark_of is not None
    first = named(run)
    of = np.full(int(first.max()) + 1, -1)
    of[first[first >= 0]] = t.landmark_of[first >= 0]
    unknown = run.map.number[run.map.number >= len(of)]
    if len(unknown):
        yield Finding(name, False, f"landmark {unknown[0]} is in the map; only {len(of)} were created")
        return
    away = np.hypot(*(run.map.xy - t.landmarks.positions(of[run.map.number])).T)
    i = int(np.argmax(away))
    if away[i] <= 0.5:
        yield Finding(name, True, f"{len(of)} landmarks in the order of creation, {away[i]:.2g} m off at most")
        return
    nearest = t.landmarks.id[np.argmin(np.hypot(*(t.landmarks.xy - run.map.xy[i]).T))]
    swapped = np.flatnonzero(of == nearest)
    hint = f", where number {swapped[0]} was created" if len(swapped) and swapped[0] != run.map.number[i] else ""
    yield Finding(name, False, f"landmark {run.map.number[i]} is {away[i]:.2g} m from where it was seen first{hint}")


HALF = worlds.FRAMES // 2
ROUNDING = 1e-6


def expectation(text: str, task: str) -> Iterator[Finding]:
    """With it, nearest neighbour decides as with our EKF; and `joint` has on its diagonal what `HPHt` says."""
    name = "expectation"
    inputs = inputs_for(worlds.noise_free(worlds.arena_log()), task)
    front = driven(text, inputs, task, HALF)
    if front.foreign is not None and not front.foreign.has("expect"):
        yield Finding(name, True, "it has no `expect`, so it works with --association known alone")
        return
    frame = inputs.frame(HALF)
    front.move(frame)
    try:
        e = front.estimator.expect(frame.observations)
        rows = np.arange(min(len(e.number), 4))
        joint = e.joint(rows)
    except ForeignError as stop:
        yield Finding(name, False, str(stop))
        return
    blocks = joint.reshape(len(rows), 2, len(rows), 2)[rows, :, rows, :]
    apart = float(np.abs(blocks - e.HPHt[rows]).max(initial=0.0)) / max(float(np.abs(joint).max(initial=0.0)), 1e-300)
    if apart > ROUNDING:
        yield Finding(name, False, f"joint() and HPHt differ by {100 * apart:.2g} % of the largest covariance")
        return
    asked = inputs.without_labels()
    theirs, ours = (step_by_step(n, asked, task, "nn") for n in (text, "ekf"))
    if theirs.failure is not None:
        yield Finding(name, False, f"with nearest neighbour: stopped at {theirs.failure.text}")
        return
    other = int((theirs.decisions != ours.decisions).sum())
    said = f"{other} of {len(ours.decisions)} decisions of nearest neighbour on exact readings are not those of our EKF"
    wrong = other > 0.05 * len(ours.decisions)
    yield Finding(name, not wrong, f"{said}: look at z_hat, HPHt and number" if wrong else said)


def removal(text: str, task: str) -> Iterator[Finding]:
    """A landmark that was removed is in no map, and its number is not given again."""
    if task != "slam":
        return
    name, inputs = "removal", inputs_for(worlds.noise_free(worlds.arena_log()), task)
    front = driven(text, inputs, task, HALF)
    if front.can.removable is None:
        yield Finding(name, True, "it has no `remove`, so it works without --maintain and jcbb-hindsight")
        return
    gone = np.array([0])
    try:
        front.can.removable.remove(gone)
        assert front.known is not None
        front.known.removed(gone)
        made = []
        for k in range(HALF, worlds.FRAMES):
            frame = inputs.frame(k)
            front.move(frame)
            made += [n for n in front.update(frame, front.associate(frame)).created.tolist() if n >= 0]
        held = front.estimator.landmarks().number.tolist()
    except ForeignError as stop:
        yield Finding(name, False, f"landmark 0 removed: {stop}")
        return
    if 0 in held or 0 in made:
        yield Finding(name, False, "landmark 0 was removed and is in the map again: numbers are not given twice")
    else:
        yield Finding(name, True, f"landmark 0 left the map, seen again it is number {made[0] if made else 'none'}")


class Kept(NamedTuple):
    """An array that was handed out, what it was, and what it is called."""

    name: str
    handed: Any
    before: Any


def purity(text: str, task: str) -> Iterator[Finding]:
    """Nothing that it is handed is changed; here it could be, in a run the arrays are locked and writing raises."""
    inputs = inputs_for(worlds.arena_log(), task)
    prior: Prior = _writable(inputs.prior)
    known: LandmarkMap | None = None if inputs.map is None else _writable(inputs.map)
    kept = [_kept("prior.mean", prior.mean), _kept("prior.covariance", prior.covariance)]
    if known is not None:
        kept += [_kept("map.id", known.id), _kept("map.xy", known.xy)]
    try:
        front = FrontEnd(text, "known", Beginning(prior, inputs.sensor, known), SETUP)
        for k in range(len(inputs)):
            frame = inputs.frame(k)
            if frame.increment is not None:
                increment = Increment(*(np.array(a) for a in frame.increment))
                kept += [
                    _kept(f"increment.{n} of frame {k}", a) for n, a in zip(increment._fields, increment, strict=True)
                ]
                frame = frame._replace(increment=increment)
            observations = FrameObservations(*(np.array(a) for a in frame.observations))
            kept += [
                _kept(f"sightings.{n} of frame {k}", a) for n, a in zip(observations._fields, observations, strict=True)
            ]
            _through(front, frame._replace(observations=observations))
            front.estimator.estimate()
    except ForeignError as stop:
        yield Finding("purity", False, f"{stop}")
        return
    changed = next((k for k in kept if not np.array_equal(k.handed, k.before)), None)
    if changed is None:
        yield Finding("purity", True, f"{len(kept)} arrays that it was handed are as they were")
        return
    by = float(np.abs(changed.handed - changed.before).max())
    yield Finding(
        "purity",
        False,
        f"{changed.name} was changed by up to {by:.3g}: copy what is kept (in a run inputs are locked,"
        " so that writing raises ValueError)",
    )


def _kept(name: str, handed: Any) -> Kept:
    return Kept(name, handed, handed.copy())


def _writable(locked: Any) -> Any:
    """A copy of a frozen dataclass whose arrays can be changed."""
    copy = replace(locked)
    for f in fields(copy):
        object.__setattr__(copy, f.name, np.array(getattr(copy, f.name)))
    return copy


def covariances(text: str, task: str) -> Iterator[Finding]:
    """Every covariance that it gives is symmetric and positive semidefinite, rounding aside."""
    name = "symmetric covariance"
    inputs = inputs_for(worlds.arena_log(), task)
    front = FrontEnd(text, "known", inputs, SETUP)
    off, least, blank = 0.0, np.inf, False
    try:
        for k in range(len(inputs)):
            _through(front, inputs.frame(k))
            P = front.estimator.estimate().covariance
            blank |= not np.isfinite(P).all()
            if not blank:
                off = max(off, float(np.abs(P - P.T).max()) / max(float(np.trace(P)), 1e-300))
                least = min(least, float(np.linalg.eigvalsh(P)[0]))
    except ForeignError as stop:
        yield Finding(name, False, f"frame {k}: {stop}")
        return
    yield Finding(
        name,
        True,
        "it gives none" if blank else f"asymmetry at most {off:.1g} of the trace, least eigenvalue {least:.2g}",
    )
