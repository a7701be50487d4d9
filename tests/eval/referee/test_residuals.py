"""Smoothed residuals: zero without noise, else the noise; wrong pairings fit another landmark."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Increments, Observations
from data.logs import open_log
from data.se2 import between
from eval.referee.residuals import Used, misfits, smoothed_residuals, summaries, typical, used_by
from eval.replay.run import compare


@pytest.fixture(scope="module")
def log():
    return open_log("arena:2")


def truly(log):
    """What is used, with every landmark where it is."""
    places = log.truth.landmarks
    return Used(places.rows(log.truth.landmark_of), places.xy, places.id)


def noiseless(log):
    """The log as it would be without noise."""
    r, pose, o = log.recorded, log.truth.pose, log.recorded.observations
    motion = np.zeros_like(pose)
    motion[1:] = between(pose[:-1], pose[1:])
    z = r.sensor.predict(pose[o.frame], log.truth.landmarks.positions(log.truth.landmark_of))
    return replace(
        r, increments=Increments(motion, r.increments.covariance), observations=Observations(o.frame, z, o.R)
    )


def test_without_noise_nothing_is_left(log):
    found = smoothed_residuals(noiseless(log), log.truth.pose, truly(log))
    assert np.nanmax(np.abs(found.odometry)) < 1e-9
    assert np.nanmax(np.abs(found.observations)) < 1e-9
    assert np.isnan(found.odometry[0]).all()


def test_residuals_are_what_was_added_in_stated_sigmas(log):
    inputs, rng = noiseless(log), np.random.default_rng(0)
    o, M = inputs.observations, inputs.increments.covariance
    u, v = rng.normal(size=o.z.shape), rng.normal(size=(len(inputs), 3))
    sigma = np.sqrt(np.einsum("nii->ni", M))
    noisy = replace(
        inputs, increments=Increments(inputs.increments.mean + sigma * v, M),
        observations=Observations(o.frame, o.z + np.sqrt(np.einsum("mii->mi", o.R)) * u, o.R),
    )  # fmt: skip
    found = smoothed_residuals(noisy, log.truth.pose, truly(log))
    assert found.observations == pytest.approx(u, abs=1e-6)
    assert found.odometry[1:] == pytest.approx(v[1:], abs=1e-6)
    assert found.squared == pytest.approx((u**2).sum(axis=1), abs=1e-6)
    statistics = summaries(found, noisy, truly(log))
    assert statistics["residual_z1_mean"] == pytest.approx(u[:, 0].mean())
    assert statistics["residual_odometry_theta_spread"] == pytest.approx(v[1:, 2].std())
    assert statistics["residual_z2_largest"] == pytest.approx(np.abs(u[:, 1]).max())
    assert abs(statistics["residual_odometry_x_lag1"]) < 0.25  # white: 1 / sqrt(200) is one sigma
    assert typical(found)["z1"] == pytest.approx(1.0, abs=0.1)


def test_the_pairings_are_those_of_the_smoother(log):
    inputs = log.inputs(labels=True)
    for task, given in (("localization", inputs), ("slam", inputs.without_map())):
        (batch,) = compare(given, task, ["batch"])
        used = used_by(batch, given)
        o = given.observations
        rows = np.flatnonzero(used.number >= 0)
        assert len(rows) > 0.95 * len(o.frame)
        expected = given.sensor.predict(batch.final.pose[o.frame[rows]], used.landmarks[used.number[rows]])
        off = given.sensor.residual(o.z[rows], expected) / np.sqrt(np.einsum("mii->mi", o.R[rows]))
        assert np.abs(off).max() < 6.0
        if task == "slam":  # one landmark of the truth to each of the map
            pairs = {(a, b) for a, b in zip(used.number[rows].tolist(), log.truth.landmark_of[rows].tolist())}
            assert len(pairs) == len(used.landmarks)


def test_a_wrong_pairing_fits_another_landmark_and_an_outlier_fits_none(log):
    inputs, used = noiseless(log), truly(log)
    assert misfits(inputs, log.truth.pose, used, smoothed_residuals(inputs, log.truth.pose, used))[:2] == (0, 0)
    wrong = used.number.copy()
    wrong[100] = (wrong[100] + 1) % len(used.landmarks)
    swapped = Used(wrong, used.landmarks, used.identity)
    found = smoothed_residuals(inputs, log.truth.pose, swapped)
    outlying, elsewhere, excess = misfits(inputs, log.truth.pose, swapped, found)
    assert (outlying, elsewhere) == (1, 1)
    assert excess > 0.0
    z = inputs.observations.z.copy()
    z[100] = [60.0, 0.3]
    far = replace(inputs, observations=replace(inputs.observations, z=z))
    assert misfits(far, log.truth.pose, used, smoothed_residuals(far, log.truth.pose, used))[:2] == (1, 0)
