"""Where the first observation of a landmark showed a neighbour, the report says that the rest agree."""

from __future__ import annotations

import numpy as np

from eval.referee.score import Trial
from eval.report.diagnostics import naming_statements
from tests.eval.handmade import circle_log, run_with_error

RUN = {"estimator": "ekf", "association": "known", "phase": "online"}
TRIAL = Trial(circle_log(), "slam", (run_with_error(np.zeros(3)),))


def said(fp, agree, plain=0.1, by_majority=0.1):
    metrics = RUN | {"rmse_landmark_m": plain, "rmse_landmark_majority_m": by_majority}
    return naming_statements(TRIAL, [metrics], [RUN | {"tp": 1000 - fp, "fp": fp, "majority_agreement": agree}])


def test_both_shares_are_told_where_they_differ_notably():
    (text,) = said(200, 0.999)
    assert text.startswith("ekf with known: 20.0 % of the pairings are FP, yet 99.9 % of them show what most")
    assert "named by the observation that initialized it" in text
    assert not said(200, 0.98)
    assert not said(50, 1.0)


def test_both_landmark_errors_are_told_where_they_differ():
    (text,) = said(0, 1.0, 2.5, 0.12)
    assert "landmark RMSE is 2.50 m, by majority 0.120 m" in text
    assert not said(0, 1.0, 0.1, 0.102)
    assert not said(0, 1.0, float("nan"), 0.1)
