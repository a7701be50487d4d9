"""The scale of the noise: a density, and learned from squares whatever their tails."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_t

from eval.replay.hindsight.constants import FREEDOM, LEAST_SCALE
from eval.replay.hindsight.noise import NoiseScale, learned, log_density, stated


def test_the_density_is_students():
    S = np.array([[0.3, 0.1], [0.1, 0.2]])
    for nu, scale in (([0.4, -1.0], 1.0), ([3.0, 0.2], 0.05)):
        d2 = float(nu @ np.linalg.solve(S, nu))
        ours = log_density(NoiseScale(scale, 1.0), d2, float(np.linalg.slogdet(S)[1]))
        assert ours == pytest.approx(multivariate_t.logpdf(nu, np.zeros(2), scale * S, df=FREEDOM))


@pytest.mark.parametrize("scale", [0.04, 1.0, 3.0])
def test_the_scale_of_students_squares_is_found(scale):
    rng = np.random.default_rng(0)
    noise = stated()
    for _ in range(3000):
        squares = scale * rng.chisquare(2, 2) / (rng.chisquare(FREEDOM, 2) / FREEDOM)
        noise = learned(noise, squares, np.ones(2))
    assert noise.scale == pytest.approx(scale, rel=0.1)


def test_a_few_slips_do_not_hide_how_well_the_rest_fits():
    rng = np.random.default_rng(1)
    noise = stated()
    for k in range(500):
        noise = learned(noise, np.array([20.0]) if k % 50 == 49 else 0.05 * rng.chisquare(2, 1), np.ones(1))
    assert noise.scale < 0.1  # their mean would be 0.25


def test_what_is_believed_to_a_share_counts_as_that_share():
    rng = np.random.default_rng(2)
    squares = rng.chisquare(2, 4)
    whole = learned(stated(), squares, np.ones(4))
    halves = learned(stated(), np.repeat(squares, 2), np.full(8, 0.5))
    assert halves.scale == pytest.approx(whole.scale)
    assert halves.weight == whole.weight == stated().weight + 4.0
    assert learned(stated(), np.empty(0), np.empty(0)) == stated()


def test_noise_free_data_do_not_make_it_vanish():
    noise = stated()
    for _ in range(5000):
        noise = learned(noise, np.zeros(1), np.ones(1))
    assert noise.scale == LEAST_SCALE
