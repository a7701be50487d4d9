"""Work that had not enough memory: tried again an estimator at a time, and said where that was not enough either."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from data.inputs import Inputs
from data.notice import Code, Notice, Severity, notice
from data.result import Failure, Run
from eval.compare import compare
from eval.plan.experiment import Experiment, Work
from eval.player.watch import Watch
from eval.replay.external.spec import name_of
from eval.replay.recorder import no_run
from eval.replay.settings import BATCH, INCREMENTAL


def estimate(experiment: Experiment, part: Work, watched: bool = False) -> list[Run]:
    """All estimators of a part of the work on one log; `watched`: what the player shows is written down on the way."""
    log, known = experiment.log, part.association == "known"
    watch = Watch if watched else None
    inputs = log.inputs(labels=known)
    return compare(inputs, experiment.task, part.estimators, part.association, experiment.setup, watch)


def estimate_one(experiment: Experiment, part: Work, name: str, watched: bool = False) -> list[Run]:
    """One estimator of a part: the same run as in `estimate`, from the same front end."""
    fronts = {"ekf-iterated"} if part.association == "known" else {"isam2"}
    kept = tuple(n for n in part.estimators if name in BATCH and n in fronts)
    return estimate(experiment, Work(part.association, (*kept, name)), watched)[-1:]


def incomplete(name: str, association: str, task: str, inputs: Inputs, why: Notice) -> Run:
    """A run of which nothing is left but the reason."""
    given = "none" if name == "dead-reckoning" else name_of(association)
    online, final = name not in BATCH, name in (*BATCH, *INCREMENTAL)
    return no_run(name_of(name), given, task, inputs, Failure("incomplete", 0, why), online=online, final=final)


MISSING_RUN = notice(Code.MISSING, Severity.ERROR)


@dataclass
class Unfinished:
    """What had not enough memory, and what is missing therefore.

    Attributes:
        processes: at once.
        jobs: by what they belong to, each with the reason.
        said: for the person and the report.
    """

    processes: int
    jobs: dict[Any, Notice] = field(default_factory=dict)
    said: list[Notice] = field(default_factory=list)

    def __call__(self, owner: Any, why: Notice) -> None:
        """A job is lost."""
        self.jobs[owner] = why

    def say(self, what: str, why: Notice, about: Notice = MISSING_RUN, **more: str | int | None) -> None:
        """What is missing (a word, see `missing` in notices.j2), and why; `about`: names log, task and run."""
        values = {**why.named, "what": what, "processes": self.processes, **more}
        self.said.append(replace(about, values=tuple(sorted(values.items()))))


def wanted(work: Sequence[Work]) -> list[tuple[str, str]]:
    """Association and estimator of every run asked for, in the order of the tables."""
    named = [
        ("none" if n == "dead-reckoning" else name_of(w.association), name_of(n)) for w in work for n in w.estimators
    ]
    return list(dict.fromkeys(named))
