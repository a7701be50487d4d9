"""How fast the EKF localizer is, beside the same filter as a plain numpy loop and with filterpy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from association.known import known_decisions
from data.inputs import Inputs, LabelledObservations
from data.worlds.arena import Arena, simulate
from ekf.whole_run import run_filter
from eval.benchmarks.timed import Timed, median_seconds
from eval.replay.run import step_by_step


def localization_log(frames: int) -> Inputs:
    """An arena log with exactly three readings in every frame."""
    log = simulate(Arena(frames=frames, landmarks=40, field_of_view=2 * math.pi), 0)
    inputs = log.inputs(labels=True)
    o = inputs.observations
    assert isinstance(o, LabelledObservations)
    rank = np.arange(len(o.frame)) - inputs.start[o.frame]
    first = rank < 3
    kept = LabelledObservations(o.frame[first], o.z[first], o.R[first], o.label[first])
    return replace(inputs, observations=kept)


def numpy_localizer(inputs: Inputs) -> None:
    """The same filter as a plain numpy loop, the way it is usually written by hand."""
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


def filterpy_localizer(inputs: Inputs) -> None:
    """The same with filterpy's ExtendedKalmanFilter (its predict is replaced by ours: it has no nonlinear one)."""
    from filterpy.kalman import ExtendedKalmanFilter

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
