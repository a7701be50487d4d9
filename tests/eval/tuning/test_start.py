"""Where a fit starts: costs whose minima are known on paper."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from data.worlds.arena import simulate
from eval.tuning import Model, Parameter, make_model, starting_points
from tests.eval.tuning.stated import SMALL

INPUTS = simulate(SMALL, 0).inputs(labels=True)
FACTORS = (1 / 16, 1 / 4, 1.0, 4.0, 16.0)
LATE = Parameter("latency", "s", 1.0, 0.2, "")
MOTION, SENSOR, BIAS = (Parameter(name, "", 7.0, 1.0, "") for name in ("motion_v", "sigma_range", "bias_range"))


def away(theta, goal):
    """Distance from a goal in every parameter alike."""
    return float(np.abs(np.asarray(theta) - goal).sum())


@pytest.mark.parametrize(("motion", "sensor"), list(product(FACTORS, FACTORS)))
def test_motion_and_readings_start_at_the_factors_that_suit_both(motion, sensor):
    model = make_model(INPUTS, None, ("motion", "sensor", "bias"))
    names = [p.name for p in model.parameters]
    goal = np.zeros(len(names))
    goal[[names.index(n) for n in ("motion_along", "motion_heading")]] = np.log(motion)
    goal[[names.index(n) for n in ("sigma_range", "sigma_bearing")]] = np.log(sensor)
    (found,) = starting_points(lambda theta: away(theta, goal), model)
    np.testing.assert_allclose(found, goal, atol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "goal"), [((MOTION, BIAS), (np.log(4.0), 0.0)), ((BIAS, SENSOR), (0.0, -np.log(4.0)))]
)
def test_only_noise_that_is_fitted_is_tried(parameters, goal):
    tried = []

    def cost(theta):
        tried.append(theta.copy())
        return away(theta, np.array(goal))

    (found,) = starting_points(cost, Model(INPUTS, None, parameters))
    np.testing.assert_allclose(found, goal, atol=1e-12)
    assert len(np.unique(tried, axis=0)) == len(FACTORS)


VALLEYS = {-0.9: (4.0, 1.0), -0.5: (2.0, 16.0), 0.1: (1.0, 0.25), 0.6: (3.0, 1.0)}
"""Minima of a cost over the latency [s]: how high each is, and which factor on the motion noise suits it there."""


def valleys(theta):
    """Straight slopes down to every minimum; the noise is of less weight."""
    latency, motion = theta
    at = min(VALLEYS, key=lambda c: VALLEYS[c][0] + 100.0 * abs(latency - c))
    height, factor = VALLEYS[at]
    return height + 100.0 * abs(latency - at) + 0.01 * abs(motion - np.log(factor))


def test_a_fit_starts_from_the_three_best_minima_over_the_latency_each_with_the_noise_that_suits_it():
    found = starting_points(valleys, Model(INPUTS, None, (LATE, MOTION)))
    expected = [(0.1, np.log(0.25)), (-0.5, np.log(16.0)), (0.6, 0.0)]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_starts_are_in_the_order_of_what_they_cost_with_their_own_noise():
    """With the noise of the beginning the one at 0.5 s costs less by 0.5; the other gains 1 by its own noise."""

    def cost(theta):
        latency, motion = theta
        if latency > 0.0:
            return 1.0 + 100.0 * abs(latency - 0.5)
        return 1.5 + 100.0 * abs(latency + 0.5) - 1.0 * (latency < -0.4) * (abs(motion - np.log(4.0)) < 0.1)

    found = starting_points(cost, Model(INPUTS, None, (LATE, MOTION)))
    assert [round(float(theta[0]), 6) for theta in found] == [-0.5, 0.5]
    assert found[0][1] == pytest.approx(np.log(4.0))


@pytest.mark.parametrize("end", [-1.0, 1.0])
def test_a_cost_that_falls_to_a_bound_of_the_latency_starts_there(end):
    found = starting_points(lambda theta: abs(theta[0] - 2.0 * end), Model(INPUTS, None, (LATE,)))
    np.testing.assert_allclose(found, [[end]])


def test_latencies_are_tried_every_twentieth_of_a_second_and_a_level_bottom_is_one_start():
    tried = []

    def cost(theta):
        tried.append(float(theta[0]))
        return max(0.0, abs(theta[0] - 0.2) - 0.12)

    found = starting_points(cost, Model(INPUTS, None, (LATE,)))
    assert len(found) == 1
    assert abs(found[0][0] - 0.2) < 0.12
    np.testing.assert_allclose(np.unique(np.round(tried, 9)), 0.05 * np.arange(-20, 21), atol=1e-9)
