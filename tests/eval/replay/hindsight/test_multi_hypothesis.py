"""Several hypotheses: they branch where an observation is ambiguous, and later observations decide."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from data.result import NEW
from data.worlds.registry import named_log
from eval.referee.score import confusion_of
from eval.replay.hindsight.multi_hypothesis import best_assignments
from eval.replay.run import compare, front_end, through
from eval.replay.settings import MHT, Setup


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 3))
def test_assignments_are_the_cheapest_of_all_in_order(seed, m, more):
    rng = np.random.default_rng(seed)
    cost = rng.normal(size=(m, m + more))
    cost[rng.random(cost.shape) < 0.3] = np.inf
    every = sorted(sum(cost[i, j] for i, j in enumerate(p)) for p in permutations(range(m + more), m))
    expected = [total for total in every if np.isfinite(total) and total <= every[0] + 2.0][:5]
    found = best_assignments(cost, 5, 2.0)
    assert [total for total, _ in found] == pytest.approx(expected)
    assert all(sum(cost[np.arange(m), columns]) == pytest.approx(total) for total, columns in found)


LOG = named_log("arena:1:frames=160")


def test_every_landmark_begins_once_and_the_map_has_those_that_the_final_decisions_name():
    log = named_log("corridor:2:people+frames=60")
    for run in compare(log.inputs(), "slam", ["ekf", "isam2", "batch"], MHT, Setup(hypotheses=3)):
        assert run.failure is None
        revised = {e.old == NEW or e.new == NEW for e in run.events}
        assert run.estimator == "batch" or revised == {True, False}, "another hypothesis took the lead"
        begun = run.initialized[run.initialized >= 0]
        assert len(set(begun.tolist())) == len(begun)
        assert set(run.final_decisions[run.final_decisions >= 0].tolist()) <= set(begun.tolist())
        assert ((run.final_decisions == NEW) == (run.initialized >= 0)).all()
        assert set(run.map.number.tolist()) == set(begun.tolist())


def test_later_observations_correct_pairings_that_one_frame_cannot_decide():
    runs = [*compare(LOG.inputs(), "slam", ["ekf"], "jcbb"), *compare(LOG.inputs(), "slam", ["ekf"], MHT)]
    wrong = {run.association: confusion_of(run, LOG, "final") for run in runs}
    assert wrong[MHT].fp + wrong[MHT].fn < wrong["jcbb"].fp + wrong["jcbb"].fn


@pytest.mark.parametrize("estimator", ["ekf", "isam2", "fixed-lag"])
def test_a_hypothesis_goes_on_as_if_it_were_alone(estimator):
    """A copy ends with the same bytes, whatever the original does meanwhile."""
    inputs = LOG.inputs().without_map()
    front = front_end(estimator, MHT, inputs, Setup(hypotheses=1))
    for k in range(40):
        through(front, inputs.frame(k), lambda *_: None)
    copied = front._copied(front.members[0].replay)
    for k in range(40, 60):
        front.move(inputs.frame(k))  # without its observations
        through(copied, inputs.frame(k), lambda *_: None)
    again = front_end(estimator, MHT, inputs, Setup(hypotheses=1))
    for k in range(40):
        through(again, inputs.frame(k), lambda *_: None)
    for k in range(40, 60):
        through(again.members[0].replay, inputs.frame(k), lambda *_: None)
    for found, expected in zip(copied.estimator.estimate(), again.members[0].replay.estimator.estimate(), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_in_a_known_map_it_localizes_without_labels():
    (run,) = compare(LOG.inputs(), "localization", ["ekf"], MHT)
    outcomes = confusion_of(run, LOG, "final")
    assert outcomes.fp + outcomes.fn <= 2
    assert not (run.decisions == NEW).any()


def test_more_hypotheses_than_one_are_only_kept_where_they_are_nearly_as_likely():
    inputs = LOG.inputs().without_map()
    kept = []
    for n in (1, 8):
        front = front_end("ekf", MHT, inputs, replace(Setup(), hypotheses=n))
        for k in range(30):
            through(front, inputs.frame(k), lambda *_: None)
            kept.append(len(front.members))
            assert kept[-1] <= n
    assert max(kept) == 8
