"""Replay: one log through an estimator and a way of association, giving a `Run`; `compare` does so for many of them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from association.decide import HINDSIGHT
from association.expectation import SingularInnovationError, gate_threshold
from association.known import known_decisions
from data.inputs import Frame, Inputs
from data.result import DISCARD, Failure, Finished, Innovations, Run, Trajectory, founders, map_estimate, revised
from ekf.filter import FilterDivergedError, FilterOptions
from ekf.whole_run import FilterRun, run_filter
from eval.replay.batch import BATCH, batch
from eval.replay.estimators import FILTERS
from eval.replay.frontend import FrontEnd, Watch
from eval.replay.given import Given
from eval.replay.hindsight.localizing_frontend import LocalizingFrontEnd
from eval.replay.hindsight.mapping_frontend import MappingFrontEnd
from eval.replay.settings import Setup
from graph.factors import UnderConstrained

PLAIN = Setup()


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
    name: str = "ekf",
    threshold: float = np.inf,
    options: FilterOptions | None = None,
) -> Run:
    """A filter with labels, in one compiled loop."""
    begin = time.perf_counter()
    decisions, created = known_decisions(inputs)
    result: FilterRun = run_filter(inputs, decisions, threshold=threshold, options=options or FILTERS[name])
    seconds = time.perf_counter() - begin
    failure, decided = None, result.decisions
    if result.failure is not None:
        failure = Failure("diverged", *result.failure)
        unreached = inputs.observations.frame >= failure.frame
        decided, created = np.where(unreached, DISCARD, decided), np.where(unreached, -1, created)
    state = None
    if result.map is not None:
        kept = created.copy()
        kept[created >= len(result.map.number)] = -1  # not reached before a failure
        state = map_estimate(result.map, inputs.observations.frame, result.decisions, kept)
    total = (float(np.nansum(result.nis)), int(result.dof.sum())) if failure is None else None
    return Run(
        name, "known", task, Trajectory(result.pose, result.covariance), None, state, decided,
        decided, created, Innovations(result.nis, result.dof, result.log_likelihood, result.white), total,
        result.state_size, seconds, failure,
    )  # fmt: skip


def step_by_step(
    name: str,
    inputs: Inputs,
    task: str,
    association: str = "known",
    setup: Setup = PLAIN,
    *,
    options: FilterOptions | None = None,
    finish: bool = True,
    watch: Watch | None = None,
) -> Run:
    """Any step-by-step estimator with any way of association; `finish=False` stops without the final phase.

    With `options.each` association, too, goes observation by observation, each with its own update. `watch` is told of
    every stage and changes nothing but the time taken.
    """
    n, o = len(inputs), inputs.observations
    m = len(o.frame)
    pose, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    nis, dof, likelihood = np.full(n, np.nan), np.zeros(n, np.int64), np.full(n, np.nan)
    size, white = np.zeros(n, np.int64), np.full((m, 2), np.nan)
    decisions, created = np.full(m, DISCARD, np.int64), np.full(m, -1, np.int64)
    failure: Failure | None = None
    begin = time.perf_counter()
    front = front_end(name, association, inputs, setup, options)
    try:
        for k in range(n):
            frame = inputs.frame(k)
            front.move(frame)
            if watch is not None:
                watch.moved(front)
            for part in _portions(frame, options is not None and options.each):
                rows = slice(part.first, part.first + len(part.sightings.z))
                decided, done = front.associate(part, watch)
                created[rows] = done.created
                decisions[rows] = np.where((decided >= 0) & ~done.used, DISCARD, decided)
                if done.white is not None:
                    white[rows] = done.white
                if np.isfinite(done.nis):
                    first = not np.isfinite(nis[k])
                    nis[k], likelihood[k] = (
                        (done.nis, done.log_likelihood)
                        if first
                        else (nis[k] + done.nis, likelihood[k] + done.log_likelihood)
                    )
                    dof[k] += done.dof
            front.tidy()
            if watch is not None:
                watch.updated(front, decisions, created)
            pose[k], covariance[k] = front.estimator.estimate()
            size[k] = front.size
        if finish:
            front.close()
        finished = front.estimator.finish() if finish else Finished(None, None)
    except (FilterDivergedError, UnderConstrained, SingularInnovationError) as stop:
        failure, finished = Failure("diverged", k, str(stop)), Finished(None, None)
    seconds = time.perf_counter() - begin
    final = decisions
    removed = None
    if front.upkeep is not None:
        removed = front.upkeep.removal_frames(int(created.max(initial=-1)) + 1)
        retracted = np.isin(np.where(created >= 0, created, decisions), sorted(front.upkeep.retracted))
        final = np.where(retracted, DISCARD, decisions)
    events = front.events()
    final = revised(final, events)
    state = None if finished.map is None else map_estimate(finished.map, o.frame, final, founders(final, created))
    formed = np.isfinite(nis)
    innovations = Innovations(nis, dof, likelihood, white) if formed.any() else None
    total = finished.total_nis
    if name in FILTERS and innovations is not None and failure is None:
        total = float(np.nansum(nis)), int(dof.sum())
    return Run(
        name, association, task, Trajectory(pose, covariance), finished.final, state, decisions, final, created,
        innovations, total, size if name in FILTERS else None, seconds, failure, tuple(front.notes()), removed,
        events,
    )  # fmt: skip


def front_end(
    name: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
) -> FrontEnd:
    """What decides and updates frame by frame, before the first frame."""
    kind = FrontEnd
    if association == HINDSIGHT:
        kind = MappingFrontEnd if given.map is None else LocalizingFrontEnd
    return kind(name, association, given, setup, options)


def _portions(frame: Frame, each: bool) -> list[Frame]:
    """A frame's observations: together, or one by one."""
    count = len(frame.sightings.z)
    if each:
        return [frame.part(slice(i, i + 1)) for i in range(count)]
    return [frame] if count else []


