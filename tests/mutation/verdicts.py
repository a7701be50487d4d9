"""The named checks: verdicts of the product on small logs, each true of the product as it is.

Estimators run step by step, so that a patched step is the step that runs.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from data import se2
from data.worlds.arena import Arena, simulate
from data.worlds.corridor import Corridor
from data.worlds.corridor import simulate as simulate_corridor
from eval.referee import consistency
from eval.referee.consistency import chi2_bounds
from eval.replay.run import compare, step_by_step
from tests.mutation.faults import Check

RUNS = 50
WORLD = Arena(frames=20, landmarks=15)


@cache
def arena(seed, frames=80):
    return simulate(Arena(frames=frames, landmarks=15), seed)


@cache
def corridor():
    return simulate_corridor(Corridor(frames=20), 0)


def localized(log):
    return step_by_step("ekf", log.inputs(labels=True), "localization")


def smoothed(log):
    return compare(log.inputs(labels=True), "localization", ["batch"])[0]


# NEES, NIS and whiteness


def expect_consistent(v):
    assert v.word in ("consistent", "white"), f"{v.word}, {v.mean:.3g} for {v.expected:g} (N = {v.runs})"


def nees_verdict(run, logs):
    """Mean pose NEES of each run; a consistent estimator must be called so, by a verdict that has power."""
    means = []
    for log in logs:
        r = run(log)
        assert r.failure is None, f"{r.status} at frame {r.failure.frame}: {r.failure.why}"
        t = r.trajectory(r.phases[0])
        means.append(consistency.mean_or_nan(consistency.nees(t.pose, t.covariance, log.truth.pose, "pose")))
    v = consistency.verdict(np.array(means), 3)
    expect_consistent(v)
    assert v.power > 0.9, f"power {v.power:.2f}: a verdict without power says nothing"


def localizer_nees():
    nees_verdict(localized, [arena(s) for s in range(RUNS)])


def fresh_localizer_nees():
    """The logs are made anew, for faults in the simulator."""
    nees_verdict(localized, [simulate(WORLD, s) for s in range(RUNS)])


def batch_nees():
    nees_verdict(smoothed, [arena(s, 20) for s in range(RUNS)])


def localizer_whiteness():
    correlations = []
    for seed in range(RUNS):
        log = arena(seed)
        run = localized(log)
        correlations.append(consistency.lag1(run.innovations.white, log.recorded.observations.frame, run.decisions)[0])
    expect_consistent(consistency.whiteness(np.array(correlations)))


def nis_verdict(runs):
    """Innovations are white, in one run and from run to run: all of them together against one chi-square."""
    for run in runs:
        assert run.failure is None, f"{run.status}: {run.failure.why}"
    total, dof = np.sum([run.total_nis for run in runs], axis=0)
    low, high = chi2_bounds(int(dof))
    assert low < total / dof < high, f"{total / dof:.3g} per degree of freedom, not {low:.2f} to {high:.2f}"


def localizer_nis():
    nis_verdict([localized(arena(s)) for s in range(10)])


def batch_nis():
    nis_verdict([smoothed(arena(s, 20)) for s in range(10)])


LOCALIZER_NEES = Check(f"NEES verdict of the localizer, {RUNS} arenas", localizer_nees)
FRESH_NEES = Check(f"NEES verdict of the localizer, {RUNS} new arenas", fresh_localizer_nees)
BATCH_NEES = Check(f"NEES verdict of the batch smoother, {RUNS} arenas", batch_nees)
LOCALIZER_WHITENESS = Check(f"whiteness verdict of the localizer, {RUNS} arenas", localizer_whiteness)
LOCALIZER_NIS = Check("NIS verdict of the localizer, 10 arenas", localizer_nis)
BATCH_NIS = Check("NIS verdict of the batch smoother, 10 arenas", batch_nis)


# filter and smoother on identical inputs


def as_certain():
    inputs = corridor().inputs(labels=True).without_map()
    ekf, isam2 = (step_by_step(name, inputs, "slam") for name in ("ekf", "isam2"))
    ratio = ekf.online.covariance[1:, 0, 0] / isam2.online.covariance[1:, 0, 0]
    low, high = ratio.min(), ratio.max()
    assert 0.8 < low <= high < 1.2, f"var(x) {low:.2g} to {high:.2g} of the smoother's"


def agree(a, b, covariance, limit):
    """Two poses are closer than `limit` sigma."""
    error = se2.pose_error(a, b)
    apart = math.sqrt(error @ np.linalg.solve(covariance, error))
    assert apart < limit, f"{apart:.3g} sigma apart"


def same_last_pose():
    """With a known map the last pose is the same up to linearization, in mean and in covariance."""
    inputs = arena(2).inputs(labels=True)
    ekf = localized(arena(2)).online
    batch, isam2 = smoothed(arena(2)).final, step_by_step("isam2", inputs, "localization").online
    for other in (batch, isam2):
        agree(ekf.pose[-1], other.pose[-1], other.covariance[-1], 0.3)
        ratio = np.diag(ekf.covariance[-1]) / np.diag(other.covariance[-1])
        assert abs(np.log(ratio)).max() < 0.1, f"variances differ by factors {ratio.round(2).tolist()}"


AS_CERTAIN = Check("filter and smoother are equally certain (SLAM)", as_certain)
SAME_LAST_POSE = Check("filter and smoothers agree on the last pose", same_last_pose)
