"""Replay: one log through an estimator and an association method, giving a `Run`; `compare` runs many of them."""

import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import ThreadpoolController

from association.decide import known_decisions
from association.expectation import SingularInnovationError, gate_threshold
from association.truncated import truncated_square
from data.errors import SlamrefError, UsageError, unknown
from data.inputs import Frame, Inputs, IntArray, LabelledObservations
from data.notice import Code, Notice, notice, stopped
from data.result import DISCARD, Failure, Finished, Innovations, Run, Trajectory, Updated, map_estimate
from data.wing import of_all
from ekf.filter import FilterDivergedError, FilterOptions
from ekf.whole_run import run_filter, worthwhile
from eval.replay.batch import batch
from eval.replay.estimators import OPTIONS, dead_reckoning, lack_with_sensor
from eval.replay.external.adapter import CannotError, ForeignError, Thing, in_one_line, require, text_of
from eval.replay.external.spec import is_foreign, name_of
from eval.replay.frontend import FrontEnd
from eval.replay.hindsight.localizing_frontend import LocalizingFrontEnd
from eval.replay.hindsight.mapper import MappingFrontEnd
from eval.replay.hindsight.multi_hypothesis import MultiHypothesisFrontEnd
from eval.replay.recorder import Observer, ObserverError, Recorder, Writing, missing_run, observe
from eval.replay.settings import BATCH, FILTERS, HINDSIGHT, MHT, TASKS, Given, Setup
from graph.factors import UnderConstrained

PLAIN = Setup()
NULL_OBSERVER = Observer()
DIVERGED = (FilterDivergedError, UnderConstrained, SingularInnovationError)  # Errors of estimators that cannot continue


def crashed(fault: Exception, frame: int) -> Failure:
    """The failure of an estimator in which an exception was raised: it alone has failed, whatever runs beside it.
    Errors of the input and a lack of memory are raised again: they concern the whole log.
    """
    if isinstance(fault, ForeignError):
        return Failure("diverged", frame, stopped(str(fault)), fault.trace)
    if isinstance(fault, DIVERGED):
        return Failure("diverged", frame, stopped(str(fault)))
    if isinstance(fault, (SlamrefError, MemoryError)):
        raise fault
    return Failure("diverged", frame, stopped(in_one_line(fault)), "".join(traceback.format_exception(fault)))


_found: tuple[int, ThreadpoolController] | None = None


def one_thread() -> AbstractContextManager[object]:
    """One thread of linear algebra: sums over several round differently, and bytes must not depend on cores. Libraries
    are searched again (5 ms) only after further modules were imported.
    """
    global _found
    modules = len(sys.modules)
    if _found is None or _found[0] != modules:
        _found = modules, ThreadpoolController()
    limited: AbstractContextManager[object] = _found[1].limit(limits=1)
    return limited


def filter_known(inputs: Inputs, task: str, *, name: str = "ekf", threshold: float = np.inf) -> Run:
    """A filter with labels, in one compiled loop; a large map is parked where that is faster."""
    begin = time.perf_counter()
    decisions, created = known_decisions(inputs)
    epochs = worthwhile(inputs, decisions, OPTIONS[name])
    result = run_filter(inputs, decisions, threshold=threshold, options=OPTIONS[name], epochs=epochs)
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
    name: str, inputs: Inputs, task: str, association: str = "known", setup: Setup = PLAIN, *,
    options: FilterOptions | None = None, finish: bool = True, observer: Observer = NULL_OBSERVER,
) -> Run:  # fmt: skip
    """Any estimator, step by step; `finish=False`: without the final phase. `observer` sees every stage."""
    _check_granted(inputs, association)
    setup = setup.settled(inputs.labels_are_sensed)
    if not setup.appearance:
        inputs = inputs.without_appearance()
    try:
        if is_foreign(name):
            require(name, task, association, setup)
        front = front_end(name, association, inputs, setup, options)
    except CannotError as stop:
        return missing_run(name, association, task, inputs, Failure("incomplete", 0, stopped(str(stop))))
    except Exception as stop:  # noqa: BLE001 - whatever its constructor raised
        return missing_run(name, association, task, inputs, crashed(stop, 0))
    return driven(name, front, inputs, task, finish=finish, observer=observer)