def compare(
    inputs: Inputs,
    task: str,
    estimators: Sequence[str],
    association: str = "known",
    setup: Setup = PLAIN,
) -> list[Run]:
    """Estimators with one way of association on identical inputs; the runs come in the order of `estimators`.

    `batch...` take the decisions of a front end and start from its path: under `known` those of the EKF (the iterated
    one if that was asked for), otherwise those of iSAM2, or of the EKF if iSAM2 was not asked for. A front end that was
    not asked for runs all the same. Where the setup's gate for labels is not for smoothers, they get every pairing and
    start at the gated EKF's path.
    Labels are withheld from every method but `known`.
    """
    # sums over two threads round otherwise than over one: the same bytes for any number of processes and cores
    with threadpool_limits(1):
        return _compare(inputs, task, estimators, association, setup)


def _compare(inputs: Inputs, task: str, estimators: Sequence[str], association: str, setup: Setup) -> list[Run]:
    if task == "slam":
        inputs = inputs.without_map()
    if association != "known":
        inputs = inputs.without_labels()
    done: dict[str, Run] = {}

    def ahead(name: str) -> Run:
        if name not in done:
            quick = name in FILTERS and association == "known" and not (setup.upkeep and task == "slam")
            done[name] = (
                filter_known(inputs, task, name=name, threshold=gate_threshold(setup.gate_known))
                if quick
                else step_by_step(name, inputs, task, association, setup)
            )
        return done[name]

    runs = []
    for name in estimators:
        if name == "dead-reckoning":
            runs.append(dead_reckoning(inputs, task))
        elif name in BATCH:
            if (
                association == "known"
            ):  # the pairings are the same, the start is better where the plain filter gets lost
                first = "ekf-iterated" if "ekf-iterated" in estimators else "ekf"
            else:
                first = "isam2" if "isam2" in estimators else "ekf"
            front = ahead(first)
            if association == "known" and not setup.gate_smoothers:
                decisions, created = known_decisions(inputs)
                front = replace(front, decisions=decisions, final_decisions=decisions, created=created)
            runs.append(batch(name, inputs, front))
        else:
            runs.append(ahead(name))
    return runs
