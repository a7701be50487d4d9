"""Two odometries of one robot: the graph fuses each step as least squares does, filters as well, and NEES is right."""

import numpy as np
import pytest

from data.formats.second_odometry import closures_between, covered, of_twists
from data.inputs import Increments
from data.log import Log
from data.se2 import between, dead_reckoned, pose_error
from data.truth import Truth
from eval.referee.score import Trial, score
from eval.replay.run import compare
from eval.replay.settings import FILTERS, Setup
from tests.builders.logs import inputs_of, observations_of

ALL = Setup(gate_poses=None)


def two_odometries(seed, frames, scale=1.0):
    """A drive on which wheels and camera err independently: its log, and the true path."""
    rng = np.random.default_rng(seed)
    true = np.column_stack([np.full(frames, 0.5), np.zeros(frames), 0.3 * np.sin(0.1 * np.arange(frames))])
    true[0] = 0.0
    spreads = []
    for sizes in ((0.03, 0.02, 0.02), (0.05, 0.01, 0.01)):
        A = rng.standard_normal((frames, 3, 3)) * np.array(sizes)[:, None] * scale
        spreads.append(0.3 * A @ A.transpose(0, 2, 1) + np.diag(np.square(sizes)) * scale**2)
        spreads[-1][0] = 0.0
    wheels, camera = (
        true + np.array([rng.multivariate_normal(np.zeros(3), P) if k else np.zeros(3) for k, P in enumerate(spread)])
        for spread in spreads
    )
    closures = closures_between(np.arange(frames), Increments(camera, spreads[1]), "camera")
    prior = np.array([1.0, 2.0, 0.4])
    nothing = observations_of([], [], label=[])
    inputs = inputs_of(Increments(wheels, spreads[0]), nothing, start=prior, closures=closures)
    return inputs, dead_reckoned(prior, true)


def test_each_step_is_the_weighted_mean_of_both():
    """(A^-1 + B^-1)^-1 (A^-1 a + B^-1 b); errors of 2 to 5e-5 leave 1e-9 of gtsam's, by the logarithm of a pose."""
    inputs, _ = two_odometries(0, 12, 1e-3)
    a, A = inputs.increments.mean[1:], np.linalg.inv(inputs.increments.covariance[1:])
    b, B = inputs.closures.relative, np.linalg.inv(inputs.closures.covariance)
    P = np.linalg.inv(A + B)
    fused = (P @ (A @ a[:, :, None] + B @ b[:, :, None]))[:, :, 0]
    *filters, isam2, batch = compare(inputs, "slam", (*FILTERS, "isam2", "batch"), setup=ALL)
    assert np.abs(fused - a).max() > 1e-5
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for run in (batch, isam2, *filters):
        path, covariance = (t := run.final if run.final is not None else run.online).pose, t.covariance
        np.testing.assert_allclose(pose_error(between(path[:-1], path[1:]), fused), 0.0, atol=2e-8)
        np.testing.assert_allclose(covariance[1], turn @ P[0] @ turn.T, rtol=1e-3, atol=1e-13)


def test_the_referee_counts_the_second_odometry_as_a_source():
    inputs, true = two_odometries(1, 400)
    runs = compare(inputs, "slam", ("ekf", "batch"))
    found = score([Trial(Log("two", inputs, Truth(true)), "slam", tuple(runs))]).sources
    row = found[(found["estimator"] == "ekf") & (found["phase"] == "online")].iloc[0]
    assert (row["source"], row["kind"], row["count"]) == ("camera", "closure", 399)
    assert row["nis_low"] < row["nis_mean"] < row["nis_high"]
    assert row["nis_mean"] == pytest.approx(1.0, abs=0.1)


def test_twists_state_the_noise_of_the_motion_between_frames():
    """Against a dense reference: velocities drawn with the stated covariance, held, and integrated step by step."""
    rng = np.random.default_rng(2)
    stamp = np.sort(rng.uniform(0.0, 4.0, 30))
    velocity = np.column_stack([np.full(30, 0.8), np.zeros(30), 0.4 * np.sin(stamp)])
    C = np.tile(np.diag([0.2, 0.1, 0.05]) ** 2, (30, 1, 1))
    C[:, 0, 2] = C[:, 2, 0] = 0.004
    at = stamp[[0, 7, 18, 29]]
    dt = np.diff(stamp)[:, None]
    pose = dead_reckoned(np.zeros(3), np.concatenate([np.zeros((1, 3)), velocity[1:] * dt]))
    found = of_twists(stamp, pose, C, at)
    ends = pose[[0, 7, 18, 29]]
    np.testing.assert_allclose(found.mean[1:], between(ends[:-1], ends[1:]), atol=1e-12)
    root = np.linalg.cholesky(C[1:])
    runs = 2000
    drawn = velocity[1:] + 0.2 * (root[None] @ rng.standard_normal((runs, 29, 3, 1)))[..., 0]
    errors = np.empty((runs, 3, 3))
    for i in range(runs):
        path = dead_reckoned(np.zeros(3), np.concatenate([np.zeros((1, 3)), drawn[i] * dt]))[[0, 7, 18, 29]]
        errors[i] = pose_error(between(path[:-1], path[1:]), found.mean[1:])
    measured = np.einsum("nki,nkj->kij", errors, errors) / runs
    scale = np.sqrt(np.diagonal(found.covariance[1:], axis1=1, axis2=2))
    off = (measured / 0.2**2 - found.covariance[1:]) / (scale[:, :, None] * scale[:, None, :])
    assert np.abs(off).max() < 0.12


def test_parts_of_an_interval_share_its_variance():
    stamp, pose = np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    C = np.tile(np.diag([0.3, 0.2, 0.0]) ** 2, (2, 1, 1))
    whole = of_twists(stamp, pose, C, np.array([0.0, 1.0])).covariance[1]
    parts = of_twists(stamp, pose, C, np.array([0.0, 0.25, 1.0])).covariance[1:]
    np.testing.assert_allclose(parts.sum(axis=0), whole, atol=1e-15)
    np.testing.assert_allclose(parts[0], 0.25 * C[0], atol=1e-15)


def test_a_frame_is_covered_at_a_stamp_and_between_near_ones():
    stamp = np.array([0.0, 1.0, 3.0, 4.0])
    time = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 3.5, 4.0, 5.0])
    assert covered(stamp, time).tolist() == [False, True, True, True, False, True, True, True, False]
