"""What a log less its estimated errors says of itself, and its twins."""

from __future__ import annotations

import numpy as np
import pytest

from data.motion.priors import systematic
from data.worlds.registry import named_log
from eval.plan.calibrate import with_systematic
from eval.referee.truth_free import of_smoother
from eval.replay.run import compare
from eval.replay.settings import Setup
from eval.studies.twins import inputs_of, source_of, twin


@pytest.fixture(scope="module", params=["localization", "slam"])
def smoothed(request):
    """A log whose wheels err, and batch's plain run and the one that estimates the errors, each with its log."""
    log = named_log("arena:0:scale=-0.1+curvature=0.05+frames=250")
    aware = with_systematic(log, systematic(("scale", "curvature")))
    return [(each, _batch(each, request.param)) for each in (log, aware)]


def _batch(log, task):
    (run,) = compare(inputs_of(log, task, "known"), task, ("batch",), "known")
    return run


def test_what_a_smoother_estimated_its_residuals_no_longer_ask_for(smoothed):
    largest = []
    for log, run in smoothed:
        said = of_smoother(run, inputs_of(log, run.task, "known")).statistics
        largest.append(max(abs(m.value / m.se) for n, m in said.items() if n.startswith("slope_") and m.se > 0.0))
    assert largest[0] > 10.0
    assert largest[1] < 4.0


def test_twins_have_no_errors_and_estimate_them_all_the_same(smoothed):
    log, run = smoothed[1]
    drawn = twin(source_of(log, run, (), Setup()), 0)
    assert drawn.recorded.systematic is log.recorded.systematic
    found = _batch(drawn, run.task).errors_final
    assert np.all(np.abs(found.mean[-1]) < 4.0 * found.sigma[-1])
    # odometry as of a robot without errors: what is stated is the way but for noise
    driven = np.hypot(*np.diff(run.final.pose[:, :2], axis=0).T).sum()
    assert np.hypot(*drawn.recorded.increments.mean[:, :2].T).sum() == pytest.approx(driven, rel=0.02)
