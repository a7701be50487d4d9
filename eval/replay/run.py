"""Replay: one log through an estimator and a way of association, giving a `Run`; `compare` does so for many of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from association.decide import known_decisions
from association.expectation import SingularInnovationError, gate_threshold
from association.scans.constraints import SCAN
from association.truncated import truncated_square
from data.inputs import Frame, Inputs, IntArray
from data.notice import stopped
from data.result import DISCARD, Failure, Finished, Innovations, Run, Trajectory, Updated, map_estimate
from data.se2 import Array
from ekf.epochs import run_in_epochs, worthwhile
from ekf.filter import FilterDivergedError, FilterOptions
from ekf.slam import EkfSlam
from ekf.whole_run import FilterRun, run_filter
from eval.replay.batch import batch
from eval.replay.estimators import OPTIONS, lack_with_walls
from eval.replay.external.guard import ForeignError
from eval.replay.external.load import Thing, text_of
from eval.replay.external.make import CannotError, require
from eval.replay.external.spec import is_foreign, name_of
from eval.replay.frontend import FrontEnd
from eval.replay.hindsight.localizing_frontend import LocalizingFrontEnd
from eval.replay.hindsight.mapping_frontend import MappingFrontEnd
from eval.replay.laser.comparison import compare_laser
from eval.replay.laser.landmarks import at_all_frames, corner_log
from eval.replay.recorder import NullObserver, Observer, Recorder, Writing, no_run
from eval.replay.settings import BATCH, FILTERS, HINDSIGHT, Given, Setup
from graph.factors import UnderConstrained

PLAIN = Setup()
NULL_OBSERVER = NullObserver()
DIVERGED = (FilterDivergedError, UnderConstrained, SingularInnovationError)
"""What an estimator of ours raises when it cannot go on."""


def dead_reckoning(inputs: Inputs, task: str) -> Run:
    """Prediction alone: the path composed from the increments, its covariance growing."""
    begin = time.perf_counter()
    nothing = np.full(len(inputs.observations.frame), DISCARD, np.int64)
    run = run_filter(inputs if inputs.systematic is None else replace(inputs, systematic=None), nothing)
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
    """A filter with labels, in one compiled loop; a large map is parked where that is faster."""
    begin = time.perf_counter()
    decisions, created = known_decisions(inputs)
    options = options or OPTIONS[name]
    epochs = worthwhile(inputs, decisions, options)
    result: FilterRun = (
        run_filter(inputs, decisions, threshold=threshold, options=options)
        if epochs is None
        else run_in_epochs(inputs, decisions, epochs, threshold=threshold, options=options)
    )
    seconds = time.perf_counter() - begin
    failure, decided = None, result.decisions
    if result.failure is not None:
        failure = Failure("diverged", result.failure[0], stopped(result.failure[1]))
        unreached = inputs.observations.frame >= failure.frame
        decided, created = np.where(unreached, DISCARD, decided), np.where(unreached, -1, created)
    state = None
    if result.map is not None:
        kept = created.copy()
        kept[created >= len(result.map.number)] = -1  # not reached before a failure
        state = map_estimate(result.map, inputs.observations.frame, decided, kept)
    total = (float(np.nansum(result.nis)), int(result.dof.sum())) if failure is None else None
    mean, variance = truncated_square(threshold)
    return Run(
        name, "known", task, Trajectory(result.pose, result.covariance), None, state, decided,
        decided, created, Innovations(result.nis, result.dof, result.log_likelihood, result.white), total,
        result.state_size, seconds, failure, gated=(mean / 2, variance / 2), errors_online=result.errors,
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
    observer: Observer = NULL_OBSERVER,
) -> Run:
    """Any step-by-step estimator with any way of association; `finish=False` stops without the final phase.

    With `options.each` association, too, goes observation by observation, each with its own update. `observer` sees
    every stage and changes nothing but the time taken.
    """
    begin = time.perf_counter()
    setup = setup.settled(inputs.labels_are_sensed)
    try:
        if is_foreign(name):
            require(name, task, association, setup)
        front = front_end(name, association, inputs, setup, options)
    except CannotError as stop:
        return no_run(name_of(name), name_of(association), task, inputs, Failure("incomplete", 0, stopped(str(stop))))
    except ForeignError as stop:  # its constructor crashed
        failure = Failure("diverged", 0, stopped(str(stop)), stop.trace)
        return no_run(name_of(name), name_of(association), task, inputs, failure)
    each = options is not None and options.each
    run = driven(name, front, inputs, task, each=each, finish=finish, observer=observer)
    return replace(run, seconds=time.perf_counter() - begin)


def driven(
    name: str,
    front: FrontEnd,
    inputs: Inputs,
    task: str,
    *,
    each: bool = False,
    finish: bool = True,
    observer: Observer = NULL_OBSERVER,
) -> Run:
    """A front end before its first frame, driven over a whole log; arguments as of `step_by_step`."""
    begin = time.perf_counter()
    record = Recorder(len(inputs), len(inputs.observations.frame), inputs.systematic)
    failure, finished = None, Finished(None, None)
    try:
        for k in range(len(inputs)):
            through(front, inputs.frame(k), record.update, each=each, observer=observer)
            observer.updated(front, record.decisions, record.created)
            record.estimate(front)
        if finish:
            front.close()
            finished = front.estimator.finish()
    except DIVERGED as stop:
        failure = Failure("diverged", front.k, stopped(str(stop)))
    except ForeignError as stop:
        failure = Failure("diverged", max(front.k, 0), stopped(str(stop)), stop.trace)
    return record.run(name_of(name), task, front, finished, failure, time.perf_counter() - begin)


def through(
    front: FrontEnd,
    frame: Frame,
    used: Callable[[Frame, IntArray, Updated], None],
    *,
    each: bool = False,
    observer: Observer = NULL_OBSERVER,
) -> None:
    """One frame through a front end, from a log or while a robot drives; afterwards the estimator has its estimate.

    `used` is told of (each part of) the frame with its decisions and what the update did with them.
    """
    front.move(frame)  # predict
    observer.moved(front)
    for part in _parts(frame, each):
        pairing = front.associate(part)  # expect and decide
        observer.decided(front, part, pairing)
        done = front.update(part, pairing)  # with all pairings, then new landmarks
        used(part, pairing.decisions, done)
    front.tidy()  # landmarks leave the map


def front_end(
    name: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
) -> FrontEnd:
    """What decides and updates frame by frame, before the first frame. Raises CannotError for what walls forbid."""
    why = lack_with_walls(name, "slam" if given.map is None else "localization", association, given, options)
    if why is not None:
        raise CannotError(why)
    kind = FrontEnd
    if association == HINDSIGHT:
        kind = MappingFrontEnd if given.map is None else LocalizingFrontEnd
    return kind(name, association, given, setup, options)


def _parts(frame: Frame, each: bool) -> list[Frame]:
    """A frame's observations: together, or one by one."""
    count = len(frame.observations.z)
    if each:
        return [frame.part(slice(i, i + 1)) for i in range(count)]
    return [frame] if count else []


