"""Localization in an uncertain map: dense least squares over path and map, and filters that end where smoothers do."""

from dataclasses import replace

import numpy as np
import pytest

from data import se2
from data.inputs import LandmarkMap
from data.sensors import Range, RangeBearing, RelativePoint
from ekf.whole_run import run_filter
from eval.replay.run import compare
from eval.replay.settings import FILTERS
from tests.builders import logs
from tests.oracle.test_linear_world import FRAMES, LANDMARKS, P0, M, R, inputs_of, rotation, world  # noqa: F401

SIGMA = np.array([[0.0, 0.0], [0.4, 0.0], [0.3, 0.6], [0.05, 0.1], [2.0, 1.0], [0.2, 0.2], [0.5, 0.5]])


@pytest.fixture(scope="module")
def uncertain(world):  # noqa: F811
    inputs, _, _ = inputs_of(world, 0.0)
    rng = np.random.default_rng(11)
    known = LandmarkMap(3 + 2 * np.arange(LANDMARKS), rng.uniform(-6.0, 6.0, (LANDMARKS, 2)), sigma=SIGMA)
    return replace(inputs, map=known), known.id[[j for _, j, _ in world[3]]]


@pytest.fixture(scope="module")
def dense(world, uncertain):  # noqa: F811
    """Mean and covariance of path and map together (2 N + 2 L,), by the posterior of a linear Gaussian model."""
    motions, _, heading, seen, start = world
    known, n = uncertain[0].map, 2 * (FRAMES + LANDMARKS)
    mean, A = np.zeros(n), np.zeros((n, n))  # prior of everything: a chain of motions, and the map
    Q = np.zeros((n, n))
    mean[:2], Q[:2, :2] = start, P0
    A[:2, :2] = np.eye(2)
    for k in range(1, FRAMES):
        C = rotation(heading[k - 1])
        mean[2 * k : 2 * k + 2] = mean[2 * k - 2 : 2 * k] + C @ motions[k]
        Q[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = C @ M @ C.T
        A[2 * k : 2 * k + 2, : 2 * k] = A[2 * k - 2 : 2 * k, : 2 * k]
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.eye(2)
    m = 2 * FRAMES
    mean[m:], Q[m:, m:], A[m:, m:] = known.xy.ravel(), np.diag(SIGMA.ravel() ** 2), np.eye(2 * LANDMARKS)
    P = A @ Q @ A.T
    H, z = np.zeros((2 * len(seen), n)), np.concatenate([each for _, _, each in seen])
    for i, (k, j, _) in enumerate(seen):
        C = rotation(heading[k]).T
        H[2 * i : 2 * i + 2, 2 * k : 2 * k + 2], H[2 * i : 2 * i + 2, m + 2 * j : m + 2 * j + 2] = -C, C
    S = H @ P @ H.T + np.kron(np.eye(len(seen)), R)
    K = np.linalg.solve(S, H @ P).T
    return mean + K @ (z - H @ mean), P - K @ H @ P, (z - H @ mean) @ np.linalg.solve(S, z - H @ mean)


def test_a_filter_ends_at_the_dense_posterior_of_pose_and_map(uncertain, dense):
    inputs, decisions = uncertain
    mean, P, chi_square = dense
    run = run_filter(inputs, decisions)
    last, m = slice(2 * FRAMES - 2, 2 * FRAMES), 2 * FRAMES
    np.testing.assert_allclose(run.pose[-1, :2], mean[last], atol=1e-9)
    np.testing.assert_allclose(run.covariance[-1, :2, :2], P[last, last], atol=1e-9)
    np.testing.assert_allclose(run.map.xy.ravel(), mean[m:], atol=1e-9)
    blocks = np.array([P[i : i + 2, i : i + 2] for i in range(m, len(P), 2)])
    np.testing.assert_allclose(run.map.covariance, blocks, atol=1e-9)
    assert run.map.number.tolist() == inputs.map.id.tolist()
    assert run.nis.sum() == pytest.approx(chi_square, abs=1e-6)
    assert run.state_size[-1] == 3 + 2 * (LANDMARKS - 1), "the exact landmark is no state"


SCALE = 3e-5


def tiny(sensor, noise, seed=3):
    """A drive with errors so small that every model is linear, in a map with errors of the same size, with labels."""
    rng = np.random.default_rng(seed)
    spread = SCALE**2 * np.diag([0.09, 0.06, 0.04])
    start = np.array([1.0, 2.0, 0.4])
    truth = [start + rng.multivariate_normal(np.zeros(3), spread)]
    steps = np.array([[0.0, 0.0, 0.0], *([0.4, 0.03, 0.3] + 0.1 * rng.standard_normal((11, 3)))])
    for step in steps[1:]:
        truth.append(se2.compose(truth[-1], step + rng.multivariate_normal(np.zeros(3), spread)))
    sigma = SCALE * rng.uniform(0.5, 2.0, (6, 2))
    xy = rng.uniform(-4.0, 6.0, (6, 2))
    frame, label = np.nonzero(rng.random((12, 6)) < 0.6)
    z = sensor.predict(np.array(truth)[frame], xy[label])
    measures = [q in sensor.measures for q in (0, 1)]
    z = z + SCALE * np.array(noise) * measures * rng.standard_normal(z.shape)
    C = np.diag(np.where(measures, (SCALE * np.array(noise)) ** 2, 1.0))
    seen = logs.observations_of(frame, z, C, label)
    known = LandmarkMap(np.arange(6), xy + sigma * rng.standard_normal(sigma.shape), sigma=sigma)
    return logs.inputs_of(logs.increments_of(steps, spread), seen, sensor, known, start=start, spread=spread)


@pytest.mark.parametrize(
    ("sensor", "noise"), [(RangeBearing(), (0.5, 0.1)), (RelativePoint(), (0.5, 0.3)), (Range(), (0.5, 1.0))]
)
def test_a_filter_ends_where_the_smoothers_do(sensor, noise):
    inputs = tiny(sensor, noise)
    *others, batch = compare(inputs, "localization", [*FILTERS, "isam2", "fixed-lag", "batch"])
    last, P = batch.final.pose[-1], batch.final.covariance[-1]
    for run in others:
        assert run.failure is None
        np.testing.assert_allclose(run.online.pose[-1], last, atol=1e-9 * np.sqrt(P.trace()) + 1e-11)
        np.testing.assert_allclose(run.online.covariance[-1], P, atol=1e-5 * P.trace())
        np.testing.assert_allclose(run.map.xy, batch.map.xy, atol=1e-4 * SCALE)
        np.testing.assert_allclose(run.map.covariance, batch.map.covariance, atol=1e-4 * SCALE**2)
    assert batch.total_nis[1] == len(inputs.observations.z) * len(sensor.measures)
    exact = compare(replace(inputs, map=inputs.map.exact), "localization", ["ekf", "batch"])[-1]
    assert np.abs((exact.final.pose[-1] - last) / np.sqrt(np.diag(P))).max() > 0.1, "the sigmas matter"
