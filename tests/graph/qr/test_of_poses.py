"""Scores and evidence of logs with fixes and closures, against dense least squares by numeric derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from data.logs import open_log
from data.pose_measurements import MEASURED, FixKind, expected_closure, expected_fix
from data.se2 import between, pose_error, wrap_angle
from eval.compare import compare
from eval.referee import effects, residuals
from graph.qr.score_test import evidence

NAME = "mixed:2:frames=14+closure_gap=3+closure_radius=9+closure_period=2+compass_period=2+landmarks=25"


@pytest.fixture(scope="module", params=["localization", "slam"])
def solved(request):
    inputs = open_log(NAME).inputs(labels=True)
    inputs = inputs.without_map() if request.param == "slam" else inputs
    (run,) = compare(inputs, request.param, ("batch",), "known")
    return inputs, run.final.pose, residuals.used_by(run, inputs)


def white(inputs, used, state, n):
    """All whitened residuals of a state: poses (3 n), then landmarks in use; plain loops."""
    path, xy = state[: 3 * n].reshape(n, 3), used.landmarks.copy()
    if inputs.map is None:
        xy = state[3 * n :].reshape(-1, 2)

    def root(C):
        return np.linalg.inv(np.linalg.cholesky(C))

    parts = [root(inputs.prior.covariance) @ pose_error(inputs.prior.mean, path[0])]
    for k in range(1, n):
        off = inputs.increments.mean[k] - between(path[k - 1], path[k])
        off[2] = wrap_angle(off[2])
        parts.append(root(inputs.increments.covariance[k]) @ off)
    o = inputs.observations
    for i in np.flatnonzero(used.number >= 0):
        expected = inputs.sensor.predict(path[o.frame[i]], xy[used.number[i]][None])[0]
        parts.append(root(o.R[i]) @ inputs.sensor.residual(o.z[i], expected))
    f = inputs.fixes
    for i in range(len(f)):
        rows = list(MEASURED[FixKind(f.kind[i])])
        off = f.z[i][rows] - expected_fix(path[f.frame[i]], f.kind[i], f.sources[f.source[i]])[0]
        if f.kind[i] != FixKind.POSITION:
            off[-1] = wrap_angle(off[-1])
        parts.append(root(f.covariance[i][np.ix_(rows, rows)]) @ off)
    c = inputs.closures
    for i in range(len(c)):
        off = c.relative[i] - expected_closure(path[c.frame1[i]], path[c.frame2[i]])[0]
        off[2] = wrap_angle(off[2])
        parts.append(root(c.covariance[i]) @ off)
    return np.concatenate(parts)


def jacobian(function, x):
    return np.stack([(function(x + s) - function(x - s)) / 2e-6 for s in 1e-6 * np.eye(len(x))], axis=1)


def without_effect(inputs, e, size):
    """The inputs less `size` of a systematic error of a source."""
    if e.fixes is not None:
        return replace(inputs, fixes=replace(inputs.fixes, z=inputs.fixes.z - size * e.fixes))
    return replace(inputs, closures=replace(inputs.closures, relative=inputs.closures.relative - size * e.closures))


def test_the_scores_of_sources_are_those_of_dense_least_squares(solved):
    inputs, path, used = solved
    n, state = len(path), path.ravel()
    if inputs.map is None:
        state = np.concatenate([state, used.landmarks.ravel()])
    found = [e for e in effects.effects(inputs, path, used) if ":" in e.name]
    assert {e.name for e in found} == {
        *(f"position:gps/{x}" for x in ("x", "y", "lever_x", "lever_y", "latency")),
        *("heading:compass/theta", "heading:compass/latency"),
        *(f"closure:loops/{x}" for x in ("x", "y", "theta", "scale")),
    }
    J = jacobian(lambda x: white(inputs, used, x, n), state)
    r = white(inputs, used, state, n)
    by = np.stack([white(without_effect(inputs, e, 1.0), used, state, n) - r for e in found], axis=1)
    project = np.eye(len(r)) - J @ np.linalg.pinv(J, rcond=1e-13)
    score = effects.score_of(inputs, path, used, found).score
    np.testing.assert_allclose(score.information, by.T @ project @ by, rtol=1e-4, atol=1e-4 * score.information.max())
    np.testing.assert_allclose(score.score, -by.T @ project @ r, rtol=1e-3, atol=1e-3 * np.abs(score.score).max())


def test_evidence_differs_between_noises_as_that_of_dense_least_squares_does(solved):
    inputs, path, used = solved
    n, state = len(path), path.ravel()
    if inputs.map is None:
        state = np.concatenate([state, used.landmarks.ravel()])

    def dense(given):
        J, r = jacobian(lambda x: white(given, used, x, n), state), white(given, used, state, n)
        left = r - J @ np.linalg.lstsq(J, r, rcond=None)[0]
        f = given.fixes
        rows = [list(MEASURED[FixKind(k)]) for k in f.kind]
        noise = sum(np.linalg.slogdet(C[np.ix_(a, a)])[1] for C, a in zip(f.covariance, rows, strict=True))
        noise += np.linalg.slogdet(given.closures.covariance)[1].sum()
        return -0.5 * left @ left - 0.5 * np.linalg.slogdet(J.T @ J)[1] - 0.5 * noise

    def own(given):
        return evidence(given, used.number, path, used.landmarks, effects.poses_of(given, used))

    fixes, closures = inputs.fixes, inputs.closures
    for other in (
        replace(inputs, fixes=replace(fixes, covariance=4.0 * fixes.covariance)),
        replace(inputs, closures=replace(closures, covariance=0.2 * closures.covariance)),
    ):
        assert own(other) - own(inputs) == pytest.approx(dense(other) - dense(inputs), abs=2e-3)
