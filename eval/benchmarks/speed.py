"""Speed of the EKF localizer, of a Monte Carlo study, and of SLAM over Victoria Park.

Peers are a plain numpy loop and filterpy, one and two processes and a Dask cluster, and a bare gtsam loop with the same
factors.
"""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from association.decide import known_decisions
from data.blocks import block_diagonal
from data.formats.recordings.victoria_park import load_victoria_park
from data.inputs import Increment, Inputs, LabelledObservations
from data.log import shortened
from data.se2 import Array
from data.worlds.arena import Arena, simulate
from ekf.whole_run import run_filter
from eval.benchmarks.timed import REPEATS, Timed, median_seconds
from eval.plan.execute import execute
from eval.plan.experiments import Plan
from eval.plan.flags.table import Execution, Options, Output
from eval.replay.run import step_by_step
from eval.studies.scenario import Scenario, load_scenario
from graph.bare_loop import bare_isam2


def localization_log(frames: int) -> Inputs:
    """An arena log with three observations in every frame."""
    log = simulate(Arena(frames=frames, landmarks=40, field_of_view=2 * math.pi), 0)
    inputs = log.inputs(labels=True)
    o = inputs.observations
    assert isinstance(o, LabelledObservations)
    rank = np.arange(len(o.frame)) - inputs.start[o.frame]
    first = rank < 3
    kept = LabelledObservations(o.frame[first], o.z[first], o.R[first], o.label[first])
    return replace(inputs, observations=kept)


def measured(x: Array, landmarks: Array) -> Array:
    """Expected ranges and bearings (2m,) of landmarks (m, 2), interleaved."""
    d = landmarks - x[:2]
    return np.stack([np.hypot(d[:, 0], d[:, 1]), np.arctan2(d[:, 1], d[:, 0]) - x[2]], 1).ravel()


def jacobian(x: Array, landmarks: Array) -> Array:
    """Jacobian (2m, 3) of `measured`."""
    d = landmarks - x[:2]
    r = np.hypot(d[:, 0], d[:, 1])
    J = np.zeros((2 * len(d), 3))
    J[0::2, :2] = -d / r[:, None]
    J[1::2, 0], J[1::2, 1], J[1::2, 2] = d[:, 1] / r**2, -d[:, 0] / r**2, -1
    return J


def residual(a: Array, b: Array) -> Array:
    """Difference (2m,) of measurements with wrapped bearings."""
    e = a - b
    e[1::2] = (e[1::2] + math.pi) % (2 * math.pi) - math.pi
    return e


def predicted(x: Array, P: Array, increment: Increment) -> tuple[Array, Array]:
    """Pose and covariance after an increment."""
    (u, M), c, s = increment, math.cos(x[2]), math.sin(x[2])
    F = np.array([[1, 0, -s * u[0] - c * u[1]], [0, 1, c * u[0] - s * u[1]], [0, 0, 1]])
    B = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return x + B @ u, F @ P @ F.T + B @ M @ B.T


def seen_in(inputs: Inputs, k: int) -> tuple[Array, Array, Array]:
    """Measurements (2m,) of a frame, their covariance (2m, 2m), and the landmarks (m, 2)."""
    assert inputs.map is not None
    o, rows = inputs.observations, slice(inputs.start[k], inputs.start[k + 1])
    assert isinstance(o, LabelledObservations)
    return o.z[rows].ravel(), block_diagonal(o.R[rows]), inputs.map.xy[o.label[rows]]


def numpy_localizer(inputs: Inputs) -> None:
    """The same filter as a plain numpy loop."""
    x, P = inputs.prior.mean.copy(), inputs.prior.covariance.copy()
    for k in range(len(inputs)):
        if k:
            x, P = predicted(x, P, inputs.increment(k))
        z, R, landmarks = seen_in(inputs, k)
        H = jacobian(x, landmarks)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x = x + K @ residual(z, measured(x, landmarks))
        P = (np.eye(3) - K @ H) @ P


def filterpy_localizer(inputs: Inputs) -> None:
    """The same with filterpy's ExtendedKalmanFilter (with our predict: it has no nonlinear one)."""
    from filterpy.kalman import ExtendedKalmanFilter

    f = ExtendedKalmanFilter(dim_x=3, dim_z=6)
    f.x, f.P = inputs.prior.mean.copy(), inputs.prior.covariance.copy()
    for k in range(len(inputs)):
        if k:
            f.x, f.P = predicted(f.x, f.P, inputs.increment(k))
        z, R, landmarks = seen_in(inputs, k)
        if len(z):
            f.update(z, jacobian, measured, R=R, args=(landmarks,), hx_args=(landmarks,), residual=residual)


