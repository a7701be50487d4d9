"""Scores of systematic errors: against dense least squares and the cost of the batch optimum; size and power."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from data.inputs import Increments, LandmarkMap
from data.se2 import between, compose, pose_error, world_from_body
from data.worlds.linear import LinearWorld, simulate
from graph.qr.score_test import systematic
from tests.graph.worlds import SENSORS, circle

EXACT = np.zeros((3, 3))


def dense(inputs, number, path, landmarks, motion, readings):
    """(score, information) by generalized least squares on all residuals, pose by pose in plain loops: every deviation
    is a matrix times all noises plus one times the errors, and the landmarks are profiled out.
    """
    n, p, size = len(path), motion.shape[2], 2 * len(landmarks)
    of_noise, of_errors, mean = np.zeros((n, 3, 3 * n)), np.zeros((n, 3, p)), np.zeros((n, 3))
    noise = np.zeros((3 * n, 3 * n))
    noise[:3, :3] = inputs.prior.covariance
    of_noise[0, :, :3] = np.eye(3)
    mean[0] = pose_error(inputs.prior.mean, path[0])
    for k in range(1, n):
        x, y = path[k, :2] - path[k - 1, :2]
        F, B = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]]), world_from_body(path[k - 1, 2])
        at = slice(3 * k, 3 * k + 3)
        noise[at, at] = inputs.increments.covariance[k]
        of_noise[k] = F @ of_noise[k - 1]
        of_noise[k][:, at] = -B
        of_errors[k] = F @ of_errors[k - 1] - B @ motion[k]
        stated = compose(path[k - 1], inputs.increments.mean[k])
        mean[k] = F @ mean[k - 1] + pose_error(stated, path[k])
    rows = np.flatnonzero(number >= 0)
    H, J, r = np.zeros((2 * len(rows), 3 * n)), np.zeros((2 * len(rows), p + size)), np.zeros(2 * len(rows))
    R = np.zeros((2 * len(rows), 2 * len(rows)))
    o = inputs.observations
    for j, i in enumerate(rows):
        k, of = o.frame[i], number[i]
        z_hat, Hx, Hl = (a[0] for a in inputs.sensor.linearize(path[k], landmarks[of : of + 1]))
        at = slice(2 * j, 2 * j + 2)
        H[at] = Hx @ of_noise[k]
        J[at, :p] = Hx @ of_errors[k] + readings[i]
        J[at, p + 2 * of : p + 2 * of + 2] = Hl
        r[at] = inputs.sensor.residual(o.z[i], z_hat) - Hx @ mean[k]
        R[at, at] = o.R[i]
    white = np.linalg.inv(np.linalg.cholesky(H @ noise @ H.T + R))
    r, errors, map_ = white @ r, white @ J[:, :p], white @ J[:, p:]
    if inputs.map is None:
        left = np.eye(len(r)) - map_ @ np.linalg.pinv(map_)
        r, errors = left @ r, left @ errors
    return errors.T @ r, errors.T @ errors


def columns(inputs, number, path, landmarks):
    """motion (N, 3, 4) and readings (M, 2, 4) of: curvature, distance, first coordinate's scale, second's offset."""
    o = inputs.observations
    way = between(path[:-1], path[1:])
    motion, readings = np.zeros((len(path), 3, 4)), np.zeros((len(o.z), 2, 4))
    motion[1:, 2, 0] = np.hypot(way[:, 0], way[:, 1])
    motion[1:, :2, 1] = way[:, :2]
    used = number >= 0
    readings[used, 0, 2] = inputs.sensor.predict(path[o.frame[used]], landmarks[number[used]])[:, 0]
    readings[:, 1, 3] = 1.0
    return motion, readings


def problem(sensor, task, P0=None, **world):
    """A small world near its solution, a third of the observations unused: the arguments of `systematic`."""
    inputs, truth, xy = circle(sensor, P0=P0, **{"frames": 25, **world})
    rng = np.random.default_rng(1)
    path = truth + rng.normal(0.0, 0.02, truth.shape)
    number = np.where(rng.random(len(inputs.observations.z)) < 0.3, -1, inputs.observations.label)
    motion, readings = columns(inputs, number, path, xy)
    motion = np.concatenate([motion, rng.normal(size=(len(path), 3, 2))], axis=2)
    readings = np.concatenate([readings, rng.normal(size=(len(number), 2, 2))], axis=2)
    return inputs if task == "localization" else inputs.without_map(), number, path, xy, motion, readings


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
@pytest.mark.parametrize("task", ["localization", "slam"])
@pytest.mark.parametrize("P0", [None, EXACT, np.diag([0.01, 0.0, 0.02])], ids=["prior", "exact", "y exact"])
def test_score_and_information_are_those_of_dense_generalized_least_squares(sensor, task, P0):
    given = problem(sensor, task, P0)
    score, information = dense(*given)
    found = systematic(*given)
    np.testing.assert_allclose(found.information, information, rtol=1e-8, atol=1e-9 * np.diag(information).max())
    np.testing.assert_allclose(found.score, score, rtol=1e-8, atol=1e-9 * np.sqrt(np.diag(information).max()))


@pytest.mark.parametrize("task", ["localization", "slam"])
def test_what_the_data_cannot_tell_has_no_information(task):
    """An increment after the last observation, an unused one; in SLAM the map may be anywhere."""
    inputs, number, path, xy, motion, readings = problem(SENSORS["relative point"], task)
    motion, readings = np.zeros((len(path), 3, 4)), np.zeros((len(number), 2, 4))
    number = np.where(inputs.observations.frame == len(path) - 1, -1, number)
    motion[-1, :, 0] = 1.0
    readings[number < 0, :, 1] = 1.0
    c, s = np.cos(path[inputs.observations.frame, 2]), np.sin(path[inputs.observations.frame, 2])
    readings[:, 0, 2], readings[:, 1, 2] = c, -s  # every landmark further east
    motion[1:, 2, 3] = 1.0
    found = systematic(inputs, number, path, xy, motion, readings)
    unknown = [0, 1] if task == "localization" else [0, 1, 2]
    assert (found.sigmas[unknown] == 0.0).all()
    assert (found.information[unknown] == 0.0).all()
    assert (np.diag(found.information)[[j for j in range(4) if j not in unknown]] > 0.0).all()


WORLD = LinearWorld(frames=20, laps=0.4, sigma_turn=1e-4)


def linear(seed, task, errors=(0.0, 0.0, 0.0, 0.0)):
    """Scores of one short drive at the true path and map (any point is as good in a linear world), errors put in."""
    log = simulate(WORLD, seed)
    inputs, path, known = log.inputs(labels=True), log.truth.pose, log.truth.landmarks
    assert isinstance(known, LandmarkMap)
    number = known.rows(log.truth.landmark_of)
    motion, readings = columns(inputs, number, path, known.xy)
    o, u = inputs.observations, inputs.increments
    inputs = replace(
        inputs,
        observations=replace(o, z=o.z + readings @ errors),
        increments=Increments(u.mean + motion @ errors, u.covariance),
    )
    inputs = inputs if task == "localization" else inputs.without_map()
    return systematic(inputs, number, path, known.xy, motion, readings)


def size_of_the_test(task, runs):
    """Share (4,) of runs in which each error is found at the 5 % level, and the p-values of (mean, spread) (4,)."""
    sigmas = np.array([linear(seed, task).sigmas for seed in range(runs)])
    total = np.sum(sigmas**2, axis=0)
    found = np.mean(np.abs(sigmas) > stats.norm.ppf(0.975), axis=0)
    return found, stats.chi2.sf(total, runs), stats.chi2.cdf(total, runs)


@pytest.mark.slow
@pytest.mark.parametrize("task", ["localization", "slam"])
def test_the_five_percent_test_rejects_five_percent(task):
    found, above, below = size_of_the_test(task, 2000)
    np.testing.assert_allclose(found, 0.05, atol=0.01)
    assert (np.minimum(above, below) > 1e-3).all()
