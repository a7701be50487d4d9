"""The score test beside systematic errors that were estimated: against the plain test of the corrected log."""

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import ERRORS
from data.motion.systematic import corrected_inputs, forgotten, knots
from data.se2 import between, pose_error
from data.sensors import RangeBearing
from graph.batch import smooth
from graph.qr.score_test import systematic
from tests.graph.calibrating import erring, errors_of
from tests.graph.worlds import OFF_CENTRE, SENSORS, both_tasks

H = 1e-6


def solved(task, names=ERRORS, sensor=SENSORS["relative point"]):
    """(inputs, what the batch found, row of each landmark, landmarks) of a small world whose odometry errs."""
    inputs, decisions, created, start, _ = erring(sensor, task, errors_of(names), frames=30, landmarks=5)
    found = smooth(inputs, decisions, created, start)
    xy = inputs.map.xy if task == "localization" else found.map.xy
    return inputs, found, np.where(created >= 0, created, decisions), xy


def columns(inputs, path, number, landmarks):
    """Curvature, time, and an offset of the second coordinate: motion (N, 3, 3), readings (M, 2, 3)."""
    way = between(path[:-1], path[1:])
    motion, readings = np.zeros((len(path), 3, 3)), np.zeros((len(number), 2, 3))
    motion[1:, 2, 0], motion[1:, 2, 1] = np.hypot(way[:, 0], way[:, 1]), 1.0
    readings[:, 1, 2] = 1.0
    return motion, readings


def by_differences(inputs, found, path, number, landmarks):
    """What one more sigma of every error and knot takes out of the log: columns of the corrected log. The errors act on
    what odometry and sensor would say at the solution, without noise.
    """
    systematics, names = found.systematic, inputs.systematic.names
    of, ended = knots(inputs.systematic.length, inputs.increments.mean)
    clean = corrected_inputs(inputs, systematics)
    o = inputs.observations
    clean = replace(
        clean,
        increments=replace(clean.increments, mean=np.vstack([np.zeros(3), between(path[:-1], path[1:])])),
        observations=replace(o, z=inputs.sensor.predict(path[o.frame], landmarks[number])),
    )
    erring_log = clean  # back to the log that errs: by fixed-point iteration
    for _ in range(40):
        there = corrected_inputs(erring_log, systematics)
        off = pose_error(there.increments.mean, clean.increments.mean)
        z_off = inputs.sensor.residual(there.observations.z, clean.observations.z)
        erring_log = replace(
            erring_log,
            increments=replace(erring_log.increments, mean=erring_log.increments.mean - off),
            observations=replace(o, z=erring_log.observations.z - z_off),
        )
    which = [(i, None) for i, n in enumerate(names) if n != "drift"]
    which += [(names.index("drift"), j) for j in range(len(ended) + 1)] if "drift" in names else []
    motion, readings = np.zeros((len(path), 3, len(which))), np.zeros((len(number), 2, len(which)))
    for column, (i, j) in enumerate(which):
        change = np.zeros_like(systematics.mean)
        change[:, i] = H * inputs.systematic.sigma[i] * (1.0 if j is None else of == j)
        more = corrected_inputs(erring_log, systematics._replace(mean=systematics.mean + change))
        less = corrected_inputs(erring_log, systematics._replace(mean=systematics.mean - change))
        motion[:, :, column] = -pose_error(more.increments.mean, less.increments.mean) / (2 * H)
        readings[:, :, column] = -inputs.sensor.residual(more.observations.z, less.observations.z) / (2 * H)
    q = len(which) - (len(ended) + 1 if "drift" in names else 0)
    size = [systematics.mean[-1, i] / inputs.systematic.sigma[i] for i, j in which if j is None]
    P = np.eye(q)
    if "drift" in names:
        at, K = names.index("drift"), len(ended) + 1
        size += [systematics.mean[of == j, at][-1] / inputs.systematic.sigma[at] for j in range(K)]
        L = np.zeros((K, K))  # drifts as sums of independent steps
        for j in range(K):
            stays, anew = forgotten(ended[j - 1], inputs.systematic.length) if j else (0.0, 1.0)
            L[j] = stays * L[j - 1]
            L[j, j] = np.sqrt(anew)
        P = np.block([[P, np.zeros((q, K))], [np.zeros((K, q)), L @ L.T]])
    return motion, readings, np.array(size), P


@both_tasks
@pytest.mark.parametrize(("names", "sensor"), [
    (ERRORS, SENSORS["relative point"]), (["scale", "range", "bearing"], RangeBearing(max_range=8.0, **OFF_CENTRE)),
    pytest.param(["drift"], SENSORS["relative point"], marks=pytest.mark.slow),
], ids=["all", "off centre", "drift"])  # fmt: skip
def test_estimated_errors_are_profiled_out_with_their_priors(task, names, sensor):
    """Every error and every knot as one more hypothesis of the plain test, taken out again by dense algebra."""
    inputs, found, number, xy = solved(task, names, sensor)
    path = found.trajectory.pose
    motion, readings = columns(inputs, path, number, xy)
    own_motion, own_readings, size, P = by_differences(inputs, found, path, number, xy)
    corrected = corrected_inputs(inputs, found.systematic)
    every = np.concatenate([motion, own_motion], 2), np.concatenate([readings, own_readings], 2)
    both = systematic(corrected, number, path, xy, *every)
    p = motion.shape[2]
    prior = np.linalg.inv(P)  # the slope of the cost beside that of the priors: none, at the optimum
    slope, curvature = both.score[p:] - prior @ size, both.information[p:, p:] + prior
    assert np.abs(np.linalg.solve(curvature, slope) / np.sqrt(np.diag(np.linalg.inv(curvature)))).max() < 0.05
    across = both.information[:p, p:] @ np.linalg.inv(curvature)
    score = systematic(inputs, number, path, xy, motion, readings, found.systematic)
    information = both.information[:p, :p] - across @ both.information[p:, :p]
    scale = np.sqrt(np.diag(information))
    assert np.abs((score.information - information) / np.outer(scale, scale)).max() < 1e-5
    np.testing.assert_allclose(score.score / scale, (both.score[:p] - across @ slope) / scale, atol=1e-4)


@both_tasks
def test_an_error_that_was_estimated_with_a_wide_prior_is_not_found_again(task):
    """Without the estimate the test finds the curvature; beside it nothing is left of that."""
    inputs, decisions, created, start, _ = erring(
        SENSORS["relative point"], task, errors_of(["curvature"], curvature=5.0), frames=40, seed=2
    )
    number = np.where(created >= 0, created, decisions)
    motion, readings = columns(inputs, start.pose, number, start.landmark)

    def sigmas(inputs):
        found = smooth(inputs, decisions, created, start)
        xy = inputs.map.xy if task == "localization" else found.map.xy
        return systematic(inputs, number, found.trajectory.pose, xy, motion, readings, found.systematic).sigmas

    assert abs(sigmas(replace(inputs, systematic=None))[0]) > 4.0
    assert abs(sigmas(inputs)[0]) < 1.0