def driven(
    name: str, front: FrontEnd, inputs: Inputs, task: str, *, finish: bool = True, observer: Observer = NULL_OBSERVER
) -> Run:
    """Run a front end over a whole log; arguments as of `step_by_step`."""
    begin, counts = time.perf_counter(), (len(inputs), len(inputs.observations.frame))
    record = Recorder(*counts, inputs.systematic, inputs.fixes, inputs.closures)
    failure, finished = None, Finished(None, None)
    try:
        for k in range(len(inputs)):
            frame = inputs.frame(k)
            through(front, frame, record.update, observer=observer)
            record.poses.enter(frame, front.poses.fixed, front.poses.closed)
            record.begin(front)
            observe(observer.updated, front, record.decisions, record.created)
            record.estimate(front)
        if finish:
            front.close()
            finished = front.finish()
    except ObserverError as fault:
        raise fault.of from fault.of.__cause__
    except Exception as stop:  # noqa: BLE001 - `crashed` raises again what concerns the log
        failure = crashed(stop, max(front.k, 0))
    return record.run(name_of(name), task, front, finished, failure, time.perf_counter() - begin)


def through(
    front: FrontEnd, frame: Frame, used: Callable[[Frame, IntArray, Updated], None], *,
    observer: Observer = NULL_OBSERVER,
) -> None:  # fmt: skip
    """One frame through a front end, of a log or a live robot; `used` gets it (in parts) with decisions and result."""
    front.move(frame)  # predict
    observe(observer.moved, front)
    front.use_poses(frame)  # update with fixes and closures
    for part in frame.by_sensor() if len(frame.observations.z) else []:
        front.look(part)  # through its sensor
        pairing = front.associate(part)  # expect and decide
        observe(observer.decided, front, part, pairing)
        done = front.update(part, pairing)  # with all pairings, then new landmarks
        used(part, pairing.decisions, done)
    front.tidy()  # landmarks leave the map


def front_end(
    name: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
) -> FrontEnd:
    """The front end of an estimator and an association method. Raises CannotError for what the sensors forbid."""
    why = lack_with_sensor(name, "slam" if given.map is None else "localization", association, given, options)
    if why is not None:
        raise CannotError(why)
    kind = FrontEnd
    if association == HINDSIGHT:
        kind = MappingFrontEnd if given.map is None else LocalizingFrontEnd
    elif association == MHT:
        kind = MultiHypothesisFrontEnd
    return kind(name, association, given, setup, options)


def compare(
    inputs: Inputs, task: str, estimators: Sequence[str | Thing], association: str | Thing = "known",
    setup: Setup = PLAIN, watch: Callable[[Inputs], Writing] | None = None,
    judge: Callable[[Sequence[Run], Inputs], list[Run]] = lambda runs, _: list(runs),
) -> list[Run]:  # fmt: skip
    """Estimators with one association method on identical inputs; runs in the order of `estimators`.

    Estimators are names, settled texts of foreign ones (`eval.replay.external`), or classes and functions. `batch...`
    take the decisions of a front end and start from its path. Under `known` this is the EKF (if it fails, the iterated
    one), otherwise iSAM2, or the EKF if iSAM2 was not asked for. The front end then runs in any case. If the gate for
    labels excludes smoothers, they get every pairing and start at the gated EKF's path. With `scan` the scans of a
    laser log are matched and loops closed; with any other method the corners of walls are the landmarks. Labels are
    withheld from every method but `known`; sensed labels are gated by default (`Setup.settled`).

    `watch` makes an observer of each replay of point landmarks; its result is the run's `watched`. `judge` gets the
    runs with their inputs, before either is converted (`eval.compare`: the referee).
    """
    if not isinstance(inputs, Inputs):
        raise UsageError(f"{type(inputs).__name__}: the inputs of a log are needed, as in log.inputs(labels=True)")
    if task not in TASKS:
        raise UsageError(f"task {task!r}: {unknown(task, TASKS)}")
    names, association = [text_of(e, "estimator") for e in estimators], text_of(association, "association")
    with one_thread():
        for replay in of_all("replays"):
            runs: list[Run] | None = replay(inputs, task, names, association, setup, judge)
            if runs is not None:
                return runs
        return judge(_compare(inputs, task, names, association, setup, watch), inputs)


