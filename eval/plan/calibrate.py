"""Which errors each log is calibrated by, settled before its runs, and what the battery says when they are done."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from association.scans.laser_run import SCAN
from data.errors import UsageError
from data.inputs import Systematic
from data.log import Log
from data.motion.priors import AUTO, systematic, written
from data.result import Run
from eval.plan.calibrate.battery import examined, plainly, with_systematic
from eval.plan.calibrate.named import every
from eval.plan.experiment import Experiment
from eval.plan.flags.options import Options
from eval.plan.unfinished import Unfinished
from eval.plan.work import work
from eval.referee.score import Trial
from eval.replay.foreign.spec import name_of
from eval.replay.settings import Setup
from eval.studies.trusted import Trust
from eval.studies.twins import inputs_of

ASKED, NAMED, ALL = "asked", "named", "all"
"""Why these errors: a person named them, the log did, or nobody, so that all are looked for with tight priors."""
SCANNED = "--calibrate: log {!r} is a laser log, whose scans are matched; it has no landmarks to calibrate by"


@dataclass(frozen=True, eq=False)
class Calibration:
    """A log and task whose systematic errors are estimated along.

    Attributes:
        log, task, association: which, and the way of association whose decisions the battery is about.
        systematic: the errors, and how well they are known before.
        why: `ASKED`, `NAMED` or `ALL`.
        plain: runs of plain estimators, as far as the log was asked for names.
        before, after: the battery under plain estimators and under these (None: not enough memory).
    """

    log: str
    task: str
    association: str
    systematic: Systematic
    why: str
    plain: tuple[Run, ...] = ()
    before: Trust | None = None
    after: Trust | None = None


def check_calibrated(log: Log, options: Options) -> None:
    """Refuse to calibrate by scans, and the sensor by walls."""
    if options.calibrate and SCAN in options.association:
        raise UsageError(f"--calibrate and --association {SCAN} exclude each other: errors are told by landmarks")
    if options.calibrate and log.recorded.scans is not None and not len(log.recorded.observations.frame):
        raise UsageError(SCANNED.format(log.name))
    named = options.calibrate and options.calibrate != (AUTO,)
    if named and not log.recorded.sensor.sees_points and systematic(options.calibrate).of_sensor:
        raise UsageError(f"--calibrate: log {log.name!r} has walls; range and bearing are errors of points")


def settle(
    experiments: Sequence[Experiment], options: Options, lost: Unfinished
) -> tuple[tuple[Experiment, ...], tuple[Calibration, ...]]:
    """The experiments on logs whose errors are estimated along, and which errors those are.

    Logs without landmarks stay as they are, and all do without `--calibrate`.
    """
    wanted = [i for i, e in enumerate(experiments) if e.setup.calibrate and len(e.log.recorded.observations.frame)]
    if not wanted:
        return tuple(experiments), ()
    first = {i: experiments[i].work[0].association for i in wanted if experiments[i].work}
    asked = [(i, experiments[i]) for i in first if experiments[i].setup.calibrate == (AUTO,)]
    jobs = [(i, (plainly, (e.log, e.task, first[i], _plain(e.setup)))) for i, e in asked]
    found = dict(work(jobs, options, lost=_missing(experiments, lost)))
    settled, made = list(experiments), []
    for i, association in first.items():
        e = experiments[i]
        plain, names = found.get(i, ((), ()))
        stated, why = e.setup.calibrate, ASKED
        if stated == (AUTO,):
            inputs = inputs_of(e.log, e.task, association)
            stated, why = (written(names), NAMED) if names else (written(every(inputs), tight=True), ALL)
        errors = systematic(stated)
        settled[i] = replace(e, log=with_systematic(e.log, errors), setup=replace(e.setup, calibrate=stated))
        if e.beside is None:
            made.append(Calibration(e.log.name, e.task, association, errors, why, plain))
    return tuple(settled), tuple(made)


def examine(
    calibrations: Sequence[Calibration],
    experiments: Sequence[Experiment],
    trials: Sequence[Trial],
    options: Options,
    lost: Unfinished,
) -> tuple[Calibration, ...]:
    """The same with what the battery says of each log, and of the log less its errors."""
    place = {(e.log.name, e.task): i for i, e in enumerate(experiments) if e.beside is None}
    jobs: list[tuple[tuple[int, str], Any]] = []
    for k, c in enumerate(calibrations):
        e, trial = experiments[place[c.log, c.task]], trials[place[c.log, c.task]]
        runs = [r for r in trial.runs if r.association == name_of(c.association) and r.flaw is None]
        ready = runs if any(r.estimator == "batch" for r in runs) else []
        plain = with_systematic(e.log, None), c.task, c.association, _plain(e.setup), c.plain
        jobs.append(((k, "before"), (examined, plain)))
        jobs.append(((k, "after"), (examined, (e.log, c.task, c.association, e.setup, ready))))
    at = [place[c.log, c.task] for c in calibrations]
    missing = _missing(experiments, lost)
    found = dict(work(jobs, options, lost=lambda owner, why: missing(at[owner[0]], why)))
    both = [(found.get((k, "before")), found.get((k, "after"))) for k in range(len(calibrations))]
    return tuple(replace(c, before=b, after=a, plain=()) for c, (b, a) in zip(calibrations, both, strict=True))


def _plain(setup: Setup) -> Setup:
    return replace(setup, calibrate=())


def _missing(experiments: Sequence[Experiment], lost: Unfinished) -> Callable[[int, str], None]:
    def missing(i: int, why: str) -> None:
        lost.say(f"{experiments[i].log.name}, {experiments[i].task}: what its battery says of systematic errors", why)

    return missing
