"""One frame can dominate the mean NEES of a log; median, and frames without a regular covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Prior
from data.logs import open_log
from eval.referee.consistency import THIN, nearly_singular, nis_bounds
from eval.referee.score import Trial, score
from eval.replay.run import compare


def test_an_exact_prior_beside_the_truth_shows_in_the_mean_and_not_in_the_median():
    log = open_log("arena:1")
    exact = replace(log, recorded=replace(log.recorded, prior=Prior(log.recorded.prior.mean, np.zeros((3, 3)))))
    row = score([Trial(exact, "localization", tuple(compare(exact.inputs(labels=True), "localization", ["ekf"])))])
    (row,) = row.metrics.to_dict("records")
    assert row["nees_pose"] > 10.0
    assert row["nees_pose_median"] == pytest.approx(2.37, abs=0.4)
    assert row["nees_left_out"] == 1  # the first: its covariance is zero


def test_a_covariance_as_thin_as_the_floor_is_left_out():
    """Seen: one frame after an exact prior, NEES 15 725, of a run whose median is 1.8."""
    floor = 1e-10
    P = np.tile(np.diag([1e-4, 2e-10, 1e-4]), (3, 1, 1))
    P[1, 1, 1] = 2.0 * THIN * floor
    P[2] = np.nan
    assert nearly_singular(P, floor).tolist() == [True, False, False]


def test_bounds_of_nis_are_those_of_chi_square_without_a_gate_and_lower_behind_one():
    assert nis_bounds(100) == pytest.approx((0.7422, 1.2956), abs=1e-4)
    lower, upper = nis_bounds(1000, (0.9535, 1.567))
    assert lower < 0.9535 < upper < 1.04
    assert nis_bounds(1000)[0] < lower + 0.06
    assert all(np.isnan(nis_bounds(0)))
