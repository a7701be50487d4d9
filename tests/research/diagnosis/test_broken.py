"""Broken filters: sound at no size, off in NEES at theirs, each wrong in the way it says."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy import stats

from data.errors import UsageError
from data.inputs import Increment
from data.motion.velocity import carried
from data.result import NEW
from data.worlds.arena import Arena, simulate
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from eval.referee.consistency import nees
from eval.replay.run import filter_known
from tests.research.diagnosis import broken
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


@pytest.mark.parametrize("task", ["localization", "slam"])
def test_the_covariance_reported_is_the_only_thing_that_is_less(task):
    inputs, _ = arena(0)
    run, right = broken.reported(inputs, task, 0.25), filter_known(for_task(inputs, task), task)
    np.testing.assert_array_equal(run.online.covariance, 0.25 * right.online.covariance)
    np.testing.assert_array_equal(run.online.pose, right.online.pose)
    np.testing.assert_array_equal(run.innovations.nis, right.innovations.nis)
    if task == "slam":
        np.testing.assert_array_equal(run.map.covariance, 0.25 * right.map.covariance)


def steps(kind, *share):
    """A filter after one frame with all its landmarks new (SLAM) or seen, and one increment that may follow."""
    inputs, _ = arena(0)
    given = for_task(inputs, "slam" if issubclass(kind, EkfSlam) else "localization")
    filter_ = kind(*share, given) if share else kind(given.prior, given.sensor, *([given.map] if given.map else []))
    seen = given.frame_observations(0)
    label = inputs.observations.label[: len(seen.z)]
    filter_.update(seen, np.full(len(seen.z), NEW) if given.map is None else label)
    return filter_, Increment(np.array([0.5, 0.1, 0.3]), np.diag([0.01, 0.02, 0.003]))


@pytest.mark.parametrize(
    ("sound_kind", "kind"), [(EkfLocalizer, broken.TurnlessLocalizer), (EkfSlam, broken.TurnlessSlam)]
)
def test_the_prediction_lacks_that_share_of_the_headings_column(sound_kind, kind):
    before, _ = steps(sound_kind)
    turnless, increment = steps(kind, 0.4)
    np.testing.assert_array_equal(turnless.covariance, before.covariance)
    P, d = before.covariance, before.size
    _, _, F3, B = carried(before.mean[2], increment.mean)
    F, Q = np.eye(d), np.zeros((d, d))
    F[:2, 2] = 0.6 * F3[:2, 2]
    Q[:3, :3] = B @ increment.covariance @ B.T
    turnless.predict(increment)
    before.predict(increment)
    np.testing.assert_allclose(turnless.covariance, F @ P @ F.T + Q, atol=1e-14)
    np.testing.assert_array_equal(turnless.mean, before.mean)
    np.testing.assert_array_equal(turnless.covariance, turnless.covariance.T)


def test_new_landmarks_lose_that_share_of_their_cross_covariance_and_of_nothing_else():
    right, _ = steps(EkfSlam)
    forgetful, _ = steps(broken.Forgetful, 0.3)
    of = np.concatenate([np.zeros(3), np.repeat(np.arange(1, 1 + (right.size - 3) // 2), 2)])
    share = np.where(of[:, None] == of, 1.0, 0.7)
    np.testing.assert_allclose(forgetful.covariance, share * right.covariance, rtol=1e-15)
    np.testing.assert_array_equal(forgetful.mean, right.mean)
    assert np.linalg.eigvalsh(forgetful.covariance)[0] > 0.0


def test_localization_has_no_cross_covariance_to_lose():
    assert BROKEN["cross-covariance"].tasks == ("slam",)
    with pytest.raises(UsageError, match="slam only"):
        broken.cross_covariance(arena(0)[0], "localization", 0.5)


def test_the_table_goes_from_small_to_large():
    for b in BROKEN.values():
        distance = [abs(size - b.none) for size in b.sizes]
        assert distance == sorted(distance)
        assert distance[0] > 0.0
        assert b.called
