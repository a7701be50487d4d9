"""Broken filters: sound at no size, off in NEES at theirs, each wrong in the way it says."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy import stats

from data.worlds.arena import Arena, simulate
from eval.referee.consistency import nees
from eval.replay.run import filter_known
from tests.research.diagnosis.broken import BROKEN, for_task

CASES = [(name, task) for name, b in BROKEN.items() for task in b.tasks]
RUNS = 30


@functools.cache
def arena(seed):
    log = simulate(Arena(frames=60, landmarks=15), seed)
    return log.inputs(labels=True), log.truth.pose


def mean_nees(run, truth):
    assert run.failure is None
    return np.mean(nees(run.online.pose, run.online.covariance, truth, "pose"))


@functools.cache
def sound(task):
    """Mean NEES of each log."""
    logs = [arena(seed) for seed in range(RUNS)]
    return np.array([mean_nees(filter_known(for_task(inputs, task), task), truth) for inputs, truth in logs])


def numbers(run):
    """All that a run holds, its time aside."""
    i, state = run.innovations, run.map
    found = [run.online.pose, run.online.covariance, run.decisions, run.final_decisions, run.created, run.state_size]
    found += [i.nis, i.dof, i.log_likelihood, i.white, np.array(run.total_nis), np.array(run.gated)]
    return found + ([] if state is None else [state.xy, state.covariance, state.first_frame, state.times_seen])


@pytest.mark.parametrize(("name", "task"), CASES)
def test_at_no_size_it_is_the_sound_filter_bit_for_bit(name, task):
    inputs, _ = arena(0)
    run, right = BROKEN[name].run(inputs, task, BROKEN[name].none), filter_known(for_task(inputs, task), task)
    assert (run.estimator, run.association, run.task, run.failure) == ("ekf", "known", task, None)
    for a, b in zip(numbers(run), numbers(right), strict=True):
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize(("name", "task"), CASES)
def test_nees_says_that_it_is_broken(name, task):
    """At the largest size, log by log beside the sound filter, so that what the arena does to both cancels."""
    size = BROKEN[name].sizes[-1]
    means = np.array([mean_nees(BROKEN[name].run(arena(s)[0], task, size), arena(s)[1]) for s in range(RUNS)])
    assert stats.wilcoxon(means, sound(task), alternative="greater").pvalue < 1e-4
    assert means.mean() > 1.3 * sound(task).mean()
