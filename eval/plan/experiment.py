"""An experiment: a log, a task, and the estimators of each association method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from association.decide import SCAN
from data.errors import UsageError
from data.log import Log
from eval.replay.external.spec import is_foreign
from eval.replay.settings import FILTERS, Setup


@dataclass(frozen=True)
class Work:
    """Estimators with one association method."""

    association: str
    estimators: tuple[str, ...]

    def parts(self) -> tuple[Work, ...]:
        """Parts to do in parallel: iSAM2 and foreign estimators (slow) alone, batch with its front end.

        Scans are matched once for all estimators.
        """
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
        raise UsageError(f"--association known: log {log.name!r} has no labels (true_id or label in observations.csv)")


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
