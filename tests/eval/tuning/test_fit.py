"""A fit starts where costs are least and finds noise, biases and scales put into logs, with honest standard errors."""

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Increments
from data.motion.velocity import VelocityModel, VelocityNoise
from data.worlds.arena import simulate
from eval import tuning
from tests.eval.tuning.stamped import SMALL, by_name, changed
from tests.quick import slow

NOISE = ("motion", "sensor")
TRUE_AT_ZERO = ("motion_lateral", "bias_range", "bias_bearing", "odometry_v", "odometry_omega")


def fitted(log, groups=NOISE, slam=False):
    inputs = log.inputs(labels=True)
    if slam:
        inputs = inputs.without_map()
    model, decisions = tuning.make_model(inputs, None, groups), tuning.pairings(inputs)
    return model, decisions, tuning.fit(model, decisions)


@pytest.mark.parametrize(("seed", "wrong", "slam"), [
    slow(0, 2.0, False), (3, 0.5, True), slow(1, 2.0, True), slow(2, 0.5, False),
])  # fmt: skip
def test_sigmas_stated_wrong_by_a_factor_of_two_are_recovered_within_three_standard_errors(seed, wrong, slam):
    model, decisions, found = fitted(changed(simulate(SMALL, seed), noise=wrong), slam=slam)
    for name, theta, error in zip(by_name(model, found.theta), found.theta, found.error):
        true = 0.0 if name in TRUE_AT_ZERO else -np.log(wrong)
        if np.isfinite(error):
            assert abs(theta - true) < 3.0 * error, name
    error = by_name(model, found.error)
    assert error["sigma_range"] < 0.05
    assert error["sigma_bearing"] < 0.05
    assert error["motion_along"] < 0.3
    before = tuning.score(model.inputs, decisions)
    after = tuning.score(tuning.apply(model, found.theta), decisions)
    assert not 0.4 < before.nis < 2.5
    assert after.lower < after.nis < after.upper
    assert after.log_likelihood - before.log_likelihood == pytest.approx(found.gain, abs=1e-6)


def test_a_bearing_bias_and_an_odometry_scale_are_found():
    log = changed(simulate(SMALL, 0), bias=(0.15, 0.03), scale=(1.05, 0.96))
    model, _, found = fitted(log, ("bias", "odometry"))
    value = by_name(model, [p.value(t) for p, t in zip(model.parameters, found.theta)])
    error = by_name(model, found.error)
    assert value["bias_range"] == pytest.approx(0.15, abs=3.0 * error["bias_range"])
    assert value["bias_bearing"] == pytest.approx(0.03, abs=3.0 * error["bias_bearing"])
    assert value["odometry_v"] == pytest.approx(1.0 / 1.05, abs=3.0 * error["odometry_v"])
    assert value["odometry_omega"] == pytest.approx(1.0 / 0.96, abs=3.0 * error["odometry_omega"])
    assert error["bias_range"] < 0.02
    assert error["bias_bearing"] < 0.005
    assert max(error["odometry_v"], error["odometry_omega"]) < 0.015


@pytest.mark.slow
def test_standard_errors_are_as_large_as_the_errors_are():
    squares = []
    for seed in range(30):
        model, _, found = fitted(changed(simulate(SMALL, seed), noise=2.0), (*NOISE, "bias", "odometry"))
        true = np.array([0.0 if p.name in TRUE_AT_ZERO else -np.log(2.0) for p in model.parameters])
        squares.append(((found.theta - true) / found.error) ** 2)
    mean = np.nanmean(squares, axis=0)  # of about 30 chi-square values: 1 with a standard error of 0.26
    assert (mean < 1.8).all()
    assert (mean > 0.4).all()


def test_factors_multiply_standard_deviations_and_biases_are_taken_off():
    inputs = simulate(SMALL, 0).inputs(labels=True)
    model = tuning.make_model(inputs, None, tuning.GROUPS)
    values = {"sigma_range": 3.0, "bias_bearing": 0.1, "motion_along": 2.0, "motion_heading": 5.0, "range_growth": 0.5}
    new = tuning.apply(model, tuning.vector(model, values))
    o, z = new.observations, inputs.observations.z
    assert o.R[:, 0, 0] == pytest.approx(9.0 * 0.1**2 * z[:, 0])
    assert o.R[:, 1, 1] == pytest.approx(0.02**2)
    assert np.cos(o.z[:, 1] - z[:, 1] + 0.1) == pytest.approx(1.0)
    ratio = new.increments.covariance[1:] / inputs.increments.covariance[1:]
    assert ratio == pytest.approx(np.tile(np.outer([2.0, 5.0, 5.0], [2.0, 5.0, 5.0]), (len(ratio), 1, 1)), rel=1e-6)


STRAIGHT = np.arange(0.0, 4.0)
"""s. A robot that drives 2 m straight ahead in each second and is seen once in each."""


def recorded(noise, omega=0.0):
    """A model of a log whose odometry was recorded, at 2 m/s and `omega`, with every group of parameters."""
    inputs = simulate(replace(SMALL, frames=len(STRAIGHT)), 0).inputs(labels=True)
    n = np.ones(len(STRAIGHT))
    odometry = tuning.Odometry(STRAIGHT, 2.0 * n, omega * n, VelocityModel(noise))
    return tuning.make_model(replace(inputs, time=STRAIGHT), odometry, tuning.GROUPS)


