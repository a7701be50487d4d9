"""Faults in the scoring: true answers, errors, and what may be concluded from NEES."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data import se2
from data.result import Trajectory
from eval.referee import consistency
from eval.referee.consistency import chi2_bounds
from eval.referee.score import confusion_of, metrics_row
from eval.replay.estimators import dead_reckoning
from eval.replay.run import compare
from tests.mutation.faults import Check, Fault, replaced
from tests.mutation.verdicts import arena, corridor


def labels_are_right():
    counts = confusion_of(compare(corridor().inputs(labels=True), "slam", ["ekf"], "known")[0], corridor(), "online")
    assert counts.fp == counts.fn == 0, f"{counts.fp} fp, {counts.fn} fn"


def off_everywhere():
    """metrics.csv of a path that is 0.5 m and 10 degrees off everywhere; the truth is known in every other frame."""
    log = arena(0)
    pose = log.truth.pose.copy()
    pose[1::2] = np.nan
    log = replace(log, truth=replace(log.truth, pose=pose))
    run = dead_reckoning(log.inputs(), "localization")
    off = se2.compose(arena(0).truth.pose, np.array([0.3, -0.4, np.radians(10.0)]))
    return metrics_row(replace(run, online=Trajectory(off, run.online.covariance)), "online", log, None)


def rmse_of_a_known_path():
    rmse = off_everywhere()["rmse_position_m"]
    assert abs(rmse - 0.5) < 1e-9, f"it says {rmse:.3g}"


def heading_of_a_known_path():
    rmse = off_everywhere()["rmse_heading_deg"]
    assert abs(rmse - 10.0) < 1e-9, f"it says {rmse:.3g}"


def few_runs_prove_nothing():
    draws = np.random.default_rng(0).chisquare(3, 49)
    for n in (2, 5, 49):
        word = consistency.verdict(draws[:n], 3).word
        assert word == "not enough runs", f"{n} runs are called {word}"


STEPS = 100


def accepts_a_perfect_filter():
    """A matched Kalman filter of a random walk, 300 studies of 50 runs: its NEES is correlated in time."""
    rng = np.random.default_rng(4)
    q, r, P, e = 0.01, 1.0, 1.0, rng.standard_normal((300, 50))
    total = np.zeros_like(e)
    for _ in range(STEPS):
        e, P = e - np.sqrt(q) * rng.standard_normal(e.shape), P + q
        K = P / (P + r)
        e, P = (1.0 - K) * e + K * np.sqrt(r) * rng.standard_normal(e.shape), (1.0 - K) * P
        total += e**2 / P
    share = np.mean([consistency.verdict(study, 1).word == "consistent" for study in total / STEPS])
    assert 0.92 < share < 0.98, f"it is {100 * share:.0f} % in 300 studies"


LABELS = Check("association.csv: labels are never wrong", labels_are_right)
RMSE = Check("metrics.csv: RMSE of a path 0.5 m off", rmse_of_a_known_path)
HEADING = Check("metrics.csv: heading RMSE of a path 10 degrees off", heading_of_a_known_path)
FEW_RUNS = Check("fewer than 50 runs are not enough", few_runs_prove_nothing)
ACCEPTS = Check("accept rate of a perfect filter is 95 %", accepts_a_perfect_filter)


def answers_of_the_frame_before(real):
    def late(frame, true_id, created, known, removed=None):
        gt = real(frame, true_id, created, known, removed)
        first = np.searchsorted(frame, frame)
        before = np.searchsorted(frame, np.maximum(frame - 1, 0))
        return gt[np.minimum(before + np.arange(len(frame)) - first, len(gt) - 1)]

    return late


def root_of_the_sum(real):
    return lambda values: float(np.sqrt(np.nansum(values**2)))


def unknown_as_zero(real):
    return lambda values: real(np.nan_to_num(values))


def every_frame_a_sample(real):
    """Chi-square bounds as if the frames of a run were independent."""

    def verdict(run_means, dof, *words):
        v = real(run_means, dof, *words)
        low, high = chi2_bounds(dof * STEPS * v.runs, 0.95)
        inside = low <= v.mean / dof <= high
        return replace(v, word="consistent" if inside else "overconfident" if v.mean > dof else "conservative")

    return verdict


def two_runs_will_do(monkeypatch):
    monkeypatch.setattr(consistency, "MIN_RUNS", 2)


FAULTS = (
    Fault(8, "true answer of the frame before", LABELS,
          replaced("eval.referee.confusion.ground_truth", answers_of_the_frame_before)),
    Fault(13, "root of the sum sold as RMSE", RMSE, replaced("eval.referee.errors.rms", root_of_the_sum)),
    Fault(13, "RMSE over frames without truth", RMSE, replaced("eval.referee.errors.rms", unknown_as_zero)),
    Fault(16, "NEES verdict from two runs", FEW_RUNS, two_runs_will_do),
    Fault(16, "NEES bounds from time averages", ACCEPTS,
          replaced("eval.referee.consistency.verdict", every_frame_a_sample)),
    Fault(23, "heading errors not wrapped", HEADING,
          replaced("data.se2.pose_error", lambda real: lambda estimate, truth: np.asarray(estimate) - truth)),
)  # fmt: skip
