"""Work that ran out of memory: repeated one estimator at a time, and reported where that fails, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from data.inputs import Inputs
from data.notice import Code, Notice, notice
from data.result import Failure, Run
from eval.compare import compare
from eval.plan.experiment import Experiment, Work
from eval.player.watch import Watch
from eval.replay.external.spec import name_of
from eval.replay.recorder import missing_run
from eval.replay.settings import BATCH


def estimate(experiment: Experiment, part: Work, watched: bool = False) -> list[Run]:
    """All estimators of a part of the work on one log; `watched`: recorded for the player."""
    inputs = experiment.log.inputs(labels=part.association == "known")
    watch = Watch if watched else None
    return compare(inputs, experiment.task, part.estimators, part.association, experiment.setup, watch)


def estimate_one(experiment: Experiment, part: Work, name: str, watched: bool = False) -> list[Run]:
    """One estimator of a part, with the same front end and run as in `estimate`."""
    fronts = {"ekf-iterated"} if part.association == "known" else {"isam2"}
    kept = tuple(n for n in part.estimators if name in BATCH and n in fronts)
    return estimate(experiment, Work(part.association, (*kept, name)), watched)[-1:]


def incomplete(name: str, association: str, task: str, inputs: Inputs, why: Notice) -> Run:
    """A run without results, and the reason."""
    return missing_run(name, association, task, inputs, Failure("incomplete", 0, why))


MISSING_RUN = notice(Code.MISSING)


@dataclass
class Unfinished:
    """Jobs that ran out of memory, and results that are therefore missing.

    Attributes:
        processes: number of parallel processes.
        jobs: reason by owner.
        messages: for terminal and report.
    """

    processes: int
    jobs: dict[Any, Notice] = field(default_factory=dict)
    messages: list[Notice] = field(default_factory=list)

    def __call__(self, owner: Any, why: Notice) -> None:
        """Record a lost job."""
        self.jobs[owner] = why

    def say(self, what: str, why: Notice, about: Notice = MISSING_RUN, **more: str | int | None) -> None:
        """Report a missing result (`what`: see `missing` in notices.j2); `about` names log, task and run."""
        values = {**why.named, "what": what, "processes": self.processes, **more}
        self.messages.append(replace(about, values=tuple(sorted(values.items()))))


def wanted(work: Sequence[Work]) -> list[tuple[str, str]]:
    """Association method and estimator of every run of some work, in the order of the tables."""
    named = [
        ("none" if n == "dead-reckoning" else name_of(w.association), name_of(n)) for w in work for n in w.estimators
    ]
    return list(dict.fromkeys(named))
