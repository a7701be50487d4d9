"""Batch smoothers over the decisions that a front end made, started at its path."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from data.inputs import Inputs, IntArray
from data.notice import Code, Severity, notice, stopped
from data.result import DISCARD, Failure, Run, Trajectory, map_estimate
from data.se2 import BoolArray
from graph.batch import Smoothed, Start, smooth
from graph.factors import UnderConstrained
from graph.optimum import NotConvergedError
from graph.robust import gnc

LOSSES = {"batch": "gaussian", "batch-huber": "huber", "batch-cauchy": "cauchy"}
"""Of the batch smoothers by name, `gnc` aside."""
LOWER = 1e-6
"""Share of its cost by which another minimum must be lower to be another one."""


def batch(name: str, inputs: Inputs, front: Run, other: Callable[[], Run] | None = None) -> Run:
    """A batch smoother over the final decisions of `front`, started at its path.

    Where that leads to no minimum, or to one so high that it may be a wrong one, the path of `other` (a run with the
    same landmark numbers) is tried as well, and the lowest minimum counts.

    `gnc` chooses among them itself: a pairing that it leaves out is discarded in the end, and so is a landmark of which
    no observation is left.
    """
    if front.failure is not None or front.online is None:
        at = front.failure.frame if front.failure else 0
        why = notice(Code.FRONT_END_STOPPED, Severity.ERROR, front=front.estimator, at=at)
        return _failed(name, front, Failure("incomplete", 0, why), len(inputs), 0.0)
    begin = time.perf_counter()
    # what was retracted has no landmark; what a filter merely forgot is smoothed like all others
    initialized = front.initialized
    start = start_at(inputs, front, initialized)
    final, notes = front.final_decisions, [notice(Code.DECIDED_BY, Severity.INFO, front=front.estimator)]
    try:
        if name == "gnc":
            result, accepted = gnc(inputs, final, initialized, start)
            left_out = _left_out(final, initialized, accepted)
            rejected = int((~accepted & (np.where(initialized >= 0, initialized, final) >= 0)).sum())
            notes.append(notice(Code.OBSERVATIONS_REJECTED, Severity.INFO, observations=rejected))
            final, initialized = np.where(left_out, DISCARD, final), np.where(left_out, -1, initialized)
        else:
            result = _lowest(inputs, final, initialized, start, LOSSES[name], other)
    except UnderConstrained as stop:
        return _failed(
            name, front, Failure("diverged", 0, stopped(str(stop))), len(inputs), time.perf_counter() - begin
        )
    seconds = time.perf_counter() - begin
    state = None
    if result.map is not None:
        state = map_estimate(result.map, inputs.observations.frame, final, initialized)
    return Run(
        name, front.association, front.task, None, result.trajectory, state, front.decisions, final,
        front.created, None, result.total_nis, None, seconds, None, tuple(notes), front.removed, gated=front.gated,
        iterations=result.iterations, last_step_sigma=result.last_step, errors_final=result.systematic,
        begun=None if front.begun is None else initialized, gated_final=front.gated_final,
    )  # fmt: skip


def _lowest(
    inputs: Inputs,
    final: IntArray,
    initialized: IntArray,
    start: Start,
    loss: str,
    other: Callable[[], Run] | None,
) -> Smoothed:
    """The minimum from `start`, or from the path of another run if that is a lower one."""
    result, stop = None, None
    try:
        result = smooth(inputs, final, initialized, start, loss=loss)
    except NotConvergedError as fault:
        stop = fault
    if other is not None and (result is None or result.suspect):
        run = other()
        if run.failure is None and run.online is not None:
            try:
                found = smooth(inputs, final, initialized, start_at(inputs, run, initialized), loss=loss)
            except NotConvergedError as fault:
                stop = fault
            else:
                if result is None or found.cost < result.cost * (1.0 - LOWER):
                    result = found
    if result is None:
        assert stop is not None
        raise stop
    return result


def _left_out(decisions: IntArray, initialized: IntArray, accepted: BoolArray) -> BoolArray:
    """Observations (M,) discarded at the end: rejected pairings, and those of landmarks without any left."""
    number = np.where(initialized >= 0, initialized, decisions)
    alive = np.unique(number[accepted])
    return (number >= 0) & np.where(initialized >= 0, ~np.isin(number, alive), ~accepted)


def start_at(inputs: Inputs, front: Run, initialized: IntArray) -> Start:
    """A front end's path, and its map; a landmark that it dropped stands where it was initialized.

    `initialized` (M,): number of the landmark that an observation initialized, -1 for none.
    """
    assert front.online is not None
    places = np.full((int(initialized.max(initial=-1)) + 1, 2), np.nan)
    if front.map is not None:
        o = inputs.observations
        for i in np.flatnonzero(initialized >= 0):
            pose = front.online.pose[o.frame[i]]
            places[initialized[i]] = inputs.sensor.inverse(pose, o.z[i : i + 1])[0][0]
        held = front.map.number < len(places)
        places[front.map.number[held]] = front.map.xy[held]
    # the errors as the front end knows them in the end; knots of the drift that it has forgotten are the last one's
    known = front.errors_final or front.errors_online
    errors = None if known is None else np.broadcast_to(known.mean[-1], known.mean.shape)
    return Start(front.online.pose, places, errors)


def _failed(name: str, front: Run, failure: Failure, frames: int, seconds: float) -> Run:
    nothing = Trajectory(np.full((frames, 3), np.nan), np.full((frames, 3, 3), np.nan))
    return Run(
        name, front.association, front.task, None, nothing, None, front.decisions, front.final_decisions, front.created,
        None, None, None, seconds, failure, (), front.removed,
    )  # fmt: skip
