"""K in the graph: the projection is the renderer's, the optimum that of dense least squares, and errors as stated."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.optimize import least_squares
from scipy.stats import chi2

import data.logs
from data.inputs import Increments
from data.log import Log, shortened
from data.pictures import Evidence, Found
from data.se2 import Array, between, world_from_body
from eval.replay.run import compare
from graph.factors import UnderConstrained
from tests.eval.handmade import circle_log
from wings.camera import calibration as camera
from wings.camera.calibration import EDGE, HEIGHT, Belief, Sightings, estimate_camera, project
from wings.camera.command import main
from wings.camera.gallery import Gallery, gallery, in_camera, in_view, projections, simulate


def true_camera(g: Gallery) -> Array:
    return np.array([g.focal, 0.5 * (g.image_width - 1), 0.5 * (g.image_height - 1)])


USUAL, HALF = Gallery(), Gallery(duration=30.0, rate=3.0)  # The rendered world, and half its loop in 90 frames


def drawn(seed: int, sigma: float = 0.3, g: Gallery = USUAL) -> tuple[Log, Array, Sightings]:
    """A log without images, the pictures' corners in the plan, and their pixels with noise."""
    scene, rng = gallery(g, seed), np.random.default_rng([seed, 1])
    rows = [(k, s.picture, s.pixels) for k, pose in enumerate(scene.pose) for s in in_view(g, scene.corners, pose)]
    pixels = np.array([row[2] for row in rows])
    frame, picture = (np.array([row[i] for row in rows], np.int64) for i in (0, 1))
    noisy = pixels + sigma * rng.standard_normal(pixels.shape)
    return simulate(g, seed), scene.setup.corners, Sightings(frame, picture, noisy, sigma)


PRIOR = np.array([80.0, 20.0, 20.0])  # px, standard deviations of f, c_u and c_v
SMALL = Gallery(duration=8.0, rate=2.0)  # 16 frames
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
    nees, truth = [], true_camera(USUAL)
    for seed in range(100):
        log, corners, seen = drawn(seed, g=HALF)
        inputs = log.inputs(labels=True)
        (ekf,) = compare(inputs, "localization", ("ekf",), "known")
        before = Belief(truth + PRIOR * np.random.default_rng([seed, 2]).standard_normal(3), PRIOR)
        made = estimate_camera(inputs, corners, seen, before, ekf.trajectory("online").pose)
        nees.append((made.mean - truth) @ np.linalg.solve(made.covariance, made.mean - truth))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * 100) / 100
    assert low < np.mean(nees) < high


BRIEF = Gallery(duration=20.0, rate=2.0)


def recorded(some: slice = slice(None)) -> Log:
    """A log with drawn pixels as what was found in images of 640 x 480."""
    log, _, seen = drawn(0, 0.2, BRIEF)
    setup, n, D = gallery(BRIEF, 0).setup, len(log.recorded), len(seen.frame[some])
    content = io.BytesIO()
    Image.new("RGB", (640, 480)).save(content, "PNG")
    found = Found(
        log.recorded.time, np.zeros(n), np.zeros(n), seen.frame[some], seen.picture[some], np.full(D, 50),
        seen.pixels[some], np.full((D, 4, 3), np.nan), ({},) * 8, ((0, content.getvalue()),), 554.0, 0.1, 0.01,
    )  # fmt: skip
    return replace(log, evidence=Evidence(setup, found))


@pytest.fixture
def opened(monkeypatch):
    def install(log: Log) -> None:
        monkeypatch.setattr(data.logs, "open_log", lambda name, reading, say: log)

    return install


def test_focal_length_and_centre_are_printed_with_three_sigma_beside_prior_and_a_truth_if_there_is_one(opened, capsys):
    opened(recorded())
    assert main(["visual:0"]) == 0
    out = capsys.readouterr().out
    truth = true_camera(BRIEF)
    for name, true, prior in zip(("focal length", "centre u", "centre v"), truth, ("640.0", "319.5", "239.5")):
        value, sigma, said, rendered = re.search(
            rf"{name} +([\d.]+) ± ([\d.]+) px \(prior ([\d.]+) ± \d+, rendered with ([\d.]+)\)", out
        ).groups()
        assert said == prior
        assert float(rendered) == pytest.approx(true, abs=0.006)
        assert abs(float(value) - true) < 1.5 * float(sigma)
        assert float(sigma) < 40.0
    assert "the stereo points imply a focal length of 554.00 px" in out
    assert float(re.search(r"residuals: RMS ([\d.]+) of", out)[1]) == pytest.approx(1.0, abs=0.15)
    assert float(re.search(r"NEES of K: ([\d.]+)", out)[1]) < 16.3
    assert float(re.search(r"position RMSE .*: ([\d.]+) m", out)[1]) < 0.05
    assert main(["my_lab", "--pixel-sigma", "0.4"]) == 0
    out = capsys.readouterr().out
    assert "rendered with" not in out
    assert "NEES" not in out
    assert float(re.search(r"residuals: RMS ([\d.]+) of", out)[1]) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(("log", "words", "said"), [
    (circle_log(), [], "has no images; visual:SEED and folders of the visual lab have"),
    (None, [], "no picture was found in any image"),
    (circle_log(), ["--pixel-sigma", "0"], "--pixel-sigma 0: a number from 0.001 to 100"),
    (circle_log(), ["--pixel-sigma", "much"], "--pixel-sigma much: a number from 0.001 to 100"),
])  # fmt: skip
def test_what_it_cannot_do_is_said_in_a_line(log, words, said, opened, refused):
    opened(log or recorded(slice(0)))
    assert said in refused(main, ["visual:0", *words])
