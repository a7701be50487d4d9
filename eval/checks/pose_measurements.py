"""Checks of `fix` and `close_loops` of an estimator that has them, on a small log with both; what is off is named.

The right result is that of our EKF, which tests compare with dense least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from data.inputs import Increments, Inputs, Prior
from data.pose_measurements import MEASURED, Closures, Fixes, FixKind, FixSource, PoseUpdated, expected_fix
from data.result import Run
from data.se2 import Array, between, wrap_angle
from eval.checks import worlds
from eval.checks.estimators import SETUP, completed, inputs_for, off
from eval.checks.finding import APPROXIMATE, EXACT, FailedError, Finding, check, graded
from eval.replay.run import front_end

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
CLOSE = 0.1  # of the deviation: a mistake that leaves no more than that is named
SPREAD = 0.5  # largest relative difference of a variance: samples and approximations are below
RELATIVE = 0.05  # largest relative difference of a stated NIS


class Part(NamedTuple):
    """Fixes or closures: the estimator's method, their name in inputs and runs, the field with their values, and the
    mistakes to tell apart. A mistake changes the measurements, or returns None where it leaves them out.
    """

    verb: str
    name: str
    values: str
    mistakes: dict[str, Callable[[Any], Fixes | Closures | None]]

    def of(self, run: Run) -> PoseUpdated:
        """What became of these measurements in a run."""
        done: PoseUpdated = getattr(run, self.name)
        return done

    def changed(self, inputs: Inputs, change: Callable[[Any], Fixes | Closures | None]) -> Inputs:
        """The inputs with changed measurements."""
        now: dict[str, Any] = {self.name: change(getattr(inputs, self.name))}
        return replace(inputs, **now)


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
        inputs,
        prior=Prior(truth[0] + L @ rng.standard_normal(3), COVARIANCE),
        increments=Increments(moved, M),
        observations=replace(inputs.observations, z=seen, R=R),
        fixes=Fixes(frame, kinds, of, z, C, SOURCES),
        closures=closures,
    )


def _sources(change: Callable[[FixSource], FixSource]) -> Callable[[Fixes], Fixes]:
    return lambda f: replace(f, sources=tuple(map(change, f.sources)))


COVARIANCES: dict[str, Callable[[Any], Fixes | Closures | None]] = {
    "correlations within their covariance are dropped": lambda f: replace(f, covariance=f.covariance * np.eye(3)),
    "their covariance is doubled": lambda f: replace(f, covariance=2.0 * f.covariance),
    "their covariance is halved": lambda f: replace(f, covariance=0.5 * f.covariance),
}
FIXES = Part("fix", "fixes", "z", {
    "they are not used": lambda f: None,
    "the source's lever is left out": _sources(lambda s: replace(s, lever=(0.0, 0.0))),
    "the source's lever has the wrong sign": _sources(lambda s: replace(s, lever=(-s.lever[0], -s.lever[1]))),
    "the source's rotation is left out": _sources(lambda s: replace(s, rotation=0.0)),
    "the source's rotation has the wrong sign": _sources(lambda s: replace(s, rotation=-s.rotation)),
} | COVARIANCES)  # fmt: skip
CLOSURES = Part("close_loops", "closures", "relative", {
    "they are not used": lambda c: None,
    "frame1 and frame2 are swapped": lambda c: replace(c, frame1=c.frame2, frame2=c.frame1),
} | COVARIANCES)  # fmt: skip


@check("fixes")
def fixes(text: str, task: str) -> Iterator[Finding | str]:
    """Positions on a lever, headings of a turned compass, and poses, if it has `fix`."""
    yield from _checked(text, replace(measured(task), closures=None), task, FIXES)


@check("closures")
def closures(text: str, task: str) -> Iterator[Finding | str]:
    """Relative poses to earlier frames, in both directions, if it has `close_loops`."""
    yield from _checked(text, replace(measured(task), fixes=None), task, CLOSURES)


def _checked(text: str, inputs: Inputs, task: str, part: Part) -> Iterator[Finding | str]:
    can = front_end(text, "known", inputs, SETUP).can
    if (can.fixable if part is FIXES else can.closable) is None:
        yield f"it has no `{part.verb}`, so it works without a log's {part.name}"
        return
    where = f"with {part.name}: "
    setup = replace(SETUP, gate_poses=None)
    (run, path), (ours, right) = (completed(name, inputs, task, where, setup=setup) for name in (text, "ekf"))
    done, known = part.of(run), part.of(ours)
    count, used = len(done.used), int(done.used.sum())
    if used < count and part is CLOSURES and not np.isfinite(done.nis[~done.used]).any():
        yield f"{used} of {count} closures used; it no longer knows the earlier frame of the others"
        return
    if used < count:
        raise FailedError(f"{used} of {count} {part.name} used without a gate; all are right")
    far = off(path.pose.copy(), right.pose, right.covariance)
    spread = _spread(path.covariance, right.covariance)
    worst = max(far, spread)
    if worst > EXACT and (cause := _likely(inputs, task, part, path.pose, path.covariance, worst)):
        what = f"{far:.2g} sigma" if far >= spread else f"{100.0 * spread:.2g} % of a variance"
        raise FailedError(f"{what} off after {count} {part.name}. Likely: {cause}")
    yield graded(part.name, far, f"the path with {count} {part.name}")
    if np.isfinite(path.covariance).all():
        said = f"variances with {count} {part.name} within {100.0 * spread:.2g} % of those of our EKF"
        yield Finding(f"{part.name}, covariance", spread <= SPREAD, said)
    yield from _stated(part, done, known, far)
    yield from _gated(text, inputs, task, part)


def _spread(P: Array, right: Array) -> float:
    """Largest relative difference of a variance; 0 where none is given."""
    mine, exact = (np.diagonal(C, axis1=1, axis2=2) for C in (P, right))
    return float(np.nanmax(np.abs(mine - exact) / exact, initial=0.0))


def _likely(inputs: Inputs, task: str, part: Part, pose: Array, P: Array, worst: float) -> str | None:
    """The mistake with which our EKF gives this path, if one is known."""
    setup = replace(SETUP, gate_poses=None)
    each = {}
    for cause, change in part.mistakes.items():
        wrong = completed("ekf", part.changed(inputs, change), task, setup=setup)[1]
        each[cause] = max(off(pose.copy(), wrong.pose, wrong.covariance), _spread(P, wrong.covariance))
    cause = min(each, key=lambda c: each[c])
    return cause if each[cause] < CLOSE * worst else None


def _stated(part: Part, done: PoseUpdated, known: PoseUpdated, far: float) -> Iterator[Finding]:
    """The NIS that it states, which is not needed."""
    name, stated = f"{part.name}, NIS", np.isfinite(done.nis)
    if not stated.any():
        return
    apart = np.abs(done.nis - known.nis)[stated] / np.maximum(known.nis, known.dof)[stated]
    i = int(np.argmax(apart))
    allowed = RELATIVE if far <= EXACT else APPROXIMATE
    row = int(np.flatnonzero(stated)[i])
    if apart[i] > allowed:
        right = f"{known.nis[row]:.3g} is that of its innovation before it is used, nu' S^-1 nu"
        yield Finding(
            name, False, f"{part.name[: -2 if part is FIXES else -1]} {row}: NIS {done.nis[row]:.3g}; {right}"
        )
    else:
        yield Finding(name, True, f"stated of {int(stated.sum())}, within {100.0 * apart[i]:.2g} %")


def _gated(text: str, inputs: Inputs, task: str, part: Part) -> Iterator[Finding]:
    """One of them is metres off; a gate is there to reject it."""
    setup, row, name = replace(SETUP, gate_poses=PROBABILITY), 2, f"{part.name}, gate"
    values = np.array(getattr(getattr(inputs, part.name), part.values))
    values[row, 0] += FAR
    inputs = part.changed(inputs, lambda f: replace(f, **{part.values: values}))
    done = part.of(completed(text, inputs, task, f"with {part.name}, one of them wrong: ", setup=setup)[0])
    if done.used[row]:
        yield Finding(name, False, f"one that is {FAR:.0f} m off was used; `gate` is {PROBABILITY}, of chi-square")
    else:
        yield Finding(name, True, f"one that is {FAR:.0f} m off was rejected")
