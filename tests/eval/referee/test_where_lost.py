"""First frame of a lost estimator, for runs written by hand."""

from __future__ import annotations

import numpy as np
import pytest

from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.notice import Code, notice, stopped
from data.result import DISCARD, Innovations, Run, Trajectory
from data.sensors import RangeBearing
from eval.referee.lost import lost

FRAMES = 100


def inputs(each: int = 1, known_map: bool = True) -> Inputs:
    """A robot at rest that sees landmark 0, 2 m ahead, so many times in every frame."""
    frame = np.repeat(np.arange(FRAMES), each)
    m = len(frame)
    return Inputs(
        Prior(np.zeros(3), 0.01 * np.eye(3)),
        np.arange(FRAMES, dtype=np.float64),
        Increments(np.zeros((FRAMES, 3)), np.tile(1e-6 * np.eye(3), (FRAMES, 1, 1))),
        Observations(frame, np.tile([2.0, 0.0], (m, 1)), np.tile(0.01 * np.eye(2), (m, 1, 1))),
        RangeBearing(max_range=8.0),
        LandmarkMap(np.array([0]), np.array([[2.0, 0.0]])) if known_map else None,
    )  # fmt: skip


def run(used, task: str = "localization", white=None, **fields) -> Run:
    """A run that used these observations, as landmark 0."""
    decisions = np.where(used, 0, DISCARD)
    path = Trajectory(np.zeros((FRAMES, 3)), np.tile(1e-4 * np.eye(3), (FRAMES, 1, 1)))
    m = len(decisions)
    if white is not None:
        nothing = np.full(FRAMES, np.nan)
        fields["innovations"] = Innovations(nothing, np.zeros(FRAMES, np.int64), nothing, white)
    return Run("ekf", "jcbb", task, path, None, None, decisions, decisions, np.full(m, -1), **fields)


def until(frame: int, each: int = 1):
    return np.repeat(np.arange(FRAMES), each) < frame


def test_it_is_lost_in_the_first_thirty_observations_of_which_less_than_a_tenth_is_used():
    found = lost(run(until(50)), inputs())
    assert found is not None
    assert found == notice(Code.UNPAIRED, 48, did=2, could=30.0, last=77)


def test_a_tenth_is_enough():
    assert lost(run(np.arange(FRAMES) % 10 == 0), inputs()) is None
    assert lost(run(np.arange(FRAMES) % 11 == 10), inputs()) is not None


def test_many_observations_at_once_are_judged_over_ten_frames():
    found = lost(run(until(50, each=6)), inputs(each=6))
    assert found == notice(Code.UNPAIRED, 50, did=0, could=60.0, last=59)


def test_fewer_than_thirty_at_the_end_are_not_judged():
    assert lost(run(until(FRAMES - 12)), inputs()) is None
    assert lost(run(until(FRAMES - 29)), inputs()).frame == FRAMES - 31  # 2 and 28, or so


def test_observations_labelled_as_no_landmark_do_not_count():
    assert lost(run(until(50)), inputs(), label=np.where(until(50), 0, 77)) is None


def test_a_mapper_is_judged_after_its_first_frames_over_all():
    slam = inputs(known_map=False)
    assert lost(run(until(10), "slam"), slam) == notice(Code.HARDLY_USED, 10, share=0.0, after=10)
    assert lost(run(until(19), "slam"), slam) is None  # 9 of 90
    assert lost(run(until(18), "slam"), slam) is not None


def test_a_map_changes_nothing_in_slam():
    assert lost(run(until(50), "slam"), inputs()) is None


@pytest.mark.parametrize(("squared", "is_lost"), [(99.0, False), (101.0, True)])
def test_three_innovations_beyond_ten_sigma_in_a_row_are_absurd(squared, is_lost):
    white = np.zeros((FRAMES, 2))
    white[[20, 40, 41, 60, 61, 62]] = np.sqrt([0.25 * squared, 0.75 * squared])
    found = lost(run(np.ones(FRAMES, bool), white=white), inputs())
    assert (found is not None) == is_lost
    if is_lost:
        assert found == notice(Code.TEN_SIGMA, 60, innovations=3)


def test_in_a_row_are_those_that_were_used():
    white = np.zeros((FRAMES, 2))
    white[[20, 22, 24]], white[[21, 23]] = 10.0, np.nan
    assert lost(run(np.ones(FRAMES, bool), white=white), inputs()).frame == 20


@pytest.mark.parametrize(
    ("total", "is_lost"), [((0.0, 0), False), ((5.0, 0), False), ((990.0, 10), False), ((1010.0, 10), True)]
)
def test_a_whole_cost_of_a_hundred_per_degree_of_freedom_is_absurd(total, is_lost):
    found = lost(run(np.ones(FRAMES, bool), total_nis=total), inputs())
    assert found == (notice(Code.NIS, 0, per_dof=101.0, over_run=False) if is_lost else None)


GATED = (0.9, 1.5)
CHANCE = (1.8 * 0.9 * 100 + 1.0, 100)


@pytest.mark.parametrize(
    ("share", "total", "gated", "is_lost"),
    [
        (50, CHANCE, GATED, True),
        (100, CHANCE, GATED, False),  # nearly all are used
        (50, (1.8 * 0.9 * 100 - 1.0, 100), GATED, False),
        (50, (CHANCE[0] * 0.29, 29), GATED, False),  # too few
        (50, (CHANCE[0] * 0.30, 30), GATED, True),
        (50, CHANCE, (1.0, 2.0), False),  # no gate, so no chance that it was filled by
        (50, None, GATED, False),
    ],
)
def test_few_pairings_that_fill_the_gate_are_by_chance(share, total, gated, is_lost):
    used = np.arange(FRAMES) % 100 < 100
    used[np.arange(FRAMES) % 2 == 1] = share == 100
    assert (lost(run(used, total_nis=total, gated=gated), inputs()) is not None) == is_lost


def test_dead_reckoning_and_those_that_stopped_are_not_lost():
    from dataclasses import replace

    from data.result import Failure

    nothing = run(until(0))
    assert lost(nothing, inputs()) is not None
    assert lost(replace(nothing, association="none"), inputs()) is None
    assert lost(replace(nothing, failure=Failure("diverged", 3, stopped("so"))), inputs()) is None
