"""Replay: one log through an estimator, frame by frame (predict, expect, associate, update, record), giving a `Run`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from association.expectation import Expectation, gate_threshold
from association.known import known_decisions
from data.inputs import Increment, Inputs, IntArray, Sightings
from data.result import (
    DISCARD,
    Failure,
    Finished,
    Innovations,
    PoseEstimate,
    Run,
    Trajectory,
    Updated,
    map_estimate,
)
from ekf.filter import DEFAULT, FilterDivergedError, FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from ekf.whole_run import FilterRun, run_filter
from graph.batch import Start, smooth
from graph.factors import UnderConstrained
from graph.incremental import Isam2Smoother

LOSSES = {"batch": "gaussian", "batch-huber": "huber", "batch-cauchy": "cauchy"}


class Estimator(Protocol):
    """The verbs every step-by-step estimator has; any association method works with any of them."""

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        ...

    def expect(self, sightings: Sightings) -> Expectation:
        """What it expects to see."""
        ...

    def update(self, sightings: Sightings, decisions: IntArray, *, threshold: float = np.inf) -> Updated:
        """Use the pairings, found new landmarks."""
        ...

    def remove(self, numbers: IntArray) -> None:
        """Drop landmarks."""
        ...

    def estimate(self) -> PoseEstimate:
        """The newest pose."""
        ...

    def finish(self) -> Finished:
        """The end of the run."""
        ...


def dead_reckoning(inputs: Inputs, task: str) -> Run:
    """Prediction alone: the path composed from the increments, its covariance growing."""
    begin = time.perf_counter()
    nothing = np.full(len(inputs.observations.frame), DISCARD, np.int64)
    run = run_filter(inputs, nothing)
    return Run(
        "dead-reckoning", "none", task, Trajectory(run.pose, run.covariance), None, None, nothing, nothing,
        np.full(len(nothing), -1, np.int64), state_size=run.state_size, seconds=time.perf_counter() - begin,
    )  # fmt: skip


def filter_known(
    inputs: Inputs,
    task: str,
    *,
    threshold: float = np.inf,
    options: FilterOptions = DEFAULT,
) -> Run:
    """The EKF with labels, in one compiled loop."""
    begin = time.perf_counter()
    decisions, created = known_decisions(inputs)
    result: FilterRun = run_filter(inputs, decisions, threshold=threshold, options=options)
    seconds = time.perf_counter() - begin
    failure = None if result.failure is None else Failure("diverged", *result.failure)
    state = None
    if result.map is not None:
        kept = created.copy()
        kept[created >= len(result.map.number)] = -1  # not reached before a failure
        state = map_estimate(result.map, inputs.observations.frame, result.decisions, kept)
    total = (float(np.nansum(result.nis)), int(result.dof.sum())) if failure is None else None
    return Run(
        "ekf", "known", task, Trajectory(result.pose, result.covariance), None, state, result.decisions,
        result.decisions, created, Innovations(result.nis, result.dof, result.log_likelihood), total,
        result.state_size, seconds, failure,
    )  # fmt: skip


def make_estimator(name: str, inputs: Inputs) -> Estimator:
    """A fresh step-by-step estimator for these inputs: with a map it localizes, without it does SLAM."""
    if name == "ekf":
        if inputs.map is not None:
            return EkfLocalizer(inputs.prior, inputs.sensor, inputs.map)
        return EkfSlam(inputs.prior, inputs.sensor)
    if name == "isam2":
        return Isam2Smoother(inputs.prior, inputs.sensor, inputs.map)
    raise ValueError(f"{name!r} does not work step by step")


def step_by_step(name: str, inputs: Inputs, task: str, *, threshold: float = np.inf, finish: bool = True) -> Run:
    """Any step-by-step estimator with labels; `finish=False` stops at the last frame, without the final phase."""
    planned, _ = known_decisions(inputs)
    n, o = len(inputs), inputs.observations
    pose, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    nis, dof, likelihood = np.full(n, np.nan), np.zeros(n, np.int64), np.full(n, np.nan)
    decisions, created = planned.copy(), np.full(len(planned), -1, np.int64)
    failure: Failure | None = None
    begin = time.perf_counter()
    estimator = make_estimator(name, inputs)
    try:
        for k in range(n):
            if k > 0:
                estimator.predict(inputs.increment(k))
            rows = slice(inputs.start[k], inputs.start[k + 1])
            if rows.stop > rows.start:
                done = estimator.update(inputs.sightings(k), planned[rows], threshold=threshold)
                created[rows] = done.created
                decisions[rows] = np.where((planned[rows] >= 0) & ~done.used, DISCARD, planned[rows])
                nis[k], dof[k], likelihood[k] = done.nis, done.dof, done.log_likelihood
            pose[k], covariance[k] = estimator.estimate()
        finished = estimator.finish() if finish else Finished(None, None)
    except (FilterDivergedError, UnderConstrained) as stop:
        failure, finished = Failure("diverged", k, str(stop)), Finished(None, None)
    seconds = time.perf_counter() - begin
    state = None if finished.map is None else map_estimate(finished.map, o.frame, decisions, created)
    formed = np.isfinite(nis)
    return Run(
        name, "known", task, Trajectory(pose, covariance), finished.final, state, decisions, decisions, created,
        Innovations(nis, dof, likelihood) if formed.any() else None, finished.total_nis, None, seconds, failure,
    )  # fmt: skip


def batch(name: str, inputs: Inputs, front: Run) -> Run:
    """A batch smoother over the decisions of `front`, started at its path."""
    if front.failure is not None or front.online is None:
        why = f"the {front.estimator} it starts from stopped at frame {front.failure.frame if front.failure else 0}"
        return _failed(name, front, Failure("incomplete", 0, why), len(inputs), 0.0)
    landmarks = np.empty((0, 2)) if front.map is None else front.map.xy
    begin = time.perf_counter()
    try:
        result = smooth(
            inputs, front.final_decisions, front.created, Start(front.online.pose, landmarks), loss=LOSSES[name]
        )
    except UnderConstrained as stop:
        return _failed(name, front, Failure("diverged", 0, str(stop)), len(inputs), time.perf_counter() - begin)
    seconds = time.perf_counter() - begin
    state = None
    if result.map is not None:
        state = map_estimate(result.map, inputs.observations.frame, front.final_decisions, front.created)
    return Run(
        name, front.association, front.task, None, result.trajectory, state, front.decisions, front.final_decisions,
        front.created, None, result.total_nis, None, seconds, None, (f"decisions made by {front.estimator}",),
    )  # fmt: skip


def _failed(name: str, front: Run, failure: Failure, frames: int, seconds: float) -> Run:
    nothing = Trajectory(np.full((frames, 3), np.nan), np.full((frames, 3, 3), np.nan))
    return Run(
        name, front.association, front.task, None, nothing, None, front.decisions, front.final_decisions, front.created,
        None, None, None, seconds, failure,
    )  # fmt: skip


def compare(inputs: Inputs, task: str, estimators: Sequence[str], *, gate_known: float | None = None) -> list[Run]:
    """All estimators with labels on identical inputs; the runs come back in the order of `estimators`.

    `batch...` use the pairings that the EKF accepted and start from its path; it runs implicitly if not asked for.
    """
    if task == "slam":
        inputs = inputs.without_map()
    threshold = gate_threshold(gate_known)
    front: Run | None = None
    runs = []
    for name in estimators:
        if name == "dead-reckoning":
            runs.append(dead_reckoning(inputs, task))
        elif name == "isam2":
            runs.append(step_by_step(name, inputs, task, threshold=threshold))
        else:
            front = front or filter_known(inputs, task, threshold=threshold)
            runs.append(front if name == "ekf" else batch(name, inputs, front))
    return runs
