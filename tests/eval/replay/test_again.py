"""A filter's run looked at again has the same map in the end, and its sigmas shrink where the loop is closed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.logs import open_log
from eval.replay import run as again
from eval.replay.run import compare, landmark_sigmas
from eval.replay.settings import Setup

LOG = open_log("corridor:0")
RUN = compare(LOG.inputs(labels=True), "slam", ["ekf"])[0]


def widest(run) -> np.ndarray:
    return np.sqrt(np.linalg.eigvalsh(run.map.covariance)[:, -1])


def test_sigmas_end_as_those_of_the_last_map_and_begin_when_a_landmark_does():
    sigma = landmark_sigmas(LOG.recorded, RUN)
    assert sigma[-1, RUN.map.number] == pytest.approx(widest(RUN))
    known = np.isfinite(sigma)
    assert known.argmax(axis=0).tolist() == RUN.map.first_frame.tolist()
    assert np.all(known[-1])


def test_a_landmark_that_was_removed_has_none_from_then_on():
    log = open_log("corridor:0:people")
    run = compare(log.inputs(), "slam", ["ekf"], "jcbb", Setup(maintain=True))[0]
    sigma = landmark_sigmas(log.recorded, run)
    gone = np.flatnonzero(run.removed >= 0)
    assert len(gone)
    for number in gone:
        frame = run.removed[number]
        assert np.all(np.isnan(sigma[frame:, number]))
        assert np.isfinite(sigma[frame - 1, number])
    assert sigma[-1, run.map.number] == pytest.approx(widest(run))


def test_what_cannot_be_looked_at_again_has_none(monkeypatch):
    assert landmark_sigmas(LOG.recorded, replace(RUN, estimator="isam2")) is None
    assert landmark_sigmas(LOG.recorded, replace(RUN, state_size=None)) is None
    monkeypatch.setattr(again, "MOST_WORK", 10.0)
    assert landmark_sigmas(LOG.recorded, RUN) is None
