"""Checks of `fix` and `close_loops` of an estimator that has them, against our EKF, on a small log with both."""

from collections.abc import Iterator
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
SPREAD = 0.5  # largest relative difference of a variance: samples and approximations are below
RELATIVE = 0.05  # largest relative difference of a stated NIS


class Part(NamedTuple):
    """Fixes or closures: the estimator's method, their name in inputs and runs, and the field with their values."""

    verb: str
    name: str
    values: str

    def of(self, run: Run) -> PoseUpdated:
        """What became of these measurements in a run."""
        done: PoseUpdated = getattr(run, self.name)
        return done


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
    """Positions on a lever, headings of a turned compass, and poses, if it has `fix`."""
    yield from _checked(text, replace(measured(task), closures=None), task, FIXES)


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
    done, known = part.of(run), part.of(ours)
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
    yield from _gated(text, inputs, task, part)


def _spread(P: Array, right: Array) -> float:
    """Largest relative difference of a variance; 0 where none is given."""
    mine, exact = (np.diagonal(C, axis1=1, axis2=2) for C in (P, right))
    return float(np.nanmax(np.abs(mine - exact) / exact, initial=0.0))


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
        which = f"{part.name[: -2 if part is FIXES else -1]} {row}"
        yield Finding(name, False, f"{which}: NIS {done.nis[row]:.3g}; {right}")
    else:
        yield Finding(name, True, f"stated of {int(stated.sum())}, within {100.0 * apart[i]:.2g} %")


def _gated(text: str, inputs: Inputs, task: str, part: Part) -> Iterator[Finding]:
    """One of them is metres off; a gate is there to reject it."""
    setup, row, name = replace(SETUP, gate_poses=PROBABILITY), 2, f"{part.name}, gate"
    values = np.array(getattr(getattr(inputs, part.name), part.values))
    values[row, 0] += FAR
    changed: dict[str, Any] = {part.name: replace(getattr(inputs, part.name), **{part.values: values})}
    inputs = replace(inputs, **changed)
    done = part.of(completed(text, inputs, task, f"with {part.name}, one of them wrong: ", setup=setup)[0])
    if done.used[row]:
        yield Finding(name, False, f"one that is {FAR:.0f} m off was used; `gate` is {PROBABILITY}, of chi-square")
    else:
        yield Finding(name, True, f"one that is {FAR:.0f} m off was rejected")
