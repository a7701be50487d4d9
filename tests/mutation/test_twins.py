"""Broken twins of the localizer: over 50 runs the verdicts call them overconfident, and the sound filter consistent.

What a single fault breaks elsewhere is found by `tests.mutation.sampled`.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from data import se2
from data.inputs import Increment, Inputs
from data.result import PoseEstimate
from data.sensors import measure
from data.worlds.arena import Arena, simulate
from ekf import kernels, updates
from ekf.filter import Filter
from eval.referee import consistency
from eval.referee.consistency import chi2_bounds
from eval.replay.run import step_by_step

RUNS = 50


@cache
def arena(seed):
    return simulate(Arena(frames=80, landmarks=15), seed)


def localized(seed):
    """Step by step, so that a patched step is the step that runs."""
    run = step_by_step("ekf", arena(seed).inputs(labels=True), "localization")
    assert run.failure is None
    return run


def nees_verdict():
    """On the mean pose NEES of each run."""
    paths = [(localized(seed).online, arena(seed).truth.pose) for seed in range(RUNS)]
    means = [np.nanmean(consistency.nees(path.pose, path.covariance, truth, "pose")) for path, truth in paths]
    return consistency.verdict(np.array(means), 3)


def nees():
    return nees_verdict().word


def whiteness():
    frames = [(localized(seed), arena(seed).recorded.observations.frame) for seed in range(RUNS)]
    lag1 = [consistency.lag1(run.innovations.white, frame, run.decisions)[0] for run, frame in frames]
    return consistency.whiteness(np.array(lag1)).word


def nis():
    """All innovations together against one chi-square."""
    total, dof = np.sum([localized(seed).total_nis for seed in range(10)], axis=0)
    low, high = chi2_bounds(int(dof))
    return "consistent" if low < total / dof < high else "overconfident" if total / dof > high else "conservative"


def test_the_sound_filter_is_consistent():
    found = nees_verdict()
    assert (found.word, whiteness(), nis()) == ("consistent", "white", "consistent")
    assert found.power > 0.9, "a verdict without power says nothing"


def scaled(patch):
    """The covariance reported is 0.8 of what it is."""
    real = Filter.estimate
    patch.setattr(Filter, "estimate", lambda self: PoseEstimate(real(self).mean, 0.8 * real(self).covariance))


def in_the_body_frame(patch):
    real = Filter.estimate

    def estimate(self):
        mean, P = real(self)
        B = se2.world_from_body(mean[2])
        return PoseEstimate(mean, B.T @ P @ B)

    patch.setattr(Filter, "estimate", estimate)


def half_the_noise(patch):
    """Of the process."""
    real = Inputs.increment

    def increment(self, frame):
        mean, covariance = real(self, frame)
        return Increment(mean, 0.5 * covariance)

    patch.setattr(Inputs, "increment", increment)


def interpreted(function, **instead):
    """A compiled function of the updates as plain Python, with other globals."""
    scope = {**function.py_func.__globals__, **instead}
    return type(function.py_func)(function.py_func.__code__, scope)


def with_innovate(patch, innovate):
    update = interpreted(updates.update, innovate=innovate)
    patch.setattr(updates, "of_frame", interpreted(updates.of_frame, update=update))


def unwrapped(patch):
    """The bearing less the expected one, not wrapped."""

    def innovate(kind, extrinsic, mean, base, P, d, seen, begin, out, first):
        kernels.innovate(kind, extrinsic, mean, base, P, d, seen, begin, out, first)
        bearing = seen.z[:, 1]
        out.nu[1::2] = bearing - se2.wrap_angle(bearing - out.nu[1::2])

    with_innovate(patch, innovate)


def jacobian_of_the_first_sighting(patch):
    """Of a landmark for all its later ones."""
    kept = {}

    def innovate(kind, extrinsic, mean, base, P, d, seen, begin, out, first):
        kernels.innovate(kind, extrinsic, mean, base, P, d, seen, begin, out, first)
        rows = []
        for landmark in seen.known:
            H = np.empty((2, 3))
            measure(kind, extrinsic, mean, *landmark, np.empty(2), H, np.empty((2, 2)))
            rows.append(kept.setdefault(tuple(landmark), H))
        H = np.concatenate(rows)
        out.PHt[:] = P[:d, :d] @ H.T
        out.S[:] = H @ out.PHt
        for i in range(len(seen.at)):
            out.S[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += seen.R[i]

    with_innovate(patch, innovate)


@pytest.mark.parametrize(
    ("twin", "verdict", "word"),
    [
        *((t, nees, "overconfident") for t in (scaled, half_the_noise, unwrapped, jacobian_of_the_first_sighting)),
        (in_the_body_frame, nees, "overconfident"),
        (half_the_noise, whiteness, "correlated"),
        (half_the_noise, nis, "overconfident"),
    ],
)
def test_a_broken_twin_is_called_so(twin, verdict, word, monkeypatch):
    twin(monkeypatch)
    assert verdict() == word