@pytest.mark.parametrize(("v", "omega"), [(1.0, 1.0), (3.0, 1.0), (1.0, 5.0), (0.5, 0.25)])
def test_factors_on_recorded_odometry_multiply_the_noise_of_velocity_and_of_turn_rate(v, omega):
    model = recorded(VelocityNoise("density", (0.1, 0.02)))
    new = tuning.apply(model, tuning.vector(model, {"motion_v": v, "motion_omega": omega}))
    # in a second: 0.1 m along and 0.02 rad of heading; of what it turns on the way half shows sideways
    assert np.sqrt(new.increments.covariance[1:, 0, 0]) == pytest.approx(0.1 * v)
    assert np.sqrt(new.increments.covariance[1:, 2, 2]) == pytest.approx(0.02 * omega)
    assert new.increments.covariance[1:, 1, 2] == pytest.approx(1.0 * (0.02 * omega) ** 2)
    assert new.increments.mean[1:] == pytest.approx(np.tile([2.0, 0.0, 0.0], (3, 1)))


def test_factors_on_alphas_multiply_what_each_of_them_adds():
    """In a second, at 2 m/s and 0.5 rad/s: 4 alpha1 + alpha2 / 4 along, and 4 alpha3 + alpha4 / 4 of heading."""
    model = recorded(VelocityNoise("textbook", (0.0, 0.0), (0.01, 0.02, 0.03, 0.04)), omega=0.5)
    motion = [p.name for p in model.parameters if p.name.startswith("motion")]
    assert motion == ["motion_alpha1", "motion_alpha2", "motion_alpha3", "motion_alpha4"]
    values = {"motion_alpha1": 100.0, "motion_alpha2": 100.0, "motion_alpha3": 5.0, "motion_alpha4": 7.0}
    new = tuning.apply(model, tuning.vector(model, values)).increments.covariance
    assert new[1:, 2, 2] == pytest.approx(5.0 * 0.03 * 4.0 + 7.0 * 0.04 * 0.25)
    model = recorded(VelocityNoise("textbook", (0.0, 0.0), (0.01, 0.02, 0.0, 0.0)), omega=0.5)
    stated = tuning.apply(model, np.zeros(len(model))).increments.covariance
    new = tuning.apply(model, tuning.vector(model, {"motion_alpha1": 3.0, "motion_alpha2": 7.0})).increments.covariance
    assert stated[1:, 0, 0].min() > 0.0
    assert new == pytest.approx(stated * (3.0 * 0.04 + 7.0 * 0.005) / 0.045)


def test_what_a_log_does_not_determine_stays_as_stated():
    log = simulate(replace(SMALL, frames=30), 0)
    r = log.recorded
    D = np.diag([1.0, 0.0, 0.0])
    log = replace(log, recorded=replace(r, increments=Increments(r.increments.mean, D @ r.increments.covariance @ D)))
    model, _, found = fitted(log, ("motion",))
    status, theta = by_name(model, found.status), by_name(model, found.theta)
    assert status["motion_heading"] == status["motion_lateral"] == tuning.HELD
    assert theta["motion_heading"] == theta["motion_lateral"] == 0.0
    assert status["motion_along"] in (tuning.FITTED, tuning.AT_BOUND)


def test_what_a_short_log_cannot_tell_goes_back_to_what_it_states():
    _, _, found = fitted(simulate(replace(SMALL, frames=6), 2), ("motion",))
    assert tuning.HELD in found.status
    for theta, error, word in zip(found.theta, found.error, found.status):
        assert np.isfinite(error) == (word == tuning.FITTED)
        assert (theta == 0.0) == (word == tuning.HELD)


INPUTS = simulate(SMALL, 0).inputs(labels=True)
LATE = tuning.Parameter("latency", "s", 1.0, 0.2, "")
MOTION = tuning.Parameter("motion_v", "", 7.0, 1.0, "")


VALLEYS = {-0.9: (4.0, 1.0), -0.5: (2.0, 16.0), 0.1: (1.0, 0.25), 0.6: (3.0, 1.0)}
"""Minima of a cost over the latency [s]: how high each is, and which factor on the motion noise suits it there."""


def test_a_fit_starts_at_the_deepest_of_several_valleys_over_the_latency_with_the_noise_that_suits_it():
    def valleys(theta):
        at = min(VALLEYS, key=lambda c: VALLEYS[c][0] + 100.0 * abs(theta[0] - c))
        height, factor = VALLEYS[at]
        return height + 100.0 * abs(theta[0] - at) + 0.01 * abs(theta[1] - np.log(factor))

    found = tuning.starting_point(valleys, tuning.Model(INPUTS, None, (LATE, MOTION)))
    np.testing.assert_allclose(found, (0.1, np.log(0.25)), atol=1e-9)


@pytest.mark.parametrize("end", [-1.0, 1.0])
def test_a_cost_that_falls_to_a_bound_of_the_latency_starts_there(end):
    found = tuning.starting_point(lambda theta: abs(theta[0] - 2.0 * end), tuning.Model(INPUTS, None, (LATE,)))
    np.testing.assert_allclose(found, [end])