def compare(
    inputs: Inputs,
    task: str,
    estimators: Sequence[str | Thing],
    association: str | Thing = "known",
    setup: Setup = PLAIN,
    watch: Callable[[Inputs], Writing] | None = None,
    judge: Callable[[Sequence[Run], Inputs], list[Run]] = lambda runs, _: list(runs),
) -> list[Run]:
    """Estimators with one way of association on identical inputs; the runs come in the order of `estimators`.

    Beside names of ours stand settled texts of foreign ones (`eval.replay.external`), or classes and functions as they
    are, which then have their own names.

    `batch...` take the decisions of a front end and start from its path: under `known` those of the EKF (and, where
    that leads to no good end, at the iterated one's), otherwise those of iSAM2, or of the EKF if iSAM2 was not asked
    for. A front end that was not asked for runs all the same. Where the setup's gate for labels is not for smoothers,
    they get every pairing and start at the gated EKF's path.
    With `scan` the scans of a laser log are matched and loops closed; under any other name the corners of walls in them
    are the landmarks.
    Labels are withheld from every method but `known`. Labels that a sensor read are gated where the setup does not say
    otherwise (`Setup.settled`).
    `watch` makes an observer of each replay of point landmarks; what it writes down is the run's `watched`. `judge`
    gets the runs with what they had, before either is turned into something else (`eval.compare`: the referee).
    """
    names, association = [text_of(e, "estimator") for e in estimators], text_of(association, "association")
    # sums over two threads round otherwise than over one: the same bytes for any number of processes and cores
    with threadpool_limits(1):
        if association == SCAN:
            return judge(compare_laser(inputs, names, setup), inputs)
        if inputs.scans is not None and not len(inputs.observations.frame):
            log = corner_log(inputs, setup)
            runs = judge(_compare(log.inputs, task, names, association, setup), log.inputs)
            return [at_all_frames(run, log, len(inputs)) for run in runs]
        return judge(_compare(inputs, task, names, association, setup, watch), inputs)


