"""NEES of EKF-SLAM and localization with walls over many seeds of the ideal room; what it depends on."""

from __future__ import annotations

import numpy as np
import pytest

from eval.referee.consistency import CONSISTENT, nees, verdict
from eval.referee.score import confusion_of
from eval.replay.run import compare
from eval.replay.settings import Setup
from tests.ekf.lines.world import line_log

FIRST = 8
"""Frames that are left out: the prior and what lies next to it."""


def run_means(seeds, task, name, association="known", setup=None):
    """Mean pose NEES of each run, and all their outcomes of pairings: right, wrong, in the map but not paired."""
    means, outcomes = [], np.zeros(3, int)
    for seed in seeds:
        log = line_log(seed)
        (run,) = compare(log.inputs(labels=association == "known"), task, [name], association, setup or Setup())
        assert run.status == "ok"
        values = nees(run.online.pose, run.online.covariance, log.truth.pose, "pose")
        means.append(float(np.nanmean(values[FIRST:])))
        c = confusion_of(run, log, "online")
        outcomes += [c.tp, c.wrong + c.spurious, c.fn]
    return np.array(means), outcomes


def test_localization_has_the_nees_of_its_three_degrees_of_freedom():
    means, _ = run_means(range(12), "localization", "ekf")
    assert means.mean() == pytest.approx(3.0, abs=0.35)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ekf", "ekf-iterated", "ekf-fej"])
@pytest.mark.parametrize("task", ["slam", "localization"])
@pytest.mark.parametrize("association", ["known", "jcbb"])
def test_walls_are_consistent_over_fifty_seeds(name, task, association):
    # in a known map a gate of 0.99 is seen in the NEES: what it leaves out is noise, not error
    setup = Setup(gate=0.9999) if association == "jcbb" else Setup()
    means, (right, wrong, _) = run_means(range(50), task, name, association, setup=setup)
    found = verdict(means, 3)
    assert found.word == CONSISTENT, f"{found.mean:.2f} [{found.lower:.2f}, {found.upper:.2f}]"
    assert wrong <= 1e-3 * right
