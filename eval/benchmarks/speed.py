"""Speed of the EKF localizer, of a Monte Carlo study, of association, and of SLAM over Victoria Park.

Peers are a plain numpy loop, one process for two, and a bare gtsam loop with the same factors.
"""

import math
import os
import platform
import re
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from association.decide import known_decisions
from association.expectation import Expectation
from association.jcbb import jcbb
from data.blocks import block_diagonal
from data.formats.recordings.victoria_park import load_victoria_park
from data.inputs import Inputs, LabelledObservations
from data.log import Log, shortened
from data.se2 import Array
from data.whole import whole_file
from data.worlds.arena import Arena, simulate
from ekf.whole_run import run_filter
from eval.plan.execute import execute
from eval.plan.experiments import Plan
from eval.plan.flags.table import Execution, Options, Output
from eval.plan.provenance import versions
from eval.replay.run import front_end, step_by_step, through
from eval.replay.settings import HINDSIGHT, Setup
from eval.studies.scenario import Scenario, load_scenario
from graph.bare_loop import bare_isam2

REPEATS = 5
CPUINFO = Path("/proc/cpuinfo")


@dataclass(frozen=True)
class Timed:
    """A line of the table: what, median seconds, what one unit is, units per second, and the peer's ratio if any."""

    what: str
    seconds: float
    units: int
    unit: str
    ratio: str = ""
    goal: str = ""


