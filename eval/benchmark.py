"""`python -m eval.benchmark`: how fast the estimators are, beside their peers timed in the same run.

Every figure is the median of several repetitions after a warm-up; ratios compare neighbours in the same process, so
they travel between machines, absolute seconds do not.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from dataclasses import replace

import numpy as np

from eval.benchmarks.timed import REPEATS, Timed, median_seconds, table


def localization_log(frames: int) -> object:
    """An arena log with exactly three readings in every frame."""
    from data.inputs import LabelledObservations
    from data.worlds.arena import Arena, simulate

    log = simulate(Arena(frames=frames, landmarks=40, field_of_view=2 * math.pi), 0)
    inputs = log.inputs(labels=True)
    o = inputs.observations
    assert isinstance(o, LabelledObservations)
    rank = np.arange(len(o.frame)) - inputs.start[o.frame]
    first = rank < 3
    kept = LabelledObservations(o.frame[first], o.z[first], o.R[first], o.label[first])
    return replace(inputs, observations=kept)


def numpy_localizer(inputs: object) -> None:
    """The same filter as a plain numpy loop, the way it is usually written by hand."""
    from data.inputs import Inputs, LabelledObservations

    assert isinstance(inputs, Inputs)
    assert inputs.map is not None
    o = inputs.observations
    assert isinstance(o, LabelledObservations)
    x, P = inputs.prior.mean.copy(), inputs.prior.covariance.copy()
    for k in range(len(inputs)):
        if k:
            u, M = inputs.increment(k)
            c, s = math.cos(x[2]), math.sin(x[2])
            F = np.array([[1, 0, -s * u[0] - c * u[1]], [0, 1, c * u[0] - s * u[1]], [0, 0, 1]])
            B = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            P = F @ P @ F.T + B @ M @ B.T
            x = x + B @ u
        rows = slice(inputs.start[k], inputs.start[k + 1])
        d = inputs.map.xy[o.label[rows]] - x[:2]
        m = len(d)
        r = np.sqrt((d**2).sum(1))
        nu = o.z[rows] - np.stack([r, np.arctan2(d[:, 1], d[:, 0]) - x[2]], 1)
        nu[:, 1] = (nu[:, 1] + math.pi) % (2 * math.pi) - math.pi
        H = np.zeros((2 * m, 3))
        H[0::2, :2] = -d / r[:, None]
        H[1::2, 0], H[1::2, 1], H[1::2, 2] = d[:, 1] / r**2, -d[:, 0] / r**2, -1
        R = np.zeros((2 * m, 2 * m))
        for i, Ri in enumerate(o.R[rows]):
            R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = Ri
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x = x + K @ nu.ravel()
        P = (np.eye(3) - K @ H) @ P


def filterpy_localizer(inputs: object) -> None:
    """The same with filterpy's ExtendedKalmanFilter (its predict is replaced by ours: it has no nonlinear one)."""
    from filterpy.kalman import ExtendedKalmanFilter

    from data.inputs import Inputs, LabelledObservations

    assert isinstance(inputs, Inputs)
    assert inputs.map is not None
    o = inputs.observations
    assert isinstance(o, LabelledObservations)
    known = inputs.map.xy

    def h(x: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
        d = landmarks - x[:2]
        return np.stack([np.hypot(d[:, 0], d[:, 1]), np.arctan2(d[:, 1], d[:, 0]) - x[2]], 1).ravel()

    def H(x: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
        d = landmarks - x[:2]
        r = np.hypot(d[:, 0], d[:, 1])
        J = np.zeros((2 * len(d), 3))
        J[0::2, :2] = -d / r[:, None]
        J[1::2, 0], J[1::2, 1], J[1::2, 2] = d[:, 1] / r**2, -d[:, 0] / r**2, -1
        return J

    def residual(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        e: np.ndarray = a - b
        e[1::2] = (e[1::2] + math.pi) % (2 * math.pi) - math.pi
        return e

    f = ExtendedKalmanFilter(dim_x=3, dim_z=6)
    f.x, f.P = inputs.prior.mean.copy(), inputs.prior.covariance.copy()
    for k in range(len(inputs)):
        if k:
            u, M = inputs.increment(k)
            c, s = math.cos(f.x[2]), math.sin(f.x[2])
            f.F = np.array([[1, 0, -s * u[0] - c * u[1]], [0, 1, c * u[0] - s * u[1]], [0, 0, 1]])
            B = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            f.P = f.F @ f.P @ f.F.T + B @ M @ B.T
            f.x = f.x + B @ u
        rows = slice(inputs.start[k], inputs.start[k + 1])
        landmarks = known[o.label[rows]]
        m = len(landmarks)
        if m == 0:
            continue
        R = np.zeros((2 * m, 2 * m))
        for i, Ri in enumerate(o.R[rows]):
            R[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = Ri
        f.update(o.z[rows].ravel(), H, h, R=R, args=(landmarks,), hx_args=(landmarks,), residual=residual)


def localization_lines(frames: int) -> list[Timed]:
    """The EKF localizer with three readings a frame, and its peers."""
    from association.known import known_decisions
    from data.inputs import Inputs
    from ekf.whole_run import run_filter
    from eval.replay.run import step_by_step

    inputs = localization_log(frames)
    assert isinstance(inputs, Inputs)
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


def victoria_park_lines(frames: int) -> list[Timed]:
    """EKF-SLAM and iSAM2 over Victoria Park, iSAM2 beside a bare gtsam loop with the same factors."""
    from association.known import known_decisions
    from data.log import shortened
    from data.recordings.victoria_park import load_victoria_park
    from ekf.whole_run import run_filter
    from eval.replay.run import step_by_step
    from graph.bare_loop import bare_isam2

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


def main(argv: list[str] | None = None) -> int:
    """Time everything and print the table."""
    p = argparse.ArgumentParser(
        prog="python -m eval.benchmark", description=__doc__.split("\n\n")[0] if __doc__ else ""
    )
    p.add_argument("--quick", action="store_true", help="a tenth of the work, to see that it runs")
    quick = p.parse_args(argv).quick
    lines = localization_lines(2_000 if quick else 20_000)
    print(table(lines), flush=True)
    print(table(victoria_park_lines(700 if quick else 10**9)), flush=True)
    from eval.benchmarks.association import association_lines, hindsight_lines

    print(table(association_lines(quick)), flush=True)
    print(table(hindsight_lines(700 if quick else 10**9)), flush=True)
    from eval.benchmarks.studies import study_lines

    print(table(study_lines(quick)), flush=True)
    from eval.benchmarks.visual import visual_lines

    print(table(visual_lines(quick)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