def _compare(
    inputs: Inputs, task: str, estimators: Sequence[str], association: str, setup: Setup,
    watch: Callable[[Inputs], Writing] | None = None,
) -> list[Run]:  # fmt: skip
    if task == "slam":
        inputs = inputs.without_map()
    if association != "known":
        inputs = inputs.without_labels()
    if set(estimators) - {"dead-reckoning"}:
        _check_granted(inputs, association)
    notes = list[Notice]()
    if inputs.map is not None and inputs.map.sigma is not None and not inputs.map_is_uncertain:
        sigma, effect = float(inputs.map.sigma.max()), inputs.map_effect
        notes = [notice(Code.MAP_AS_EXACT, sigma=sigma, effect=effect)]
        inputs = replace(inputs, map=inputs.map.exact)
    each = _Comparison(inputs, task, estimators, association, setup.settled(inputs.labels_are_sensed), watch)
    runs = [each.run(name) for name in estimators]
    runs[0] = replace(runs[0], notes=(*runs[0].notes, *notes))
    return runs if inputs.sensor.sees_points else [replace(run, walls=True) for run in runs]


def _check_granted(inputs: Inputs, association: str) -> None:
    """Raise ValueError for known association of observations without labels."""
    if association == "known" and not isinstance(inputs.observations, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")


@dataclass(eq=False)
class _Comparison:
    """The runs of one comparison; each front end runs once."""

    inputs: Inputs
    task: str
    estimators: Sequence[str]
    association: str
    setup: Setup
    watch: Callable[[Inputs], Writing] | None
    _done: dict[str, Run] = field(default_factory=dict)

    def run(self, name: str) -> Run:
        """The run of an estimator by name; if anything crashes, a blank one that says what."""
        if name not in self._done:
            try:
                self._done[name] = self._batch(name) if name in BATCH else self._stepping(name)
            except Exception as fault:  # noqa: BLE001 - `crashed` raises again what concerns the log
                self._done[name] = missing_run(name, self.association, self.task, self.inputs, crashed(fault, 0))
        return self._done[name]

    def _stepping(self, name: str) -> Run:
        """In one compiled loop where possible; an observer needs the same steps once more."""
        if name == "dead-reckoning":
            return dead_reckoning(self.inputs, self.task)
        quick = self._compiled(name)
        if quick is not None and self.watch is None:
            return quick
        observer = None if self.watch is None else self.watch(self.inputs)
        given = self.inputs, self.task, self.association, self.setup
        slow = step_by_step(name, *given, observer=observer or NULL_OBSERVER)
        if observer is None:
            return slow
        return replace(quick or replace(slow, seconds=slow.seconds - observer.seconds), watched=observer.left())

    def _compiled(self, name: str) -> Run | None:
        inputs, managed = self.inputs, self.setup.manages_map and self.task == "slam"
        if name not in FILTERS or self.association != "known" or managed:
            return None
        if inputs.observations.sensor is not None or not inputs.sensor.locates:
            return None
        if inputs.fixes is not None or inputs.closures is not None:
            return None
        if lack_with_sensor(name, self.task, self.association, inputs) is not None:
            return None
        return filter_known(inputs, self.task, name=name, threshold=gate_threshold(self.setup.label_gate))

    def _batch(self, name: str) -> Run:
        if self.inputs.closures is not None and not len(self.inputs.observations.frame):
            return batch(name, self.inputs, replace(self.run("dead-reckoning"), association=self.association))
        if self.association != "known":
            first = batch(name, self.inputs, self.run("isam2" if "isam2" in self.estimators else "ekf"))
            if first.failure is None or "isam2" not in self.estimators:
                return first
            second = batch(name, self.inputs, self.run("ekf"))
            return second if second.failure is None else first
        # also where isam2 was asked for; the iterated filter's path is better where the plain one gets lost
        fronts = (self.run(front) for front in ("ekf", "ekf-iterated", "isam2"))
        front = next((run for run in fronts if run.failure is None), self.run("ekf"))
        if not self.setup.gate_smoothers:
            decisions, created = known_decisions(self.inputs)
            front = replace(front, decisions=decisions, final_decisions=decisions, created=created, begun=None)
        return batch(name, self.inputs, front, lambda: self.run("ekf-iterated"), lambda: self.run("dead-reckoning"))
