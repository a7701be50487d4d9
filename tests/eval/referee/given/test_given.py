"""Landmark numbers and frames of other programs' runs."""

from __future__ import annotations

import numpy as np
import pytest

from data.formats.results.path import GivenPath
from data.logs import open_log
from data.result import DISCARD, NEW
from eval.referee.given.runs import TruePath, begun_by, created_by, given_run, log_of


def test_landmarks_are_numbered_in_the_order_of_their_creation_retracted_ones_too():
    decisions = np.array([NEW, NEW, 0, DISCARD, NEW])
    final = np.array([NEW, 0, 0, DISCARD, NEW])
    assert created_by(decisions, final, "slam").tolist() == [0, 1, -1, -1, 2]
    assert created_by(decisions, final, "localization").tolist() == [-1] * 5


def test_a_landmark_whose_creation_was_revised_begins_with_its_first_observation():
    created = np.array([0, -1, 1, -1, -1, 2, -1])
    final = np.array([DISCARD, 0, NEW, 0, 1, 1, 2])  # 0 and 2 without what created them; 1 as it was
    assert begun_by(final, created).tolist() == [-1, 0, 1, -1, -1, -1, 2]
    # in a known map nothing begins, whatever its ids are
    assert begun_by(np.array([4, 4, 7]), np.full(3, -1)).tolist() == [-1] * 3


@pytest.mark.parametrize(("late", "on_its_frames"), [(0.0, True), (5e-7, True), (0.01, False)])
def test_on_the_frames_of_the_log_it_is_a_run_of_the_log(late, on_its_frames):
    log = open_log("arena:0")
    path = GivenPath("a", "TUM", log.recorded.time + late, log.truth.pose)
    run = given_run("a", "slam", {"final": path}, log, TruePath(log.recorded.time, log.truth.pose))
    assert (log_of(run, log) is log) is on_its_frames
