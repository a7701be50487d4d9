"""Landmarks with the true id of a neighbour, whose other observations agree."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from eval.referee.diagnostics import naming
from tests.eval.handmade import run_with_error

RUN = {"log": "circle", "task": "slam", "estimator": "ekf", "association": "known", "phase": "online"}


def said(fp, agree, plain=0.1, by_majority=0.1):
    metrics = RUN | {"rmse_landmark_m": plain, "rmse_landmark_majority_m": by_majority}
    decided = RUN | {"tp": 1000 - fp, "fp": fp, "majority_agreement": agree}
    scores = SimpleNamespace(metrics=pd.DataFrame([metrics]), association=pd.DataFrame([decided]))
    return naming(run_with_error(np.zeros(3)), scores, "circle")


def test_both_shares_are_reported_where_they_differ():
    found = said(200, 0.999).named
    assert (found["false_share"], found["agree"], found["rmse"]) == (pytest.approx(0.2), 0.999, None)
    assert said(200, 0.98) is None
    assert said(50, 1.0) is None


def test_both_landmark_errors_are_reported_where_they_differ():
    found = said(0, 1.0, 2.5, 0.12).named
    assert (found["false_share"], found["rmse"], found["rmse_majority"]) == (None, 2.5, 0.12)
    assert said(0, 1.0, 0.1, 0.102) is None
    assert said(0, 1.0, float("nan"), 0.1) is None
