"""Where a fit starts: costs whose minima are known on paper."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from data.worlds.arena import simulate
from eval.tuning import Model, Parameter, make_model, starting_point
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
    found = starting_point(lambda theta: away(theta, goal), model)
    np.testing.assert_allclose(found, goal, atol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "goal"), [((MOTION, BIAS), (np.log(4.0), 0.0)), ((BIAS, SENSOR), (0.0, -np.log(4.0)))]
)
def test_only_noise_that_is_fitted_is_tried(parameters, goal):
    tried = []

    def cost(theta):
        tried.append(theta.copy())
        return away(theta, np.array(goal))

    np.testing.assert_allclose(starting_point(cost, Model(INPUTS, None, parameters)), goal, atol=1e-12)
    assert len(np.unique(tried, axis=0)) == len(FACTORS)


VALLEYS = {-0.9: (4.0, 1.0), -0.5: (2.0, 16.0), 0.1: (1.0, 0.25), 0.6: (3.0, 1.0)}
"""Minima of a cost over the latency [s]: how high each is, and which factor on the motion noise suits it there."""


def test_a_fit_starts_at_the_deepest_of_several_valleys_over_the_latency_with_the_noise_that_suits_it():
    def valleys(theta):
        at = min(VALLEYS, key=lambda c: VALLEYS[c][0] + 100.0 * abs(theta[0] - c))
        height, factor = VALLEYS[at]
        return height + 100.0 * abs(theta[0] - at) + 0.01 * abs(theta[1] - np.log(factor))

    found = starting_point(valleys, Model(INPUTS, None, (LATE, MOTION)))
    np.testing.assert_allclose(found, (0.1, np.log(0.25)), atol=1e-9)


@pytest.mark.parametrize("end", [-1.0, 1.0])
def test_a_cost_that_falls_to_a_bound_of_the_latency_starts_there(end):
    found = starting_point(lambda theta: abs(theta[0] - 2.0 * end), Model(INPUTS, None, (LATE,)))
    np.testing.assert_allclose(found, [end])
