"""Intervals of one log: the stationary bootstrap against its law, against `arch`, and where it must not speak."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy import signal

from eval.referee.intervals import (
    MIN_FRAMES,
    REPLICATES,
    block_length,
    independent_frames,
    intervals,
    resampled_means,
)


def rng(seed=0):
    return np.random.default_rng(seed)


def correlated(coefficient, frames, series, seed):
    """Stationary AR(1) series (series, frames) of variance 1."""
    burn = 300 if coefficient <= 0.95 else 3000
    noise = rng(seed).standard_normal((series, burn + frames)) * math.sqrt(1.0 - coefficient**2)
    return signal.lfilter([1.0], [1.0, -coefficient], noise, axis=1)[:, burn:]


def squares(coefficient, frames, series, seed):
    """Squared distances (series, frames), mean 2, of two such coordinates."""
    x = correlated(coefficient, frames, 2 * series, seed)
    return x[:series] ** 2 + x[series:] ** 2


@pytest.mark.parametrize("block", [1.0, 4.0, 25.0])
def test_resampled_means_scatter_as_the_stationary_bootstrap_does(block):
    """Politis & Romano 1994, lemma 1: n var = R(0) + 2 sum (1 - i/n)(1 - p)^i R(i), R the log's circular covariance."""
    x = squares(0.8, 200, 1, 2)[0]
    n, centred = len(x), x - x.mean()
    i = np.arange(1, n)
    R = np.array([centred @ np.roll(centred, k) / n for k in range(n)])
    variance = (R[0] + 2.0 * np.sum((1.0 - i / n) * (1.0 - 1.0 / block) ** i * R[1:])) / n
    means = resampled_means(x[:, None], block, rng(3), 20_000)[:, 0]
    assert means.mean() == pytest.approx(x.mean(), abs=4.0 * math.sqrt(variance / 20_000))
    assert means.var() == pytest.approx(variance, rel=0.05)  # its standard error is 1 %


@pytest.mark.parametrize("frames", [50, 101, 1000, 5000])
@pytest.mark.parametrize("coefficient", [-0.5, 0.0, 0.3, 0.9, 0.999])
def test_the_block_length_is_that_of_arch(coefficient, frames):
    from arch.bootstrap import optimal_block_length

    for x in (*squares(coefficient, frames, 3, 13), np.sin(0.3 * np.arange(frames)), np.arange(frames) % 7.0):
        theirs = float(optimal_block_length(x)["stationary"].iloc[0])
        assert block_length(x) == pytest.approx(max(1.0, theirs), rel=1e-12)


def test_without_correlation_the_interval_is_the_classical_one():
    d2, nees = rng(7).chisquare(2, 2000), rng(8).chisquare(3, 2000)
    rmse, mean = intervals(d2, nees, rng(9))
    half = 1.96 * nees.std(ddof=1) / math.sqrt(2000)
    assert (mean.lower, mean.upper) == pytest.approx((nees.mean() - half, nees.mean() + half), abs=0.15 * half)
    half = 1.96 * d2.std(ddof=1) / math.sqrt(2000) / (2.0 * rmse.value)  # of a root: by its slope
    assert (rmse.lower, rmse.upper) == pytest.approx((rmse.value - half, rmse.value + half), abs=0.15 * half)
    assert rmse.value == pytest.approx(math.sqrt(d2.mean()))
    assert rmse.block < 5.0


def test_a_log_is_worth_as_many_frames_as_theory_says():
    """For AR(1) squares, whose correlation is the coefficient's square: n (1 - a)/(1 + a)."""
    worth = [independent_frames(x) for x in squares(0.8, 2000, 40, 3)]
    assert np.mean(worth) == pytest.approx(2000 * (1.0 - 0.64) / (1.0 + 0.64), rel=0.1)
    assert independent_frames(squares(0.0, 2001, 1, 4)[0]) > 1600.0


def test_frames_without_truth_are_left_out():
    x = squares(0.5, 400, 1, 6)[0]
    gaps = np.insert(x, [0, 50, 50, 399], np.nan)
    assert intervals(gaps, gaps, rng()) == intervals(x, x, rng())


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (np.full(200, np.nan), "no frame has a true pose"),
        (
            rng().chisquare(2, MIN_FRAMES - 1),
            f"{MIN_FRAMES - 1} frames with truth are too few, {MIN_FRAMES} are needed",
        ),
        (np.full(200, 0.3), "do not vary"),
        (np.linspace(0.0, 1.0, 200) ** 2, "worth about . independent ones, 20 are needed"),
        (squares(0.99, 200, 1, 7)[0], "independent ones"),
    ],
    ids=["no truth", "short", "constant", "drift", "correlated"],
)
def test_a_missing_interval_has_a_reason(values, why):
    for found in intervals(values, values, rng()):
        assert re.search(why, found.why)
        assert math.isnan(found.lower)
        assert math.isnan(found.upper)
        assert found.value == pytest.approx(np.sqrt(values.mean()), nan_ok=True) or found.value == values.mean()


def test_a_run_without_nees_still_has_an_interval_of_its_rmse():
    x = squares(0.5, 400, 1, 8)[0]
    rmse, nees = intervals(x, np.full(400, np.nan), rng())
    assert rmse.lower < rmse.value < rmse.upper
    assert nees.why
    assert math.isnan(nees.value)


def test_both_intervals_have_the_longer_block():
    smooth, white, drift = squares(0.9, 1000, 1, 1)[0], squares(0.0, 1000, 1, 2)[0], np.linspace(0.0, 1.0, 1000)
    for pair in ((smooth, white), (white, smooth)):
        assert [i.block for i in intervals(*pair, rng())] == [block_length(smooth)] * 2
    refused, given = intervals(drift, white, rng())
    assert refused.why
    assert given.block == block_length(white) < refused.block


def test_what_two_runs_share_cancels_in_their_difference():
    common = squares(0.9, 1000, 1, 9)[0]
    own = 0.05 * rng(10).standard_normal(1000)
    a, b = common + 0.1 + own, common
    paired, _ = intervals((a, b), (a, b), rng())
    alone, _ = intervals(a, a, rng())
    assert paired.value == pytest.approx(math.sqrt(a.mean()) - math.sqrt(b.mean()))
    assert 0.0 < paired.lower < paired.value < paired.upper
    assert paired.upper - paired.lower < 0.2 * (alone.upper - alone.lower)
    assert paired.p == 1.0 / (1 + REPLICATES)