def localization_lines(frames: int) -> list[Timed]:
    """The EKF localizer with three observations a frame, and its peers."""
    inputs = localization_log(frames)
    decisions, _ = known_decisions(inputs)
    whole = median_seconds(lambda: run_filter(inputs, decisions))
    steps = median_seconds(lambda: step_by_step("ekf", inputs, "localization"))
    plain = median_seconds(lambda: numpy_localizer(inputs), 3)
    lines = [
        Timed("EKF localizer, whole run compiled", whole, frames, "frames", "1", ">= 50 000 frames/s"),
        Timed("EKF localizer, step by step", steps, frames, "frames", f"{steps / whole:.1f}"),
        Timed("peer: plain numpy loop", plain, frames, "frames", f"{plain / whole:.1f}"),
    ]
    try:
        peer = median_seconds(lambda: filterpy_localizer(inputs), 3)
        lines.append(Timed("peer: filterpy", peer, frames, "frames", f"{peer / whole:.1f}"))
    except ImportError:
        lines.append(Timed("peer: filterpy (not installed)", math.nan, frames, "frames"))
    return lines


VARIANTS = ("ekf", "ekf-fej", "ekf-invariant")
PROCESSES, TURNS = 2, 3


def study_seconds(scenario: Scenario, runs: int, jobs: int, scheduler: str | None = None) -> float:
    """Wall time of a study; the processes were started before, by a few runs of the same."""
    taken = 0.0
    for n in (2 * jobs, runs):
        with tempfile.TemporaryDirectory() as folder:
            options = Options(output=Output(out=Path(folder) / "report"), execution=Execution(jobs, scheduler))
            begin = time.perf_counter()
            execute(Plan((), ((scenario, n),)), options, lambda done, total: None)
            taken = time.perf_counter() - begin
    return taken


def study_lines(quick: bool) -> list[Timed]:
    """Lines of the table about studies."""
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
        for _ in range(1 if quick else TURNS):  # in turn, so that changes of the machine's speed affect all
            one.append(study_seconds(scenario, runs, 1))
            two.append(study_seconds(scenario, runs, PROCESSES))
            dask.append(study_seconds(scenario, runs, PROCESSES, cluster.scheduler_address))
    gain, dask_ratio = (median(a / b for a, b in zip(x, y, strict=True)) for x, y in ((one, two), (dask, two)))
    few = 4 if quick else 10
    batch = study_seconds(scenario.only(("batch",)), few, PROCESSES)
    what = f"study: circle (2500 steps, 20 landmarks), {runs} runs, {len(VARIANTS)} filters"
    return [
        Timed(f"{what}, 1 process", median(one), runs, "runs", f"{gain:.2f}", ">= 1.70 (85 % efficiency)"),
        Timed(f"{what}, 2 processes", median(two), runs, "runs", "1", "< 60 s"),
        Timed(f"{what}, Dask, 2 workers", median(dask), runs, "runs", f"{dask_ratio:.2f}", "<= 1.15"),
        Timed(f"the same, batch smoother, {few} runs, 2 processes", batch, few, "runs"),
    ]


def victoria_park_lines(frames: int) -> list[Timed]:
    """EKF-SLAM and iSAM2 over Victoria Park, against a bare gtsam loop with the same factors."""
    log = shortened(load_victoria_park(), frames)
    inputs = log.inputs(labels=True).without_map()
    decisions, created = known_decisions(inputs)
    n = len(inputs)
    slam = median_seconds(lambda: run_filter(inputs, decisions), 3)
    ours, bare = [], []
    first = shortened(log, 300).inputs(labels=True).without_map()
    step_by_step("isam2", first, "slam", finish=False)  # a warm-up for the compiled parts
    for _ in range(REPEATS):  # in turn, so that changes of the machine's speed affect both
        begin = time.perf_counter()
        step_by_step("isam2", inputs, "slam", finish=False)
        ours.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        bare_isam2(inputs, decisions, created)
        bare.append(time.perf_counter() - begin)
    ratio = statistics.median(a / b for a, b in zip(ours, bare, strict=True))
    updates = len(np.unique(inputs.observations.frame))
    more = statistics.median(a - b for a, b in zip(ours, bare, strict=True)) / updates
    landmarks = int((created >= 0).sum())
    return [
        Timed(f"EKF-SLAM, Victoria Park ({landmarks} landmarks)", slam, n, "frames", "", "<= 3 s"),
        Timed("iSAM2, Victoria Park, frame by frame", statistics.median(ours), n, "frames", f"{ratio:.2f}", "<= 1.20"),
        Timed("peer: bare gtsam loop, same factors", statistics.median(bare), n, "frames", "1"),
        Timed("the difference, in a frame with observations", more, 1, "frames"),
    ]
