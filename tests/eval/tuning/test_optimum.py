"""Minimum and curvature of functions whose answers are known on paper."""

from __future__ import annotations

import numpy as np
import pytest

from eval.tuning import curvature, search, slope

A = np.array([[2.0, 0.6], [0.6, 1.0]])
CENTRE = np.array([0.3, -0.2])


def bowl(theta):
    """A bowl in the first and the third parameter; the second is not looked at."""
    off = theta[[0, 2]] - CENTRE
    return 0.5 * off @ A @ off


MOVING = np.array([0, 2])
AT = np.array([0.3, 77.0, -0.2])


def test_the_curvature_of_a_bowl_is_its_matrix_whatever_the_steps():
    for limit in (0.1, 1.0, 30.0):
        found = curvature(bowl, AT, MOVING, np.full(3, limit))
        np.testing.assert_allclose(found, A, rtol=1e-5)


def test_the_curvature_is_found_in_spite_of_rounding():
    found = curvature(lambda theta: round(bowl(theta), 5), AT, MOVING, np.ones(3))
    np.testing.assert_allclose(found, A, atol=0.005)


def test_the_curvature_of_a_narrow_valley_is_not_that_of_its_surroundings():
    """log cosh is a bowl of width one about its minimum, and nearly straight beyond: steps of 4 widths miss it."""
    narrow = np.array([0.0025])
    found = curvature(lambda theta: np.log(np.cosh(theta[0] / narrow[0])), np.zeros(1), np.array([0]), np.ones(1))
    assert found[0, 0] * narrow[0] ** 2 == pytest.approx(1.0, rel=0.3)


def test_the_slope_is_that_of_the_parameters_asked_for():
    theta = np.array([1.0, 5.0, 2.0])
    np.testing.assert_allclose(slope(bowl, theta, MOVING, np.full(2, 1e-3)), A @ (theta[MOVING] - CENTRE), rtol=1e-9)


def test_the_minimum_is_found_within_the_bounds_and_nothing_else_moves():
    start, scale = np.array([1.0, 5.0, 1.0]), np.array([0.1, 1.0, 10.0])
    found = search(bowl, start, MOVING, scale, np.full(3, 9.0))
    np.testing.assert_allclose(found, [0.3, 5.0, -0.2], atol=1e-3)
    bounded = search(bowl, np.array([0.0, 5.0, 0.0]), MOVING, scale, np.array([9.0, 9.0, 0.1]))
    # at the bound of the last, the first is where its own slope is none
    np.testing.assert_allclose(bounded, [0.3 - 0.6 * 0.1 / 2.0, 5.0, -0.1], atol=1e-3)
