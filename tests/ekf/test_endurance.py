"""A million steps in one filter: P stays symmetric to the bit and positive semidefinite."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from data.sensors import RangeBearing, RelativePoint
from ekf import kernels
from ekf.filter import FilterOptions
from ekf.kernels import Pairings, augment, predict
from ekf.updates import Outcome, UpdateRule, update

STEPS, BLOCK = 1_000_000, 50_000


@numba.njit
def drive(kind, extrinsic, mean, P, d, landmarks, rng, steps, sigma, rule, first):
    """Predict and update on a loop among the landmarks, two seen at a time; returns the worst asymmetry."""
    M, R = np.diag(np.array([1e-4, 1e-6, 1e-5])), np.diag(sigma**2)
    truth = np.array([5.0, 0.0, 0.5 * np.pi])
    keep, stats, white = np.ones(2, np.bool_), np.zeros(3), np.zeros((2, 2))
    worst = 0.0
    for k in range(steps):
        motion = np.array([0.1, 0.0, 0.02])
        truth[0] += 0.1 * np.cos(truth[2])
        truth[1] += 0.1 * np.sin(truth[2])
        truth[2] += 0.02
        noise = rng.standard_normal(3)
        predict(mean, P, d, motion + np.array([1e-2, 1e-3, 3.2e-3]) * noise, M, first)
        at, z, Rs = np.empty(2, np.int64), np.empty((2, 2)), np.empty((2, 2, 2))
        for i in range(2):
            n = (k + 3 * i) % len(landmarks)
            at[i], Rs[i] = 3 + 2 * n, R
            dx, dy = landmarks[n, 0] - truth[0], landmarks[n, 1] - truth[1]
            c, s = np.cos(truth[2]), np.sin(truth[2])
            x, y = c * dx + s * dy, -s * dx + c * dy
            if kind == 0:
                z[i, 0], z[i, 1] = np.hypot(x, y), np.arctan2(y, x)
            else:
                z[i, 0], z[i, 1] = x, y
            z[i] += sigma * rng.standard_normal(2)
        seen, how = Pairings(at, np.zeros((2, 2)), z, Rs), UpdateRule(np.inf, rule[0], rule[1], False, first)
        status = update(kind, extrinsic, mean, mean, P, d, seen, 0, 2, how, Outcome(keep, stats, white))
        if status != 0:
            return -1.0
        for i in range(d):
            for j in range(i):
                worst = max(worst, abs(P[i, j] - P[j, i]))
    return worst


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [RangeBearing(), RelativePoint()], ids=["range_bearing", "relative_point"])
@pytest.mark.parametrize(
    "options",
    [FilterOptions(), FilterOptions(first_estimates=True), FilterOptions(invariant=True)],
    ids=["plain", "first-estimates", "invariant"],
)
def test_p_stays_symmetric_and_positive_semidefinite_over_a_million_steps(sensor, options):
    landmarks = np.array([(-4.0, 1.0), (0.0, 9.0), (6.0, 7.0), (9.0, -2.0), (1.0, -8.0)])
    d = 3 + 2 * len(landmarks)
    mean, P = np.zeros(d), np.zeros((d, d))
    mean[:3] = 5.0, 0.0, 0.5 * np.pi
    P[:3, :3] = 1e-6 * np.eye(3)
    sigma = np.array([0.05, 0.01]) if sensor.name == "range_bearing" else np.array([0.05, 0.05])
    first = mean.copy() if options.first_estimates else kernels.NEWEST
    z = sensor.predict(mean[:3], landmarks)
    for i in range(len(landmarks)):
        augment(sensor.kind, sensor.extrinsic, mean, P, 3 + 2 * i, z[i], np.diag(sigma**2), -1.0, first)
    rng = np.random.default_rng(0)
    for _ in range(STEPS // BLOCK):
        worst = drive(sensor.kind, sensor.extrinsic, mean, P, d, landmarks, rng, BLOCK, sigma, options.rule(), first)
        assert worst == 0.0
        assert np.isfinite(mean).all()
        assert np.linalg.eigvalsh(P)[0] >= -1e-12 * np.trace(P)
