"""Time and memory for parks of a thousand to a hundred thousand frames, each run in its own process."""

import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import gtsam
import numpy as np
import pandas as pd
from gtsam.symbol_shorthand import L, X

from association.decide import known_decisions
from data.inputs import Inputs, IntArray
from data.se2 import Array
from data.worlds.registry import named_log
from eval.compare import compare
from eval.referee.errors import position_distance, rms
from eval.replay.batch import start_at
from eval.replay.run import filter_known
from graph.bare_loop import bare_isam2
from graph.batch import build
from graph.problem import Start

SIZES = (1_000, 3_000, 10_000, 30_000, 100_000)
BARE, BARE_BATCH = "bare isam2", "bare batch"
MEASURED = ("ekf", "batch", BARE_BATCH, "isam2", BARE)
LOG = "park:0:spacing=3.3+frames={}"  # a landmark for every ten frames, five to seven observations a frame
MEGABYTE = 1024.0  # KiB, the unit of `ru_maxrss`


class RunCost(NamedTuple):
    """One run, its size, and its cost."""

    estimator: str
    frames: int
    landmarks: int
    seconds: float  # wall time of the estimator alone, and with the EKF that batch starts from
    with_start: float
    peak_mb: float  # memory of the process at most, and before the run, the log included
    log_mb: float
    rmse_m: float  # of the positions, in the end
    status: str


def bare_batch(inputs: Inputs, decisions: IntArray, created: IntArray, start: Start) -> Array:
    """SLAM: poses (N, 3) of gtsam's Levenberg-Marquardt optimizer with defaults, and all marginal covariances."""
    problem = build(inputs, decisions, created)
    graph = problem.graph()
    found = gtsam.LevenbergMarquardtOptimizer(graph, problem.values(start)).optimize()
    marginals = gtsam.Marginals(graph, found)
    for key in (*(L(n) for n in problem.numbers.tolist()), *(X(k) for k in range(len(inputs)))):
        marginals.marginalCovariance(key)
    return np.asarray(gtsam.utilities.extractPose2(gtsam.utilities.allPose2s(found)))


def measure(estimator: str, name: str) -> RunCost:
    """One estimator with labels on one simulated log, in this process."""
    log = named_log(name)
    inputs = log.inputs(labels=True).without_map()
    if estimator != BARE:  # compiled code is loaded
        compare(named_log("park:0:frames=50").inputs(labels=True), "slam", [estimator.removeprefix("bare ")])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE
    begin = time.perf_counter()
    if estimator == BARE:
        pose, status = bare_isam2(inputs, *known_decisions(inputs)).pose, "ok"
        seconds = time.perf_counter() - begin
    elif estimator == BARE_BATCH:
        front = filter_known(inputs, "slam")
        started = time.perf_counter()
        pose = bare_batch(inputs, front.decisions, front.created, start_at(inputs, front, front.created))
        status, seconds = "ok", time.perf_counter() - started
    else:
        (run,) = compare(inputs, "slam", [estimator])
        pose, status, seconds = run.trajectory(run.phases[-1]).pose, run.status, run.seconds
    whole = time.perf_counter() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE
    assert log.truth.pose is not None
    rmse, landmarks = rms(position_distance(pose, log.truth.pose)), int((known_decisions(inputs)[1] >= 0).sum())
    return RunCost(estimator, len(inputs), landmarks, seconds, whole, peak, before, rmse, status)


def measure_all(sizes: Sequence[int] = SIZES) -> Iterator[RunCost]:
    """Every estimator at every size, the small ones first, each in a process whose peak memory is its own."""
    for frames in sizes:
        for estimator in MEASURED:
            command = [sys.executable, "-m", "tests.research.large", estimator, LOG.format(frames)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
            yield RunCost(*json.loads(done.stdout.splitlines()[-1]))


def study(out: Path) -> None:
    """Print each measurement when it is done, and write all so far to OUT/large.csv."""
    found = []
    for m in measure_all():
        found.append(m)
        print(*m, flush=True)
        pd.DataFrame(found).to_csv(out / "large.csv", index=False, lineterminator="\n")


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure(*sys.argv[1:])) + "\n")
