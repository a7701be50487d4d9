"""Odometry becomes increments: exact arcs, smooth through omega = 0, and a noise total that no cut changes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from data import se2
from data.motion.velocity import ARC, HALF_ANGLE, VelocityModel, VelocityNoise, preintegrate, sinc, sinc_slope, step
from tests.quick import examples

NOISELESS = VelocityModel(VelocityNoise("density"))


def fine_integration(v, omega, duration, pieces=200_000):
    """Midpoint rule in tiny steps: knows nothing of arcs."""
    dt = duration / pieces
    middle = omega * dt * (np.arange(pieces) + 0.5)
    return np.array([(v * np.cos(middle)).sum() * dt, (v * np.sin(middle)).sum() * dt, omega * duration])


@pytest.mark.parametrize("omega", [0.0, 1e-9, -1e-9, 1e-5, 3e-2, -0.2, 1.3, -3.0])
def test_arc_equals_fine_integration(omega):
    mean, G = np.zeros(3), np.zeros((3, 2))
    step(ARC, 0.8 * 1.5, omega * 1.5, mean, G)
    assert np.abs(mean - fine_integration(0.8, omega, 1.5)).max() < 1e-9


@pytest.mark.parametrize("model", [ARC, HALF_ANGLE])
@pytest.mark.parametrize("rotation", [0.0, 1e-9, -1e-9, 1e-5, 0.0999, 0.1001, -0.7, 3.0])
def test_jacobian_of_the_arc_meets_central_differences(model, rotation):
    def increment(u):
        mean, G = np.zeros(3), np.zeros((3, 2))
        step(model, u[0], u[1], mean, G)
        return mean

    mean, G = np.zeros(3), np.zeros((3, 2))
    step(model, 0.7, rotation, mean, G)
    h = 1e-6
    for i in range(2):
        d = np.eye(2)[i] * h
        numeric = (increment(np.array([0.7, rotation]) + d) - increment(np.array([0.7, rotation]) - d)) / (2 * h)
        assert np.abs(G[:, i] - numeric).max() < 1e-9


@pytest.mark.parametrize("edge", [1e-4, 0.1])
def test_series_and_closed_form_meet_where_they_change_over(edge):
    below, above = np.nextafter(edge, 0.0), np.nextafter(edge, 1.0)
    assert abs(sinc(below) - sinc(above)) < 1e-15
    assert abs(sinc_slope(below) - sinc_slope(above)) < 1e-13


@pytest.mark.parametrize("alphas", [(0.2, 0.03, 0.09, 0.08), (0.2, 0.03, 0.09, 0.08, 0.5, 0.7)])
@pytest.mark.parametrize(("v", "omega"), [(0.8, 0.0), (0.8, 1e-7), (-0.5, 0.4), (0.0, -1.3), (1.2, 3.0)])
def test_textbook_noise_is_that_of_the_velocities_and_of_a_final_rotation(alphas, v, omega):
    dt = 0.4

    def moved(u):  # Probabilistic Robotics, Table 5.3, without drawing anything
        return fine_integration(u[0], u[1], dt, 20_000) + np.array([0.0, 0.0, u[2] * dt])

    u, h = np.array([v, omega, 0.0]), 1e-4
    J = np.column_stack([(moved(u + d) - moved(u - d)) / (2.0 * h) for d in h * np.eye(3)])
    a = np.array([*alphas, 0.0, 0.0])[:6]
    M = np.diag([a[0] * v**2 + a[1] * omega**2, a[2] * v**2 + a[3] * omega**2, a[4] * v**2 + a[5] * omega**2])
    model = VelocityModel(VelocityNoise("textbook", alphas=alphas))
    increments, _ = preintegrate(model, np.array([0.0, dt]), np.full(2, v), np.full(2, omega), np.array([0.0, dt]))
    assert np.abs(increments.mean[1] - moved(u)).max() < 1e-9
    assert np.abs(increments.covariance[1] - J @ M @ J.T).max() < 1e-9
    twice = preintegrate(model.scaled(2.0), np.array([0.0, dt]), np.full(2, v), np.full(2, omega), np.array([0.0, dt]))
    assert np.allclose(twice[0].covariance[1], 4.0 * increments.covariance[1], rtol=1e-12)


@pytest.mark.parametrize(("kind", "count"), [("displacement", 6), ("textbook", 5), ("textbook", 2), ("velocity", 6)])
def test_a_number_of_alphas_that_means_nothing_is_refused(kind, count):
    with pytest.raises(ValueError, match="alphas do not go with"):
        VelocityNoise(kind, alphas=(0.1,) * count)


def test_each_number_of_a_noise_is_scaled_by_itself():
    sigmas = VelocityModel(VelocityNoise("density", (0.25, 0.5))).scaled(2.0).noise
    assert (sigmas.sigma, sigmas.alphas) == ((0.5, 1.0), (0.0, 0.0, 0.0, 0.0))
    alphas = VelocityNoise("displacement", alphas=(0.125, 0.25, 0.5, 1.0))
    assert VelocityModel(alphas).scaled(2.0).noise.alphas == (0.25, 0.5, 1.0, 2.0)
    assert VelocityModel(replace(alphas, kind="textbook")).scaled(2.0).noise.alphas == (0.5, 1.0, 2.0, 4.0)


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 30))
def test_preintegration_equals_predicting_sample_by_sample(seed, cuts):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.01, 0.2, 40))
    v, omega = rng.normal(size=40), rng.normal(size=40) * (rng.random(40) > 0.5)
    model = VelocityModel(VelocityNoise("density", (0.1, 0.05)))
    coarse, _ = preintegrate(model, time, v, omega, time[[0, -1]])
    fine, _ = preintegrate(model, time, v, omega, time)
    at = np.sort(np.concatenate([time[[0, -1]], rng.uniform(time[0], time[-1], cuts)]))
    some, _ = preintegrate(model, time, v, omega, np.unique(at))
    for parts in (fine, some):
        pose, P = np.zeros(3), np.zeros((3, 3))
        for u, M in zip(parts.mean[1:], parts.covariance[1:], strict=True):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            F = np.array([[1, 0, -s * u[0] - c * u[1]], [0, 1, c * u[0] - s * u[1]], [0, 0, 1]])
            B = se2.world_from_body(pose[2])
            P = F @ P @ F.T + B @ M @ B.T
            pose = pose + B @ u
        assert np.abs(pose - coarse.mean[1]).max() < 1e-12
        if parts is fine:
            assert np.abs(P - coarse.covariance[1]).max() < 1e-14


def test_no_odometry_for_a_while_lets_the_covariance_grow_and_the_robot_stand():
    time, v = np.array([0.0, 0.5, 5.0, 5.5]), np.array([1.0, 1.0, 1.0, 1.0])
    increments, gaps = preintegrate(NOISELESS, time, v, 0.1 * v, np.array([0.0, 0.5, 5.0, 5.5]))
    assert gaps == 1
    assert increments.mean[2, 0] == pytest.approx(np.sin(0.1) / 0.1)  # held for 1 s, then standing still
    assert increments.covariance[2, 0, 0] == pytest.approx(
        3.5**2, rel=0.05
    )  # up to 1 m/s for the 3.5 s that are missing
    assert not increments.covariance[1].any()
    late, gaps = preintegrate(NOISELESS, time + 3.0, v, v, np.array([1.0, 3.0, 3.5]))
    assert gaps == 1
    assert late.mean[1].tolist() == [0, 0, 0]
    assert late.covariance[1, 0, 0] == pytest.approx(4.0)


def test_equal_stamps_are_commands_overwritten_at_once():
    time, v = np.array([0.0, 1.0, 1.0, 1.5]), np.array([1.0, 50.0, 2.0, 0.0])
    increments, _ = preintegrate(
        VelocityModel(VelocityNoise("displacement", alphas=(1, 0, 0, 1))), time, v, 0 * v, np.array([0.0, 1.5])
    )
    assert increments.mean[1, 0] == pytest.approx(1.0 + 1.0)
    assert increments.covariance[1, 0, 0] == pytest.approx(1.0 + 4.0)


def test_unknown_model_or_noise_or_negative_parameter_is_refused():
    with pytest.raises(ValueError, match="known: velocity, displacement, density"):
        VelocityNoise("gaussian")
    with pytest.raises(ValueError, match="known: unicycle, half_angle"):
        VelocityModel(VelocityNoise("density"), "bicycle")
    with pytest.raises(ValueError, match="negative"):
        VelocityNoise("density", (-1.0, 0.0))
