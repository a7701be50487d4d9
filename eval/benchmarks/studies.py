"""How fast a Monte Carlo study is: the circle scenario with one and two processes, and on a Dask cluster."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median

from eval.benchmarks.timed import Timed
from eval.plan.execute import execute
from eval.plan.experiments import Plan
from eval.plan.flags.options import Options
from eval.studies.scenario import Scenario
from eval.studies.scenario_file import load_scenario

VARIANTS = ("ekf", "ekf-fej", "ekf-invariant")
PROCESSES, TURNS = 2, 3


def study_seconds(scenario: Scenario, runs: int, jobs: int, scheduler: str | None = None) -> float:
    """Wall time of a study from nothing; the processes were started before, by a few runs of the same."""
    taken = 0.0
    for n in (2 * jobs, runs):
        with tempfile.TemporaryDirectory() as folder:
            options = Options(out=Path(folder) / "report", jobs=jobs, scheduler=scheduler)
            begin = time.perf_counter()
            execute(Plan((), ((scenario, n),)), options, lambda done, total: None)
            taken = time.perf_counter() - begin
    return taken


def study_lines(quick: bool) -> list[Timed]:
    """Every line of the table about studies."""
    from distributed import LocalCluster

    scenario = load_scenario("circle").only(VARIANTS)
    runs = 20 if quick else 100
    one: list[float] = []
    two: list[float] = []
    dask: list[float] = []
    with LocalCluster(
        n_workers=PROCESSES,
        threads_per_worker=1,
        dashboard_address=None,
        worker_dashboard_address=None,
        silence_logs=50,
    ) as cluster:
        for _ in range(1 if quick else TURNS):  # in turn, so that a drift of the machine's speed touches all
            one.append(study_seconds(scenario, runs, 1))
            two.append(study_seconds(scenario, runs, PROCESSES))
            dask.append(study_seconds(scenario, runs, PROCESSES, cluster.scheduler_address))
    gain, beside = (median(a / b for a, b in zip(x, y, strict=True)) for x, y in ((one, two), (dask, two)))
    few = 4 if quick else 10
    batch = study_seconds(scenario.only(("batch",)), few, PROCESSES)
    what = f"study: circle (2500 steps, 20 landmarks), {runs} runs, {len(VARIANTS)} filters"
    return [
        Timed(f"{what}, 1 process", median(one), runs, "runs", f"{gain:.2f}", ">= 1.70 (85 % efficiency)"),
        Timed(f"{what}, 2 processes", median(two), runs, "runs", "1", "< 60 s"),
        Timed(f"{what}, Dask, 2 workers", median(dask), runs, "runs", f"{beside:.2f}", "<= 1.15"),
        Timed(f"the same, batch smoother, {few} runs, 2 processes", batch, few, "runs"),
    ]
