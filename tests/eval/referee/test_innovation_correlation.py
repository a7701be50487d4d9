"""The column innovation_lag1 does not depend on the stated noise; the verdict of studies does."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from data.worlds.arena import Arena, simulate
from eval.referee.consistency import lag1, lag1_correlation
from eval.referee.score import Trial, score
from eval.replay.run import compare
from eval.studies.montecarlo import sample
from eval.studies.scenario import load_scenario

WORLD = Arena(frames=60, field_of_view=2 * math.pi, landmarks=12)


def with_stated_noise(factor):
    """A log whose stated variances, of motion and of observations, are `factor` times the true ones."""
    log = simulate(WORLD, 3)
    r = log.recorded
    increments = replace(r.increments, covariance=factor * r.increments.covariance)
    observations = replace(r.observations, R=factor * r.observations.R)
    return replace(log, recorded=replace(r, increments=increments, observations=observations))


def innovations(log, task="localization"):
    (run,) = compare(log.inputs(labels=True), task, ("ekf",), "known")
    return run, Trial(log, task, (run,))


@pytest.mark.parametrize("factor", [1e-4, 1.0, 1e4])
def test_the_column_is_a_correlation_whatever_noise_is_stated(factor):
    row = score([innovations(with_stated_noise(factor))[1]]).metrics.iloc[0]
    assert -1.0 <= row["innovation_lag1"] <= 1.0
    assert 0.0 < row["innovation_lag1_se"] < 1.0


def test_a_constant_innovation_claimed_too_small_is_fully_correlated():
    white = np.tile([30.0, -7.0], (9, 1))
    frame, number = np.arange(9), np.zeros(9, int)
    assert lag1(white, frame, number)[0] == pytest.approx((30.0**2 + 7.0**2) / 2)
    assert lag1_correlation(white, frame, number)[0] == pytest.approx(1.0)


def test_a_component_without_spread_is_left_out_and_nothing_left_is_unknown():
    frame, number = np.arange(3), np.zeros(3, int)
    flat = np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]])
    assert lag1_correlation(flat, frame, number) == pytest.approx((-1.0, math.sqrt(0.5)))
    for nothing in (0.0 * flat, flat[:0]):
        assert all(math.isnan(v) for v in lag1_correlation(nothing, frame[: len(nothing)], number[: len(nothing)]))


def test_the_verdict_of_studies_keeps_the_unit_of_the_claim():
    log = with_stated_noise(0.04)
    run, trial = innovations(log)
    assert run.flaw is None
    seen = sample(run, "online", log, load_scenario("arena")).means["whiteness"]
    assert seen == lag1(run.innovations.white, log.recorded.observations.frame, run.decisions)[0]
    assert seen != pytest.approx(score([trial]).metrics.iloc[0]["innovation_lag1"])
