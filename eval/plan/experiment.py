"""An experiment: a log, a task, the estimators of each association method; its parts, and what is lost of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from association.names import SCAN
from data.command import portable
from data.errors import UsageError
from data.log import Log
from data.notice import Code, Notice, notice
from data.result import Run
from eval.compare import compare
from eval.player.watch import Watch
from eval.replay.external.adapter import ForeignError, Loaded, Method, lack, load, tasks_of
from eval.replay.external.spec import introduce, is_foreign, name_of, place_of, shown
from eval.replay.settings import FILTERS, Setup
from eval.studies.scenario import Scenario


@dataclass(frozen=True)
class Work:
    """Estimators with one association method."""

    association: str
    estimators: tuple[str, ...]

    def parts(self) -> tuple[Work, ...]:
        """Parts to do in parallel: iSAM2 and foreign ones (slow) alone, batch with its front end."""
        if self.association == SCAN:
            return (self,)
        apart: list[tuple[str, ...]] = [(e,) for e in self.estimators if e == "fixed-lag" or is_foreign(e)]
        rest = tuple(e for e in self.estimators if (e,) not in apart)
        if "isam2" in rest:
            alone = ("isam2",) if self.association == "known" else tuple(e for e in rest if e not in FILTERS)
            apart, rest = [alone, *apart], tuple(e for e in rest if e not in alone)
        return tuple(Work(self.association, part) for part in (*apart, rest) if part)


@dataclass(frozen=True)
class Experiment:
    """One log and task with all work on it; a variant joins the table of log `variant_of`, `about` describes it."""

    log: Log
    task: str
    work: tuple[Work, ...]
    setup: Setup
    variant_of: str | None = None
    about: str = ""


def check_possible_on(log: Log, tasks: Sequence[str], associations: Sequence[str]) -> None:
    """Raise UsageError for localization without a map, or known association without labels."""
    if "localization" in tasks and log.recorded.map is None:
        raise UsageError(f"--task localization: log {log.name!r} has no map (landmarks.csv); type --task slam")
    if "known" in associations and not log.has_labels:
        right = "convert table --columns label=NAME, or of a column for each landmark range=lm_*, gives them"
        raise UsageError(f"--association known: log {log.name!r} has no labels (label in observations.csv; {right})")


def check_maintained(setup: Setup, tasks: Sequence[str]) -> None:
    """Raise UsageError for map maintenance without SLAM."""
    if setup.manages_map and "slam" not in tasks:
        raise UsageError("--maintain, --forget-after, --deactivate-after: for slam only; type --task slam")


def default_task(log: Log) -> str:
    """The task of every command that is given none: localization where there is a map."""
    return "slam" if log.recorded.map is None else "localization"


def default_task_line(logs: Sequence[Log]) -> str:
    """What the default chose, blank where there was no choice."""
    names = [log.name for log in logs if log.recorded.map is not None]
    where = names[0] if len(names) == 1 else f"{len(names)} logs"
    return f"{where}: localization, because the map is known (--task slam estimates one)" if names else ""


def estimate(experiment: Experiment, part: Work, watched: bool = False) -> list[Run]:
    """All estimators of a part of the work on one log; `watched`: recorded for the player."""
    inputs = experiment.log.inputs(labels=part.association == "known")
    watch = Watch if watched else None
    return compare(inputs, experiment.task, part.estimators, part.association, experiment.setup, watch)


MISSING_RUN = notice(Code.MISSING)


@dataclass
class Unfinished:
    """Jobs that ran out of memory, and results that are therefore missing."""

    processes: int  # number of parallel processes
    jobs: dict[Any, Notice] = field(default_factory=dict)  # reason by owner
    messages: list[Notice] = field(default_factory=list)  # for terminal and report

    def __call__(self, owner: Any, why: Notice) -> None:
        """Record a lost job."""
        self.jobs[owner] = why

    def say(self, what: str, why: Notice, about: Notice = MISSING_RUN, **more: str | int | None) -> None:
        """Report a missing result (`what`: see `missing` in notices.j2); `about` names log, task and run."""
        values = {**why.named, "what": what, "processes": self.processes, **more}
        self.messages.append(replace(about, values=tuple(sorted(values.items()))))


def wanted(work: Sequence[Work]) -> list[tuple[str, str]]:
    """Association method and estimator of every run of some work, in the order of the tables."""
    runs = ((name_of(w.association), n) for w in work for n in w.estimators)
    named = [("none" if n == "dead-reckoning" else association, name_of(n)) for association, n in runs]
    return list(dict.fromkeys(named))


def load_all(estimators: Sequence[str], associations: Sequence[str]) -> None:
    """Raise UsageError for text that cannot be loaded, or is no estimator or association method."""
    for text in estimators:
        if is_foreign(text):
            tasks_of(load(text))
    for text in associations:
        if is_foreign(text):
            try:
                Method(load(text))
            except ForeignError as fault:
                raise UsageError(f"{place_of(text).shown}: {fault}") from fault


def introduce_all(texts: Iterable[str], results: Sequence[str] = ()) -> None:
    """Give every foreign name a line style. UsageError for one of `results` (NAME=FILE) with an estimator's name."""
    named = {name_of(text): text for text in texts if is_foreign(text)}
    handed_in = [text.partition("=")[0] for text in results]
    for name in handed_in:
        if name in named:
            raise UsageError(f"--result {name}: {shown(named[name])} has that name, too; rename one")
    introduce([*named, *handed_in])


def check_possible(experiments: Iterable[Experiment]) -> None:
    """Raise UsageError for a foreign estimator that can do none of its work; otherwise it does a part."""
    work = ((text, e, w.association) for e in experiments for w in e.work for text in w.estimators)
    _check([(text, e.task, association, e.setup) for text, e, association in work if is_foreign(text)])


def check_scenario(scenario: Scenario) -> list[str]:
    """The same for a study, after loading its members; returns messages about work that is left out."""
    names = tuple(m.name for m in scenario.members)
    load_all(names, scenario.association)
    pairs = [(task, a) for task in scenario.task for a in scenario.association]
    asked = [(n, task, a, scenario.setup) for n in names if is_foreign(n) for task, a in pairs]
    _check(asked)
    lacks = [(task, a, lack(n, task, a, setup)) for n, task, a, setup in asked]
    return [f"{scenario.name}, {task}, {name_of(a)}: left out, {why}" for task, a, why in lacks if why is not None]


def _check(asked: Sequence[tuple[str, str, str, Setup]]) -> None:
    for text in dict.fromkeys(text for text, *_ in asked):
        lacks = [lack(*one) for one in asked if one[0] == text]
        if all(lacks):
            raise UsageError(f"--estimator {place_of(text).shown}: {lacks[0]}")


def sources_of(texts: Iterable[str]) -> dict[str, object]:
    """For provenance.json: place of each foreign name, and the digest of its files."""
    found: dict[str, object] = {}
    for text in texts:
        if is_foreign(text):
            loaded: Loaded = load(text)
            place = place_of(text)
            where = portable(f"{place.file or place.module}:{place.attribute}")
            files = [portable(Path(f).as_posix()) for f in loaded.sources]
            found[loaded.name] = {"is": where, "sha256": loaded.digest, "files": files}
    return found