def _compare(
    inputs: Inputs,
    task: str,
    estimators: Sequence[str],
    association: str,
    setup: Setup,
    watch: Callable[[Inputs], Writing] | None = None,
) -> list[Run]:
    if task == "slam":
        inputs = inputs.without_map()
    if association != "known":
        inputs = inputs.without_labels()
    each = _Comparison(inputs, task, estimators, association, setup.settled(inputs.labels_are_sensed), watch)
    runs = [each.run(name) for name in estimators]
    return runs if inputs.sensor.sees_points else [replace(run, walls=True) for run in runs]


class _Comparison:
    """The runs of one comparison; each front end runs once, whoever needs it."""

    def __init__(
        self,
        inputs: Inputs,
        task: str,
        estimators: Sequence[str],
        association: str,
        setup: Setup,
        watch: Callable[[Inputs], Writing] | None,
    ) -> None:
        self.inputs, self.task, self.estimators, self.association = inputs, task, estimators, association
        self.setup, self.watch = setup, watch
        self._done: dict[str, Run] = {}

    def run(self, name: str) -> Run:
        """An estimator by its name."""
        if name == "dead-reckoning":
            return dead_reckoning(self.inputs, self.task)
        return self._batch(name) if name in BATCH else self._ahead(name)

    def _ahead(self, name: str) -> Run:
        if name not in self._done:
            self._done[name] = self._stepping(name)
        return self._done[name]

    def _stepping(self, name: str) -> Run:
        """In one compiled loop where that can be; what is compiled cannot be watched: the same steps once more."""
        quick = self._compiled(name)
        if quick is not None and self.watch is None:
            return quick
        observer = None if self.watch is None else self.watch(self.inputs)
        slow = step_by_step(
            name, self.inputs, self.task, self.association, self.setup, observer=observer or NULL_OBSERVER
        )
        if observer is None:
            return slow
        return replace(quick or replace(slow, seconds=slow.seconds - observer.seconds), watched=observer.left())

    def _compiled(self, name: str) -> Run | None:
        managed = self.setup.manages_map and self.task == "slam"
        if name not in FILTERS or self.association != "known" or managed:
            return None
        if lack_with_walls(name, self.task, self.association, self.inputs) is not None:
            return None
        return filter_known(self.inputs, self.task, name=name, threshold=gate_threshold(self.setup.label_gate))

    def _batch(self, name: str) -> Run:
        if self.association != "known":
            return batch(name, self.inputs, self._ahead("isam2" if "isam2" in self.estimators else "ekf"), None)
        # whatever else was asked for; the iterated filter's path is better where the plain one gets lost
        front = self._ahead("ekf")
        if front.failure is not None:
            front = self._ahead("ekf-iterated")
        if not self.setup.gate_smoothers:
            decisions, created = known_decisions(self.inputs)
            front = replace(front, decisions=decisions, final_decisions=decisions, created=created, begun=None)
        return batch(name, self.inputs, front, lambda: self._ahead("ekf-iterated"))


MOST_WORK = 3e7
"""Entries of covariances, frame by frame: beyond (Victoria Park: 2e9) looking again takes longer than a figure may."""


def landmark_sigmas(inputs: Inputs, run: Run) -> Array | None:
    """Standard deviation (N, L) [m] of each landmark along its least certain direction after every frame.

    NaN before a landmark is initialized and after it was removed. None of runs that are no EKF-SLAM of ours from start
    to end, that parked landmarks, or that are too large to be looked at again.
    """
    size = run.state_size
    if run.estimator not in FILTERS or run.task != "slam" or run.failure is not None or size is None:
        return None
    if float(np.sum(np.asarray(size, float) ** 2)) > MOST_WORK or run.events:
        return None
    inputs = inputs.without_map().without_labels()
    estimator = EkfSlam(inputs.prior, inputs.sensor, OPTIONS[run.estimator], systematic=inputs.systematic)
    count = int(run.created.max(initial=-1)) + 1
    sigma = np.full((len(inputs), count), math.nan)
    for k in range(len(inputs)):
        frame = inputs.frame(k)
        if frame.increment is not None:
            estimator.predict(frame.increment)
        rows = slice(frame.first, frame.first + len(frame.observations.z))
        if rows.stop > rows.start:
            done = estimator.update(frame.observations, run.decisions[rows])
            if not np.array_equal(done.created, run.created[rows]):
                return None
        if run.removed is not None and np.any(run.removed == k):
            estimator.remove(np.flatnonzero(run.removed == k))
        m = estimator.landmarks()
        if len(m.number):
            largest = np.linalg.eigvalsh(m.covariance)[:, -1]
            sigma[k, m.number] = np.sqrt(np.maximum(largest, 0.0))
        if not np.allclose(estimator.estimate().mean, run.trajectory("online").pose[k], atol=1e-6):
            return None
    return sigma
