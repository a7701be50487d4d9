"""Limits of the tests of lost estimators, for runs written by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import Observations
from data.notice import Code, notice, stopped
from data.result import DISCARD, NEW, Failure, Innovations, MapEstimate
from eval.referee.lost import former_observations, lost
from tests.eval.handmade import FRAMES, LANDMARKS, circle_log, run_with_error

PER_FRAME = 3


def observing(*, known_map=True):
    """All frames see landmark 3 three times."""
    log = circle_log(known_map=known_map)
    r = log.recorded
    frame = np.repeat(np.arange(FRAMES), PER_FRAME)
    z = np.concatenate([np.tile(r.sensor.predict(p, LANDMARKS.xy[:1]), (PER_FRAME, 1)) for p in log.truth.pose])
    return replace(r, observations=Observations(frame, z, np.tile(0.01 * np.eye(2), (len(z), 1, 1))))


INPUTS = observing()
M = PER_FRAME * FRAMES


def localizing(decisions, **more):
    run = run_with_error(np.zeros(3), task="localization", association="nn", mapped=False)
    nothing = np.full(M, -1)
    return replace(run, decisions=decisions, final_decisions=decisions, created=nothing, **more)


def used_but(*unused):
    decisions = np.full(M, 3)
    for frames in unused:
        decisions[np.isin(INPUTS.observations.frame, list(frames))] = DISCARD
    return decisions


def test_no_pairing_in_ten_frames_with_thirty_observations_is_lost_from_their_first_on():
    found = lost(localizing(used_but(range(15, 25))), INPUTS)
    assert (found.code, found.frame) == (Code.UNPAIRED, 15)
    assert found.named == {"did": 0, "could": 30.0, "last": 24}
    assert lost(localizing(used_but(range(15, 24))), INPUTS) is None


@pytest.mark.parametrize(("used", "is_lost"), [(2, True), (3, False)])
def test_a_tenth_of_the_observations_is_enough_not_to_be_lost(used, is_lost):
    decisions = used_but(range(15, 25))
    decisions[np.flatnonzero(decisions == DISCARD)[5 : 5 + used]] = 3
    assert (lost(localizing(decisions), INPUTS) is not None) == is_lost


def test_observations_labelled_as_no_landmark_of_the_map_do_not_count():
    run = localizing(used_but(range(15, 25)))
    label = np.full(M, 3)
    assert lost(run, INPUTS, label) is not None
    label[np.isin(INPUTS.observations.frame, range(15, 25))] = 99
    assert lost(run, INPUTS, label) is None


def test_dead_reckoning_and_failed_runs_are_not_lost():
    run = localizing(used_but(range(FRAMES)))
    assert lost(run, INPUTS) is not None
    assert lost(replace(run, association="none"), INPUTS) is None
    assert lost(replace(run, failure=Failure("diverged", 3, stopped("made up"))), INPUTS) is None


def whitened(*large, size=10.5, unused=()):
    white = np.full((M, 2), np.nan)
    white[:60] = 0.1
    white[list(large)] = [size, 0.0]
    white[list(unused)] = np.nan
    nothing = np.full(FRAMES, np.nan)
    return Innovations(nothing, np.zeros(FRAMES, int), nothing, white)


def test_three_innovations_in_a_row_beyond_ten_sigma_are_more_than_wrong_labels():
    run = localizing(used_but())
    found = lost(replace(run, innovations=whitened(30, 31, 32)), INPUTS)
    assert found == notice(Code.TEN_SIGMA, 10, innovations=3)
    assert lost(replace(run, innovations=whitened(30, 31, 33, 34)), INPUTS) is None
    assert lost(replace(run, innovations=whitened(30, 31, 32, size=9.9)), INPUTS) is None
    # what was not used stands between
    assert lost(replace(run, innovations=whitened(30, 31, 33, unused=(32,))), INPUTS) is not None


def slam(decisions=None, *, times_seen=3, first=0):
    """A run that has landmark 0 in its map where it is."""
    run = run_with_error(np.zeros(3), association="nn")
    found = MapEstimate(
        np.array([0]), LANDMARKS.xy[:1], 0.01 * np.eye(2)[None], np.array([first]), np.array([times_seen])
    )
    decisions = np.zeros(M, int) if decisions is None else decisions
    return replace(run, map=found, decisions=decisions, final_decisions=decisions, created=np.full(M, -1))


def test_a_landmark_is_expected_twenty_frames_after_it_was_made_if_it_was_seen_three_times():
    inputs = observing(known_map=False)
    could, did, looked = former_observations(slam(first=5), inputs)
    assert looked.all()
    # well inside: 0.9 of 8 m; the robot is at most 10 m from (6, 0) on its circle of 4 m
    away = np.linalg.norm(circle_log().truth.pose[:, :2] - LANDMARKS.xy[0], axis=1)
    assert could.tolist() == ((away < 7.2) & (np.arange(FRAMES) >= 25)).astype(float).tolist()
    assert did.tolist() == [3 * (k >= 25) for k in range(FRAMES)]
    seldom, done, _ = former_observations(slam(times_seen=2), inputs)
    assert not seldom.any()
    assert not done.any()


def test_slam_without_pairings_after_ten_frames_is_lost_there():
    inputs = observing(known_map=False)
    decisions = np.full(M, NEW)
    assert lost(slam(decisions), inputs).frame == 10
    decisions[inputs.observations.frame >= 10] = np.where(np.arange(90) % 10 < 1, 0, NEW)
    assert lost(slam(decisions), inputs) is None, "a tenth of them was used"
