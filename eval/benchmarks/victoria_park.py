"""How fast SLAM over Victoria Park is, iSAM2 beside a bare gtsam loop with the same factors."""

from __future__ import annotations

import statistics
import time

from association.known import known_decisions
from data.log import shortened
from data.recordings.victoria_park import load_victoria_park
from ekf.whole_run import run_filter
from eval.benchmarks.timed import REPEATS, Timed, median_seconds
from eval.replay.run import step_by_step
from graph.bare_loop import bare_isam2


def victoria_park_lines(frames: int) -> list[Timed]:
    """EKF-SLAM and iSAM2 over Victoria Park, iSAM2 beside a bare gtsam loop with the same factors."""
    log = shortened(load_victoria_park(), frames)
    inputs = log.inputs(labels=True).without_map()
    decisions, created = known_decisions(inputs)
    n = len(inputs)
    slam = median_seconds(lambda: run_filter(inputs, decisions), 3)
    ours, bare = [], []
    first = shortened(log, 300).inputs(labels=True).without_map()
    step_by_step("isam2", first, "slam", finish=False)  # a warm-up for the compiled parts
    for _ in range(REPEATS):  # in turn, so that a drift of the machine's speed touches both
        begin = time.perf_counter()
        step_by_step("isam2", inputs, "slam", finish=False)
        ours.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        bare_isam2(inputs, decisions, created)
        bare.append(time.perf_counter() - begin)
    ratio = statistics.median(a / b for a, b in zip(ours, bare, strict=True))
    landmarks = int((created >= 0).sum())
    return [
        Timed(f"EKF-SLAM, Victoria Park ({landmarks} landmarks)", slam, n, "frames", "", "<= 3 s"),
        Timed("iSAM2, Victoria Park, frame by frame", statistics.median(ours), n, "frames", f"{ratio:.2f}", "<= 1.20"),
        Timed("peer: bare gtsam loop, same factors", statistics.median(bare), n, "frames", "1"),
    ]
