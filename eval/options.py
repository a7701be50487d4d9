"""Everything a person can ask of a run, as one frozen record, and the checks that no combination is senseless."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

TASKS = ("localization", "slam")
ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch", "batch-huber", "batch-cauchy")
ASSOCIATIONS = ("known",)
FORMATS = ("csv", "md", "tex")
DEFAULT_ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch")


@dataclass(frozen=True)
class Options:
    """What `python -m eval.run_all` was asked for; field names are the flags' and the config file's keys.

    Attributes:
        log: names or paths of logs; empty: the default suite.
        data: folders to search for datasets.
        task: tasks to run, or empty for each log's natural one.
        estimator, association: names.
        gate: chi-square probability of the association gates, None for no gate.
        gate_known: the same for pairings by label; None: never gated.
        runs: Monte Carlo runs of the consistency study.
        seed: first seed of the study.
        jobs: processes.
    """

    log: tuple[str, ...] = ()
    data: tuple[str, ...] = ()
    task: tuple[str, ...] = ()
    estimator: tuple[str, ...] = DEFAULT_ESTIMATORS
    association: tuple[str, ...] = ("known",)
    gate: float | None = 0.99
    gate_known: float | None = None
    runs: int = 50
    seed: int = 0
    jobs: int = 2
    quick: bool = False
    out: Path = Path("results/report")
    formats: tuple[str, ...] = FORMATS
    plots: bool = True
    animate: bool = False
    verbosity: int = 0
