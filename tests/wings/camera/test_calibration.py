"""K in the graph: the projection is the renderer's, the optimum that of dense least squares, and errors as stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from data.inputs import Increments
from data.log import shortened
from data.se2 import between, world_from_body
from graph.factors import UnderConstrained
from tests.wings.camera.camera_study import PRIOR, drawn, rows_of, true_camera
from wings.camera import calibration as camera
from wings.camera.calibration import EDGE, HEIGHT, Belief, Sightings, estimate_camera, project
from wings.camera.gallery import Gallery, gallery, in_camera, projections

SMALL = Gallery(duration=8.0, rate=2.0)
"""16 frames."""
EXACT = Gallery(duration=8.0, rate=2.0, sigma_v=1e-5, sigma_omega=1e-5, prior_sigma=1e-4, prior_sigma_heading=1e-4)


def small(seed=0, sigma=0.3, world=SMALL):
    log, corners, seen = drawn(seed, sigma, world)
    return log.inputs(labels=True), corners, seen, log.truth.pose


def heights(seed=0):
    """Of the pictures' edges below the camera (L, 2) m, by the world."""
    y = in_camera(SMALL, np.zeros(3), gallery(SMALL, seed).corners)[:, :, 1]
    return 0.5 * (y[:, [0, 3]] + y[:, [1, 2]])


def test_corners_project_as_the_renderer_projects_them():
    inputs, corners, _, pose = small()
    scene = gallery(SMALL, 0)
    for k in (0, 5, 11):
        for shown in projections(SMALL, scene.corners, pose[k]):
            if np.isfinite(shown.pixels).all():
                at = project(
                    inputs.sensor, pose[k], true_camera(SMALL), heights()[shown.picture], corners[shown.picture]
                )
                np.testing.assert_allclose(at[0], shown.pixels, atol=1e-8)


def test_its_jacobians_are_those_of_differences():
    inputs, corners, seen, pose = small()
    k, i = int(seen.frame[3]), int(seen.picture[3])
    at = [pose[k], true_camera(SMALL), heights()[i]]
    made = project(inputs.sensor, *at, corners[i])
    for which, step in ((0, 1e-6), (1, 1e-4), (2, 1e-6)):
        for j in range(len(at[which])):
            change = [v.copy() for v in at], [v.copy() for v in at]
            change[0][which][j] += step
            change[1][which][j] -= step
            more, less = (project(inputs.sensor, *c, corners[i])[0] for c in change)
            np.testing.assert_allclose(made[1 + which][..., j], (more - less) / (2.0 * step), atol=2e-5)


def test_without_noise_k_is_found_exactly_from_a_wrong_start():
    inputs, corners, seen, pose = small(sigma=1e-3, world=EXACT)
    before = Belief(true_camera(EXACT) + [120.0, -15.0, 20.0], 3.0 * PRIOR)
    made = estimate_camera(inputs, corners, seen, before, pose)
    np.testing.assert_allclose(made.mean, true_camera(EXACT), atol=0.2)
    assert made.residual < 1.1


def logarithm(pose):
    """Twist (3,) of a motion, gtsam's error of a pose."""
    half = 0.5 * pose[2]
    c = half / np.tan(half) if abs(half) > 1e-9 else 1.0
    return np.array([c * pose[0] + half * pose[1], c * pose[1] - half * pose[0], pose[2]])


def test_mean_and_covariance_are_those_of_dense_least_squares():
    """Oracle: scipy over poses, K and heights, with residuals written here; covariance (J'J)^-1."""
    inputs, corners, seen, pose = small(1)
    # the oracle's numerical derivatives cannot stand weights of 1e10
    increments = Increments(inputs.increments.mean, inputs.increments.covariance + 1e-6 * np.eye(3))
    inputs = replace(inputs, increments=increments)
    before = Belief(true_camera(SMALL) + [10.0, -3.0, 4.0], PRIOR)
    made = estimate_camera(inputs, corners, seen, before, pose)
    n, shown = len(pose), np.unique(seen.picture)
    start = np.concatenate([pose.ravel(), before.mean, heights(1)[shown].ravel()])
    motion, Q = inputs.increments.mean, inputs.increments.covariance
    turned = [world_from_body(m[2]).T @ C @ world_from_body(m[2]) for m, C in zip(motion, Q)]
    roots = [np.linalg.inv(np.linalg.cholesky(C)) for C in turned]
    first = np.linalg.inv(np.linalg.cholesky(inputs.prior.covariance))  # the same in x and y
    row = {int(i): r for r, i in enumerate(shown)}

    def residual(x):
        path, K, edges = x[: 3 * n].reshape(n, 3), x[3 * n : 3 * n + 3], x[3 * n + 3 :].reshape(-1, 2)
        parts = [first @ logarithm(between(inputs.prior.mean, path[0])), (K - before.mean) / before.sigma]
        parts.append(edges.ravel() / HEIGHT)
        for k in range(1, n):
            parts.append(roots[k] @ logarithm(between(motion[k], between(path[k - 1], path[k]))))
        for k, i, pixels in zip(seen.frame, seen.picture, seen.pixels):
            x_c, z_c = inputs.sensor.predict(path[k], corners[i]).T
            u, v = K[0] * x_c / z_c + K[1], K[0] * edges[row[int(i)]][EDGE] / z_c + K[2]
            parts.append((np.stack([u, v], -1) - pixels).ravel() / seen.sigma)
        return np.concatenate(parts)

    dense = least_squares(residual, start, jac="3-point", x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    P = np.linalg.inv(dense.jac.T @ dense.jac)
    at = slice(3 * n, 3 * n + 3)
    np.testing.assert_allclose(made.mean, dense.x[at], atol=1e-3)
    np.testing.assert_allclose(made.covariance, P[at, at], rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(made.pose, dense.x[: 3 * n].reshape(n, 3), atol=1e-5)
    np.testing.assert_allclose(made.pose_covariance[-1], P[3 * n - 3 : 3 * n, 3 * n - 3 : 3 * n], rtol=5e-3, atol=1e-9)
    np.testing.assert_allclose(made.heights[shown], dense.x[3 * n + 3 :].reshape(-1, 2), atol=1e-5)
    assert np.isnan(np.delete(made.heights, shown, axis=0)).all()


def test_a_search_that_does_not_end_is_said(monkeypatch):
    inputs, corners, seen, pose = small()
    monkeypatch.setattr(camera, "ENOUGH", -1.0)
    with pytest.raises(UnderConstrained, match="K: the search has not converged after 30 steps"):
        estimate_camera(inputs, corners, seen, Belief(true_camera(SMALL) + 50.0, PRIOR), pose)


def test_a_short_log_shortens_what_is_known():
    """Twice as many frames tell K better."""
    log, corners, seen = drawn(0, 0.3, SMALL)
    half = seen.frame < 8
    sigma = []
    for part, some in ((shortened(log, 8), half), (log, seen.frame >= 0)):
        part_seen = Sightings(seen.frame[some], seen.picture[some], seen.pixels[some], seen.sigma)
        before = Belief(true_camera(SMALL), PRIOR)
        made = estimate_camera(part.inputs(labels=True), corners, part_seen, before, part.truth.pose)
        sigma.append(np.sqrt(np.diag(made.covariance)))
    assert (sigma[1] < sigma[0]).all()


@pytest.mark.slow
def test_over_a_hundred_runs_errors_of_k_are_as_large_as_stated():
    nees = np.array([rows_of(seed, None)[0].nees for seed in range(100)])
    low, high = chi2.ppf([0.0005, 0.9995], 3 * 100) / 100
    assert low < nees.mean() < high