def median_seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median wall time of `work` after one warm-up."""
    work()
    taken = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begin)
    return statistics.median(taken)


def in_turn(first: Callable[[], object], second: Callable[[], object]) -> tuple[Array, Array]:
    """Processor seconds (n,) of two works, n times one after the other: other processes and changes of the machine's
    speed affect both alike. Medians leave out the first turn, which loads compiled code.
    """
    seconds = np.empty((REPEATS, 3))
    for row in seconds:
        row[0] = time.process_time()
        first()
        row[1] = time.process_time()
        second()
        row[2] = time.process_time()
    taken = np.diff(seconds, axis=1)
    return taken[:, 0], taken[:, 1]


def table(lines: list[Timed]) -> str:
    """The lines as text."""
    out = [f"{'':84s} {'median s':>9s} {'per second':>18s} {'ratio':>7s}  goal"]
    for t in lines:
        rate = f"{t.units / t.seconds:,.0f} {t.unit}" if t.seconds > 0 else ""
        seconds = f"{t.seconds:9.5f}" if math.isfinite(t.seconds) else " " * 9
        out.append(f"{t.what:84s} {seconds} {rate:>18s} {t.ratio:>7s}  {t.goal}")
    return "\n".join(out)


def machine() -> str:
    """The processor, as far as the system names it, and the number of its cores."""
    found = re.search(r"model name\s*: (.*)", CPUINFO.read_text()) if CPUINFO.exists() else None
    name = found[1] if found else platform.processor()
    return f"{sys.platform} {platform.machine()}, {name}, {os.cpu_count()} cores"


def write(tables: Mapping[str, Sequence[Timed]], path: Path) -> None:
    """The tables as one CSV file: each line with its table, the machine and the versions that it was measured with."""
    where = {"machine": machine(), **versions()}
    rows = [{"table": name, **asdict(t), **where} for name, lines in tables.items() for t in lines]
    with whole_file(path) as partial:
        pd.DataFrame(rows).to_csv(partial, index=False, lineterminator="\n")


GATE = 0.99


def hard_frame(observations: int, landmarks: int, ambiguous: int) -> Expectation:
    """A frame whose landmarks are far apart, `ambiguous` of them with a neighbour inside the gate, all correlated."""
    rng = np.random.default_rng(0)
    xy = 4.0 * np.stack(np.divmod(np.arange(landmarks), int(np.ceil(np.sqrt(landmarks)))), axis=1).astype(float)
    xy[observations : observations + ambiguous] = xy[:ambiguous] + np.array([0.12, 0.05])
    pose = np.tile(np.eye(2), (landmarks, 1))  # a pose error shifts all expectations alike
    joint = pose @ (0.03 * np.eye(2)) @ pose.T + 1e-3 * np.eye(2 * landmarks)
    R = np.tile(1e-3 * np.eye(2), (observations, 1, 1))
    shift = rng.multivariate_normal(np.zeros(2), 0.03 * np.eye(2))
    return Expectation.from_arrays(xy[:observations] + shift + rng.normal(0.0, 0.04, (observations, 2)), xy, joint, R)


def each_frame(estimator: str, association: str, inputs: Inputs) -> Array:
    """Seconds (N,) of every frame of a log."""
    front = front_end(estimator, association, inputs, Setup())
    seconds = np.empty(len(inputs))
    with threadpool_limits(1):
        for k in range(len(inputs)):
            begin = time.perf_counter()
            frame = inputs.frame(k)
            through(front, frame, lambda *_: None)
            front.estimator.estimate()
            seconds[k] = time.perf_counter() - begin
    return seconds


def hindsight_lines(quick: bool) -> list[Timed]:
    """Victoria Park without labels, frame by frame: the mean, the slowest in a hundred, the slowest."""
    inputs = _park(quick).inputs().without_map()
    lines = []
    for name in ("ekf", "isam2"):
        each_frame(name, HINDSIGHT, shortened(load_victoria_park(), 300).inputs().without_map())
        seconds = each_frame(name, HINDSIGHT, inputs)
        what = f"Victoria Park without labels, {name}, jcbb-hindsight, a frame"
        for label, value, goal in (
            ("mean", seconds.mean(), "< 10 ms"),
            ("99 %", np.quantile(seconds, 0.99), "< 50 ms"),
            ("longest", seconds.max(), ""),
        ):
            lines.append(Timed(f"{what}: {label}", float(value), 1, "frames", "", goal if name == "isam2" else ""))
    return lines


def association_lines(_: bool) -> list[Timed]:
    """Lines of the table about association."""
    from data.worlds.corridor import Corridor, simulate

    e = hard_frame(20, 1000, 10)
    fast = median_seconds(lambda: jcbb(replace(e), GATE), 50)  # a copy has no cached distances
    log = simulate(Corridor(), 0)
    inputs = log.inputs().without_map()
    run = median_seconds(lambda: step_by_step("ekf", inputs, "slam", "jcbb"))
    seen = len(log.recorded.observations.frame)
    corridor = f"corridor ({len(inputs)} steps, {seen} observations), EKF and JCBB"
    return [
        Timed("JCBB, 20 observations x 1000 landmarks, 10 ambiguous", fast, 1, "frames", "", "< 5 ms"),
        Timed(corridor, run, len(inputs), "frames", "", "< 0.25 s"),
    ]


def localization_log(frames: int) -> Inputs:
    """An arena log with three observations in every frame."""
    inputs = simulate(Arena(frames=frames, landmarks=40, field_of_view=2 * math.pi), 0).inputs(labels=True)
    o = inputs.observations
    assert isinstance(o, LabelledObservations)
    first = (np.arange(len(o.frame)) - inputs.start[o.frame]) < 3
    return replace(inputs, observations=LabelledObservations(o.frame[first], o.z[first], o.R[first], o.label[first]))


def numpy_localizer(inputs: Inputs) -> Array:
    """The same filter as a plain numpy loop; its poses (N, 3)."""
    assert inputs.map is not None
    o, xy = inputs.observations, inputs.map.xy
    assert isinstance(o, LabelledObservations)
    x, P = inputs.prior.mean.copy(), inputs.prior.covariance.copy()
    poses = np.empty((len(inputs), 3))
    for k in range(len(inputs)):
        if k:
            (u, M), c, s = inputs.increment(k), math.cos(x[2]), math.sin(x[2])
            F = np.array([[1, 0, -s * u[0] - c * u[1]], [0, 1, c * u[0] - s * u[1]], [0, 0, 1]])
            B = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            x, P = x + B @ u, F @ P @ F.T + B @ M @ B.T
        rows = slice(inputs.start[k], inputs.start[k + 1])
        d = xy[o.label[rows]] - x[:2]
        r = np.hypot(d[:, 0], d[:, 1])
        H = np.zeros((2 * len(d), 3))
        H[0::2, :2] = -d / r[:, None]
        H[1::2, 0], H[1::2, 1], H[1::2, 2] = d[:, 1] / r**2, -d[:, 0] / r**2, -1
        e = o.z[rows] - np.stack([r, np.arctan2(d[:, 1], d[:, 0]) - x[2]], axis=1)
        e[:, 1] = (e[:, 1] + math.pi) % (2 * math.pi) - math.pi
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + block_diagonal(o.R[rows]))
        x, P = x + K @ e.ravel(), (np.eye(3) - K @ H) @ P
        poses[k] = x
    return poses


def localization_lines(quick: bool) -> list[Timed]:
    """The EKF localizer with three observations a frame, beside a plain numpy loop."""
    frames = 2_000 if quick else 20_000
    inputs = localization_log(frames)
    decisions, _ = known_decisions(inputs)
    whole = median_seconds(lambda: run_filter(inputs, decisions))
    ours, peers = in_turn(lambda: step_by_step("ekf", inputs, "localization"), lambda: numpy_localizer(inputs))
    steps, plain, gain = (float(np.median(each)) for each in (ours, peers, peers / ours))
    return [
        Timed("EKF localizer, whole run compiled", whole, frames, "frames", "1", ">= 50 000 frames/s"),
        Timed("EKF localizer, step by step", steps, frames, "frames", f"{steps / whole:.1f}"),
        Timed("peer: plain numpy loop", plain, frames, "frames", f"{plain / whole:.1f}"),
        Timed("frames/s of the steps over those of the loop", math.nan, frames, "frames", f"{gain:.2f}", ">= 1.5"),
    ]


VARIANTS = ("ekf", "ekf-fej", "ekf-invariant")
PROCESSES, TURNS = 2, 3


def study_seconds(scenario: Scenario, runs: int, jobs: int) -> float:
    """Wall time of a study; the processes were started before, by a few runs of the same."""
    taken = 0.0
    for n in (2 * jobs, runs):
        with tempfile.TemporaryDirectory() as folder:
            options = Options(output=Output(out=Path(folder) / "report"), execution=Execution(jobs))
            begin = time.perf_counter()
            execute(Plan((), ((scenario, n),)), options, lambda done, total: None)
            taken = time.perf_counter() - begin
    return taken


def study_lines(quick: bool) -> list[Timed]:
    """Lines of the table about studies."""
    scenario = load_scenario("circle").only(VARIANTS)
    runs = 20 if quick else 100
    # in turn, so that changes of the machine's speed affect both
    each = [[study_seconds(scenario, runs, n) for n in (1, PROCESSES)] for _ in range(1 if quick else TURNS)]
    one, two = np.array(each).T
    gain = float(np.median(one / two))
    few = 4 if quick else 10
    batch = study_seconds(scenario.only(("batch",)), few, PROCESSES)
    what = f"study: circle (2500 steps, 20 landmarks), {runs} runs, {len(VARIANTS)} filters"
    return [
        Timed(f"{what}, 1 process", float(np.median(one)), runs, "runs", f"{gain:.2f}", ">= 1.70 (85 % efficiency)"),
        Timed(f"{what}, 2 processes", float(np.median(two)), runs, "runs", "1", "< 60 s"),
        Timed(f"the same, batch smoother, {few} runs, 2 processes", batch, few, "runs"),
    ]


def _park(quick: bool) -> Log:
    return shortened(load_victoria_park(), 700 if quick else 10**9)


def victoria_park_lines(quick: bool) -> list[Timed]:
    """EKF-SLAM and iSAM2 over Victoria Park, against a bare gtsam loop with the same factors."""
    inputs = _park(quick).inputs(labels=True).without_map()
    decisions, created = known_decisions(inputs)
    n = len(inputs)
    slam = median_seconds(lambda: run_filter(inputs, decisions), 3)
    ours, bare = in_turn(
        lambda: step_by_step("isam2", inputs, "slam", finish=False), lambda: bare_isam2(inputs, decisions, created)
    )
    updates = len(np.unique(inputs.observations.frame))
    seconds, peer, ratio, more = (float(np.median(each)) for each in (ours, bare, ours / bare, (ours - bare) / updates))
    landmarks = int((created >= 0).sum())
    return [
        Timed(f"EKF-SLAM, Victoria Park ({landmarks} landmarks)", slam, n, "frames", "", "<= 3 s"),
        Timed("iSAM2, Victoria Park, frame by frame", seconds, n, "frames", f"{ratio:.2f}", "<= 1.12"),
        Timed("peer: bare gtsam loop, same factors", peer, n, "frames", "1"),
        Timed("the difference, in a frame with observations", more, 1, "frames"),
    ]
