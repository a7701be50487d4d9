"""Time and memory against size: parks of a thousand to a hundred thousand frames, each in its own process."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data.worlds.registry import named_log
from eval.figures.style import DOTTED, Style, drawing, page_width, style_of
from eval.referee.errors import position_distance, rms

SIZES = (1_000, 3_000, 10_000, 30_000, 100_000)
BARE = "bare isam2"
BARE_BATCH = "bare batch"
ESTIMATORS = ("ekf", "batch", BARE_BATCH, "isam2", BARE)
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


def measure(estimator: str, name: str) -> RunCost:
    """One estimator with labels on one simulated log, in this process."""
    from association.decide import known_decisions
    from eval.compare import compare
    from eval.replay.batch import start_at
    from eval.replay.run import filter_known
    from graph.bare_loop import bare_batch, bare_isam2

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
        pose = bare_batch(inputs, front.decisions, front.created, start_at(inputs, front, front.created)).pose
        status, seconds = "ok", time.perf_counter() - started
    else:
        (run,) = compare(inputs, "slam", [estimator])
        pose, status, seconds = run.trajectory(run.phases[-1]).pose, run.status, run.seconds
    whole = time.perf_counter() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE
    assert log.truth.pose is not None
    rmse, landmarks = rms(position_distance(pose, log.truth.pose)), int((known_decisions(inputs)[1] >= 0).sum())
    return RunCost(estimator, len(inputs), landmarks, seconds, whole, peak, before, rmse, status)


def measured_apart(estimator: str, name: str) -> RunCost:
    """The same in its own process, whose peak memory is this run's."""
    command = [sys.executable, "-m", "eval.benchmarks.large", estimator, name]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return RunCost(*json.loads(done.stdout.splitlines()[-1]))


def measure_all(sizes: Sequence[int] = SIZES, estimators: Sequence[str] = ESTIMATORS) -> Iterator[RunCost]:
    """Every estimator at every size, the small ones first."""
    for frames in sizes:
        for estimator in estimators:
            yield measured_apart(estimator, LOG.format(frames))


def slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Exponent of growth: slope of log(values) against log(sizes), by least squares over the larger two thirds."""
    x, y = np.log(np.asarray(sizes, float)), np.log(np.asarray(values, float))
    last = slice(len(x) // 3, None)
    return float(np.polyfit(x[last], y[last], 1)[0])


def draw_growth(ax: Axes, style: Style, sizes: Sequence[float], values: Sequence[float]) -> None:
    """A line on logarithmic axes; its label has the exponent, where three points or more show one."""
    exponent = f", $n^{{{slope(sizes, values):.2f}}}$" if len(sizes) > 2 else ""
    ax.plot(sizes, values, label=style.label + exponent, **style.look)
    ax.set(xscale="log", yscale="log")


def write(found: Sequence[RunCost], path: Path) -> None:
    """The measurements as CSV."""
    pd.DataFrame(found).to_csv(path, index=False, lineterminator="\n")


def line_of(m: RunCost) -> str:
    """A measurement as a line of text."""
    return ", ".join(f"{name} {v:.4g}" if isinstance(v, float) else f"{name} {v}" for name, v in m._asdict().items())


PEERS = {BARE: ("isam2", "bare gtsam loop"), BARE_BATCH: ("batch", "bare gtsam batch")}
"""Estimator that each bare loop is compared with, and its label."""


def scaling_figure(found: Sequence[RunCost]) -> Figure:
    """Wall time and peak memory above that of the log, over the number of frames, both axes logarithmic."""
    with drawing():
        fig = Figure(figsize=(page_width(), 3.5))
        panels: tuple[tuple[str, Callable[[RunCost], float]], ...] = (
            ("wall time [s]", lambda m: m.seconds),
            ("memory without the log [MB]", lambda m: max(m.peak_mb - m.log_mb, 1.0)),
        )
        for ax, (label, value) in zip(fig.subplots(1, 2), panels, strict=True):
            for estimator in dict.fromkeys(m.estimator for m in found):
                own = sorted((m for m in found if m.estimator == estimator), key=lambda m: m.frames)
                draw_growth(ax, _style(estimator), [m.frames for m in own], [value(m) for m in own])
            ax.set(xlabel="frames n [–]", ylabel=label)
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)  # below: lines fill the panel
        return fig


def _style(estimator: str) -> Style:
    if estimator not in PEERS:
        return style_of(estimator)
    ours, label = PEERS[estimator]
    return replace(style_of(ours), label=label, line=DOTTED, marker="o")


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure(*sys.argv[1:])) + "\n")
